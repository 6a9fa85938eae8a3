r"""Polynomial models of past inputs and past outputs: terms, free runs, exact derivatives.

A model is a sum of terms, each a coefficient times a product of lagged signals. The recursion

.. math:: y(k) = \sum_g w_g(k) \, \prod_j y(k - l_{gj})

has one group for each distinct product of outputs; its weight ``w_g`` is the sum of the input
factors of all its terms. The weights do not depend on outputs, so they are computed in advance, a
block of samples at a time. The groups are ordered by the power of ``y(k-1)`` and summed by Horner's
rule: from one sample to the next only one product and one sum per power depend on each other.
Models up to the third degree with at most one output lag besides 1, the common ones, have a loop
without tables.
"""

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..operators import as_signal, sum_of_products
from ._runs import Lags, clipped

_BLOCK = 500  # samples; the weights of a block stay in the first-level cache


def candidate_terms(groups, width, include_bias):
    """Return the table (n_terms, width) of all products of lagged signals; absent factors are -1.

    A group is (signals by position, highest degree). It adds the products, up to its degree, of its
    own signals and those of earlier groups with at least one of its own, lower degrees first.
    """
    rows, known = [()] if include_bias else [], []
    for signals, degree in groups:
        known += signals
        rows += [
            product
            for size in range(1, degree + 1)
            for product in combinations_with_replacement(known, size)
            if not set(product).isdisjoint(signals)
        ]
    table = np.full((len(rows), max(width, 1)), -1, dtype=np.int64)
    for row, product in zip(table, rows, strict=True):
        row[: len(product)] = product
    return table


def term_name(factors, names, n_inputs, n_outputs):
    """Return a term as text, such as ``y(k-1) u(k-2)^2``: outputs, then inputs, then noise."""
    counts = Counter(int(factor) for factor in factors if factor >= 0)
    ends = (n_inputs, n_inputs + n_outputs)
    ranked = sorted(counts, key=lambda f: (1 if f < ends[0] else 0 if f < ends[1] else 2, f))
    powers = [names[f] + (f"^{counts[f]}" if counts[f] > 1 else "") for f in ranked]
    return " ".join(powers) or "1"


def term_products(Z, terms):
    """Return the values (n_samples, n_terms) of terms from lagged signals."""
    # terms first: each product is one contiguous row
    columns = np.ascontiguousarray(Z.T)
    out = np.ones((len(terms), len(Z)), dtype=columns.dtype)
    for row, factors in zip(out, terms, strict=True):
        for factor in factors[factors >= 0]:
            row *= columns[factor]
    return out.T


class Polynomial(NamedTuple):
    """The terms of a model in the order in which the loops need them.

    Arrays of lags are padded with 0 beyond the counts.
    """

    n_columns: int  # of the inputs
    start: int  # number of outputs before a record that are needed: the longest output lag
    reach: int  # the longest input lag
    inputs: tuple  # of each term: number of inputs, their columns and lags (n_terms, degree), group
    outputs: tuple  # of each group: number of outputs and their lags (n_groups, degree)
    older: tuple  # the same for outputs older than y(k-1); and (n_powers, 3), one row per power of
    # y(k-1), highest first: the group without older outputs, ends of those with one and with more
    short: np.ndarray  # (10,): group of y(k-1)^i y(k-lag)^j, i + j <= 3, n_groups for none; or (0,)
    older_lag: int  # that lag; 1 if there is none


