"""Bouc-Wen model: hysteresis with a smooth transition to a limit."""

from itertools import product
from numbers import Real

import numpy as np

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import BoucWenOperator

__all__ = ["BoucWen"]

_SCREENED = 400  # samples that decide between starting values
_LIMITS = np.geomspace(0.04, 2.0, 5)  # of half the drive's range
_RATIOS = (0.3, 2.0)
_EXPONENTS = (1.2, 2.5)


class BoucWen(ParametricModel):
    r"""Bouc-Wen model of rate-independent hysteresis.

    .. math::

        y = k u + g + c, \qquad
        g' = \alpha u' - \beta |u'| |g|^{n-1} g - \gamma u' |g|^n

    (tanh paper (1)-(2), with the last exponent as in the original law). The drive is a straight
    line between samples and the law is integrated exactly. For ``alpha > 0`` the hysteretic part
    ``g`` goes ahead of the drive, as a friction force does; for ``alpha < 0`` it makes the
    response lag behind the drive, as in a piezo.

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
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    alpha_, beta_, gamma_ : float
        Coefficients of the law above: response/drive, ``response^(1-n)/drive``,
        ``response^(1-n)/drive``. They follow from ``alpha``, ``limit``, ``ratio`` and ``exponent``.
    exponent_ : float
        ``n``.
    intercept_ : float
        Units of the response.
    operator_ : BoucWenOperator
        The model as frozen numbers, to run sample by sample.
    params_, params_std_ : dict
        ``gain`` (``k``), ``alpha``, ``limit`` (``D``), ``ratio`` (``r``), ``exponent``,
        ``asymmetry``, ``intercept`` as far as they are fitted, and their standard errors.

    References
    ----------
    Tanh paper, section 2.1. R. Bouc, "Forced vibration of mechanical systems with hysteresis",
    1967; Y.-K. Wen, "Method for random vibration of hysteretic systems", J. Eng. Mech. Div. 102,
    1976. C.-H. Wang and Y.-K. Wen, "Evaluation of pre-Northridge low-rise steel buildings I:
    modeling", J. Struct. Eng. 126(10), 2000.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWen
    >>> from skhyst.operators import BoucWenOperator
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

    _rank = BoucWenOperator.rank

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
        self.exponent = exponent
        self.asymmetry = asymmetry
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        """Return the best of a coarse grid, the linear parameters solved at some samples."""
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
        best, most = None, -np.inf
        for ratio, exponent in product(_RATIOS, exponents):
            # all limits have one curve: z / limit is a function of u / limit
            unit = BoucWenOperator(0.0, 1.0, 1.0, ratio, exponent)
            for limit in half_range * _LIMITS:
                z = np.concatenate(
                    [
                        unit.run(u / limit, 1.0)[0][part]
                        for u, part in zip(drives, rows, strict=True)
                    ]
                )
                own = z - basis @ (basis.T @ z)
                power = own @ own
                explained = (own @ rest) ** 2 / power if power > 1e-20 * (z @ z) else 0.0
                if explained > most:
                    most, best = explained, (limit * z, float(limit), ratio, exponent)
        z, limit, ratio, exponent = best
        linear = np.linalg.lstsq(np.column_stack((z, known)), response, rcond=None)[0]
        alpha, *others = linear.tolist()
        gain = others.pop(0) if self.fit_gain else 0.0
        operator = BoucWenOperator(gain, alpha, limit, ratio, exponent, intercept=sum(others))
        return [(operator, ())]

    def _fixed(self):
        free = {
            "exponent": self.exponent == "fit",
            "asymmetry": self.asymmetry,
            "gain": self.fit_gain,
            "intercept": self.fit_intercept,
        }
        return frozenset(name for name, is_free in free.items() if not is_free)

    def _adopt(self, result):
        super()._adopt(result)
        self.alpha_, self.beta_, self.gamma_ = self.operator_.coefficients()
        self.exponent_ = float(self.operator_.exponent)
        self.intercept_ = float(self.operator_.intercept)
        return self
