"""Bouc-Wen operator in normalised form, integrated exactly."""

import dataclasses
import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .._kernels._arrays import as_signal
from .._kernels._bouc_wen import GRID, N_BINS, build_curve, curve_run, curve_tangents
from ._base import Operator, parameter

__all__ = ["BoucWenOperator", "BoucWenState"]


class BoucWenState(NamedTuple):
    """What a Bouc-Wen operator remembers.

    Parameters
    ----------
    z : float
        Hysteretic part, in units of the drive.
    last : float
        Last value of the drive.
    """

    z: float
    last: float


@dataclasses.dataclass(frozen=True)
class BoucWenOperator(Operator):
    r"""Bouc-Wen hysteresis.

    .. math::

        y = k u + \alpha z + c, \qquad
        z' = u' \left\{1 - |z|^n \left[\gamma_z + \beta_z \operatorname{sgn}(u' z)
        + \varphi_z (\operatorname{sgn} u' + \operatorname{sgn} z)\right]\right\}

    with :math:`\beta_z + \gamma_z = D^{-n}`, :math:`\beta_z - \gamma_z = r D^{-n}` and
    :math:`2 \varphi_z = a D^{-n}`. For ``a = 0`` this is the law of Bouc and Wen for
    :math:`g = \alpha z`; the term with ``a`` is that of Wang and Wen. The output is in phase with
    the drive or before it for ``alpha > 0`` (a force over a displacement) and lags behind it for
    ``alpha < 0`` (the displacement of a piezo over its voltage).

    Parameters
    ----------
    gain : float
        ``k`` in response/drive.
    alpha : float
        Slope of the hysteretic part at ``z = 0``, in response/drive.
    limit : float
        ``D``, positive, in units of the drive: the hysteretic part ``z`` stays within ``+-D`` (for
        ``asymmetry = 0``), so the loop is at most ``2 |alpha| D`` high.
    ratio : float, default=1.0
        ``r``: how much the slope exceeds ``alpha`` right behind the reversal of a large loop, over
        ``alpha``. At least 0, so that the model dissipates: ``beta_z >= |gamma_z|``.
    exponent : float, default=1.0
        ``n``, positive: sharpness of the transition to the limit.
    asymmetry : float, default=0.0
        ``a`` in (-1, 1): the limits are ``D (1 + a)^(-1/n)`` above and ``-D (1 - a)^(-1/n)`` below
        zero.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.

    Raises
    ------
    ValueError
        If ``limit`` or ``exponent`` is not positive, ``ratio`` is negative or ``asymmetry`` not
        between -1 and 1.

    Notes
    -----
    The drive is a straight line between samples and the law is integrated exactly, for every
    exponent, so neither the length of a step nor samples in between matter. The operator is
    rate-independent: ``dt`` is not used. The state is a :class:`BoucWenState`. ``"rest"`` is the
    first loading from zero to the first sample; in ``"zero"`` the drive was zero. Both give the
    same output, since the way to the first sample is that first loading.

    References
    ----------
    Tanh paper, (1)-(2), as corrected in the list of errata. Normalised form: F. Ikhouane and
    J. Rodellar, "Systems with hysteresis", Wiley 2007. Asymmetry: C.-H. Wang and Y.-K. Wen,
    "Evaluation of pre-Northridge low-rise steel buildings I: modeling", J. Struct. Eng. 126(10),
    2000; compared with others by J. Song and A. Der Kiureghian, "Generalized Bouc-Wen model for
    highly asymmetric hysteresis", J. Eng. Mech. 132(6), 2006.

    Examples
    --------
    >>> from skhyst.operators import BoucWenOperator
    >>> operator = BoucWenOperator(gain=0.5, alpha=1.0, limit=2.0)
    >>> y, state = operator.run([0.0, 20.0, -20.0], dt=1e-3)
    >>> y.round(3)
    array([  0., 12., -12.])
    >>> BoucWenOperator.from_coefficients(alpha=1.0, beta=0.5, gamma=0.5, exponent=2.0).limit
    1.0
    """

    gain: float = parameter(linear=True, unit="response/drive")
    alpha: float = parameter(linear=True, unit="response/drive")
    limit: float = parameter(log=True, lower=0.0, unit="drive")
    ratio: float = parameter(default=1.0, lower=0.0)
    # below 0.5 the curvature at z = 0 is beyond any data, above 20 the corner is a kink
    exponent: float = parameter(default=1.0, log=True, lower=0.5, upper=20.0)
    asymmetry: float = parameter(default=0.0, lower=-0.95, upper=0.95)
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    carries_scale = True
    rank = 10

    def __post_init__(self):
        for name, valid, requirement in (
            ("limit", self.limit > 0.0, "positive"),
            ("ratio", self.ratio >= 0.0, "at least 0"),
            ("exponent", self.exponent > 0.0, "positive"),
            ("asymmetry", -1.0 < self.asymmetry < 1.0, "between -1 and 1"),
        ):
            if not valid:
                raise ValueError(
                    f"The '{name}' parameter of BoucWenOperator must be {requirement}. "
                    f"Got {getattr(self, name)!r} instead."
                )

    def __reduce__(self):
        fields = dataclasses.fields(self)
        return type(self), tuple(getattr(self, field.name) for field in fields)

    @classmethod
    def from_coefficients(cls, alpha, beta, gamma, exponent=1.0, *, gain=0.0, intercept=0.0):
        """Return the operator of the law as printed.

        ``y = k u + g + c`` with ``g' = alpha u' - beta |u'| |g|^(n-1) g - gamma u' |g|^n``.

        Parameters
        ----------
        alpha : float
            Not zero.
        beta, gamma : float
            With ``beta > 0`` and ``beta >= |gamma|``, where at most one of the two signs of
            ``gamma`` is an equality.
        exponent : float, default=1.0
            ``n``.
        gain, intercept : float, default=0.0
            ``k`` and ``c`` of ``y = k u + g + c``.

        Returns
        -------
        BoucWenOperator

        Raises
        ------
        ValueError
            If the law is not bounded or does not dissipate.
        """
        # with g = alpha z, and sgn(u' g) the opposite of sgn(u' z) where alpha is negative
        gamma_on = gamma * np.sign(alpha)
        if not beta + gamma_on > 0.0 or not beta - gamma_on >= 0.0:
            raise ValueError(
                "BoucWenOperator.from_coefficients needs 'beta' > 0 and 'beta' >= |'gamma'|, and "
                "more than -'gamma' (than 'gamma' where 'alpha' is negative): the law must be "
                f"bounded and dissipate. Got beta={beta!r}, gamma={gamma!r} instead."
            )
        # limit of g, which is the limit of z times |alpha|
        bound = (abs(alpha) / (beta + gamma_on)) ** (1.0 / exponent)
        return cls(
            gain=gain,
            alpha=alpha,
            limit=float(bound / abs(alpha)),
            ratio=float((beta - gamma_on) / (beta + gamma_on)),
            exponent=exponent,
            intercept=intercept,
        )

    def coefficients(self):
        """Return ``alpha, beta, gamma`` of the law as printed, see :meth:`from_coefficients`.

        ``beta = (1 + r)/2 |alpha|^(1-n) D^-n``, ``gamma = sgn(alpha) (1 - r)/2 |alpha|^(1-n)
        D^-n``; without the asymmetry. Both are infinite beyond the range of floating point, as for
        ``alpha = 0``.
        """
        n, size = self.exponent, abs(self.alpha)
        with np.errstate(over="ignore"):
            log = (1.0 - n) * np.log(size) - n * np.log(self.limit) if size > 0.0 else np.inf
            scale = np.exp(log)
        turned = np.sign(self.alpha) * 0.5 * (1.0 - self.ratio)
        gamma = turned * scale if turned != 0.0 else 0.0
        return float(self.alpha), float(0.5 * (1.0 + self.ratio) * scale), float(gamma)

    @cached_property
    def _sides(self):
        """Sign, limit and ratio above zero, then below; ``1 + sign a`` last."""
        n, r, a = float(self.exponent), float(self.ratio), float(self.asymmetry)
        factors = (1.0, 1.0 + a), (-1.0, 1.0 - a)
        return [(s, self.limit * f ** (-1.0 / n), r / f, f) for s, f in factors]

    @cached_property
    def _curves(self):
        """The curve of a rising drive, and that of a falling one if it is another."""
        above, below = self._sides
        *grid, _ = GRID
        n_curves = 1 + (self.asymmetry != 0.0)
        n_rows = n_curves * (len(grid[0]) + 1)
        tables = (
            np.empty(n_rows),
            np.empty((n_rows, 9)),
            np.empty((n_rows, 12)),
            np.empty(n_curves * (N_BINS + 1), dtype=np.int16),
            np.empty((n_curves, 3)),
        )
        for number in range(n_curves):
            behind, ahead = (below, above) if number == 0 else (above, below)
            build_curve(
                *grid, float(self.exponent), behind[2], behind[1], ahead[1], number, *tables
            )
        return tables

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample ``u0``, a :class:`BoucWenState`."""
        virgin = BoucWenState(0.0, 0.0)
        return self.run([u0], 1.0, virgin)[1] if initial_state == "rest" else virgin

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        y, z, last = self._follow(as_signal(u), state or (0.0, 0.0), np.empty((0, 5)))
        return y, BoucWenState(z, last)

    def _follow(self, u, state, trace):
        y = np.empty(u.size)
        places, curve, _, bins, scales = self._curves
        z, last = curve_run(
            u,
            float(self.gain),
            float(self.alpha),
            float(self.intercept),
            places,
            curve,
            bins,
            scales,
            GRID[-1],
            float(state[0]),
            float(state[1]),
            y,
            trace,
        )
        return y, z, last

    def linearize(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.linearize`."""
        u, du = as_signal(u), as_signal(du)
        trace = np.empty((u.size, 5))
        y, _, _ = self._follow(u, (0.0, 0.0), trace)
        dy = np.empty((u.size, du.shape[1] + self.n_parameters))
        n, r = float(self.exponent), float(self.ratio)
        # of limit, exponent and ratio of a side, by limit, ratio, exponent and asymmetry
        chain = [
            (
                (limit / self.limit, 0.0, limit * math.log(f) / n**2, -sign * limit / (n * f)),
                (0.0, 0.0, 1.0, 0.0),
                (0.0, 1.0 / f, 0.0, -sign * r / f**2),
            )
            for sign, limit, _, f in self._sides
        ]
        curve_tangents(
            u,
            du,
            float(self.gain),
            float(self.alpha),
            *self._curves[:3],
            np.array([side[1] for side in self._sides]),
            np.array(chain),
            trace,
            dy,
        )
        return y, dy
