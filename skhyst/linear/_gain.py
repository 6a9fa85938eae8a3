"""Static gain."""

from ..base import ParametricModel
from ..operators import GainOperator
from ._base import LinearModel, slope

__all__ = ["Gain"]


class Gain(LinearModel):
    r"""Static gain: the response is proportional to the drive.

    .. math:: y = g u + c

    The plainest declared model of an actuator, and the least that an auxiliary input does.

    Parameters
    ----------
    fit_gain, fit_intercept : bool, default=True
        Whether the gain (1 otherwise) and a constant response (0 otherwise) are fitted.
    initial_state, dt, method
        As for every model; a memoryless model depends on neither.

    Attributes
    ----------
    operator_ : GainOperator
        ``gain`` in response units over drive units, ``intercept`` in units of the response.
    params_, params_std_ : dict
        Parameters and their standard errors.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import Gain
    >>> X = np.linspace(0.0, 5.0, 50).reshape(-1, 1)
    >>> model = Gain().fit(X, 2.0 * X[:, 0] + 1.0)
    >>> round(model.operator_.gain, 6), round(model.operator_.intercept, 6)
    (2.0, 1.0)
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_gain": ["boolean"],
        "fit_intercept": ["boolean"],
    }
    _any_interval = True

    def __init__(
        self,
        *,
        fit_gain=True,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        return [(GainOperator(slope(records) if self.fit_gain else 1.0), ())]
