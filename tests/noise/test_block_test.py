"""Sums of a series whose neighbours depend on each other."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import t as student

from skhyst.noise import block_length, block_p_value
from skhyst.noise._block_test import _autocovariance, _block_sums

N, RECORDS = 600, 4


def coloured(rng, correlation, n=N):
    """Draw AR(1) noise of unit variance."""
    white = np.sqrt(1.0 - correlation**2) * rng.standard_normal(n + 2000)
    return lfilter([1.0], [1.0, -correlation], white)[2000:]


@pytest.mark.parametrize(("correlation", "least", "most"), [(0.0, 1, 3), (0.9, 20, 400)])
def test_blocks_are_as_long_as_the_memory_asks_for(correlation, least, most):
    rng = np.random.default_rng(9007)
    lengths = [
        block_length([coloured(rng, correlation) for _ in range(RECORDS)])[0] for _ in range(20)
    ]
    assert least <= np.median(lengths) <= most


@pytest.mark.parametrize("correlation", [0.0, 0.8, 0.95])
def test_the_variance_that_blocks_miss_is_put_back(correlation):
    """Block sums and what they leave out add up to the variance of the whole sum."""
    rng = np.random.default_rng(9008)
    found, totals = [], []
    for _ in range(400):
        series = coloured(rng, correlation, 4000)
        length, missing = block_length([series])
        edges = np.arange(0, 4000, length)
        sums = np.add.reduceat(series, edges)
        found.append(sums @ sums / (1.0 - missing))
        totals.append(series.sum() ** 2)
    # 400 squares of normal numbers are known to 7 %
    assert np.mean(found) == pytest.approx(np.mean(totals), rel=0.25)


def test_what_blocks_miss_widens_the_law_of_chance():
    series = coloured(np.random.default_rng(9010), 0.95, 4000)
    length, missing = block_length([series])
    edges = np.linspace(0, 4000, 4000 // length + 1).astype(int)[:-1]
    sums, total = np.add.reduceat(series, edges), 500.0
    spread = total / student.isf(block_p_value(total, [series]), len(sums))
    assert missing > 0.05
    assert spread**2 * (1.0 - missing) == pytest.approx(sums @ sums, rel=1e-6)


def test_a_total_that_chance_makes_often_is_not_significant():
    rng = np.random.default_rng(9009)
    p = []
    for _ in range(1000):
        series = coloured(rng, 0.8)
        p.append(block_p_value(series.sum(), [series]))
    assert np.mean(np.array(p) < 0.01) <= 0.02


@pytest.mark.parametrize(
    ("pole", "sizes"),
    [
        (0.5, (2000,)),
        (0.9, (2000,)),
        (-0.6, (2000,)),
        (-0.99, (400,)),  # it cancels
        (-0.99, (7,)),
        (0.5, (900, 200, 31, 3, 0)),  # the longest one has the lags
        (0.99, (100,)),
        (0.999, (40, 30)),  # half of the variance is missed
        (1.0, (12,)),
        (0.0, (400,)),
        (0.0, (3,)),
    ],
)
def test_blocks_are_as_long_as_politis_and_white_say(pole, sizes):
    """Their formula, lag by lag: full weight up to half of the window, then a fall."""
    rng = np.random.default_rng(0)
    series = [coloured(rng, pole, size) if pole < 1.0 else np.ones(size) for size in sizes]
    n, longest = sum(sizes), max(sizes)
    r = [
        sum(x[k:] @ x[: len(x) - k] for x in series if len(x) > k) / n if 2 * k <= longest else 0.0
        for k in range(longest + 8)
    ]
    bar, run = 2.0 * np.sqrt(np.log10(n) / n), 5
    m = next(k for k in range(n) if np.abs(r[k + 1 : k + 1 + run]).max() < bar * r[0])
    g, moment = r[0], 0.0
    for lag in range(1, 2 * m + 1):
        part = lag / (2 * m)
        weight = 1.0 if part <= 0.5 else 2.0 * (1.0 - part)
        g += 2.0 * weight * r[lag]
        moment += 2.0 * weight * lag * r[lag]
    if g > 0.0:
        length = int(np.ceil((2.0 * moment**2 / (4.0 / 3.0 * g**2) * n) ** (1.0 / 3.0)))
        length = min(max(length, 1), longest)
        missing = np.clip(moment / (g * length), 0.0, 0.5)
    else:
        length, missing = min(2 * m + 1, longest), 0.0
    assert block_length(series) == (length, pytest.approx(missing))
    assert block_length([1e-9 * x for x in series]) == (length, pytest.approx(missing))


def test_what_has_no_chance_is_certain():
    rest = [np.zeros(20), np.zeros(5)]
    assert block_length(rest) == (1, 0.0)
    assert block_p_value(1e-30, rest) == 0.0
    for total in (0.0, -1.0, np.nan):
        assert block_p_value(total, rest) == block_p_value(total, [np.ones(9)]) == 1.0


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_significance_has_neither_a_unit_nor_empty_stretches(unit):
    series = coloured(np.random.default_rng(9011), 0.5)
    p_value = block_p_value(20.0, [series])
    assert 0.01 < p_value < 0.5
    assert block_p_value(unit * 20.0, [unit * series, np.empty(0)]) == pytest.approx(p_value)


@pytest.mark.parametrize("length", [1, 3, 7, 10, 11])
def test_blocks_are_even_and_none_is_shorter(length):
    sizes = _block_sums(np.ones(10), length)
    assert len(sizes) == max(10 // length, 1)
    assert sizes.sum() == 10
    assert min(length, 10) <= sizes.min() <= sizes.max() <= sizes.min() + 1


@pytest.mark.parametrize("size", [0, 3, 19, 40])
def test_products_at_a_distance_are_summed(size):
    values = np.random.default_rng(size).normal(size=20)
    direct = [values[lag:] @ values[: max(20 - lag, 0)] for lag in range(size + 1)]
    np.testing.assert_allclose(_autocovariance(values, size), direct, atol=1e-12)
