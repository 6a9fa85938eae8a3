r"""Creep in logarithmic time, by a bank of relaxing units.

With s a rate, the logarithm is a superposition of exponentials,

    ln(1 + t/tau0) = int_0^inf (1 - exp(-s t)) exp(-s tau0) ds / s.

On the scale x = ln s the integrand is smooth and falls off at both ends, so that the trapezoidal
rule converges exponentially (Trefethen and Weideman, SIAM Review 56, 2014): with rates a factor
exp(0.8) apart the relative error is 6e-5. The rates do not depend on the parameters, only the
weights ``0.8 exp(-s tau0)`` do, and tau0 moves nothing but the output of the bank.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .._kernels._creep_bank import creep_bank
from ._base import Operator, parameter

__all__ = ["LogCreepOperator"]

_SPACING = 0.8  # of the logarithms of the rates
_FASTEST = 12.0  # largest rate times the shortest time: exp(-12) is left of such a unit then
_SLOWEST = 0.01  # smallest rate times the longest time
_PROMPT = 60  # faster units that the fastest one takes over, down to exp(-48) of its time constant
_DECADE = 1.0 / np.log(10.0)


@dataclass(frozen=True)
class LogCreepOperator(Operator):
    """Creep: the response to a unit step is ``gain (1 + creep log10(1 + t / time_constant))``.

    A drive is a superposition of steps, each of which creeps from its own time on. There is no
    equilibrium, so *rest* at a level means that what creep was left there is taken for none: the
    response starts at ``gain u0`` (+ intercept) and only changes of the drive from then on creep.

    ``creep`` is the part of the prompt response that a decade of time adds, ``time_constant`` in s.
    The law is kept to 3e-4 of the creep for times from ``shortest`` to ``longest`` (both s, fixed)
    after a change of the drive, and before where the time constant is above ``shortest``; beyond
    ``longest`` the creep comes to its end.
    """

    creep: float = parameter(linear=True, lower=0.0)
    time_constant: float = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    shortest: float = 1e-3
    longest: float = 1e3
    hold: str = "foh"
    signal_linear = True

    @cached_property
    def _rates(self):
        first, last = np.log(_FASTEST / self.shortest), np.log(_SLOWEST / self.longest)
        n_units = max(int(np.ceil((first - last) / _SPACING)), 0) + 1
        return np.exp(first - _SPACING * np.arange(n_units))

    def _weights(self):
        """Return the units' weights and their derivatives by the time constant, (2, n_units)."""
        rates = self._rates
        weights = _SPACING * np.exp(-rates * self.time_constant)
        slopes = -rates * weights
        # slower units than the last act as ramps, which it takes over
        ramp = 1.0 / np.expm1(_SPACING)
        weights[-1] *= 1.0 + ramp
        slopes[-1] *= 1.0 + ramp
        # faster ones than the first have relaxed at once, as it nearly has
        faster = rates[0] * np.exp(_SPACING * np.arange(1, _PROMPT + 1))
        prompt = _SPACING * np.exp(-np.minimum(faster * self.time_constant, 700.0))
        weights[0] += prompt.sum()
        slopes[0] -= faster @ prompt
        return np.stack([weights, slopes])

    def _discrete(self, dt):
        """Return the decay of each unit and its weights of the last and the present input."""
        steps = self._rates * dt
        gone = -np.expm1(-steps)
        now = 1.0 - gone / steps if self.hold == "foh" else np.zeros_like(steps)
        return 1.0 - gone, gone - now, now

    def frequency_response(self, frequency):
        """Return the complex gain at ``frequency`` (Hz), of changes of the drive."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        units = 1.0 / (s[..., None] / self._rates + 1.0)
        return self.gain * (1.0 + self.creep * _DECADE * (units @ self._weights()[0]))

    def init(self, u0, initial_state="rest"):
        # units relative to the level of rest, that level, the last input relative to it
        return np.zeros(len(self._rates)), 0.0 if initial_state == "zero" else float(u0), 0.0

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        v, level, previous = self.init(u[0]) if state is None else state
        sums, v = creep_bank(*self._discrete(dt), self._weights()[:1], u - level, v, previous)
        y = self.gain * (u + self.creep * _DECADE * sums[:, 0]) + self.intercept
        return y, (v, level, float(u[-1] - level))

    def linearize(self, u, du, dt, initial_state="rest"):
        u = np.ascontiguousarray(u, dtype=float)
        m = du.shape[1]
        discrete, weights, units = self._discrete(dt), self._weights(), np.zeros(len(self._rates))
        rest = initial_state == "rest"
        scale = self.creep * _DECADE
        sums, _ = creep_bank(*discrete, weights, u - (u[0] if rest else 0.0), units, 0.0)
        dy = np.empty((len(u), m + 4))
        for q in range(m):
            change = np.ascontiguousarray(du[:, q] - (du[0, q] if rest else 0.0))
            own, _ = creep_bank(*discrete, weights[:1], change, units, 0.0)
            dy[:, q] = self.gain * (du[:, q] + scale * own[:, 0])
        dy[:, m] = self.gain * _DECADE * sums[:, 0]
        dy[:, m + 1] = self.gain * scale * sums[:, 1]
        dy[:, m + 2] = u + scale * sums[:, 0]
        dy[:, m + 3] = 1.0
        return self.gain * dy[:, m + 2] + self.intercept, dy
