"""The search on plants that are integrated independently, and on a measured recording."""

import os
import pickle
import subprocess
import sys
import warnings
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
import plants
import pytest
from plants import make_recording
from sklearn.base import clone
from sklearn.preprocessing import StandardScaler

from skhyst.base import ParametricModel
from skhyst.compose import Cascade
from skhyst.diagnosis import (
    Effect,
    EffectSearchCV,
    effect_names,
    register_effect,
    unregister_effect,
)
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import TransferFunction
from skhyst.operators import StaticOperator, parameter
from skhyst.records import read_records, stack_records

EFFECTS = plants.EFFECTS[:11]  # those that are a stage of their own, or beside the model
SEED = 9000
DECLARED = ("prandtl_ishlinskii", "cascade")
PIEZO = Path(__file__).parents[2] / "../shared/data/piezo_afm/SG_data_triangle_sin_raw.mat"


def declared_model(name):
    if name == "prandtl_ishlinskii":
        return PrandtlIshlinskii()
    return Cascade([("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(2))])


def search_of(declared="prandtl_ishlinskii", **options):
    return EffectSearchCV(declared_model(declared), **{"random_state": 0} | options)


@pytest.fixture(scope="session")
def found(tmp_path_factory):
    """Give a recording and the search of it over all effects, each made once by all workers."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    known = {}

    def of(effect, declared):
        path = shared / f"{effect}-{declared}.joblib"
        if (effect, declared) not in known:
            if not path.exists():
                part = path.with_suffix(f".{os.getpid()}")
                joblib.dump(_searched(effect, declared), part)
                part.replace(path)
            known[effect, declared] = joblib.load(path)
        return known[effect, declared]

    return of


def _searched(effect, declared):
    recording = make_recording(effect, declared, SEED, n_samples=5000)
    # a cascade costs more: it is asked for the first name only
    search = search_of(declared, max_effects=1 if declared == "cascade" else 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        search.fit(recording.X_train, recording.y_train)
    return recording, search


# --------------------------------------------------------------------------------- what it names


@pytest.mark.parametrize(
    ("effect", "declared"),
    [(effect, "prandtl_ishlinskii") for effect in EFFECTS]
    + [(effect, "cascade") for effect in ("lag", "delay", "output_saturation", "drift")],
)
def test_the_missing_effect_is_named(effect, declared, found):
    recording, search = found(effect, declared)
    assert search.effects_[:1] == [effect]
    limit = 1.25 if effect == "delay" else 1.10
    if declared == "cascade":
        limit = 1.35  # so few samples do not determine all parameters of the declared model
    error = search.held_out_error(recording.X_test, recording.y_test)
    assert error < limit * recording.noise_std
    assert error < 0.5 * search.held_out_error(recording.X_test, recording.y_test, declared=True)


@pytest.mark.parametrize("effect", EFFECTS)
def test_what_is_left_is_noise_and_nothing_else_is_claimed(effect, found):
    recording, search = found(effect, "prandtl_ishlinskii")
    assert search.effects_ == [effect]
    assert search.verdict_ == "noise"
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.1)


@pytest.mark.parametrize("declared", DECLARED)
def test_nothing_is_claimed_where_nothing_is_missing(declared, found):
    recording, search = found("none", declared)
    assert search.effects_ == []
    assert search.verdict_ == "noise"
    assert search.error_after_ == search.error_before_
    assert len(search.history_) == 0
    assert search.evidence_ == {}
    assert not search.ranking_["claimed"].any()
    np.testing.assert_array_equal(search.residual_after_, search.residual_before_)
    np.testing.assert_allclose(
        search.predict(recording.X_test),
        search.declared_estimator_.predict(recording.X_test),
        atol=1e-9 * np.ptp(recording.y_train),
    )


def rate(u):
    return np.gradient(u) / np.gradient(u).std()


@pytest.mark.parametrize(
    "law",
    [
        lambda u, y: 0.04 * np.tanh(rate(u)) * y,
        lambda u, y: 0.03 * np.sign(rate(u)) * np.sin(12.0 * u),
        lambda u, y: 0.03 * np.sin(25.0 * u),
    ],
    ids=["rate times response", "ripple of either branch", "ripple of the drive"],
)
def test_structure_of_no_known_effect_is_called_unexplained(law):
    recording = make_recording("none", "prandtl_ishlinskii", SEED, n_samples=4000)
    drive, clean = recording.X_train["drive"], recording.y_train_clean
    u, y = drive / np.abs(drive).max(), clean / np.abs(clean).max()
    extra = [law(u.loc[[k]].to_numpy(), y.loc[[k]].to_numpy()) for k in range(5)]
    response = recording.y_train + np.abs(clean).max() * np.concatenate(extra)
    search = search_of().fit(recording.X_train, response)
    assert search.effects_ == []
    assert search.verdict_ == "unexplained"
    assert recording.noise_std < search.noise_floor_ < search.error_after_


# ---------------------------------------------------------------------- what it says about itself


@pytest.mark.parametrize("effect", ["lag", "offset", "none"])
def test_the_attributes_agree_with_each_other(effect, found):
    recording, search = found(effect, "prandtl_ishlinskii")
    y = recording.y_train.to_numpy()
    np.testing.assert_array_equal(search.response_, y)
    np.testing.assert_array_equal(search.drive_, recording.X_train["drive"])
    assert [record.label for record in search.records_] == list(range(5))
    for stage, error in (("before", search.error_before_), ("after", search.error_after_)):
        residual = getattr(search, f"residual_{stage}_")
        np.testing.assert_array_equal(residual, y - getattr(search, f"prediction_{stage}_"))
        assert error == pytest.approx(np.sqrt(np.mean(residual**2)), rel=1e-9)
    history, ranking = search.history_, search.ranking_
    assert list(history["effect"]) == search.effects_ == list(search.evidence_)
    assert list(ranking.loc[ranking["claimed"], "effect"]) == search.effects_
    if len(history):
        assert history["error_before"].iloc[0] == search.error_before_
        assert history["error_after"].iloc[-1] == search.error_after_
        assert (history["p_value"] < search.alpha).all()
        assert (history["error_after"] < 0.98 * history["error_before"]).all()
    first = ranking[ranking["round"] == 1]
    assert set(first["effect"]) == set(effect_names())
    assert ranking["screen"].between(0.0, 1.0).all()
    contested = ranking["p_value"].notna()
    assert (contested == ranking["error_after"].notna()).all()
    assert ranking.loc[contested, "p_value"].between(0.0, 1.0).all()
    assert (ranking["n_parameters"] >= 0).all()
    assert all(seconds >= 0.0 for seconds in search.seconds_.values())
    assert search.n_features_in_ == 1
    assert list(search.feature_names_in_) == ["drive"]


def test_ambiguous_effects_come_with_an_experiment(found):
    rows = [
        row
        for effect in ("lag", "output_saturation", "drift")
        for row in found(effect, "prandtl_ishlinskii")[1].history_.itertuples()
    ]
    assert any(row.ambiguous_with for row in rows)
    for row in rows:
        assert row.effect not in row.ambiguous_with
        assert set(row.ambiguous_with) <= set(effect_names())
        assert bool(row.experiment) == bool(row.ambiguous_with)


def test_the_best_model_is_a_model_like_any_other(found):
    recording, search = found("lag", "prandtl_ishlinskii")
    model = search.best_estimator_
    assert isinstance(model, Cascade)
    assert [name for name, _ in model.steps] == ["prandtl_ishlinskii", "lag"]
    free_run = model.predict(recording.X_test)
    np.testing.assert_array_equal(free_run, search.predict(recording.X_test))
    assert np.std(free_run - recording.y_test) < 1.1 * recording.noise_std
    assert set(model.params_) == set(model.params_std_)
    again = clone(model).fit(recording.X_train, recording.y_train)
    np.testing.assert_allclose(again.predict(recording.X_test), free_run, atol=recording.noise_std)
    assert search.score(recording.X_test, recording.y_test) > 0.999


def test_held_out_error_is_that_of_the_free_run(found):
    recording, search = found("lag", "prandtl_ishlinskii")
    X, y = recording.X_test, recording.y_test
    for model, declared in ((search.declared_estimator_, True), (search.best_estimator_, False)):
        expected = np.sqrt(np.mean((y - model.predict(X)) ** 2))
        assert search.held_out_error(X, y, declared=declared) == pytest.approx(expected, rel=2e-3)


def test_held_out_error_of_one_sample_does_not_use_that_sample(found):
    """A record's own constants are taken from other stretches of it."""
    recording, search = found("offset", "prandtl_ishlinskii")
    X, y = recording.X_test, recording.y_test.copy()
    error = search.held_out_error(X, y)
    assert error < 1.1 * recording.noise_std
    assert np.sqrt(np.mean((y - search.predict(X)) ** 2)) > 3.0 * error  # constants of its own
    jump = 1e3 * recording.noise_std
    y.iloc[100] += jump
    without_help = np.sqrt(error**2 + jump**2 / len(y))
    assert search.held_out_error(X, y) > 0.95 * without_help


# -------------------------------------------------------------------------------------- symmetries

FEW = ["lag", "delay", "offset", "output_saturation"]
SMALL = {"lag": 2500, "output_saturation": 2500}


def small(effect):
    return make_recording(effect, "prandtl_ishlinskii", SEED, n_samples=SMALL[effect])


def few(**options):
    return search_of(**{"effects": FEW} | options)


@pytest.mark.parametrize("effect", SMALL)
def test_units_change_nothing(effect):
    recording = small(effect)
    plain = few().fit(recording.X_train, recording.y_train)
    X = recording.X_train * 1e3
    X.index = X.index.set_levels(X.index.levels[1] * 1e-3, level="time")
    y = pd.Series(recording.y_train.to_numpy() * 1e-6, X.index)
    other = few().fit(X, y)
    assert other.effects_ == plain.effects_
    assert other.effects_[:1] == [effect]
    assert other.verdict_ == plain.verdict_
    for name in ("error_before_", "error_after_", "noise_floor_"):
        assert getattr(other, name) * 1e6 == pytest.approx(getattr(plain, name), rel=1e-6)
    np.testing.assert_allclose(other.ranking_["screen"], plain.ranking_["screen"], atol=1e-6)
    np.testing.assert_allclose(other.ranking_["p_value"], plain.ranking_["p_value"], rtol=1e-4)


def test_same_seed_same_result():
    recording = small("lag")
    first, again = (few().fit(recording.X_train, recording.y_train) for _ in range(2))
    pd.testing.assert_frame_equal(first.ranking_, again.ranking_)
    assert first.noise_floor_ == again.noise_floor_
    np.testing.assert_array_equal(first.residual_after_, again.residual_after_)


def test_number_of_threads_changes_nothing():
    recording = small("lag")
    one = few(n_jobs=1).fit(recording.X_train, recording.y_train)
    two = few(n_jobs=2).fit(recording.X_train, recording.y_train)
    pd.testing.assert_frame_equal(one.ranking_, two.ranking_)


def test_order_of_the_records_changes_no_name():
    recording = small("lag")
    plain = few().fit(recording.X_train, recording.y_train)
    order = [3, 0, 4, 2, 1]
    X = pd.concat([recording.X_train.loc[[label]] for label in order])
    y = pd.concat([recording.y_train.loc[[label]] for label in order])
    other = few().fit(X, y)
    assert other.effects_ == plain.effects_ == ["lag"]
    assert other.verdict_ == plain.verdict_
    assert other.error_after_ == pytest.approx(plain.error_after_, rel=1e-3)


def test_data_are_left_as_they_were():
    recording = small("lag")
    X, y = recording.X_train.copy(), recording.y_train.copy()
    few(effects=["offset", "lag"]).fit(X, y)
    pd.testing.assert_frame_equal(X, recording.X_train)
    pd.testing.assert_series_equal(y, recording.y_train)


def test_a_shift_of_the_response_is_the_declared_models_intercept():
    recording = small("lag")
    plain = few().fit(recording.X_train, recording.y_train)
    shift = 3.0 * np.ptp(recording.y_train)
    other = few().fit(recording.X_train, recording.y_train + shift)
    assert other.effects_ == plain.effects_
    assert other.error_after_ == pytest.approx(plain.error_after_, rel=1e-3)


# ------------------------------------------------------------------------------------- one record


def one_record(effect="lag", n_samples=12500):
    """Return the first record alone: arrays of the drive and the response, and the interval."""
    recording = make_recording(effect, "prandtl_ishlinskii", SEED, n_samples=n_samples)
    X, y = recording.X_train.loc[0], recording.y_train.loc[0]
    return X.to_numpy(), y.to_numpy(), recording


def test_one_record_is_cut_into_blocks_that_are_washed_out():
    X, y, recording = one_record()
    model = PrandtlIshlinskii(dt=recording.sampling_interval)
    search = EffectSearchCV(model, effects=FEW, cv=4, washout=23, random_state=0).fit(X, y)
    assert search.effects_ == ["lag"]
    edges = np.linspace(0, len(y), 5).astype(int)
    washed = np.zeros(len(y), dtype=bool)
    for edge in edges[:-1]:
        washed[edge : edge + 23] = True
    for stage in ("before", "after"):
        residual = getattr(search, f"residual_{stage}_")
        prediction = getattr(search, f"prediction_{stage}_")
        np.testing.assert_array_equal(np.isnan(residual), washed)
        np.testing.assert_array_equal(residual, y - prediction)
        error = np.sqrt(np.nanmean(residual**2))
        assert getattr(search, f"error_{stage}_") == pytest.approx(error, rel=1e-9)
    assert search.error_after_ < 1.3 * recording.noise_std  # blocks of 600 samples


def test_a_washout_of_nothing_scores_everything():
    X, y, _ = one_record()
    search = EffectSearchCV(PrandtlIshlinskii(), effects=["offset"], washout=0).fit(X, y)
    assert np.isfinite(search.residual_before_).all()


def test_arrays_with_an_interval_are_frames_with_a_time_index():
    X, y, recording = one_record()
    dt = recording.sampling_interval
    array = EffectSearchCV(PrandtlIshlinskii(dt=dt), effects=FEW, random_state=0).fit(X, y)
    index = pd.Index(dt * np.arange(len(y)), name="time")
    frame = EffectSearchCV(PrandtlIshlinskii(), effects=FEW, random_state=0).fit(
        pd.DataFrame(X, index=index), pd.Series(y, index)
    )
    assert array.effects_ == frame.effects_ == ["lag"]
    assert array.records_[0].dt == pytest.approx(frame.records_[0].dt)
    assert array.error_after_ == pytest.approx(frame.error_after_, rel=1e-6)
    tau = recording.truth["parameters"]["tau"]
    value, std, unit = array.evidence_["lag"].numbers["time constant"]
    assert abs(value - tau) < max(5.0 * std, 0.01 * tau)
    assert unit == "s"


def test_repeated_periods_give_the_noise_floor():
    rng = np.random.default_rng(SEED)
    t = np.arange(4000)
    drive = np.sin(2.0 * np.pi * t / 400) + 0.4 * np.sin(2.0 * np.pi * 3 * t / 400 + 1.0)
    y = np.clip(drive, -1.0, 0.9) + 0.01 * rng.standard_normal(4000)
    search = search_of(effects=["output_saturation"]).fit(drive.reshape(-1, 1), y)
    assert search.effects_ == ["output_saturation"]
    assert search.noise_floor_ == pytest.approx(0.01, rel=0.05)


def test_repeated_records_give_the_noise_floor():
    recording = small("lag")
    X, y = recording.X_train.loc[[0, 1, 2]], recording.y_train_clean.loc[[0, 1, 2]]
    rng = np.random.default_rng(SEED)
    records = [
        (X.loc[k, "drive"], y.loc[k] + recording.noise_std * rng.standard_normal(len(y.loc[k])))
        for k in (0, 1, 2, 0, 1, 2)
    ]
    X, y = stack_records(
        [(u.to_numpy(), v.to_numpy()) for u, v in records], dt=recording.sampling_interval
    )
    search = few(effects=["lag"]).fit(X, y)
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.06)


def test_data_without_noise_end_the_search():
    recording = make_recording("lag", "prandtl_ishlinskii", SEED, n_samples=2500, noise=0.0)
    search = few().fit(recording.X_train, recording.y_train)
    assert search.effects_[0] == "lag"
    assert search.error_after_ < 0.05 * search.error_before_


# -------------------------------------------------------------------------- parameters and refusals


def test_budget_of_effects():
    recording = small("output_saturation")
    none = few(max_effects=0).fit(recording.X_train, recording.y_train)
    assert none.effects_ == []
    assert len(none.ranking_) == 0
    assert none.error_after_ == none.error_before_
    one = few(max_effects=1).fit(recording.X_train, recording.y_train)
    assert one.effects_ == ["output_saturation"]
    assert set(one.ranking_["round"]) == {1}
    assert set(one.ranking_["effect"]) == set(FEW)


def test_two_missing_effects_are_both_found():
    recording = small("lag")
    y = recording.y_train.copy()
    offsets = 0.03 * np.ptp(y) * np.array([1.0, -1.0, 0.5, -0.4, 0.8])
    y += offsets[y.index.get_level_values("record")]
    search = few().fit(recording.X_train, y)
    assert sorted(search.effects_) == ["lag", "offset"]
    assert search.error_after_ < 1.1 * recording.noise_std
    assert (np.diff(search.history_["error_after"]) < 0.0).all()
    assert search.history_["error_before"].iloc[1] == search.history_["error_after"].iloc[0]


def test_one_name_is_a_list_of_one():
    recording = small("lag")
    assert few(effects="lag").fit(recording.X_train, recording.y_train).effects_ == ["lag"]


def test_an_improvement_of_no_practical_size_is_not_claimed():
    recording = small("lag")
    fitted = few(effects=["lag"]).fit(recording.X_train, recording.y_train)
    gain = 1.0 - fitted.error_after_ / fitted.error_before_
    modest = few(effects=["lag"], min_improvement=min(1.05 * gain, 0.999))
    assert modest.fit(recording.X_train, recording.y_train).effects_ == []


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"effects": ["magic", "lag"]}, ValueError, r"'effects' parameter.*asymmetry.*'magic'"),
        ({"effects": "magic"}, ValueError, r"'effects' parameter.*'magic' instead"),
        ({"estimator": StandardScaler()}, ValueError, r"'estimator' parameter of EffectSearchCV"),
        ({"estimator": 3}, ValueError, r"'estimator' parameter of EffectSearchCV"),
        ({"cv": 1}, ValueError, r"'cv' parameter of EffectSearchCV"),
        ({"folds": "rows"}, ValueError, r"'folds' parameter of EffectSearchCV"),
        ({"alpha": 0.0}, ValueError, r"'alpha' parameter of EffectSearchCV"),
        ({"max_effects": -1}, ValueError, r"'max_effects' parameter of EffectSearchCV"),
        ({"min_improvement": 1.0}, ValueError, r"'min_improvement' parameter of EffectSearchCV"),
        ({"washout": -1}, ValueError, r"'washout' parameter of EffectSearchCV"),
    ],
)
def test_wrong_parameters_are_refused_by_name(options, error, message):
    X, y = np.linspace(0.0, 1.0, 100).reshape(-1, 1), np.linspace(0.0, 1.0, 100)
    with pytest.raises(error, match=message):
        EffectSearchCV(**{"estimator": PrandtlIshlinskii(2)} | options).fit(X, y)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", ["X", "y"])
