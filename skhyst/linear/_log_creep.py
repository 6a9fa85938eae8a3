"""Logarithmic creep, by a bank of relaxing units.

With s a rate, the logarithm is a superposition of exponentials,

    ln(1 + t/tau0) = int_0^inf (1 - exp(-s t)) exp(-s tau0) ds / s.

On the scale x = ln s the integrand is smooth and falls off at both ends, so that the trapezoidal
rule converges exponentially (Trefethen and Weideman, *SIAM Review*, 2014): with rates a factor
exp(0.8) apart the relative error is 6e-5. The rates do not depend on the parameters, only the
weights ``0.8 exp(-s tau0)`` do, so tau0 enters the output of the bank only, not its states.
"""

from dataclasses import dataclass
from functools import cached_property
from numbers import Real

import numpy as np

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..operators import CompiledLaw, HeldInput, parameter
from ._gain import slope
from ._linear import LinearModel, log_grid, refuse_open_hold, time_span

_SPACING = 0.8  # difference of the logarithms of neighbouring rates
_FASTEST = 12.0  # largest rate times the shortest time: such a unit has decayed to exp(-12) then
_SLOWEST = 0.01  # smallest rate times the longest time
# number of still faster units, lumped into the fastest one; the time constant of the last of them
# is exp(-48) of that
_PROMPT = 60
_DECADE = 1.0 / np.log(10.0)
_SHORTEST = 0.1  # shortest time of a fit, in sampling intervals
_LONGEST = 10.0  # longest time of a fit, in lengths of the longest record


@jit(inline=True)
def relax(decay, b0, b1, before, u, state):
    """Advance the units, in place, by one interval; the drive goes from ``before`` to ``u``."""
    for j in range(decay.size):
        state[j] = decay[j] * state[j] + (b0[j] * before + b1[j] * u)


@jit
def creep_step(u, c, s):
    """Return the response; ``s`` are the units' states, the last drive minus the level, the level.

    ``c`` is (decay, b0, b1, weights (n_units,), gain, intercept), see :func:`_creep_bank`.
    """
    decay, b0, b1, weights, gain, intercept = c
    n = decay.size
    change = u - s[n + 1]
    relax(decay, b0, b1, s[n], change, s)
    s[n] = change
    y = u
    for j in range(n):
        y += weights[j] * s[j]
    return gain * y + intercept


@jit
def creep_begin(u, c, s):
    """Do :func:`creep_step` if no drive precedes the first sample.

    ``s`` ends with a mark that is zero before it.
    """
    _, _, _, weights, gain, intercept = c
    n = weights.size
    if s[n + 2] > 0.0:
        return creep_step(u, c, s)
    s[n], s[n + 2], y = u - s[n + 1], 1.0, u
    for j in range(n):
        y += weights[j] * s[j]
    return gain * y + intercept


@jit
def _creep_bank(decay, b0, b1, weights, u, v, u_previous):
    """Return the sums (n_samples, n_sums) and the last state; ``v`` is not modified.

    ``v[k] = decay v[k-1] + b0 u[k-1] + b1 u[k]`` for each of the units, whose states are weighted
    by ``weights`` (n_sums, n_units).
    """
    n_units = decay.shape[0]
    n_sums = weights.shape[0]
    state = v.copy()
    sums = np.empty((u.shape[0], n_sums))
    for k in range(u.shape[0]):
        relax(decay, b0, b1, u_previous, u[k], state)
        for i in range(n_sums):
            total = 0.0
            for j in range(n_units):
                total += weights[i, j] * state[j]
            sums[k, i] = total
        u_previous = u[k]
    return sums, state


