"""The gray-box network: its laws, and its training on a plant that the package has no part in."""

import copy
import dataclasses
from itertools import combinations_with_replacement, pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.signal import cont2discrete, lfilter
from sklearn.linear_model import LinearRegression

from skhyst.exceptions import DivergenceWarning, RecordError
from skhyst.hysteresis import SystemLevelHysteresis, SystemLevelOperator
from skhyst.neural import GrayBoxHysteresis, GrayBoxOperator
from skhyst.preprocessing import GeneralizedInputGradient, PlayOperators
from skhyst.records import stack_records

# ----------------------------------------------------------------------- laws of the operator


def mode(omega, zeta, dt):
    """Numerator and denominator of a second-order mode's discrete form, by SciPy."""
    continuous = [omega**2], [1.0, 2 * zeta * omega, omega**2]
    numerator, denominator, _ = cont2discrete(continuous, dt, method="foh")
    return numerator.ravel(), denominator


def weights_of(numerator, denominator):
    """Weights of ``dd(k)``, ``dd(k-1)``, ``e(k)`` and ``dy(k-1)`` that make such a mode."""
    e = -denominator[1] - denominator[2]
    return np.array([numerator[0] - 1.0 + e, -numerator[2], e, denominator[2]])


def behind(filtering, level):
    """The response of a mode that was at rest before."""
    padded = np.r_[np.full(3000, level[0]), level]
    return lfilter(*filtering, padded)[3000:]


STATIC = SystemLevelOperator(1.1, 0.4, 0.7, 0.3)
DRIVE = 0.5 + 0.2 * np.cumsum(np.random.default_rng(0).normal(size=400)) * np.hanning(400)


@pytest.mark.parametrize("dynamics", ["rate", "printed"])
@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_without_weights_it_is_the_static_model(dynamics, initial_state):
    operator = GrayBoxOperator.at_rest(STATIC, degree=2, dynamics=dynamics)
    y, _ = operator.run(DRIVE, 0.01, operator.init(DRIVE[0], initial_state))
    expected, _ = STATIC.run(DRIVE, 0.01, STATIC.init(DRIVE[0], initial_state))
    np.testing.assert_allclose(y, expected, atol=1e-14)


