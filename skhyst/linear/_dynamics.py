"""The linear operators: lag, second-order mode, Kelvin-Voigt chain, transfer function."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eig

from ..operators import parameter
from ._linear import LinearOperator

__all__ = [
    "FirstOrderLagOperator",
    "KelvinVoigtOperator",
    "SecondOrderModeOperator",
    "TransferFunctionOperator",
]


@dataclass(frozen=True)
class FirstOrderLagOperator(LinearOperator):
    """First-order low-pass ``1 / (time_constant s + 1)``; the time constant is in s."""

    time_constant: float = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    n_poles = (1, 0)

    def with_poles(self, rates, pairs):
        return replace(self, time_constant=float(1.0 / rates[0]))

    def _matrices(self, p):
        rate = 1.0 / p[0]
        return np.array([[-rate]]), np.array([rate]), np.array([p[1]]), 0.0 * p[0]


@dataclass(frozen=True)
class SecondOrderModeOperator(LinearOperator):
    """Second-order mode ``1 / (s^2/w^2 + 2 damping_ratio s/w + 1)``, w in rad/s."""

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    n_poles = (0, 1)

    def with_poles(self, rates, pairs):
        return replace(self, natural_frequency=float(pairs[0][0]), damping_ratio=float(pairs[0][1]))

    def _matrices(self, p):
        w, zeta, gain = p[:3]
        a = np.array([[0.0 * w, w], [-w, -2.0 * zeta * w]])
        return a, np.array([0.0 * w, w]), np.array([gain, 0.0 * w]), 0.0 * w


@dataclass(frozen=True)
class KelvinVoigtOperator(LinearOperator):
    """Creep: ``gain (1 + sum_i c_i / (tau_i s + 1))`` (thesis (3.7), k_0 carried by the gain).

    ``compliances`` c_i are relative to the prompt response, ``time_constants`` tau_i in s.
    """

    compliances: np.ndarray = parameter(linear=True, lower=0.0)
    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    gain: float = parameter(gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"

    @property
    def n_poles(self):
        return np.size(self.compliances), 0

    def with_poles(self, rates, pairs):
        return replace(self, time_constants=1.0 / np.array(rates))

    def _matrices(self, p):
        n = np.size(self.compliances)
        rates = 1.0 / p[n : 2 * n]
        return np.diag(-rates), rates, p[2 * n] * p[:n], p[2 * n]


@dataclass(frozen=True)
class TransferFunctionOperator(LinearOperator):
    """Rational transfer function, poles as stable sections in series, numerator linear.

    Sections in their order in the series: first-order lags (``time_constants``, s), then
    second-order ones (``natural_frequencies`` in rad/s, ``damping_ratios``, above 1 for two real
    poles). With L_0 = u, L_i the output of section i and L the last one,

        y = gain L + numerator . (L'/w, L_{m-1} - L, L_{m-1}'/w, L_{m-2} - L_{m-1}, ...) + intercept

    where a first-order section gives no derivative term. The first ``n_zeros`` of these terms span
    every numerator of that degree, and all of them vanish at rest, so ``gain`` is the static gain.
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerator: np.ndarray = parameter(linear=True, unit="response/drive")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"

    @classmethod
    def from_scipy(cls, system, *, hold="foh"):
        """Make one of a continuous-time system of SciPy or python-control.

        Parameters
        ----------
        system : scipy.signal.lti, control.StateSpace or control.TransferFunction
            Continuous time, one response, one input or several, no pole at zero.
        hold : {"foh", "zoh"}, default="foh"
            Input between samples.

        Returns
        -------
        TransferFunctionOperator
            For several inputs a :class:`MultiInputTransferFunctionOperator`.

        Raises
        ------
        ValueError
            If the system is in discrete time, has several responses, no pole, or a pole at zero.
        """
        from ._conversion import operator_of_system

        return operator_of_system(system, hold)

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        from ._conversion import scipy_system

        return scipy_system(self)

    def zeros(self):
        """Return the zeros in rad/s, complex, shape (n_zeros,)."""
        n = np.size(self.numerator)
        a, b, c, d = self.state_space()
        unit = float(np.abs(self.poles()).max())
        pencil = np.block([[a / unit, b[:, None] / unit], [c[None, :], np.array([[d]])]])
        found = eig(pencil, np.diag(np.r_[np.ones(len(b)), 0.0]), right=False)
        found = found[np.isfinite(found)]
        # those at infinity come out as large as rounding lets them
        return unit * found[np.argsort(np.abs(found))[:n]]

    @property
    def n_poles(self):
        return np.size(self.time_constants), np.size(self.natural_frequencies)

    def with_poles(self, rates, pairs):
        frequencies, dampings = np.array(pairs, dtype=float).reshape(-1, 2).T
        return replace(
            self,
            time_constants=1.0 / np.array(rates, dtype=float),
            natural_frequencies=frequencies,
            damping_ratios=dampings,
        )

    def _matrices(self, p):
        n_first, n_second = np.size(self.time_constants), np.size(self.natural_frequencies)
        n_zeros = np.size(self.numerator)
        tau, w, zeta, numerator = np.split(p, np.cumsum([n_first, n_second, n_second, n_zeros]))[:4]
        gain = p[n_first + 2 * n_second + n_zeros]
        n = n_first + 2 * n_second
        a = np.zeros((n, n), dtype=p.dtype)
        b = np.zeros(n, dtype=p.dtype)
        # rows over (states, u): the level before each section, its derivative term, the level after
        level = np.zeros(n + 1, dtype=p.dtype)
        level[n] = 1.0
        terms = []
        for i in range(n_first + n_second):
            after = np.zeros(n + 1, dtype=p.dtype)
            if i < n_first:
                row, rate = i, 1.0 / tau[i]
                after[row] = 1.0
                slope = rate * (level - after)
                a[row], b[row] = slope[:n], slope[n]
                terms.append((None, level - after))
            else:
                j = i - n_first
                row = n_first + 2 * j
                after[row] = 1.0
                velocity = np.zeros(n + 1, dtype=p.dtype)
                velocity[row + 1] = 1.0
                force = w[j] * (level - after - 2.0 * zeta[j] * velocity)
                a[row, row + 1] = w[j]
                a[row + 1], b[row + 1] = force[:n], force[n]
                terms.append((velocity, level - after))
            level = after
        output = gain * level
        columns = [column for pair in reversed(terms) for column in pair if column is not None]
        for weight, column in zip(numerator, columns, strict=False):
            output = output + weight * column
        return a, b, output[:n], output[n]