def test_readings_that_are_no_numbers_are_refused(value, which):
    X, y = np.sin(np.arange(200.0)).reshape(-1, 1), np.sin(np.arange(200.0))
    if which == "X":
        X[17] = value
    else:
        y[17] = value
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        few().fit(X, y)


def test_too_few_samples_are_refused_with_the_number_that_is_enough():
    X, y = np.arange(6.0).reshape(-1, 1), np.arange(6.0)
    with pytest.raises(ValueError, match=r"at least 10 samples for 5 folds. Got 6 instead"):
        EffectSearchCV(PrandtlIshlinskii(2), effects=["lag"]).fit(X, y)


def test_a_constant_drive_claims_nothing():
    rng = np.random.default_rng(SEED)
    y = 2.0 + 0.1 * rng.standard_normal(400)
    search = EffectSearchCV(PrandtlIshlinskii(2), effects=["lag", "offset"], random_state=0)
    search.fit(np.ones((400, 1)), y)
    assert search.effects_ == []
    assert search.error_before_ == pytest.approx(0.1, rel=0.15)


def test_an_unfitted_search_says_so():
    for method in ("predict", "report"):
        with pytest.raises(ValueError, match="not fitted"):
            getattr(few(), method)(*([np.zeros((3, 1))] if method == "predict" else []))