def test_of_degree_one_it_is_hysteresis_and_a_second_order_mode():
    omega, zeta = 40.0, 0.2
    filtering = mode(omega, zeta, 0.01)
    operator = GrayBoxOperator(STATIC, weights_of(*filtering))
    assert operator.term_names() == ["dd(k)", "dd(k-1)", "e(k)", "dy(k-1)"]
    expected = behind(filtering, STATIC.run(DRIVE, 0.01)[0])
    np.testing.assert_allclose(operator.run(DRIVE, 0.01)[0], expected, atol=1e-11)
    poles = np.exp(0.01 * omega * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    np.testing.assert_allclose(np.sort_complex(operator.poles()), [poles.conj(), poles], atol=1e-12)


def test_the_printed_form_is_equation_35():
    rng = np.random.default_rng(1)
    pairs = list(combinations_with_replacement(range(4), 2))
    weights = np.r_[0.2, -0.1, 0.3, -0.2, 0.01 * rng.normal(size=len(pairs))]
    operator = GrayBoxOperator(STATIC, weights, degree=2, dynamics="printed")
    level = STATIC.run(DRIVE, 0.01, STATIC.init(DRIVE[0], "zero"))[0]
    u, y = np.r_[0.0, 0.0, DRIVE], np.zeros(len(DRIVE) + 2)
    for k in range(2, len(y)):
        x = [u[k - 1], u[k - 2], y[k - 1], y[k - 2]]
        y[k] = level[k - 2] + weights[:4] @ x
        y[k] += sum(w * x[i] * x[j] for w, (i, j) in zip(weights[4:], pairs, strict=True))
    found, _ = operator.run(DRIVE, 0.01, operator.init(DRIVE[0], "zero"))
    np.testing.assert_allclose(found, y[2:], atol=1e-12)


def test_products_of_rates_vanish_at_rest():
    """Held still, the response ends where the static model is, whatever the weights."""
    rng = np.random.default_rng(2)
    n = len(GrayBoxOperator.at_rest(STATIC, degree=2).weights)
    weights = np.r_[0.1, 0.2, 0.4, -0.2, 0.02 * rng.normal(size=n - 4)]
    operator = GrayBoxOperator(STATIC, weights, degree=2)
    drive = np.r_[np.linspace(0.0, 1.3, 30), np.linspace(1.3, 0.4, 20), np.full(200, 0.4)]
    y, level = operator.run(drive, 0.01)[0], STATIC.run(drive, 0.01)[0]
    assert np.abs(y - level).max() > 0.01
    np.testing.assert_allclose(y[-1], level[-1], atol=1e-12)


def test_regressors_explain_a_noise_free_run():
    for dynamics, degree in (("rate", 2), ("printed", 2), ("rate", 1)):
        zero = GrayBoxOperator.at_rest(STATIC, degree=degree, dynamics=dynamics)
        weights = 0.05 * np.cos(np.arange(len(zero.weights)))
        operator = dataclasses.replace(zero, weights=weights)
        y, _ = operator.run(DRIVE, 0.01)
        columns, rest = operator.regressors(DRIVE, y, 0.01)
        np.testing.assert_allclose(columns @ weights, rest, atol=1e-12)


def test_what_diverges_is_no_number_nor_are_its_tangents():
    operator = GrayBoxOperator(STATIC, np.array([0.0, 0.0, 0.0, -3.0]))
    assert np.abs(operator.poles()).max() > 1.0
    y, _ = operator.run(np.tile(DRIVE, 5), 0.01)
    first = np.flatnonzero(np.isnan(y))[0]
    assert np.isnan(y[first:]).all()
    assert np.isfinite(y[:first]).all()
    _, dy = operator.sensitivities(DRIVE, np.empty((len(DRIVE), 0)), 0.01)
    assert np.isnan(dy).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [("dynamics", "other"), ("degree", 3), ("input_lags", -1), ("weights", np.zeros(3))],
)
def test_errors(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of GrayBoxOperator must"):
        GrayBoxOperator(**{"static": STATIC, "weights": np.zeros(4)} | {name: value})


# -------------------------------------------------------------------------------- the training

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
    """A second-order mode behind it."""
    return behind(mode(OMEGA, ZETA, DT), hysteresis(u))


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
    static = {"slope": SLOPE, "curvature": CURVATURE, "decay": DECAY, "intercept": INTERCEPT}
    names = GrayBoxOperator.at_rest(STATIC).term_names()
    weights = weights_of(*mode(OMEGA, ZETA, DT))
    truth = static | {f"theta[{n}]": value for n, value in zip(names, weights, strict=True)}
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


@pytest.mark.filterwarnings("ignore:No one set of parameters")
def test_the_slow_records_alone_train_the_static_model(data, staged):
    X, y = data
    other = y.copy()
    other.loc[[5.0, 10.0, 25.0]] *= 1.3
    slopes = [
        GrayBoxHysteresis(n_static_records=n).fit(X, other).params_["slope"] for n in (None, 2)
    ]
    assert slopes[0] == staged.params_["slope"] < slopes[1] / 1.01


def test_every_method_trains_the_same_network(data, joint):
    other = GrayBoxHysteresis("joint", method="variable_projection").fit(*data)
    assert other.fit_error_ == pytest.approx(joint.fit_error_, rel=1e-6)
    for name, value in joint.params_.items():
        assert abs(other.params_[name] - value) < 0.01 * joint.params_std_[name]
    assert (other.history_["mu"] > 0.0).all()


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
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


@pytest.mark.slow
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
    u, n = np.r_[down, up[1:]].reshape(-1, 1), round(0.5 / speed)
    states = PlayOperators(thresholds=[0.0, 0.1, 0.2, 0.4, 0.7]).fit_transform(u)
    y = states @ [1.0, 0.5, 0.4, 0.6, 0.5]
    features = GeneralizedInputGradient().fit_transform(u)
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
    # the extreme before the last one tells them apart
    extremes = GeneralizedInputGradient(turning_points=4).fit_transform(u)
    assert (extremes[from_above] != extremes[from_below]).any(axis=1).all()
    additive = np.column_stack([features, states])
    np.testing.assert_allclose(LinearRegression().fit(additive, y).predict(additive), y, atol=1e-10)


def _path(corners, speed):
    parts = [
        a + np.sign(b - a) * speed * np.arange(1, round(abs(b - a) / speed) + 1)
        for a, b in pairwise(corners)
    ]
    return np.concatenate([corners[:1], *parts])