def plan_polynomial(terms, input_lags, output_lags, n_columns):
    """Arrange the terms of a model, see ``Lags``, for :func:`polynomial_run`.

    ``terms`` (n_terms, degree) has the factors of each term: positions in the list of lagged
    signals, inputs first, then outputs; -1 stands for the factor one.
    """
    terms = np.atleast_2d(np.asarray(terms, dtype=np.int64))
    degree, n_inputs = terms.shape[1], len(input_lags)
    inputs = [[input_lags[f] for f in row if 0 <= f < n_inputs] for row in terms]
    products = [
        tuple(sorted(int(output_lags[f - n_inputs]) for f in row if f >= n_inputs)) for row in terms
    ]
    n_powers = 1 + max((product.count(1) for product in products), default=0)
    bare = {(1,) * power for power in range(n_powers)}
    groups = sorted({*products, *bare}, key=lambda p: (-p.count(1), len(p), p))
    place = {product: g for g, product in enumerate(groups)}
    ones = np.array([product.count(1) for product in groups])
    n_outputs, n_older = _counts(groups), _counts(groups) - ones
    powers = [
        [
            place[(1,) * p],
            *(1 + np.flatnonzero((ones == p) & (n_older <= most))[-1] for most in (1, degree)),
        ]
        for p in reversed(range(n_powers))
    ]
    older = [[lag for lag in product if lag > 1] for product in groups]
    older_lags = {lag for lags in older for lag in lags}
    lag, short = max(older_lags, default=0), []
    if len(older_lags) <= 1 and n_outputs.max() <= 3:
        pairs = [(1,) * i + (lag,) * j for i in range(4) for j in range(4 - i)]
        short = [place.get(product, len(groups)) for product in pairs]
    columns = _table([[column for column, _ in row] for row in inputs], degree)
    lags = _table([[lag for _, lag in row] for row in inputs], degree)
    group = np.array([place[product] for product in products], dtype=np.int64)
    tables = n_older, _table(older, degree), np.array(powers)
    return Polynomial(
        n_columns=int(n_columns),
        start=max((int(lag) for lag in output_lags), default=0),
        reach=max((int(lag) for _, lag in input_lags), default=0),
        inputs=(_counts(inputs), columns, lags, group),
        outputs=(n_outputs, _table(groups, degree)),
        older=tuple(table.astype(np.uint64) for table in tables),
        short=np.array(short, dtype=np.int64),
        older_lag=max(lag, 1),
    )


def _counts(rows):
    return np.array([len(row) for row in rows], dtype=np.int64)


def _table(rows, width):
    out = np.zeros((len(rows), width), dtype=np.int64)
    for row, values in zip(out, rows, strict=True):
        row[: len(values)] = values
    return out


def polynomial_run(plan, coefficients, inputs, initial, bound=np.inf, n_past=0):
    """Return the free run (n_samples,), and whether all of it stayed within ``bound``.

    Outputs beyond it, and NaN, are cut off there. ``inputs`` (n_past + n_samples, n_columns) equal
    their first row before it; ``initial`` (start,) are the outputs before the run, the latest last.
    """
    inputs = np.asarray(inputs, dtype=float)
    n_samples = len(inputs) - n_past
    y = np.empty(plan.start + n_samples)
    y[: plan.start] = initial
    coefficients, good = as_signal(coefficients), True
    # only the first samples need inputs before the first row; the others are not copied
    n_head = min(max(plan.reach - n_past, 0), n_samples)
    pieces = [(n_head, n_samples, as_signal(inputs.T), n_past + n_head)]
    if n_head:
        head = _with_past(plan, inputs[: n_past + n_head], n_past)
        pieces.insert(0, (0, n_head, head, plan.reach))
    for first, stop, signals, origin in pieces:
        model = origin, plan.inputs, coefficients, signals, float(bound)
        values = y[first : plan.start + stop]
        if len(plan.short) and plan.start:
            groups = plan.short, len(plan.outputs[0])
            good &= _run_short(plan.start, plan.older_lag, *groups, *model, values)
        else:
            good &= _run(plan.start, plan.older, *model, values)
    return y[plan.start :], good


