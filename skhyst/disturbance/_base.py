"""Base classes of the additive disturbances."""

from abc import abstractmethod

import numpy as np

from ..base import ParametricModel
from ..operators import CompiledLaw, Operator


class DisturbanceOperator(Operator):
    """Base of disturbances ``y(t) = basis(t) @ coefficients``, t since the record's start (s).

    A subclass is a frozen dataclass with a field ``coefficients`` and defines :meth:`basis`, and
    :meth:`basis_tangents` if it has other parameters.

    Examples
    --------
    See :class:`OffsetOperator`.
    """

    signal_linear = True
    stage_order = 60
    is_disturbance = True
    has_constant = False  # whether the first column of the basis is constant

    @abstractmethod
    def basis(self, time):
        """Return the basis, whose combination by the coefficients is the disturbance.

        Parameters
        ----------
        time : ndarray of shape (n_samples,)
            Time since the start of the record, s.

        Returns
        -------
        ndarray of shape (n_samples, n_coefficients)
            A column for each coefficient.
        """

    def basis_tangents(self, time, coefficients):
        """Return the derivatives of ``basis(time) @ coefficients`` by the other parameters.

        Parameters
        ----------
        time : ndarray of shape (n_samples,)
            Time since the start of the record, s.
        coefficients : ndarray of shape (n_coefficients,)
            Of the record.

        Returns
        -------
        ndarray of shape (n_samples, p)
            A column for each of the p parameters other than coefficients.
        """
        return np.empty((len(time), 0))

    def init(self, u0, initial_state="rest"):
        return 0.0  # s since the record's start

    def run(self, u, dt, state=None):
        start = 0.0 if state is None else state
        time = start + dt * np.arange(len(u))
        return self.basis(time) @ self.coefficients, start + dt * len(u)

    def _step(self):
        """Return the compiled step, or None, and its constants but the first, ``dt``."""
        return None, ()

    def compiled_step(self, dt, state):
        step, constants = self._step()
        if step is None:
            return super().compiled_step(dt, state)
        return CompiledLaw(step, (dt, *constants), [state / dt])

    def sensitivities(self, u, du, dt, initial_state="rest"):
        time = dt * np.arange(len(u))
        basis = self.basis(time)
        by_parameters = np.concatenate(
            [basis, self.basis_tangents(time, self.coefficients)], axis=1
        )
        return basis @ self.coefficients, np.concatenate([np.zeros_like(du), by_parameters], axis=1)


class Disturbance(ParametricModel):
    """Base of the disturbance models: the response does not depend on the drive."""

    operator_class = DisturbanceOperator
