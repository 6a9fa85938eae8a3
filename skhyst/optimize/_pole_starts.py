"""Data-driven starting values of linear dynamics."""

from itertools import combinations, permutations, product

import numpy as np
from scipy.signal import lfilter

from ._vector_fitting import RationalBlock, vector_fit

_ITERATIONS = 5
_DECIMATIONS = (1, 3, 9, 27)
_MIN_SAMPLES = 30  # per parameter
_MOST_LINES = 3000  # frequencies that vector fitting of records uses
_MOST_RECORDS = 4
_FASTEST = 3.0  # rate of a pole that the sampling does not resolve, relative to the sampling rate


def pole_starts(records, n_poles):
    """Return candidate pole sets (rad/s) of a transfer function from input to response.

    The iteration of Steiglitz and McBride, *IEEE Transactions on Automatic Control*, 1965, at
    several decimations, since noise dominates the least squares of an oversampled signal.

    Parameters
    ----------
    records : sequence of (u, y, dt)
        Input and response, (n_samples,) each; interval in s. Records at each interval give
        separate sets: slow poles are identified at long intervals.
    n_poles : int
        Of each set.

    Returns
    -------
    list of ndarray of shape (n_poles,)
        Stable poles, complex.
    """
    found = []
    for interval in sorted({dt for _, _, dt in records}):
        signals = [(u, y) for u, y, dt in records if dt == interval]
        found += _poles_at(interval, signals, n_poles)
    return found


def _poles_at(interval, signals, n_poles):
    """Return the pole sets of records of one interval."""
    pole_sets = []
    for q in _DECIMATIONS:
        parts = [np.stack([u[::q], y[::q]]) for u, y in signals]
        if sum(part.shape[1] for part in parts) < _MIN_SAMPLES * (2 * n_poles + 2):
            break
        parts = [part - part[:, :1] for part in parts if part.shape[1] > n_poles + 1]
        denominator = np.r_[1.0, np.zeros(n_poles)]
        for iteration in range(_ITERATIONS):
            gram = np.zeros((2 * n_poles + 3,) * 2)
            for part in parts:
                u, y = lfilter([1.0], denominator, part) if iteration else part
                n = len(y) - n_poles
                rows = [-y[n_poles - k : len(y) - k] for k in range(1, n_poles + 1)]
                rows += [u[n_poles - k : len(u) - k] for k in range(n_poles + 1)]
                rows = np.stack([*rows, np.ones(n), y[n_poles:]])
                gram += rows @ rows.T
            if not np.isfinite(gram).all():
                break
            scale = np.sqrt(np.diag(gram)[:-1])
            scale[scale == 0.0] = 1.0
            matrix, target = gram[:-1, :-1] / np.outer(scale, scale), gram[:-1, -1] / scale
            solution = np.linalg.lstsq(matrix, target, rcond=None)[0] / scale
            roots = np.roots(np.r_[1.0, solution[:n_poles]])
            if len(roots) < n_poles or not np.isfinite(roots).all():
                break
            outside = np.abs(roots) > 1.0
            roots[outside] = 1.0 / np.conj(roots[outside])
            roots = np.where(np.abs(roots) > 0.9999, roots * 0.9999, roots)
            denominator = np.real(np.poly(roots))
            dt = interval * q
            # a root near zero or on the negative real axis is faster than the sampling resolves
            fast = (np.abs(roots) < 1e-3) | ((np.abs(roots.imag) < 1e-12) & (roots.real <= 0.0))
            poles = np.where(fast, -_FASTEST / dt, np.log(np.where(fast, 0.5, roots)) / dt)
            if iteration in (1, _ITERATIONS - 1):
                pole_sets.append(poles)
    return pole_sets


def warp(s, dt):
    """Return poles (rad/s) of a sampled system from those in the variable of Tustin.

    With ``z = exp(s dt)``, a rational function of ``z`` is one of ``2 / dt (z - 1) / (z + 1)`` of
    the same degree, whose values on the unit circle lie on the imaginary axis.
    """
    half = 0.5 * dt * np.asarray(s, dtype=complex)
    beyond = (np.abs(half.imag) < 1e-12) & (half.real <= -1.0)
    z = np.where(beyond, 0.5, (1.0 + half) / np.where(beyond, 1.0, 1.0 - half))
    return np.where(beyond, -_FASTEST / dt, np.log(z) / dt)


