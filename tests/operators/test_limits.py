"""Limits of the drive side: backlash, dead band, slew limit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.hysteresis import BacklashOperator, PrandtlIshlinskiiOperator, SlewLimitOperator
from skhyst.static import DeadBandOperator

DT = 0.01


@pytest.fixture
def u():
    return np.cumsum(np.random.default_rng(1).normal(size=400)) / 10


def test_backlash_is_one_play(u):
    expected, _ = PrandtlIshlinskiiOperator([0.3], [1.0]).run(u, DT)
    np.testing.assert_allclose(BacklashOperator(0.3).run(u, DT)[0], expected, atol=1e-14)


@given(a=st.floats(0.01, 0.5), b=st.floats(0.01, 0.5))
@settings(deadline=None, max_examples=20)
def test_gaps_in_series_add_up(a, b):
    u = np.cumsum(np.random.default_rng(2).normal(size=300)) / 10
    twice = BacklashOperator(b).run(BacklashOperator(a).run(u, DT)[0], DT)[0]
    np.testing.assert_allclose(twice, BacklashOperator(a + b).run(u, DT)[0], atol=1e-12)


def test_dead_band_and_clipping_add_up_to_the_drive(u):
    band = DeadBandOperator(half_width=0.4, center=0.1)
    np.testing.assert_allclose(band.run(u, DT)[0] + np.clip(u, -0.3, 0.5), u, atol=1e-14)


def test_slew_limit_of_a_slow_drive_is_the_drive(u):
    fastest = np.abs(np.diff(u)).max() / DT
    np.testing.assert_array_equal(SlewLimitOperator(fastest).run(u, DT)[0], u)


@pytest.mark.parametrize("part", [0.02, 0.2, 0.7])
def test_slew_limit_solves_its_law(u, part):
    u, fine = u[:120], 100
    rate = part * np.abs(np.diff(u)).max() / DT
    time = DT * np.arange(len(u))
    signal = np.interp(np.linspace(0.0, time[-1], fine * (len(u) - 1) + 1), time, u)
    y, reach, slow = signal[0], rate * DT / fine, [signal[0]]
    for value in signal[1:]:
        y += np.clip(value - y, -reach, reach)
        slow.append(y)
    exact = SlewLimitOperator(rate).run(u, DT)[0]
    # the plain steps are late by less than one of them
    np.testing.assert_allclose(exact, slow[::fine], atol=3.0 * np.abs(np.diff(u)).max() / fine)
    assert np.abs(np.diff(exact)).max() <= rate * DT * (1 + 1e-12)
