"""What to record next: it settles what it says, within the limits, and the numbers are those."""

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import NotFittedError
from sklearn.linear_model import LinearRegression

from skhyst.datasets import from_rest_to_rest, sine
from skhyst.diagnosis import EffectSearchCV, next_experiment
from skhyst.diagnosis._next_experiment import _record
from skhyst.diagnosis._open_questions import Fitted
from skhyst.linear import FirstOrderLag, Gain
from skhyst.model_selection import BlockedTimeSeriesSplit
from skhyst.records import read_records, stack_records

DT, NOISE = 5e-3, 0.02
LIMITS, RATE = (-1.0, 1.0), 100.0


def late(u, seed):
    """The response of a device that is two samples late."""
    rows = np.arange(len(u))
    noise = NOISE * np.random.default_rng(seed).normal(size=len(u))
    return np.interp(rows - 2.0, rows, u) + noise


@pytest.fixture(scope="module")
def slow():
    """A slow recording, in which a delay and a lag look alike."""
    X = sine(1.0, 2.0, n_cycles=4, dt=DT)
    return X, late(X["drive"].to_numpy(), 0)


@pytest.fixture(scope="module")
def ambiguous(slow):
    search = EffectSearchCV(Gain(), effects=["delay", "lag"], random_state=0).fit(*slow)
    assert search.history_["ambiguous_with"].tolist() == [("lag",)]
    return search


@pytest.fixture(scope="module")
def experiment(ambiguous):
    return next_experiment(ambiguous, LIMITS, RATE)


@pytest.mark.slow
def test_the_record_settles_what_was_ambiguous(slow, experiment):
    drive = experiment.drive.to_numpy()
    X, y = stack_records([slow, (pd.DataFrame({"drive": drive}), late(drive, 1))], dt=DT)
    folds = BlockedTimeSeriesSplit(5, staggered=True)
    search = EffectSearchCV(Gain(), effects=["delay", "lag"], cv=folds, random_state=0).fit(X, y)
    assert search.effects_ == ["delay"]
    assert search.history_["ambiguous_with"].tolist() == [()]


def test_its_representation_is_short(experiment):
    assert experiment.reason in repr(experiment)
    assert len(repr(experiment)) < len(experiment.reason) + 200


def test_the_reason_says_what_it_tells_apart(experiment):
    assert experiment.reason.startswith(experiment.signal[0].upper())
    assert "it distinguishes delay from lag (" in experiment.reason
    assert "hardly" not in experiment.reason
    assert experiment.expected_gain > 0.0


def test_the_drive_is_within_the_limits(slow, experiment):
    u, time = experiment.drive.to_numpy(), experiment.drive.index.to_numpy()
    assert len(u) == len(slow[0])
    assert u.min() >= LIMITS[0]
    assert u.max() <= LIMITS[1]
    assert np.abs(np.diff(u)).max() <= RATE * DT * (1.0 + 1e-9)
    np.testing.assert_allclose(np.diff(time), DT)


def test_a_faster_drive_tells_more(ambiguous, experiment):
    slower = next_experiment(ambiguous, LIMITS, RATE / 10.0)
    assert slower.expected_gain < experiment.expected_gain


def test_duration_and_interval_are_as_asked(ambiguous):
    drive = next_experiment(ambiguous, LIMITS, duration=1.0, dt=0.01).drive
    assert len(drive) == 100
    assert drive.index[1] == pytest.approx(0.01)
    # of a record of so few samples that no signal has its form, the shortest that has
    assert len(next_experiment(ambiguous, LIMITS, dt=0.1).drive) == 64


def test_what_a_linear_model_misses_is_what_a_refit_leaves(ambiguous, slow):
    u = np.sin(0.3 * np.arange(200.0)) ** 3
    y = np.roll(u, 3)
    model = Fitted(ambiguous._declared_structure, ambiguous._records)
    missed = model.misses(y, _record(ambiguous, u, DT))
    # the data so far hold the parameters as if the model were right there
    begin, _ = ambiguous._records[0].segments[0]  # behind the washout
    old = slow[0]["drive"].to_numpy()[begin:]
    line = LinearRegression().fit(old[:, None], slow[1][begin:])
    both = np.concatenate([old, u])
    target = np.concatenate([line.predict(old[:, None]), y])
    again = LinearRegression().fit(both[:, None], target)
    left = np.sum(np.square(target - again.predict(both[:, None])))
    assert missed == pytest.approx(left, rel=1e-6)


