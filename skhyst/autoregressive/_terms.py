"""The candidate terms of a polynomial model, and their names."""

from collections import Counter
from itertools import combinations_with_replacement
from math import comb

import numpy as np

__all__ = ["candidate_terms", "count_terms", "term_name", "unit_scale"]


def count_terms(n_signals, degree):
    """Return the number of products of at most ``degree`` of the signals, the empty one too."""
    return comb(n_signals + degree, degree)


def candidate_terms(groups, width, include_bias):
    """Return the table (n_terms, width) of all products of lagged signals; absent factors are -1.

    A group has signals, by position, and the highest degree of their products. Each extends the one
    before: products with at least one signal of its own, up to its degree, lower degrees first.
    """
    rows, known = [()] if include_bias else [], []
    for own, degree in groups:
        known += own
        rows += [
            product
            for size in range(1, degree + 1)
            for product in combinations_with_replacement(known, size)
            if not set(product).isdisjoint(own)
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


def unit_scale(values):
    """Return a power of two next to the largest magnitude: dividing by it rounds nothing."""
    largest = np.abs(values).max(axis=0)
    return 2.0 ** np.round(np.log2(np.where(largest > 0.0, largest, 1.0)))
