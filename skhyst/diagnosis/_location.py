r"""Where the power of a residual is concentrated, and the parameters of a fit without that part.

**Error of a share.** The share s of the power in a part is a ratio of two sums over one series.
Over blocks i of the length of Politis and White (``noise.block_length``) the sums
:math:`e_i = \sum_{t \in i} r_t^2 (1_t - s)`, where :math:`1_t` is one for t in the part, are nearly
independent, and the variance of s is :math:`\sum e_i^2 / (\sum r_t^2)^2`. Their means are not
subtracted, since a part that is a single block has no other scatter: for white noise this makes the
error 1.22 times too large. In frequency, the ordinates of a periodogram are the blocks.

**Parameters without a part.** If the model is right, a fit to part of the samples differs only by
chance: the variance of the difference is that of the fit to the part minus that of the fit to all
samples, so it is at most the former (Hausman [1]_).

References
----------
.. [1] Hausman, *Econometrica*, 1978.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
from scipy.stats import norm, ttest_ind_from_stats
from scipy.stats import t as student

from ..inspection import branch
from ..noise import block_length, independent_sample
from ..records import record_names
from ._constants import NOTICEABLE
from ._tables import PARAMETERS_WITHOUT
from ._turns import turns

_COLUMNS = ["by", "record", "low", "high", "unit", "share", "concentration"]
_COLUMNS += ["concentration_low", "concentration_high"]
_LEVEL = 0.95
_TENTHS = 10


def locate(slices, drive, residual, units):
    """Return how the power of a residual is distributed over the records, by several signals.

    There is one row per record, per tenth of the time of a record, of the drive, of its amplitude
    (half of each swing) and of its rate (by number of samples), per direction (-1 falling, 1
    rising), and per octave of frequency: ``by``, ``record`` (for times only), ``low``, ``high``,
    ``unit``, ``share``, the fraction of the power of the residual, and ``concentration``, the mean
    power there relative to that of all samples, by which rows are sorted within each ``by``, with
    ``concentration_low`` and ``concentration_high``, its 95 % interval for all rows of a ``by`` at
    once. White noise has a concentration of one everywhere. The residual is NaN where it does not
    count.
    """
    residuals = [residual[s.rows] for s in slices]
    known = [np.isfinite(r) for r in residuals]
    power = [np.square(r[k]) for r, k in zip(residuals, known, strict=True)]
    total, count = sum(p.sum() for p in power), sum(p.size for p in power)
    if not total > 0.0:
        return pd.DataFrame(columns=_COLUMNS)
    length, _ = block_length([p - total / count for p in power if p.size])
    blocks, n_blocks = [], 0
    for p in power:  # no block spans two records
        blocks.append(n_blocks + np.arange(p.size) // length)
        n_blocks += -(-p.size // length)
    power, blocks, rows = np.concatenate(power), np.concatenate(blocks), []
    for by, (unit, signals) in _signals(slices, drive).items():
        values = [signal[k] for signal, k in zip(signals, known, strict=True)]
        places, part_of = _partition(by, values, signals, record_names(slices))
        for place, numbers in zip(
            places, _shares(power, part_of, len(places), blocks), strict=True
        ):
            if by == "record" or numbers[1] > 0.0:
                rows.append((by, *place, units.of(unit), *numbers))
    hertz = units.of("Hz")
    rows += [
        ("frequency", None, *octave[:2], hertz, *octave[2:])
        for octave in _octaves(slices, residuals)
    ]
    order = ["record", "time", "drive", "amplitude", "rate", "direction", "frequency"]
    rows.sort(key=lambda row: (order.index(row[0]), -row[6]))
    return pd.DataFrame(rows, columns=_COLUMNS)


def out_of_line(residuals, responses, criterion):
    """Return the records whose error is larger than that of all others: number -> ratio.

    The mean power of a record is compared with that of the others by Welch's test with the number
    of independent samples, as it is and relative to the variance of the response: noise of one size
    is the larger part of a small response, and a misfit that grows with the response is larger in a
    large one.

    Parameters
    ----------
    residuals, responses : sequence of ndarray of shape (n_samples,)
        Of each record; the residual is NaN where it does not count.
    criterion : Criterion
        Its level, family-wise over all records, and the fraction by which errors must differ.
    """
    rows = {i: known for i, r in enumerate(residuals) if (known := np.isfinite(r)).any()}
    power = {i: np.square(residuals[i][known]) for i, known in rows.items()}
    relative = {i: p / (np.var(responses[i][rows[i]]) or 1.0) for i, p in power.items()}
    found = {}
    for number in power if len(power) > 1 else ():
        sides = [
            (own[number], [p for i, p in own.items() if i != number]) for own in (power, relative)
        ]
        others = np.sqrt(np.mean(np.concatenate(sides[0][1])))
        error = np.sqrt(np.mean(power[number]))
        p_value = len(power) * max(_larger_p_value(*side) for side in sides)
        if others < (1.0 - criterion.min_improvement) * error and p_value < criterion.alpha:
            found[number] = float(error / others) if others else np.inf
    return found


def _larger_p_value(own, others):
    """Return the p-value of the hypothesis that a series has no larger mean than others."""
    worth = independent_sample([p - p.mean() for p in (own, *others)])
    sides = [(p.mean(), p.std(), p.size / worth) for p in (own, np.concatenate(others))]
    if min(count for *_, count in sides) <= 1.0 or not any(spread for _, spread, _ in sides):
        return 1.0
    return float(ttest_ind_from_stats(*sides[0], *sides[1], False, "greater").pvalue)


def strongest(table):
    """Return the row of largest concentration of each ``by``, where it is beyond chance."""
    strong = table["concentration_low"] > 1.0 + NOTICEABLE
    return table[strong].groupby("by", sort=False).head(1)


def parameters_without(tree, slices, records, drive, table, result, alpha):
    """Return the parameters of fits that leave out the samples where the residual is strongest.

    Parameters
    ----------
    tree : Tree
        The model.
    slices, records, drive
        Those of the search.
    table : DataFrame
        Distribution of the residual, see :func:`locate`.
    result : IdentificationResult
        Of the fit to all samples.
    alpha : float
        Level of the test, family-wise over all parameters.

    Returns
    -------
    DataFrame
        One row per parameter and place; places in frequency are not tried.
    """
    signals, rows = _signals(slices, drive), []
    for place in strongest(table).to_dict("records"):
        if place["by"] not in signals:
            continue
        _, signal = signals[place["by"]]
        reduced = []
        for name, record, values in zip(record_names(slices), records, signal, strict=True):
            inside = (values >= place["low"]) & (values <= place["high"])
            if place["by"] in ("record", "time"):
                inside &= place["record"] == name
            reduced.append(replace(record, weights=record.counts() * ~inside))
        n_left, n_all = (sum(r.counts().sum() for r in group) for group in (reduced, records))
        if 2.0 * n_left < n_all:  # a fit to less than half of the data says nothing about the rest
            continue
        _, refit = tree.fitted(reduced, slices)
        for name, value in refit.params.items():
            errors = result.params_std.get(name, np.nan), refit.params_std[name]
            if np.isfinite(errors).all():
                estimates = result.params[name], errors[0], value, errors[1]
                rows.append([place[key] for key in _COLUMNS[:5]] + [name, *map(float, estimates)])
    far = norm.isf(0.5 * alpha / max(len(rows), 1))
    rows = [[*row, abs(row[-2] - row[-4]) > far * row[-1]] for row in rows]
    return pd.DataFrame(rows, columns=PARAMETERS_WITHOUT)


def _signals(slices, drive):
    """Return the unit and the values per record of each signal that a residual is compared with."""
    drives = [drive[s.rows] for s in slices]
    times = [s.dt * np.arange(len(u)) for s, u in zip(slices, drives, strict=True)]
    return {
        "record": ("s", times),
        "time": ("s", times),
        "drive": ("drive", drives),
        "amplitude": ("drive", [_amplitude(u) for u in drives]),
        "rate": ("drive/s", [np.gradient(u, s.dt) for u, s in zip(drives, slices, strict=True)]),
        "direction": ("", [branch(u) for u in drives]),
    }


def _amplitude(u):
    """Return for each sample of a drive half the range of the monotone swing that it is in."""
    ends = np.array([0, *turns(u), len(u)])
    swings = 0.5 * np.abs(np.diff(u[np.minimum(ends, len(u) - 1)]))
    return np.repeat(swings, np.diff(ends))


def _partition(by, values, signals, names):
    """Return the parts of a signal as (record, low, high), and the number of each sample's part.

    ``values`` are those at the samples that count, ``signals`` those at all samples.
    """
    if by in ("record", "time"):
        n, parts, part_of = 1 if by == "record" else _TENTHS, [], []
        for k, (name, times, record_times) in enumerate(zip(names, values, signals, strict=True)):
            edges = np.linspace(0.0, record_times[-1], n + 1)
            parts += [(name, *ends) for ends in pairwise(edges.tolist())]
            part = np.searchsorted(edges, times, side="right") - 1
            part_of.append(n * k + np.clip(part, 0, n - 1))
        return parts, np.concatenate(part_of)
    values = levels = np.concatenate(values)
    if by == "amplitude":  # nominally equal swings differ a little: they are rounded to one level
        levels = np.round(values / (NOTICEABLE * max(values.max(), np.finfo(float).tiny)))
    _, part_of, sizes = np.unique(levels, return_inverse=True, return_counts=True)
    if by != "direction":  # tenths of the samples; samples of one level stay together
        middle = np.cumsum(sizes) - 0.5 * sizes
        _, part_of = np.unique((_TENTHS * middle // len(values))[part_of], return_inverse=True)
    ends = [
        (values[part_of == i].min(), values[part_of == i].max()) for i in range(part_of.max() + 1)
    ]
    return [(None, float(low), float(high)) for low, high in ends], part_of


def _shares(power, part_of, count, blocks):
    """Return share, concentration and its confidence interval of the power in each part.

    ``part_of`` and ``blocks`` are the numbers of the part and of the block of each sample.
    """
    size = np.maximum(np.bincount(part_of, minlength=count), 1)
    share = np.bincount(part_of, power, count) / power.sum()
    pairs, pair_of_sample = np.unique(blocks * count + part_of, return_inverse=True)
    sums, part = np.bincount(pair_of_sample, power), pairs % count
    totals = np.bincount(blocks, power)
    # the squares of e_i, see the head of the module, multiplied out and summed over the blocks
    own_squares = np.bincount(part, np.square(sums), count)
    cross = np.bincount(part, sums * totals[pairs // count], count)
    error = np.sqrt(
        np.maximum(own_squares - 2.0 * share * cross + share**2 * (totals @ totals), 0.0)
    )
    n_blocks = np.count_nonzero(np.bincount(blocks))
    reach = student.isf(0.5 * (1.0 - _LEVEL) / count, n_blocks - 1) if n_blocks > 1 else np.inf
    half = np.where(error > 0.0, reach, 0.0) * error / power.sum()
    ends = np.array([share, np.maximum(share - half, 0.0), share + half]) * len(power) / size
    return np.stack([share, *ends], axis=1).tolist()


def _octaves(slices, residuals):
    """Yield low, high (Hz), share, concentration and its interval of the residual by octaves."""
    top = 0.5 / min(s.dt for s in slices)
    longest = max(s.dt * s.n_samples for s in slices)
    count = max(int(np.floor(np.log2(top * longest))), 1)
    edges = np.concatenate([[0.0], top * 2.0 ** np.arange(-count + 1.0, 1.0)])
    power, octave_of_line = [], []
    for s, residual in zip(slices, residuals, strict=True):
        power.append(np.abs(np.fft.rfft(np.nan_to_num(residual))) ** 2 / s.n_samples)
        frequency = np.fft.rfftfreq(s.n_samples, s.dt)
        octave = np.searchsorted(edges, frequency, side="left") - 1
        octave_of_line.append(np.clip(octave, 0, count - 1))
    power, octave_of_line = np.concatenate(power), np.concatenate(octave_of_line)
    for i, numbers in enumerate(_shares(power, octave_of_line, count, np.arange(len(power)))):
        if np.any(octave_of_line == i):
            yield float(edges[i]), float(edges[i + 1]), *numbers
