import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import PlayMemory, PrandtlIshlinskiiOperator

signals = arrays(float, st.integers(2, 60), elements=st.floats(-100, 100, width=32))
VIRGIN = PlayMemory(np.empty(0), 0.0)


@st.composite
def operators(draw, lowest=0.0, first=None):
    size = draw(st.integers(1, 12))
    gaps = draw(arrays(float, size, elements=st.floats(0.01, 20)))
    gaps[0] = draw(st.floats(0, 5)) if first is None else first
    return PrandtlIshlinskiiOperator(
        np.cumsum(gaps),
        draw(arrays(float, size, elements=st.floats(lowest, 10))),
        intercept=draw(st.floats(-50, 50)),
        drive_offset=draw(st.floats(-20, 20)),
    )


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def play_sum(operator, u):
    v = np.asarray(u) - operator.drive_offset
    plays, y = np.zeros(operator.thresholds.size), []
    for value in v:
        plays = np.maximum(
            value - operator.thresholds, np.minimum(value + operator.thresholds, plays)
        )
        y.append(operator.intercept + operator.weights @ plays)
    return np.array(y)


def example(n_plays=12, **options):
    rng = np.random.default_rng(0)
    return PrandtlIshlinskiiOperator(
        np.linspace(0.0, 1.5, n_plays), rng.random(n_plays) + 0.1, 0.7, -0.2, **options
    )


def close(a, b, range_=None, tolerance=1e-12):
    range_ = max(np.ptp(b), np.abs(b).max(), 1e-300) if range_ is None else range_
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * range_)


# Theorems of the operator


@settings(deadline=None, max_examples=100)
@given(operators(lowest=-10.0), signals)
def test_equals_the_sum_of_plays(operator, u):
    scale = np.abs(operator.weights).sum() * (np.abs(u).max() + 120)
    close(run(operator, u), play_sum(operator, u), scale)


