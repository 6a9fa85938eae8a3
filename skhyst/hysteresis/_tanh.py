"""Hyperbolic tangent model of piezo actuators: a static curve plus a term in the drive's rate."""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ..base import ParametricModel, refine
from ..operators import (
    CompiledLaw,
    InverseOperator,
    OneStateOperator,
    RootInverseOperator,
    in_ring,
    parameter,
)
from ._common import largest_drive


def tanh_step(nothing, u0, u1, dt, values):
    """Return the response and derivatives; the last drive is the only memory of the model."""
    k0, alpha, beta, gamma, intercept = values
    rate = (u1 - u0) / dt
    bend = math.tanh(gamma * u1)
    slope = (1.0 - bend) * (1.0 + bend)
    damping = alpha / dt
    gain = k0 + beta * gamma * slope + damping
    return (
        0.0,
        intercept + k0 * u1 + alpha * rate + beta * bend,
        (0.0, 0.0, 0.0),
        (0.0, -damping, gain, u1, rate, bend, beta * u1 * slope, 1.0),
    )


@dataclass(frozen=True)
class TanhHysteresisOperator(OneStateOperator, step=tanh_step):
    """Static curve plus a term in the drive's rate: the law of :class:`TanhHysteresis`.

    Parameters
    ----------
    k0 : float
        Slope far from zero, response/drive.
    alpha : float
        Weight of the rate, response s/drive; negative values make the response lag.
    beta : float
        Height of the bend at zero, units of the response.
    gamma : float
        Steepness of the bend, 1/drive, positive.
    intercept : float, default=0.0
        Constant ``c``, units of the response.

    Notes
    -----
    The state is ``(0, last drive)``. In ``"rest"`` the last drive equals the first sample, so that
    the rate begins at zero; in ``"zero"`` it is zero.

    Examples
    --------
    >>> from skhyst.hysteresis import TanhHysteresisOperator
    >>> operator = TanhHysteresisOperator(k0=0.1, alpha=-1e-4, beta=0.5, gamma=100.0)
    >>> operator.run([0.0, 10.0, 10.0], dt=1e-3)[0]
    array([0. , 0.5, 1.5])
    """

    k0: float = parameter(linear=True, unit="response/drive")
    alpha: float = parameter(linear=True, unit="response s/drive")
    beta: float = parameter(linear=True, unit="response")
    gamma: float = parameter(log=True, lower=0.0, unit="1/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")

    owns_gain = True
    stage_order = 10

    def inverse(self):
        """Return the inverse; it needs preview of the response if ``alpha`` is negative."""
        return RootInverseOperator(self) if self.alpha >= 0.0 else TanhInverseOperator(self)


@jit
def drive_before(u, y, c):
    """Return the drive one sample before ``u``, where ``u`` gives the response ``y``.

    ``c`` is (-alpha / dt, k0, beta, gamma, intercept).
    """
    slope, k0, beta, gamma, intercept = c[0], c[1], c[2], c[3], c[4]
    return u + (y - (intercept + k0 * u + beta * math.tanh(gamma * u))) / slope


@jit
def drives_before(y, c, u):
    """Fill ``u`` (n,) backwards from its last value with the drives that give ``y`` (n,)."""
    for k in range(u.size - 1, 0, -1):
        u[k - 1] = drive_before(u[k], y[k], c)


@jit
def inverse_step(y, c, s):
    """Return the drive of the sample that lies the preview length before ``y``.

    ``c`` is that of :func:`drive_before`, then a mean slope of the curve. ``s`` is a ring buffer:
    the index of the next response, then the last responses.
    """
    n = s.size - 1
    at = int(s[0])
    s[1 + at] = y
    s[0] = (at + 1) % n
    u = (y - c[4]) / c[5]
    for k in range(n):
        u = drive_before(u, s[1 + (at + n - k) % n], c)
    return u


@dataclass(frozen=True)
class TanhInverseOperator(InverseOperator):
    """Inverse of the tanh model with ``alpha < 0``: from the response to its drive.

    With ``a = -alpha / dt`` and the curve ``f(u) = k0 u + beta tanh(gamma u) + intercept`` the
    response is ``y[k] = f(u[k]) - a (u[k] - u[k-1])``. Solved for ``u[k]``, errors grow by
    ``a / (a - f')`` per sample. Solved for the previous drive,

        u[k-1] = u[k] + (y[k] - f(u[k])) / a,

    they shrink by ``1 - f' / a`` per sample towards the beginning, as long as f' is below 2 a. So a
    record is inverted backwards in time, from an assumed rest after its end, and a stream is fed
    the response with preview. At long sampling intervals, where f' is larger, each sample is solved
    for its root instead.
    """

    causal = False

    def init(self, u0, initial_state="rest"):
        """Return None: a record is inverted in one pass, without a state; see the base."""
        return None

    def _backwards(self, dt):
        """Return the constants of a backward run and the factor of its errors per sample."""
        o = self.operator
        slope, steepest = -o.alpha / dt, o.k0 + max(o.beta * o.gamma, 0.0)
        flattest = o.k0 + min(o.beta * o.gamma, 0.0)
        shrinkage = max(abs(1.0 - flattest / slope), abs(1.0 - steepest / slope))
        values = slope, o.k0, o.beta, o.gamma, o.intercept, 0.5 * (flattest + steepest)
        return tuple(map(float, values)), shrinkage

    def run(self, u, dt, state=None):
        """Return the drive (n_samples,) whose response is ``u`` (n_samples,); see the base."""
        c, shrinkage = self._backwards(dt)
        if not shrinkage < 1.0:
            return RootInverseOperator(self.operator).run(u, dt)[0], None
        y = np.append(u, np.full(_samples(shrinkage, np.finfo(float).eps), u[-1]))
        drive = np.full(len(y), (y[-1] - c[4]) / c[5])
        drives_before(y, c, drive)
        return drive[: len(u)], None

    def ahead(self, dt, u0, tol=1e-9):
        """Return a compiled step that is fed the response with preview, and that in samples."""
        c, shrinkage = self._backwards(dt)
        if not shrinkage < 1.0:
            return RootInverseOperator(self.operator).ahead(dt, u0)
        samples = _samples(shrinkage, tol)
        state = [0.0, *np.full(samples, u0)]
        return CompiledLaw(inverse_step, c, state, possible=in_ring), samples