@dataclass(frozen=True)
class LogCreepOperator(HeldInput):
    """Creep: the response to a unit step is ``gain (1 + creep log10(1 + t / time_constant))``.

    For "rest" see :class:`LogCreep`. The law holds to 3e-4 of the creep from ``shortest`` to
    ``longest`` after a change of the drive, and earlier too where the time constant exceeds
    ``shortest``; after ``longest`` the creep ends.

    Parameters
    ----------
    creep : float
        Fraction of the prompt response that is added per decade of time.
    time_constant : float
        In s.
    gain : float, default=1.0
        Gain of the prompt response, response/drive.
    intercept : float, default=0.0
        Units of the response.
    shortest, longest : float, default=1e-3, 1e3
        Times between which the law holds, s. Fixed structure.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Input between samples: a straight line, constant, or without content above half the sampling
        rate. Fixed structure.

    Raises
    ------
    ValueError
        If ``shortest`` is not above 0, or ``longest`` is infinite or below it.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import LogCreepOperator
    >>> creep = LogCreepOperator(0.1, time_constant=0.1)
    >>> y, _ = creep.run(np.append(0.0, np.ones(1000)), dt=0.1)
    >>> bool(np.isclose(y[1000] - y[100], 0.1, atol=2e-3))  # a decade later
    True
    """

    creep: float = parameter(linear=True, lower=0.0)
    time_constant: float = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    shortest: float = 1e-3
    longest: float = 1e3
    hold: str = "foh"
    signal_linear = True

    def __post_init__(self):
        super().__post_init__()
        self._require("shortest", self.shortest > 0.0, "be above 0")
        is_right = self.shortest <= self.longest < np.inf
        self._require("longest", is_right, "be finite, and not below 'shortest'")

    @cached_property
    def _rates(self):
        first, last = np.log(_FASTEST / self.shortest), np.log(_SLOWEST / self.longest)
        n_units = max(int(np.ceil((first - last) / _SPACING)), 0) + 1
        return np.exp(first - _SPACING * np.arange(n_units))

    def _weights(self):
        """Return the units' weights and their derivatives by the time constant, (2, n_units)."""
        rates = self._rates
        weights = _SPACING * np.exp(-rates * self.time_constant)
        both = np.stack([weights, -rates * weights])
        # units slower than the last are still ramps, as it is: their weights are added to it
        both[:, -1] *= 1.0 + 1.0 / np.expm1(_SPACING)
        # units faster than the first relax at once, as it nearly does: they are added to it
        faster = rates[0] * np.exp(_SPACING * np.arange(1, _PROMPT + 1))
        prompt = _SPACING * np.exp(-np.minimum(faster * self.time_constant, 700.0))
        both[:, 0] += prompt.sum(), -faster @ prompt
        return both

    def _discrete(self, dt):
        """Return the decay of each unit and its weights of the last and the present input."""
        refuse_open_hold(self.hold)
        steps = self._rates * dt
        decayed = -np.expm1(-steps)
        by_present = 1.0 - decayed / steps if self.hold == "foh" else np.zeros_like(steps)
        return 1.0 - decayed, decayed - by_present, by_present

    def frequency_response(self, frequency):
        """Return the complex gain of changes of the drive.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        ndarray of shape (n,)
            Response over drive.
        """
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        units = 1.0 / (s[..., None] / self._rates + 1.0)
        return self.gain * (1.0 + self.creep * _DECADE * (units @ self._weights()[0]))

    def init(self, u0, initial_state="rest"):
        # states of the units relative to the level at rest, that level, last input relative to it
        if initial_state == "zero":  # a ramp from zero would lead to the first sample
            return np.zeros(len(self._rates)), 0.0, None if self.hold == "foh" else 0.0
        return np.zeros(len(self._rates)), float(u0), 0.0

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        v, level, previous = self.init(u[0]) if state is None else state
        sums, v = self._sums(dt, self._weights()[:1], u - level, v, previous)
        y = self.gain * (u + self.creep * _DECADE * sums[:, 0]) + self.intercept
        return y, (v, level, float(u[-1] - level))

    def compiled_step(self, dt, state):
        v, level, previous = state
        weights = self.creep * _DECADE * self._weights()[0]
        constants = *self._discrete(dt), weights, self.gain, self.intercept
        if self.hold == "foh":
            begun = previous is not None
            state = [*v, previous if begun else 0.0, level, float(begun)]
            return CompiledLaw(creep_begin, constants, state)
        return CompiledLaw(creep_step, constants, [*v, previous, level])

    def _sums(self, dt, weights, u, v, previous):
        """Return the sums of :func:`_creep_bank`; no drive before if ``previous`` is None."""
        if previous is not None:
            return _creep_bank(*self._discrete(dt), weights, u, v, previous)
        sums, state = _creep_bank(*self._discrete(dt), weights, u[1:], v, float(u[0]))
        return np.vstack([weights @ v, sums]), state

    def sensitivities(self, u, du, dt, initial_state="rest"):
        u = np.ascontiguousarray(u, dtype=float)
        m, weights = du.shape[1], self._weights()
        units, level, previous = self.init(u[0], initial_state)
        rest = initial_state == "rest"
        scale = self.creep * _DECADE
        sums, _ = self._sums(dt, weights, u - level, units, previous)
        dy = np.empty((len(u), m + 4))
        for q in range(m):
            change = np.ascontiguousarray(du[:, q] - (du[0, q] if rest else 0.0))
            propagated, _ = self._sums(dt, weights[:1], change, units, previous)
            dy[:, q] = self.gain * (du[:, q] + scale * propagated[:, 0])
        dy[:, m] = self.gain * _DECADE * sums[:, 0]
        dy[:, m + 1] = self.gain * scale * sums[:, 1]
        dy[:, m + 2] = u + scale * sums[:, 0]
        dy[:, m + 3] = 1.0
        return self.gain * dy[:, m + 2] + self.intercept, dy