@settings(deadline=None, max_examples=50)
@given(operators(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(operator, u, seed):
    # Repeated samples, and samples on the way from one to the next, change nothing.
    rng = np.random.default_rng(seed)
    time = np.arange(u.size, dtype=float)
    extra = np.sort(rng.random(2 * u.size) * (u.size - 1))
    warped = np.sort(np.concatenate((time, time, extra)))
    slow = np.interp(warped, time, u)
    rows = np.searchsorted(warped, time)
    assert slow.size > 2 * u.size
    close(run(operator, slow)[rows], run(operator, u), 1e4)


@settings(deadline=None, max_examples=50)
@given(operators(), signals, signals)
def test_wiping_out(operator, u, loop):
    # An excursion that stays within the last branch's range leaves no trace beyond its ends.
    low, high = -101.0, 101.0
    inner = np.clip(loop, low, high)
    direct = np.concatenate((u, [high, low, high, low], u))
    detour = np.concatenate((u, [high, low], inner, [high, low], u))
    close(run(operator, detour)[-u.size :], run(operator, direct)[-u.size :], 1e4)


def test_a_wiped_loop_is_forgotten_by_the_state():
    operator = example()
    _, short = operator.run([0.0, 4.0, -3.0, 3.5], 1.0)
    _, long = operator.run([0.0, 4.0, -3.0, 2.0, -1.0, 1.0, 3.5], 1.0)
    np.testing.assert_array_equal(short.turning_points, long.turning_points)
    assert short.last == long.last


@settings(deadline=None, max_examples=50)
@given(operators(), signals, signals, st.floats(-40, 0), st.floats(1, 40))
def test_congruency(operator, first, second, low, width):
    # Loops between the same two values have one shape, whatever came before.
    loop = np.concatenate((np.linspace(low, low + width, 9), np.linspace(low + width, low, 9)))
    shapes = []
    for history in (first, second):
        y = run(operator, np.concatenate((history, loop, loop)))[-loop.size :]
        shapes.append(y - y[0])
    close(shapes[0], shapes[1], 1e4)


@settings(deadline=None, max_examples=50)
@given(operators(), signals)
def test_odd_symmetry(operator, u):
    centre = dataclasses.replace(operator, drive_offset=0.0)
    np.testing.assert_array_equal(
        run(centre, -u) - centre.intercept,
        run(dataclasses.replace(centre, intercept=-centre.intercept), u) * -1 - centre.intercept,
    )


@settings(deadline=None, max_examples=50)
@given(operators(), signals)
def test_monotone_branches(operator, u):
    y = run(operator, u)
    assert np.all(np.diff(y) * np.sign(np.diff(u)) >= -1e-10)


@settings(deadline=None, max_examples=50)
@given(operators(), signals)
def test_order_is_preserved(operator, u):
    assert np.all(run(operator, u + 0.5) >= run(operator, u) - 1e-10)


@settings(deadline=None, max_examples=50)
@given(
    arrays(float, st.integers(2, 12), elements=st.integers(-9, 9).map(float)),
    st.lists(st.integers(1, 80), min_size=1, max_size=8, unique=True).map(sorted),
    st.integers(0, 2**32 - 1),
)
def test_dissipation(u, quarters, seed):
    # A play of half-width r takes the work w r each time it moves by 1. It moves at least from one
    # end of the loop to the other and back. All kinks lie on the grid of samples, so the trapezoid
    # is exact.
    thresholds = np.array(quarters) / 4.0
    weights = np.random.default_rng(seed).random(thresholds.size) + 0.1
    operator = PrandtlIshlinskiiOperator(thresholds, weights)
    period = np.append(u, u[0])
    steps = np.concatenate([[u[0]], *map(straight, period[:-1], period[1:])])
    y = run(operator, np.concatenate((steps, steps, steps)))[-steps.size :]
    work = np.trapezoid(steps, y)
    least = 2.0 * weights * thresholds * np.maximum(np.ptp(u) - 2.0 * thresholds, 0.0)
    assert work >= least.sum() - 1e-9


def straight(start, stop):
    return start + np.sign(stop - start) * 0.25 * np.arange(1, 4 * abs(stop - start) + 1)


def test_loop_area_of_one_play():
    operator = PrandtlIshlinskiiOperator([0.5], [2.0])
    u = np.array([0.0, 3.0, 2.0, -3.0, -2.0, 3.0])
    area = np.trapezoid(u[1:], run(operator, u)[1:])
    # Parallelogram: width 2 r, height w (2 A - 2 r).
    assert area == pytest.approx(2 * 0.5 * 2.0 * (6.0 - 1.0), rel=1e-12)


def test_no_weight_beyond_the_excursion_matters():
    u = np.sin(np.linspace(0.0, 20.0, 300))
    full = PrandtlIshlinskiiOperator([0.0, 0.5, 1.0, 7.0], [1.0, 2.0, 3.0, 4.0])
    used = PrandtlIshlinskiiOperator([0.0, 0.5], [1.0, 2.0])
    np.testing.assert_allclose(run(full, u), run(used, u), rtol=0, atol=1e-14)


def test_excursion_to_a_threshold_and_just_beyond():
    operator = PrandtlIshlinskiiOperator([0.0, 0.5, 1.0], [1.0, 10.0, 100.0])
    y = run(operator, [0.5, 1.0, 1.25, 0.25, -0.75, -1.25])
    # Loading: dead zones open at 0.5 and 1; unloading: at 1.25 - 1 and 1.25 - 2.
    np.testing.assert_allclose(y, [0.5, 6.0, 33.75, 32.75, 21.75, -33.75], rtol=0, atol=1e-13)


# State


@settings(deadline=None, max_examples=50)
@given(operators(), signals, st.integers(0, 60))
def test_chunks_equal_the_whole(operator, u, cut):
    whole, end = operator.run(u, 1.0)
    first, state = operator.run(u[:1], 1.0)
    second, state = operator.run(u[1 : 1 + cut], 1.0, state)
    third, state = operator.run(u[1 + cut :], 1.0, state)
    np.testing.assert_array_equal(np.concatenate((first, second, third)), whole)
    np.testing.assert_array_equal(state.turning_points, end.turning_points)
    assert state.last == end.last


def test_steps_equal_the_run():
    operator, u = example(), np.random.default_rng(1).standard_normal(50)
    state, y = operator.init(u[0]), []
    for value in u:
        state, output = operator.step(state, value, 1.0)
        y.append(output)
    np.testing.assert_array_equal(y, run(operator, u))


def test_state_passed_in_is_left_alone():
    operator = example()
    _, state = operator.run([0.0, 3.0, -2.0, 1.0], 1.0)
    before = state.turning_points.copy()
    operator.run([5.0, -5.0, 4.0], 1.0, state)
    np.testing.assert_array_equal(state.turning_points, before)
    assert state.last == pytest.approx(1.2)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_first_loading(initial_state):
    operator, u0 = example(), 1.3
    y = run(operator, [u0], operator.init(u0, initial_state))
    expected = operator.intercept + operator.weights @ np.maximum(1.5 - operator.thresholds, 0.0)
    assert y[0] == pytest.approx(expected, rel=1e-14)


def test_rest_remembers_the_first_loading():
    operator = example()
    y = run(operator, [0.0], operator.init(2.0, "rest"))
    assert y[0] == pytest.approx(run(operator, [2.0, 0.0])[1], rel=1e-14)
    assert y[0] != pytest.approx(run(operator, [0.0], operator.init(2.0, "zero"))[0], rel=1e-3)


def test_no_samples():
    operator = example()
    y, state = operator.run([], 1.0)
    assert y.shape == (0,)
    assert run(operator, [operator.drive_offset], state)[0] == operator.intercept
    y, dy = operator.linearize(np.empty(0), np.empty((0, 2)), 1.0)
    assert dy.shape == (0, 16)


def test_a_state_from_more_plays_is_accepted():
    # More turning points than an operator of one play needs.
    u = 2.0 * (-1.0) ** np.arange(200) * np.linspace(1.0, 0.1, 200)
    _, state = example(100).run(u, 1.0)
    small = PrandtlIshlinskiiOperator([0.3], [1.0], drive_offset=-0.2)
    after = np.array([1.5, -1.5])
    assert state.turning_points.size > 20
    close(run(small, after, state), run(small, np.append(u, after))[-2:])


@settings(deadline=None, max_examples=50)
@given(operators(), signals, signals)
def test_plays_and_state_are_the_same_memory(operator, u, after):
    _, state = operator.run(u, 1.0)
    plays = operator.plays(state)
    v = u - operator.drive_offset
    expected = np.zeros(plays.size)
    for value in v:
        expected = np.clip(expected, value - operator.thresholds, value + operator.thresholds)
    np.testing.assert_allclose(plays, expected, rtol=0, atol=1e-12)
    again = operator.state_from_plays(plays, u[-1])
    np.testing.assert_allclose(operator.plays(again), plays, rtol=0, atol=1e-12)
    close(run(operator, after, again), run(operator, after, state), 1e4)


def test_plays_that_cannot_be_reached():
    operator = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match=r"'plays' parameter .* reachable"):
        operator.state_from_plays([0.0, 1.5], 0.0)
    with pytest.raises(ValueError, match=r"'plays' parameter .* reachable"):
        operator.state_from_plays([0.5, 0.5], 0.0)
    with pytest.raises(ValueError, match=r"'plays' parameter .* reachable"):
        operator.state_from_plays([0.0], 0.0)


# Derivatives


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
@pytest.mark.parametrize("m", [0, 1, 3])
def test_linearize_against_central_differences(m, initial_state):
    rng = np.random.default_rng(5)
    operator = example(non_negative=False)
    u = np.cumsum(rng.standard_normal(400)) * 0.3 + 0.5
    du = rng.standard_normal((400, m)) if m else np.empty((400, 0))
    y, dy = operator.linearize(u, du, 1.0, initial_state)
    np.testing.assert_array_equal(y, run(operator, u, operator.init(u[0], initial_state)))
    assert dy.shape == (400, m + operator.n_parameters)
    assert dy.flags.c_contiguous
    h, vector = 1e-6, operator.pack()

    def output(parameters, drive):
        changed = operator.unpack(parameters)
        return run(changed, drive, changed.init(drive[0], initial_state))

    for j in range(m):
        numeric = output(vector, u + h * du[:, j]) - output(vector, u - h * du[:, j])
        np.testing.assert_allclose(dy[:, j], numeric / (2 * h), rtol=1e-6, atol=1e-6)
    for j, step in enumerate(h * np.eye(vector.size)):
        numeric = output(vector + step, u) - output(vector - step, u)
        np.testing.assert_allclose(dy[:, m + j], numeric / (2 * h), rtol=1e-6, atol=1e-6)


def test_stuck_plays_hold_their_tangent():
    operator = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 10.0])
    u = np.array([3.0, 2.0, 1.5, 0.0])
    du = np.array([[1.0], [2.0], [3.0], [4.0]])
    _, dy = operator.linearize(u, du, 1.0)
    # The second play moves at first, sticks twice, and moves again.
    np.testing.assert_array_equal(dy[:, 0], [11.0, 12.0, 13.0, 44.0])
    np.testing.assert_array_equal(dy[:, 1:3], [[3, 2], [2, 2], [1.5, 2], [0, 1]])


