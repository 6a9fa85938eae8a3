"""Data-driven starting values of linear dynamics."""

from itertools import combinations, permutations, product

import numpy as np
from scipy.signal import lfilter

__all__ = ["distribute_poles", "pole_starts", "sections"]

_ITERATIONS = 5
_DECIMATIONS = (1, 3, 9, 27)
_MIN_SAMPLES = 30  # a parameter


def pole_starts(records, n_poles):
    """Return candidate pole sets (rad/s) of a transfer function from input to response.

    The iteration of Steiglitz and McBride (IEEE Trans. Autom. Control 10, 1965) at several
    decimations, since the least squares of an oversampled signal sees noise only.

    Parameters
    ----------
    records : sequence of (u, y, dt)
        Input and response, (n_samples,) each; interval in s.
    n_poles : int

    Returns
    -------
    list of ndarray of shape (n_poles,)
        Stable poles, complex.
    """
    found = []
    for q in _DECIMATIONS:
        parts = [(u[::q], y[::q]) for u, y, _ in records]
        if sum(len(u) for u, _ in parts) < _MIN_SAMPLES * (2 * n_poles + 2):
            break
        denominator = np.r_[1.0, np.zeros(n_poles)]
        for iteration in range(_ITERATIONS):
            rows, targets = [], []
            for u, y in parts:
                if len(u) <= n_poles + 1:
                    continue
                u, y = u - u[0], y - y[0]
                if iteration:
                    u, y = lfilter([1.0], denominator, u), lfilter([1.0], denominator, y)
                lags = [-y[n_poles - k : len(y) - k] for k in range(1, n_poles + 1)]
                lags += [u[n_poles - k : len(u) - k] for k in range(n_poles + 1)]
                lags.append(np.ones(len(u) - n_poles))
                rows.append(np.stack(lags, axis=1))
                targets.append(y[n_poles:])
            rows, targets = np.concatenate(rows), np.concatenate(targets)
            if not (np.isfinite(rows).all() and np.isfinite(targets).all()):
                break
            scale = np.linalg.norm(rows, axis=0)
            scale[scale == 0.0] = 1.0
            rows /= scale
            solution = np.linalg.lstsq(rows.T @ rows, rows.T @ targets, rcond=None)[0] / scale
            roots = np.roots(np.r_[1.0, solution[:n_poles]])
            if len(roots) < n_poles or not np.isfinite(roots).all():
                break
            outside = np.abs(roots) > 1.0
            roots[outside] = 1.0 / np.conj(roots[outside])
            roots = np.where(np.abs(roots) > 0.9999, roots * 0.9999, roots)
            denominator = np.real(np.poly(roots))
            dt = records[0][2] * q
            # a pole near zero or on the negative axis is faster than the sampling resolves
            fast = (np.abs(roots) < 1e-3) | ((np.abs(roots.imag) < 1e-12) & (roots.real <= 0.0))
            poles = np.where(fast, -3.0 / dt, np.log(np.where(fast, 0.5, roots)) / dt)
            if iteration in (1, _ITERATIONS - 1):
                found.append(poles)
    return found


def sections(poles):
    """Split poles (rad/s) into time constants, natural frequencies and damping ratios.

    Complex poles and pairs of real ones make second-order sections; a real pole that is left over,
    the slowest, makes a first-order one.
    """
    poles = np.asarray(poles, dtype=complex)
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    real = np.sort(-poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)].real)
    frequencies, dampings = list(np.abs(upper)), list(-upper.real / np.abs(upper))
    constants = []
    if len(real) % 2:
        constants.append(1.0 / real[0])
        real = real[1:]
    for a, b in zip(real[::2], real[1::2], strict=True):
        frequencies.append(np.sqrt(a * b))
        dampings.append((a + b) / (2.0 * np.sqrt(a * b)))
    return np.array(constants), np.array(frequencies), np.array(dampings)


def distribute_poles(stages, poles):
    """Return the ways to give poles (rad/s) to linear operators in series.

    Complex pairs go to stages that take pairs, and real ones to either kind; pairs that no stage
    can take become two equal real poles.

    Parameters
    ----------
    stages : sequence of LinearOperator
    poles : ndarray
        As many as the stages have together.

    Returns
    -------
    list of tuple of LinearOperator
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
    ways = []
    missing = n_pairs - len(pairs)
    for chosen in combinations(range(len(rates)), 2 * missing):
        made = [
            (
                np.sqrt(rates[i] * rates[j]),
                0.5 * (rates[i] + rates[j]) / np.sqrt(rates[i] * rates[j]),
            )
            for i, j in zip(chosen[::2], chosen[1::2], strict=True)
        ]
        left = [rate for i, rate in enumerate(rates) if i not in chosen]
        if len(left) != n_rates:
            continue
        for some_rates, some_pairs in product(
            set(permutations(left)), set(permutations([*pairs, *made]))
        ):
            own, first, second = [], 0, 0
            for stage in stages:
                k, m = stage.n_poles
                own.append(
                    stage.with_poles(some_rates[first : first + k], some_pairs[second : second + m])
                )
                first, second = first + k, second + m
            ways.append(tuple(own))
    return ways