def test_progress_goes_to_the_standard_error_stream(capsys):
    recording = small("lag")
    few(verbose=1).fit(recording.X_train, recording.y_train)
    written = capsys.readouterr()
    assert written.out == ""
    assert "round 1: lag, held-out error" in written.err
    few().fit(recording.X_train, recording.y_train)
    assert capsys.readouterr().err == ""


# ------------------------------------------------------------------------------ scikit-learn's ways


def test_clone_has_the_same_parameters_and_no_results(found):
    _, search = found("lag", "prandtl_ishlinskii")
    copy = clone(search)
    assert copy.get_params().keys() == search.get_params().keys()
    assert not [name for name in vars(copy) if name.endswith("_")]
    assert copy.set_params(estimator__dt=0.5).estimator.dt == 0.5
    assert search.estimator.dt == 1.0


def test_the_declared_model_is_left_unfitted(found):
    _, search = found("lag", "prandtl_ishlinskii")
    assert not hasattr(search.estimator, "operator_")
    assert search.declared_estimator_ is not search.estimator


@pytest.mark.parametrize("effect", ["lag", "periodic_disturbance"])
def test_a_pickled_search_predicts_in_a_fresh_process(effect, tmp_path, found):
    recording, search = found(effect, "prandtl_ishlinskii")
    path = tmp_path / "search.pickle"
    path.write_bytes(pickle.dumps((search, recording.X_test)))
    code = (
        "import pickle, sys, numpy\n"
        "search, X = pickle.load(open(sys.argv[1], 'rb'))\n"
        "numpy.save(sys.argv[2], search.predict(X))\n"
        "print(search.effects_[0], search.verdict_)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), str(tmp_path / "prediction.npy")],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    assert done.stdout.split() == [effect, search.verdict_]
    np.testing.assert_array_equal(
        np.load(tmp_path / "prediction.npy"), search.predict(recording.X_test)
    )


# --------------------------------------------------------------------------- an effect of one's own


@dataclass(frozen=True)
class DeadBandOperator(StaticOperator):
    """No response within a level: ``y = u - clip(u, -level, level)``."""

    level: float = parameter(lower=0.0, unit="drive")
    rank = 0

    def _evaluate(self, v):
        inside = np.abs(v) < self.level
        y = np.where(inside, 0.0, v - np.sign(v) * self.level)
        own = np.where(inside, 0.0, -np.sign(v))[:, None]
        return y, (~inside).astype(float), own


class DeadBand(ParametricModel):
    _rank = DeadBandOperator.rank

    def __init__(self, *, initial_state="rest", dt=1.0):
        self.initial_state = initial_state
        self.dt = dt

    def _starts(self, records):
        largest = max(np.abs(record.u).max() for record in records)
        return [(DeadBandOperator(part * largest), ()) for part in (0.05, 0.15, 0.3)]


def test_a_users_own_effect_is_found():
    recording = make_recording("none", "prandtl_ishlinskii", SEED, n_samples=3000)
    u = recording.X_train["drive"].to_numpy()
    level = 0.2 * np.abs(u).max()
    X = recording.X_train.copy()
    # the plant's drive comes out of a dead band: undo it where it can be undone
    X["drive"] = u + np.sign(u) * level
    effect = Effect("dead_band", lambda: [DeadBand()], "No response around zero.", "Drive less.")
    register_effect(effect)
    try:
        search = few(effects="all", max_effects=1).fit(X, recording.y_train)
    finally:
        unregister_effect("dead_band")
    assert search.effects_ == ["dead_band"]
    value, std, _ = search.evidence_["dead_band"].numbers["level"]
    assert abs(value - level) < max(5.0 * std, 0.01 * level)
    assert search.error_after_ < 1.1 * recording.noise_std


# ---------------------------------------------------------------------------- a measured recording


@pytest.mark.skipif(not PIEZO.exists(), reason=f"{PIEZO.resolve()} is absent")
def test_measured_piezo_scanner_lacks_a_curve():
    X, y = read_records(PIEZO, drive="V", response="SG[0]", sampling_rate=1.0)
    n, span = int(0.6 * len(y)), np.ptp(y.to_numpy())
    search = search_of().fit(X[:n], y[:n])
    pair = {"asymmetry", "static_nonlinearity"}
    first = search.history_.iloc[0]
    assert first["effect"] in pair
    assert search.held_out_error(X[n:], y[n:], declared=True) >= 0.02 * span
    assert search.held_out_error(X[n:], y[n:]) <= 0.008 * span
    one = search_of(max_effects=1).fit(X[:n], y[:n])
    assert one.effects_ == search.effects_[:1]
    assert one.held_out_error(X[n:], y[n:]) <= 0.009 * span


def test_blocks_of_records_that_foretell_nothing_of_each_other():
    rng = np.random.default_rng(SEED)
    found = []
    for level in (1.0, 3.0):
        u = level * np.sin(np.linspace(0.0, 40.0, 600))
        found.append((u, u + 0.05 * u**2 + 0.005 * rng.standard_normal(600)))
    X, y = stack_records(found, dt=0.01)
    options = {"effects": ["static_nonlinearity", "lag", "drift"], "random_state": 0}
    search = EffectSearchCV(PrandtlIshlinskii(3), folds="blocks", **options).fit(X, y)
    assert search.effects_ == ["static_nonlinearity"]
    assert search.error_after_ < 0.006
    scored = np.isfinite(search.residual_after_)
    assert scored.all()  # each sample is held out once


def test_a_later_claim_shows_that_an_earlier_one_was_simpler():
    recording = make_recording(("offset", "creep"), "prandtl_ishlinskii", 200416, n_samples=3000)
    search = search_of(effects=["offset", "drift", "creep", "output_saturation"])
    search.fit(recording.X_train, recording.y_train)
    assert sorted(search.effects_) == ["creep", "offset"]
    error = search.held_out_error(recording.X_test, recording.y_test)
    assert error < 1.10 * recording.noise_std
