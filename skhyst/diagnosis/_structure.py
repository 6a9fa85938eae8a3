r"""Structure in a residual: found by repetitions, by a black box, and by the drive's past.

**Repetitions.** Where the drive repeats, the part of the residual that repetitions have in common
is structure.

**A black box.** Its features are the drive's past, which a model could have used, and the
residual's own past, which shows structure that is no function of the drive (an oscillation or a
chaotic motion of its own, a gain that switches). Coloured noise can also be predicted from its own
past, but not from the drive; so where the residual has the spectrum of a sensor's noise, see
``skhyst.noise``, the black box is first given the drive alone, and then has to predict what that
noise model does not. In a closed loop the drive depends on the noise: the reference of the loop
replaces it, see ``_reference``.

**The drive, shifted in time.** Noise is related to the drive no more than to the drive of some time
before or after, however slow it is. A regression of the residual at the middle rows of each record
on features of the drive there has the coefficient of determination :math:`R^2_k` with the residual
:math:`k` shifts later. If the residual is stationary, so is the sequence :math:`R^2_{-r}, \dots,
R^2_r`, whatever the drive is. Among any r + 1 neighbours in it, at most b are among the b largest,
and each sees the other r within its own r neighbours. So the number b of all that are at least as
large as :math:`R^2_0`, itself included, has :math:`P\{b \leq \alpha (r + 1)\} \leq \alpha` (Yuan
and Shou [1]_): the p-value is b / (r + 1). A periodic drive is the same after a period: shifts stay
below a third of it. A single sine is the same function of its past at any time, so that this test
cannot show anything; repetitions can.

References
----------
.. [1] Yuan and Shou, *PLoS Biology*, 2024.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import Ridge

from ..noise import block_length, block_p_value, fit_noise, stretches
from ..operators import play_basis, play_thresholds
from ..records import by_interval, drive_period, repeats
from ._constants import (
    BLOCKS,
    BOX_FOLDS,
    ENOUGH,
    LAGS,
    PLAYS,
    SHIFTS,
    SLOW,
    STRETCHES,
    TREES,
)
from ._criterion import paired_p_value

N_PRESENT = 4  # features of the drive's present: drive, prediction, its square and cube


class Trial(NamedTuple):
    """Result of a test for structure in a residual.

    ``share`` is the fraction of the residual's power that remains, ``p_value`` that of the
    hypothesis that nothing can be predicted, and ``left`` the remaining residual of each contiguous
    part; None if samples are not predicted one by one.
    """

    share: float
    p_value: float
    left: list | None

    def improves_enough(self, criterion):
        """Whether the error falls by `min_improvement` at least."""
        return bool(self.share <= (1.0 - criterion.min_improvement) ** 2)

    def is_structure(self, criterion):
        """Whether the structure is significant, and its size is of practical importance."""
        return self.p_value < criterion.alpha and self.improves_enough(criterion)


# ---------------------------------------------------------------------------------- repetitions


def repeatability(records, *, pairs=None):
    """Return the standard deviation of the response between repetitions of the drive, or None.

    Repetitions are records with the same drive, and periods within a record from the second on,
    since the first still depends on the start of the record. A resting drive has no repetitions.
    Differences of two records due to different pasts are excluded: records are compared after the
    drive has been at both ends of its range, which erases the memory of a hysteresis, and after the
    difference has settled. A slow drift between repetitions, a cubic of time, is no noise either.

    Parameters
    ----------
    records : sequence of RecordData
    pairs : list, optional
        The pairs of ``repetitions``, if they are known.
    """
    power, count = 0.0, 0
    for i, a, j, b in repetitions(records) if pairs is None else pairs:
        squares, freedom = _settled(records[i].y[a] - records[j].y[b])
        power += 0.5 * squares
        count += freedom
    return float(np.sqrt(power / count)) if count else None


def repetitions(records):
    """Yield the record and rows of a repetition, and those of another with the same drive."""
    for i, a in enumerate(records):
        if not np.ptp(a.u) > 0.0:
            continue
        for j in range(i + 1, len(records)):
            b = records[j]
            if len(a.u) == len(b.u) and np.isclose(a.dt, b.dt) and repeats(a.u, b.u):
                rows = slice(_wiped(a.u), len(a.u))
                yield i, rows, j, rows
                break
    for i, record in enumerate(records):
        n, period = len(record.u), drive_period(record.u)
        if period and n >= 3 * period:
            yield i, slice(2 * period, n), i, slice(period, n - period)


def _wiped(u):
    """Return the first row after which the drive has been at both ends of its range.

    There the memory of a hysteresis is wiped out. Zero if less than a quarter of the record would
    remain: then differences of the initial memory are accepted.
    """
    # noise and rounding keep repeated extremes from the very same value
    tolerance = 1e-3 * np.ptp(u)
    start = max(np.argmax(u >= u.max() - tolerance), np.argmax(u <= u.min() + tolerance))
    return int(start) if 4 * start <= 3 * len(u) else 0


def _settled(difference):
    """Return sum of squares and degrees of freedom of a difference without transient and drift."""
    detrended = difference
    # squared rounding error of a sum of as many terms: a first block below it is no transient
    rounding = (len(difference) * np.spacing(np.abs(difference).max())) ** 2
    for _ in range(BLOCKS // 2):
        detrended = difference - _drift(difference)
        # the transient is over once the first block is no larger than the others
        size = max(len(difference) // BLOCKS, 1)
        blocks = [
            np.mean(np.square(detrended[k : k + size])) for k in range(0, len(detrended), size)
        ]
        if len(blocks) < 4 or blocks[0] <= max(*blocks[1:], rounding):
            break
        difference = difference[size:]
    return float(detrended @ detrended), max(len(detrended) - SLOW - 1, 0)


def _drift(difference):
    """Return the polynomial of time that fits a difference, or its mean if that is short."""
    if len(difference) <= 4 * SLOW:
        return np.mean(difference)
    time = np.arange(len(difference))
    return np.polynomial.legendre.Legendre.fit(time, difference, SLOW)(time)


def in_repetitions(pairs, residuals, power):
    """Return the trial of the part of the residuals that repetitions have in common.

    Noise is independent between repetitions: the mean product of their residuals is zero. ``power``
    is the mean square of the residuals.
    """
    products = [residuals[i][a] * residuals[j][b] for i, a, j, b in pairs]
    products = [p[np.isfinite(p)] for p in products]
    total, count = sum(p.sum() for p in products), sum(p.size for p in products)
    share = max(1.0 - max(total, 0.0) / (max(count, 1) * power), 0.0)
    differences = [np.sqrt(0.5) * (residuals[i][a] - residuals[j][b]) for i, a, j, b in pairs]
    return Trial(share, block_p_value(total, products), differences)


# ------------------------------------------------------------------------------------ black box


def by_black_boxes(records, residuals, predictions, rng, criterion):
    """Return the trial of all records, with one black box for each sampling interval."""
    known = [i for i, r in enumerate(residuals) if np.isfinite(r).any()]
    trials, powers = [], []
    for numbers in by_interval([records[i] for i in known]).values():
        group = [[part[known[i]] for i in numbers] for part in (records, residuals, predictions)]
        trials.append(_by_black_box(*group, rng, criterion))
        powers.append(sum(np.nansum(np.square(r)) for r in group[1]))
    p_value = min(1.0, len(trials) * min(trial.p_value for trial in trials))
    share = np.average([trial.share for trial in trials], weights=powers)
    return Trial(share, p_value, [part for trial in trials for part in trial.left])


def _by_black_box(records, residuals, predictions, rng, criterion):
    """Return the trial of predicting the residual by a black box.

    Features of ridge regression and boosted trees are the drive and the model's output, their
    change over logarithmically spaced lags, further columns, and time; and of the residual's own
    past its last values, averages, and its gain with the drive. Folds are runs of consecutive
    samples. Of more than 10,000 samples, runs spread over the records are used.

    Where the residual has the spectrum of a coloured noise, prediction from its own past proves
    nothing. But noise does not depend on the drive, and cannot be predicted beyond its noise model:
    so the black box must predict the residual from the drive alone, or the innovations of the noise
    model from the residual's own past, or, from the drive alone, the size of the part that the
    noise model predicts, as for a gain that wanders. As for any two models, errors are compared as
    they are, and as innovations of the residual.

    Returns
    -------
    Trial
    """
    noise = fit_noise(residuals)
    x, n_driven, y, new, block, ends = _black_box_data(records, residuals, predictions, rng, noise)

    def trial(features, target, n_trials=1):
        boxes = _black_box_residuals(features, target, block, rng)
        remaining = min(boxes, key=lambda residual: residual @ residual)
        share = min((remaining @ remaining) / (target @ target), 1.0) if target.any() else 1.0
        target, remaining = np.split(target, ends), np.split(remaining, ends)
        p_value, law = paired_p_value(target, remaining), fit_noise(remaining)
        if law.law != "white":
            whitened = paired_p_value(law.innovations(target), law.innovations(remaining))
            p_value = 2.0 * min(p_value, whitened)
        return Trial(share, min(1.0, n_trials * len(boxes) * p_value), remaining)

    if noise.law == "white":
        return trial(x, y)
    # coloured noise is predictable from its own past: the residual itself has to be predicted from
    # the drive alone, and from the past only the innovations
    driven, noise_power = x[:, :n_driven], np.square(y - new)
    past = np.delete(x, np.s_[N_PRESENT:n_driven], axis=1)
    targets = [(driven, y), (past, new), (driven, noise_power - noise_power.mean())]
    trials = [trial(*task, len(targets)) for task in targets]
    significant = [result for result in trials if result.is_structure(criterion)]
    if not significant:
        return min(trials, key=lambda result: result.share)
    if significant[0] is trials[0]:  # prediction of noise from its own past is no structure
        return significant[0]
    whole = trial(x, y)  # the past belongs to the structure, too
    return significant[0]._replace(share=whole.share, left=whole.left)


def _black_box_residuals(x, y, block, rng):
    """Return the held-out residual after ridge regression, and after ridge regression and trees."""
    # scaled by all samples: some features are constant in the training rows, and vary when held out
    residuals, scale = np.stack([y, y]), x.std(axis=0)
    x = x / np.where(scale > 0.0, scale, 1.0)
    for fold in range(BOX_FOLDS):
        test = block % BOX_FOLDS == fold
        train = np.flatnonzero(~test)
        if not test.any() or not len(train):
            continue
        # a light ridge: lagged features of a smooth drive are nearly collinear
        ridge = Ridge(alpha=1e-3 * len(train)).fit(x[train], y[train])
        trees = HistGradientBoostingRegressor(**TREES, random_state=int(rng.integers(2**31)))
        trees.fit(x[train], y[train] - ridge.predict(x[train]))
        # a linear prediction would extrapolate beyond the range of its fit
        linear = np.clip(ridge.predict(x[test]), y[train].min(), y[train].max())
        residuals[:, test] -= linear
        residuals[1, test] -= trees.predict(x[test])
    return residuals


def _black_box_data(records, residuals, predictions, rng, noise):
    """Return the data of the black box, row by row.

    These are the features, and how many of them depend on the drive only; the residual; its
    innovations under its noise model; the number of the run that a row belongs to; and the rows,
    without the first, that do not continue the row before them.
    """
    total = sum(int(np.isfinite(r).sum()) for r in residuals)
    # correlated neighbours must be held out together: a run is no shorter than the correlation
    lasting, _ = block_length([r[rows] for r in residuals for rows in stretches(r)])
    length = max(min(total, ENOUGH) // STRETCHES, min(lasting, total // BOX_FOLDS**2), 1)
    stride = max(total // ENOUGH, 1)  # every stride-th run is used
    features, target, innovations, run_numbers, ends = [], [], [], [], []
    start, count = int(rng.integers(stride)), 0
    driven_columns = _drive_features(records, predictions, LAGS)
    for record, r, new in zip(records, residuals, noise.innovations(residuals), strict=True):
        rows = np.flatnonzero(np.isfinite(r))
        parts = [rows[a : a + length] for a in range(0, len(rows), length)]
        parts = parts[start::stride] if len(parts) > start else parts[:1]
        rows = np.concatenate([rows[:0], *parts])
        driven = [column[rows] for column in next(driven_columns)]
        past = [column[rows] for column in _past_features(record.u, np.nan_to_num(r))]
        n_driven = len(driven)
        features.append(np.stack([*driven, *past], axis=1))
        target.append(r[rows])
        innovations.append(new[rows])
        ends.append(np.diff(rows, prepend=-2) > 1)
        run_numbers += [np.full(len(part), count + k) for k, part in enumerate(parts)]
        count += len(parts)
    joined = (np.concatenate(part) for part in (target, innovations, run_numbers))
    ends = np.flatnonzero(np.concatenate(ends))[1:]
    return np.concatenate(features), n_driven, *joined, ends


def _drive_features(records, predictions, lags=()):
    """Yield an iterator over the features of each record's drive, at all samples.

    They are the drive, the prediction and its powers, plays of the drive, changes over ``lags``
    samples, first-order lags of the drive and of its square with logarithmically spaced time
    constants up to the longest record (as of creep and heat), drive and prediction times time, and
    further columns. All records are scaled alike, so that a dependence on the amplitude stays
    visible.
    """
    finite = np.concatenate([p[np.isfinite(p)] for p in predictions])
    drives = np.concatenate([record.u for record in records])
    shift, size = drives.mean(), np.ptp(drives) or 1.0
    level, height = finite.mean(), np.ptp(finite) or 1.0
    longest = max(len(record.u) for record in records)
    poles = np.exp(-1.0 / 4.0 ** np.arange(1, -(-longest.bit_length() // 2)))
    thresholds = play_thresholds([(r.u - shift) / size for r in records], PLAYS + 1)[1:]

    def columns(u, q, auxiliary):
        plays = np.empty((len(u), PLAYS))
        play_basis(u, thresholds, np.full(PLAYS, u[0]), plays)
        yield from (u, q, q**2, q**3, *plays.T)
        for signal in (u, q):
            yield from (signal - delayed(signal, lag, signal[0]) for lag in lags)
        for signal in (u - u[0], np.square(u) - u[0] ** 2):
            yield from (lfilter([1.0 - a], [1.0, -a], signal) for a in poles)
        yield from (np.linspace(-0.5, 0.5, len(u)) * signal for signal in (u, q))
        yield from () if auxiliary is None else auxiliary.T

    for record, p in zip(records, predictions, strict=True):
        u, q = (record.u - shift) / size, np.nan_to_num((p - level) / height)
        yield columns(u, q, record.auxiliary)


def _past_features(u, r):
    """Yield features of a residual: its past values, its past gain with the drive, and time."""
    yield from (delayed(r, lag) for lag in LAGS[:4])
    yield from (past_mean(r, size) for size in LAGS[2::2])
    for signal in (u - u.mean(), u - delayed(u, 1, u[0])):
        for size in LAGS[4::4]:
            power = past_mean(signal**2, size)
            # without a floor, a gain would be a quotient of rounding where the signal rests
            floor = 1e-3 * np.mean(signal**2) + np.finfo(float).tiny
            yield past_mean(r * signal, size) / (power + floor) * signal
    yield np.arange(len(r)) / len(r)


def delayed(signal, lag, first=0.0):
    """Return a signal delayed by ``lag`` samples; before its start it is ``first``."""
    return np.concatenate([np.full(min(lag, len(signal)), first), signal[:-lag]])


def past_mean(signal, size):
    """Return for each sample the mean of up to ``size`` samples before it; 0 for the first."""
    sums = np.concatenate([[0.0], np.cumsum(signal)])
    stop = np.arange(len(signal))
    start = np.maximum(stop - size, 0)
    return (sums[stop] - sums[start]) / np.maximum(stop - start, 1)


# ----------------------------------------------------------------------- the drive, shifted in time


def by_shifted_drive(records, residuals, predictions):
    """Return the trial of the residual being related to the drive more than to a shifted one.

    Features have no delays, which would only compensate for the shift. Records with gaps in the
    scored samples are left out.
    """
    aligned = []
    stride = max(sum(len(r) for r in residuals) // ENOUGH, 1)
    for record, r, columns in zip(
        records, residuals, _drive_features(records, predictions), strict=True
    ):
        known = np.flatnonzero(np.isfinite(r))
        if not len(known) or known[-1] - known[0] >= len(known):
            continue
        # the regression sees at least half of the samples at every shift
        largest_shift, period = len(known) // 4, drive_period(record.u)
        # half a period later, a symmetric drive repeats with the opposite sign
        largest_shift = min(largest_shift, period // 3) if period else largest_shift
        rows = np.arange(known[0] + largest_shift, known[-1] + 1 - largest_shift, stride)
        aligned.append(
            (r, rows, largest_shift, np.stack([column[rows] for column in columns], axis=1))
        )
    no_structure = Trial(1.0, 1.0, None)
    count = min(SHIFTS, max((largest_shift for *_, largest_shift, _ in aligned), default=0))
    if not count:
        return no_structure
    x = np.concatenate([columns - columns.mean(axis=0) for *_, columns in aligned])
    scale = x.std(axis=0)
    basis, values, _ = np.linalg.svd(x[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False)
    # linearly dependent features have singular values of rounding, of smooth ones up to 1e-6
    basis = basis[:, values > 1e-6 * values.max(initial=0.0)]
    if not 0 < 2 * basis.shape[1] <= len(basis):  # the drive rests, or the record is too short
        return no_structure
    shares = []
    for k in range(-count, count + 1):
        y = [r[rows + round(k / count * largest_shift)] for r, rows, largest_shift, _ in aligned]
        y = np.concatenate([record_y - record_y.mean() for record_y in y])
        shares.append(1.0 - np.sum(np.square(basis.T @ y)) / max(y @ y, np.finfo(float).tiny))
    b = np.count_nonzero(np.array(shares) <= shares[count])
    share = min(shares[count] / np.median(shares), 1.0)
    return Trial(share, min(b / (count + 1), 1.0), None)
