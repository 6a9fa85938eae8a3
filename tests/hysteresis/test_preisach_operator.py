import dataclasses
import itertools
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import PlayMemory, PrandtlIshlinskiiOperator, PreisachOperator
from skhyst.hysteresis._relay_grid import cell_indices

signals = arrays(float, st.integers(2, 40), elements=st.floats(-12, 12, width=32))


@st.composite
def operators(draw, lowest=0.0):
    n = draw(st.integers(2, 8))
    gaps = draw(arrays(float, n, elements=st.floats(0.1, 5)))
    levels = np.cumsum(gaps) - draw(st.floats(0, 20))
    weights = st.floats(lowest, 10)
    return PreisachOperator(
        levels,
        draw(arrays(float, n * (n - 1) // 2, elements=weights)),
        draw(st.sampled_from([0, n - 1]).flatmap(lambda m: arrays(float, m, elements=weights))),
        draw(st.floats(-50, 50)),
        draw(st.sampled_from([0.0, -np.inf, np.inf, levels[0], 0.5 * (levels[0] + levels[-1])])),
    )


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def example(n=7, **options):
    rng = np.random.default_rng(0)
    return PreisachOperator(
        np.linspace(-1.5, 2.0, n),
        rng.random(n * (n - 1) // 2),
        rng.random(n - 1),
        0.7,
        0.2,
        **options,
    )


def close(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


# Theorems


def relay_sum(operator, u, fine):
    """Add up relays, ``fine`` squared in each cell; those on the diagonal itself do not count."""
    x, width = operator.levels, np.diff(operator.levels)
    part = (np.arange(fine) + 0.5) / fine
    alphas, betas, weights = [], [], []
    for k, (i, j) in enumerate(zip(*cell_indices(x.size), strict=True)):
        alpha, beta = np.meshgrid(x[i] + part * width[i], x[j] + part * width[j], indexing="ij")
        inside = alpha > beta
        alphas.append(alpha[inside])
        betas.append(beta[inside])
        weights.append(np.full(inside.sum(), operator.weights[k] / inside.sum()))
    alpha, beta, weight = map(np.concatenate, (alphas, betas, weights))
    relays = np.where(alpha + beta > 2 * np.clip(operator.center, x[0], x[-1]), -1.0, 1.0)
    y = []
    for value in u:
        relays[alpha <= value] = 1.0
        relays[beta >= value] = -1.0
        ramps = 2 * np.clip((value - x[:-1]) / width, 0, 1) - 1
        y.append(operator.intercept + weight @ relays + operator.reversible @ ramps)
    return np.array(y)


@pytest.mark.parametrize("center", [0.2, 0.0, -0.9, -np.inf, np.inf])
def test_equals_relays_on_a_fine_grid(center):
    operator = dataclasses.replace(example(), center=center)
    u = 1.3 * np.random.default_rng(1).normal(size=150)
    y = run(operator, u)
    errors = [np.abs(relay_sum(operator, u, fine) - y).max() for fine in (10, 40)]
    assert errors[1] < 0.01 * np.ptp(y)
    assert errors[1] < 0.5 * errors[0]


@settings(deadline=None, max_examples=60)
@given(operators(lowest=-10.0), signals)
def test_output_is_the_weighted_mean_state_of_the_cells(operator, u):
    rows, state = operator.basis(u)
    y, end = operator.run(u, 1.0)
    close(rows @ operator.pack(), y)
    np.testing.assert_array_equal(state.turning_points, end.turning_points)
    assert state.last == end.last


@settings(deadline=None, max_examples=40)
@given(operators(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(operator, u, seed):
    rng = np.random.default_rng(seed)
    time = np.arange(u.size, dtype=float)
    extra = np.sort(rng.random(2 * u.size) * (u.size - 1))
    warped = np.sort(np.concatenate((time, time, extra)))
    slow = run(operator, np.interp(warped, time, u))
    close(slow[np.searchsorted(warped, time)], run(operator, u), 1e-8)


@settings(deadline=None, max_examples=40)
@given(operators(), signals, signals)
def test_wiping_out(operator, u, loop):
    direct = np.concatenate((u, [30.0, -30.0], u))
    detour = np.concatenate((u, loop, [30.0, -30.0], u))
    close(run(operator, detour)[-u.size :], run(operator, direct)[-u.size :])


def test_a_wiped_loop_is_forgotten_by_the_state():
    operator = example()
    _, short = operator.run([0.2, 1.4, -1.3, 1.1], 1.0)
    _, long = operator.run([0.2, 1.4, -1.3, 0.8, -1.0, 1.0, 1.1], 1.0)
    np.testing.assert_array_equal(short.turning_points, long.turning_points)
    assert short.last == long.last


@settings(deadline=None, max_examples=40)
@given(operators(), signals, signals, st.floats(-12, 0), st.floats(0.5, 12))
def test_congruency(operator, first, second, low, width):
    """Loops between the same two values have one shape, whatever came before."""
    loop = np.concatenate((np.linspace(low, low + width, 9), np.linspace(low + width, low, 9)))
    shapes = []
    for history in (first, second):
        y = run(operator, np.concatenate((history, loop, loop)))[-loop.size :]
        shapes.append(y - y[0])
    close(shapes[0], shapes[1])


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_monotone_branches(operator, u):
    assert np.all(np.diff(run(operator, u)) * np.sign(np.diff(u)) >= -1e-10)


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_order_is_preserved(operator, u):
    assert np.all(run(operator, u + 0.5) >= run(operator, u) - 1e-10)


@settings(deadline=None, max_examples=30)
@given(operators(), signals)
def test_dissipation(operator, u):
    """The work of a closed loop is not negative: its integral by the Everett function."""
    period = np.append(u, u[0])
    steps = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(period)])
    y = run(operator, np.concatenate((steps, steps)))[-steps.size :]
    work = np.trapezoid(steps, y)
    scale = np.ptp(steps) * (np.ptp(y) + 1e-9)
    assert work >= -1e-3 * scale


def test_area_of_the_major_loop():
    """It is twice the density times the width alpha - beta, over the half plane."""
    operator = PreisachOperator([0.0, 1.0, 2.0], [0.0, 3.0, 0.0], [0.4, 0.7])
    u = np.concatenate((np.linspace(0, 2, 2001), np.linspace(2, 0, 2001)))
    area = np.trapezoid(u, run(operator, u))
    assert area == pytest.approx(2.0 * 3.0 * (1.5 - 0.5), rel=1e-6)


def test_symmetric_density_gives_odd_loops():
    operator = PreisachOperator(
        np.linspace(-1, 1, 4), [0.5, 0.3, 0.2, 0.9, 0.3, 0.5], [0.1, 0.4, 0.1]
    )
    u = np.random.default_rng(3).normal(size=500)
    close(run(operator, -u), -run(operator, u), 1e-12)
    assert run(operator, [0.0])[0] == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("r", [0.0, 0.5])
def test_diagonal_lines_are_plays(r):
    """A density on the line alpha - beta = 2 r is a play of threshold r."""
    n = 121
    levels = np.linspace(-1.2, 1.2, n)
    width = levels[1] - levels[0]
    i, j = cell_indices(n)
    weights = np.zeros(i.size)
    reversible = np.zeros(n - 1)
    if r > 0.0:
        weights[i - j == round(2 * r / width)] = 0.5 * width
    else:
        reversible[:] = 0.5 * width
    relays = PreisachOperator(levels, weights, reversible)
    plays = PrandtlIshlinskiiOperator([r], [1.0])
    u = 0.35 * np.random.default_rng(4).normal(size=400)
    u = np.clip(u, -0.65, 0.65)  # on the line, alpha and beta stay within the levels
    y, expected = run(relays, u), plays.run(u, 1.0, PlayMemory(np.empty(0), 0.0))[0]
    assert np.abs(y - expected).max() < (1e-12 if r == 0.0 else 0.6 * width)


def test_everett_function():
    operator, u = example(), np.array([-9.0, 0.9, -0.4])
    y = run(operator, u)
    assert y[1] - y[0] == pytest.approx(2 * operator.everett(0.9, -9.0), rel=1e-12)
    assert y[1] - y[2] == pytest.approx(2 * operator.everett(0.9, -0.4), rel=1e-12)
    total = operator.weights.sum() + operator.reversible.sum()
    assert operator.everett(99.0, -99.0) == pytest.approx(total, rel=1e-12)
    assert operator.everett(0.3, 0.3) == 0.0


def test_continuous():
    u = np.repeat([-1.2, 1.7, -0.8, 1.1, -0.3, 0.6], 2)
    steps = np.concatenate([np.linspace(a, b, 4000) for a, b in itertools.pairwise(u)])
    y = run(example(), steps)
    assert np.abs(np.diff(y)).max() < 30 * np.abs(np.diff(steps)).max()


# First loading, saturation, state


def test_drive_of_one_sign_starts_all_down():
    """With the centre at the lowest level, the first loading is the rising major branch."""
    operator = PreisachOperator(np.linspace(0, 150, 6), np.arange(15.0), np.arange(5.0))
    up = np.linspace(0, 150, 40)
    total = operator.weights.sum() + operator.reversible.sum()
    y = run(operator, np.concatenate((up, [0.0], up)))
    assert y[0] == -total
    close(y[:40], y[41:], 1e-12)
    for center in (-np.inf, -20.0):
        close(run(dataclasses.replace(operator, center=center), up), y[:40], 1e-12)


@settings(deadline=None, max_examples=30)
@given(operators(), signals)
def test_saturates_outside_the_levels(operator, u):
    low, high = operator.levels[[0, -1]]
    np.testing.assert_array_equal(run(operator, u), run(operator, np.clip(u, low, high)))


def test_demagnetised_by_decaying_swings():
    """Swings that decay slowly about the centre lead to the virgin state."""
    operator = example()
    u = 0.2 + 1.8 * (1 - np.arange(20000) / 20000) * (-1.0) ** np.arange(20000)
    _, state = operator.run(np.append(u, 0.2), 1.0)
    after = np.array([0.5, -0.3, 1.2])
    close(run(operator, after, state), run(operator, after, operator.init(0.2)), 2e-3)


def test_no_samples_and_long_states():
    operator = example()
    y, state = operator.run([], 1.0)
    assert y.shape == (0,)
    assert state.turning_points.size == 0
    y, dy = operator.linearize(np.empty(0), np.empty((0, 2)), 1.0)
    assert dy.shape == (0, 2 + operator.n_parameters)
    u = 1.2 * (-1.0) ** np.arange(2000) * np.linspace(1.0, 0.1, 2000)
    y, state = operator.run(u, 1.0)
    assert state.turning_points.size > 1900
    rows, _ = operator.basis(u)
    close(rows @ operator.pack(), y)


def test_pickle_with_tables():
    operator = example(non_negative=False)
    y = run(operator, [0.3, -1.0, 1.0])
    again = pickle.loads(pickle.dumps(operator))
    np.testing.assert_array_equal(run(again, [0.3, -1.0, 1.0]), y)
    assert again.parameter_specs()["weights"].lower == -np.inf


@pytest.mark.parametrize("m", [0, 3])
@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_tangents_are_central_differences(m, initial_state):
    operator, rng = example(), np.random.default_rng(6)
    u = rng.normal(size=500)
    du = rng.normal(size=(500, m))
    _, dy = operator.linearize(u, du, 1.0, initial_state)
    h = 1e-7
    for c in range(m):
        ends = []
        for shift in (h, -h):
            signal = u + shift * du[:, c]
            ends.append(run(operator, signal, operator.init(signal[0], initial_state)))
        close(dy[:, c], (ends[0] - ends[1]) / (2 * h), 2e-6)


@pytest.mark.parametrize("drive_unit", [1e-150, 1e-9, 1e9, 1e150])
@pytest.mark.parametrize("response_unit", [1e-100, 1e100])
def test_unit_equivariance(drive_unit, response_unit):
    operator, u = example(), np.random.default_rng(7).normal(size=300)
    other = PreisachOperator(
        operator.levels * drive_unit,
        operator.weights * response_unit,
        operator.reversible * response_unit,
        operator.intercept * response_unit,
        operator.center * drive_unit,
    )
    close(run(other, u * drive_unit) / response_unit, run(operator, u), 1e-10)
    close(other.basis(u * drive_unit)[0], operator.basis(u)[0], 1e-10)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"levels": [0.0]}, "two or more ascending"),
        ({"levels": [0.0, 0.0, 1.0]}, "two or more ascending"),
        ({"weights": [1.0, 2.0]}, "3 cells"),
        ({"reversible": [1.0]}, "'reversible' parameter .* 2 intervals"),
    ],
)
def test_wrong_fields(fields, message):
    good = {"levels": [0.0, 1.0, 2.0], "weights": [1.0, 1.0, 1.0], "reversible": ()}
    with pytest.raises(ValueError, match=message):
        PreisachOperator(**{**good, **fields})
