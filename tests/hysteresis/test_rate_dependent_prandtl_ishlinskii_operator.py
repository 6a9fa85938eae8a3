"""Plays whose thresholds, or weights, follow the rate of the drive."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import PrandtlIshlinskiiOperator, RateDependentPrandtlIshlinskiiOperator

DT = 1e-3
R, W, S = np.array([0.0, 0.4, 0.9, 1.6]), np.array([1.0, 0.5, 0.4, 0.3]), np.array([3, -2, 1, 2])
signals = arrays(float, st.integers(2, 80), elements=st.floats(-5, 5))


def make(variant, **options):
    if variant == "threshold":
        return RateDependentPrandtlIshlinskiiOperator(R, W, (), 0.3, 4e-3, **options)
    return RateDependentPrandtlIshlinskiiOperator(R, W, 1e-3 * S, 0.3, **options)


VARIANTS = pytest.mark.parametrize("variant", ["threshold", "slope"])


def by_definition(operator, u, dt):
    """The plays' differential inclusion, in fine steps, and the weighted sum."""
    plays, last, slack, y = np.zeros(operator.thresholds.size), u[0], operator.thresholds, []
    for value in u:
        rate = abs(value - last) / dt
        goal = operator.thresholds + operator.dilation * rate * (operator.thresholds > 0.0)
        for part in np.linspace(0.0, 1.0, 11):
            v, r = last + part * (value - last), slack + part * (goal - slack)
            plays = np.maximum(v - r, np.minimum(v + r, plays))
        slack, last = goal, value
        weights = operator.weights
        if operator.rate_weights.size:
            weights = weights + operator.rate_weights * rate
        y.append(operator.intercept + weights @ plays)
    return np.array(y)


@VARIANTS
@settings(deadline=None, max_examples=30)
@given(u=signals, speed=st.floats(1e-3, 1e2))
def test_follows_its_definition(variant, u, speed):
    operator = make(variant)
    expected = by_definition(operator, u, DT / speed)
    np.testing.assert_allclose(
        operator.run(u, DT / speed)[0], expected, rtol=0, atol=1e-11 * (1 + np.abs(expected).max())
    )


@VARIANTS
@settings(deadline=None, max_examples=30)
@given(u=signals)
def test_slow_drive_gives_the_plain_model(variant, u):
    plain = PrandtlIshlinskiiOperator(R, W, 0.3)
    np.testing.assert_allclose(
        make(variant).run(u, 1e12)[0], plain.run(u, 1.0)[0], rtol=0, atol=1e-10
    )


@settings(deadline=None, max_examples=30)
@given(u=signals)
def test_without_dilation_and_rate_weights_it_is_the_plain_model(u):
    operator = RateDependentPrandtlIshlinskiiOperator(R, W, intercept=0.3)
    plain = PrandtlIshlinskiiOperator(R, W, 0.3)
    np.testing.assert_allclose(operator.run(u, DT)[0], plain.run(u, DT)[0], rtol=0, atol=1e-12)
    assert [name for name, _ in operator.entries()][-1] == "intercept"


def triangle(rate, periods=3, n=4000):
    """A triangular wave between -4 and 4 whose rate has one size."""
    time = np.arange(periods * n + 1) / n
    return 4.0 - 8.0 * np.abs(2.0 * (time % 1.0) - 1.0), 16.0 / rate / n


@pytest.mark.parametrize("rate", [0.5, 20.0, 80.0])
def test_width_of_a_loop_grows_with_the_rate(rate):
    operator = RateDependentPrandtlIshlinskiiOperator([0.0, 0.4], [0.0, 1.0], dilation=4e-3)
    u, dt = triangle(rate)
    y, _ = operator.run(u, dt)
    rows = slice(-4000, None)
    up = np.interp(0.0, y[rows][:2000], u[rows][:2000])
    down = np.interp(0.0, y[rows][:1999:-1], u[rows][:1999:-1])
    assert up - down == pytest.approx(2.0 * (0.4 + 4e-3 * rate), rel=1e-9)


def test_area_of_a_loop_grows_with_the_rate():
    areas = []
    for rate in (1.0, 10.0, 50.0):
        u, dt = triangle(rate)
        y, _ = make("threshold").run(u, dt)
        areas.append(np.trapezoid(u[-4001:], y[-4001:]))
    assert 0.0 < areas[0] < areas[1] < areas[2]


@settings(deadline=None, max_examples=40)
@given(u=signals, speed=st.floats(1e-2, 1e3))
def test_dissipation(u, speed):
    """Whatever the rate, a play moves only against its slack: ``(u - F) dF`` is not negative."""
    operator = RateDependentPrandtlIshlinskiiOperator([0.4], [1.0], dilation=4e-3)
    play, _ = operator.run(u, DT / speed)
    assert np.all((u[1:] - play[1:]) * np.diff(play) >= -1e-12)


@VARIANTS
@settings(deadline=None, max_examples=30)
@given(u=signals)
def test_odd_symmetry(variant, u):
    operator = make(variant)
    up, down = operator.run(u, DT)[0] - 0.3, operator.run(-u, DT)[0] - 0.3
    np.testing.assert_allclose(down, -up, rtol=0, atol=1e-12 * (1 + np.abs(up).max()))


