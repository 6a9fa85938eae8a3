"""A sum of stops, evaluated as a sum of plays."""

import dataclasses
import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import PlayMemory, PrandtlIshlinskiiOperator
from skhyst.preprocessing import StopOperators

signals = arrays(float, st.integers(2, 60), elements=st.floats(-100, 100, width=32))


@st.composite
def operators(draw, first=None):
    size = draw(st.integers(1, 12))
    gaps = draw(arrays(float, size, elements=st.floats(0.01, 20)))
    gaps[0] = draw(st.sampled_from([0.0, 0.7])) if first is None else first
    return PrandtlIshlinskiiOperator(
        np.cumsum(gaps),
        draw(arrays(float, size, elements=st.floats(0.05, 10))),
        intercept=draw(st.floats(-50, 50)),
        drive_offset=draw(st.floats(-20, 20)),
        form="stop",
    )


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def close(a, b, scale, tolerance=1e-12):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale)


def size(operator, u):
    return operator.weights.sum() * (np.abs(u).max() + 20) + abs(operator.intercept)


@settings(deadline=None, max_examples=60)
@given(operators(), signals)
def test_equals_the_sum_of_stops(operator, u):
    stops = StopOperators(thresholds=operator.thresholds).fit_transform(
        (u - operator.drive_offset).reshape(-1, 1)
    )
    # the first column is the drive: the spring of threshold zero, which never yields
    elastic = operator.weights[operator.thresholds == 0.0].sum()
    expected = operator.intercept + elastic * stops[:, 0] + stops[:, 1:] @ operator.weights
    close(run(operator, u), expected, size(operator, u))


@settings(deadline=None, max_examples=30)
@given(operators(), signals)
def test_equals_plays_with_other_weights(operator, u):
    w = np.where(operator.thresholds > 0.0, operator.weights, 0.0)
    plays = PrandtlIshlinskiiOperator(
        np.append(0.0, operator.thresholds),
        np.append(operator.weights.sum(), -w),
        operator.intercept,
        operator.drive_offset,
        non_negative=False,
    )
    close(run(operator, u), run(plays, u), size(operator, u))


@settings(deadline=None, max_examples=30)
@given(operators(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(operator, u, seed):
    time = np.arange(u.size, dtype=float)
    extra = np.random.default_rng(seed).random(2 * u.size) * (u.size - 1)
    warped = np.sort(np.concatenate((time, time, extra)))
    rows = np.searchsorted(warped, time)
    close(run(operator, np.interp(warped, time, u))[rows], run(operator, u), size(operator, u))


@settings(deadline=None, max_examples=40)
@given(
    arrays(float, st.integers(2, 12), elements=st.integers(-9, 9).map(float)),
    st.lists(st.integers(1, 80), min_size=1, max_size=8, unique=True).map(sorted),
    st.integers(0, 2**32 - 1),
)
def test_dissipation(u, quarters, seed):
    """The work of a force over a closed loop of the displacement: loops run clockwise."""
    thresholds = np.array(quarters) / 4.0
    weights = np.random.default_rng(seed).random(thresholds.size) + 0.1
    operator = PrandtlIshlinskiiOperator(thresholds, weights, form="stop")
    # all kinks lie on the grid of samples, so the trapezoid is exact
    steps = [a + np.sign(b - a) * 0.25 * np.arange(4 * abs(b - a) + 1) for a, b in pairwise(u)]
    path = np.concatenate([*steps, *(step[::-1] for step in reversed(steps))])
    force = run(operator, np.concatenate([path, path, path]))[-path.size :]
    work = np.trapezoid(force, path)
    assert work >= -1e-9
    assert work > 0.01 or thresholds[0] >= 0.5 * np.ptp(u)


def test_work_of_one_stop():
    operator = PrandtlIshlinskiiOperator([0.5], [2.0], form="stop")
    u = np.array([0.0, 3.0, 2.0, -3.0, -2.0, 3.0])
    # parallelogram: height 2 w r, width 2 A - 2 r
    assert np.trapezoid(run(operator, u)[1:], u[1:]) == pytest.approx(2 * 2.0 * 0.5 * 5.0)


def test_without_a_spring_of_threshold_zero_the_force_saturates():
    operator = PrandtlIshlinskiiOperator([0.5, 1.0], [2.0, 3.0], form="stop")
    y = run(operator, np.array([0.0, 0.25, 0.75, 50.0, 1e6]))
    np.testing.assert_allclose(y, [0.0, 1.25, 3.25, 4.0, 4.0], rtol=1e-9)


@settings(deadline=None, max_examples=60)
@given(operators(first=0.0), signals)
def test_inverse_of_forward_is_the_identity(operator, u):
    stiffness = operator.weights.sum() / operator.weights[0]
    close(run(operator.inverse(), run(operator, u)), u, stiffness * (120 + size(operator, u)))


def test_inverse_with_a_history_and_after_pickling():
    operator = PrandtlIshlinskiiOperator([0.0, 0.4, 0.9], [0.5, 2.0, 1.0], 0.3, -0.1, form="stop")
    rng = np.random.default_rng(0)
    _, state = operator.run(rng.normal(size=50), 1.0)
    u = rng.normal(size=200)
    again = pickle.loads(pickle.dumps(operator))
    assert again.form == "stop"
    y = run(again, u, state)
    close(run(again.inverse(), y, again.inverse_state(state)), u, 10.0)


@pytest.mark.parametrize("weights", [[0.1, 0.2, 0.3], [0.7, 0.1, 0.1]])
def test_no_inverse_where_no_spring_is_left(weights):
    operator = PrandtlIshlinskiiOperator([0.2, 0.5, 0.7], weights, form="stop")
    with pytest.raises(ValueError, match=r"springs of positive sum left .* strictly monotone"):
        operator.inverse()


def test_state_is_that_of_the_plays():
    operator = PrandtlIshlinskiiOperator([0.0, 0.4, 0.9], [0.5, 2.0, 1.0], form="stop")
    u = np.random.default_rng(1).normal(size=60)
    _, state = operator.run(u, 1.0)
    plays = dataclasses.replace(operator, form="play")
    _, expected = plays.run(u, 1.0)
    np.testing.assert_array_equal(state.turning_points, expected.turning_points)
    np.testing.assert_array_equal(operator.plays(state), plays.plays(expected))
    again = operator.state_from_plays(operator.plays(state), u[-1])
    after = np.random.default_rng(2).normal(size=30)
    np.testing.assert_allclose(run(operator, after, again), run(operator, after, state), atol=1e-12)
    assert isinstance(again, PlayMemory)


def test_form_is_checked():
    with pytest.raises(ValueError, match="'form' parameter of PrandtlIshlinskiiOperator"):
        PrandtlIshlinskiiOperator([0.0], [1.0], form="stops")
