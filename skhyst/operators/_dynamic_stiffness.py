"""The force of a measured motion: mass, dashpot and spring."""

from dataclasses import dataclass

import numpy as np

from .._kernels._arrays import as_signal
from ._base import Operator, parameter
from ._differences import latest, samples_before, slopes

__all__ = ["DynamicStiffnessOperator"]


@dataclass(frozen=True)
class DynamicStiffnessOperator(Operator):
    r"""Equation of motion seen from the force, the inverse of a second-order mode.

    .. math:: y = m \ddot u + d \dot u + k u + c

    or, where the drive is a velocity already, :math:`y = m \dot u + d u + c`.

    Parameters
    ----------
    mass : float, default=0.0
        ``m`` in response s^2/drive, for a velocity response s/drive.
    damping : float, default=0.0
        ``d`` in response s/drive, for a velocity response/drive.
    stiffness : float, default=0.0
        Spring ``k`` in response/drive; none for a velocity.
    intercept : float, default=0.0
        Constant ``c`` in units of the response.
    drive : {"displacement", "velocity"}, default="displacement"
        What the drive is. Fixed structure.
    smoothing : int, default=1
        Intervals over which a slope is taken. Fixed structure.

    Notes
    -----
    The first derivative is the least-squares slope over the last ``smoothing`` intervals, the
    backward difference by default; the second is the same slope of the first. They lag behind by
    ``smoothing / 2`` and ``smoothing`` intervals and do not know the future. What came before a
    record is unknown in ``"rest"``, for it may begin in motion: a derivative counts as zero until
    the record is as long as its window. The state is the last samples, at most ``2 smoothing`` of a
    displacement and ``smoothing`` of a velocity.

    Examples
    --------
    >>> from skhyst.operators import DynamicStiffnessOperator
    >>> operator = DynamicStiffnessOperator(mass=2.0, damping=1.0, stiffness=10.0)
    >>> operator.run([0.0, 0.0, 0.5, 1.5, 2.5], dt=1.0)[0]
    array([ 0. ,  0. ,  6.5, 17. , 26. ])
    """

    mass: float = parameter(default=0.0, linear=True, unit="response s^2/drive")
    damping: float = parameter(default=0.0, linear=True, unit="response s/drive")
    stiffness: float = parameter(default=0.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    drive: str = "displacement"
    smoothing: int = 1
    signal_linear = True
    carries_scale = True
    rank = 10

    def __post_init__(self):
        if self.drive not in ("displacement", "velocity"):
            raise ValueError(
                "The 'drive' parameter of DynamicStiffnessOperator must be 'displacement' or "
                f"'velocity'. Got {self.drive!r} instead."
            )
        if self.drive == "velocity" and self.stiffness:
            raise ValueError(
                "The 'stiffness' parameter of DynamicStiffnessOperator must be 0 where the drive "
                f"is a velocity. Got {self.stiffness!r} instead."
            )

    def parameter_specs(self):
        """Return the identifiable fields; the drive says their units and whether there is k."""
        specs = super().parameter_specs()
        if self.drive == "velocity":
            specs["mass"], specs["damping"] = specs["damping"], specs["stiffness"]
            del specs["stiffness"]
        return specs

    @property
    def _n_past(self):
        return self.smoothing * (2 if self.drive == "displacement" else 1)

    def _terms(self, u, past, dt):
        """Return what mass, damping and, of a displacement, stiffness multiply."""
        first = slopes(np.concatenate([past, u]), dt, self.smoothing)
        if self.drive == "velocity":
            return latest(first, len(u)), u
        return latest(slopes(first, dt, self.smoothing), len(u)), latest(first, len(u)), u

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample: what is known of the samples before."""
        return samples_before((), self._n_past, initial_state)

    def run(self, u, dt, state=None):
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        if not u.size:
            return np.empty(0), state
        y = np.full(u.size, float(self.intercept))
        for value, term in zip(self.pack(), self._terms(u, state, dt), strict=False):
            if value:
                y += value * term
        return y, np.concatenate([state, u])[-self._n_past :]

    def linearize(self, u, du, dt, initial_state="rest"):
        u, m = as_signal(u), du.shape[1]
        values = self.pack()
        dy = np.zeros((u.size, m + len(values)))
        y = np.full(u.size, float(self.intercept))
        terms = self._terms(u, self.init(u[0], initial_state), dt)
        carried = self._terms(du, samples_before((m,), self._n_past, initial_state), dt)
        for i, (term, tangents) in enumerate(zip(terms, carried, strict=True)):
            dy[:, m + i] = term
            y += values[i] * term
            dy[:, :m] += values[i] * tangents
        dy[:, -1] = 1.0
        return y, dy
