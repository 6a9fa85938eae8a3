"""Dead zones by their weights and by their slopes, and the inverse of these."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.static import DeadZoneOperator, MonotoneDeadZoneOperator

values = arrays(float, st.integers(1, 60), elements=st.floats(-100, 100))


@st.composite
def curves(draw):
    size = draw(st.integers(1, 7))
    gaps = draw(arrays(float, size, elements=st.floats(0.0, 20)))
    return MonotoneDeadZoneOperator(
        draw(arrays(float, size, elements=st.floats(0.05, 20))),
        np.cumsum(gaps) + draw(st.floats(-60, 10)),
        draw(st.integers(0, size)),
    )


def run(operator, v):
    return operator.run(v, 1.0)[0]


def test_weights_by_their_formula():
    v, weights = np.linspace(-3.0, 3.0, 241), np.array([0.5, -0.3, 0.2])
    operator = DeadZoneOperator(weights, np.array([0.4, -0.2, -1.0]), np.array([1, -1, -1]))
    expected = v + 0.5 * np.maximum(v - 0.4, 0.0)
    expected += -0.3 * np.minimum(v + 0.2, 0.0) + 0.2 * np.minimum(v + 1.0, 0.0)
    np.testing.assert_allclose(run(operator, v), expected, atol=1e-14)
    np.testing.assert_array_equal(run(operator.unpack(np.zeros(6)), v), v)


@settings(deadline=None, max_examples=80)
@given(curves(), values)
def test_equals_the_dead_zones(curve, v):
    zones = DeadZoneOperator(curve.weights, curve.thresholds, curve.side)
    np.testing.assert_allclose(run(curve, v), run(zones, v), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.sign(curve.side), curve.side)


@settings(deadline=None, max_examples=80)
@given(curves(), values)
def test_inverse_is_the_identity(curve, v):
    inverse = curve.inverse()
    np.testing.assert_allclose(run(inverse, run(curve, v)), v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run(curve, run(inverse, v)), v, rtol=0, atol=1e-9)
    again = inverse.inverse()
    np.testing.assert_allclose(again.thresholds, curve.thresholds, rtol=0, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(curves(), values)
def test_strictly_monotone_and_the_sum_of_its_parts(curve, v):
    v = np.unique(np.round(v, 3))
    assert np.all(np.diff(run(curve, v)) >= 0.04 * np.diff(v))
    centre, parts = curve.parts(v)
    np.testing.assert_allclose(centre + parts.sum(axis=1), v, rtol=0, atol=1e-10)


def test_slopes_of_each_segment():
    curve = MonotoneDeadZoneOperator(np.array([3.0, 2.0, 0.5]), np.array([-2.0, -1.0, 1.0]), 2)
    v = np.array([-5.0, -1.5, 0.0, 7.0])
    _, dy = curve.linearize(v, np.ones((4, 1)), 1.0)
    np.testing.assert_array_equal(dy[:, 0], [3.0, 2.0, 1.0, 0.5])
    np.testing.assert_array_equal(curve.weights, [1.0, 1.0, -0.5])
    np.testing.assert_array_equal(run(curve, v), [-12.0, -2.0, 0.0, 4.0])


@pytest.mark.parametrize("slope", [0.0, -0.1])
def test_no_inverse(slope):
    curve = MonotoneDeadZoneOperator(np.array([slope]), np.array([1.0]), 0)
    with pytest.raises(ValueError, match="needs positive slopes"):
        curve.inverse()