def test_pack_and_unpack():
    operator = example(3)
    vector = operator.pack()
    np.testing.assert_array_equal(vector, [*operator.weights, 0.7, -0.2])
    changed = operator.unpack(vector + 1.0)
    np.testing.assert_array_equal(changed.pack(), vector + 1.0)
    np.testing.assert_array_equal(changed.thresholds, operator.thresholds)
    np.testing.assert_array_equal(operator.pack(), vector)


@pytest.mark.parametrize(("non_negative", "lower"), [(True, 0.0), (False, -np.inf)])
def test_bound_of_the_weights(non_negative, lower):
    specs = example(non_negative=non_negative).parameter_specs()
    assert list(specs) == ["weights", "intercept", "drive_offset"]
    assert specs["weights"].lower == lower
    assert specs["weights"].linear
    assert specs["intercept"].linear
    assert not specs["drive_offset"].linear


# Inverse


@settings(deadline=None, max_examples=100)
@given(operators(lowest=0.05, first=0.0), signals)
def test_inverse_of_forward_is_the_identity(operator, u):
    assume(np.ptp(u) > 0.1)
    close(run(operator.inverse(), run(operator, u)), u, tolerance=1e-12)


@settings(deadline=None, max_examples=100)
@given(operators(lowest=0.05, first=0.0), signals)
def test_forward_of_inverse_is_the_identity(operator, y):
    scale = np.abs(y).max() + abs(operator.intercept) + operator.weights.sum()
    close(run(operator, run(operator.inverse(), y)), y, scale)


