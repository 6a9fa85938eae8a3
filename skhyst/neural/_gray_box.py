"""Gray-box network: quasi-static hysteresis and its dynamics, whose weights are parameters."""

import dataclasses
import warnings
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from scipy.linalg import block_diag

from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..exceptions import DivergenceWarning, RecordError
from ..hysteresis import SystemLevelHysteresis
from ..optimize import IdentificationResult, identify
from ..records import record_slices
from ._gray_box_operator import GrayBoxOperator

_BOUND = 100.0  # ranges of the response beyond the largest one: what lies there has diverged
_SAME_INTERVAL = 1e-2  # relative
_SLOW = 2.0  # records at most so much faster than the slowest one train the static sub-model


class GrayBoxHysteresis(ParametricModel):
    r"""Gray-box network: system-level hysteresis and a NARMAX sub-model of its dynamics.

    .. math:: y(k) = d_H(k) + \sum_i \theta_i x_i(k) + \sum_{i \le j} \theta_{ij} x_i(k) x_j(k),
        \qquad \frac{d d_H}{du} = p + \kappa \frac{1 - e^{-\lambda |u - V_{shift}|}}{\lambda}

    where :math:`V_{shift}` is the drive at its last turning point. The weights of the network are
    the parameters of this model. They are trained by Levenberg-Marquardt on the error of the free
    run, with the exact Jacobian of the whole recursion. The signals :math:`x_i` are changes of
    :math:`d_H` and of past outputs, which vanish at rest, or as printed the past drives and outputs
    themselves; see :class:`~skhyst.neural.GrayBoxOperator`.

    Parameters
    ----------
    training : {"staged", "joint"}, default="staged"
        ``"staged"``, as Ahmed and Yan (2021) do: the quasi-static sub-model from the slowest
        records, then the dynamic one from all records, with the first held. ``"joint"``: after
        these two stages all weights are trained together on all records.
    n_static_records : int or None, default=None
        How many records, the slowest ones, train the quasi-static sub-model: by the way that the
        drive travels in a second, over its range. None: those at most twice as fast as the slowest.
    variant : {"integral", "printed"}, default="integral"
        Quasi-static sub-model, as in :class:`~skhyst.hysteresis.SystemLevelHysteresis`.
    dynamics : {"rate", "printed"}, default="rate"
        Signals of the dynamic sub-model.
    input_lags, output_lags : int, default=2
        Lags of the dynamic sub-model in samples.
    degree : {1, 2}, default=1
        Highest degree of its products. Ahmed and Yan (2021) have 2; 1 is any linear dynamics of
        ``output_lags`` poles behind the hysteresis.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record, with all weights.
    method : str or Method, default="levenberg_marquardt"
        How the weights are trained, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : GrayBoxOperator
    params_, params_std_ : dict
        ``slope`` p in response/drive, ``curvature`` kappa in response/drive^2, ``decay`` lambda in
        1/drive, ``intercept`` and, with the printed variant, ``rate_gain`` in response s/drive;
        ``theta[...]``, named by its product. Standard errors of the staged training are those
        of each stage, with the other held.
    history_ : dict of str to ndarray
        A value for each epoch, the start of a stage being its epoch 0: ``stage`` (``"static"``,
        ``"dynamic"``, ``"joint"``), ``epoch``, ``loss`` (mean square of the error, response^2)
        and ``mu``, the damping (NaN with methods that have none).
    n_epochs_ : dict of str to int
        Epochs of each stage.
    dt_ : float
        Sampling interval of the fit in s.
    bound_ : float
        Magnitude beyond which a run has diverged: 100 ranges of the response beyond its largest.

    Raises
    ------
    RecordError
        If ``predict`` gets records of another sampling interval than ``fit``: lags are in samples.

    References
    ----------
    Ahmed and Yan, *IEEE Access*, 2021, equations (15) to (22), (27) and (30) to (43).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.neural import GrayBoxHysteresis
    >>> from skhyst.neural import GrayBoxOperator
    >>> from skhyst.hysteresis import SystemLevelOperator
    >>> from skhyst.records import stack_records
    >>> plant = GrayBoxOperator(SystemLevelOperator(0.1, 0.002, 0.03), [0.3], 0, 1)
    >>> time = 0.01 * np.arange(1000)
    >>> drives = [50.0 - 50.0 * np.cos(2 * np.pi * f * time) for f in (0.1, 1.0, 2.5)]
    >>> records = [(u.reshape(-1, 1), plant.run(u, 0.01)[0]) for u in drives]
    >>> X, y = stack_records(records, dt=0.01)
    >>> model = GrayBoxHysteresis("joint", input_lags=0, output_lags=1).fit(X, y)
    >>> print(f"{model.params_['decay']:.4f} {model.params_['theta[e(k)]']:.4f}")
    0.0300 0.3000
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "training": [StrOptions({"staged", "joint"})],
        "n_static_records": [Interval(Integral, 1, None, closed="left"), None],
        "variant": [StrOptions({"integral", "printed"})],
        "dynamics": [StrOptions({"rate", "printed"})],
        "input_lags": [Interval(Integral, 0, None, closed="left")],
        "output_lags": [Interval(Integral, 0, None, closed="left")],
        "degree": [Interval(Integral, 1, 2, closed="both")],
        "fit_intercept": ["boolean"],
    }

    _extreme = 1e30  # products of several values are squared
    operator_class = GrayBoxOperator
    _one_interval = True

    def __init__(
        self,
        training="staged",
        *,
        n_static_records=None,
        variant="integral",
        dynamics="rate",
        input_lags=2,
        output_lags=2,
        degree=1,
        fit_intercept=True,
        initial_state="rest",
        dt=1.0,
        method="levenberg_marquardt",
    ):
        self.training = training
        self.n_static_records = n_static_records
        self.variant = variant
        self.dynamics = dynamics
        self.input_lags = input_lags
        self.output_lags = output_lags
        self.degree = degree
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def predict(self, X) -> np.ndarray:
        """Return the free run: the response to the drive alone, each record from its own start.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            Sampled at the interval of the fit.

        Returns
        -------
        ndarray of shape (n_samples,)
            Units of the response. Finite always; outputs beyond ``bound_`` are cut off there, and a
            run that left the range of floating point is zero from there on, with a
            :class:`~skhyst.exceptions.DivergenceWarning`.
        """
        y = super().predict(X)
        for record in record_slices(X, dt=self.dt):
            if abs(record.dt - self.dt_) > _SAME_INTERVAL * self.dt_:
                raise RecordError(
                    f"The records must be sampled at {self.dt_:g} s, as those of the fit: the lags "
                    f"of GrayBoxHysteresis are in samples. Got {record.dt:g} s instead; use "
                    "resample_records."
                )
        if np.abs(y).max() > self.bound_:
            warnings.warn(
                "The simulation diverged; outputs far beyond the range of the response in fit were "
                "cut off.",
                DivergenceWarning,
                stacklevel=2,
            )
            y = np.clip(y, -self.bound_, self.bound_)
        return y

    def starting_values(self, records):
        return [self._identify(records).operator]

    def _identify(self, data):
        largest = max(np.abs(record.y).max() for record in data)
        span = max(r.y.max() for r in data) - min(r.y.min() for r in data)
        n_samples = sum(len(r.u) for r in data)
        self.bound_ = float(largest + _BOUND * (span or largest or 1.0))
        options = {"initial_state": self._free_run_state(), "method": self.method}
        slow = self._slow_records(data)
        first = SystemLevelHysteresis(self.variant).starting_values(slow)
        static = identify(first, slow, fixed=self.held_parameters(), **options)
        stages = [_stage("static", static, sum(len(r.u) for r in slow))]
        network = GrayBoxOperator.at_rest(
            static.operator,
            input_lags=self.input_lags,
            output_lags=self.output_lags,
            degree=self.degree,
            dynamics=self.dynamics,
        )
        held = frozenset(name for name, _ in static.operator.entries())
        if network.n_parameters > len(held):
            starts = [network, *self._one_step_starts(network, data)]
            dynamic = identify(starts, data, fixed=held, **options)
            stages.append(_stage("dynamic", dynamic, n_samples))
            result = _beside(static, dynamic)
        else:
            result = dataclasses.replace(static, operator=network)
        if self.training == "joint":
            joint = identify([result.operator], data, fixed=self.held_parameters(), **options)
            stages.append(_stage("joint", joint, n_samples))
            n_evaluations = result.n_evaluations + joint.n_evaluations
            result = dataclasses.replace(joint, n_evaluations=n_evaluations)
        return _TrainingResult(**vars(result), stages=stages)

    def _slow_records(self, data):
        """Return the records that train the static sub-model."""
        ranges = np.array([np.ptp(record.u) for record in data])
        travels = np.array([np.abs(np.diff(r.u)).sum() / (r.dt * len(r.u)) for r in data])
        moving = np.flatnonzero(ranges > 0.0)
        if not len(moving):
            return data
        speeds = travels[moving] / ranges[moving]
        order = moving[np.argsort(speeds, kind="stable")]
        count = self.n_static_records
        if count is None:
            count = int(np.sum(speeds <= _SLOW * speeds.min()))
        return [data[i] for i in sorted(order[:count])]

    def _one_step_starts(self, network, data):
        """Return the network with weights that explain each sample from the measured past."""
        parts = [
            network.regressors(record.u, record.y, record.dt, self._free_run_state())
            for record in data
        ]
        columns = np.concatenate([part for part, _ in parts])
        rest = np.concatenate([part for _, part in parts])
        scale = np.abs(columns).max(axis=0)
        scale[scale == 0.0] = 1.0
        weights = np.linalg.lstsq(columns / scale, rest, rcond=None)[0] / scale
        start = dataclasses.replace(network, weights=weights)
        return [start] if np.all(np.abs(start.poles()) < 1.0) else []

    def _adopt(self, result):
        if isinstance(result, _TrainingResult):
            stages = result.stages
        else:  # a refinement of all weights together
            stages = [_stage("joint", result, sum(record.n_samples for record in self.records_))]
        self.history_ = {key: np.concatenate([s[key] for s in stages]) for key in stages[0]}
        self.n_epochs_ = {s["stage"][0]: int(s["epoch"][-1]) for s in stages}
        self.dt_ = self.records_[0].dt
        return super()._adopt(result)


@dataclass(frozen=True)
class _TrainingResult(IdentificationResult):
    stages: list = ()


def _stage(name, result, n_samples):
    """Return the history of a stage of the training."""
    count = len(result.history)
    return {
        "stage": [name] * count,
        "epoch": np.arange(count),
        "loss": [cost / n_samples for _, cost in result.history],
        "mu": result.damping or np.full(count, np.nan),
    }


def _beside(static, dynamic):
    """Return one result of the two stages."""
    return dataclasses.replace(
        dynamic,
        params=static.params | dynamic.params,
        params_std=static.params_std | dynamic.params_std,
        params_std_white=static.params_std_white | dynamic.params_std_white,
        undetermined=(*static.undetermined, *dynamic.undetermined),
        condition_number=max(static.condition_number, dynamic.condition_number),
        n_evaluations=static.n_evaluations + dynamic.n_evaluations,
        seconds=static.seconds + dynamic.seconds,
        x=np.concatenate([static.x, dynamic.x]),
        covariance=block_diag(static.covariance, dynamic.covariance),
    )
