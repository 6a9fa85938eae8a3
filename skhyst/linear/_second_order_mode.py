"""Second-order mode, ``1 / (s^2/w^2 + 2 damping_ratio s/w + 1)``: mass, spring and damper."""

from dataclasses import dataclass, replace

import numpy as np

from ..operators import parameter
from ..optimize import pole_starts, sections
from ._linear import LinearModel, LinearOperator, log_grid, time_span

_DAMPED = float(np.sqrt(0.5))  # damping ratio from which on a pair of poles has no resonance peak


def count_ringing(damping_ratios):
    """Return how many pairs of poles have a resonance peak: a damping ratio below sqrt(1/2)."""
    return int(np.count_nonzero(np.asarray(damping_ratios) < _DAMPED))


def rates_of_sections(time_constants, frequencies, damping_ratios):
    """Return the rates (1/s) of sections as lags in series, [] where one has a resonance peak."""
    if count_ringing(damping_ratios):
        return []
    rates = [1.0 / constant for constant in time_constants]
    for frequency, damping in zip(frequencies, damping_ratios, strict=True):
        # up to a damping ratio of 1 a pair counts as two equal lags; above it, it is two lags
        apart = np.exp(np.arccosh(max(damping, 1.0)))
        rates += [frequency / apart, frequency * apart]
    return [float(rate) for rate in rates]


@dataclass(frozen=True)
class SecondOrderModeOperator(LinearOperator):
    """Second-order mode ``1 / (s^2/w^2 + 2 damping_ratio s/w + 1)``.

    Parameters
    ----------
    natural_frequency : float
        Undamped frequency w, rad/s.
    damping_ratio : float
        Relative to critical damping.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> y, _ = SecondOrderModeOperator(2.0 * np.pi, 0.1).run(np.append(0.0, np.ones(50)), dt=0.01)
    >>> print(f"{y.max():.2f}")  # 1 + exp(-pi zeta / sqrt(1 - zeta^2))
    1.73
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    n_poles = (0, 1)

    def with_poles(self, rates, pairs):
        return replace(self, natural_frequency=float(pairs[0][0]), damping_ratio=float(pairs[0][1]))

    def n_ringing(self):
        return count_ringing(self.damping_ratio)

    def lag_rates(self):
        return rates_of_sections([], [self.natural_frequency], [self.damping_ratio])

    def characteristics(self, seen):
        # delay of slow motion: the sum of the two time constants where both poles are real
        delay = 2.0 * self.damping_ratio / self.natural_frequency
        return {} if self.n_ringing() else {"time constant": (delay, "s")}

    def linear_mode(self):
        return self

    def _matrices(self, p):
        w, zeta, gain = p[:3]
        a = np.array([[0.0 * w, w], [-w, -2.0 * zeta * w]])
        return a, np.array([0.0 * w, w]), np.array([gain, 0.0 * w]), 0.0 * w


class SecondOrderMode(LinearModel):
    r"""Second-order mode: mass, spring and damper.

    .. math:: G(s) = \frac{g}{s^2/\omega^2 + 2 \zeta s/\omega + 1}

    Attributes
    ----------
    operator_ : SecondOrderModeOperator
        ``natural_frequency`` in rad/s, ``damping_ratio``, ``gain``.

    See Also
    --------
    TransferFunction : Any number of modes.
    skhyst.hysteresis.RestoringForce : Spring and damper that are not linear.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderMode, SecondOrderModeOperator
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05).run(drive, 0.01)
    >>> model = SecondOrderMode(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.natural_frequency:.2f} rad/s")
    60.00 rad/s
    """

    operator_class = SecondOrderModeOperator

    def starting_values(self, records):
        dt, span = time_span(records)
        starts = [(w, zeta) for w in log_grid(6.0 / span, 1.5 / dt, 2) for zeta in (0.05, 0.5)]
        for poles in pole_starts([(r.u, r.y, r.dt) for r in records], 2):
            _, frequencies, dampings = sections(poles)
            starts += list(zip(frequencies[:1], dampings[:1], strict=True))
        return [
            SecondOrderModeOperator(float(w), float(zeta), hold=self.hold) for w, zeta in starts
        ]
