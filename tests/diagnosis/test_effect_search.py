"""The search on plants that are integrated independently, and on a measured recording."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plants import EFFECTS, make_recording
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from skhyst.compose import Cascade
from skhyst.diagnosis import Effect, EffectSearchCV, register_effect, unregister_effect
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, TransferFunction
from skhyst.records import read_records, stack_records

PIEZO_AFM = (
    Path(__file__).resolve().parents[2].parent
    / "shared/data/piezo_afm/SG_data_triangle_sin_raw.mat"
)
SEED = 9100


def declared_model(name):
    if name == "prandtl_ishlinskii":
        return PrandtlIshlinskii()
    return Cascade([("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(2))])


def searched(recording, declared="prandtl_ishlinskii", **options):
    search = EffectSearchCV(declared_model(declared), n_jobs=2, random_state=0, **options)
    return search.fit(recording.X_train, recording.y_train)


@pytest.mark.parametrize(
    ("effect", "declared"),
    [(effect, "prandtl_ishlinskii") for effect in EFFECTS]
    + [(effect, "cascade") for effect in ("lag", "delay", "output_saturation", "drift")],
)
def test_a_missing_effect_is_named(effect, declared):
    recording = make_recording(effect, declared, SEED, n_samples=6000)
    search = searched(recording, declared)
    first = search.history_.iloc[0]
    assert effect in (first["effect"], *first["ambiguous_with"])
    error = search.held_out_error(recording.X_test, recording.y_test)
    assert error < (1.25 if effect == "delay" else 1.10) * recording.noise_std
    assert search.verdict_ == "noise"
    assert search.error_after_ < search.error_before_
    evidence = search.evidence_[first["effect"]]
    assert evidence.statement
    assert all(np.isfinite(value) for value, _, _ in evidence.numbers.values())
    assert all(len(x) == len(y) for _, x, y, _ in evidence.picture.curves)


@pytest.mark.parametrize("declared", ["prandtl_ishlinskii", "cascade"])
def test_nothing_missing_claims_nothing(declared):
    recording = make_recording("none", declared, SEED + 1, n_samples=6000)
    search = searched(recording, declared)
    assert search.effects_ == []
    assert search.verdict_ == "noise"
    assert search.error_after_ == search.error_before_
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.2)


def test_evidence_gives_the_true_parameters():
    recording = make_recording("resonance", "prandtl_ishlinskii", SEED + 2, n_samples=6000)
    numbers = searched(recording, effects=["resonance"]).evidence_["resonance"].numbers
    truth = recording.truth["parameters"]
    assert numbers["natural frequency"][0] == pytest.approx(truth["frequency"], rel=2e-3)
    assert numbers["damping ratio"][0] == pytest.approx(truth["damping"], rel=5e-2)


def unexplained_recording():
    """A response that bends with the rate of the drive."""
    rng = np.random.default_rng(3)
    records = []
    for _ in range(4):
        t = np.arange(1500) / 1500
        drive = np.sin(2 * np.pi * (2 + 5 * t) * t) * rng.uniform(0.7, 1.0)
        rate = np.gradient(drive) / np.abs(np.gradient(drive)).max()
        response = drive + 0.1 * drive**2 * np.abs(rate)
        records.append((drive, response + 0.002 * rng.normal(size=1500)))
    return stack_records(records, dt=1e-3)


def test_unknown_structure_is_called_unexplained():
    X, y = unexplained_recording()
    search = EffectSearchCV(
        PrandtlIshlinskii(), effects=["offset", "input_saturation"], random_state=0
    ).fit(X, y)
    assert search.effects_ == []
    assert search.verdict_ == "unexplained"
    assert search.noise_floor_ < search.error_after_


def test_units_change_nothing():
    recording = make_recording("lag", "prandtl_ishlinskii", SEED + 3, n_samples=5000)
    plain = searched(recording, effects=["lag", "delay", "offset"])
    X = recording.X_train * 1e3
    X.index = X.index.set_levels(X.index.levels[1] * 1e-3, level=1)
    other = EffectSearchCV(
        PrandtlIshlinskii(), effects=["lag", "delay", "offset"], n_jobs=2, random_state=0
    ).fit(X, pd.Series(recording.y_train.to_numpy() * 1e-6, X.index))
    assert other.effects_ == plain.effects_ == ["lag"]
    np.testing.assert_allclose(other.error_after_ * 1e6, plain.error_after_, rtol=1e-5)
    np.testing.assert_allclose(other.error_before_ * 1e6, plain.error_before_, rtol=1e-5)


def test_same_seed_same_result_and_order_of_records_is_immaterial():
    recording = make_recording("output_saturation", "prandtl_ishlinskii", SEED, n_samples=5000)
    options = {"effects": ["output_saturation", "asymmetry", "drift"]}
    first, again = searched(recording, **options), searched(recording, **options)
    assert first.error_after_ == again.error_after_
    assert first.noise_floor_ == again.noise_floor_
    pd.testing.assert_frame_equal(first.ranking_, again.ranking_)
    order = [3, 0, 4, 2, 1]
    X = pd.concat([recording.X_train.loc[[label]] for label in order])
    y = pd.concat([recording.y_train.loc[[label]] for label in order])
    permuted = EffectSearchCV(PrandtlIshlinskii(), n_jobs=2, random_state=0, **options).fit(X, y)
    assert permuted.effects_ == first.effects_
    assert permuted.error_after_ == pytest.approx(first.error_after_, rel=1e-4)


def test_held_out_residuals_align_with_the_rows():
    recording = make_recording("none", "prandtl_ishlinskii", SEED, n_samples=4000)
    X = recording.X_train.xs(0, level="record")
    y = recording.y_train.xs(0, level="record")
    search = EffectSearchCV(PrandtlIshlinskii(), effects=["lag"], cv=4, washout=11).fit(X, y)
    assert np.isnan(search.residual_before_).sum() == 4 * 11
    scored = np.isfinite(search.residual_before_)
    np.testing.assert_allclose(
        (search.residual_before_ + search.prediction_before_)[scored], y.to_numpy()[scored]
    )


def test_budget_and_errors():
    recording = make_recording("lag", "prandtl_ishlinskii", SEED, n_samples=4000)
    assert searched(recording, effects=["lag"], max_effects=0).effects_ == []
    X, y = recording.X_train, recording.y_train
    with pytest.raises(ValueError, match="asymmetry"):
        EffectSearchCV(PrandtlIshlinskii(), effects=["magic"]).fit(X, y)
    with pytest.raises(TypeError, match="parametric model"):
        EffectSearchCV(LinearRegression()).fit(X, y)
    with pytest.raises(ValueError, match="at least"):
        EffectSearchCV(PrandtlIshlinskii(2)).fit(np.arange(6.0).reshape(-1, 1), np.arange(6.0))


def test_a_search_survives_pickling_into_a_fresh_process(tmp_path):
    recording = make_recording("lag", "prandtl_ishlinskii", SEED, n_samples=4000)
    search = searched(recording, effects=["lag"])
    assert clone(search).get_params()["effects"] == ["lag"]
    path = tmp_path / "search.pickle"
    path.write_bytes(pickle.dumps((search, recording.X_test)))
    code = (
        "import pickle, sys; s, X = pickle.load(open(sys.argv[1], 'rb')); print(s.predict(X).sum())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
    )
    assert float(done.stdout) == pytest.approx(search.predict(recording.X_test).sum(), rel=1e-12)


def test_an_effect_of_ones_own_is_found():
    effect = Effect("my_lag", lambda: [FirstOrderLag()], "A lag of my own.", "Sweep.")
    register_effect(effect)
    try:
        recording = make_recording("lag", "prandtl_ishlinskii", SEED, n_samples=4000)
        assert searched(recording, effects=["my_lag", "offset"]).effects_ == ["my_lag"]
        with pytest.raises(ValueError, match="registered already"):
            register_effect(effect)
    finally:
        unregister_effect("my_lag")


@pytest.mark.skipif(not PIEZO_AFM.exists(), reason=f"{PIEZO_AFM} is absent")
def test_measured_piezo_scanner_lacks_asymmetry():
    X, y = read_records(PIEZO_AFM, drive="V", response="SG[0]", sampling_rate=1.0)
    n = int(0.6 * len(y))
    search = EffectSearchCV(PrandtlIshlinskii(), n_jobs=2, random_state=0).fit(X[:n], y[:n])
    assert search.effects_[0] in ("asymmetry", "static_nonlinearity")
    span = np.ptp(y.to_numpy())
    assert search.held_out_error(X[n:], y[n:], declared=True) >= 0.02 * span
    assert search.held_out_error(X[n:], y[n:]) <= 0.008 * span
    assert np.sqrt(np.mean((search.predict(X[n:]) - y[n:]) ** 2)) <= 0.009 * span