def polynomial_tangents(
    plan, coefficients, inputs, initial, d_initial, bound=np.inf, n_past=0, measured=None, pull=0.0
):
    """Return the run, its derivatives (n_samples, n_terms + m), and whether ``bound`` was kept.

    In addition to :func:`polynomial_run`: ``d_initial`` (start, n_terms + m) are the derivatives of
    the initial outputs by the coefficients and by ``m`` further parameters; ``pull`` is the
    fraction by which each output is moved to the measured one before the next step, 0 in the free
    run and 1 one step ahead. Derivatives are zero where the output was cut off.
    """
    inputs = np.asarray(inputs, dtype=float)
    n_samples = len(inputs) - n_past
    y = np.empty(plan.start + n_samples)
    y[: plan.start] = initial
    dy = np.zeros((len(y), d_initial.shape[1]))
    dy[: plan.start] = d_initial
    measured = np.zeros(n_samples) if measured is None else as_signal(measured)
    signals, weights = _with_past(plan, inputs, n_past), np.zeros((n_samples, len(plan.outputs[0])))
    for t, (count, columns, lags, group) in enumerate(zip(*plan.inputs, strict=True)):
        product = np.ones(n_samples)
        for column, lag in zip(columns[:count], lags[:count], strict=True):
            product *= signals[column, plan.reach - lag :][:n_samples]
        dy[plan.start :, t] = product
        weights[:, group] += coefficients[t] * product
    model = plan.outputs, plan.inputs[3], weights, float(bound)
    good = _tangents(plan.start, *model, measured, float(pull), y, y.copy(), dy)
    return y[plan.start :], dy[plan.start :], good


def _with_past(plan, inputs, n_past):
    """Return the inputs (n_columns, reach + n_samples), with ``reach`` samples of their past."""
    signals = np.empty((plan.n_columns, plan.reach + len(inputs) - n_past))
    rest = max(plan.reach - n_past, 0)
    signals[:, :rest] = inputs[:1].T
    signals[:, rest:] = inputs[max(n_past - plan.reach, 0) :].T
    return as_signal(signals)


@jit
def _weights(first, stop, origin, terms, coefficients, signals, row, out):
    """Fill ``out`` (n_groups, block) with the sum of the terms of each group."""
    n_factors, columns, lags, group = terms
    size = stop - first
    out[:, :size] = 0.0
    for t in range(len(n_factors)):
        weight, c = out[group[t]], coefficients[t]
        if n_factors[t] == 0:
            for i in range(size):
                weight[i] += c
            continue
        one = signals[columns[t, 0], origin + first - lags[t, 0] :]
        if n_factors[t] == 1:
            for i in range(size):
                weight[i] += c * one[i]
            continue
        other = signals[columns[t, 1], origin + first - lags[t, 1] :]
        if n_factors[t] == 2:
            for i in range(size):
                weight[i] += c * one[i] * other[i]
            continue
        for i in range(size):
            row[i] = c * one[i] * other[i]
        for j in range(2, n_factors[t]):
            other = signals[columns[t, j], origin + first - lags[t, j] :]
            for i in range(size):
                row[i] *= other[i]
        for i in range(size):
            weight[i] += row[i]


@jit
def _run(start, tables, origin, terms, coefficients, signals, bound, y):
    """Fill ``y``. Indices are unsigned, which saves the check for negative ones."""
    n_older, older, powers = tables
    n_samples, n_powers = len(y) - start, len(powers)
    good, one = True, np.uint64(1)
    row, weights = np.empty(_BLOCK), np.empty((len(n_older), _BLOCK))
    previous = y[start - 1] if start > 0 else 0.0
    for first in range(0, n_samples, _BLOCK):
        stop = min(first + _BLOCK, n_samples)
        _weights(first, stop, origin, terms, coefficients, signals, row, weights)
        for i in range(np.uint64(stop - first)):
            k = np.uint64(start + first) + i
            total = 0.0
            for p in range(n_powers):
                part = weights[powers[p, 0], i]
                for g in range(powers[p, 0] + one, powers[p, 1]):
                    part += weights[g, i] * y[k - older[g, 0]]
                for g in range(powers[p, 1], powers[p, 2]):
                    value = weights[g, i] * y[k - older[g, 0]]
                    for j in range(one, n_older[g]):
                        value *= y[k - older[g, j]]
                    part += value
                total = total * previous + part
            good &= abs(total) <= bound
            previous = y[k] = clipped(total, bound)
    return good


