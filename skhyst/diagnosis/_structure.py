r"""Structure in a residual: found by repetitions, by a black box, and by the drive's past.

**Repetitions.** Where the drive repeats, what the residual has in common between repetitions is
structure.

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

N_PRESENT = 4  # the first features of a drive, which need no past


class Trial(NamedTuple):
    """Result of a test for structure in a residual.

    ``share`` is the fraction of the residual's power that remains, ``p_value`` that of nothing
    being predicted, and ``left`` the remaining residual of each contiguous part; None if samples
    are not predicted one by one.
    """

    share: float
    p_value: float
    left: list | None

    def improves_enough(self, criterion):
        """Whether the error falls by `min_improvement` at least."""
        return bool(self.share <= (1.0 - criterion.min_improvement) ** 2)

    def is_structure(self, criterion):
        """Whether it is significant, and matters."""
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
        own, freedom = _settled(records[i].y[a] - records[j].y[b])
        power += 0.5 * own
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

    Zero if less than a quarter of the record would remain: then the memory is accepted.
    """
    # noise and rounding keep repeated extremes from the very same value
    near = 1e-3 * np.ptp(u)
    start = max(np.argmax(u >= u.max() - near), np.argmax(u <= u.min() + near))
    return int(start) if 4 * start <= 3 * len(u) else 0


