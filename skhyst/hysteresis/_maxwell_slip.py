"""Maxwell-slip friction model: elasto-slide elements in parallel."""

from numbers import Integral

import numpy as np
from sklearn.utils.validation import check_array

from .._sklearn import Interval, StrOptions
from ..operators import MaxwellSlipOperator, play_thresholds
from ._friction import FrictionModel

__all__ = ["MaxwellSlip"]


class MaxwellSlip(FrictionModel):
    r"""Maxwell-slip model: springs that slide, in parallel; a superposition of stop operators.

    .. math::

        y = \sum_i k_i E_{r_i}[u] + k u + d \dot u + c, \qquad
        E_r[u](t) = \max(-r, \min(r, E_r[u](t^-) + u(t) - u(t^-)))

    The drive ``u`` is a displacement, the response a force (or anything that follows it). All
    parameters are linear and solved exactly, the stiffnesses by non-negative least squares; no
    starting values are needed.

    Parameters
    ----------
    n_elements : int, default=10
        Number of elements; ignored where ``thresholds`` is an array.
    thresholds : {"grid", "quantile"} or array-like of shape (n_elements,), default="grid"
        Deflections at which the elements slide: evenly spaced over the half range of the drive, by
        quantiles of the drive's swings, or given, in units of the drive, positive.
    non_negative : bool, default=True
        Stiffnesses of the elements are not negative (the model dissipates); free otherwise.
    fit_damping : bool, default=True
        Whether a viscous force ``d`` times the velocity is fitted (0 otherwise).
    fit_stiffness : bool, default=False
        Whether a spring ``k`` that never slides is fitted (0 otherwise).
    fit_intercept : bool, default=True
        Whether the response has a constant (a force offset).
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    thresholds_ : ndarray of shape (n_elements,)
        Units of the drive.
    weights_ : ndarray of shape (n_elements,)
        Stiffnesses ``k_i``, units of the response over units of the drive.
    saturation_forces_ : ndarray of shape (n_elements,)
        ``k_i r_i``, units of the response.
    intercept_ : float
        Units of the response.
    operator_ : MaxwellSlipOperator
        The model as frozen numbers, to run sample by sample.
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    W. D. Iwan, "A distributed-element model for hysteresis and its steady-state dynamic response",
    Journal of Applied Mechanics 33(4), 1966; F. Al-Bender, V. Lampaert, J. Swevers, "The
    generalized Maxwell-slip model", IEEE Trans. Automatic Control 50(11), 2005.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import MaxwellSlip
    >>> drive = 5.0 * np.sin(np.linspace(0, 20, 300))
    >>> y = np.zeros(300)
    >>> for k in range(1, 300):
    ...     y[k] = np.clip(y[k - 1] + drive[k] - drive[k - 1], -2.0, 2.0)
    >>> model = MaxwellSlip(thresholds=[1.0, 2.0, 3.0]).fit(drive.reshape(-1, 1), y + 7.0)
    >>> model.weights_.round(3) + 0.0
    array([0., 1., 0.])
    """

    _parameter_constraints = {
        **FrictionModel._parameter_constraints,
        "n_elements": [Interval(Integral, 1, None, closed="left")],
        "thresholds": [StrOptions({"grid", "quantile"}), "array-like"],
        "non_negative": ["boolean"],
    }

    def __init__(
        self,
        n_elements=10,
        *,
        thresholds="grid",
        non_negative=True,
        fit_damping=True,
        fit_stiffness=False,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.n_elements = n_elements
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.fit_damping = fit_damping
        self.fit_stiffness = fit_stiffness
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        if isinstance(self.thresholds, str):
            # the first of the thresholds of plays is zero: no stop at all
            drives = [record.u for record in records]
            thresholds = play_thresholds(drives, self.n_elements + 1, self.thresholds)[1:]
        else:
            thresholds = check_array(self.thresholds, ensure_2d=False, dtype=np.float64)
        operator = MaxwellSlipOperator(
            thresholds, np.zeros(len(thresholds)), non_negative=self.non_negative
        )
        return [(operator, ())]

    def _adopt(self, result):
        super()._adopt(result)
        self.thresholds_ = np.array(result.operator.thresholds)
        self.weights_ = np.array(result.operator.weights)
        self.saturation_forces_ = self.weights_ * self.thresholds_
        self.intercept_ = float(result.operator.intercept)
        return self
