"""Poles, natural frequencies and damping ratios of fitted models, with their standard errors."""

import numpy as np
import pandas as pd

from .._documentation import inherit_documentation


def section_poles(time_constants, frequencies, dampings):
    """Return the poles (n,) of sections, in rad/s, and their derivatives (n, n), complex.

    Derivatives are by time constants, frequencies and damping ratios, in that order; infinite at a
    damping ratio of 1, where two poles coincide.
    """
    n_first, n_second = len(time_constants), len(frequencies)
    n = n_first + 2 * n_second
    poles, by = np.empty(n, dtype=complex), np.zeros((n, n), dtype=complex)
    poles[:n_first] = -1.0 / time_constants
    by[np.arange(n_first), np.arange(n_first)] = 1.0 / time_constants**2
    root = np.sqrt(np.asarray(dampings, dtype=complex) ** 2 - 1.0)
    second = np.arange(n_second)
    for sign, rows in ((1.0, n_first + 2 * second), (-1.0, n_first + 2 * second + 1)):
        poles[rows] = frequencies * (-dampings + sign * root)
        by[rows, n_first + second] = poles[rows] / frequencies
        with np.errstate(divide="ignore", invalid="ignore"):
            by[rows, n_first + n_second + second] = frequencies * (-1.0 + sign * dampings / root)
    return poles, by


class ModesMixin:
    """Poles and modes of a fitted linear model, as attributes and as a table.

    Attributes
    ----------
    poles_ : ndarray of shape (n_poles,), complex
        rad/s, slowest first.
    poles_covariance_ : ndarray of shape (n_poles, 2, 2)
        Covariance of real and imaginary part, (rad/s)^2.
    natural_frequencies_, natural_frequencies_std_ : ndarray of shape (n_modes,)
        rad/s; a mode is a real pole or a pair. :meth:`poles_table` gives Hz.
    damping_ratios_, damping_ratios_std_ : ndarray of shape (n_modes,)
    n_states_ : int
        Number of states; equal to that of the poles, for any number of inputs.
    """

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls)

    def _set_modes(self, poles, by, covariance):
        """Store poles and modes; ``by`` are derivatives by parameters with that ``covariance``."""
        order = np.argsort(np.abs(poles), kind="stable")
        poles, parts = poles[order], np.stack([by.real, by.imag], axis=1)[order]
        with np.errstate(invalid="ignore"):
            spread = parts @ covariance @ parts.transpose(0, 2, 1)
        self.poles_, self.poles_covariance_, self.n_states_ = poles, spread, len(poles)
        modes = poles.imag >= 0.0  # one of each pair
        p, spread = poles[modes], spread[modes]
        size = np.abs(p)
        by_size = np.stack([p.real, p.imag], axis=1) / size[:, None]
        by_damping = np.stack([-(p.imag**2), p.real * p.imag], axis=1) / size[:, None] ** 3
        self.natural_frequencies_, self.damping_ratios_ = size, -p.real / size
        self.natural_frequencies_std_ = _std(by_size, spread)
        # the damping ratio of a real pole is 1 or -1 and has no standard error
        self.damping_ratios_std_ = np.where(p.imag > 0.0, _std(by_damping, spread), np.nan)

    def _add_integrators(self, count):
        """Put poles at zero, which are known, before the others; they are no modes."""
        self.poles_ = np.concatenate([np.zeros(count), self.poles_])
        known = np.zeros((count, 2, 2))
        self.poles_covariance_ = np.concatenate([known, self.poles_covariance_])
        self.n_states_ += count

    def poles_table(self) -> pd.DataFrame:
        r"""Return the modes as a table, slowest first: one row per real pole or pair.

        Standard errors are propagated from the parameters to first order, which is inaccurate
        where two real poles almost coincide (damping ratio near 1).

        Returns
        -------
        DataFrame
            Columns ``frequency`` and ``frequency_std`` (Hz; of a real pole its rate over
            :math:`2 \pi`), ``damping_ratio`` and ``damping_ratio_std`` (1 and NaN for a real
            pole, negative if unstable), ``time_constant`` (s, in which the mode decays by a
            factor e).
        """
        with np.errstate(divide="ignore"):
            time_constant = 1.0 / (self.natural_frequencies_ * self.damping_ratios_)
        return pd.DataFrame(
            {
                "frequency": self.natural_frequencies_ / (2.0 * np.pi),
                "frequency_std": self.natural_frequencies_std_ / (2.0 * np.pi),
                "damping_ratio": self.damping_ratios_,
                "damping_ratio_std": self.damping_ratios_std_,
                "time_constant": time_constant,
            }
        )


def _std(by, covariance):
    return np.sqrt(np.maximum(np.einsum("ij,ijk,ik->i", by, covariance, by), 0.0))
