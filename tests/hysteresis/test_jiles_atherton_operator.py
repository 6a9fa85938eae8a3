"""Laws of the Jiles-Atherton model."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from skhyst.hysteresis import JilesAthertonOperator

OPERATOR = JilesAthertonOperator(1.0, 1.0, 1.3, 0.6, 0.2, max_step=0.02)
SIGNALS = st.lists(st.floats(-8, 8).map(lambda v: round(v, 3)), min_size=1, max_size=8)
PLANTS = st.builds(
    JilesAthertonOperator,
    st.just(1.0),
    st.floats(0.1, 5.0),
    st.floats(0.05, 5.0),
    st.floats(0.0, 0.95),
    st.floats(0.0, 1.0),
)


def anhysteretic(field, shape, coupling):
    """Solve m = L((field + alpha Ms m) / shape)."""

    def gap(m):
        x = field / shape + 3.0 * coupling * m
        return (1.0 / np.tanh(x) - 1.0 / x if abs(x) > 1e-4 else x / 3.0) - m

    return brentq(gap, -1.0, 1.0, xtol=1e-15)


def textbook(operator, path):
    """Integrate the printed equation along straight branches, tightly, with M and alpha Ms."""
    a, k, c = operator.shape, operator.pinning, operator.reversibility
    alpha = 3.0 * a * operator.coupling
    m, found = 0.0, []
    last = 0.0
    for field in path:
        direction = np.sign(field - last)

        def slope(h, m, direction=direction):
            x = (h + alpha * m[0]) / a
            if abs(x) < 1e-3:
                curve, steep = x / 3.0 - x**3 / 45.0, (1.0 / 3.0 - x**2 / 15.0) / a
            else:
                curve, steep = 1.0 / np.tanh(x) - 1.0 / x, (1.0 / x**2 - 1.0 / np.sinh(x) ** 2) / a
            gap = curve - m[0]
            loss = gap / (k * direction - alpha * gap) if gap * direction > 0.0 else 0.0
            return [(loss + c * steep) / (1.0 - c * alpha * steep)]

        if field != last:
            m = solve_ivp(slope, (last, field), [m], "DOP853", rtol=1e-12, atol=1e-14).y[0, -1]
        found.append(m)
        last = field
    return np.array(found)


def order(operator, path, steps):
    """Regress the error at the end of a path on the length of the step."""
    exact = textbook(operator, path)[-1]
    errors = [
        abs(dataclasses.replace(operator, max_step=h).run(path, 1.0)[0][-1] - exact) for h in steps
    ]
    return np.polyfit(np.log(steps), np.log(errors), 1)[0], errors[-1]


def test_order_four_on_a_first_magnetisation():
    slope, smallest = order(OPERATOR, [2.0], 2.0 / np.array([4, 8, 16, 32, 64]))
    assert slope == pytest.approx(4.0, abs=0.3)
    assert smallest < 1e-8


def test_order_two_at_least_where_the_irreversible_part_sets_in():
    slope, smallest = order(OPERATOR, [4.0, -4.0], 8.0 / np.array([16, 32, 64, 128, 256, 512]))
    assert slope > 1.9
    assert smallest < 1e-5


@settings(deadline=None, max_examples=15)
@given(SIGNALS)
def test_textbook_equation(values):
    y, _ = dataclasses.replace(OPERATOR, max_step=0.005).run(values, 1.0)
    np.testing.assert_allclose(y, textbook(OPERATOR, values), atol=1e-5)


@settings(deadline=None, max_examples=15)
@given(SIGNALS)
def test_rate_independence(values):
    """Samples on the way change the steps, not the curve; the interval does not count at all."""
    fractions = np.linspace(0.0, 1.0, 6)[1:]
    path = np.concatenate([[0.0], values])
    way = (path[:-1, None] + np.diff(path)[:, None] * fractions).ravel()
    y, _ = OPERATOR.run(values, 1.0)
    np.testing.assert_array_equal(OPERATOR.run(values, 1e-6)[0], y)
    np.testing.assert_allclose(OPERATOR.run(way, 1.0)[0][4::5], y, atol=2e-4)
    np.testing.assert_array_equal(OPERATOR.run(np.repeat(values, 3), 1.0)[0], np.repeat(y, 3))


@settings(deadline=None, max_examples=15)
@given(SIGNALS, PLANTS)
def test_odd_symmetry(values, operator):
    u = np.array(values)
    np.testing.assert_array_equal(operator.run(-u, 1.0)[0], -operator.run(u, 1.0)[0])


@settings(deadline=None, max_examples=15)
@given(SIGNALS, PLANTS, st.floats(0.01, 100.0))
def test_bounds(values, operator, max_step):
    """Finite and within saturation for any step, and never moving against the drive."""
    operator = dataclasses.replace(operator, max_step=max_step)
    y, _ = operator.run(values, 1.0)
    assert (np.abs(y) <= 1.0).all()
    moves, steps = np.diff(y, prepend=0.0), np.diff(values, prepend=0.0)
    assert (moves * np.sign(steps) >= -1e-12).all()
    assert np.isfinite(
        operator.linearize(np.array(values), np.ones((len(values), 1)), 1.0)[1]
    ).all()


def test_saturation():
    fields = np.array([50.0, 200.0, 1000.0])
    y, _ = OPERATOR.run(fields, 1.0)
    expected = [anhysteretic(field, 1.0, 0.6) for field in fields]
    np.testing.assert_allclose(y, expected, atol=1e-3)
    assert 0.998 < y[-1] < 1.0
    remanence = [OPERATOR.run([field, 0.0], 1.0)[0][-1] for field in (50.0, 100.0, 150.0)]
    assert abs(remanence[2] - remanence[1]) < abs(remanence[1] - remanence[0]) < 1e-3


@pytest.mark.parametrize("coupling", [0.0, 0.5, 0.9])
def test_little_pinning_leaves_the_anhysteretic_curve(coupling):
    path = np.array([0.5, 2.0, 4.0, 1.0, -0.5, -3.0, 0.2, 2.0])
    expected = np.array([anhysteretic(field, 1.0, coupling) for field in path])
    errors = []
    for pinning in (0.02, 0.01):
        operator = JilesAthertonOperator(
            1.0, 1.0, pinning, coupling, 0.2, max_step=0.2 * pinning * (1 - coupling)
        )
        errors.append(np.abs(operator.run(path, 1.0)[0] - expected).max())
    assert errors[1] < 0.6 * errors[0] < 0.1


@pytest.mark.parametrize("coupling", [0.0, 0.5, 0.9])
def test_reversible_magnetisation_is_the_anhysteretic_curve(coupling):
    path = np.array([0.5, 2.0, 4.0, 1.0, -0.5, -3.0, 0.2, 2.0])
    expected = [anhysteretic(field, 1.0, coupling) for field in path]
    operator = JilesAthertonOperator(1.0, 1.0, 1.3, coupling, 1.0, max_step=0.01)
    np.testing.assert_allclose(operator.run(path, 1.0)[0], expected, atol=2e-5)


@settings(deadline=None, max_examples=15)
@given(PLANTS, st.floats(0.3, 10.0))
def test_loops_dissipate(operator, amplitude):
    """The work of the drive over a steady loop, the integral of H dB, is not negative."""
    n = 400
    u = amplitude * np.sin(2 * np.pi * np.arange(4 * n + 1) / n)
    operator = dataclasses.replace(operator, gain=0.3)
    y, _ = operator.run(u, 1.0)
    u, y = u[-n - 1 :], y[-n - 1 :]
    work = 0.5 * np.sum((u[1:] + u[:-1]) * np.diff(y))
    assert work > -1e-4 * amplitude
    if operator.reversibility < 0.8 and operator.pinning > 0.3:
        assert work > 0.0


def test_units():
    """A response in other units scales; a drive in other units scales all lengths."""
    u = np.random.default_rng(0).normal(size=50).cumsum()
    y, _ = dataclasses.replace(OPERATOR, gain=0.1).run(u, 1.0)
    scaled = JilesAthertonOperator(1e-3, 1e6, 1.3e6, 0.6, 0.2, 1e-10, max_step=2e4)
    np.testing.assert_allclose(scaled.run(1e6 * u, 1.0)[0], 1e-3 * y, rtol=1e-9)


def test_default_step_is_kept_by_copies():
    operator = JilesAthertonOperator(1.0, 2.0, 3.0, 0.5, 0.2)
    assert operator.max_step == pytest.approx(0.2)
    assert operator.unpack(1.5 * operator.pack()).max_step == operator.max_step


@pytest.mark.parametrize(
    ("field", "value"),
    [("shape", 0.0), ("pinning", -1.0), ("coupling", 1.0), ("reversibility", 1.1), ("max_step", 0)],
)
def test_wrong_fields(field, value):
    with pytest.raises(ValueError, match=f"The '{field}' parameter of JilesAthertonOperator"):
        dataclasses.replace(OPERATOR, **{field: value})
