"""Plays and stops: definition, memory, work, inverse, recovery of plants."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from skhyst.hysteresis import MaxwellSlip, PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.preprocessing import StopOperators

signals = arrays(float, st.integers(2, 60), elements=st.floats(-100, 100, width=32))
FORMS = pytest.mark.parametrize("form", ["play", "stop"])


@st.composite
def operators(draw, form="play", lowest=0.0, first=None):
    size = draw(st.integers(1, 12))
    gaps = draw(arrays(float, size, elements=st.floats(0.01, 20)))
    gaps[0] = draw(st.floats(0, 5)) if first is None else first
    return PrandtlIshlinskiiOperator(
        np.cumsum(gaps),
        draw(arrays(float, size, elements=st.floats(lowest, 10))),
        intercept=draw(st.floats(-50, 50)),
        drive_offset=draw(st.floats(-20, 20)),
        form=form,
    )


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def play_values(thresholds, v):
    """Return the plays of a signal by their definition, (n_samples, n_plays)."""
    plays, rows = np.zeros(len(thresholds)), []
    for value in v:
        plays = np.maximum(value - thresholds, np.minimum(value + thresholds, plays))
        rows.append(plays)
    return np.array(rows)


def by_definition(operator, u):
    v, r = np.asarray(u)[:, None] - operator.drive_offset, operator.thresholds
    parts = play_values(r, v[:, 0])
    if operator.form == "stop":
        parts = np.where(r > 0.0, v - parts, v)
    return operator.intercept + parts @ operator.weights


def scale_of(operator, u):
    return np.abs(operator.weights).sum() * (np.abs(u).max() + 20) + abs(operator.intercept)


def example(n_plays=12, **options):
    rng = np.random.default_rng(0)
    weights = rng.random(n_plays) + 0.1
    return PrandtlIshlinskiiOperator(np.linspace(0.0, 1.5, n_plays), weights, 0.7, -0.2, **options)


def close(a, b, scale=None, tolerance=1e-12):
    scale = max(np.ptp(b), np.abs(b).max()) if scale is None else scale
    # subnormal numbers have no relative accuracy
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * max(scale, 1e-300))


# Definition


@FORMS
@settings(deadline=None, max_examples=100)
@given(st.data(), signals)
def test_equals_the_sum_of_plays_or_stops(form, data, u):
    operator = data.draw(operators(form, lowest=-10.0))
    close(run(operator, u), by_definition(operator, u), scale_of(operator, u))


THRESHOLDS = {
    "one": np.array([0.0]),
    "one_positive": np.array([0.7]),
    "even": np.linspace(0.0, 2.0, 25),
    "crowded": np.append(0.0, np.geomspace(1e-9, 2.0, 60)),
    "crowded_far": 2.0 - np.geomspace(1.0, 1e-9, 60),
    "repeated": np.array([0.0, 0.5, 0.5, 0.5, 1.0, 1.0]),
    "all_zero": np.zeros(3),
    "tiny": np.linspace(0.0, 1e-305, 4),
}
DRIVES = {
    "noise": np.random.default_rng(4).standard_normal(4000),
    "walk": 0.1 * np.cumsum(np.random.default_rng(5).standard_normal(4000)),
    "decay": 3.0 * np.cos(2.5 * np.arange(4000)) * np.linspace(1.0, 0.0, 4000),
    "growth": 3.0 * np.cos(2.5 * np.arange(4000)) * np.linspace(0.0, 1.0, 4000),
    "steps": np.round(np.random.default_rng(6).standard_normal(4000)),
}
EVERY_GRID = pytest.mark.parametrize("grid", THRESHOLDS)


def on_grid(grid):
    weights = np.random.default_rng(3).random(THRESHOLDS[grid].size) + 0.1
    return PrandtlIshlinskiiOperator(THRESHOLDS[grid], weights, -1.0, 0.3)


@EVERY_GRID
@pytest.mark.parametrize("drive", DRIVES)
def test_thresholds_of_all_kinds(grid, drive):
    """A long run is the sum of plays, and chunks of it equal the whole to the bit."""
    operator, u = on_grid(grid), DRIVES[drive]
    y, end = operator.run(u, 1.0)
    close(y, by_definition(operator, u), np.ptp(y))
    parts, state = [], operator.init(0.3)
    for start in range(0, u.size, 7):
        part, state = operator.run(u[start : start + 7], 1.0, state)
        parts.append(part)
    np.testing.assert_array_equal(np.concatenate(parts), y)
    np.testing.assert_array_equal(state[0], end[0])
    assert state[1] == end[1]


@EVERY_GRID
def test_excursions_that_end_at_a_threshold(grid):
    """From a turning point, as on the first loading, each play gives one dead zone."""
    operator = on_grid(grid)
    r, w = operator.thresholds, operator.weights
    ends = np.concatenate((r, np.nextafter(r, np.inf), np.nextafter(r, 0.0), [1e3, 0.4]))
    for end in ends:
        expected = w @ np.maximum(end - r, 0.0)
        y = run(operator, 0.3 + np.array([end, -5.0, -5.0 + 2.0 * end, 5.0, 5.0 - 2.0 * end]))
        assert y[0] == pytest.approx(expected - 1.0, rel=1e-13)
        if end < 5.0:
            np.testing.assert_allclose([y[2] - y[1], y[3] - y[4]], 2.0 * expected, atol=1e-12)


# Memory


@EVERY_GRID
def test_memory_of_a_long_decay_stays_bounded_and_forgets_no_play(grid):
    operator = on_grid(grid)
    u = 0.3 + 3.0 * (-1.0) ** np.arange(20_000) * np.linspace(1.0, 0.0, 20_000)
    _, state = operator.run(u, 1.0)
    assert state[0].size <= 4 * operator.thresholds.size + 16
    expected = play_values(operator.thresholds, u - 0.3)[-1]
    np.testing.assert_allclose(operator.plays(state), expected, rtol=0, atol=1e-15)


def test_a_state_from_more_plays_is_accepted_and_a_broken_one_is_cut():
    u = 2.0 * (-1.0) ** np.arange(200) * np.linspace(1.0, 0.1, 200)
    _, state = example(100).run(u, 1.0)
    assert state[0].size > 20
    small = PrandtlIshlinskiiOperator([0.3], [1.0], drive_offset=-0.2)
    after = np.array([1.5, -1.5])
    close(run(small, after, state), run(small, np.append(u, after))[-2:])
    broken, nested = np.array([3.0, -2.0, 1.0, -2.5]), np.array([3.0, -2.0, 1.0])
    found, expected = (run(small, after, (p, 0.0)) for p in (broken, nested))
    np.testing.assert_array_equal(found, expected)


@EVERY_GRID
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_stay_harmless(grid, value):
    operator, u = on_grid(grid), np.random.default_rng(6).standard_normal(500)
    clean = run(operator, u[:100])
    u[100::50] = value
    y, state = operator.run(u, 1.0)
    np.testing.assert_array_equal(y[:100], clean)
    assert state[0].size <= 4 * operator.thresholds.size + 16


def test_first_loading_is_remembered_at_rest_only():
    operator = example()
    expected = operator.intercept + operator.weights @ np.maximum(1.5 - operator.thresholds, 0.0)
    for initial_state in ("rest", "zero"):
        y = run(operator, [1.3], operator.init(1.3, initial_state))
        assert y[0] == pytest.approx(expected, rel=1e-14)
    rest, zero = (run(operator, [0.0], operator.init(2.0, name))[0] for name in ("rest", "zero"))
    assert rest == pytest.approx(run(operator, [2.0, 0.0])[1], rel=1e-14)
    assert rest != pytest.approx(zero, rel=1e-3)


@FORMS
@settings(deadline=None, max_examples=50)
@given(st.data(), signals, signals)
def test_plays_and_state_are_the_same_memory(form, data, u, after):
    operator = data.draw(operators(form))
    _, state = operator.run(u, 1.0)
    plays = operator.plays(state)
    close(plays, play_values(operator.thresholds, u - operator.drive_offset)[-1], 1.0)
    again = operator.state_from_plays(plays, u[-1])
    close(operator.plays(again), plays, 1.0)
    close(run(operator, after, again), run(operator, after, state), 1e4)


@pytest.mark.parametrize("plays", [[0.0, 1.5], [0.5, 0.5], [0.0]])
def test_plays_that_cannot_be_reached(plays):
    operator = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 1.0])
    with pytest.raises(ValueError, match=r"'plays' parameter .* reachable"):
        operator.state_from_plays(plays, 0.0)


# Work


@FORMS
@settings(deadline=None, max_examples=50)
@given(
    st.data(),
    arrays(float, st.integers(2, 12), elements=st.integers(-9, 9).map(float)),
    st.lists(st.integers(1, 80), min_size=1, max_size=8, unique=True).map(sorted),
)
def test_work_of_a_closed_loop(form, data, u, quarters):
    """An element takes the work w r each time its play moves by 1.

    It moves at least from one end of the loop to the other and back. All kinks lie on the grid of
    samples, so the trapezoid is exact.
    """
    thresholds = np.array(quarters) / 4.0
    weights = data.draw(arrays(float, thresholds.size, elements=st.floats(0.1, 1.1)))
    operator = PrandtlIshlinskiiOperator(thresholds, weights, form=form)
    steps = [
        a + np.sign(b - a) * 0.25 * np.arange(4 * abs(b - a) + 1)
        for a, b in pairwise(np.append(u, u[0]))
    ]
    path = np.concatenate(steps)
    y = run(operator, np.concatenate((path, path, path)))[-path.size :]
    work = np.trapezoid(path, y) if form == "play" else np.trapezoid(y, path)
    least = 2.0 * weights * thresholds * np.maximum(np.ptp(u) - 2.0 * thresholds, 0.0)
    assert work >= least.sum() - 1e-9


@FORMS
def test_loop_area_of_one_element(form):
    """A parallelogram: of a play 2 r wide and w (2 A - 2 r) high, of a stop the other way round."""
    operator = PrandtlIshlinskiiOperator([0.5], [2.0], form=form)
    u = np.array([0.0, 3.0, 2.0, -3.0, -2.0, 3.0])
    y = run(operator, u)
    area = np.trapezoid(u[1:], y[1:]) if form == "play" else np.trapezoid(y[1:], u[1:])
    assert area == pytest.approx(2 * 0.5 * 2.0 * (6.0 - 1.0), rel=1e-12)


# Inverse


@FORMS
@settings(deadline=None, max_examples=100)
@given(st.data(), signals, signals)
def test_inverse_undoes_the_model(form, data, u, history):
    operator = data.draw(operators(form, lowest=0.05, first=0.0))
    assume(np.ptp(u) > 0.1)
    inverse = operator.inverse()
    y, state = run(operator, u), operator.run(history, 1.0)[1]
    after, state_of_inverse = run(operator, u, state), operator.inverse_state(state)
    if form == "play":
        scales = None, np.abs(u).max() + abs(operator.intercept) + operator.weights.sum(), 100.0
    else:  # the more springs yield, the softer what is left
        softest = operator.weights.sum() / operator.weights[0]
        scales = (softest * (120 + scale_of(operator, u)),) * 3
    close(run(inverse, y), u, scales[0])
    close(run(operator, run(inverse, u)), u, scales[1])
    close(run(inverse, after, state_of_inverse), u, scales[2])
    close(run(inverse.inverse(), u), y, scales[0], 1e-11)


def test_inverse_with_negative_weights():
    # Partial sums 2, 0.5, 1: monotone, though a weight is negative.
    operator = PrandtlIshlinskiiOperator([0.0, 0.4, 0.8], [2.0, -1.5, 0.5], non_negative=False)
    u = np.random.default_rng(2).standard_normal(1000)
    close(run(operator.inverse(), run(operator, u)), u)


@pytest.mark.parametrize(
    ("form", "thresholds", "weights"),
    [
        ("play", [0.1, 1.0], [1.0, 1.0]),
        ("play", [0.0, 1.0], [0.0, 1.0]),
        ("play", [0.0, 1.0], [1.0, -1.0]),
        ("stop", [0.2, 0.5, 0.7], [0.1, 0.2, 0.3]),
        ("stop", [0.2, 0.5, 0.7], [0.7, 0.1, 0.1]),
    ],
)
def test_no_inverse(form, thresholds, weights):
    needs = "stiffnesses that have not yielded" if form == "stop" else "of the weights"
    with pytest.raises(ValueError, match=f"strictly monotone.*{needs}"):
        PrandtlIshlinskiiOperator(thresholds, weights, form=form).inverse()


# Estimator


def springs(u, thresholds, weights, intercept):
    """Force of springs in parallel, each behind a slider that yields at its threshold."""
    force, total, last = np.zeros(len(thresholds) - 1), [], 0.0
    for value in u:
        force = np.clip(force + (value - last), -thresholds[1:], thresholds[1:])
        last = value
        total.append(intercept + weights[0] * value + weights[1:] @ force)
    return np.array(total)


def displacements(u, thresholds, weights, intercept):
    return intercept + play_values(thresholds, u) @ weights


@pytest.mark.slow
@FORMS
def test_recovery_and_standard_errors(form, assert_recovered):
    """Weights of plants that are summed here come back, with standard errors that are true."""
    law = springs if form == "stop" else displacements

    def plant(seed):
        rng = np.random.default_rng(seed)
        unit = 10.0 ** rng.uniform(-6, 6)
        u = np.cumsum(rng.normal(size=1500)) / 8.0
        thresholds = np.array([0.0, 0.15, 0.35, 0.6]) * np.ptp(u) / 2.0
        truth = np.append(rng.uniform(0.3, 1.0, 4), 0.4)
        clean = unit * law(u, thresholds, truth[:4], 0.4)
        noise = 0.005 * np.ptp(clean)
        y = clean + noise * rng.normal(size=u.size)
        return u, clean, y, noise, unit * truth, {"thresholds": thresholds}

    assert_recovered(PrandtlIshlinskii(form=form), map(plant, range(25)))


THESE = np.array([0.0, 0.2, 0.5, 0.9])


@pytest.fixture
def force():
    """Springs that are moved to and fro: displacement, as a column, and force."""
    turns = np.random.default_rng(3).uniform(0.3, 1.0, 16) * (-1.0) ** np.arange(16) * 2.0
    u = np.interp(np.arange(1500), np.linspace(0, 1499, 17), np.append(0.0, turns))
    return u.reshape(-1, 1), springs(u, THESE, np.array([0.3, 1.0, 1.0, 1.0]), 0.2)


def test_free_weights_of_either_form_give_one_linear_model(force):
    X, y = force
    y = np.tanh(y) + 0.1 * np.random.default_rng(4).normal(size=len(y))
    plays, stops = (
        PrandtlIshlinskii(thresholds=THESE, form=form, non_negative=False).fit(X, y)
        for form in ("play", "stop")
    )
    plain = make_pipeline(StopOperators(thresholds=THESE[1:]), LinearRegression()).fit(X, y)
    np.testing.assert_allclose(stops.predict(X), plain.predict(X), atol=1e-8)
    np.testing.assert_allclose(stops.predict(X), plays.predict(X), atol=1e-8)
    np.testing.assert_allclose(stops.weights_[1:], -plays.weights_[1:], atol=1e-6)


def test_a_force_needs_stops(force):
    X, y = force
    error = {form: PrandtlIshlinskii(form=form).fit(X, y).fit_error_ for form in ("play", "stop")}
    assert error["stop"] < 0.03 * error["play"]


@pytest.mark.parametrize("kind", ["plays", "elements"])
def test_errors_of_weights_hold_those_of_thresholds_that_were_found(kind):
    """Least squares in weights and thresholds together, with the slopes of a finite change."""
    dt = 0.01
    t = dt * np.arange(600)
    u = np.sin(2 * np.pi * t / (200 * dt)) * np.linspace(2.0, 0.5, len(t))
    form = "play" if kind == "plays" else "stop"
    y = PrandtlIshlinskiiOperator([0.0, 0.7], [0.6, 0.3], form=form).run(u, dt)[0]
    y += 0.01 * np.random.default_rng(1).normal(size=len(u))
    options = {"thresholds": "auto", "dt": dt}
    model = PrandtlIshlinskii(2, **options)
    if kind == "elements":
        model = MaxwellSlip(2, fit_damping=False, fit_stiffness=True, **options)
    model.fit(u[:, None], y)
    found, columns = model.operator_, []
    for name in ("weights", "thresholds", "stiffness", "intercept"):
        values = np.atleast_1d(getattr(found, name, []))
        for i in np.flatnonzero((values != 0.0) | (name == "intercept")):
            runs = []
            for step in (1e-6, -1e-6):
                moved = values + step * (np.arange(values.size) == i)
                moved = moved if np.ndim(getattr(found, name)) else moved[0]
                runs.append(replace(found, **{name: moved}).run(u, dt)[0])
            columns.append((runs[0] - runs[1]) / 2e-6)
    J = np.array(columns).T
    residual = y - found.run(u, dt)[0]
    covariance = residual @ residual / (len(y) - J.shape[1]) * np.linalg.inv(J.T @ J)
    n = np.count_nonzero(found.weights)
    errors = [model.params_std_white_[f"weights[{i}]"] for i in np.flatnonzero(found.weights)]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance))[:n], rtol=0.05)
