"""Records that begin under way: named, predicted, and a model like any other."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.autoregressive import NARXRegressor
from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, Gain, SecondOrderMode, SecondOrderModeOperator

NOISE, CUT, N = 2e-3, 500, 700
PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 0.3, 0.8, 1.4]), np.array([1.0, 0.4, 0.3, 0.3]))
DECLARED = PrandtlIshlinskii(thresholds=[0.0, 0.3, 0.8, 1.4])
EFFECTS = ["initial_state", "drift", "offset", "asymmetry", "lag"]


def recording(device, *, cut=CUT, seed=0, records=5):
    """Run a device and cut off the first part of each record."""
    Xs, ys = {}, {}
    for i in range(records):
        rng = np.random.default_rng([seed, i])
        time = np.arange(cut + N) * 0.01
        u = sum(np.sin(rng.uniform(0.8, 8.0) * time + rng.uniform(0, 6)) for _ in range(4))
        y = device.run(u, 0.01)[0] + NOISE * rng.normal(size=len(u))
        index = pd.Index(np.arange(N) * 0.01, name="time")
        Xs[i], ys[i] = pd.DataFrame({"u": u[cut:]}, index), pd.Series(y[cut:], index)
    return tuple(pd.concat(own, names=["record"]) for own in (Xs, ys))


@pytest.fixture(scope="module")
def search():
    return EffectSearchCV(DECLARED, effects=EFFECTS, cv=2, random_state=0).fit(*recording(PLAYS))


@pytest.mark.slow
def test_a_start_under_way_is_named_and_no_drift(search):
    assert search.effects_ == ["initial_state"]
    assert search.verdict_ == "noise"
    assert search.error_before_ > 10.0 * NOISE
    assert search.error_after_ < 2.0 * NOISE


def test_new_records_are_foretold_as_well(search):
    new = recording(PLAYS, seed=1, records=3)
    assert search.held_out_error(*new) < 1.2 * NOISE
    assert search.held_out_error(*new, declared=True) > 10.0 * NOISE


def test_its_evidence_says_how_much_and_how_long(search):
    evidence = search.evidence_["initial_state"]
    most, _, _ = evidence.numbers["largest part of the response"]
    lasting, _, unit = evidence.numbers["longest time above the noise"]
    assert most > 20.0 * NOISE
    assert 0.0 < lasting < 0.01 * N
    assert unit == "s"
    assert [label for label, *_ in evidence.picture.curves] == [
        "measured",
        "identified",
        "without it",
    ]
    assert "initial_state" in search.report().to_markdown()


@pytest.mark.slow
def test_the_augmented_model_is_one_like_any_other(search):
    X, y = recording(PLAYS)
    model = search.best_estimator_
    assert model.initial_state == "estimate"
    assert model.initial_drive_.shape == (5, 9)
    again = clone(model).fit(X, y)
    assert again.fit_error_ == pytest.approx(model.fit_error_, rel=0.1)
    assert EffectSearchCV(model, effects=EFFECTS, cv=2, random_state=0).fit(X, y).effects_ == []


def test_the_first_part_of_a_record_tells_the_rest(search):
    X, y = recording(PLAYS, seed=6, records=2)
    known = y.where(X.index.get_level_values("time") < 1.0)
    late = known.isna().to_numpy()
    rest, told = search.predict(X), search.predict(X, y_start=known)
    errors = [np.sqrt(np.mean(np.square((y - own)[late]))) for own in (rest, told)]
    assert errors[1] < 1.5 * NOISE
    assert errors[1] < 0.5 * errors[0]
    first = X.index.get_level_values("record") == X.index[0][0]
    begun, later = X[first & ~late], X[first & late]
    stepped = search.stepper_from(begun, y[begun.index]).run(later.to_numpy()[:, 0])
    assert np.sqrt(np.mean(np.square(y[later.index] - stepped))) < 1.5 * NOISE


def test_what_begins_at_rest_has_none():
    found = EffectSearchCV(DECLARED, effects=EFFECTS, cv=2, random_state=0)
    found.fit(*recording(PLAYS, cut=0))
    assert found.effects_ == []


@pytest.mark.slow
def test_it_is_estimated_anew_beside_what_is_found_later():
    """A lag of two time constants is missing too: what came before is found behind both."""
    stages = [PLAYS, SecondOrderModeOperator(25.0, 1.5)]

    class Device:
        def run(self, u, dt):
            for stage in stages:
                u = stage.run(u, dt)[0]
            return u, None

    X, y = recording(Device(), records=3)
    effects = ["initial_state", "drift", "lag", "resonance"]
    found = EffectSearchCV(DECLARED, effects=effects, cv=2, random_state=0).fit(X, y)
    assert set(found.effects_) == {"lag", "initial_state"}
    assert found.error_after_ < 1.3 * NOISE


@pytest.mark.parametrize(
    "declared",
    [Gain(), SecondOrderMode(initial_state="zero"), PrandtlIshlinskii(5, initial_state="estimate")],
)
def test_there_is_nothing_to_estimate(declared):
    """Without a memory, with a state that is known, and where it is estimated already."""
    X, y = recording(PLAYS, records=2)
    found = EffectSearchCV(declared, effects=["initial_state"], random_state=0).fit(X, y)
    assert found.effects_ == []
    assert found.ranking_["error_after"].isna().all()


def test_a_record_that_continues_one_of_the_fit_is_under_way():
    """Its time says so; with a time of their own the same rows would begin at rest."""
    X, y = recording(PLAYS, cut=0, records=1)
    X, y = X.droplevel("record"), y.droplevel("record")
    found = EffectSearchCV(DECLARED, effects=["offset"], random_state=0).fit(X[:400], y[:400])
    own = X[400:].set_axis(X.index[: N - 400])
    for declared in (False, True):
        assert found.held_out_error(X[400:], y[400:], declared=declared) < 1.3 * NOISE
        alone = found.held_out_error(own, y[400:].set_axis(own.index), declared=declared)
        assert alone > 5.0 * NOISE


def test_a_black_box_goes_on_from_the_washout_of_a_record_that_continues_one_of_the_fit():
    rng = np.random.default_rng(0)
    u = rng.normal(size=600).cumsum()
    y = FirstOrderLagOperator(0.5).run(u, 0.01)[0] + 0.01 * rng.normal(size=600)
    time = pd.Index(0.01 * np.arange(600), name="time")
    X, y = pd.DataFrame({"u": u}, time), pd.Series(y, time)
    declared = NARXRegressor()
    found = EffectSearchCV(declared, effects=["offset"], cv=2).fit(X[:400], y[:400])
    late = X[400:].set_axis(X.index[400:] + 1.0)
    assert found.held_out_error(X[400:], y[400:]) < 0.05
    assert found.held_out_error(late, y[400:].set_axis(late.index)) > 0.5
