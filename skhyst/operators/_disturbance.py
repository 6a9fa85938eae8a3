"""Disturbances: functions of time since the start of a record, whatever the drive.

The coefficients of a disturbance belong to the record, not to the device. Identification solves
them exactly record by record; the operator holds their mean over the records, which is what a
free run of a new record can know.
"""

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from ._base import Operator, parameter

__all__ = ["DisturbanceOperator", "DriftOperator", "OffsetOperator", "SinusoidOperator"]


class DisturbanceOperator(Operator):
    """Base: ``y(t) = basis(t) coefficients``; the input is not used.

    Time is counted from the record's start.
    """

    signal_linear = True
    rank = 60

    @abstractmethod
    def basis(self, time):
        """Return the basis, shape (n_samples, n_coefficients), at ``time`` (s)."""

    def basis_tangents(self, time, coefficients):
        """Return derivatives of ``basis @ coefficients`` by the other parameters, (n, p)."""
        return np.empty((len(time), 0))

    def init(self, u0, initial_state="rest"):
        return 0.0  # s since the record's start

    def run(self, u, dt, state=None):
        start = 0.0 if state is None else state
        time = start + dt * np.arange(len(u))
        return self.basis(time) @ self.coefficients, start + dt * len(u)

    def linearize(self, u, du, dt, initial_state="rest"):
        time = dt * np.arange(len(u))
        basis = self.basis(time)
        own = np.concatenate([basis, self.basis_tangents(time, self.coefficients)], axis=1)
        return basis @ self.coefficients, np.concatenate([np.zeros_like(du), own], axis=1)


@dataclass(frozen=True)
class OffsetOperator(DisturbanceOperator):
    """A constant."""

    coefficients: np.ndarray = parameter(linear=True, unit="response")

    def basis(self, time):
        return np.ones((len(time), 1))


@dataclass(frozen=True)
class DriftOperator(DisturbanceOperator):
    """Legendre polynomials of time over ``duration`` (s), from degree 0; constant afterwards."""

    coefficients: np.ndarray = parameter(linear=True, unit="response")
    duration: float

    def basis(self, time):
        z = np.clip(2.0 * time / self.duration - 1.0, -1.0, 1.0)
        return np.polynomial.legendre.legvander(z, np.size(self.coefficients) - 1)


@dataclass(frozen=True)
class SinusoidOperator(DisturbanceOperator):
    """Sines and cosines at ``frequencies`` (Hz)."""

    coefficients: np.ndarray = parameter(linear=True, unit="response")
    frequencies: np.ndarray = parameter(lower=0.0, unit="Hz")

    def basis(self, time):
        phase = 2.0 * np.pi * np.outer(time, self.frequencies)
        return np.concatenate([np.cos(phase), np.sin(phase)], axis=1)

    def basis_tangents(self, time, coefficients):
        phase = 2.0 * np.pi * np.outer(time, self.frequencies)
        cosine, sine = np.split(np.asarray(coefficients), 2)
        return 2.0 * np.pi * time[:, None] * (sine * np.cos(phase) - cosine * np.sin(phase))
