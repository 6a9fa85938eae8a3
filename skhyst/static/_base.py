"""Base classes of the memoryless curves."""

import numpy as np

from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import CompiledLaw, Operator

SIDES = {"lower": (-1,), "upper": (1,), "both": (-1, 1)}


class StaticOperator(Operator):
    """Base of the memoryless operators; a subclass defines :meth:`evaluate`.

    With a compiled ``curve`` and its :meth:`curve_constants` it is also stepped, exported and
    observed.

    Attributes
    ----------
    curve : callable or None
        Compiled ``curve(u, c, s) -> y``, see :class:`~skhyst.operators.CompiledLaw`; ``s`` is
        empty.

    Examples
    --------
    See :class:`DeadBandOperator`, :class:`SaturationOperator`.
    """

    stage_order = 40
    memoryless = True
    curve = None

    def evaluate(self, v):
        """Return the curve, its slope and its derivatives by the parameters.

        Parameters
        ----------
        v : ndarray of shape (n_samples,)
            Input.

        Returns
        -------
        y, slope : ndarray of shape (n_samples,)
            Output, and its derivative by the input.
        own : ndarray of shape (n_samples, n_parameters)
            Derivatives by the parameters, in the order of the fields.
        """
        raise NotImplementedError

    def init(self, u0, initial_state="rest"):
        return ()

    def run(self, u, dt, state=None):
        return self.evaluate(np.asarray(u, dtype=float))[0], ()

    def curve_constants(self):
        """Return the constants of ``curve``.

        Returns
        -------
        tuple of float and ndarray
            By default none.
        """
        return ()

    def compiled_step(self, dt, state):
        if self.curve is None:
            return super().compiled_step(dt, state)
        return CompiledLaw(self.curve, self.curve_constants(), ())

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, slope, by_parameters = self.evaluate(u)
        m = du.shape[1]
        dy = np.empty((len(y), m + by_parameters.shape[1]))
        np.multiply(du, slope[:, None], out=dy[:, :m])
        dy[:, m:] = by_parameters
        return y, dy

    def bend(self, seen):
        """Return the departure of the curve from a straight line over the range of its input.

        Parameters
        ----------
        seen : object
            As for :meth:`characteristics`; only its ``ends`` of the input are used.

        Returns
        -------
        dict of str to (float, str)
            Largest departure as a percentage of the range, by its name.
        """
        v = np.linspace(*seen.ends, 300)
        departure = self.run(v, 1.0)[0] - v
        departure -= np.polyval(np.polyfit(v, departure, 1), v)
        return {"departure from a straight line": (100.0 * np.ptp(departure) / np.ptp(v), "%")}


class StaticModel(ParametricModel):
    """Base of the memoryless models.

    Parameters
    ----------
    initial_state, dt, drive, method : str, float, str or int, str or Method
        As for every model; a memoryless model does not depend on the first two.
    """

    operator_class = StaticOperator
    any_interval = True


class SaturationModel(StaticModel):
    """Base of the saturations.

    Parameters
    ----------
    sides : {"both", "lower", "upper"}, default="both"
        Which limits are fitted.
    place : {"drive", "sensor"}, default="sensor"
        Position in a series that an effect search builds: before all other stages, or after them.
    """

    any_interval = False
    _parameter_constraints = {
        **StaticModel._parameter_constraints,
        "sides": [StrOptions(set(SIDES))],
        "place": [StrOptions({"drive", "sensor"})],
    }

    @property
    def stage_order(self) -> int:
        return 0 if self.place == "drive" else 50


def range_of_drive(records):
    """Return the smallest and the largest value of the drive in all records."""
    drives = [record.u for record in records]
    return float(min(map(np.min, drives))), float(max(map(np.max, drives)))
