"""What all disturbances share."""

from abc import abstractmethod

import numpy as np

from ..base import ParametricModel
from ..operators import LoweredStep, Operator


class DisturbanceOperator(Operator):
    """Base: ``y(t) = basis(t) coefficients``, t from the record's start; no input is used."""

    signal_linear = True
    rank = 60
    stands_beside = True
    has_constant = False  # as the first column of its basis

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

    def _step(self):
        """Return the compiled step, or None, and its constants behind ``dt``."""
        return None, ()

    def lowered(self, dt, state):
        step, constants = self._step()
        if step is None:
            return super().lowered(dt, state)
        return LoweredStep(step, (dt, *constants), [state / dt])

    def linearize(self, u, du, dt, initial_state="rest"):
        time = dt * np.arange(len(u))
        basis = self.basis(time)
        own = np.concatenate([basis, self.basis_tangents(time, self.coefficients)], axis=1)
        return basis @ self.coefficients, np.concatenate([np.zeros_like(du), own], axis=1)


class Disturbance(ParametricModel):
    """Base of the disturbances: nothing is driven, all is beside."""

    operator_class = DisturbanceOperator