def record_poles(records, n_poles):
    """Return poles (rad/s) that fit the transforms of records, of any number of inputs.

    The transform of a record of a sampled system obeys ``Y = sum_i N_i / D U_i + T / D`` exactly,
    where T is a polynomial due to its ends (Pintelon and Schoukens, *System Identification*, 2012,
    section 6.3): vector fitting finds D.

    Parameters
    ----------
    records : sequence of (u, y, dt)
        Inputs (n_samples,) or (n_samples, n_inputs), response (n_samples,), interval in s.
    n_poles : int
        Of the system.

    Returns
    -------
    ndarray of shape (n_poles,) or None
        Stable poles, complex; None where the records are too short.
    """
    # sorted also by the mean, so that the choice among equally long ones ignores their order
    records = sorted(records, key=lambda record: (-len(record[1]), record[1].mean()))
    dt = records[0][2]
    records = [record for record in records if record[2] == dt][:_MOST_RECORDS]
    lines, targets, inputs, ends = [], [], [], []
    for number, (u, y, _) in enumerate(records):
        n = len(y)
        k = np.arange(1, (n + 1) // 2)
        u = u.reshape(n, -1)
        lines.append(2j / dt * np.tan(np.pi * k / n))
        targets.append(np.fft.rfft(y - y[0])[k] / np.sqrt(n))
        inputs.append(np.fft.rfft(u - u[0], axis=0)[k] / np.sqrt(n))
        ends.append(np.full(len(k), number))
    s, target, drives = np.concatenate(lines), np.concatenate(targets), np.concatenate(inputs)
    size = np.linalg.norm(drives, axis=0)
    drives = drives[:, size > 0.0] / size[size > 0.0]
    ends = (np.concatenate(ends)[:, None] == np.arange(len(records))) * (1.0 / np.sqrt(len(s)))
    if 2 * len(s) < 2 * (n_poles + 1) * (drives.shape[1] + len(records) + 1):
        return None
    if len(s) > _MOST_LINES:  # those with the largest drive
        kept = np.sort(np.argsort(-np.sum(np.abs(drives) ** 2, axis=1))[:_MOST_LINES])
        s, target, drives, ends = s[kept], target[kept], drives[kept], ends[kept]
    regressors = np.concatenate([drives, ends], axis=1)
    block = RationalBlock(target, regressors, np.ones(len(s)))
    if not (np.isfinite(regressors).all() and np.abs(target).max() > 0.0):
        return None
    return warp(vector_fit(s, [block], n_poles)[0], dt)


def distribute_poles(stages, poles):
    """Return the assignments of poles (rad/s) to linear operators in series.

    Complex pairs go to stages that take pairs, and real ones to either kind; pairs that no stage
    can take become two equal real poles.

    Parameters
    ----------
    stages : sequence of LinearOperator
    poles : ndarray
        As many as the stages have in total.

    Returns
    -------
    list of tuple of LinearOperator
        The stages with the poles of one assignment each.
    """
    n_rates = sum(stage.n_poles[0] for stage in stages)
    n_pairs = sum(stage.n_poles[1] for stage in stages)
    poles = np.asarray(poles, dtype=complex)
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    rates = [float(r) for r in np.sort(-poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)].real)]
    pairs = sorted((float(abs(p)), float(-p.real / abs(p))) for p in upper)
    while len(pairs) > n_pairs:
        frequency, _ = pairs.pop()
        rates += [frequency, frequency]
    assignments = []
    missing = n_pairs - len(pairs)
    for chosen in combinations(range(len(rates)), 2 * missing):
        combined = [
            (
                np.sqrt(rates[i] * rates[j]),
                0.5 * (rates[i] + rates[j]) / np.sqrt(rates[i] * rates[j]),
            )
            for i, j in zip(chosen[::2], chosen[1::2], strict=True)
        ]
        remaining = [rate for i, rate in enumerate(rates) if i not in chosen]
        if len(remaining) != n_rates:
            continue
        for some_rates, some_pairs in product(
            set(permutations(remaining)), set(permutations([*pairs, *combined]))
        ):
            assigned, first, second = [], 0, 0
            for stage in stages:
                k, m = stage.n_poles
                assigned.append(
                    stage.with_poles(some_rates[first : first + k], some_pairs[second : second + m])
                )
                first, second = first + k, second + m
            assignments.append(tuple(assigned))
    return assignments


def sections(poles):
    """Split poles (rad/s) into time constants, natural frequencies and damping ratios.

    Complex poles and pairs of real ones make second-order sections; a real pole that is left over,
    the slowest, makes a first-order one, and so does each real pole of the right half plane. The
    second-order ones are in the order of their frequencies.
    """
    poles = np.asarray(poles, dtype=complex)
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    real = np.sort(-poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)].real)
    frequencies, dampings = list(np.abs(upper)), list(-upper.real / np.abs(upper))
    constants, real = list(1.0 / real[real < 0.0]), real[real >= 0.0]
    if len(real) % 2:
        constants.append(1.0 / real[0])
        real = real[1:]
    for a, b in zip(real[::2], real[1::2], strict=True):
        frequencies.append(np.sqrt(a * b))
        dampings.append((a + b) / (2.0 * np.sqrt(a * b)))
    order = np.argsort(frequencies, kind="stable")
    return np.array(constants), np.array(frequencies)[order], np.array(dampings)[order]
