"""What knows no noise decides: the reference of a loop, the smooth part of a noisy drive."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import search_steps
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from sklearn.base import clone

from skhyst.cli import main
from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._criterion import paired_p_value
from skhyst.diagnosis._reference import Reference
from skhyst.diagnosis._verdict import judge_residual
from skhyst.linear import Gain
from skhyst.optimize import RecordData
from skhyst.records import record_slices, stack_records

N, GAIN = 1500, 2.0


def wandering(rng, n, width):
    """Draw a smooth signal about zero, of unit variance."""
    pole = np.exp(-1.0 / width)
    signal = lfilter([1.0], np.poly([pole, pole]), rng.standard_normal(n + 20 * width))[-n:]
    return (signal - signal.mean()) / signal.std()


def in_loop(rng, correlation, *, n=N, level=0.05, top=np.inf, speed=0.5, width=300):
    """Return drive and reference, and the response: an integral controller around a gain.

    The noise is AR(1), ``top`` saturates the plant's output.
    """
    reference = wandering(rng, n, width)
    noise = level * np.sqrt(1.0 - correlation**2) * rng.standard_normal(n + 500)
    noise = lfilter([1.0], [1.0, -correlation], noise)[-n:]
    drive, y, command = np.empty(n), np.empty(n), reference[0] / GAIN
    for t in range(n):
        drive[t] = command
        y[t] = min(GAIN * command, top) + noise[t]
        command = min(max(command + speed / GAIN * (reference[t] - y[t]), -2.0), 2.0)
    return np.column_stack([drive, reference]), y


def recording(seed, correlation=0.5, **options):
    rng = np.random.default_rng(seed)
    return stack_records([in_loop(rng, correlation, **options) for _ in range(4)], dt=0.01)


def search(reference=1, **options):
    options = {"effects": ["lag", "output_saturation", "offset"], "cv": 2} | options
    return EffectSearchCV(Gain(), reference=reference, random_state=0, **options)


def lagging(drive):
    """Return what a rival predicts beyond the true gain: tiny, so that it is neither good nor bad.

    A part of a lag.
    """
    return 1e-6 * (np.concatenate([np.repeat(drive[:1], 5), drive[:-5]]) - drive)


@pytest.mark.parametrize(("correlation", "level"), [(0.0, 0.05), (0.5, 0.01)])
def test_the_level_of_a_needless_candidate_in_a_loop(correlation, level):
    """Two fixed predictions, so that nothing but the criterion is seen."""
    p_values = {"drive": [], "reference": []}
    for seed in range(100):
        rng = np.random.default_rng(seed)
        X, y = in_loop(rng, correlation, level=level)
        slices = record_slices(X, dt=1.0)
        records = Reference(X[:, 0], X[:, 1], slices).explain([RecordData(X[:, 0], y, 1.0)])
        base = y - GAIN * X[:, 0]
        rival = base - lagging(X[:, 0])
        p_values["drive"].append(paired_p_value([base], [rival]))
        seen = [lagging(records[0].explained)]
        p_values["reference"].append(paired_p_value([base], [rival], seen))
    below = {name: np.mean(np.array(own) < 0.1) for name, own in p_values.items()}
    assert 0.01 < below["reference"] < 0.1 + 3.0 * np.sqrt(0.1 * 0.9 / 100)
    if correlation:
        assert below["drive"] > 0.3  # what is noise seems to be predicted


def test_an_instrument_that_shows_nothing_of_the_difference_is_no_evidence():
    rng = np.random.default_rng(0)
    better = rng.standard_normal(500)
    worse = better + 1.0
    assert paired_p_value([worse], [better], [np.ones(500)]) < 1e-6
    assert paired_p_value([worse], [better], [-np.ones(500)]) == 1.0


@pytest.mark.slow
def test_a_loop_that_lacks_nothing():
    """Without the reference the same recording is said to lack an effect."""
    X, y = recording(0)
    found = search().fit(X, y)
    assert (found.effects_, found.verdict_) == ([], "noise")
    assert "closed_loop" not in set(found.data_quality_["fault"])
    assert found.reference_share_ > 0.9
    assert "It predicts 99.8 % of the drive" in found.report().to_markdown()
    blind = search(None).fit(X.iloc[:, :1], y)
    assert blind.effects_ == ["lag"]
    assert blind.reference_share_ is None
    assert "closed_loop" in set(blind.data_quality_["fault"])
    assert "search with it as the reference" in blind.report().sentence


@pytest.mark.slow
def test_what_a_loop_lacks_is_found():
    X, y = recording(1, top=1.0)
    found = search().fit(X, y)
    assert (found.effects_, found.verdict_) == (["output_saturation"], "noise")
    assert found.error_after_ < 1.1 * 0.05
    assert 0.1 < found.reference_share_ < 1.0


def test_structure_that_no_effect_explains_is_still_told():
    X, y = recording(2, top=1.0)
    found = search(effects=["offset"]).fit(X, y)
    assert (found.effects_, found.verdict_) == ([], "unexplained")


@pytest.mark.slow
def test_an_offset_knows_no_noise_either():
    X, y = recording(3)
    y += np.array([0.1, -0.1, 0.2, -0.3])[y.index.get_level_values("record")]
    assert search(effects=["offset", "lag"]).fit(X, y).effects_ == ["offset"]


def test_repetitions_of_a_reference_share_no_noise():
    """The loop makes the response repeat better than the noise is large: that is no floor."""
    rng = np.random.default_rng(4)
    noise = [0.05 * rng.standard_normal(N) for _ in range(2)]
    reference = wandering(rng, N, 60)
    records = [RecordData(reference, reference, 0.01) for _ in noise]
    judgement = judge_residual(
        records, noise, [reference] * 2, rng, search_steps.USUAL, in_loop=True
    )
    assert judgement.repeated
    assert not judgement.structured
    assert judgement.floor == pytest.approx(0.05, rel=0.05)


@pytest.fixture(scope="module")
def fitted():
    X, y = recording(5, n=400)
    X.columns, y.name = ["voltage", "setpoint"], "um"
    return search("setpoint", effects=["offset"]).fit(X, y), X, y


def test_neither_the_estimator_nor_predictions_need_the_reference(fitted):
    found, X, y = fitted
    assert found.n_features_in_ == 2
    assert list(found.best_estimator_.feature_names_in_) == ["voltage"]
    other = X.assign(setpoint=np.arange(len(X)))
    np.testing.assert_array_equal(found.predict(other), found.predict(X))
    np.testing.assert_array_equal(found.predict(X), found.best_estimator_.predict(X[["voltage"]]))
    assert found.held_out_error(other, y) == found.held_out_error(X, y)
    with pytest.raises(ValueError, match="setpoint"):
        found.predict(X[["voltage"]])


def test_a_position_is_a_name_and_arrays_are_frames(fitted):
    found, X, y = fitted
    for position in (1, -1):
        assert clone(found).set_params(reference=position).fit(X, y).reference_share_ == (
            found.reference_share_
        )
    X, y = X.loc[0].to_numpy(), y.loc[0].to_numpy()
    assert len(search(effects=["offset"]).fit(X, y).predict(X)) == len(y)


def test_a_reference_is_no_auxiliary_input(fitted):
    _, X, y = fitted
    more = X.assign(load=np.random.default_rng(6).standard_normal(len(X)))
    y = y + 0.5 * more["load"]
    found = search("setpoint", effects=["auxiliary_input"]).fit(more, y)
    assert found.effects_ == ["auxiliary_input"]
    assert "load" in found.evidence_["auxiliary_input"].statement
    found = search("load", effects=["auxiliary_input"])
    with pytest.raises(ValueError, match=r"predicts .* of the drive"):
        found.fit(more, y)


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("magic", "'reference' parameter of EffectSearchCV must be .*'magic' instead"),
        (7, "'reference' parameter of EffectSearchCV must be .* Got 7 instead"),
        (1.5, "'reference' parameter of EffectSearchCV"),
        (0, "another column than the drive"),
        ("copy", "another column than the drive"),
        ("constant", "which is constant"),
        ("chance", r"which predicts .* % of the drive \(p = "),
        ("hole", "NaN"),
    ],
)
def test_wrong_references_are_refused(fitted, reference, message):
    _, X, y = fitted
    X = X.copy()
    if reference == "copy":
        X["copy"] = X["voltage"]
    elif reference == "constant":
        X["constant"] = 1.0
    elif reference == "chance":
        X["chance"] = np.random.default_rng(7).standard_normal(len(X))
    elif reference == "hole":
        X["hole"] = X["setpoint"].where(np.arange(len(X)) != 17)
    with pytest.raises(ValueError, match=message):
        search(reference).fit(X, y)


def test_the_command_line_takes_a_reference(fitted, tmp_path, capsys):
    _, X, y = fitted
    table = pd.concat([X, y], axis=1).reset_index()
    table.to_csv(tmp_path / "loop.csv", index=False)
    call = [tmp_path / "loop.csv", "--drive", "voltage", "--response", "um", "--time", "time"]
    call += ["--record", "record", "--model", "gain", "--effects", "offset", "--jobs", 1]
    call += ["--quiet", "--json", tmp_path / "found.json"]
    assert main(["diagnose", *map(str, call), "--reference", "setpoint"]) == 0
    result = json.loads((tmp_path / "found.json").read_text())
    share = result["data"]["reference"]["share"]
    assert result["data"]["reference"]["name"] == "setpoint"
    told = re.search(r"setpoint\. It predicts (\S+) % of the drive", capsys.readouterr().out)
    assert float(told[1]) == pytest.approx(100.0 * share, rel=0.05)
    assert main(["diagnose", *map(str, call), "--reference", "voltage"]) == 1


def noisily_driven(seed, lag=0.0):
    """Return three records whose drive is read with 1 % of noise, which the device has not seen."""
    rng, records = np.random.default_rng(seed), []
    for _ in range(3):
        drive = gaussian_filter1d(wandering(rng, N, 30), 8.0)
        pole = np.exp(-1.0 / lag) if lag else 0.0
        y = lfilter([1.0 - pole], [1.0, -pole], drive, zi=[pole * drive[0]])[0]
        read = drive + 0.01 * np.ptp(drive) * rng.standard_normal(N)
        records.append((read[:, None], y + 1e-3 * rng.standard_normal(N)))
    return stack_records(records, dt=0.01)


WITHOUT = {"effects": ["lag", "timing", "backlash"], "reference": None}


@pytest.mark.slow
def test_what_only_smooths_a_noisy_drive_is_no_effect():
    found = search(**WITHOUT).fit(*noisily_driven(1))
    assert "noisy_drive" in set(found.data_quality_["fault"])
    assert found.effects_ == []
    assert found.verdict_ == "noise"
    assert "noise that does not act on the device" in found.report().to_markdown()


@pytest.mark.slow
def test_a_lag_behind_a_noisy_drive_is_found():
    assert search(**WITHOUT).fit(*noisily_driven(1, lag=12.0)).effects_[0] == "lag"
