"""Prandtl-Ishlinskii model: a weighted superposition of play or stop operators."""

from numbers import Integral, Real

import numpy as np
from sklearn.utils.validation import check_array

from .._sklearn import Interval, StrOptions
from ..operators import PrandtlIshlinskiiOperator, play_thresholds
from ._invertible import InvertibleModel

__all__ = ["PrandtlIshlinskii"]


class PrandtlIshlinskii(InvertibleModel):
    r"""Prandtl-Ishlinskii model of rate-independent hysteresis.

    .. math:: y = c + \sum_k w_k F_{r_k}[u - u_0], \quad
       F_r[u](t) = \max(u(t) - r, \min(u(t) + r, F_r[u](t^-)))

    (thesis, (3.1)-(3.6)). With ``form="stop"``, stops :math:`E_r[v] = v - F_r[v]`, springs that
    yield at r, take the place of the plays with a threshold above zero. The weights and the
    intercept are solved exactly by (non-negative) least squares; no starting values are needed.

    Parameters
    ----------
    n_operators : int, default=20
        Number of operators; ignored where ``thresholds`` is an array.
    form : {"play", "stop"}, default="play"
        Superposition of plays or of stops. It matters where the weights are not negative: plays
        then give counter-clockwise loops (displacement over voltage), stops clockwise ones (force
        over displacement).
    thresholds : {"grid", "quantile"} or array-like of shape (n_operators,), default="grid"
        Evenly spaced over the half range of the drive, by quantiles of the drive's swings, or
        given, in units of the drive.
    non_negative : bool, default=True
        Weights are not negative (the model dissipates, and has an inverse); free otherwise.
    drive_offset : float or "fit", default=0.0
        Drive at which the virgin device stands, units of the drive.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index. The model does not depend on it.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    thresholds_ : ndarray of shape (n_operators,)
        Units of the drive.
    weights_ : ndarray of shape (n_operators,)
        Of the plays or of the stops, units of the response over units of the drive.
    intercept_ : float
        Units of the response.
    operator_ : PrandtlIshlinskiiOperator
        The model as frozen numbers, to run sample by sample.
    params_, params_std_ : dict
        Parameters and their standard errors.

    References
    ----------
    Thesis on high-speed scanning stages, section 3.2; K. Kuhnen, "Modeling, identification and
    compensation of complex hysteretic nonlinearities", Eur. J. Control 9(4), 2003.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> drive = np.sin(np.linspace(0, 20, 500)) * np.linspace(0, 1, 500)
    >>> X = drive.reshape(-1, 1)
    >>> y = PrandtlIshlinskii(n_operators=4).fit(X, drive).predict(X)
    >>> bool(np.allclose(y, drive))
    True
    """

    _parameter_constraints = {
        **InvertibleModel._parameter_constraints,
        "n_operators": [Interval(Integral, 1, None, closed="left")],
        "form": [StrOptions({"play", "stop"})],
        "thresholds": [StrOptions({"grid", "quantile"}), "array-like"],
        "non_negative": ["boolean"],
        "drive_offset": [Interval(Real, None, None, closed="neither"), StrOptions({"fit"})],
        "fit_intercept": ["boolean"],
    }

    _rank = PrandtlIshlinskiiOperator.rank
    _any_interval = True

    def __init__(
        self,
        n_operators=20,
        *,
        form="play",
        thresholds="grid",
        non_negative=True,
        drive_offset=0.0,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.n_operators = n_operators
        self.form = form
        self.thresholds = thresholds
        self.non_negative = non_negative
        self.drive_offset = drive_offset
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _starts(self, records):
        if isinstance(self.thresholds, str):
            thresholds = play_thresholds(
                [record.u for record in records], self.n_operators, self.thresholds
            )
        else:
            thresholds = check_array(self.thresholds, ensure_2d=False, dtype=np.float64)
        offset = 0.0 if self.drive_offset == "fit" else self.drive_offset
        operator = PrandtlIshlinskiiOperator(
            thresholds,
            np.zeros(len(thresholds)),
            drive_offset=offset,
            non_negative=self.non_negative,
            form=self.form,
        )
        return [(operator, ())]

    def _fixed(self):
        fixed = set() if self.drive_offset == "fit" else {"drive_offset"}
        return frozenset(fixed if self.fit_intercept else fixed | {"intercept"})

    def _adopt(self, result):
        super()._adopt(result)
        self.thresholds_ = np.array(self.operator_.thresholds)
        self.weights_ = np.array(self.operator_.weights)
        self.intercept_ = float(self.operator_.intercept)
        return self
