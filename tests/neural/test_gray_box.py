"""The gray-box network recovers a plant that is computed without the package."""

import copy
import dataclasses
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.signal import cont2discrete, lfilter
from sklearn.linear_model import LinearRegression

from skhyst.exceptions import DivergenceWarning, RecordError
from skhyst.hysteresis import SystemLevelHysteresis
from skhyst.neural import GrayBoxHysteresis
from skhyst.preprocessing import GeneralizedInputGradient, PlayOperators
from skhyst.records import stack_records

DT = 1e-3
SLOPE, CURVATURE, DECAY, INTERCEPT = 80.0, 0.9, 0.02, 400.0  # nm, V
OMEGA, ZETA = 2 * np.pi * 90.0, 0.08
NOISE = 5.0  # nm, of 10 um


def hysteresis(u):
    """Equation (15) in closed form from turning point to turning point."""
    turning, base, direction, last, y = 0.0, INTERCEPT, 1.0, 0.0, np.empty(len(u))

    def branch(s):
        growth = (s - (1.0 - np.exp(-DECAY * s)) / DECAY) / DECAY
        return SLOPE * s + CURVATURE * growth

    for k, value in enumerate(u):
        if (value - last) * direction < 0.0:
            base += direction * branch(abs(last - turning))
            turning, direction = last, -direction
        y[k] = base + direction * branch(abs(value - turning))
        last = value
    return y


def stage(u):
    """A second-order mode behind it, at rest before the record."""
    (numerator,), denominator, _ = cont2discrete(
        ([OMEGA**2], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), DT, method="foh"
    )
    level = hysteresis(u)
    past = np.full(1000, level[0])
    return lfilter(numerator.ravel(), denominator, np.r_[past, level])[1000:]


def records(seed, noise=NOISE, frequencies=(0.5, 5.0, 10.0, 25.0)):
    rng, parts = np.random.default_rng(seed), []
    for frequency in frequencies:
        time = DT * np.arange(int(max(2.0 / frequency, 0.4) / DT))
        u = 50.0 - 50.0 * np.cos(2 * np.pi * frequency * time)
        parts.append((u.reshape(-1, 1), stage(u) + noise * rng.normal(size=len(u))))
    return stack_records(parts, labels=frequencies, dt=DT)


@pytest.fixture(scope="module")
def data():
    return records(0)


@pytest.fixture(scope="module")
def joint(data):
    return GrayBoxHysteresis("joint").fit(*data)


@pytest.fixture(scope="module")
def staged(data):
    return GrayBoxHysteresis().fit(*data)


def test_joint_training_recovers_the_parameters_within_their_errors(joint):
    (numerator,), (_, a1, a2), _ = cont2discrete(
        ([OMEGA**2], [1.0, 2 * ZETA * OMEGA, OMEGA**2]), DT, method="foh"
    )
    e = -a1 - a2
    truth = {
        "slope": SLOPE,
        "curvature": CURVATURE,
        "decay": DECAY,
        "intercept": INTERCEPT,
        "theta[dd(k)]": numerator[0] - 1.0 + e,
        "theta[dd(k-1)]": -numerator[2],
        "theta[e(k)]": e,
        "theta[dy(k-1)]": a2,
    }
    assert set(truth) == set(joint.params_)
    for name, value in truth.items():
        assert abs(joint.params_[name] - value) < 4.0 * joint.params_std_[name], name
    assert joint.fit_error_ == pytest.approx(NOISE, rel=0.05)
    assert joint.identifiability_["undetermined"] == ()


def test_standard_errors_are_those_of_repetitions():
    names = ["slope", "curvature", "decay", "theta[e(k)]", "theta[dy(k-1)]"]
    values, errors = [], []
    for seed in range(12):
        model = GrayBoxHysteresis("joint").fit(*records(seed, frequencies=(1.0, 20.0)))
        values.append([model.params_[name] for name in names])
        errors.append([model.params_std_[name] for name in names])
    ratio = np.std(values, axis=0, ddof=1) / np.mean(errors, axis=0)
    # of 12 repetitions the ratio has a standard error of 0.2
    assert np.all((ratio > 0.4) & (ratio < 1.8)), ratio


def test_stages(data, staged, joint):
    """The static sub-model is that of the slowest record alone; joint training goes on from it."""
    X, y = data
    alone = SystemLevelHysteresis(dt=DT).fit(X.loc[[0.5]], y.loc[[0.5]])
    for name, value in alone.params_.items():
        assert staged.params_[name] == pytest.approx(value, rel=1e-3, abs=0.01)
        assert staged.params_std_[name] == pytest.approx(alone.params_std_[name], rel=0.01)
    assert staged.n_epochs_.keys() == {"static", "dynamic"}
    assert max(staged.n_epochs_.values()) <= 15
    assert joint.n_epochs_.keys() == {"static", "dynamic", "joint"}
    assert joint.fit_error_ < staged.fit_error_
    history = joint.history_
    for name, epochs in joint.n_epochs_.items():
        own = history["stage"] == name
        np.testing.assert_array_equal(history["epoch"][own], np.arange(epochs + 1))
        assert np.all(np.diff(history["loss"][own]) < 0.0)
        assert np.all(history["mu"][own] > 0.0)
    assert history["loss"][-1] == pytest.approx(joint.fit_error_**2)
    assert history["loss"][-1] == pytest.approx(np.mean((y - joint.predict(X)) ** 2), rel=1e-6)


