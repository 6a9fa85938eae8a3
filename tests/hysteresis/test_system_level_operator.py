"""Laws of the system-level model."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.hysteresis import SystemLevelOperator

OPERATOR = SystemLevelOperator(slope=0.9, curvature=0.3, decay=0.8, intercept=0.2)
PRINTED = dataclasses.replace(OPERATOR, variant="printed", rate_gain=0.02)
SIGNALS = st.lists(st.floats(-5, 5).map(lambda v: round(v, 3)), min_size=2, max_size=20)


def refine(u, n=7):
    """Put ``n - 1`` samples on the straight line to each sample."""
    steps = np.linspace(0.0, 1.0, n + 1)[1:]
    fine = np.concatenate([u[:1], (u[:-1, None] + np.diff(u)[:, None] * steps).ravel()])
    fine[::n] = u  # a sample beyond the end, by rounding, would be a turning point
    return fine


@settings(deadline=None, max_examples=30)
@given(SIGNALS)
def test_rate_independence(values):
    u = np.array(values)
    y, state = OPERATOR.run(u, 1.0)
    fine, last = OPERATOR.run(refine(u), 1e-3)
    np.testing.assert_allclose(fine[::7], y, atol=1e-11)
    np.testing.assert_allclose(last, state, atol=1e-11)


@settings(deadline=None, max_examples=30)
@given(SIGNALS)
def test_integral_of_the_slope(values):
    """Equation (15) by quadrature, the turning points found by hand."""
    u = np.concatenate([[0.0], values])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    turning, direction, total, expected = 0.0, 0.0, 0.2, []
    for a, b in pairwise(u):
        if b != a:
            if np.sign(b - a) != direction:
                turning, direction = a, np.sign(b - a)
            points = a + (b - a) * 0.5 * (nodes + 1.0)
            growth = (1.0 - np.exp(-0.8 * np.abs(points - turning))) / 0.8
            total += (b - a) * 0.5 * weights @ (0.9 + 0.3 * growth)
        expected.append(total)
    np.testing.assert_allclose(OPERATOR.run(u[1:], 1.0)[0], expected, atol=1e-9)


@settings(deadline=None, max_examples=30)
@given(SIGNALS)
def test_odd_symmetry(values):
    odd = dataclasses.replace(OPERATOR, intercept=0.0)
    u = np.array(values)
    np.testing.assert_array_equal(odd.run(-u, 1.0)[0], -odd.run(u, 1.0)[0])


@settings(deadline=None, max_examples=30)
@given(SIGNALS, st.floats(0.1, 3.0))
def test_every_loop_closes_at_once(values, swing):
    u = np.array([*values, values[-1] + 4.0, values[-1], values[-1] + swing, values[-1]])
    y, _ = OPERATOR.run(u, 1.0)
    assert y[-1] == pytest.approx(y[-3], abs=1e-10)


@settings(deadline=None, max_examples=30)
@given(SIGNALS, SIGNALS)
def test_congruency(first, second):
    """Loops of equal swing have one shape, whatever came before and wherever they are."""
    loop = np.concatenate([np.linspace(0, 1, 9), np.linspace(1, 0, 9), np.linspace(0, 1, 9)])
    shapes = []
    for past in (first, second):
        u = np.concatenate([past, [past[-1] + 6.0], past[-1] + loop])
        y, _ = OPERATOR.run(u, 1.0)
        shapes.append(y[-18:] - 0.9 * u[-18:])
    np.testing.assert_allclose(np.diff(shapes[0]), np.diff(shapes[1]), atol=1e-10)


def area(operator, swing):
    n = 4000
    u = np.concatenate([np.linspace(0, swing, n), np.linspace(swing, 0, n)[1:]])
    y, _ = operator.run(np.concatenate([u, u[1:]]), 1.0)
    y = y[-len(u) :]
    return 0.5 * np.sum((u[1:] + u[:-1]) * np.diff(y))


@pytest.mark.parametrize("swing", [0.3, 1.0, 5.0])
def test_area_of_the_rayleigh_law(swing):
    """Without decay the loops are parabolas of area curvature swing^3 / 6."""
    rayleigh = dataclasses.replace(OPERATOR, decay=0.0)
    assert area(rayleigh, swing) == pytest.approx(0.3 * swing**3 / 6.0, rel=1e-5)
    assert 0.0 < area(OPERATOR, swing) < area(rayleigh, swing)


def test_wide_swings_have_the_limiting_slope():
    y, _ = OPERATOR.run([0.0, 40.0, 50.0], 1.0)
    assert (y[2] - y[1]) / 10.0 == pytest.approx(0.9 + 0.3 / 0.8)


def test_state_is_last_turning_point():
    _, state = OPERATOR.run([0.0, 2.0, 1.0, 1.5, 1.2, 1.2], 1.0)
    turning, base, last, direction = state
    assert (turning, last, direction) == (1.5, 1.2, -1.0)
    assert base == pytest.approx(OPERATOR.run([0.0, 2.0, 1.0, 1.5], 1.0)[0][-1] - 0.2)


def test_printed_form():
    """Equation (21) with the rate term of (22)."""
    delta_d, gamma, v_c, d_o, h_s, dt = 0.4, -3.0, 2.5, 0.3, 0.02, 0.1
    u = np.array([0.5, 2.0, 3.0, 1.0, -1.0, -1.0, 0.5])
    shift = np.array([0.0, 0.0, 0.0, 3.0, 3.0, 3.0, -1.0])
    rate = np.diff(u, prepend=u[0]) / dt
    expected = d_o + delta_d * (1 - gamma * np.exp(-np.abs(u - shift) / v_c)) * u + h_s * rate
    operator = SystemLevelOperator.from_paper(
        delta_d, gamma, v_c, d_o=d_o, h_s=h_s, variant="printed"
    )
    np.testing.assert_allclose(operator.run(u, dt)[0], expected, rtol=1e-12)


def test_parameters_of_the_paper_in_the_integral():
    operator = SystemLevelOperator.from_paper(0.4, -3.0, 2.5, d_o=0.3)
    u = np.linspace(0.0, 6.0, 20001)
    slopes = np.gradient(operator.run(u, 1.0)[0], u)
    expected = 0.3 + 0.4 * (1.0 + 3.0 * np.exp(-u / 2.5))
    np.testing.assert_allclose(slopes[1:-1], expected[1:-1], atol=1e-6)


def test_printed_form_jumps_where_the_drive_turns():
    u = np.array([0.0, 3.0, 3.0 - 1e-9])
    smooth, _ = OPERATOR.run(u, 1.0)
    printed, _ = dataclasses.replace(PRINTED, rate_gain=0.0).run(u, 1.0)
    assert abs(smooth[2] - smooth[1]) < 1e-8
    assert abs(printed[2] - printed[1]) > 0.5


@pytest.mark.parametrize(
    ("field", "value"), [("variant", "other"), ("decay", -0.1), ("rate_gain", 0.1)]
)
def test_wrong_fields(field, value):
    with pytest.raises(ValueError, match=f"The '{field}' parameter of SystemLevelOperator"):
        dataclasses.replace(OPERATOR, **{field: value})