@jit
def _run_short(start, older, short, n_groups, origin, terms, coefficients, signals, bound, y):
    """Fill ``y`` from ``q = y(k-1)`` and ``r = y(k-older)``; absent groups have zero weights."""
    good, n_samples = True, len(y) - start
    row, weights = np.empty(_BLOCK), np.empty((n_groups + 1, _BLOCK))
    w00, w01, w02, w03 = weights[short[0]], weights[short[1]], weights[short[2]], weights[short[3]]
    w10, w11, w12 = weights[short[4]], weights[short[5]], weights[short[6]]
    w20, w21, w30 = weights[short[7]], weights[short[8]], weights[short[9]]
    q = y[start - 1]
    for first in range(0, n_samples, _BLOCK):
        stop = min(first + _BLOCK, n_samples)
        _weights(first, stop, origin, terms, coefficients, signals, row, weights)
        new = y[start + first :]
        old = y[start + first - older :]
        for i in range(stop - first):
            r = old[i]
            third = w30[i] * q + (w20[i] + w21[i] * r)
            second = third * q + (w10[i] + r * (w11[i] + r * w12[i]))
            total = second * q + (w00[i] + r * (w01[i] + r * (w02[i] + r * w03[i])))
            if not abs(total) <= bound:  # a predicted branch: the next sample need not wait for it
                good = False
                total = -bound if total < 0.0 else bound
            q = new[i] = total
    return good


@jit
def _tangents(start, outputs, group, weights, bound, measured, pull, y, state, dy):
    """Fill ``y``, and turn the input products of the terms in ``dy`` into its derivatives.

    ``weights`` (n_samples, n_groups) are those of the groups; the recursion reads past outputs from
    ``state``.
    """
    n_outputs, output_lags = outputs
    n_groups, n_parameters, n_terms = len(n_outputs), dy.shape[1], len(group)
    keep, good = 1.0 - pull, True
    monomials, slopes = np.empty(n_groups), np.zeros(start + 1)
    for i in range(len(weights)):
        k = start + i
        slopes[:] = 0.0
        total = 0.0
        for g in range(n_groups):
            value = 1.0
            for j in range(n_outputs[g]):
                others = weights[i, g]
                for other in range(n_outputs[g]):
                    if other != j:
                        others *= state[k - output_lags[g, other]]
                slopes[output_lags[g, j]] += others
                value *= state[k - output_lags[g, j]]
            monomials[g] = value
            total += weights[i, g] * value
        tangent = dy[k]
        if abs(total) <= bound:
            for t in range(n_terms):
                tangent[t] *= monomials[group[t]]
            for lag in range(1, start + 1):
                slope = slopes[lag] if k - lag < start else keep * slopes[lag]
                if slope != 0.0:
                    past = dy[k - lag]
                    for q in range(n_parameters):
                        tangent[q] += slope * past[q]
        else:
            tangent[:] = 0.0
            good = False
        y[k] = clipped(total, bound)
        state[k] = y[k] + pull * (measured[i] - y[k])
    return good


@jit
def polynomial(x, at, c):
    """Return the output of a polynomial; ``c`` is (terms, coefficients)."""
    terms, coefficients = c
    return sum_of_products(coefficients, terms, x, at)


@dataclass(frozen=True)
class PolynomialStep:
    """Polynomial model, a sum of products of signals; see ``_steps``."""

    room = 0
    output_weights = None

    lags: Lags
    terms: np.ndarray
    coefficients: np.ndarray

    @cached_property
    def plan(self):
        return plan_polynomial(self.terms, *self.lags)

    def plain_law(self):
        return polynomial, (self.terms, self.coefficients)

    def rows(self, Z):
        return term_products(Z, self.terms) @ self.coefficients

    def run(self, start, bound):
        return polynomial_run(
            self.plan, self.coefficients, start.inputs, start.history, bound, start.n_past
        )