@settings(deadline=None, max_examples=50)
@given(operators(lowest=0.05, first=0.0), signals, signals)
def test_inverse_with_a_history(operator, history, u):
    _, state = operator.run(history, 1.0)
    y = run(operator, u, state)
    inverse = operator.inverse()
    close(run(inverse, y, operator.inverse_state(state)), u, 100.0)


@settings(deadline=None, max_examples=50)
@given(operators(lowest=0.05, first=0.0), signals)
def test_inverse_twice_is_the_operator(operator, u):
    close(run(operator.inverse().inverse(), u), run(operator, u), tolerance=1e-11)


def test_inverse_with_negative_weights():
    # Partial sums 2, 0.5, 1: monotone, though a weight is negative.
    operator = PrandtlIshlinskiiOperator([0.0, 0.4, 0.8], [2.0, -1.5, 0.5], non_negative=False)
    u = np.random.default_rng(2).standard_normal(1000)
    close(run(operator.inverse(), run(operator, u)), u)


def test_analytic_inverse_agrees_with_bisection():
    operator, target = example(), 1.9
    history = np.array([0.0, 2.0, -1.0, 0.5])
    low, high = -10.0, 10.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if run(operator, np.append(history, middle))[-1] < target:
            low = middle
        else:
            high = middle
    response = np.append(run(operator, history), target)
    assert run(operator.inverse(), response)[-1] == pytest.approx(middle, rel=1e-12)


