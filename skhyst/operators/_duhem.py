"""Duhem hysteresis in the form of Coleman and Hodgdon."""

import dataclasses

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._duhem import MAX_TERMS, duhem_run, duhem_tangents
from ._base import Operator, parameter

__all__ = ["DuhemOperator"]


@dataclasses.dataclass(frozen=True, eq=False)
class DuhemOperator(Operator):
    r"""Duhem model of Coleman and Hodgdon with polynomials for its two functions.

    .. math::

        \dot h = \alpha |\dot u| (f(u) - h) + \dot u\, g(u), \qquad y = h + c

        f(u) = s \sum_{i=1}^{d} a_i t^i, \quad g(u) = \sum_{j=0}^{d-1} b_j t^j, \quad
        t = (u - m)/s

    ``f`` is the curve that the response is drawn to, ``g`` its slope where it crosses that curve.
    With ``H_j`` the solution of ``dH_j/du = -sgn(du/dt) alpha H_j + t^j`` the response is
    ``f(u) + sum_j (b_j - (j + 1) a_(j+1)) H_j + c``: linear in all but ``alpha``.

    Parameters
    ----------
    alpha : float
        Reciprocal of the length over which the past is forgotten, 1/drive, positive.
    curve : array-like of shape (d,)
        Coefficients ``a_i`` of ``f``, in response/drive.
    slope : array-like of shape (d,)
        Coefficients ``b_j`` of ``g``, in response/drive.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    center, scale : float, default=0.0, 1.0
        ``m`` and ``s`` in units of the drive, fixed structure: beyond ``center +- scale`` the
        polynomials extrapolate.

    Raises
    ------
    ValueError
        If there are not as many coefficients of ``f`` as of ``g``, or none, or more than 9.

    Notes
    -----
    The step along the straight line between two samples is exact. The model is rate-independent:
    ``dt`` is not used. At degree 1 the response equals that of a Dahl model with
    ``x_c = 1/alpha``, ``F_c = (b_0 - a_1)/alpha`` and a spring ``a_1``. The state is
    ``(H, last drive)``.

    References
    ----------
    B. D. Coleman, M. L. Hodgdon, "A constitutive relation for rate-independent hysteresis in
    ferromagnetically soft materials", Int. J. Engineering Science 24(6), 1986.

    Examples
    --------
    >>> from skhyst.operators import DuhemOperator
    >>> operator = DuhemOperator(1.0, curve=[1.0], slope=[0.5])
    >>> operator.run([0.0, 20.0, 19.0, 0.0], dt=1e-3)[0].round(3)
    array([ 0.   , 19.5  , 19.132,  0.5  ])
    """

    alpha: float = parameter(log=True, lower=0.0, unit="1/drive")
    curve: np.ndarray = parameter(linear=True, unit="response/drive")
    slope: np.ndarray = parameter(linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    center: float = 0.0
    scale: float = 1.0

    carries_scale = True
    rank = 10

    def __post_init__(self):
        for name in ("curve", "slope"):
            constant = np.array(getattr(self, name), dtype=float, ndmin=1)
            constant.flags.writeable = False
            object.__setattr__(self, name, constant)
        degree = self.curve.size
        if (
            self.curve.shape != self.slope.shape
            or self.curve.ndim != 1
            or not (1 <= degree <= MAX_TERMS)
        ):
            raise ValueError(
                "The 'curve' and 'slope' parameters of DuhemOperator must be lists of one length, "
                f"from 1 to {MAX_TERMS}. Got shapes {self.curve.shape} and {self.slope.shape} "
                "instead."
            )

    def _memory(self, u, before, h):
        out = np.empty((u.size, h.size))
        shape = float(self.alpha), float(self.center), float(self.scale)
        duhem_run(u, float(before), h, *shape, out)
        return out

    def _output(self, u, memory):
        t = (u - self.center) / self.scale
        y = np.zeros(u.size)
        for coefficient in self.curve[::-1]:
            y += coefficient
            y *= t
        y *= self.scale
        y += memory @ self._excess()
        y += self.intercept
        return y

    def _excess(self):
        """Return the weights of the memory terms: what g is steeper than f."""
        return self.slope - np.arange(1, self.curve.size + 1) * self.curve

    def init(self, u0, initial_state="rest"):
        h = np.zeros(self.curve.size)
        if initial_state == "zero":
            return h, 0.0
        return self._memory(as_signal([u0]), 0.0, h)[0], float(u0)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if not u.size:
            return np.empty(0), state or self.init(0.0)
        h, before = state or self.init(u[0])
        memory = self._memory(u, before, np.array(h, dtype=float))
        return self._output(u, memory), (memory[-1].copy(), float(u[-1]))

    def linearize(self, u, du, dt, initial_state="rest"):
        # from rest or from zero: either way the path starts at zero, and its rate is immaterial
        u, du = as_signal(u), as_signal(du)
        m, d = du.shape[1], self.curve.size
        memory, tangents = np.empty((u.size, d)), np.empty((u.size, d, m + 1))
        shape = float(self.alpha), float(self.center), float(self.scale)
        duhem_tangents(u, du, *shape, memory, tangents)
        powers = np.vander((u - self.center) / self.scale, d + 1, increasing=True)
        degrees = np.arange(1, d + 1)
        dy = np.empty((u.size, m + self.n_parameters))
        dy[:, : m + 1] = np.einsum("j,njq->nq", self._excess(), tangents)
        dy[:, :m] += (powers[:, :-1] @ (degrees * self.curve))[:, None] * du
        dy[:, m + 1 : m + 1 + d] = self.scale * powers[:, 1:] - degrees * memory
        dy[:, m + 1 + d : m + 1 + 2 * d] = memory
        dy[:, -1] = 1.0
        return self._output(u, memory), dy
