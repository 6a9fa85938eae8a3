r"""Identification of linear dynamics by the errors of predictions one step ahead.

A plant that a feedback keeps in bounds may be unstable: its free run then grows whatever the
parameters. The predictor in innovation form,

    e[k] = y[k] - C x[k] - D u[k] - c,    x[k+1] = Ad (x[k] + L e[k]) + B0 u[k] + B1' u[k+1],

is stable, and consistent even if the drive depends on the response, as long as it does so with a
delay and the gain L describes the noise (Ljung, *System Identification*, 1999, sections 7.2 and
13.4). Parameters, L and the state at the start of each record minimise the sum of squares of e.

It starts from a predictor-based subspace method (Chiuso, *Automatica*, 2007): a long autoregression
with the drive, which closed loops do not bias, gives the states up to a basis; regressions on these
give the poles and L.
"""

import time

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.optimize import least_squares

from .._jit import jit
from ..optimize import IdentificationResult, sections

_PAST = 20  # least number of past samples in the autoregression
_PER_STATE = 4  # past samples per state, if that is more
_SMALLEST = 1e-3  # poles in the z plane that are closer to zero, or negative, are moved there
_POINTS = 8  # points of the unit circle per pole at which gains are compared
_REST = 1e-9  # least variance of the noise of a state, so that the Riccati equation has a solution
_SINGULAR = 1e-11  # relative singular value below which a direction is not determined


@jit
def predictor(ad, b0, b1, c, d, constant, gain, by, u, y, x, errors, tangents):
    """Write the errors (n,) of the predictions and their derivatives (n, p + 2 n_states).

    ``by`` are the derivatives (p, ...) of Ad, B0, B1, C, D and the constant. The columns are those
    of the p parameters, of the gain (n_states,), and of the state ``x`` at the first sample, which
    is changed. A response that is not finite is not read. Empty tangents are not written.
    """
    dad, db0, db1, dc, dd, dconstant = by
    n, p = len(gain), len(dd)
    count = p + 2 * n if tangents.size else 0
    dx = np.zeros((n, count))
    for i in range(n if count else 0):
        dx[i, p + n + i] = 1.0
    # x is the state before the correction by a sample's error, ``after`` the one behind it; ``dx``
    # are the derivatives of the former, corrected in place at the end of the loop
    new, dnew, after = np.empty(n), np.empty((n, count)), np.empty(n)
    for k in range(len(u)):
        if k > 0:
            for i in range(n):
                value = b0[i] * u[k - 1] + b1[i] * u[k]
                for j in range(n):
                    value += ad[i, j] * after[j]
                new[i] = value
            for q in range(count):
                for i in range(n):
                    value = 0.0
                    for j in range(n):
                        value += ad[i, j] * dx[j, q]
                    if q < p:
                        value += db0[q, i] * u[k - 1] + db1[q, i] * u[k]
                        for j in range(n):
                            value += dad[q, i, j] * after[j]
                    dnew[i, q] = value
            for i in range(n):
                x[i] = new[i]
                for q in range(count):
                    dx[i, q] = dnew[i, q]
        output = constant + d * u[k]
        for i in range(n):
            output += c[i] * x[i]
        read = np.isfinite(y[k])
        errors[k] = y[k] - output
        e = errors[k] if read else 0.0
        for q in range(count):
            value = 0.0
            for i in range(n):
                value -= c[i] * dx[i, q]
            if q < p:
                value -= dd[q] * u[k] + dconstant[q]
                for i in range(n):
                    value -= dc[q, i] * x[i]
            tangents[k, q] = value
            if read:
                for i in range(n):
                    dx[i, q] += gain[i] * value
                if q >= p and q < p + n:
                    dx[q - p, q] += e
        for i in range(n):
            after[i] = x[i] + gain[i] * e


def one_step(operator, gain, u, y, dt):
    """Return predictions one step ahead; the state at the start is that with the least errors.

    Parameters
    ----------
    operator : LinearOperator
    gain : ndarray of shape (n_states,)
        L, by which an error of the prediction moves the state.
    u, y : ndarray of shape (n_samples,)
        Drive and response; NaN where the response is not known: the model's response replaces it.
    dt : float
        Interval in s.

    Returns
    -------
    ndarray of shape (n_samples,)
    """
    errors, tangents = _errors(operator, gain, u, y, dt, by_parameters=False)
    known = np.isfinite(errors)
    start = np.linalg.lstsq(tangents[known], -errors[known], rcond=None)[0]
    return _predictions(operator, gain, u, y, dt, start)


