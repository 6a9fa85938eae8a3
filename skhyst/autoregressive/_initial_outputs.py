"""Outputs before a record: the equilibrium of a model, or the best fit to the first samples."""

import numpy as np
from scipy.optimize import least_squares

from ._runs import Start

_GRID = 33  # outputs between which an equilibrium is searched
_ITERATIONS = 60  # bisections at most: to the last digit
_SAMPLES = 20  # samples that initial outputs are fitted to, or ten per output if that is more
_STEP = 1e-6  # step of a difference quotient, in ranges of the outputs
_UNIQUE = 1e-8  # distance of an equilibrium, and of the gain of the feedback from 1


def fit_line(X, y):
    """Return the linear regression of y on the columns of X: intercept and slopes."""
    mean, spread = X.mean(axis=0), X.std(axis=0)
    spread[spread == 0.0] = 1.0
    slopes = np.linalg.lstsq((X - mean) / spread, y - y.mean(), rcond=1e-9)[0] / spread
    return np.append(y.mean() - mean @ slopes, slopes)


def rest_outputs(one_step, inputs, n_outputs, guesses, low, high):
    """Return the equilibrium outputs (n_rows,) of a model for each row of constant inputs.

    The equilibrium solves ``f(y) = one_step(inputs, y, ..., y) - y = 0``. It is searched within the
    range of the outputs, extended by that range on both sides. An equilibrium can be stable only
    where ``f`` decreases: such roots are preferred, then the one closest to the guess. Without a
    root (an integrator) it is the guess itself.
    """

    def excess(rows, y):
        Z = np.empty((len(y), inputs.shape[1] + n_outputs))
        Z[:, : inputs.shape[1]] = inputs[rows]
        Z[:, inputs.shape[1] :] = y[:, None]
        return np.asarray(one_step(Z), dtype=float).reshape(-1) - y

    span, n_rows = high - low, len(inputs)
    bottom = np.minimum(low, guesses) - span
    width = np.maximum(high, guesses) + span - bottom
    grid = bottom[:, None] + width[:, None] * np.linspace(0.0, 1.0, _GRID)
    values = excess(np.repeat(np.arange(n_rows), _GRID), grid.ravel()).reshape(grid.shape)
    falls = (values[:, :-1] >= 0.0) & (values[:, 1:] <= 0.0)
    rises = (values[:, :-1] <= 0.0) & (values[:, 1:] >= 0.0)
    distance = np.abs(0.5 * (grid[:, :-1] + grid[:, 1:]) - guesses[:, None])
    # an unstable equilibrium counts as farther away than any that can be stable
    distance = np.select([falls, rises], [distance, distance + width[:, None]], np.inf)
    solvable, cells = np.flatnonzero(np.isfinite(distance).any(axis=1)), np.argmin(distance, axis=1)
    result = np.array(guesses, dtype=float)
    if solvable.size:
        lower, upper = (solvable, cells[solvable]), (solvable, cells[solvable] + 1)
        ends = grid[lower], grid[upper], values[lower], values[upper]
        result[solvable] = _root(lambda y, rows: excess(solvable[rows], y), *ends)
    return result


def _root(f, a, b, fa, fb):
    """Return a root of each of several functions, by regula falsi and bisection in turn."""
    width = np.abs(b - a)
    active = np.arange(len(a))
    for iteration in range(2 * _ITERATIONS):
        with np.errstate(divide="ignore", invalid="ignore"):
            c = (a[active] * fb[active] - b[active] * fa[active]) / (fb[active] - fa[active])
        # regula falsi may move one end only, in ever smaller steps: every second step bisects
        halve = ~np.isfinite(c) | (iteration % 2 == 1)
        c[halve] = 0.5 * (a[active] + b[active])[halve]
        fc = f(c, active)
        in_left = fa[active] * fc <= 0.0
        b[active], fb[active] = np.where(in_left, c, b[active]), np.where(in_left, fc, fb[active])
        a[active], fa[active] = np.where(in_left, a[active], c), np.where(in_left, fa[active], fc)
        tiny = 4.0 * np.finfo(float).eps * np.maximum(width, np.abs(a) + np.abs(b))
        close = (np.abs(b - a) <= tiny) | (fa == 0.0) | (fb == 0.0) | (np.abs(fb) <= tiny)
        active = active[~close[active]]
        if not active.size:
            break
    return np.where(np.abs(fa) < np.abs(fb), a, b)


def is_equilibrium(output, next_output, gain, span):
    """Whether an output is at an equilibrium whose derivatives exist (implicit function theorem).

    ``gain`` is the derivative of the next output by equal past outputs: it is 1 for an integrator,
    which has no unique equilibrium. ``span`` is the range of the outputs.
    """
    excess = abs(next_output - output) > _UNIQUE * max(span, abs(output))
    return not (abs(1.0 - gain) < _UNIQUE or excess)


def estimate_history(free_runs, inputs, y, n_outputs, span):
    """Return the outputs (n_outputs,) before a record whose free run fits its first samples best.

    ``free_runs`` maps a list of starts to a list of runs and whether all stayed within bounds;
    ``span`` is the range of the outputs.
    """
    if not n_outputs:
        return np.empty(0)
    n_samples = min(len(y), max(_SAMPLES, 10 * n_outputs))
    inputs, y = inputs[:n_samples], y[:n_samples]

    def residuals(parts):
        histories = y[0] + span * np.atleast_2d(parts)
        runs, _ = free_runs([Start(inputs, 0, history) for history in histories])
        return (np.array(runs) - y) / span

    def jacobian(part):
        values = residuals(np.vstack([part, part + _STEP * np.eye(n_outputs)]))
        return (values[1:] - values[0]).T / _STEP

    fit = least_squares(lambda part: residuals(part)[0], np.zeros(n_outputs), jac=jacobian)
    return y[0] + span * fit.x