@VARIANTS
@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_tangents_with_many_upstream(variant, initial_state):
    rng = np.random.default_rng(2)
    operator = make(variant)
    u = np.cumsum(rng.normal(size=200)) * 0.2 + 0.4
    du = np.cumsum(rng.normal(size=(200, 3)), axis=0)
    y, dy = operator.linearize(u, du, 0.05, initial_state)

    def output(vector, signal):
        moved = operator.unpack(vector)
        return moved.run(signal, 0.05, moved.init(signal[0], initial_state))[0]

    vector, h = operator.pack(), 1e-7
    np.testing.assert_array_equal(y, output(vector, u))
    for j, step in enumerate(np.eye(3)):
        shift = h * du @ step
        numeric = (output(vector, u + shift) - output(vector, u - shift)) / (2 * h)
        np.testing.assert_allclose(dy[:, j], numeric, atol=1e-6 * np.abs(numeric).max(), rtol=0)
    for j, step in enumerate(np.eye(vector.size) * h):
        numeric = (output(vector + step, u) - output(vector - step, u)) / (2 * h)
        np.testing.assert_allclose(
            dy[:, 3 + j], numeric, atol=1e-6 * max(np.abs(numeric).max(), 1.0), rtol=0
        )


@VARIANTS
def test_inverse_at_known_rates(variant):
    operator = pickle.loads(pickle.dumps(make(variant)))
    time = DT * np.arange(2000)
    u = 4.0 * np.sin(2 * np.pi * 2.0 * time * (1.0 + time)) + 0.3
    y, _ = operator.run(u, DT)
    rates = np.abs(np.diff(u, prepend=u[0])) / DT
    np.testing.assert_allclose(operator.drive_at_rates(y, rates), u, rtol=0, atol=1e-12 * np.ptp(u))
    _, (plays, _) = operator.run(u[:700], DT)
    np.testing.assert_allclose(
        operator.drive_at_rates(y[700:], rates[700:], plays), u[700:], atol=1e-12 * np.ptp(u)
    )


@VARIANTS
@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_inverse_without_the_rates(variant, initial_state):
    """What is left is a small part of what the inverse of the plain model leaves."""
    operator = make(variant)
    time = DT * np.arange(3000)
    u = 4.0 * np.sin(2 * np.pi * 1.5 * time) * np.cos(0.8 * time)
    y, _ = operator.run(u, DT, operator.init(u[0], initial_state))
    errors = []
    for drive in (
        operator.inverse_run(y, DT, initial_state),
        operator.drive_at_rates(y, np.zeros(y.size)),
    ):
        back, _ = operator.run(drive, DT, operator.init(drive[0], initial_state))
        errors.append(np.sqrt(np.mean((back - y) ** 2)))
    assert errors[0] < 0.1 * errors[1]
    assert errors[0] < 1e-3 * np.ptp(y)


def test_inverse_is_exact_where_steps_of_time_are_long():
    operator = make("threshold")
    u = np.cumsum(np.random.default_rng(3).normal(size=300))
    y, _ = operator.run(u, 0.2)
    np.testing.assert_allclose(operator.inverse_run(y, 0.2), u, atol=1e-6 * np.ptp(u))


@pytest.mark.parametrize(
    ("thresholds", "weights", "rate_weights", "rate"),
    [
        ([0.1, 1.0], [1.0, 1.0], (), 0.0),
        ([0.0, 1.0], [0.0, 1.0], (), 0.0),
        ([0.0, 1.0], [1.0, 1.0], [-0.1, 0.0], 11.0),
    ],
)
def test_no_inverse(thresholds, weights, rate_weights, rate):
    operator = RateDependentPrandtlIshlinskiiOperator(thresholds, weights, rate_weights)
    with pytest.raises(ValueError, match="strictly monotone"):
        operator.drive_at_rates(np.zeros(3), np.full(3, rate))


@pytest.mark.parametrize("drive_unit", [1e-9, 1e9])
@pytest.mark.parametrize("time_unit", [1e-6, 1e6])
@VARIANTS
def test_units(variant, drive_unit, time_unit):
    operator = make(variant)
    other = RateDependentPrandtlIshlinskiiOperator(
        R * drive_unit,
        W / drive_unit,
        operator.rate_weights * time_unit / drive_unit**2,
        0.3,
        operator.dilation * time_unit,
    )
    u = np.cumsum(np.random.default_rng(4).normal(size=300)) * 0.1
    expected, _ = operator.run(u, DT)
    found, _ = other.run(u * drive_unit, DT * time_unit)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.ptp(expected))


def test_wrong_sizes():
    kind = RateDependentPrandtlIshlinskiiOperator
    with pytest.raises(ValueError, match=r"'rate_weights' parameter .* 2 thresholds"):
        kind([0.0, 1.0], [1.0, 1.0], [1.0])
    with pytest.raises(ValueError, match="'thresholds' parameter of RateDependent"):
        kind([1.0, 0.0], [1.0, 1.0])
    with pytest.raises(ValueError, match="'weights' parameter of RateDependent"):
        kind([0.0, 1.0], [1.0])


def test_no_samples():
    operator = make("threshold")
    y, state = operator.run([], DT, operator.init(1.0))
    assert y.shape == (0,)
    assert state[1] == 1.0
    y, dy = operator.linearize(np.empty(0), np.empty((0, 2)), DT)
    assert dy.shape == (0, 2 + operator.n_parameters)