class LogCreep(LinearModel):
    r"""Logarithmic creep: a step response grows by the same amount in every decade of time.

    .. math:: u = \text{step of size } a \text{ at } t_0 \quad\Rightarrow\quad
       y = g\,a\,\Bigl(1 + \gamma \log_{10}\bigl(1 + \tfrac{t - t_0}{\tau_0}\bigr)\Bigr)

    and for any other drive the superposition of its changes. Two parameters describe creep from
    milliseconds to hours, for which :class:`KelvinVoigt` needs one unit per decade.

    The law has no equilibrium: after a step the response creeps for ever. ``initial_state="rest"``
    therefore means that the drive has been at its first value so long that the remaining creep is
    neglected: the response starts at :math:`g u_0` and only later changes of the drive creep. With
    ``"zero"`` the drive steps from zero at the first sample, and this step creeps too.

    Parameters
    ----------
    time_constant : "fit" or float, default="fit"
        :math:`\tau_0` in s, fitted or fixed; 0.1 s is a convention in the literature. The data
        determine it where the drive changes fast and is sampled densely afterwards; where all
        samples are much later, its logarithm cannot be distinguished from the gain.

    Attributes
    ----------
    operator_ : LogCreepOperator
        ``creep`` (:math:`\gamma`, fraction per decade), ``time_constant`` in s, ``gain``. It
        follows the law to 3e-4 of the creep, for ten times the longest record of the fit.

    See Also
    --------
    KelvinVoigt : Creep by single units, each with its time constant.
    skhyst.disturbance.Drift : Slow motion whatever the drive.

    References
    ----------
    Fett and Thun, *Journal of Materials Science Letters*, 1998. Jung and Gweon, *Review of
    Scientific Instruments*, 2000.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets import steps
    >>> from skhyst.linear import LogCreep
    >>> X = steps([0.0, 1.0], hold=[1.0, 100.0], dt=0.1)
    >>> time = np.arange(-10, 1000) * 0.1
    >>> y = np.where(time < 0, 0.0, 1.0 + 0.02 * np.log10(1.0 + np.maximum(time, 0.0) / 0.5))
    >>> model = LogCreep(hold="zoh").fit(X, y)
    >>> print(f"{model.operator_.creep:.4f}, {model.operator_.time_constant:.2f} s")
    0.0200, 0.50 s
    """

    operator_class = LogCreepOperator
    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "time_constant": [StrOptions({"fit"}), Interval(Real, 0, None, closed="neither")],
    }

    def __init__(
        self,
        time_constant="fit",
        *,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.time_constant = time_constant
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def held_parameters(self) -> frozenset[str]:
        held = frozenset() if self.time_constant == "fit" else {"time_constant"}
        return super().held_parameters() | held

    def starting_values(self, records):
        dt, span = time_span(records)
        constants = [self.time_constant]
        if self.time_constant == "fit":
            constants = log_grid(dt, max(span, 10.0 * dt), 1)
        options = {"shortest": _SHORTEST * dt, "longest": _LONGEST * span, "hold": self.hold}
        gain = slope(records) if self.fit_gain else 1.0
        return [LogCreepOperator(0.05, float(tau), gain, **options) for tau in constants]
