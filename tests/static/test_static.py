"""Clipping and smooth curves: their formulas, and what is identified."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.static import (
    DeadBandOperator,
    DeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
)

V = np.linspace(-3.0, 3.0, 241)


def curve(operator, v=V):
    return operator.run(v, 1.0)[0]


def test_saturation_clips():
    np.testing.assert_array_equal(curve(SaturationOperator(-1.0, 0.5)), np.clip(V, -1.0, 0.5))
    np.testing.assert_array_equal(curve(SaturationOperator(upper=0.5)), np.minimum(V, 0.5))
    np.testing.assert_array_equal(curve(SaturationOperator(lower=0.5)), np.maximum(V, 0.5))
    np.testing.assert_array_equal(curve(SaturationOperator()), V)


@pytest.mark.parametrize(
    ("operator", "names"),
    [
        (SaturationOperator(), []),
        (SaturationOperator(lower=-1.0), ["lower"]),
        (SaturationOperator(upper=1.0), ["upper"]),
        (SaturationOperator(-1.0, 1.0), ["lower", "upper"]),
    ],
)
def test_infinite_level_is_no_parameter(operator, names):
    assert [name for name, _ in operator.entries()] == names
    assert operator.n_parameters == len(names)
    assert curve(operator.unpack(operator.pack())) == pytest.approx(curve(operator))


@settings(deadline=None, max_examples=25)
@given(
    coefficients=st.lists(st.floats(-1, 1), min_size=1, max_size=4),
    center=st.floats(-1, 1),
    scale=st.floats(0.5, 2.0),
)
def test_curve_is_legendre_inside_and_its_tangent_outside(coefficients, center, scale):
    operator = PolynomialCurveOperator(np.array(coefficients), center, scale)
    series = np.polynomial.Legendre(
        [0.0, 0.0, *coefficients], domain=[center - scale, center + scale]
    )
    inside = np.linspace(center - scale, center + scale, 51)
    np.testing.assert_allclose(curve(operator, inside), inside + scale * series(inside), atol=1e-12)
    for side in (-1, 1):
        end = center + side * scale
        beyond = end + side * np.array([0.0, 0.7, 5.0])
        tangent = end + scale * series(end) + (1 + scale * series.deriv()(end)) * (beyond - end)
        np.testing.assert_allclose(curve(operator, beyond), tangent, atol=1e-10)


@pytest.mark.parametrize(
    "operator",
    [
        SaturationOperator(-1.0, 0.5),
        DeadBandOperator(0.4, 0.1),
        DeadZoneOperator(np.array([0.5]), np.array([0.4]), np.array([1])),
        PolynomialCurveOperator(np.array([0.2, 0.1]), 0.1, 1.0),
    ],
)
def test_no_curve_has_memory(operator):
    order = np.random.default_rng(0).permutation(len(V))
    np.testing.assert_array_equal(curve(operator, V[order]), curve(operator)[order])
    assert operator.init(3.0) == ()