def test_where_nothing_is_open_the_widest_interval_narrows_as_foretold():
    X = sine(1.0, 2.0, n_cycles=4, dt=DT)
    device = FirstOrderLag().fit(X, X["drive"].shift(3, fill_value=0.0))
    rng = np.random.default_rng(3)

    def respond(X):
        return device.predict(X) + NOISE * rng.normal(size=len(X))

    y = respond(X)
    search = EffectSearchCV(FirstOrderLag(), effects=["offset"], random_state=0).fit(X, y)
    assert search.verdict_ == "noise"
    experiment = next_experiment(search, LIMITS, RATE)
    assert "nothing is ambiguous" in experiment.reason
    more = stack_records([pd.DataFrame({"drive": experiment.drive.to_numpy()})], dt=DT)
    both = stack_records([(X, y), (more, respond(more))], labels=[0, 1])
    before, after = FirstOrderLag().fit(X, y).params_std_, FirstOrderLag().fit(*both).params_std_
    names = ["gain", "time_constant"]  # hardly correlated, and of a known size
    assert all(name.replace("_", " ") in experiment.reason for name in names)
    narrower = sum(np.log(before[name] / after[name]) for name in names)
    assert experiment.expected_gain == pytest.approx(narrower, abs=0.1)


def test_where_no_effect_helps_what_was_not_excited_is_asked_for(slow):
    u = slow[0]["drive"].to_numpy()
    y = np.abs(u) + 0.3 * u + NOISE * np.random.default_rng(0).normal(size=len(u))
    search = EffectSearchCV(Gain(), effects=["delay"], random_state=0).fit(slow[0], y)
    assert (search.effects_, search.verdict_) == ([], "unexplained")
    experiment = next_experiment(search, LIMITS, RATE)
    assert "no effect is near to a claim" in experiment.reason
    assert experiment.expected_gain > 0.0


def test_further_columns_are_taken_to_stay(slow):
    X, y = slow
    X = X.assign(temperature=20.0 + np.linspace(0.0, 1.0, len(X)))
    search = EffectSearchCV(Gain(), effects=["delay", "lag"], random_state=0).fit(X, y)
    reason = next_experiment(search, LIMITS, RATE).reason
    assert reason.endswith("Further columns are taken to stay at their means.")


def test_behind_any_regressor(slow):
    search = EffectSearchCV(LinearRegression(), effects=["delay", "lag"], random_state=0)
    reason = next_experiment(search.fit(*slow), LIMITS, RATE).reason
    assert "delay" in reason


def test_a_drive_begins_and_ends_at_rest():
    """No step is larger than those of the drive, or than the rate, and the drive is inside."""
    u = np.array([3.0, 4.0, 5.0, 4.0])
    for more, largest in (({}, 1.0), ({"rate_limit": 0.5}, 0.25), ({"rate_limit": 9.0}, 4.5)):
        for rest in (0.0, 10.0):
            drive, n_before = from_rest_to_rest(u, 0.5, rest, **more)
            np.testing.assert_array_equal(drive[n_before : n_before + 4], u)
            assert drive[0] == drive[-1] == rest
            for ramp in (drive[: n_before + 1], drive[n_before + 3 :]):
                assert np.abs(np.diff(ramp)).max() <= largest * (1.0 + 1e-9)
    drive, n_before = from_rest_to_rest(u, 0.5)  # from its own value that is nearest to zero
    assert (drive.tolist(), n_before) == ([3.0, 4.0, 5.0, 4.0, 3.0], 0)
    drive, n_before = from_rest_to_rest([2.0] * 4, 0.5, 1.0)
    np.testing.assert_allclose(drive[: n_before + 1], [1.0, 1.25, 1.5, 1.75, 2.0])
    with pytest.raises(ValueError, match="finite numbers"):
        from_rest_to_rest([np.nan], 1.0)


def test_a_file_is_written_once(experiment, tmp_path):
    path = tmp_path / "drive.csv"
    experiment.save(path)
    X, _ = read_records(path, drive="drive", time="time")
    time, drive = X.index.get_level_values("time"), X["drive"].to_numpy()
    own = (time > -0.5 * DT) & (time < (len(experiment.drive) - 0.5) * DT)
    np.testing.assert_allclose(drive[own], experiment.drive)
    assert np.abs(np.diff(drive)).max() <= RATE * DT * (1.0 + 1e-9)
    assert abs(drive[0]) <= RATE * DT >= abs(drive[-1])  # one step from the rest at zero
    with pytest.raises(FileExistsError, match=r"drive\.csv"):
        experiment.save(path)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"drive_limits": (1.0, -1.0)}, "'drive_limits' .* the lower one first"),
        ({"drive_limits": (0.0, np.nan)}, "'drive_limits'"),
        ({"drive_limits": 1.0}, "'drive_limits'"),
        ({"rate_limit": 0.0}, "'rate_limit' .* positive"),
        ({"rate_limit": 1e-3}, "'rate_limit' .* at least"),
        ({"duration": 0.1}, "'duration' .* at least 64 intervals"),
        ({"dt": 0.0}, "'dt'"),
    ],
)
def test_bad_input_is_refused(ambiguous, asked, message):
    with pytest.raises(ValueError, match=message):
        next_experiment(ambiguous, **({"drive_limits": LIMITS} | asked))


def test_a_search_must_be_fitted():
    with pytest.raises(NotFittedError):
        next_experiment(EffectSearchCV(Gain()), LIMITS)