def _predictions(operator, gain, u, y, dt, x):
    """Return the predictions from a state at the first sample, also where ``y`` is NaN."""
    ad, b0, b1, c, d = operator.discrete(dt)
    predictions = np.empty(len(u))
    for k in range(len(u)):
        if k:
            x = ad @ x + b0 * u[k - 1] + b1 * u[k]
        predictions[k] = c @ x + d * u[k] + operator.intercept
        if np.isfinite(y[k]):
            x = x + gain * (y[k] - predictions[k])
    return predictions


def _errors(operator, gain, u, y, dt, start=None, *, by_parameters=True):
    """Return the errors and their derivatives by parameters, gain and start."""
    n = len(gain)
    ad, b0, b1, c, d = operator.discrete(dt)
    if by_parameters:
        *by, _ = operator._discrete_tangents(dt)
        names = [name for name, _ in operator.entries()]
        by = (*by, np.array([float(name == "intercept") for name in names]))
    else:
        by = tuple(np.empty((0, *np.shape(part))) for part in (ad, b0, b1, c, d, 0.0))
    p = len(by[-1])
    x = np.zeros(n) if start is None else np.array(start, dtype=float)
    errors, tangents = np.empty(len(u)), np.empty((len(u), p + 2 * n))
    signals = (np.ascontiguousarray(part, dtype=float) for part in (u, y))
    constant = float(operator.intercept)
    predictor(ad, b0, b1, c, float(d), constant, gain, by, *signals, x, errors, tangents)
    return errors, tangents if by_parameters else tangents[:, -n:]


class PredictionErrorProblem:
    """Records and an operator, whose free parameters and gain minimise the prediction errors."""

    def __init__(self, operator, records, fixed):
        self.operator, self.records = operator, records
        entries = operator.entries()
        self.free = np.array([not (spec.held or name in fixed) for name, spec in entries])
        self.names = [name for name, _ in entries]
        self.log = np.array([spec.log for _, spec in entries])[self.free]
        self._values = operator.pack()
        self._sign = np.where(self.log & (self._values[self.free] < 0.0), -1.0, 1.0)
        self.n_evaluations = 0

    def x0(self, gain):
        """Return the unknowns: the parameters, positive ones as logarithms, and the gain."""
        values = self._values[self.free]
        with np.errstate(divide="ignore"):
            unknowns = np.where(self.log, np.log(np.where(self.log, np.abs(values), 1.0)), values)
        return np.concatenate([unknowns, gain])

    def at(self, x):
        """Return the operator and the gain at a value of the unknowns."""
        unknowns = x[: self.free.sum()]
        values = self._values.copy()
        values[self.free] = np.where(
            self.log, self._sign * np.exp(np.where(self.log, unknowns, 0)), unknowns
        )
        return self.operator.unpack(values), x[self.free.sum() :]

    def evaluate(self, x):
        """Return errors and their derivatives, with the start of each record eliminated.

        Errors are linear in the state at the start: its columns are projected out of both (variable
        projection). None where the predictor is unstable.
        """
        operator, gain = self.at(x)
        n, blocks = len(gain), []
        self.n_evaluations += 1
        ad, _, _, c, _ = operator.discrete(self.records[0].dt)
        if np.abs(np.linalg.eigvals(ad - np.outer(ad @ gain, c))).max() > 1.0:
            return None  # the predictor is unstable
        used = np.append(self.free, np.ones(n, dtype=bool))
        for record in self.records:
            errors, tangents = _errors(operator, gain, record.u, record.y, record.dt)
            root = np.sqrt(record.counts())
            rows = np.column_stack([tangents, errors]) * root[:, None]
            rows[:, :-1][:, : len(self.free)] *= self._chain(operator)
            if not np.isfinite(rows).all():
                return None
            basis, size, _ = np.linalg.svd(rows[:, -1 - n : -1], full_matrices=False)
            basis = basis[:, size > _SINGULAR * size.max(initial=0.0)]
            projected = np.column_stack([rows[:, : -1 - n][:, used], rows[:, -1]])
            blocks.append(projected - basis @ (basis.T @ projected))
        rows = np.concatenate(blocks)
        return rows[:, -1], rows[:, :-1]

    def _chain(self, operator):
        chain = np.ones(len(self.free))
        chain[np.flatnonzero(self.free)[self.log]] = operator.pack()[self.free][self.log]
        return chain


