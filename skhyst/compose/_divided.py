r"""A nonlinear stage between two linear parts, started from their best linear approximation.

For a Gaussian drive, a curve between two linear parts :math:`G_1, G_2` changes the best linear
approximation :math:`G = k\,G_1 G_2` only by a factor (Bussgang [1]_), so that the poles and zeros
of both parts are those of :math:`G`; only their assignment to the parts is unknown. Every division
is tried, as by Sjöberg and Schoukens [2]_. Instead of a fit, each costs a few filtered signals.
With :math:`x = G_1 u`, the response is regressed on the derivatives of the linear prediction by its
parameters and on :math:`G_2 f_i(x)`, where :math:`f_i` are the Legendre polynomials of degree 2 to
5 and two plays of :math:`x`; the division of least residual is the most promising (a score
statistic: the derivatives represent the refit of the linear parts). The stage in between is then
started in the same way, by its output and its derivatives by its own parameters.

References
----------
.. [1] Bussgang, *Crosscorrelation functions of amplitude-distorted Gaussian signals*, 1952.
.. [2] Sjöberg and Schoukens, *Automatica*, 2012.
"""

from dataclasses import replace

import numpy as np

from ..operators import Series, play_basis, propagate

_DEGREE = 5  # degree of the curve by which divisions are compared: it may bend and saturate
_PLAYS = np.array([0.03, 0.1])  # half gaps, relative to the range of the signal in between
_DIVISIONS = 3  # number of divisions that are kept for a fit
_ENOUGH = 10_000  # samples that suffice to compare divisions
_TINY = np.finfo(float).tiny


class Divisions:
    """The divisions of a linear operator in two, the most promising first.

    Parameters
    ----------
    operator : TransferFunctionOperator
        Best linear approximation, at its solution.
    records : sequence of RecordData
        With the input of the operator as their drive.
    initial_state : {"rest", "zero"}, default="rest"
        State before each record.
    behind : sequence of Operator, default=()
        Later stages of the series.
    fitting : callable, optional
        Takes both parts of a division and returns them as a model represents them, or None if it
        cannot.
    """

    def __init__(self, operator, records, initial_state="rest", *, behind=(), fitting=None):
        self._score = _Score([operator, *behind], first_parts(records), initial_state)
        self._behind = behind
        divisions = map(fitting, operator.divisions()) if fitting else operator.divisions()
        scored = []
        for first, second in filter(None, divisions):
            signals = self._score.outputs(first)
            columns = [_curves_and_plays(x) for x in signals]
            score = self._score.residual_fraction(signals, columns, [second, *behind])
            scored.append((score, first, second, signals))
        self._best = sorted(scored, key=lambda entry: entry[0])[:_DIVISIONS]

    def started(self, starts_of):
        """Return the most promising stages in between, with the parts of their division.

        Parameters
        ----------
        starts_of : callable
            Returns starting operators of the stage in between, for records whose drive is its
            input.

        Returns
        -------
        list of (float, (TransferFunctionOperator, Operator, TransferFunctionOperator))
            At most three, with the fraction of the residual's power that each leaves, ascending.
            Empty if there is no division.
        """
        started = []
        for _, first, second, signals in self._best:
            for start in starts_of(self._score.driven_by(signals)):
                columns = self._score.tangents(start, signals)
                score = self._score.residual_fraction(signals, columns, [second, *self._behind])
                started.append((score, (first, start, second)))
        return sorted(started, key=lambda entry: entry[0])[:_DIVISIONS]


class _Score:
    """The part of a response that columns explain in addition to a linear model's derivatives."""

    def __init__(self, operators, records, state):
        self.records, self.state = records, state
        self._weights = [np.sqrt(record.counts()) for record in records]
        derivatives = [
            _series(operators).sensitivities(r.u, np.empty((len(r.u), 0)), r.dt, state)[1]
            for r in records
        ]
        derivatives = self._stacked(derivatives)
        self._basis = np.linalg.qr(derivatives / _norms(derivatives))[0]
        self._rest = self._beside(self._stacked([record.y[:, None] for record in records]))

    def outputs(self, operator):
        """Return the responses of an operator to the drives."""
        return [operator.run(r.u, r.dt, operator.init(r.u[0], self.state))[0] for r in self.records]

    def driven_by(self, signals):
        """Return the records with other drives."""
        return [replace(r, u=u, before=None) for r, u in zip(self.records, signals, strict=True)]

    def tangents(self, operator, signals):
        """Return the output of an operator and its derivatives by its parameters, per record."""
        columns = []
        for record, x in zip(self.records, signals, strict=True):
            y, dy = operator.sensitivities(x, np.empty((len(x), 0)), record.dt, self.state)
            columns.append(np.column_stack([y, dy]))
        return columns

    def residual_fraction(self, signals, columns, behind):
        """Return the fraction of the residual's power that columns, filtered by ``behind``, leave.

        ``signals`` are the inputs of ``behind``, of which the columns are changes. The residual is
        that of the linear model and of any change of its parameters.
        """
        behind = _series(behind)
        filtered = [
            propagate(behind, x, column, r.dt, self.state)[1]
            for r, x, column in zip(self.records, signals, columns, strict=True)
        ]
        filtered = self._beside(self._stacked(filtered))
        if not np.isfinite(filtered).all():
            return np.inf
        filtered /= _norms(filtered)
        residual = self._rest - filtered @ np.linalg.lstsq(filtered, self._rest, rcond=None)[0]
        return float(np.square(residual).sum() / max(np.square(self._rest).sum(), _TINY))

    def _stacked(self, columns):
        return np.concatenate(
            [w[:, None] * column for w, column in zip(self._weights, columns, strict=True)]
        )

    def _beside(self, columns):
        return columns - self._basis @ (self._basis.T @ columns)


def _series(operators):
    return Series(tuple(map(str, range(len(operators)))), tuple(operators))


def _norms(columns):
    return np.linalg.norm(columns, axis=0) + _TINY


def _curves_and_plays(x):
    """Return polynomials and plays of a signal, (n_samples, 6)."""
    low, high = float(x.min()), float(x.max())
    z = (x - 0.5 * (low + high)) / (0.5 * (high - low) or 1.0)
    plays = np.empty((len(z), len(_PLAYS)))
    play_basis(z, 2.0 * _PLAYS, np.full(len(_PLAYS), z[0]), plays)
    return np.column_stack([np.polynomial.legendre.legvander(z, _DEGREE)[:, 2:], plays])


def first_parts(records):
    """Return the first parts of records, with as many samples in all as suffice."""
    share = _ENOUGH / sum(len(record.u) for record in records)
    if share >= 1.0:
        return list(records)
    return [r.first_part(int(share * len(r.u))) for r in records]