def _samples(shrinkage, tol):
    """Return the number of samples in which errors shrink by ``tol``, at least 1."""
    return max(math.ceil(math.log(tol) / math.log(shrinkage)), 1) if shrinkage > 0.0 else 1


_BENDS = np.geomspace(0.5, 500.0, 7)  # starting values: gamma times the largest drive
_STEP = 20.0  # gamma times the smallest drive of a step: its tanh is 1 to the last bit
_NEGLIGIBLE = 1e-9  # relative to the largest drive: smaller samples count as zero
_SIGNIFICANT = 3.84  # 95 % point of chi-squared, one degree of freedom
_ROUNDING = 1e-12  # relative to the response


class TanhHysteresis(ParametricModel):
    r"""Hyperbolic tangent model: a static curve and a term in the drive's rate.

    .. math:: z = k_0 u + \alpha \dot u + \beta \tanh(\gamma u) + c

    (equation (3) of Xie et al. 2023, plus a constant that is zero by default). The rate is the
    causal backward difference ``(u[k] - u[k-1]) / dt``. The model has no rate-independent memory:
    its loop closes only through ``alpha``, and has an area in proportion to the frequency.

    Parameters
    ----------
    fit_intercept : bool, default=False
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest at that sample, so that the rate begins at
        zero; the drive was zero; or after a rest at a drive value that is fitted per record.

    Attributes
    ----------
    operator_ : TanhHysteresisOperator
        ``k0`` in response/drive, ``alpha`` in response s/drive, ``beta`` in units of the response,
        ``gamma`` in 1/drive.
    identifiability_ : dict
        ``undetermined`` names ``gamma`` if the data do not reject (at 5 %) that the hyperbolic
        tangent is a step, as it is for any large ``gamma``.

    See Also
    --------
    RateDependentPrandtlIshlinskii : Plays that depend on the rate of the drive.
    BoucWen : Rate-independent loops.

    Notes
    -----
    With a drive that is never negative and a large ``gamma``, as published, the hyperbolic tangent
    is 1 wherever the drive is not zero: ``beta`` is an offset and ``gamma`` is not identifiable.
    The fit then keeps a ``gamma`` that is a step at every sample, reports it in
    ``identifiability_``, and warns.

    References
    ----------
    Xie et al., *Smart Materials and Structures*, 2023, equation (3).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import TanhHysteresis
    >>> drive = 10.0 * np.sin(np.linspace(0.0, 20.0, 500))
    >>> y = 0.2 * drive + np.tanh(0.7 * drive)
    >>> model = TanhHysteresis().fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gamma:.3f}")
    0.700
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_intercept": ["boolean"],
    }

    largest_value = 1e30  # largest value of the data: products of several are squared
    operator_class = TanhHysteresisOperator

    def __init__(
        self,
        fit_intercept=False,
        *,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.fit_intercept = fit_intercept

    def starting_values(self, records):
        largest = largest_drive(records)
        return [_start(bend / largest) for bend in _BENDS]

    def identify(self, data):
        """Prefer a step to a bend unless the data distinguish them.

        A large gamma is bounded from below only, which a standard error cannot express.
        """
        bend = super().identify(data)
        magnitudes = np.abs(np.concatenate([record.u for record in data]))
        largest = largest_drive(data)
        smallest = magnitudes[magnitudes > _NEGLIGIBLE * largest].min(initial=largest)
        step = refine(self, [_start(_STEP / smallest)], data, "variable_projection")
        margin = _SIGNIFICANT / max(magnitudes.size - len(step.params), 1)
        power = np.mean(np.square(np.concatenate([record.y for record in data])))
        limit = bend.error**2 * (1.0 + margin) + _ROUNDING**2 * power
        return dataclasses.replace(
            step if step.error**2 <= limit else bend,
            n_evaluations=step.n_evaluations + bend.n_evaluations,
        )


def _start(gamma):
    return TanhHysteresisOperator(0.0, 0.0, 1.0, float(gamma))
