"""Saturation with a rounded knee: its law, its limits, its inverse."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.compose import Cascade
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.static import SoftSaturation, SoftSaturationOperator

V = np.linspace(-3.0, 3.0, 241)
KNEES = st.floats(0.3, 50.0)


def curve(operator, v=V):
    return operator.run(v, 1.0)[0]


@pytest.mark.parametrize(
    ("knee", "expected"),
    [(1.0, V / (1 + np.abs(V) / 0.7)), (2.0, V / np.sqrt(1 + (V / 0.7) ** 2))],
)
def test_law_of_integer_knees(knee, expected):
    np.testing.assert_allclose(curve(SoftSaturationOperator(0.7, knee)), expected, atol=1e-14)


def test_sharpest_knee_is_the_clip():
    difference = curve(SoftSaturationOperator(0.7, 50.0, 0.2)) - np.clip(V, -0.5, 0.9)
    assert np.abs(difference).max() < 0.7 * (1 - 2 ** (-1 / 50)) + 1e-12
    assert np.abs(difference[np.abs(np.abs(V - 0.2) - 0.7) > 0.1]).max() < 1e-4


@settings(deadline=None, max_examples=40)
@given(
    knee=KNEES, level=st.floats(1e-9, 1e9), center=st.floats(-1, 1), side=st.sampled_from([0, 1])
)
def test_unit_of_the_drive_does_not_matter(knee, level, center, side):
    unit = SoftSaturationOperator(1.0, knee, center, side)
    other = dataclasses.replace(unit, level=level, center=center * level)
    np.testing.assert_allclose(curve(other, level * V) / level, curve(unit), atol=1e-14)


@settings(deadline=None, max_examples=40)
@given(knee=KNEES, distance=st.floats(1e-3, 1e300), level=st.floats(1e-6, 1e6))
def test_far_drives_are_finite_and_bounded(knee, distance, level):
    operator = SoftSaturationOperator(level, knee)
    v = np.array([-distance, -1e-300, 0.0, 1e-300, distance])
    y, dy = operator.linearize(v, np.ones((5, 1)), 1.0)
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
    np.testing.assert_allclose(operator.inverse(curve(operator, v)), v, atol=1e-9)
    beyond = operator.inverse(np.array([center - 9.0, center + 9.0]))
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
