"""Polynomial recursions: against a loop over dictionaries, and their derivatives."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.autoregressive import _polynomial_loops as _polynomial
from skhyst.autoregressive._polynomial_loops import (
    plan_polynomial,
    polynomial_run,
    polynomial_tangents,
)

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
        total = 0.0
        for factors, coefficient in zip(terms, coefficients, strict=True):
            for factor in factors[factors >= 0]:
                if factor < len(INPUT_LAGS):
                    column, lag = INPUT_LAGS[factor]
                    coefficient = coefficient * inputs[max(k - lag, 0), column]
                else:
                    coefficient = coefficient * past[-OUTPUT_LAGS[factor - len(INPUT_LAGS)]]
            total = total + coefficient
        past.append(total)
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
        y, n_good = polynomial_run(kind, coefficients, inputs, initial, 1e9, n_past)
        assert n_good == len(y) == len(inputs) - n_past
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
    y, dy, n_good = polynomial_tangents(
        plan, coefficients, inputs, initial, d_initial, 1e9, 0, measured, pull
    )
    assert n_good == len(y)
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
        y, n_good = polynomial_run(plan, np.ones(2), inputs, np.zeros(1), bound)
        same, dy, also = polynomial_tangents(
            plan, np.ones(2), inputs, np.zeros(1), np.zeros((1, 2)), bound
        )
        assert 0 < n_good == also < 50
        assert np.isfinite(y).all()
        assert np.abs(y[:n_good]).max() <= bound
        np.testing.assert_array_equal(y[n_good:], bound)
        np.testing.assert_allclose(same, y)
        assert not dy[n_good:].any()


@pytest.mark.parametrize("function", ["_run", "_run_short", "_tangents"])
def test_compiled_equals_python(monkeypatch, function):
    _, plan, coefficients, inputs, initial = make(3)
    by_table = plan._replace(short=NO_SHORT_WAY)
    calls = {
        "_run": lambda: polynomial_run(by_table, coefficients, inputs, initial),
        "_run_short": lambda: polynomial_run(plan, coefficients, inputs, initial),
        "_tangents": lambda: polynomial_tangents(
            plan, coefficients, inputs, initial, np.zeros((3, len(coefficients)))
        ),
    }
    compiled = calls[function]()
    monkeypatch.setattr(_polynomial, function, getattr(_polynomial, function).py_func)
    for a, b in zip(compiled, calls[function](), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13)


def test_model_without_terms_is_zero():
    plan = plan_polynomial(np.empty((0, 2), dtype=int), [(0, 0)], [1], 1)
    y, n_good = polynomial_run(plan, np.empty(0), np.ones((4, 1)), np.ones(1))
    assert n_good == 4
    np.testing.assert_array_equal(y, 0.0)
