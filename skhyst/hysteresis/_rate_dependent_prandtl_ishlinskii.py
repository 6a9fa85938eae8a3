"""Prandtl-Ishlinskii model whose loops widen, or tilt, with the rate of the drive."""

import numpy as np
from sklearn.utils.validation import check_is_fitted

from .._sklearn import StrOptions
from ..base import ParametricModel, read_data
from ..operators import RateDependentPrandtlIshlinskiiOperator
from ._prandtl_ishlinskii import PrandtlIshlinskii

__all__ = ["RateDependentPrandtlIshlinskii"]

_GROWTHS = np.geomspace(0.003, 0.3, 5)  # of a threshold at the highest rate, over the half range


class RateDependentPrandtlIshlinskii(ParametricModel):
    r"""Prandtl-Ishlinskii model that depends on the rate of the drive.

    With ``variant="threshold"`` (Al Janaideh and Krejci 2013) all thresholds but the one at zero
    grow with the rate, and loops widen:

    .. math:: y = c + \sum_k w_k F_{r_k(t)}[u], \quad r_k(t) = r_k + \beta |u'(t)|

    With ``variant="slope"`` (Ang, Khosla and Riviere 2007) the weights change with the rate, and
    loops tilt:

    .. math:: y = c + \sum_k (w_k + s_k |u'(t)|) F_{r_k}[u]

    The size of the rate counts, so that a model without intercept stays odd. The rate at a
    sample is that of the straight line that leads to it. All parameters but :math:`\beta` are
    solved exactly by least squares.

    Parameters
    ----------
    n_operators : int, default=20
        Number of play operators; ignored where ``thresholds`` is an array.
    variant : {"threshold", "slope"}, default="threshold"
        What follows the rate.
    thresholds : {"grid", "quantile"} or array-like of shape (n_operators,), default="grid"
        Thresholds at rest: evenly spaced over the half range of the drive, by quantiles of the
        drive's swings, or given, in units of the drive.
    non_negative : bool, default=True
        Weights at rest are not negative; free otherwise.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    thresholds_ : ndarray of shape (n_operators,)
        At rest, units of the drive.
    weights_ : ndarray of shape (n_operators,)
        At rest, units of the response over units of the drive.
    rate_weights_ : ndarray of shape (n_operators,) or (0,)
        Change of the weights with the rate (``variant="slope"``).
    dilation_ : float
        Growth of the thresholds with the rate, in s; 0 with ``variant="slope"``.
    intercept_ : float
        Units of the response.
    operator_ : RateDependentPrandtlIshlinskiiOperator
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    M. Al Janaideh and P. Krejci, "Inverse rate-dependent Prandtl-Ishlinskii model for feedforward
    compensation of hysteresis in a piezomicropositioning actuator", IEEE/ASME Trans. Mechatronics
    18(5), 2013. W. T. Ang, P. K. Khosla and C. N. Riviere, "Feedforward controller with inverse
    rate-dependent model for piezoelectric actuators in trajectory-tracking applications",
    IEEE/ASME Trans. Mechatronics 12(2), 2007.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import RateDependentPrandtlIshlinskii
    >>> from skhyst.operators import RateDependentPrandtlIshlinskiiOperator
    >>> truth = RateDependentPrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.5], dilation=0.02)
    >>> drive = np.sin(np.linspace(0, 8, 500) ** 2)
    >>> y, _ = truth.run(drive, 0.01)
    >>> model = RateDependentPrandtlIshlinskii(thresholds=[0.0, 0.3], dt=0.01)
    >>> round(model.fit(drive.reshape(-1, 1), y).dilation_, 6)
    0.02
    """

    _parameter_constraints = {
        **PrandtlIshlinskii._parameter_constraints,
        "variant": [StrOptions({"threshold", "slope"})],
    }
    del _parameter_constraints["form"], _parameter_constraints["drive_offset"]

    _rank = RateDependentPrandtlIshlinskiiOperator.rank

    def __init__(
        self,
        n_operators=20,
        *,
        variant="threshold",
        thresholds="grid",
        non_negative=True,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.n_operators = n_operators
        self.variant = variant
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        plays = PrandtlIshlinskii(self.n_operators, thresholds=self.thresholds)
        thresholds = plays._starts(records)[0][0].thresholds
        zeros = np.zeros(thresholds.size)
        if self.variant == "slope":
            rates, dilations = zeros, [0.0]
        else:
            rates, dilations = (), self._dilations(records)
        return [
            (
                RateDependentPrandtlIshlinskiiOperator(
                    thresholds,
                    zeros,
                    rates,
                    dilation=float(dilation),
                    non_negative=self.non_negative,
                ),
                (),
            )
            for dilation in dilations
        ]

    @staticmethod
    def _dilations(records):
        """Return growths with which a threshold changes by a part of the drive's half range."""
        fastest = max(np.abs(np.diff(record.u)).max(initial=0.0) / record.dt for record in records)
        half_range = 0.5 * max(np.ptp(record.u) for record in records)
        return _GROWTHS * (half_range / fastest if fastest > 0.0 else records[0].dt)

    def _fixed(self):
        return frozenset() if self.fit_intercept else frozenset({"intercept"})

    def _adopt(self, result):
        super()._adopt(result)
        for name in ("thresholds", "weights", "rate_weights"):
            setattr(self, f"{name}_", np.array(getattr(self.operator_, name)))
        self.dilation_ = float(self.operator_.dilation)
        self.intercept_ = float(self.operator_.intercept)
        return self

    def inverse_predict(self, X):
        """Return the drive that makes the response follow column 0 of ``X``.

        The inverse is exact at known rates of the drive. These are found by repetition, as far as
        that brings the response closer to ``X``; a small error is left where the thresholds, or
        weights, change fast. Check ``predict`` of the result.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Column 0 is the desired response, in its units; the index carries the records.

        Returns
        -------
        ndarray of shape (n_samples,)
            Drive.

        Raises
        ------
        ValueError
            If the model is not strictly monotone: the threshold zero needs a positive weight.
        """
        check_is_fitted(self)
        slices, X, _ = read_data(self, X, reset=False, dt=self.dt)
        state = self._free_run_state()
        inverse = self.operator_.inverse_run
        return np.concatenate([inverse(X[r.rows, 0], r.dt, state) for r in slices])
