"""The error that no model can beat, and whether what is left is noise.

Where the drive repeats, what the residual has in common in repetitions is structure, and what it
has not is noise, whatever its colour. Where nothing repeats, noise is what nothing predicts but its
own law: a flexible black box sees the drive's past, which a model could have used, and the
residual's own past, which shows structure that is no function of the drive (an oscillation or a
chaotic motion of its own, a gain that switches). Coloured noise has a past, too, but not of the
drive; so where the residual has the spectrum of a sensor's noise, see ``skhyst.noise``, the black
box first sees the drive alone, and then has to predict what that law does not. In a closed loop
the drive knows the noise: the reference of the loop takes its place, see ``_reference``.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import Ridge

from ..noise import NoiseModel, block_length, block_p_value, fit_noise, stretches
from ..records import by_interval
from ._constants import BLOCKS, ENOUGH, FACTOR, LAGS, SLOW, STRETCHES, TRANSIENT
from ._criterion import paired_p_value
from ._periods import drive_period, repeats


@dataclass(frozen=True)
class Judgement:
    """What is left: ``structured``, noise, or ``open`` where the recording cannot tell.

    ``error`` is the root mean square that no model is expected to beat, ``p_value`` that of pure
    noise, ``gain`` the part of the residual's power that is structure, ``repeated`` tells whether
    repetitions decided, and ``noise`` is what is no structure.
    """

    structured: bool
    open: bool
    error: float
    p_value: float
    gain: float
    repeated: bool
    noise: NoiseModel


class Trial(NamedTuple):
    """What was tried to predict a residual, or to find in repetitions.

    ``share`` is the part of its power that is left, ``p_value`` that of nothing being predicted,
    and ``left`` what is left, in stretches.
    """

    share: float
    p_value: float
    left: list

    def matters(self, criterion):
        """Whether as much is taken away as by a candidate that matters."""
        return bool(self.share <= (1.0 - criterion.min_improvement) ** 2)

    def is_structure(self, criterion):
        """Whether it is significant, and matters."""
        return self.p_value < criterion.alpha and self.matters(criterion)


def judge_residual(records, residuals, predictions, rng, criterion, *, in_loop=False):
    """Decide whether residuals are noise or structure that a model has left.

    What repetitions have in common, or what a black box predicts, is structure where it is
    significant and where without it the error is better by what matters, as for any candidate.

    Parameters
    ----------
    records : sequence of RecordData
    residuals, predictions : sequence of ndarray of shape (n_samples,)
        Of each record, NaN where nothing counts.
    rng : numpy.random.Generator
    criterion : Criterion
    in_loop : bool, default=False
        Whether the records have the reference of a loop in the place of the drive, and predictions
        are of what that explains. Repetitions then share no drive, but still no noise.

    Returns
    -------
    Judgement
    """
    readings = [record.y for record in records]
    power = sum(map(np.nansum, map(np.square, residuals)))
    power /= max(sum(np.isfinite(r).sum() for r in residuals), 1)
    if not power > 0.0:
        return Judgement(False, False, 0.0, 1.0, 0.0, False, fit_noise(residuals, readings))
    pairs = list(_repetitions(records))
    floor = repeatability(records, pairs=pairs)
    repeated = floor is not None
    if repeated:
        common, p_value = _common_part(pairs, residuals)
        apart = [residuals[i][a] - residuals[j][b] for i, a, j, b in pairs]
        left = [np.sqrt(0.5) * own for own in apart]
        trial = Trial(max(1.0 - common / power, 0.0), p_value, left)
    else:
        trial = _by_black_boxes(records, residuals, predictions, rng, criterion)
    structured = trial.is_structure(criterion)
    if in_loop or not repeated:
        floor = float(np.sqrt(power * (trial.share if structured else 1.0)))
    noise = fit_noise(trial.left if structured else residuals, readings)
    if structured:
        noise = replace(noise, standard_deviation=floor)
    unsure = not structured and trial.matters(criterion)
    return Judgement(structured, unsure, floor, trial.p_value, 1.0 - trial.share, repeated, noise)


# ---------------------------------------------------------------------------------- repetitions


def repeatability(records, *, pairs=None):
    """Return the standard deviation of the response between repetitions of the drive, or None.

    Repetitions are records with the same drive, and periods within a record from the second on,
    since the first still depends on how the record began. A resting drive repeats nothing. What
    two records owe to different pasts does not count: they are compared once the drive has been
    at both ends of its range, which wipes out what a hysteresis remembers, and once the difference
    has settled. A slow drift between repetitions, a cubic of time, is no noise either.

    Parameters
    ----------
    records : sequence of RecordData
    pairs : list, optional
        What ``_repetitions`` yields, if it is known.
    """
    power, count = 0.0, 0
    for i, a, j, b in _repetitions(records) if pairs is None else pairs:
        own, freedom = _settled(records[i].y[a] - records[j].y[b])
        power += 0.5 * own
        count += freedom
    return float(np.sqrt(power / count)) if count else None


def _repetitions(records):
    """Yield record and rows of one repetition, and those of another with the same drive."""
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
    """Return the row from which on the drive has been at both ends of its range.

    Where less than a quarter of the record would be left, what is remembered has to be borne.
    """
    near = 1e-3 * np.ptp(u)
    start = max(np.argmax(u >= u.max() - near), np.argmax(u <= u.min() + near))
    return int(start) if 4 * start <= 3 * len(u) else 0


def _settled(difference):
    """Return the sum of squares of a difference without its start and drift, and its freedom."""
    rest = difference
    # of a sum of so many
    rounding = (len(difference) * np.spacing(np.max(np.abs(difference), initial=0.0))) ** 2
    for _ in range(BLOCKS // 2):
        rest = difference - _slow(difference)
        size = max(len(difference) // BLOCKS, 1)
        blocks = [np.mean(np.square(rest[k : k + size])) for k in range(0, len(rest), size)]
        if len(blocks) < 4 or blocks[0] <= TRANSIENT * max(np.median(blocks[1:]), rounding):
            break
        difference = difference[size:]
    return float(rest @ rest), max(len(rest) - SLOW - 1, 0)


def _slow(difference):
    if len(difference) <= 4 * SLOW:
        return np.mean(difference)
    time = np.linspace(-1.0, 1.0, len(difference))
    return np.polynomial.legendre.Legendre.fit(time, difference, SLOW)(time)


def _common_part(pairs, residuals):
    """Return the mean power that residuals have in common in repetitions, and its p-value.

    Noise is not repeated: the product of two repetitions' residuals is zero on average.
    """
    products = [residuals[i][a] * residuals[j][b] for i, a, j, b in pairs]
    products = [p[np.isfinite(p)] for p in products]
    total, count = sum(p.sum() for p in products), sum(p.size for p in products)
    return max(float(total / max(count, 1)), 0.0), block_p_value(total, products)


# ------------------------------------------------------------------------------------ black box


def _by_black_boxes(records, residuals, predictions, rng, criterion):
    """Return the trial of all records: lags count samples, so each interval has its black box."""
    known = [i for i, r in enumerate(residuals) if np.isfinite(r).any()]
    trials, powers = [], []
    for numbers in by_interval([records[i] for i in known]).values():
        own = [[part[known[i]] for i in numbers] for part in (records, residuals, predictions)]
        trials.append(black_box_gain(*own, rng, criterion))
        powers.append(sum(np.nansum(np.square(r)) for r in own[1]))
    p_value = min(1.0, len(trials) * min(own.p_value for own in trials))
    share = np.average([own.share for own in trials], weights=powers)
    return Trial(share, p_value, [part for own in trials for part in own.left])


def black_box_gain(records, residuals, predictions, rng, criterion):
    """Predict the residual by a black box; return what that achieves.

    Ridge regression and boosted trees see the drive and the model's output, their change over
    logarithmically spaced lags, and further columns; and the residual's own past: its last values,
    averages, and the gain that it had with the drive, and the time. Folds are stretches of
    consecutive samples. Of more than 10,000 samples, stretches spread over the records are seen.

    Where the residual has the spectrum of a coloured noise, its past alone proves nothing. Noise
    does not know the drive, though, and no more than its law predicts it: so the black box must
    predict the residual from the drive alone, or what the law leaves of it, or, from the drive
    alone, how large that is which the law predicts, as of a gain that wanders.

    Returns
    -------
    Trial
    """
    noise = fit_noise(residuals)
    x, n_driven, y, new, block = _seen(records, residuals, predictions, rng, noise)
    ends = np.flatnonzero(np.diff(block)) + 1

    def trial(seen, target, n_trials=1):
        boxes = _left_by_boxes(seen, target, block, rng)
        left = min(boxes, key=lambda own: own @ own)
        share = min((left @ left) / (target @ target), 1.0) if target.any() else 1.0
        left = np.split(left, ends)
        p_value = paired_p_value(np.split(target, ends), left)
        return Trial(share, min(1.0, n_trials * len(boxes) * p_value), left)

    if noise.law == "white":
        return trial(x, y)
    driven, size = x[:, :n_driven], np.square(y - new)
    targets = [(driven, y), (x, new), (driven, size - size.mean())]
    trials = [trial(*own, len(targets)) for own in targets]
    best = min(trials, key=lambda own: (not own.is_structure(criterion), own.share))
    if best.is_structure(criterion):  # then the past is of the structure, too
        whole = trial(x, y)
        best = best._replace(share=min(whole.share, trials[0].share), left=whole.left)
    return best


def _left_by_boxes(x, y, block, rng):
    """Return what is left of held-out stretches by ridge regression, and with trees."""
    left = np.stack([y, y])
    for fold in range(FACTOR):
        test = block % FACTOR == fold
        train = np.flatnonzero(~test)
        if not test.any() or not len(train):
            continue
        scale = x[train].std(axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        ridge = Ridge(alpha=1e-3 * len(train)).fit(x[train] / scale, y[train])
        trees = HistGradientBoostingRegressor(
            max_iter=40,
            learning_rate=0.15,
            max_leaf_nodes=15,
            min_samples_leaf=40,
            early_stopping=False,
            random_state=int(rng.integers(2**31)),
        ).fit(x[train], y[train] - ridge.predict(x[train] / scale))
        left[:, test] -= ridge.predict(x[test] / scale)
        left[1, test] -= trees.predict(x[test])
    return left


def _seen(records, residuals, predictions, rng, noise):
    """Return what the black box sees, row by row.

    That is features, of which so many are driven; the residual; what its law as noise does not
    predict of it; and the number of the stretch.

    One scale serves all records, so that what depends on the amplitude stays visible.
    """
    finite = np.concatenate([p[np.isfinite(p)] for p in predictions])
    drives = np.concatenate([record.u for record in records])
    shift, size = drives.mean(), np.ptp(drives) or 1.0
    level, height = finite.mean(), np.ptp(finite) or 1.0
    total = sum(int(np.isfinite(r).sum()) for r in residuals)
    # what neighbours have in common predicts nothing: a stretch is no shorter than that lasts
    lasting, _ = block_length([r[rows] for r in residuals for rows in stretches(r)])
    length = max(min(total, ENOUGH) // STRETCHES, min(lasting, total // FACTOR**2), 1)
    every = max(total // ENOUGH, 1)  # of so many stretches one is seen
    context = int(LAGS[-1])
    features, target, innovations, block = [], [], [], []
    start = int(rng.integers(every))
    news = noise.innovations(residuals)
    for record, r, p, new in zip(records, residuals, predictions, news, strict=True):
        rows = np.flatnonzero(np.isfinite(r))
        parts = [rows[a : a + length] for a in range(0, len(rows), length)]
        for part in parts[start::every] if len(parts) > start else parts[:1]:
            first = max(part[0] - context, 0)
            seen = slice(first, part[-1] + 1)
            u = (record.u[seen] - shift) / size
            q = np.nan_to_num((p[seen] - level) / height)
            driven, own = _features(u, q, np.nan_to_num(r[seen]))
            own.append(np.arange(first, part[-1] + 1) / len(r))
            driven += [] if record.auxiliary is None else list(record.auxiliary[seen].T)
            features.append(np.stack([*driven, *own], axis=1)[part - first])
            target.append(r[part])
            innovations.append(new[part])
            block.append(np.full(len(part), len(block)))
    found = np.concatenate(features), np.concatenate(target), np.concatenate(innovations)
    return found[0], len(driven), *found[1:], np.concatenate(block)


def _features(u, q, r):
    """Return what is known of a stretch before each sample's residual, driven, and of its own."""
    driven = [u, q, q**2, q**3]
    for signal in (u, q):
        driven += [signal - moved(signal, lag, signal[0]) for lag in LAGS]
    columns = [moved(r, lag) for lag in LAGS[:4]]
    columns += [past_mean(r, size) for size in LAGS[2::2]]
    for signal in (u - u.mean(), u - moved(u, 1, u[0])):
        for size in LAGS[4::4]:
            power = past_mean(signal**2, size)
            floor = 1e-3 * np.mean(signal**2) + np.finfo(float).tiny
            columns.append(past_mean(r * signal, size) / (power + floor) * signal)
    return driven, columns


def moved(signal, lag, first=0.0):
    """Return the signal so many samples before each one, with a first value before the start."""
    return np.concatenate([np.full(min(lag, len(signal)), first), signal[:-lag]])


def past_mean(signal, size):
    """Return the mean of up to ``size`` samples before each one."""
    sums = np.concatenate([[0.0], np.cumsum(signal)])
    stop = np.arange(len(signal))
    start = np.maximum(stop - size, 0)
    return (sums[stop] - sums[start]) / np.maximum(stop - start, 1)