def identify_one_step(starts, records, fixed=()):
    """Identify an operator by its predictions one step ahead.

    Parameters
    ----------
    starts : sequence of (LinearOperator, ndarray of shape (n_states,))
        Operators of one structure, each with a gain.
    records : sequence of RecordData
    fixed : collection of str, default=()
        Names of entries that are held.

    Returns
    -------
    (result, gain) : (IdentificationResult, ndarray of shape (n_states,)) or None
        With the root mean square error of the predictions, and L of the predictor; None if the
        predictor of every start is unstable.
    """
    begin, fits = time.perf_counter(), []
    for operator, gain in starts:
        problem = PredictionErrorProblem(operator, records, fixed)
        x = problem.x0(gain)
        if problem.evaluate(x) is None:
            continue
        cached = {}

        def rows(x, problem=problem, cached=cached):
            if x.tobytes() not in cached:
                cached.clear()
                cached[x.tobytes()] = problem.evaluate(x)
            return cached[x.tobytes()]

        # an unstable predictor gives errors so large that the step is refused
        n, size = rows(x)[1].shape
        huge = np.full(n, 1e10), np.zeros((n, size))
        solution = least_squares(
            lambda x, rows=rows, huge=huge: (rows(x) or huge)[0],
            x,
            jac=lambda x, rows=rows, huge=huge: (rows(x) or huge)[1],
            x_scale="jac",
        )
        fits.append((solution.cost, problem, solution))
    if not fits:
        return None
    _, problem, solution = min(fits, key=lambda fit: fit[0])
    operator, gain = problem.at(solution.x)
    errors, tangents = problem.evaluate(solution.x)
    # covariance of the unknowns, from the columns scaled to unit norm; positive parameters were
    # searched as logarithms, so that theirs follow by the chain rule
    counts = sum(record.counts().sum() for record in records)
    free = counts - len(solution.x) - len(records) * len(gain)
    variance = float(errors @ errors) / max(free, 1.0)
    scale = np.linalg.norm(tangents, axis=0)
    scale[scale == 0.0] = 1.0
    inverse = np.linalg.pinv((tangents / scale).T @ (tangents / scale), _SINGULAR, hermitian=True)
    p = int(problem.free.sum())
    values = operator.pack()[problem.free]
    chain = np.where(problem.log, np.abs(values), 1.0)
    covariance = variance * (inverse / np.outer(scale, scale))[:p, :p] * np.outer(chain, chain)
    names = [name for name, is_free in zip(problem.names, problem.free, strict=True) if is_free]
    std = dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    result = IdentificationResult(
        operator=operator,
        disturbances=(),
        params=dict(zip(names, values.tolist(), strict=True)),
        record_coefficients=np.empty((len(records), 0)),
        error=float(np.sqrt(errors @ errors / counts)),
        n_evaluations=sum(fit.n_evaluations for _, fit, _ in fits),
        seconds=time.perf_counter() - begin,
        converged=bool(solution.success),
        message=solution.message,
        history=[(problem.n_evaluations, 2.0 * solution.cost)],
        x=solution.x,
        params_std=std,
        params_std_white=std,
        condition_number=float(np.linalg.cond(tangents / scale) ** 2),
        joint_covariance=covariance,
    )
    return result, gain


