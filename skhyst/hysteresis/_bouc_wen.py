"""Bouc-Wen model: hysteresis with a smooth transition to a limit, integrated exactly.

The law, with the limit D of its hysteretic part as the unit, stands with :class:`BoucWenOperator`,
the curve that all its branches are pieces of in ``_bouc_wen_curve``.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from numbers import Real

import numpy as np

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import LoweredStep, Operator, as_signal, by_fields, parameter
from ._bouc_wen_curve import curve_run, curve_step, curve_tangents, curves, on_branch
from ._common import force_characteristics, show


@dataclass(frozen=True)
class BoucWenOperator(Operator):
    r"""Bouc-Wen hysteresis in normalised form, :math:`g = \alpha z` in :class:`BoucWen`.

    .. math::

        y = k u + \alpha z + c, \qquad
        z' = u' \left\{1 - |z|^n \left[\gamma_z + \beta_z \operatorname{sgn}(u' z)
        + \varphi_z (\operatorname{sgn} u' + \operatorname{sgn} z)\right]\right\}

    with :math:`\beta_z + \gamma_z = D^{-n}`, :math:`\beta_z - \gamma_z = r D^{-n}` and
    :math:`2 \varphi_z = a D^{-n}`, the term of Wang and Wen.

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
    rate-independent: ``dt`` is not used. The state is ``(z, last drive)``. ``"rest"`` is the first
    loading from zero to the first sample; in ``"zero"`` the drive was zero. Both give the same
    output, since the way to the first sample is that first loading.

    Examples
    --------
    >>> from skhyst.hysteresis import BoucWenOperator
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
        self._require("limit", self.limit > 0.0, "be positive")
        self._require("ratio", self.ratio >= 0.0, "be at least 0")
        self._require("exponent", self.exponent > 0.0, "be positive")
        self._require("asymmetry", -1.0 < self.asymmetry < 1.0, "be between -1 and 1")

    def __reduce__(self):
        return by_fields(self)

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

        Without the asymmetry; ``beta = (1 + r)/2 |alpha|^(1-n) D^-n`` and ``gamma = sgn(alpha)
        (1 - r)/2 |alpha|^(1-n) D^-n`` are infinite beyond the range of floating point, as for
        ``alpha = 0``.
        """
        n, size = self.exponent, abs(self.alpha)
        with np.errstate(over="ignore"):
            log = (1.0 - n) * np.log(size) - n * np.log(self.limit) if size > 0.0 else np.inf
            scale = np.exp(log)
        turned = np.sign(self.alpha) * 0.5 * (1.0 - self.ratio)
        gamma = turned * scale if turned != 0.0 else 0.0
        return float(self.alpha), float(0.5 * (1.0 + self.ratio) * scale), float(gamma)

    def way_before_sliding(self):
        return float(self.limit)

    def characteristics(self, seen):
        return force_characteristics(abs(self.alpha) * self.limit, abs(self.alpha))

    @cached_property
    def _sides(self):
        """Sign, limit and ratio above zero, then below; ``1 + sign a`` last."""
        n, r, a = float(self.exponent), float(self.ratio), float(self.asymmetry)
        factors = (1.0, 1.0 + a), (-1.0, 1.0 - a)
        return [(s, self.limit * f ** (-1.0 / n), r / f, f) for s, f in factors]

    @cached_property
    def _curves(self):
        """The curve of a rising drive, and that of a falling one if it is another."""
        above, below = ((ratio, limit) for _, limit, ratio, _ in self._sides)
        pairs = [(below, above), (above, below)][: 1 + (self.asymmetry != 0.0)]
        return curves(float(self.exponent), pairs)

    def init(self, u0, initial_state="rest"):
        virgin = 0.0, 0.0
        return self.run([u0], 1.0, virgin)[1] if initial_state == "rest" else virgin

    def run(self, u, dt, state=None):
        return self._follow(as_signal(u), state or (0.0, 0.0), np.empty((0, 5)))

    def lowered(self, dt, state):
        places, curve, _, *rest = self._curves
        constants = self.gain, self.alpha, self.intercept, places, curve, *rest
        state = [*state, 0.0, 0.0, 0.0]
        return LoweredStep(curve_step, constants, state, possible=on_branch)

    def _follow(self, u, state, trace):
        y = np.empty(u.size)
        weights = float(self.gain), float(self.alpha), float(self.intercept)
        state = curve_run(u, weights, self._curves, float(state[0]), float(state[1]), y, trace)
        return y, state

    def linearize(self, u, du, dt, initial_state="rest"):
        u, du = as_signal(u), as_signal(du)
        trace = np.empty((u.size, 5))
        y, _ = self._follow(u, (0.0, 0.0), trace)
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
        limits = np.array([limit for _, limit, _, _ in self._sides])
        weights = float(self.gain), float(self.alpha)
        curve_tangents(u, du, weights, self._curves, limits, np.array(chain), trace, dy)
        return y, dy


_STARTS = 3
_SCREENED = 400  # samples that decide between starting values
_LIMITS = np.geomspace(0.04, 2.0, 5)  # of half the drive's range
_RATIOS = (0.3, 2.0)
_EXPONENTS = (1.2, 2.5)


class BoucWen(ParametricModel):
    r"""Bouc-Wen model of rate-independent hysteresis.

    .. math::

        y = k u + g + c, \qquad
        g' = \alpha u' - \beta |u'| |g|^{n-1} g - \gamma u' |g|^n

    (Xie et al. 2023, (1) and (2), with the last exponent as in the original law). The drive is a
    straight line between samples and the law is integrated exactly. For ``alpha > 0`` the
    hysteretic part ``g`` goes ahead of the drive, as a friction force does; for ``alpha < 0`` it
    makes the response lag behind the drive, as in a piezo.

    It is identified as ``g = alpha z`` with the limit ``D`` of ``z`` (a drive) and the ratio ``r``,
    because ``k``, ``alpha`` and ``c`` are then linear and solved exactly, and the bounds
    ``D > 0``, ``r >= 0`` are just the condition that the model is bounded and dissipates,
    ``beta > 0`` and ``beta >= |gamma|``:

    .. math::

        \beta = \frac{1 + r}{2} |\alpha|^{1-n} D^{-n}, \qquad
        \gamma = \operatorname{sgn}(\alpha) \frac{1 - r}{2} |\alpha|^{1-n} D^{-n}

    Parameters
    ----------
    exponent : float or "fit", default=1.0
        ``n``, sharpness of the transition to the limit, between 0.5 and 20.
    asymmetry : bool, default=False
        Whether the loop may differ above and below: the generalised law of Wang and Wen,
        ``z' = u' {1 - |z|^n [gamma_z + beta_z sgn(u' z) + phi_z (sgn u' + sgn z)]}``, in which one
        parameter ``asymmetry = 2 phi_z / (beta_z + gamma_z)`` between -0.95 and 0.95 is added.
    fit_gain : bool, default=True
        Whether the elastic part ``k u`` is fitted (0 otherwise): not beside a model that has a
        spring of its own.
    fit_intercept : bool, default=True
        Whether the response has a constant.

    Attributes
    ----------
    alpha_, beta_, gamma_ : float
        Coefficients of the law above: response/drive, ``response^(1-n)/drive``,
        ``response^(1-n)/drive``. They follow from ``alpha``, ``limit``, ``ratio`` and ``exponent``.
    exponent_ : float
        ``n``.
    intercept_ : float
        Units of the response.
    params_, params_std_ : dict
        ``gain`` (``k``), ``alpha``, ``limit`` (``D``), ``ratio`` (``r``), ``exponent``,
        ``asymmetry``, ``intercept`` as far as they are fitted, and their standard errors.

    References
    ----------
    Bouc, *Fourth Conference on Nonlinear Oscillations*, 1967. Wen, *Journal of the Engineering
    Mechanics Division*, 1976. Xie et al., *Smart Materials and Structures*, 2023, section 2.1,
    where (2) is misprinted. Normalised form: Ikhouane and Rodellar, *Systems with Hysteresis*,
    2007. Asymmetry: Wang and Wen, *Journal of Structural Engineering*, 2000; compared with others
    by Song and Der Kiureghian, *Journal of Engineering Mechanics*, 2006.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWen, BoucWenOperator
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> truth = BoucWenOperator.from_coefficients(alpha=2.0, beta=1.5, gamma=0.5, gain=0.7)
    >>> response, _ = truth.run(drive, dt=1.0)
    >>> model = BoucWen().fit(drive.reshape(-1, 1), response)
    >>> print(f"{model.alpha_:.4f} {model.beta_:.4f} {model.gamma_:.4f}")
    2.0000 1.5000 0.5000
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "exponent": [Interval(Real, 0.5, 20.0, closed="both"), StrOptions({"fit"})],
        "asymmetry": ["boolean"],
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
    }

    series_rank = BoucWenOperator.rank

    def __init__(
        self,
        exponent=1.0,
        *,
        asymmetry=False,
        fit_gain=True,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, method=method)
        self.exponent = exponent
        self.asymmetry = asymmetry
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        """Return the best three limits of a coarse grid, what is linear solved at some samples.

        A disturbance beside the model may make another one look best.
        """
        half_range = 0.5 * max(np.ptp(record.u) for record in records)
        if not half_range > 0.0:
            half_range = max(np.abs(record.u).max() for record in records) or 1.0
        exponents = _EXPONENTS if self.exponent == "fit" else (float(self.exponent),)
        step = 1 + sum(stop - start for r in records for start, stop in r.segments) // _SCREENED
        drives, rows, response = [], [], []
        for r in records:
            wanted = np.concatenate([np.arange(*part) for part in r.segments])[::step]
            # between turning points the samples do not matter, and need not be simulated
            rising = np.diff(r.u, prepend=0.0) > 0.0
            kept = np.append(rising[1:] != rising[:-1], True)
            kept[wanted] = True
            drives.append(r.u[kept])
            rows.append(np.cumsum(kept)[wanted] - 1)
            response.append(r.y[wanted])
        drive = np.concatenate([u[part] for u, part in zip(drives, rows, strict=True)])
        response = np.concatenate(response)
        free = [bool(self.fit_gain), bool(self.fit_intercept)]
        known = np.column_stack((drive, np.ones(len(drive))))[:, free]
        basis, _ = np.linalg.qr(known)
        rest = response - basis @ (basis.T @ response)
        found = {}
        for ratio, exponent in product(_RATIOS, exponents):
            # all limits have one curve: z / limit is a function of u / limit
            unit = BoucWenOperator(0.0, 1.0, 1.0, ratio, exponent)
            for limit in half_range * _LIMITS:
                runs = [unit.run(u / limit, 1.0)[0] for u in drives]
                z = np.concatenate([z[part] for z, part in zip(runs, rows, strict=True)])
                own = z - basis @ (basis.T @ z)
                power = own @ own
                explained = (own @ rest) ** 2 / power if power > 1e-20 * (z @ z) else 0.0
                if limit not in found or explained > found[limit][0]:
                    found[limit] = explained, ratio, exponent, limit * z
        best = sorted(found.items(), key=lambda item: -item[1][0])[:_STARTS]
        return [
            (self._start(float(limit), ratio, exponent, z, known, response), ())
            for limit, (_, ratio, exponent, z) in best
        ]

    def _identify(self, data):
        return self._refine(self.starting_values(data)[:1], data)  # alone, the best is enough

    def _start(self, limit, ratio, exponent, z, known, response):
        linear = np.linalg.lstsq(np.column_stack((z, known)), response, rcond=None)[0]
        alpha, *others = linear.tolist()
        gain = others.pop(0) if self.fit_gain else 0.0
        return BoucWenOperator(gain, alpha, limit, ratio, exponent, intercept=sum(others))

    def held_parameters(self) -> frozenset[str]:
        held = super().held_parameters() | (set() if self.asymmetry else {"asymmetry"})
        return held if self.exponent == "fit" else held | {"exponent"}

    def _adopt(self, result):
        super()._adopt(result)
        self.alpha_, self.beta_, self.gamma_ = self.operator_.coefficients()
        show(self, self.operator_, "exponent", "intercept")
        return self
