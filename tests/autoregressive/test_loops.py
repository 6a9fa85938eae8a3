"""The compiled loops: against plain Python, loops over dictionaries, and their derivatives."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.autoregressive import _polynomial
from skhyst.autoregressive._network_step import exponentials
from skhyst.autoregressive._polynomial import (
    plan_polynomial,
    polynomial_run,
    polynomial_tangents,
)
from skhyst.autoregressive._runs import Lags, Start
from skhyst.autoregressive._steps import LinearStep
from skhyst.autoregressive._tree_step import NODE, TreesStep, rounded_at

INPUT_LAGS = ((0, 0), (0, 2), (1, 1))
OUTPUT_LAGS = (1, 3)
NO_SHORT_WAY = np.empty(0, dtype=np.int64)
N_SIGNALS = len(INPUT_LAGS) + len(OUTPUT_LAGS)
TABLE = np.array(
    [
        (*product, *[-1] * (4 - size))
        for size in range(5)
        for product in combinations_with_replacement(range(N_SIGNALS), size)
    ]
)


def by_hand(terms, coefficients, inputs, initial, n_past=0):
    past = list(initial)
    for k in range(n_past, len(inputs)):
        lagged = [inputs[max(k - lag, 0), column] for column, lag in INPUT_LAGS]
        signals = np.array([*lagged, *(past[-lag] for lag in OUTPUT_LAGS), 1.0])  # -1 is one
        past.append(coefficients @ np.prod(signals[terms], axis=1))
    return np.array(past[len(initial) :])


def make(seed, n_terms=12, n_samples=60):
    rng = np.random.default_rng(seed)
    terms = TABLE[np.sort(rng.choice(len(TABLE), n_terms, replace=False))]
    coefficients = rng.uniform(-0.25, 0.25, n_terms)
    inputs = rng.uniform(-1.0, 1.0, (n_samples, 2))
    plan = plan_polynomial(terms, INPUT_LAGS, OUTPUT_LAGS, 2)
    return terms, plan, coefficients, inputs, rng.uniform(-0.5, 0.5, 3)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(0, 5))
def test_run_is_the_sum_of_the_products(seed, n_terms, n_past):
    terms, plan, coefficients, inputs, initial = make(seed, n_terms)
    expected = by_hand(terms, coefficients, inputs, initial, n_past)
    for kind in (plan, plan._replace(short=NO_SHORT_WAY)):
        y, good = polynomial_run(kind, coefficients, inputs, initial, 1e9, n_past)
        assert good
        assert len(y) == len(inputs) - n_past
        np.testing.assert_allclose(y, expected, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("short", [True, False])
def test_run_longer_than_a_block_and_in_two_parts(short):
    _, plan, coefficients, inputs, initial = make(3, n_samples=1700)
    plan = plan._replace(short=plan.short if short else NO_SHORT_WAY)
    assert len(plan.short) == (10 if short else 0)
    y, _ = polynomial_run(plan, coefficients, inputs, initial, 1e9)
    first, _ = polynomial_run(plan, coefficients, inputs[:700], initial, 1e9)
    second, _ = polynomial_run(plan, coefficients, inputs, first[-3:], 1e9, n_past=700)
    np.testing.assert_array_equal(np.append(first, second), y)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.3, 1.0]))
def test_tangents_are_the_derivatives(seed, pull):
    """With the complex step, which has no cancellation."""
    terms, plan, coefficients, inputs, initial = make(seed)
    measured = np.random.default_rng(seed + 1).uniform(-0.5, 0.5, len(inputs))
    n_terms = len(terms)
    d_initial = np.zeros((3, n_terms + 3))
    d_initial[:, n_terms:] = np.eye(3)
    y, dy, good = polynomial_tangents(
        plan, coefficients, inputs, initial, d_initial, 1e9, 0, measured, pull
    )
    assert good
    if pull == 0.0:
        np.testing.assert_allclose(y, polynomial_run(plan, coefficients, inputs, initial)[0])
    for q in range(n_terms + 3):
        step = np.zeros(n_terms + 3, dtype=complex)
        step[q] = 1e-30j
        past = list(initial + step[n_terms:])
        values = []
        for k in range(len(inputs)):
            rows = np.concatenate([np.repeat(inputs[:1], max(2 - k, 0), 0), inputs[: k + 1]])
            value = by_hand(terms, coefficients + step[:n_terms], rows, past[-3:], len(rows) - 1)[0]
            values.append(value)
            past.append(value + pull * (measured[k] - value))
        np.testing.assert_allclose(dy[:, q], np.imag(values) / 1e-30, rtol=1e-8, atol=1e-11)


def test_what_leaves_the_bound_is_cut_off():
    plan = plan_polynomial([[1, 1], [0, -1]], [(0, 0)], [1], 1)
    inputs = np.ones((50, 1))
    for bound in (10.0, 1e300):
        y, good = polynomial_run(plan, np.ones(2), inputs, np.zeros(1), bound)
        same, dy, also = polynomial_tangents(
            plan, np.ones(2), inputs, np.zeros(1), np.zeros((1, 2)), bound
        )
        assert not good
        assert not also
        cut = y == bound
        assert 0 < np.argmax(cut) < 50
        assert (np.abs(y[~cut]) < bound).all()
        assert np.all(np.diff(cut.astype(int)) >= 0)
        np.testing.assert_allclose(same, y)
        assert not dy[cut].any()


def test_model_without_terms_is_zero():
    plan = plan_polynomial(np.empty((0, 2), dtype=int), [(0, 0)], [1], 1)
    y, good = polynomial_run(plan, np.empty(0), np.ones((4, 1)), np.ones(1))
    assert good
    np.testing.assert_array_equal(y, np.zeros(4))


# ---------------------------------------------------------------------- compiled and plain Python


@pytest.mark.parametrize("function", ["_run", "_run_short", "_tangents"])
def test_compiled_polynomial_equals_python(monkeypatch, function):
    _, plan, coefficients, inputs, initial = make(3)
    if function == "_run":
        plan = plan._replace(short=NO_SHORT_WAY)

    def call():
        if function == "_tangents":
            slopes = np.zeros((3, len(coefficients)))
            return polynomial_tangents(plan, coefficients, inputs, initial, slopes)
        return polynomial_run(plan, coefficients, inputs, initial)

    compiled = call()
    monkeypatch.setattr(_polynomial, function, getattr(_polynomial, function).py_func)
    for a, b in zip(compiled, call(), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)


# --------------------------------------------------------------------------- what a loop rests on


def test_exponential():
    x = np.concatenate([np.linspace(-700.0, 700.0, 9999), np.linspace(-1e-3, 1e-3, 101)])
    found, powers = x.copy(), np.empty(x.size)
    exponentials(found, x.size, powers.view(np.int64), powers)
    np.testing.assert_allclose(found, np.exp(x), rtol=2e-15)
    beyond = np.array([-1e300, 1e300, -np.inf, np.inf])
    exponentials(beyond, 4, powers.view(np.int64), powers)
    np.testing.assert_allclose(beyond, np.exp([-700.0, 700.0, -700.0, 700.0]), rtol=2e-15)


@pytest.mark.parametrize("value", [1e30, -1e30, np.nan])
def test_outputs_are_bounded(value):
    step = LinearStep(Lags(((0, 0),), (1,), 1), np.array([1.0, 0.0]), 0.0)
    inputs = np.array([[0.0], [0.0], [value], [0.0], [0.0]])
    y, good = step.run(Start(inputs, 0, np.zeros(1)), 7.0)
    assert not good
    np.testing.assert_array_equal(y, [0, 0, -7.0 if value < 0 else 7.0, 0, 0])


def stumps(centre=(0.0, 0.0), scale=(1.0, 1.0), offset=0.0):
    """1 or 2 beyond 0.5 of the input, and 10 or 20 beyond 0 of the last output."""
    leaves = [[(1.0, -1, 0), (2.0, -1, 0)], [(10.0, -1, 0), (20.0, -1, 0)]]
    nodes = np.array([(0.5, 0, 2), *leaves[0], (0.0, 1, 5), *leaves[1]], dtype=NODE)
    lags, arrays = Lags(((0, 0),), (1,), 1), (np.array(centre), np.array(scale), nodes)
    return TreesStep(lags, *arrays, np.array([0, 3]), offset, 1.0)


def test_trees_are_summed_over_features_that_are_scaled():
    Z = np.array([[0.5, 0.0], [0.6, 0.0], [0.5, 0.1], [9.0, 9.0]])
    np.testing.assert_array_equal(stumps().rows(Z), [11.0, 12.0, 21.0, 22.0])
    near = np.array([[0.5 + 1e-12, 0.0]])
    assert stumps().rows(near) == 12.0
    assert stumps((1.0, 0.0), (-1.0, 1.0)).rows(near) == 11.0
    assert stumps((1.0, 0.0), (-0.5, 1.0)).rows(near) == 12.0


@given(st.floats(-1e30, 1e30), st.sampled_from([-1, 0, 1]), st.sampled_from([0.0, 0.5, 0.75, 1.0]))
def test_thresholds_for_numbers_that_are_rounded(threshold, up, part):
    """Near a threshold, at floats of either precision and half way between the single ones."""
    single = np.float32(threshold)
    next_one = float(np.nextafter(single, np.float32(np.inf)))
    number = float(single) + part * (next_one - float(single))
    number = np.nextafter(number, up * np.inf) if up else number
    for own in (threshold, number, float(single)):
        moved = rounded_at(np.array([own]))[0]
        assert (number <= moved) == (float(np.float32(number)) <= own)


def test_trees_see_their_own_output():
    start = Start(np.array([[0.0], [1.0], [0.0], [0.0]]), 0, np.array([-1.0]))
    # 1 + 10 below; 2 + 10 below; 1 + 10, always below zero, and cut off where beyond 9
    y, good = stumps(offset=-21.5).run(start, 9.0)
    np.testing.assert_array_equal(y, [-9.0, -9.0, -9.0, -9.0])
    assert not good
    np.testing.assert_array_equal(stumps(offset=-11.5).run(start, 99.0)[0], [-0.5, 0.5, 9.5, 9.5])