def subspace_start(records, n_poles):
    """Return the poles (rad/s) of a predictor, its matrices A and C, and its gain, of one interval.

    Parameters
    ----------
    records : sequence of RecordData
    n_poles : int

    Returns
    -------
    poles : ndarray of shape (n_poles,)
    system : tuple of (ndarray, ndarray, ndarray, ndarray, float)
        Of discrete time, in the basis that was found: A (n, n), B of the drive before and of the
        present one (n,) each, C (n,) and D.
    gain : ndarray of shape (n_poles,)
        K, by which an error of the prediction moves the next state.
    """
    longest = max(len(r.u) for r in records)
    past = min(max(_PAST, _PER_STATE * n_poles), max(longest // 6, n_poles + 1))
    rows, targets, nows = [], [], []
    for r in records:
        n = len(r.u) - past
        if n > past:
            lags = [signal[i : i + n] for i in range(past) for signal in (r.y, r.u)]
            rows.append(np.column_stack(lags))
            targets.append(r.y[past:])
            nows.append(np.column_stack([r.u[past:], np.ones(n)]))
    columns = np.concatenate([np.concatenate(rows), np.concatenate(nows)], axis=1)
    markov = np.linalg.lstsq(columns, np.concatenate(targets), rcond=None)[0]
    lagged = markov[: 2 * past]
    # row i: the prediction i samples ahead, as if the samples in between were zero. These span the
    # state, since it is all that the future depends on of the past
    ahead = np.zeros((past, 2 * past))
    for i in range(past):
        ahead[i, 2 * i :] = lagged[: 2 * (past - i)]
    states = np.concatenate(rows) @ ahead.T
    _, _, directions = np.linalg.svd(states - states.mean(axis=0), full_matrices=False)
    states = [part @ ahead.T @ directions[:n_poles].T for part in rows]
    x, y = np.concatenate(states), np.concatenate(targets)
    inputs = np.concatenate(nows)
    output = np.linalg.lstsq(np.column_stack([x, inputs]), y, rcond=None)[0]
    ends = np.cumsum([len(part) for part in states])[:-1]
    errors = np.split(y - np.column_stack([x, inputs]) @ output, ends)
    before = [
        np.column_stack([s[:-1], e[:-1], now[:-1], now[1:, :1]])
        for s, e, now in zip(states, errors, nows, strict=True)
    ]
    after = np.concatenate([s[1:] for s in states])
    moved = np.linalg.lstsq(np.concatenate(before), after, rcond=None)[0]
    a, gain, b0, b1 = moved[:n_poles].T, moved[n_poles], moved[n_poles + 1], moved[n_poles + 3]
    z = np.linalg.eigvals(a).astype(complex)
    z = np.where((np.abs(z.imag) < 1e-12) & (z.real < _SMALLEST), _SMALLEST, z)
    system = a, b0, b1, output[:n_poles], float(output[n_poles])
    return np.log(z) / records[0].dt, system, gain


def in_basis(operator, dt, a, c, gain):
    """Return the gain L of an operator for the gain K of matrices A and C in another basis.

    The observability matrices of both bases give the transformation from one to the other.
    """
    ad, _, _, output, _ = operator.discrete(dt)
    powers = [np.linalg.matrix_power(m, k) for m in (a, ad) for k in range(len(c))]
    observability = np.stack([c @ m for m in powers[: len(c)]])
    observability_here = np.stack([output @ m for m in powers[len(c) :]])
    return np.linalg.lstsq(
        ad, np.linalg.lstsq(observability_here, observability @ gain, rcond=None)[0], rcond=None
    )[0]


def gains_of(system, z):
    """Return the gains (n,) of a system of discrete time at points z (n,) of the plane."""
    a, b0, b1, c, d = system
    resolvents = z[:, None, None] * np.eye(len(c)) - a
    states = np.linalg.solve(resolvents, (b0 + z[:, None] * b1)[..., None].astype(complex))
    return states[..., 0] @ c + d


def one_step_starts(records, n_poles, make, integrators=0):
    """Return starting pairs of operator and gain; ``make`` makes an operator from sections.

    Its numerator gives it the gains of the system that was found; as many of the system's poles as
    there are integrators, those closest to zero, are left to the integrators.
    """
    poles, system, gain = subspace_start(records, n_poles + integrators)
    poles = _without_integrators(poles, integrators)
    operator, dt = make(*sections(poles)), records[0].dt
    z = np.exp(1j * np.linspace(0.0, np.pi, _POINTS * (n_poles + 2) + 2)[1:-1])
    linear = [name != "intercept" and spec.linear for name, spec in operator.entries()]
    values, columns = np.where(linear, 0.0, operator.pack()), []
    for place in np.flatnonzero(linear):
        values[place] = 1.0
        columns.append(gains_of(operator.unpack(values).discrete(dt), z))
        values[place] = 0.0
    rows, target = np.transpose(columns), gains_of(system, z)
    weight = 1.0 / np.maximum(np.abs(target), 1e-3 * np.abs(target).max())
    rows, target = (
        np.concatenate([part.real, part.imag]) for part in ((rows.T * weight).T, target * weight)
    )
    values[linear] = np.linalg.lstsq(rows, target, rcond=None)[0]
    operator = operator.unpack(values)
    a, _, _, c, _ = system
    predictor_gain = in_basis(operator, dt, a, c, gain)
    return [(operator, predictor_gain), (operator, _kalman_gain(operator, dt))]


def _without_integrators(poles, count):
    """Return poles without the ``count`` closest to zero; a broken pair becomes real."""
    poles = poles[np.argsort(np.abs(poles))[count:]]
    alone = np.array([not np.any(np.isclose(poles, p.conj())) for p in poles], dtype=bool)
    return np.where(alone, poles.real, poles)


def _kalman_gain(operator, dt):
    """Return the gain of a stationary Kalman filter, for noise that enters as the drive does."""
    ad, b0, b1, c, _ = operator.discrete(dt)
    b, n = b0 + b1, len(b0)
    p = solve_discrete_are(ad.T, c[:, None], np.outer(b, b) + _REST * np.eye(n), [[1.0]])
    return p @ c / (c @ p @ c + 1.0)
