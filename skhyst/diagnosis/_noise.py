"""The error that no model can beat: from repetitions, else from a flexible black box."""

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.linear_model import Ridge

from ._contest import paired_p_value

__all__ = ["black_box_gain", "repeatability"]

_ROWS = 6000  # rows that the black box learns from
_FOLDS = 3
_TREES = 60
_LAGS = 2 ** np.arange(9)  # samples


def repeatability(records):
    """Return the standard deviation of the response between repetitions of the drive, or None.

    Repetitions are records with the same drive, and periods within a record from the second on,
    since the first still depends on how the record began.
    """
    power, count = 0.0, 0
    for i, a in enumerate(records):
        for b in records[i + 1 :]:
            if len(a.u) == len(b.u) and _same(a.u, b.u):
                power += 0.5 * np.sum(np.square(a.y - b.y))
                count += len(a.u)
                break
    for record in records:
        period = _period(record.u)
        if period and len(record.u) >= 3 * period:
            y = record.y[period:]
            power += 0.5 * np.sum(np.square(y[period:] - y[:-period]))
            count += len(y) - period
    return float(np.sqrt(power / count)) if count else None


def _same(a, b):
    return np.max(np.abs(a - b)) <= 1e-6 * np.ptp(a)


def _period(u):
    """Return the shortest period of a signal in samples, or 0."""
    n = len(u)
    v = u - u.mean()
    spectrum = np.fft.rfft(v, 2 * n)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
    power = np.cumsum(v**2)
    # a period makes the overlap's correlation equal to its power
    candidates = (
        np.flatnonzero(correlation[2 : n // 2] > 0.99 * power[-1] * (1 - np.arange(2, n // 2) / n))
        + 2
    )
    for lag in candidates:
        if _same(u[lag:], u[:-lag]):
            return int(lag)
    return 0


def black_box_gain(records, residuals, predictions, rng):
    """Predict the residual from the drive's past by a black box; return what that achieves.

    Ridge regression and boosted trees see the drive and the model's output at logarithmically
    spaced lags and leads of their change, the time, and the direction. Folds are stretches of
    consecutive samples.

    Returns
    -------
    error : float
        Root mean square of what the black box leaves, on held-out stretches.
    p_value : float
        That it predicts nothing.
    """
    finite = np.concatenate([p[np.isfinite(p)] for p in predictions])
    drives = np.concatenate([record.u for record in records])
    features, target, group = [], [], []
    for number, (record, r, p) in enumerate(zip(records, residuals, predictions, strict=True)):
        rows = np.flatnonzero(np.isfinite(r))
        # one scale for all records: what depends on the amplitude stays visible
        u = (record.u - drives.mean()) / (np.ptp(drives) or 1.0)
        q = np.nan_to_num((p - finite.mean()) / (np.ptp(finite) or 1.0))
        features.append(_features(u, q)[rows])
        target.append(r[rows])
        group.append(np.full(len(rows), number))
    x, y, group = np.concatenate(features), np.concatenate(target), np.concatenate(group)
    n = len(y)
    stretch = max(n // 60, 1)
    block = np.arange(n) // stretch
    before, after, groups = [], [], []
    for fold in range(_FOLDS):
        test = block % _FOLDS == fold
        train = np.flatnonzero(~test)
        if len(train) > _ROWS:
            train = np.sort(rng.choice(train, _ROWS, replace=False))
        scale = x[train].std(axis=0)
        z = x / np.where(scale > 0.0, scale, 1.0)
        ridge = Ridge(alpha=1e-3 * len(train)).fit(z[train], y[train])
        linear = ridge.predict(z)
        trees = HistGradientBoostingRegressor(
            max_iter=_TREES,
            learning_rate=0.1,
            max_leaf_nodes=15,
            min_samples_leaf=40,
            early_stopping=False,
            random_state=int(rng.integers(2**31)),
        ).fit(x[train], (y - linear)[train])
        both = linear + trees.predict(x)
        for b in np.unique(block[test]):
            rows = block == b
            # the better of the two on average is chosen afterwards
            before.append(np.sum(y[rows] ** 2))
            after.append((np.sum((y - linear)[rows] ** 2), np.sum((y - both)[rows] ** 2)))
            groups.append(group[rows][0])
    before, after, groups = np.array(before), np.array(after), np.array(groups)
    order = np.argsort(groups, kind="stable")
    best = np.argmin(after.sum(axis=0))
    # structure may stand in a few stretches only: quiet ones must not outvote them
    typical = before.mean()
    p_value = 2.0 * paired_p_value(
        before[order] + typical, after[order, best] + typical, groups[order]
    )
    return float(np.sqrt(min(after[:, best].sum(), before.sum()) / n)), min(1.0, p_value)


def _features(u, q):
    """Return what the black box sees of a drive and a prediction, (n_samples, n_features)."""
    n = len(u)
    columns = [u, q, q**2, q**3, np.arange(n) / n]
    for signal in (u, q):
        for lag in _LAGS:
            moved = np.concatenate([np.full(min(lag, n), signal[0]), signal[:-lag]])
            columns.append(signal - moved)
    return np.stack(columns, axis=1)