@pytest.mark.parametrize(
    ("thresholds", "weights"),
    [([0.1, 1.0], [1.0, 1.0]), ([0.0, 1.0], [0.0, 1.0]), ([0.0, 1.0], [1.0, -1.0])],
)
def test_no_inverse(thresholds, weights):
    with pytest.raises(ValueError, match="strictly monotone"):
        PrandtlIshlinskiiOperator(thresholds, weights).inverse()


# Units, arrays, errors


@pytest.mark.parametrize("drive_unit", [1e-150, 1e-9, 1.0, 1e9, 1e150])
@pytest.mark.parametrize("response_unit", [1e-100, 1.0, 1e100])
def test_unit_equivariance(drive_unit, response_unit):
    operator, u = example(), np.random.default_rng(7).standard_normal(500)
    other = PrandtlIshlinskiiOperator(
        operator.thresholds * drive_unit,
        operator.weights * (response_unit / drive_unit),
        operator.intercept * response_unit,
        operator.drive_offset * drive_unit,
    )
    y = run(operator, u) * response_unit
    close(run(other, u * drive_unit), y)
    close(run(other.inverse(), y), u * drive_unit, 3.0 * drive_unit)
    du = np.random.default_rng(8).standard_normal((500, 2))
    _, dy = operator.linearize(u, du, 1.0)
    _, other_dy = other.linearize(u * drive_unit, du * drive_unit, 1.0)
    # The rounded drive may land on the other side of a kink, but not often.
    different = np.abs(other_dy[:, 0] - dy[:, 0] * response_unit) > 1e-9 * response_unit
    assert different.mean() < 0.01


def test_inputs_are_left_alone_and_may_be_read_only():
    thresholds, weights = np.array([0.0, 0.5]), np.array([1.0, 2.0])
    u, du = np.random.default_rng(9).standard_normal((2, 100))
    du = du.reshape(-1, 1)
    for array in (thresholds, weights, u, du):
        array.flags.writeable = False
    operator = PrandtlIshlinskiiOperator(thresholds, weights)
    expected = run(PrandtlIshlinskiiOperator([0.0, 0.5], [1.0, 2.0]), u.copy())
    np.testing.assert_array_equal(run(operator, u), expected)
    y, _ = operator.linearize(u, du, 1.0)
    np.testing.assert_array_equal(y, expected)
    strided = np.repeat(u, 2)[::2]
    np.testing.assert_array_equal(run(operator, strided), expected)
    np.testing.assert_array_equal(run(operator, list(u)), expected)


def test_operator_does_not_share_arrays():
    thresholds, weights = np.array([0.0, 0.5]), np.array([1.0, 2.0])
    operator = PrandtlIshlinskiiOperator(thresholds, weights)
    weights[:] = thresholds[:] = 9.0
    assert run(operator, [1.0])[0] == 2.0
    with pytest.raises(ValueError, match="read-only"):
        operator.weights[0] = 3.0


def test_pickle():
    operator, u = example(non_negative=False), np.random.default_rng(10).standard_normal(100)
    y, state = operator.run(u, 1.0)
    again, state_again = pickle.loads(pickle.dumps((operator, state)))
    assert not again.non_negative
    np.testing.assert_array_equal(run(again, u), y)
    np.testing.assert_array_equal(run(again, u, state_again), run(operator, u, state))


@pytest.mark.parametrize("thresholds", [[], [-1.0, 0.0], [1.0, 0.5], [0.0, np.nan], [[0.0, 1.0]]])
def test_thresholds_are_checked(thresholds):
    with pytest.raises(ValueError, match="'thresholds' parameter of PrandtlIshlinskiiOperator"):
        PrandtlIshlinskiiOperator(thresholds, np.ones(np.size(thresholds)))


def test_weights_are_checked():
    with pytest.raises(ValueError, match="one value for each of the 2 thresholds"):
        PrandtlIshlinskiiOperator([0.0, 1.0], [1.0])