def _settled(difference):
    """Return sum of squares and freedom of a difference without transient and drift."""
    rest = difference
    # rounding of a sum of as many terms
    rounding = (len(difference) * np.spacing(np.abs(difference).max())) ** 2
    for _ in range(BLOCKS // 2):
        rest = difference - _slow(difference)
        size = max(len(difference) // BLOCKS, 1)
        blocks = [np.mean(np.square(rest[k : k + size])) for k in range(0, len(rest), size)]
        if len(blocks) < 4 or blocks[0] <= max(*blocks[1:], rounding):
            break
        difference = difference[size:]
    return float(rest @ rest), max(len(rest) - SLOW - 1, 0)


def _slow(difference):
    if len(difference) <= 4 * SLOW:
        return np.mean(difference)
    time = np.arange(len(difference))
    return np.polynomial.legendre.Legendre.fit(time, difference, SLOW)(time)


def in_repetitions(pairs, residuals, power):
    """Return the trial of the part of residuals of a mean power that repetitions share.

    Noise is independent between repetitions: the mean product of their residuals is zero.
    """
    products = [residuals[i][a] * residuals[j][b] for i, a, j, b in pairs]
    products = [p[np.isfinite(p)] for p in products]
    total, count = sum(p.sum() for p in products), sum(p.size for p in products)
    share = max(1.0 - max(total, 0.0) / (max(count, 1) * power), 0.0)
    left = [np.sqrt(0.5) * (residuals[i][a] - residuals[j][b]) for i, a, j, b in pairs]
    return Trial(share, block_p_value(total, products), left)


# ------------------------------------------------------------------------------------ black box


def by_black_boxes(records, residuals, predictions, rng, criterion):
    """Return the trial of all records; each sampling interval has a black box of its own."""
    known = [i for i, r in enumerate(residuals) if np.isfinite(r).any()]
    trials, powers = [], []
    for numbers in by_interval([records[i] for i in known]).values():
        own = [[part[known[i]] for i in numbers] for part in (records, residuals, predictions)]
        trials.append(_by_black_box(*own, rng, criterion))
        powers.append(sum(np.nansum(np.square(r)) for r in own[1]))
    p_value = min(1.0, len(trials) * min(own.p_value for own in trials))
    share = np.average([own.share for own in trials], weights=powers)
    return Trial(share, p_value, [part for own in trials for part in own.left])


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
    x, n_driven, y, new, block, ends = _seen(records, residuals, predictions, rng, noise)

    def trial(seen, target, n_trials=1):
        boxes = _black_box_residuals(seen, target, block, rng)
        left = min(boxes, key=lambda own: own @ own)
        share = min((left @ left) / (target @ target), 1.0) if target.any() else 1.0
        target, left = np.split(target, ends), np.split(left, ends)
        p_value, law = paired_p_value(target, left), fit_noise(left)
        if law.law != "white":
            evened = paired_p_value(law.innovations(target), law.innovations(left))
            p_value = 2.0 * min(p_value, evened)
        return Trial(share, min(1.0, n_trials * len(boxes) * p_value), left)

    if noise.law == "white":
        return trial(x, y)
    driven, size = x[:, :n_driven], np.square(y - new)
    past = np.delete(x, np.s_[N_PRESENT:n_driven], axis=1)
    targets = [(driven, y), (past, new), (driven, size - size.mean())]
    trials = [trial(*own, len(targets)) for own in targets]
    found = [own for own in trials if own.is_structure(criterion)]
    if not found:
        return min(trials, key=lambda own: own.share)
    if found[0] is trials[0]:  # prediction of noise from its own past is no structure
        return found[0]
    whole = trial(x, y)  # the past belongs to the structure, too
    return found[0]._replace(share=whole.share, left=whole.left)


def _black_box_residuals(x, y, block, rng):
    """Return the held-out residual after ridge regression, and after ridge regression and trees."""
    # scaled by all samples: some features are constant in the training rows, and vary when held out
    left, scale = np.stack([y, y]), x.std(axis=0)
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
        left[:, test] -= linear
        left[1, test] -= trees.predict(x[test])
    return left


def _seen(records, residuals, predictions, rng, noise):
    """Return the data of the black box, row by row.

    These are the features, and how many of them depend on the drive only; the residual; its
    innovations under its noise model; the number of the run of samples; and the rows at which a run
    begins.
    """
    total = sum(int(np.isfinite(r).sum()) for r in residuals)
    # correlated neighbours must be held out together: a run is no shorter than the correlation
    lasting, _ = block_length([r[rows] for r in residuals for rows in stretches(r)])
    length = max(min(total, ENOUGH) // STRETCHES, min(lasting, total // BOX_FOLDS**2), 1)
    every = max(total // ENOUGH, 1)  # one of so many runs is used
    features, target, innovations, block, ends = [], [], [], [], []
    start, count = int(rng.integers(every)), 0
    driven_columns = _driven(records, predictions, LAGS)
    for record, r, new in zip(records, residuals, noise.innovations(residuals), strict=True):
        rows = np.flatnonzero(np.isfinite(r))
        parts = [rows[a : a + length] for a in range(0, len(rows), length)]
        parts = parts[start::every] if len(parts) > start else parts[:1]
        rows = np.concatenate([rows[:0], *parts])
        driven = [column[rows] for column in next(driven_columns)]
        own = [column[rows] for column in _own(record.u, np.nan_to_num(r))]
        n_driven = len(driven)
        features.append(np.stack([*driven, *own], axis=1))
        target.append(r[rows])
        innovations.append(new[rows])
        ends.append(np.diff(rows, prepend=-2) > 1)
        block += [np.full(len(part), count + k) for k, part in enumerate(parts)]
        count += len(parts)
    found = (np.concatenate(part) for part in (target, innovations, block))
    ends = np.flatnonzero(np.concatenate(ends))[1:]
    return np.concatenate(features), n_driven, *found, ends


def _driven(records, predictions, lags=()):
    """Yield an iterator over the features of each record's drive, at all samples.

    They are the drive and the prediction, their powers, plays of the drive, changes over so many
    samples, first-order lags of the drive and of its square with logarithmically spaced time
    constants up to the longest record (as of creep and heat), drive and prediction times time, and
    further columns.
    All records are scaled alike, so that a dependence on the amplitude stays visible.
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


def _own(u, r):
    """Yield features of a residual's past, of its gain with the drive in the past, and time."""
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
    """Return a signal delayed by so many samples, with a first value before its start."""
    return np.concatenate([np.full(min(lag, len(signal)), first), signal[:-lag]])


def past_mean(signal, size):
    """Return the mean of up to ``size`` samples before each one."""
    sums = np.concatenate([[0.0], np.cumsum(signal)])
    stop = np.arange(len(signal))
    start = np.maximum(stop - size, 0)
    return (sums[stop] - sums[start]) / np.maximum(stop - start, 1)


# ----------------------------------------------------------------------- the drive, shifted in time


def by_shifted_drive(records, residuals, predictions):
    """Return the trial of the residual following the drive better than the shifted drive.

    Features have no delays, which would only compensate for the shift.
    """
    found = []
    every = max(sum(len(r) for r in residuals) // ENOUGH, 1)
    for record, r, columns in zip(records, residuals, _driven(records, predictions), strict=True):
        known = np.flatnonzero(np.isfinite(r))
        if not len(known) or known[-1] - known[0] >= len(known):
            continue
        most, period = len(known) // 4, drive_period(record.u)
        # half a period later, a symmetric drive repeats with the opposite sign
        most = min(most, period // 3) if period else most
        rows = np.arange(known[0] + most, known[-1] + 1 - most, every)
        found.append((r, rows, most, np.stack([column[rows] for column in columns], axis=1)))
    nothing = Trial(1.0, 1.0, None)
    count = min(SHIFTS, max((most for *_, most, _ in found), default=0))
    if not count:
        return nothing
    x = np.concatenate([columns - columns.mean(axis=0) for *_, columns in found])
    scale = x.std(axis=0)
    basis, values, _ = np.linalg.svd(x[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False)
    # without features that depend linearly on others
    basis = basis[:, values > 1e-6 * values.max(initial=0.0)]
    if not 0 < 2 * basis.shape[1] <= len(basis):  # the drive rests, or the record is too short
        return nothing
    left = []
    for k in range(-count, count + 1):
        y = [r[rows + round(k / count * most)] for r, rows, most, _ in found]
        y = np.concatenate([own - own.mean() for own in y])
        left.append(1.0 - np.sum(np.square(basis.T @ y)) / max(y @ y, np.finfo(float).tiny))
    b = np.count_nonzero(np.array(left) <= left[count])
    share = min(left[count] / np.median(left), 1.0)
    return Trial(share, min(b / (count + 1), 1.0), None)
