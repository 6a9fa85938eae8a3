"""Memoryless curves: their formulas, their inverses, and what is identified."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.static import (
    DeadBand,
    DeadBandOperator,
    DeadZoneOperator,
    FoldOperator,
    MonotoneDeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
    SoftSaturation,
    SoftSaturationOperator,
)

V = np.linspace(-3.0, 3.0, 241)
KNEES = st.floats(0.3, 50.0)


def respond(operator, v=V):
    return operator.run(v, 1.0)[0]


def test_saturation_clips():
    np.testing.assert_array_equal(respond(SaturationOperator(-1.0, 0.5)), np.clip(V, -1.0, 0.5))
    np.testing.assert_array_equal(respond(SaturationOperator(upper=0.5)), np.minimum(V, 0.5))
    np.testing.assert_array_equal(respond(SaturationOperator(lower=0.5)), np.maximum(V, 0.5))
    np.testing.assert_array_equal(respond(SaturationOperator()), V)


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
    assert respond(operator.unpack(operator.pack())) == pytest.approx(respond(operator))


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_smooth_signal_comes_back_from_its_fold_or_its_mirror_image(side, sign):
    """As it begins: on the side that is not folded, or on the other."""
    fold, rng = FoldOperator(0.3, side), np.random.default_rng(0)
    time = np.arange(2000) / 50.0
    signal = 0.3 + sign * np.cos(time) + 0.4 * np.cos(2.3 * time)
    reading = respond(fold, signal) + 0.0005 * rng.normal(size=time.size)
    assert np.all(side * (respond(fold, signal) - 0.3) >= 0.0)
    mirrored = 0.3 + side * np.sign(signal[0] - 0.3) * (signal - 0.3)
    np.testing.assert_allclose(fold.unfolded(reading), mirrored, atol=0.02)


@settings(deadline=None, max_examples=25)
@given(
    coefficients=st.lists(st.floats(-1, 1), min_size=1, max_size=4),
    center=st.floats(-1, 1),
    scale=st.floats(0.5, 2.0),
    passed=st.sampled_from([0.0, 1.0]),
)
def test_curve_is_legendre_inside_and_straight_outside(coefficients, center, scale, passed):
    operator = PolynomialCurveOperator(np.array(coefficients), center, scale, passed=passed)
    series = np.polynomial.Legendre(
        [0.0, 0.0, *coefficients], domain=[center - scale, center + scale]
    )
    inside = np.linspace(center - scale, center + scale, 51)
    np.testing.assert_allclose(
        respond(operator, inside), passed * inside + scale * series(inside), atol=1e-12
    )
    inside = inside[1:-1]  # at the ends, rounding decides which of two slopes it has
    slopes = passed + scale * series.deriv()(inside)
    np.testing.assert_allclose(operator.evaluate(inside)[1], slopes, atol=1e-10)
    for side in (-1, 1):
        end = center + side * scale
        beyond = end + side * np.array([0.0, 0.7, 5.0])
        slope = passed + scale * series.truncate(4).deriv()(end)
        straight = passed * end + scale * series(end) + slope * (beyond - end)
        np.testing.assert_allclose(respond(operator, beyond), straight, atol=1e-10)


@pytest.mark.parametrize(
    "operator",
    [
        SaturationOperator(-1.0, 0.5),
        SoftSaturationOperator(1.3, 1.7),
        DeadBandOperator(0.4, 0.1),
        DeadZoneOperator(np.array([0.5]), np.array([0.4]), np.array([1])),
        PolynomialCurveOperator(np.array([0.2, 0.1]), 0.1, 1.0),
    ],
)
def test_no_curve_has_memory(operator):
    order = np.random.default_rng(0).permutation(len(V))
    np.testing.assert_array_equal(respond(operator, V[order]), respond(operator)[order])
    assert operator.init(3.0) == ()


# ------------------------------------------------------------------------------------- dead zones

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


def test_weights_by_their_formula():
    v, weights = np.linspace(-3.0, 3.0, 241), np.array([0.5, -0.3, 0.2])
    operator = DeadZoneOperator(weights, np.array([0.4, -0.2, -1.0]), np.array([1, -1, -1]))
    expected = v + 0.5 * np.maximum(v - 0.4, 0.0)
    expected += -0.3 * np.minimum(v + 0.2, 0.0) + 0.2 * np.minimum(v + 1.0, 0.0)
    np.testing.assert_allclose(respond(operator, v), expected, atol=1e-14)
    np.testing.assert_array_equal(respond(operator.unpack(np.zeros(6)), v), v)


@settings(deadline=None, max_examples=80)
@given(curves(), values)
def test_equals_the_dead_zones(curve, v):
    zones = DeadZoneOperator(curve.weights, curve.thresholds, curve.side)
    np.testing.assert_allclose(respond(curve, v), respond(zones, v), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(np.sign(curve.side), curve.side)


@settings(deadline=None, max_examples=80)
@given(curves(), values)
def test_inverse_is_the_identity(curve, v):
    inverse = curve.inverse()
    np.testing.assert_allclose(respond(inverse, respond(curve, v)), v, rtol=0, atol=1e-9)
    np.testing.assert_allclose(respond(curve, respond(inverse, v)), v, rtol=0, atol=1e-9)
    again = inverse.inverse()
    np.testing.assert_allclose(again.thresholds, curve.thresholds, rtol=0, atol=1e-9)


@settings(deadline=None, max_examples=40)
@given(curves(), values)
def test_strictly_monotone_and_the_sum_of_its_parts(curve, v):
    v = np.unique(np.round(v, 3))
    assert np.all(np.diff(respond(curve, v)) >= 0.04 * np.diff(v))
    centre, parts = curve.parts(v)
    np.testing.assert_allclose(centre + parts.sum(axis=1), v, rtol=0, atol=1e-10)


def test_slopes_of_each_segment():
    curve = MonotoneDeadZoneOperator(np.array([3.0, 2.0, 0.5]), np.array([-2.0, -1.0, 1.0]), 2)
    v = np.array([-5.0, -1.5, 0.0, 7.0])
    _, dy = curve.sensitivities(v, np.ones((4, 1)), 1.0)
    np.testing.assert_array_equal(dy[:, 0], [3.0, 2.0, 1.0, 0.5])
    np.testing.assert_array_equal(curve.weights, [1.0, 1.0, -0.5])
    np.testing.assert_array_equal(respond(curve, v), [-12.0, -2.0, 0.0, 4.0])


@pytest.mark.parametrize("slope", [0.0, -0.1])
def test_no_inverse(slope):
    curve = MonotoneDeadZoneOperator(np.array([slope]), np.array([1.0]), 0)
    with pytest.raises(ValueError, match="slopes above zero"):
        curve.inverse()


# -------------------------------------------------------------------------------- soft saturation


@pytest.mark.parametrize(
    ("knee", "expected"),
    [(1.0, V / (1 + np.abs(V) / 0.7)), (2.0, V / np.sqrt(1 + (V / 0.7) ** 2))],
)
def test_law_of_integer_knees(knee, expected):
    np.testing.assert_allclose(respond(SoftSaturationOperator(0.7, knee)), expected, atol=1e-14)


def test_sharpest_knee_is_the_clip():
    difference = respond(SoftSaturationOperator(0.7, 50.0, 0.2)) - np.clip(V, -0.5, 0.9)
    assert np.abs(difference).max() < 0.7 * (1 - 2 ** (-1 / 50)) + 1e-12
    assert np.abs(difference[np.abs(np.abs(V - 0.2) - 0.7) > 0.1]).max() < 1e-4


@settings(deadline=None, max_examples=40)
@given(
    knee=KNEES, level=st.floats(1e-9, 1e9), center=st.floats(-1, 1), side=st.sampled_from([0, 1])
)
def test_unit_of_the_drive_does_not_matter(knee, level, center, side):
    unit = SoftSaturationOperator(1.0, knee, center, side)
    other = dataclasses.replace(unit, level=level, center=center * level)
    np.testing.assert_allclose(respond(other, level * V) / level, respond(unit), atol=1e-14)


@settings(deadline=None, max_examples=40)
@given(knee=KNEES, distance=st.floats(1e-3, 1e300), level=st.floats(1e-6, 1e6))
def test_far_drives_are_finite_and_bounded(knee, distance, level):
    operator = SoftSaturationOperator(level, knee)
    v = np.array([-distance, -1e-300, 0.0, 1e-300, distance])
    y, dy = operator.sensitivities(v, np.ones((5, 1)), 1.0)
    assert np.isfinite(y).all()
    assert np.isfinite(dy).all()
    assert np.abs(y).max() <= min(level, distance) * (1 + 1e-12)
    assert (dy[:, 0] >= 0.0).all()
    assert dy[2, 0] == 1.0
    np.testing.assert_array_equal(y, -y[::-1])


@settings(deadline=None, max_examples=40)
@given(knee=KNEES, center=st.floats(-1, 1), side=st.sampled_from([-1, 0, 1]))
def test_inverse_undoes_the_curve(knee, center, side):
    operator = SoftSaturationOperator(1.3, knee, center, side)
    v = center + np.linspace(-0.9, 0.9, 31)
    np.testing.assert_allclose(operator.unsaturated(respond(operator, v)), v, atol=1e-9)
    beyond = operator.unsaturated(np.array([center - 9.0, center + 9.0]))
    expected = [center - 9.0 if side > 0 else -np.inf, center + 9.0 if side < 0 else np.inf]
    np.testing.assert_allclose(beyond, expected)


def test_core_is_found_behind_its_hysteresis():
    time = np.linspace(0, 1, 1500)
    u = time * np.sin(40 * time) + 0.3 * np.sin(170 * time)
    plays, _ = PrandtlIshlinskiiOperator([0.0, 0.1, 0.4], [0.8, 0.5, 0.3]).run(u, 1.0)
    v = plays - 0.1
    clean = 0.1 + v / (1 + np.abs(v / 0.6) ** 1.5) ** (1 / 1.5)
    y = clean + 1e-3 * np.random.default_rng(0).normal(size=len(u))
    steps = [
        ("loop", PrandtlIshlinskii(thresholds=np.array([0.0, 0.1, 0.4]))),
        ("core", SoftSaturation()),
    ]
    model = Cascade(steps).fit(u.reshape(-1, 1), y)
    core = model.operator_.stages[1]
    assert np.sqrt(np.mean((model.predict(u.reshape(-1, 1)) - clean) ** 2)) < 3e-4
    assert (core.level, core.knee) == pytest.approx((0.6, 1.5), rel=0.05)


@settings(deadline=None, max_examples=30)
@given(center=st.floats(-0.7, 0.7), half_width=st.floats(0.03, 0.28))
def test_a_dead_band_is_found_wherever_it_is(center, half_width):
    """The bands to start from cover the range, so one of them meets it."""
    drive = np.sin(np.linspace(0.0, 6.0, 301))
    model = DeadBand().fit(drive[:, None], respond(DeadBandOperator(half_width, center), drive))
    assert model.operator_.center == pytest.approx(center, abs=1e-4)
    assert model.operator_.half_width == pytest.approx(half_width, abs=1e-4)
