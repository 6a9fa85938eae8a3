"""A simulated device that is run sample by sample."""

import copy
from typing import Self

import numpy as np


class DeviceStepper:
    """A simulated device that is stepped, such as that of :func:`inchworm_motor_stepper`.

    It has no sensor: the response is that of the device itself.

    Parameters
    ----------
    respond : callable
        Maps the drive (n_samples, n_inputs) to the response (n_samples,), and continues from there.
    u0 : array-like of shape (n_inputs,)
        Drive at which the device has rested.

    See Also
    --------
    scanning_stage_stepper : A scanning stage.
    inchworm_motor_stepper : An inchworm motor.
    skhyst.control.simulate_loop : A feedback loop around a device.

    Examples
    --------
    >>> from skhyst.datasets import scanning_stage_stepper
    >>> stage = scanning_stage_stepper()
    >>> other = stage.copy()
    >>> [f"{1e3 * stage.step(10.0):.3f} nm" for _ in range(3)]
    ['0.002 nm', '0.176 nm', '2.082 nm']
    >>> f"{1e3 * other.run([10.0] * 3)[-1]:.3f} nm"
    '2.082 nm'
    """

    def __init__(self, respond, u0):
        self._respond, self._n_inputs = respond, np.size(u0)
        self.run(np.reshape(u0, (1, -1)))

    def step(self, u) -> float:
        """Return the response at the next sample, to which the drive is a straight line.

        Parameters
        ----------
        u : float, or array-like of shape (n_inputs,)
            Drive.

        Returns
        -------
        float

        Raises
        ------
        ValueError
            If the drive is not finite or of another shape; the device stays as it is.
        """
        return float(self.run(np.reshape(u, (1, -1)))[0])

    def run(self, u) -> np.ndarray:
        """Return the response to many samples; the device is then in the state after the last.

        Parameters
        ----------
        u : array-like of shape (n_samples,) or (n_samples, n_inputs)
            Drives, as of :meth:`step`.

        Returns
        -------
        ndarray of shape (n_samples,)

        Raises
        ------
        ValueError
            As in :meth:`step`.
        """
        u = np.array(u, dtype=float)
        rows = u[:, None] if u.ndim == 1 else u
        if rows.shape[1:] != (self._n_inputs,) or not np.isfinite(rows).all():
            raise ValueError(
                f"The drive must be finite numbers, {self._n_inputs} per sample. Got {u!r} instead."
            )
        return self._respond(rows)

    def copy(self) -> Self:
        """Return an independent copy in the same state."""
        return copy.deepcopy(self)
