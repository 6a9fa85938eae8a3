"""What the friction models share: a spring, a dashpot and a constant beside the friction."""

import numpy as np

from ._base import Operator

__all__ = ["FrictionOperator"]


class FrictionOperator(Operator):
    """Base of the friction models; the last three parameters are stiffness, damping, intercept.

    The velocity at a sample is the slope of the straight line that ends there, the backward
    difference, so that the output does not know the future.
    """

    carries_scale = True
    rank = 10

    def _beside(self, u, before, dt):
        """Return spring, dashpot and constant, (n_samples,); the drive stood at ``before``."""
        y = np.full(u.size, float(self.intercept))
        if self.stiffness:
            y += self.stiffness * u
        if self.damping:
            y += (self.damping / dt) * np.diff(u, prepend=before)
        return y

    def _linearize_beside(self, u, du, dt, initial_state, y, dy):
        """Add spring, dashpot and constant to ``y`` and the first columns of ``dy``, set the last.

        ``y`` and the tangents carried through hold the friction itself.
        """
        m = du.shape[1]
        before = u[:1] if initial_state == "rest" else [0.0]
        dbefore = du[:1] if initial_state == "rest" else np.zeros((1, m))
        y += self._beside(u, before, dt)
        if m:
            dy[:, :m] += self.stiffness * du
            dy[:, :m] += (self.damping / dt) * np.diff(du, axis=0, prepend=dbefore)
        dy[:, -3] = u
        dy[:, -2] = np.diff(u, prepend=before) / dt
        dy[:, -1] = 1.0
