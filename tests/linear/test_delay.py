"""Delay: a shift of the straight lines between samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.linear import DelayOperator

DT = 0.01
U = 0.4 + np.cumsum(np.random.default_rng(0).normal(size=50))


@settings(deadline=None, max_examples=30)
@given(delay=st.floats(0.0, 0.7), initial_state=st.sampled_from(["rest", "zero"]))
def test_shifts_the_straight_lines(delay, initial_state):
    operator = DelayOperator(delay)
    before = U[0] if initial_state == "rest" else 0.0
    # what lies before the record is a sample of its own, one interval back
    time = DT * np.arange(-1, len(U))
    expected = np.interp(DT * np.arange(len(U)) - delay, time, np.r_[before, U])
    y, _ = operator.run(U, DT, operator.init(U[0], initial_state))
    np.testing.assert_allclose(y, expected, atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 7, 49, 50, 80])
def test_whole_samples_are_an_exact_shift(count):
    y, _ = DelayOperator(count * 0.25).run(U, 0.25)
    np.testing.assert_array_equal(y, np.r_[np.full(count, U[0]), U][: len(U)])


def test_state_holds_no_more_than_the_delay():
    _, state = DelayOperator(0.035).run(np.tile(U, 100), DT)
    assert np.size(state) <= 5
