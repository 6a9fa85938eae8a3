"""Operators of one state: a law is one step; all other methods are common to them.

The loops of this file are compiled for each law, see :func:`skhyst._jit.bind`.
"""

from abc import abstractmethod

import numpy as np

from .._jit import bind, jit
from ._compiled_step import CompiledLaw
from ._protocol import Operator, as_signal


def step(x, u0, u1, dt, values):
    """Placeholder of a law, which ``bind`` puts in its place; see :class:`OneStateOperator`."""
    raise NotImplementedError


def run(u, x, last, dt, values, y):
    """Write the output to ``y`` (n,) and return the final state; ``last`` is the drive before."""
    for k in range(u.size):
        x, y[k], _, _ = step(x, last, u[k], dt, values)
        last = u[k]
    return x


def tangents(u, du, x, dx, last, dlast, dt, values, y, dy):
    """Write the output (n,) and its tangents (n, m + p): those of ``du``, then by p parameters.

    ``dx`` (m + s,), the tangents of the state, which depends on s parameters, and ``dlast`` (m,),
    those of the last drive, are overwritten.
    """
    m = du.shape[1]
    for k in range(u.size):
        x, y[k], state_by, output_by = step(x, last, u[k], dt, values)
        last = u[k]
        for q in range(m):
            x_q, from_q, to_q = dx[q], dlast[q], du[k, q]
            dlast[q] = to_q
            dx[q] = state_by[0] * x_q + state_by[1] * from_q + state_by[2] * to_q
            dy[k, q] = output_by[0] * x_q + output_by[1] * from_q + output_by[2] * to_q
        for q in range(len(state_by) - 3):
            x_q = dx[m + q]
            dx[m + q] = state_by[0] * x_q + state_by[3 + q]
            dy[k, m + q] = output_by[0] * x_q + output_by[3 + q]
        for q in range(len(state_by) - 3, len(output_by) - 3):
            dy[k, m + q] = output_by[3 + q]


def compiled_step(u, c, s):
    """Return the output at one sample; ``c`` is (dt, *values), ``s`` the state and last drive."""
    x, y, _, _ = step(s[0], s[1], u, c[0], c[1:])
    s[0], s[1] = x, u
    return y


class OneStateOperator(Operator):
    """Base of the operators whose state is one number and the last drive.

    A subclass is a frozen dataclass whose parameters are all single numbers. It names its law,
    ``class MyOperator(OneStateOperator, step=my_step)``, a function of numbers in the subset of
    Python that Numba compiles::

        my_step(x, u0, u1, dt, values) -> x1, y, x1_by, y_by

    While the drive goes along a straight line from ``u0`` to ``u1``, the state goes from ``x`` to
    ``x1``, with the output ``y`` at the end. ``values`` is the tuple of the parameters in the order
    of ``pack``, then of the fields that ``structure`` names. ``x1_by`` and ``y_by`` are the tuples
    of the derivatives by ``x``, ``u0``, ``u1`` and the parameters; the former ends with the last
    parameter that the state depends on.

    Attributes
    ----------
    structure : tuple of str
        Further fields that the step reads, all numbers; none by default.

    Notes
    -----
    The state is the tuple ``(x, last drive)``; in ``"zero"`` both are zero. ``"rest"`` is the step
    from there to the first sample, which is right for a rate-independent law; others define their
    state at rest in :meth:`rest`.

    Examples
    --------
    A ratchet that goes up with the drive and never down, behind a gain:

    >>> from dataclasses import dataclass
    >>> from skhyst.operators import OneStateOperator, parameter
    >>> def ratchet(x, u0, u1, dt, values):
    ...     (gain,) = values
    ...     if u1 > x:
    ...         return u1, gain * u1, (0.0, 0.0, 1.0), (0.0, 0.0, gain, u1)
    ...     return x, gain * x, (1.0, 0.0, 0.0), (gain, 0.0, 0.0, x)
    >>> @dataclass(frozen=True)
    ... class RatchetOperator(OneStateOperator, step=ratchet):
    ...     gain: float = parameter(linear=True)
    >>> RatchetOperator(2.0).run([1.0, 3.0, 2.0, 4.0], dt=1.0)[0]
    array([2., 6., 6., 8.])
    """

    structure = ()

    def __init_subclass__(cls, step=None, **options):
        super().__init_subclass__(**options)
        if step is not None:
            law = jit(step, inline=True)
            cls._law = staticmethod(law)
            loops = (staticmethod(bind(loop, law)) for loop in (run, tangents, compiled_step))
            cls._run, cls._tangents, cls._compiled_step = loops

    @staticmethod
    @abstractmethod
    def _law(x, u0, u1, dt, values):
        """The step given by the subclass."""

    def _values(self):
        names = (*self._sizes, *self.structure)
        return tuple(float(getattr(self, name)) for name in names)

    def rest(self, u0):
        """Return the state at rest.

        Parameters
        ----------
        u0 : float
            Drive.

        Returns
        -------
        state : float
            State at rest at ``u0``.
        derivatives : tuple of float
            By ``u0`` and by the parameters.
        """
        x, _, by, _ = self._law(0.0, 0.0, u0, 1.0, self._values())
        return x, by[2:]

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``; see :meth:`Operator.init`."""
        return (self.rest(float(u0))[0], float(u0)) if initial_state == "rest" else (0.0, 0.0)

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        x, last = self.init(u[0] if u.size else 0.0) if state is None else state
        y = np.empty(u.size)
        x = self._run(u, x, last, float(dt), self._values(), y)
        return y, (x, float(u[-1]) if u.size else last)

    def compiled_step(self, dt, state):
        """Return one step in plain arithmetic; see :meth:`Operator.compiled_step`."""
        return CompiledLaw(self._compiled_step, (dt, *self._values()), state)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.sensitivities`."""
        u, du = as_signal(u), as_signal(du)
        m, first = du.shape[1], float(u[0]) if u.size else 0.0
        x, (by_first, *by) = self.rest(first)
        dx, dlast = np.zeros(m + len(by)), np.zeros(m)
        if initial_state == "zero":
            x = first = 0.0
        elif u.size:
            dlast[:] = du[0]
            dx[:m], dx[m:] = by_first * dlast, by
        y, dy = np.empty(u.size), np.empty((u.size, m + self.n_parameters))
        self._tangents(u, du, x, dx, first, dlast, float(dt), self._values(), y, dy)
        return y, dy
