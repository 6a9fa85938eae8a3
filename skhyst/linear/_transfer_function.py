"""Rational transfer functions of one input or several: the estimator.

The law and its operators stand in ``_rational``, starting values in ``_transfer_function_fit``.
"""

import warnings
from functools import partial
from numbers import Integral, Real
from typing import Self

import numpy as np
from sklearn.utils.validation import check_array, check_is_fitted

from .._sklearn import Interval, StrOptions
from ..base import one_thread
from ..exceptions import DivergenceWarning
from ..operators import run_records
from ..records import record_slices
from ._conversion import control_system, scipy_system
from ._estimate_response import chosen_columns
from ._linear import LinearModel, refuse_open_hold
from ._modes import ModesMixin, section_poles
from ._rational import TransferFunctionOperator
from ._transfer_function_fit import choose_orders, fit_response, held_names, record_starts


class TransferFunction(ModesMixin, LinearModel):
    r"""Rational transfer functions of one input or several, with a delay.

    .. math:: y = \sum_i G_i\, u_i, \qquad G_i(s) = e^{-\theta_i s} \frac{N_i(s)}{D(s)}

    All inputs share the denominator: as many states as poles. The poles are stable by
    construction, the numerators are solved exactly for given poles.

    :meth:`fit` identifies the free run over records, starting from the iteration of Steiglitz and
    McBride [1]_ and from vector fitting [2]_ of the records' transforms;
    :meth:`fit_frequency_response` identifies :math:`G(j \omega)` itself, weighted by its
    uncertainty.

    Parameters
    ----------
    n_poles : int or "auto", default=2
        Degree of the denominator. ``"auto"`` tries 1, 2, ... ``max_poles`` and takes the one with
        the smallest BIC of the residual, which counts as white: what is left of other effects
        raises the order.
    n_zeros : int or None, default=0
        Degree of the numerators, at most ``n_poles``; None chooses it by the same criterion.
    max_poles : int, default=8
        Largest degree that ``"auto"`` tries.
    inputs : {"drive", "all"} or list of int or str, default="drive"
        The columns of X that act: the first, all, or those with these positions or names. A model
        of several inputs stands first in a composition; there, inputs go by position.
    delay : float, array-like of shape (n_inputs,) or "fit", default=0.0
        Delay in s, fixed, for all inputs or one for each; or fitted, one for each.
    stable : bool, default=True
        False lets :meth:`fit_frequency_response` keep poles of the right half plane.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; ``"estimate"`` is for the drive alone.

    Attributes
    ----------
    operator_ : TransferFunctionOperator, behind a DelayOperator where there is a delay
        ``time_constants`` (s), ``natural_frequencies`` (rad/s), ``damping_ratios``, ``numerator``,
        ``gain``, ``intercept``; ``poles()``, ``frequency_response(frequency)``. With ``inputs``
        other than "drive" a MultiInputTransferFunctionOperator.
    zeros_ : ndarray of shape (n_zeros,), complex, or list of such
        rad/s; a list, one array an input, unless ``inputs="drive"``.
    fit_error_ : float
        Root mean square of the residual; after :meth:`fit_frequency_response` that of real and
        imaginary parts in units of their standard deviation.

    Raises
    ------
    ValueError
        If ``n_zeros`` exceeds ``n_poles``, or an input does not exist.

    References
    ----------
    .. [1] Steiglitz and McBride, *IEEE Transactions on Automatic Control*, 1965.
    .. [2] Gustavsen and Semlyen, *IEEE Transactions on Power Delivery*, 1999.
    .. [3] Pintelon and Schoukens, *System Identification*, 2012, ch. 6, 9 and 11.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator, TransferFunction
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05, gain=3.0).run(drive, 0.01)
    >>> model = TransferFunction(n_poles=2, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gain:.3f}")
    3.000
    """

    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "n_poles": [Interval(Integral, 1, None, closed="left"), StrOptions({"auto"})],
        "n_zeros": [Interval(Integral, 0, None, closed="left"), None],
        "max_poles": [Interval(Integral, 1, None, closed="left")],
        "inputs": [StrOptions({"drive", "all"}), list, tuple],
        "delay": [Interval(Real, 0, None, closed="left"), StrOptions({"fit"}), "array-like"],
        "stable": ["boolean"],
    }

    def __init__(
        self,
        n_poles=2,
        *,
        n_zeros=0,
        max_poles=8,
        inputs="drive",
        delay=0.0,
        stable=True,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.n_poles = n_poles
        self.n_zeros = n_zeros
        self.max_poles = max_poles
        self.inputs = inputs
        self.delay = delay
        self.stable = stable
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def _reads_columns(self):
        return not (isinstance(self.inputs, str) and self.inputs == "drive")

    def _signal(self, X, slices):
        return X[:, self._columns(X.shape[1])] if self._reads_columns else X[:, 0]

    def _columns(self, n_columns, names=None):
        """Return the positions of the inputs among the columns of X."""
        if isinstance(self.inputs, str):
            return list(range(n_columns if self.inputs == "all" else 1))
        if names is None:
            names = getattr(self, "feature_names_in_", ())
        return chosen_columns(self.inputs, names, n_columns, "TransferFunction")

    def _delay_of(self, n_inputs):
        """Return "fit", or the delays in s: one an input, or none at all."""
        if isinstance(self.delay, str):
            return self.delay
        delays = np.asarray(self.delay, dtype=float)
        if delays.ndim > 1 or delays.size not in (1, n_inputs) or not np.all(delays >= 0.0):
            raise ValueError(
                "The 'delay' parameter of TransferFunction must be a number that is not negative, "
                f"or one for each of {n_inputs} input(s). Got {self.delay!r} instead."
            )
        delays = np.broadcast_to(delays, n_inputs).astype(float)
        return delays if delays.any() else np.empty(0)

    def held_parameters(self) -> frozenset[str]:
        fixed = super().held_parameters()
        if self._reads_columns:
            n_inputs = getattr(self, "_n_inputs", 1)
            held = held_names(n_inputs, self._delay_of(n_inputs), self.fit_gain)
            return frozenset(held | (fixed & {"intercept"}))
        delay = self._delay_of(1)
        if not np.size(delay):
            return fixed
        held = set() if isinstance(delay, str) else {"delay__delay"}
        return frozenset(held | {f"transfer_function__{name}" for name in fixed})

    def _check_orders(self):
        n_poles = self.max_poles if self.n_poles == "auto" else self.n_poles
        if self.n_zeros is not None and self.n_zeros > n_poles:
            name = "max_poles" if self.n_poles == "auto" else "n_poles"
            raise ValueError(
                f"The 'n_zeros' parameter of TransferFunction must be at most '{name}' = "
                f"{n_poles}. Got {self.n_zeros} instead."
            )

    def _record_data(self, slices, X, y):
        self.__dict__.pop("_response_inputs", None)  # of an earlier fit to a response
        records = super()._record_data(slices, X, y)
        if self._reads_columns:
            self._n_inputs = records[0].u.shape[1]
            if self.initial_state == "estimate":
                raise ValueError(
                    "The 'initial_state' parameter of TransferFunction must be 'rest' or 'zero' "
                    "unless 'inputs' is 'drive'. Got 'estimate' instead."
                )
        return records

    def starting_values(self, records):
        self._check_orders()
        if self.n_poles == "auto" or self.n_zeros is None:
            return [self._choose(records).operator]
        return self._starts_of(records, self.n_poles, self.n_zeros)

    def _starts_of(self, records, n_poles, n_zeros):
        n_inputs = records[0].u.shape[1] if self._reads_columns else 1
        return record_starts(records, n_poles, n_zeros, self._delay_of(n_inputs), self.hold)

    def _identify(self, data):
        self._check_orders()
        return self._choose(data)

    def _choose(self, records):
        n_samples = sum(record.segment_weights().sum() for record in records)
        power = sum(record.power() for record in records)

        def fit(n_poles, n_zeros):
            starts = self._starts_of(records, n_poles, n_zeros)
            return self._refine(starts, records), n_samples, power

        return choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)

    def fit_frequency_response(self, response) -> Self:
        r"""Identify the model from a frequency response.

        Minimises :math:`\sum_{k,i} |\hat G_i(f_k) - G_i(f_k)|^2 / \sigma_i(f_k)^2` over
        continuous-time G, which takes inputs as band-limited between samples. No intercept.

        Parameters
        ----------
        response : FrequencyResponse
            With ``std``, the lines are weighted by it.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If there are fewer lines than the parameters need, or several inputs while ``inputs``
            is "drive".
        """
        self._validate_params()
        refuse_open_hold(self.hold)
        self._check_orders()
        g, std = response.response, response.std
        if g.shape[1] > 1 and not self._reads_columns:
            raise ValueError(
                "The 'inputs' parameter of TransferFunction must be 'all' or a list for a "
                f"frequency response of {g.shape[1]} inputs. Got 'drive' instead."
            )
        columns = self._columns(g.shape[1], response.input_names)
        used = response.frequency > 0.0
        frequency, g = response.frequency[used], g[used][:, columns]
        std = None if std is None else std[used][:, columns]
        fewest = (self.n_zeros or 1) if self.n_poles == "auto" else self.n_poles
        n_unknowns = fewest + len(columns) * ((self.n_zeros or 0) + 1)
        if 2 * g.size <= n_unknowns or not np.any(g):
            raise ValueError(
                f"The 'response' must have more than {n_unknowns // (2 * len(columns)) + 1} lines "
                f"above zero, and not vanish. Got {len(frequency)} lines instead."
            )

        fit = partial(
            fit_response,
            frequency,
            g,
            std,
            delay=self._delay_of(len(columns)),
            hold=self.hold,
            stable=self.stable,
            single=not self._reads_columns,
            fit_gain=self.fit_gain,
            method=self.method,
        )
        with one_thread():
            result = choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)
        self._response_inputs = tuple(response.input_names[i] for i in columns)
        self._n_inputs = self.n_features_in_ = len(columns)
        self.records_ = ()
        return self._adopt(result)

    def _adopt(self, result):
        super()._adopt(result)
        names = list(result.params)
        wanted = [
            i
            for field in ("time_constants", "natural_frequencies", "damping_ratios")
            for i, name in enumerate(names)
            if name.removeprefix("transfer_function__").startswith(f"{field}[")
        ]
        self._adopt_poles(result.covariance[np.ix_(wanted, wanted)])
        return self

    def _adopt_poles(self, covariance):
        rational, _ = self._rational()
        parts = rational.time_constants, rational.natural_frequencies, rational.damping_ratios
        self._set_modes(*section_poles(*parts), covariance)
        self.zeros_ = rational.zeros()

    def _rational(self):
        """Return the fitted operator without the delay of a single input, and the delays."""
        operator = self.operator_
        if hasattr(operator, "stages"):
            return operator.stages[1], operator.stages[0].delay
        return operator, getattr(operator, "delays", 0.0)

    @classmethod
    def from_system(cls, system, **params) -> Self:
        """Make a fitted model of a continuous-time system, such as one of a data sheet.

        Parameters
        ----------
        system : scipy.signal.lti, control.StateSpace or control.TransferFunction
            One response, no pole at zero.
        **params
            Parameters of the model, such as ``dt``, ``hold`` and ``initial_state``.

        Returns
        -------
        TransferFunction
            With ``operator_``, poles and zeros; standard errors are zero.

        Examples
        --------
        >>> from scipy.signal import lti
        >>> from skhyst.linear import TransferFunction
        >>> model = TransferFunction.from_system(lti([2.0], [0.5, 1.0]), dt=0.1)
        >>> model.predict([[1.0], [1.0]]).round(6)
        array([2., 2.])
        """
        model = cls(**params)
        refuse_open_hold(model.hold)
        operator = TransferFunctionOperator.from_scipy(system, hold=model.hold)
        single = isinstance(operator, TransferFunctionOperator)
        shape = np.shape(operator.numerator if single else operator.numerators)
        model.set_params(
            n_poles=len(operator.poles()), n_zeros=shape[-1], inputs="drive" if single else "all"
        )
        model._validate_params()
        entries = [name for name, _ in operator.entries()]
        n_inputs = 1 if single else operator.n_inputs
        model._n_inputs = model.n_features_in_ = n_inputs
        model._response_inputs = tuple(f"input{i}" for i in range(n_inputs))
        model.operator_, model.records_ = operator, ()
        model.params_ = dict(zip(entries, operator.pack().tolist(), strict=True))
        model.params_std_ = dict.fromkeys(entries, 0.0)
        model.params_std_white_ = dict.fromkeys(entries, 0.0)
        model._adopt_poles(np.zeros((model.n_poles, model.n_poles)))
        return model

    def to_scipy(self):
        """Return the fitted model as a continuous-time ``scipy.signal.StateSpace``.

        The intercept is left out.

        Raises
        ------
        ValueError
            If the model has a delay, which no finite state space has.
        """
        check_is_fitted(self)
        return scipy_system(*self._rational())

    def to_control(self):
        """Return what :meth:`to_scipy` does as a ``control.StateSpace`` of python-control.

        Raises
        ------
        ImportError
            If the package ``control`` is not installed.
        """
        check_is_fitted(self)
        return control_system(*self._rational())

    def predict(self, X) -> np.ndarray:
        """Return the free run: the response to the inputs alone, each record from its own start.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_columns)
            After :meth:`fit_frequency_response` a frame gives the inputs by their names, if it has
            them, and an array by position.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response, finite always. An unstable model warns, with a
            :class:`~skhyst.exceptions.DivergenceWarning`.
        """
        check_is_fitted(self)
        if np.any(self.poles_.real > 0.0):
            warnings.warn(
                "The model is unstable: its free run grows without bound.",
                DivergenceWarning,
                stacklevel=2,
            )
        if not hasattr(self, "_response_inputs"):
            return super().predict(X)
        names = list(getattr(X, "columns", ()))
        if set(self._response_inputs) <= set(names):
            X = X[list(self._response_inputs)]
        array = check_array(X, dtype=np.float64)
        if array.shape[1] < self._n_inputs:
            raise ValueError(
                f"X must have the {self._n_inputs} input(s) {list(self._response_inputs)}. Got "
                f"{array.shape[1]} column(s) instead."
            )
        signal = array[:, : self._n_inputs] if self._reads_columns else array[:, 0]
        slices = record_slices(X, dt=self.dt)
        return run_records(self.operator_, signal, slices, self._free_run_state())
