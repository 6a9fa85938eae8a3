"""Models in series."""

import dataclasses

import numpy as np

from ..linear import LinearOperator
from ..operators import SeriesOperator
from ..optimize import VariableProjection, identify
from ._composition import Composition, HeldStep
from ._thinning import thin_records

__all__ = ["Cascade"]

_ALONG_THE_WAY = VariableProjection(tolerance=1e-4)
_CLEARLY = 1.1  # ratio of errors in thinned records


class Cascade(Composition):
    """Models in series, identified jointly: the output of one is the input of the next.

    The static gain and the intercept belong to one step, the hysteresis where there is one; all
    others have unit gain, since only the product can be known. Steps are added one by one, each
    from its own data-driven starting values, then everything is refined together; several linear
    dynamics are added in both orders, and the better fit is kept. In long records whose drive is
    sampled much finer than it moves, every n-th sample serves for this, and the end of it is
    refined on all samples.

    A step that is known already, such as a vibration measured at a small signal, is fitted first
    and put in a :class:`sklearn.frozen.FrozenEstimator`. All its parameters are then held, its
    gain and intercept among them, and the others are identified around it. With ``warm_start``,
    everything may then be set free from there.

    Parameters
    ----------
    steps : list of (str, estimator)
        Names and models, in the order of the signal; fitted models in a FrozenEstimator are held.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample; that of the steps is not used.
    dt : float, default=1.0
        Sampling interval in s of data without a time index; that of the steps is not used.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.
    warm_start : bool, default=False
        Whether a further ``fit`` starts from the parameters found before, where the steps still
        have the same names and parameters.

    Attributes
    ----------
    operator_ : SeriesOperator
    operators_ : dict of str to Operator
        The identified operator of each step.
    params_, params_std_ : dict
        Parameters, named ``step__parameter``, and their standard errors; those of steps that are
        held are not among them.

    Raises
    ------
    TypeError
        If a step is not a parametric model.
    NotFittedError
        If a step is held, but was never fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Cascade
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> from skhyst.linear import FirstOrderLag
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> drive = np.sin(np.linspace(0, 40, 2000)) * np.linspace(0, 1, 2000)
    >>> y, _ = FirstOrderLagOperator(0.05).run(drive, 0.01)
    >>> steps = [("hysteresis", PrandtlIshlinskii(5)), ("lag", FirstOrderLag())]
    >>> model = Cascade(steps, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> round(model.operators_["lag"].time_constant, 4)
    0.05

    A small signal first, in which the hysteresis is a gain, then everything around the known lag:

    >>> from sklearn.frozen import FrozenEstimator
    >>> lag = FirstOrderLag(dt=0.01).fit(drive[:300].reshape(-1, 1), y[:300])
    >>> steps = [("hysteresis", PrandtlIshlinskii(5)), ("lag", FrozenEstimator(lag))]
    >>> model = Cascade(steps, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> model.operators_["lag"] is lag.operator_
    True
    """

    _parameter_constraints = {**Composition._parameter_constraints, "warm_start": ["boolean"]}

    def __init__(
        self,
        steps,
        *,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
        warm_start=False,
    ):
        super().__init__(steps, initial_state=initial_state, dt=dt, method=method)
        self.warm_start = warm_start

    def _check_steps(self):
        super()._check_steps()
        for (name, _), model in list(zip(self.steps, self._models(), strict=True))[1:]:
            if model._reads_columns:
                raise ValueError(
                    f"The step '{name}' of Cascade reads columns of X: it must be the first."
                )

    def _compose(self, names, stages):
        return SeriesOperator(tuple(names), tuple(stages)).normalized()

    def _identify(self, data):
        self._check_steps()
        if self.warm_start and list(getattr(self, "operators_", ())) == [n for n, _ in self.steps]:
            start = self._resume(self.operators_.values(), data)
            if start is not None:
                return self._refine([start], data, self.method)
        thinned = None
        if self._any_interval and self.method == "variable_projection":
            thinned = thin_records(data)
        if thinned is None:
            results = [self._add_steps(data, order, self.method) for order in self._orders()]
            best = min(results, key=lambda result: result.error)
        else:
            results = [self._add_steps(thinned, order, _ALONG_THE_WAY) for order in self._orders()]
            # the thresholds of plays, say, are those of all samples
            found = _distinct(results)
            starts = [self._resume(operator.stages, data) or operator for operator in found]
            best = self._refine(starts, data, self.method)
            results.append(best)
        evaluations = sum(result.n_evaluations for result in results)
        return dataclasses.replace(best, n_evaluations=evaluations)

    def _refine(self, starts, data, method):
        """Return what identification finds from operators of one structure."""
        return identify(
            [(operator, ()) for operator in starts],
            data,
            fixed=self.held_parameters(),
            initial_state=self._free_run_state(),
            method=method,
        )

    def _resume(self, stages, data):
        """Return the operator with the structure that records ask for and the values of stages.

        None where the steps have other parameters than the stages, or are no single models.
        """
        found, records = [], data
        for stage, model in zip(stages, self._models(), strict=True):
            if isinstance(model, Cascade) and isinstance(stage, SeriesOperator):
                stage = model._resume(stage.stages, records)
            elif isinstance(model, HeldStep):
                stage = model.starting_values(records)[0][0]
            elif not isinstance(model, Composition):
                start = model.starting_values(records)[0][0]
                same = [name for name, _ in start.entries()] == [n for n, _ in stage.entries()]
                stage = _to_unit_gain(start.unpack(stage.pack())) if same else None
            else:
                stage = None
            if stage is None:
                return None
            found.append(stage)
            records = self._behind([stage], records)
        return self._compose([name for name, _ in self.steps], found)

    def _behind(self, stages, records):
        """Return records whose drive has gone through stages."""
        state = self._free_run_state()
        for stage in stages:
            records = [
                dataclasses.replace(
                    record, u=stage.run(record.u, record.dt, stage.init(record.u[0], state))[0]
                )
                for record in records
            ]
        return records

    def _orders(self):
        """Return the orders in which steps are added: as given, and dynamics from the last on.

        Dynamics that come first bend to make up for those that are missing still, and a local
        search may leave them there. Steps that are held are there from the start.
        """
        models = self._models()
        given = [i for i, model in enumerate(models) if not isinstance(model, HeldStep)]
        dynamics = [i for i in given if models[i].series_rank == LinearOperator.rank]
        turned = dict(zip(dynamics, reversed(dynamics), strict=True))
        other = [turned.get(i, i) for i in given]
        return [given] if other == given else [given, other]

    def _add_steps(self, data, order, method):
        """Add the steps in an order, each behind those before it; refine all after each."""
        models = self._models()
        stages, evaluations, result = {}, 0, None
        for i, model in enumerate(models):
            if isinstance(model, HeldStep):
                [(stages[i], _)] = model.starting_values(data)
        for i in order or [0]:
            places = sorted({*stages, i})
            records = self._behind([stages[j] for j in places if j < i], data)
            names = [self.steps[j][0] for j in places]
            candidates = [
                self._compose(names, [(stages | {i: operator})[j] for j in places])
                for operator, disturbances in models[i].starting_values(records)
                if not disturbances
            ]
            if not candidates:
                raise ValueError(
                    f"The step '{names[places.index(i)]}' of Cascade is a disturbance: it stands "
                    "beside a model, in a Sum."
                )
            last = len(names) == len(self.steps)
            result = self._refine(candidates, data, method if last else _ALONG_THE_WAY)
            stages = dict(zip(places, result.operator.stages, strict=True))
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)


def _distinct(results):
    """Return the best operator, and others whose error is not clearly larger."""
    results = sorted(results, key=lambda result: result.error)
    best = results[0]
    values, std = np.array(list(best.params.values())), np.array(list(best.params_std.values()))
    found = [best.operator]
    for other in results[1:]:
        apart = np.abs(np.array(list(other.params.values())) - values) > std
        if other.error < _CLEARLY * best.error and apart.any():
            found.append(other.operator)
    return found


def _to_unit_gain(stage):
    """Return a stage whose static gain another stage will carry, where it has one of its own."""
    values, specs = stage.pack(), [spec for _, spec in stage.entries()]
    gains = [i for i, spec in enumerate(specs) if spec.gauge == 1.0]
    if len(gains) != 1 or stage.carries_scale or values[gains[0]] == 0.0:
        return stage
    gain = values[gains[0]]
    # where the gain is linear, the other linear values are units of the response too
    scaled = [spec.linear and specs[gains[0]].linear for spec in specs]
    values = np.where(scaled, values / gain, values)
    values[gains[0]] = 1.0
    return stage.unpack(values)