def test_the_slow_records_alone_train_the_static_model(data, staged):
    X, y = data
    other = y.copy()
    other.loc[[5.0, 10.0, 25.0]] *= 1.3
    model = GrayBoxHysteresis().fit(X, other)
    assert model.params_["slope"] == staged.params_["slope"]
    both = GrayBoxHysteresis(n_static_records=2).fit(X, other)
    assert both.params_["slope"] > 1.01 * staged.params_["slope"]


def test_every_method_trains_the_same_network(data, joint):
    other = GrayBoxHysteresis("joint", method="variable_projection").fit(*data)
    assert other.fit_error_ == pytest.approx(joint.fit_error_, rel=1e-6)
    for name, value in joint.params_.items():
        assert abs(other.params_[name] - value) < 0.01 * joint.params_std_[name]
    assert np.isnan(other.history_["mu"]).all()


def test_held_out_amplitude_and_frequency(joint):
    time = DT * np.arange(800)
    u = 20.0 + 50.0 * np.sin(2 * np.pi * 7.0 * time) * np.exp(-2.0 * time) + 15.0 * time
    error = joint.predict(pd.DataFrame({"drive": u}, index=time)) - stage(u)
    assert np.abs(error).max() < NOISE


def test_kilovolts_and_metres(data, staged):
    X, y = data
    other = GrayBoxHysteresis().fit(1e-3 * X, 1e-9 * y)
    np.testing.assert_allclose(1e9 * other.predict(1e-3 * X), staged.predict(X), atol=1e-3)
    assert other.params_["curvature"] == pytest.approx(1e-3 * staged.params_["curvature"], rel=1e-3)
    assert other.n_epochs_ == staged.n_epochs_


def test_the_printed_dynamics_and_products(data):
    """(35) has levels in it: alone it does not reach the noise, and rates with products do."""
    printed = GrayBoxHysteresis(dynamics="printed", degree=1).fit(*data)
    products = GrayBoxHysteresis("joint", degree=2).fit(*data)
    assert products.fit_error_ == pytest.approx(NOISE, rel=0.05)
    assert printed.fit_error_ > 2.0 * products.fit_error_


def test_interval_of_the_fit(data, staged):
    X, _ = data
    slow = X.set_axis(X.index.set_levels(10.0 * X.index.levels[1], level="time"))
    with pytest.raises(RecordError, match=r"must be sampled at 0\.001 s"):
        staged.predict(slow)


def test_a_run_that_diverges_is_finite_and_warns(data, staged):
    model = copy.copy(staged)
    model.operator_ = dataclasses.replace(staged.operator_, weights=np.array([0.0, 0.0, 0.0, -3.0]))
    with pytest.warns(DivergenceWarning):
        assert np.isfinite(model.predict(data[0])).all()
    few = data[0].iloc[:40]  # far beyond what was measured, though within floating point
    with pytest.warns(DivergenceWarning):
        assert np.abs(model.predict(few)).max() == model.bound_


def test_history_before_the_records(data):
    """Records that are cut out of the middle fit better with a rest before them."""
    X, y = data
    X, y = X.iloc[700:2200], y.iloc[700:2200]
    rest = GrayBoxHysteresis().fit(X, y)
    model = GrayBoxHysteresis(initial_state="estimate").fit(X, y)
    assert model.fit_error_ <= rest.fit_error_
    assert model.n_epochs_.keys() == {"joint"}


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_constant_drive():
    model = GrayBoxHysteresis().fit(np.full((50, 1), 3.0), np.full(50, 2.0))
    np.testing.assert_allclose(model.predict(np.full((50, 1), 3.0)), 2.0, atol=1e-9)


# ------------------------------------------------------------------------- Theorem 1 of the paper


def test_two_minor_loops_share_drive_and_gradient_and_differ():
    """No static map of the two can be right; with play states even a linear one is."""
    speed = 1 / 128  # a power of two: drive and gradient are equal to the last bit
    down = _path([0.0, 1.5, 0.25, 0.75, 0.25, 0.75, 0.25], speed)
    up = _path([0.25, -1.0, 0.75, 0.25, 0.75, 0.25], speed)
    u, n = np.r_[down, up[1:]], round(0.5 / speed)
    thresholds = [0.0, 0.1, 0.2, 0.4, 0.7]
    y = np.array([1.0, 0.5, 0.4, 0.6, 0.5]) @ [_play(u, r) for r in thresholds]
    features = GeneralizedInputGradient().fit_transform(u.reshape(-1, 1))
    from_above, from_below = slice(len(down) - n, len(down)), slice(len(u) - n, len(u))
    np.testing.assert_array_equal(features[from_above], features[from_below])
    gap = (y[from_above] - y[from_below]).max()
    assert gap > 0.08 * np.ptp(y)
    # at one drive and gradient any map gives one value: at best the middle
    _, group = np.unique(features, axis=0, return_inverse=True)
    lowest, highest = np.full((2, group.max() + 1), np.nan)
    np.fmin.at(lowest, group, y)
    np.fmax.at(highest, group, y)
    best = 0.5 * (lowest + highest)[group]
    assert np.abs(y - best).max() >= 0.5 * gap
    states = PlayOperators(thresholds=thresholds).fit_transform(u.reshape(-1, 1))
    beside = np.column_stack([features, states])
    np.testing.assert_allclose(LinearRegression().fit(beside, y).predict(beside), y, atol=1e-10)


def _path(corners, speed):
    parts = [
        a + np.sign(b - a) * speed * np.arange(1, round(abs(b - a) / speed) + 1)
        for a, b in pairwise(corners)
    ]
    return np.concatenate([corners[:1], *parts])


def _play(u, r):
    state, out = 0.0, np.empty(len(u))
    for k, value in enumerate(u):
        state = max(value - r, min(value + r, state))
        out[k] = state
    return out
