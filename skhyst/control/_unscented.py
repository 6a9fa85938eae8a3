r"""The unscented Kalman filter of a stage with hysteresis in its equation of motion.

In such a stage the hysteresis follows the motion, so its state is as uncertain as the motion. Mean
and covariance of the state are propagated through the compiled step itself, by sigma points: with
the columns :math:`l_i` of a square root of the covariance, of :math:`m` dimensions including the
input,

.. math:: \bar s, \quad \bar s \pm \sqrt{m + \kappa}\, l_i, \qquad \kappa = \max(3 - m, 0)

with the weights :math:`\kappa / (m + \kappa)` and :math:`1 / 2 (m + \kappa)` (Julier and Uhlmann,
*Proceedings of SPIE 3068*, 1997; they take :math:`3 - m` for normal variables: below zero it may
make a variance negative). States without variance are those that the step gives.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..operators import CompiledStep, as_constant

_NOTHING = 1e-14  # fraction of the largest variance, below which a variance is rounding


@dataclass(frozen=True)
class Unscented(CompiledStep):
    """The estimate of a response, from a row of the drive and the reading, which comes last.

    Parameters
    ----------
    front, core, disturbances : CompiledStep
        Stages before the motion; the motion and the stages after it; additive disturbances.
    spread : float
        Standard deviation of the noise that drives the motion, units of its input.
    walk, noise : float
        Variances of the random walk's step per sample and of the noise of the reading.
    """

    front: CompiledStep
    core: CompiledStep
    disturbances: CompiledStep
    spread: float
    walk: float
    noise: float

    @property
    def n_inputs(self):
        """Columns of the input that are read."""
        return (self.front.n_inputs or 1) + 1

    @cached_property
    def state(self):
        """State of the parts and of the walk, covariance, innovation, its standard deviation."""
        n = len(self.core.state) + 1
        others = np.zeros(1 + n * n + 2)
        parts = self.front.state, self.disturbances.state, self.core.state, others
        return as_constant(np.concatenate(parts))

    def read(self, s):
        """Return the random walk, the last innovation and its standard deviation from a state."""
        n = len(self.core.state) + 1
        return s[-3 - n * n], s[-2], s[-1]

    def predicted(self, estimate, s):
        """Return the response at the last sample without the random walk."""
        return estimate - self.read(s)[0]

    def bound(self, s, binding):
        raise NotImplementedError(
            "An unscented filter has no compiled step in plain arithmetic: take method='linear'."
        )

    def stepping(self, s, checked=False):
        step = self._stepping(s, checked)
        return lambda row: step(row)[0]

    def streaming(self, s, checked=False):
        step = self._stepping(s, checked)
        return lambda rows: np.array([step(row)[0] for row in rows])

    def innovating(self, s):
        """Return a function of the next rows that returns their innovations and updates ``s``."""
        step = self._stepping(s)
        return lambda rows: np.array([step(row)[1] for row in rows])

    def _stepping(self, s, checked=False):
        n = len(self.core.state) + 1
        ends = np.cumsum([len(self.front.state), len(self.disturbances.state), n, n * n])
        front, disturbances, mean, covariance, last = np.split(s, ends)
        covariance = covariance.reshape(n, n)
        front = self.front.stepping(front, checked)
        disturbances = self.disturbances.stepping(disturbances, checked)
        states = np.zeros((2 * (n + 1) + 1, n - 1))
        cores = [self.core.stepping(state, checked) for state in states]
        is_signal = self.front.n_inputs is None

        def step(row):
            drive = front(row[0] if is_signal else row)
            offset = disturbances(drive)
            values, vectors = np.linalg.eigh(covariance)
            # sigma points only where there is variance: fewer runs of the step
            is_uncertain = values > _NOTHING * values[-1]
            m = int(is_uncertain.sum()) + 1  # with the noise of the input
            kappa = max(3.0 - m, 0.0)
            points, inputs = np.zeros((2 * m + 1, n)), np.zeros(2 * m + 1)
            offsets = (
                np.sqrt((m + kappa) * values[is_uncertain])[:, None] * vectors[:, is_uncertain].T
            )
            points[1:m], points[m + 1 : -1] = offsets, -offsets
            inputs[m], inputs[-1] = np.sqrt(m + kappa) * self.spread * np.array([1.0, -1.0])
            weights = np.full(2 * m + 1, 0.5 / (m + kappa))
            weights[0] = kappa / (m + kappa)
            points += mean
            states[: len(points)] = points[:, :-1]
            y = points[:, -1] + offset
            y += [
                core(drive + disturbance) for core, disturbance in zip(cores, inputs, strict=False)
            ]
            points[:, :-1] = states[: len(points)]
            middle, y_middle = weights @ points, weights @ y
            points -= middle
            y -= y_middle
            spread = points.T @ (weights[:, None] * points)
            spread[-1, -1] += self.walk  # exactly: the walk enters state and response linearly
            cross_covariance = points.T @ (weights * y)
            cross_covariance[-1] += self.walk
            response_variance = weights @ y**2 + self.walk
            variance = response_variance + self.noise
            innovation = row[-1] - y_middle
            gain = cross_covariance / variance
            mean[:] = middle + gain * innovation
            covariance[:] = spread - variance * np.outer(gain, gain)
            last[:] = innovation, np.sqrt(variance)
            return float(y_middle + response_variance / variance * innovation), innovation

        return step
