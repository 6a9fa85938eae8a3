"""The search on plants that are integrated independently, and on a measured recording."""

import os
import pickle
import subprocess
import sys
import warnings
from dataclasses import dataclass

import joblib
import numpy as np
import pytest
from plants import make_recording
from recordings import load_piezo_afm
from sklearn.base import clone

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
from skhyst.linear import Gain, TransferFunction
from skhyst.model_selection import RecordKFold, segment_folds
from skhyst.operators import parameter
from skhyst.records import stack_records
from skhyst.static import SaturationOperator, SmoothCurve, StaticOperator

SEED = 9000
DECLARED = ("prandtl_ishlinskii", "cascade")
# the nearest rivals; nothing, and the demonstration, have all effects
RIVALS = {
    "lag": ["delay", "resonance", "creep"],
    "offset": ["creep", "drift", "output_saturation"],
}


def slow(*cases):
    """Return cases as slow ones: a search takes seconds."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


def declared_model(name):
    if name == "prandtl_ishlinskii":
        return PrandtlIshlinskii()
    return Cascade([("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(2))])


def search_of(declared="prandtl_ishlinskii", **options):
    return EffectSearchCV(declared_model(declared), **{"random_state": 0} | options)


@pytest.fixture(scope="session")
def found(tmp_path_factory):
    """Give a recording and the search of it, each made once by all workers."""
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
    names = [effect, *RIVALS[effect]] if effect in RIVALS else "all"
    options = {"effects": names, "max_effects": 3}
    if declared == "cascade":  # which costs more: it is asked for the first name only
        options["max_effects"] = 1
        if effect != "none":
            options["effects"] = ["lag", "output_saturation", "delay"]
    search = search_of(declared, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        search.fit(recording.X_train, recording.y_train)
    return recording, search


# --------------------------------------------------------------------------------- what it names


def assert_explained(search, recording, limit):
    """Check that held out about the noise is left, and the declared model leaves far more."""
    error = search.held_out_error(recording.X_test, recording.y_test)
    assert error < limit * recording.noise_std
    assert error < 0.5 * search.held_out_error(recording.X_test, recording.y_test, declared=True)


@pytest.mark.parametrize("effect", ["lag", *slow("offset")])
def test_the_missing_effect_is_named_and_nothing_else_is_claimed(effect, found):
    """As declared by default; see test_evidence.py for each effect where the plays are known."""
    recording, search = found(effect, "prandtl_ishlinskii")
    assert search.effects_ == [effect]
    assert_explained(search, recording, 1.10)
    assert search.verdict_ == "noise"
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.1)


@pytest.mark.slow
def test_the_first_name_is_right_where_a_cascade_is_declared(found):
    recording, search = found("lag", "cascade")
    assert search.effects_[:1] == ["lag"]
    # so few samples do not determine all parameters of a declared cascade
    assert_explained(search, recording, 1.35)


@pytest.mark.parametrize("declared", slow(*DECLARED))
def test_nothing_is_claimed_where_nothing_is_missing(declared, found):
    recording, search = found("none", declared)
    assert search.effects_ == []
    assert search.verdict_ == "noise"
    assert len(search.history_) == 0
    assert search.evidence_ == {}
    assert not search.ranking_["claimed"].any()
    # as many plays as the data ask for are no effect, but the model that is predicted with
    assert search.resolution_
    assert search.error_after_ < search.error_before_
    left = recording.y_test - search.best_estimator_.predict(recording.X_test)
    error = np.sqrt(np.mean(np.square(left)))
    assert error == pytest.approx(
        search.held_out_error(recording.X_test, recording.y_test), rel=1e-3
    )
    assert error < 1.05 * recording.noise_std


def rate(u):
    return np.gradient(u) / np.gradient(u).std()


@pytest.mark.slow
@pytest.mark.parametrize(
    "law",
    [
        lambda u, y: 0.04 * np.tanh(rate(u)) * y,
        lambda u, y: 0.03 * np.sin(25.0 * u),
    ],
    ids=["rate times response", "ripple of the drive"],
)
def test_structure_of_no_known_effect_is_called_unexplained(law):
    recording = make_recording("none", "prandtl_ishlinskii", SEED, n_samples=3000)
    drive, clean = recording.X_train["drive"], recording.y_train_clean
    u, y = drive / np.abs(drive).max(), clean / np.abs(clean).max()
    extra = [law(u.loc[[k]].to_numpy(), y.loc[[k]].to_numpy()) for k in range(5)]
    response = recording.y_train + np.abs(clean).max() * np.concatenate(extra)
    search = search_of().fit(recording.X_train, response)
    assert search.effects_ == []
    assert search.verdict_ == "unexplained"
    assert search.noise_floor_ <= 1.02 * recording.noise_std
    assert recording.noise_std < search.noise_ceiling_ < search.error_after_


# ---------------------------------------------------------------------- what it says about itself


def test_candidates_are_told_as_a_grid_search_tells_them(found):
    recording, search = found("lag", "prandtl_ishlinskii")
    results, ranking = search.cv_results_, search.ranking_
    assert [(own["round"], own["effect"]) for own in results["params"]] == list(
        zip(ranking["round"], ranking["effect"], strict=True)
    )
    names = [name for name in results if name.startswith("split")]
    X, y = recording.X_train, recording.y_train
    segments, folds = segment_folds(search.records_, search.cv, X, y)
    lengths = np.array([stop - start for own in segments for start, stop in own])
    sizes = [lengths[test].sum() for _, test in folds]
    squares = np.square([results[name] for name in names])
    errors = np.sqrt(np.average(squares, axis=0, weights=sizes))
    np.testing.assert_allclose(errors, ranking["error_after"])
    assert results["rank_test_score"][np.nanargmax(results["mean_test_score"])] == 1


def test_what_the_records_do_not_determine_is_no_verdict():
    """A curve of high degree follows each record, and predicts none that goes further."""
    rng = np.random.default_rng(0)
    drives = [np.sort(rng.uniform(low, low + 1.0, 400)) for low in (-4.0, 0.0, 4.0)]
    records = [(u, np.tanh(u) + 0.01 * rng.normal(size=400)) for u in drives]
    curve = Cascade([("gain", Gain()), ("curve", SmoothCurve(7))])
    found = {
        name: EffectSearchCV(curve, max_effects=0, cv=cv, random_state=0).fit(
            *stack_records(records, dt=0.1)
        )
        for name, cv in (("levels", RecordKFold(3)), ("blocks", 4))
    }
    assert {name: search.verdict_ for name, search in found.items()} == {
        "levels": "undetermined",
        "blocks": "noise",
    }
    for search in found.values():
        assert search.noise_floor_ == pytest.approx(0.01, rel=0.05)
    report = found["levels"].report()
    assert report.headline == "Undetermined"
    assert any("Record longer" in step for step in report.next_steps)


@pytest.mark.parametrize("effect", ["lag", *slow("offset", "none")])
def test_the_attributes_agree_with_each_other(effect, found):
    recording, search = found(effect, "prandtl_ishlinskii")
    y = recording.y_train.to_numpy()
    np.testing.assert_array_equal(search.response_, y)
    np.testing.assert_array_equal(search.drive_, recording.X_train["drive"])
    assert [record.label for record in search.records_] == list(range(5))
    for stage, error in (("before", search.error_before_), ("after", search.error_after_)):
        residual = getattr(search, f"residual_{stage}_")
        np.testing.assert_array_equal(residual, y - getattr(search, f"prediction_{stage}_"))
        mean = np.average(residual**2, weights=search.weights_)
        assert error == pytest.approx(np.sqrt(mean), rel=1e-9)
    history, ranking = search.history_, search.ranking_
    assert list(history["effect"]) == search.effects_ == list(search.evidence_)
    assert sorted(ranking.loc[ranking["claimed"], "effect"]) == sorted(search.effects_)
    if len(history):
        assert list(history["error_before"][1:]) == list(history["error_after"][:-1])
        assert (history["p_value"] < search.alpha).all()
        assert (history["error_after"] < 0.98 * history["error_before"]).all()
    first = ranking[ranking["round"] == 1]
    alone = {"offset", "drift", "periodic_disturbance"}  # functions of time, which come last
    tried = set(effect_names() if search.effects == "all" else search.effects)
    assert set(first["effect"]) | (alone & tried) == tried
    assert ranking["screen"].between(0.0, 1.0).all()
    contested = ranking["p_value"].notna()
    assert (contested == ranking["error_after"].notna()).all()
    assert ranking.loc[contested, "p_value"].between(0.0, 1.0).all()
    assert (ranking["n_parameters"] >= 0).all()
    assert all(seconds >= 0.0 for seconds in search.seconds_.values())
    assert search.n_features_in_ == 1
    assert list(search.feature_names_in_) == ["drive"]


@pytest.mark.slow
def test_ambiguous_effects_come_with_an_experiment(found):
    rows = [
        row
        for effect in ("lag", "offset")
        for row in found(effect, "prandtl_ishlinskii")[1].history_.itertuples()
    ]
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


@pytest.mark.slow
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


# ------------------------------------------------------------------------------ scikit-learn's ways


def test_clone_has_the_same_parameters_and_no_results(found):
    _, search = found("lag", "prandtl_ishlinskii")
    copy = clone(search)
    assert copy.get_params().keys() == search.get_params().keys()
    assert not [name for name in vars(copy) if name.endswith("_")]
    assert copy.set_params(estimator__dt=0.5).estimator.dt == 0.5
    assert search.estimator.dt is None


def test_the_declared_model_is_left_unfitted(found):
    _, search = found("lag", "prandtl_ishlinskii")
    assert not hasattr(search.estimator, "operator_")
    assert search.declared_estimator_ is not search.estimator


@pytest.mark.slow
def test_pickled_searches_predict_in_a_fresh_process(tmp_path, found):
    effects = "lag", "offset"
    recordings, searches = zip(*(found(e, "prandtl_ishlinskii") for e in effects), strict=True)
    path, rows = tmp_path / "searches.pickle", [recording.X_test for recording in recordings]
    path.write_bytes(pickle.dumps(list(zip(searches, rows, strict=True))))
    code = (
        "import pickle, sys, numpy\n"
        "pairs = pickle.load(open(sys.argv[1], 'rb'))\n"
        "numpy.savez(sys.argv[2], *(search.predict(X) for search, X in pairs))\n"
        "for search, _ in pairs:\n"
        "    print(search.effects_[0], search.verdict_)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path), str(tmp_path / "predictions.npz")],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
    )
    told = [f"{effect} {s.verdict_}" for effect, s in zip(effects, searches, strict=True)]
    assert done.stdout.splitlines() == told
    with np.load(tmp_path / "predictions.npz") as predictions:
        for name, search, X in zip(predictions.files, searches, rows, strict=True):
            np.testing.assert_array_equal(predictions[name], search.predict(X))


# --------------------------------------------------------------------------- an effect of one's own


@dataclass(frozen=True)
class DeadBandOperator(StaticOperator):
    """No response within a level: ``y = u - clip(u, -level, level)``."""

    level: float = parameter(lower=0.0, unit="drive")
    stage_order = 0

    def evaluate(self, v):
        inside = np.abs(v) < self.level
        y = np.where(inside, 0.0, v - np.sign(v) * self.level)
        own = np.where(inside, 0.0, -np.sign(v))[:, None]
        return y, (~inside).astype(float), own


class DeadBand(ParametricModel):
    stage_order = DeadBandOperator.stage_order

    def __init__(self, *, initial_state="rest", dt=1.0):
        self.initial_state = initial_state
        self.dt = dt

    def starting_values(self, records):
        largest = max(np.abs(record.u).max() for record in records)
        return [(DeadBandOperator(part * largest), ()) for part in (0.05, 0.15, 0.3)]


@pytest.mark.slow
def test_evidence_that_fails_costs_the_evidence_alone(monkeypatch):
    def fail(*_):
        raise ZeroDivisionError("nothing to divide by")

    monkeypatch.setattr(SaturationOperator, "characteristics", fail, raising=False)
    drive = np.cumsum(np.random.default_rng(0).normal(size=1500)) / 20.0
    y = np.minimum(drive, np.quantile(drive, 0.8))
    y += 0.005 * np.random.default_rng(1).normal(size=1500)
    search = EffectSearchCV(PrandtlIshlinskii(5), effects=["output_saturation"], random_state=0)
    with pytest.warns(RuntimeWarning, match="The numbers of output_saturation could not be made"):
        search.fit(drive.reshape(-1, 1), y)
    assert search.effects_ == ["output_saturation"]
    assert search.evidence_["output_saturation"].numbers == {}
    assert "output_saturation" in search.report().to_html()


@pytest.mark.slow
def test_a_users_own_effect_is_found():
    recording = make_recording("none", "prandtl_ishlinskii", SEED, n_samples=3000)
    others = ["backlash", "input_saturation", "lag", "offset", "static_nonlinearity"]
    u = recording.X_train["drive"].to_numpy()
    level = 0.2 * np.abs(u).max()
    X = recording.X_train.copy()
    # the plant's drive comes out of a dead band: undo it where it can be undone
    X["drive"] = u + np.sign(u) * level
    effect = Effect("dead_band", lambda: [DeadBand()], "No response around zero.", "Drive less.")
    register_effect(effect)
    try:
        search = search_of(effects=[*others, "dead_band"], max_effects=1)
        search.fit(X, recording.y_train)
    finally:
        unregister_effect("dead_band")
    assert search.effects_ == ["dead_band"]
    value, std, _ = search.evidence_["dead_band"].numbers["level"]
    assert abs(value - level) < max(5.0 * std, 0.01 * level)
    assert search.error_after_ < 1.1 * recording.noise_std


# ---------------------------------------------------------------------------- a measured recording


@pytest.mark.slow
@pytest.mark.needs_recordings("piezo_afm")
def test_measured_piezo_scanner_lacks_a_curve():
    X, y, X_test, y_test = (signal[::4] for signal in load_piezo_afm())
    span = np.ptp(np.concatenate([y, y_test]))
    search = search_of().fit(X, y)
    pair = {"asymmetry", "static_nonlinearity"}
    first = search.history_.iloc[0]
    assert first["effect"] in pair
    assert search.held_out_error(X_test, y_test, declared=True) >= 0.02 * span
    assert search.held_out_error(X_test, y_test) <= 0.008 * span
