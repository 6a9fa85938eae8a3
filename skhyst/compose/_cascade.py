"""Models in series, and what all compositions of models have in common."""

from abc import abstractmethod
from dataclasses import replace
from itertools import groupby, islice, permutations
from operator import attrgetter
from typing import Self

import numpy as np
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator
from sklearn.utils.validation import check_is_fitted

from .._sklearn import BaseComposition, diagram_of
from .._validation import common_parameter
from ..base import ParametricModel, as_node, informed, refine, with_params
from ..operators import (
    FrozenOperator,
    Operator,
    Series,
    add_disturbances,
    split_disturbances,
)
from ..optimize import VariableProjection
from ._divided import Divisions, first_parts

_HYSTERESIS, _DYNAMICS = 10, 30  # stage orders, see Operator
ROUGH = VariableProjection(tolerance=1e-4)  # for fits whose result is refined later
_CLEARLY = 1.1  # ratio of errors in thinned records that is a clear difference
_ENOUGH = 5_000  # number of samples, of all records, that thinning aims at
_LONG = 20_000  # samples above which thinning saves time
_MOST_ORDERS, _MOST_PRODUCTS = 6, 48  # most orders and joint starts, if the residual is coloured
_CHANGE = 0.01  # tolerated error of thinning, relative to the drive's standard deviation


class HeldStep(ParametricModel):
    """A fitted model as a step of a composition, with all its parameters held."""

    initial_state = "rest"

    def __init__(self, model):
        self.model = model

    stage_order = property(attrgetter("model.stage_order"))
    any_interval = property(attrgetter("model.any_interval"))
    reads_columns = property(attrgetter("model.reads_columns"))
    operator_input = property(attrgetter("model.operator_input"))

    def starting_values(self, records):
        return [FrozenOperator(self.model.operator_)]

    def subtree(self, driven, disturbances):
        held = FrozenOperator(driven) if driven.n_parameters else driven
        return replace(held, model=FrozenEstimator(self.model))


class Composition(ParametricModel, BaseComposition):
    """Base of the compositions: named steps, whose parameters are ``name__parameter``.

    Parameters
    ----------
    steps : list of (str, estimator)
        Names and models; fitted models in a FrozenEstimator are held. "drop" in place of a model
        omits the step, so that a search can try without it; so does "passthrough", except in
        parallel, where it passes the drive itself. Numbers, names and slices select steps, as for a
        Pipeline.
    initial_state : {"rest", "zero", "estimate"} or None, default=None
        State before each record's first sample, which replaces that of the steps; None: that of the
        steps, which must agree.
    dt : float or None, default=None
        Sampling interval in s of data without a time index, which replaces that of the steps; None:
        that of the steps, which must agree if they have one. Steps that name the column of the
        drive must agree, too.

    Attributes
    ----------
    operators_ : dict of str to Operator
        The identified operator of each step.
    params_, params_std_ : dict
        Parameters, named ``step__parameter``, and their standard errors; without those of steps
        that are held.
    """

    _parameter_constraints = {
        **{k: v for k, v in ParametricModel._parameter_constraints.items() if k != "drive"},
        "initial_state": [*ParametricModel._parameter_constraints["initial_state"], None],
        "steps": [list],
    }
    _parallel = False
    _left_out = ("passthrough", "drop")

    def __init__(self, steps, *, initial_state=None, dt=None, method="variable_projection"):
        self.steps = steps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def named_steps(self) -> dict[str, ParametricModel]:
        """The steps by name, each as a fitted model.

        Before a fit they are unfitted, as ``steps`` always are; additive disturbances stay
        unfitted.
        """
        steps = dict(self.steps)
        if hasattr(self, "operator_"):
            stages = dict(split_disturbances(self.operator_)[0].members())
            for (name, step), model in zip(self._kept_steps(), self._models(), strict=True):
                if name in stages and not isinstance(step, FrozenEstimator):
                    steps[name] = self._fitted_step(name, model, stages[name])
        return steps

    def _sk_visual_block_(self):
        return diagram_of(self.named_steps, parallel=self._parallel)

    @property
    def operators_(self) -> dict[str, Operator]:
        """The identified operator of each step, by name."""
        driven, disturbances = split_disturbances(self.operator_)
        additive = zip(self.disturbance_names, disturbances, strict=True)
        return dict(driven.members()) | dict(additive)

    def get_params(self, deep=True) -> dict:
        """Return the parameters of the composition and, with ``deep``, those of its steps."""
        return self._get_params("steps", deep=deep)

    def set_params(self, **params) -> Self:
        """Set parameters; ``name__parameter`` reaches into a step, ``name`` replaces it."""
        self._set_params("steps", **params)
        return self

    @property
    def reads_columns(self):
        """Whether further columns of X are read."""
        return any(model.reads_columns for model in self._models())

    def operator_input(self, X, slices):
        signal, schedules = super().operator_input(X, slices)
        signals = [m.operator_input(X, slices)[0] for m in self._models() if m.reads_columns]
        # the widest one includes the amplitude of the records as last column, if a step reads it
        return max(signals, key=np.size, default=signal), schedules

    def _validate_params(self):
        super()._validate_params()
        self._check_steps()

    def record_data(self, slices, X, y):
        self._check_steps()
        return super().record_data(slices, X, y)

    def _check_steps(self):
        kind = type(self).__name__
        if not self.steps:
            raise ValueError(f"The 'steps' parameter of {kind} must not be empty.")
        self._validate_names([name for name, _ in self.steps])
        if not self._kept_steps():
            raise ValueError(
                f"The 'steps' parameter of {kind} must have a model. Got {self.steps!r} instead."
            )
        for name, step in self._kept_steps():
            model = step.estimator if isinstance(step, FrozenEstimator) else step
            if not isinstance(model, ParametricModel):
                raise TypeError(
                    f"The steps of {kind} must be parametric models of skhyst. Got {step!r} "
                    f"as '{name}' instead; 'drop' leaves a step out."
                )
            if model is not step:
                check_is_fitted(
                    model,
                    msg=f"The step '{name}' of {kind} is frozen but not fitted: fit the model "
                    "before it goes into the FrozenEstimator.",
                )
            model._validate_params()  # its `fit`, which would validate, is not called

    def _models(self):
        """Return the steps as models, those in a FrozenEstimator as held ones."""
        return [
            HeldStep(step.estimator) if isinstance(step, FrozenEstimator) else informed(step, self)
            for _, step in self._kept_steps()
        ]

    def _starting_models(self):
        """Return the steps as models with the initial state of the whole."""
        state = common_parameter(self, "initial_state")
        return [with_params(model, initial_state=state) for model in self._models()]

    def _agreed(self):
        """Return the parameters in which the steps have to agree."""
        return {key: common_parameter(self, key) for key in ("dt", "initial_state")}

    def _kept_steps(self):
        """Return the steps without those that are left out."""
        words = self._left_out
        return [pair for pair in self.steps if not (isinstance(pair[1], str) and pair[1] in words)]

    def __len__(self):
        return len(self.steps)

    def __getitem__(self, which):
        """Return a step by number or name, or a composition of some steps."""
        if not isinstance(which, slice):
            name = which if isinstance(which, str) else self.steps[which][0]
            return self.named_steps[name]
        if which.step not in (None, 1):
            raise ValueError(
                f"The step of a slice of {type(self).__name__} must be 1. Got {which.step} instead."
            )
        part = with_params(self, steps=self.steps[which])
        if not hasattr(self, "operator_"):
            return clone(part)
        part = with_params(part, **self._agreed())
        # the fitted slice: operators, disturbances and parameters of its steps, of which those of
        # the disturbances are numbered anew
        driven, disturbances = split_disturbances(self.operator_)
        names = {name for name, _ in part._kept_steps()}
        stages = [(name, stage) for name, stage in driven.members() if name in names]
        if not stages:
            raise ValueError(
                f"A slice of a fitted {type(self).__name__} must have a step that is driven. Got "
                f"{[name for name, _ in part.steps]} instead."
            )
        additive = [
            (disturbance, np.full(np.size(disturbance.coefficients), name in names))
            for name, disturbance in zip(self.disturbance_names, disturbances, strict=True)
        ]
        operator = replace(
            driven, names=tuple(n for n, _ in stages), stages=tuple(stage for _, stage in stages)
        )
        columns = np.concatenate([[], *(mask for _, mask in additive)]).astype(bool)
        others = {
            "disturbances": tuple(disturbance for disturbance, mask in additive if mask.all()),
            "record_coefficients": self._identified.record_coefficients[:, columns],
            "input_history": None,
        }
        kept = [i for i, name in enumerate(self.disturbance_names) if name in names]
        owners = {name: name for name in names}
        owners |= {f"disturbance{old}": f"disturbance{new}" for new, old in enumerate(kept)}
        parted = [(key, *key.split("__", 1)) for key in self._identified.params]
        keys = {key: f"{owners[step]}__{rest}" for key, step, rest in parted if step in owners}
        return part.adopt(_part_of(self._identified, keys, operator, columns, **others))

    @property
    def any_interval(self):
        """Whether the response to a straight drive is the same at any sampling interval."""
        return all(model.any_interval for model in self._models())

    def with_hold(self, hold):
        self._check_steps()
        held = [
            step if isinstance(step, FrozenEstimator) else step.with_hold(hold_of_step)
            for (_, step), hold_of_step in zip(self._kept_steps(), self._holds(hold), strict=True)
        ]
        if all(new is step for new, (_, step) in zip(held, self._kept_steps(), strict=True)):
            return self
        names = [name for name, _ in self._kept_steps()]
        return with_params(self, steps=list(zip(names, held, strict=True)))

    def _holds(self, hold):
        """Return the hold of each step, if that of the drive is to be chosen."""
        return [hold] * len(self._kept_steps())

    @abstractmethod
    def _compose(self, names, stages):
        """Return the operator made of stages."""

    def starting_values(self, records):
        result = self.identify(records)
        return [add_disturbances(result.operator, result.disturbances, self.disturbance_names)]

    def further_starts(self, records):
        """Return combinations of the steps' starts, each step in series with the starts before it.

        For each step, the starts whose own output fits best, up to gain and offset, are kept.

        Returns
        -------
        list of Operator
        """
        models, combinations = self._starting_models(), [([], records)]
        if self.disturbance_names or (models[0].reads_columns and not self._parallel):
            return []
        n_kept, state = max(int(_MOST_PRODUCTS ** (1.0 / len(models))), 2), self.free_run_state
        for model in models:
            longer = []
            for stages, inputs in combinations:
                starts = [(s, _behind([s], inputs, state)) for s in _driven_starts(model, inputs)]
                starts = sorted(starts, key=lambda pair: _unlike(pair[1]))[:n_kept]
                longer += [
                    ([*stages, s], inputs if self._parallel else outputs) for s, outputs in starts
                ]
            combinations = longer
        names = [name for name, _ in self._kept_steps()]
        return [self._compose(names, stages) for stages, _ in combinations]

    def in_order(self, operator, records):
        """Return an operator with similar neighbouring linear steps slowest first; see the base.

        Neighbours with the same parameters are exchangeable: their names do not distinguish them.
        """
        operator = super().in_order(operator, records)
        models, stages = dict(self._kept_steps()), dict(operator.members())
        for _, group in groupby(stages, key=lambda name: repr(models[name])):
            names = [name for name in group if hasattr(stages[name], "poles")]
            ordered = sorted(names, key=lambda name: np.abs(stages[name].poles()).min())
            if ordered != names:
                moved = [stages[name] for name in ordered]
                stages |= dict(zip(names, moved, strict=True))
        ordered = operator.with_stages(stages.values())
        return operator if ordered is operator else ordered.normalized()

    def unfitted(self, operator) -> Self:
        stages = zip(operator.names, operator.stages, strict=True)
        return with_params(self, steps=[(name, stage.unfitted()) for name, stage in stages])

    def held_parameters(self) -> frozenset[str]:
        return frozenset(
            f"{name}__{entry}"
            for (name, _), model in zip(self._kept_steps(), self._models(), strict=True)
            for entry in model.held_parameters()
        )

    def adopt(self, result):
        self._identified = result.released()
        return super().adopt(self._identified)

    def _fitted_step(self, name, model, stage):
        """Return a step fitted with its part of an identification result."""
        prefix = f"{name}__"
        keys = [key for key in self._identified.params if key.startswith(prefix)]
        keys = {key: key.removeprefix(prefix) for key in keys}
        without = {"disturbances": (), "input_history": None}
        result = _part_of(self._identified, keys, stage, **without)
        shared = self._agreed()
        of_fit = ("records_", "dt_", "_records_dt", "time_unit_")
        shared |= {key: getattr(self, key) for key in of_fit if hasattr(self, key)}
        return with_params(model, **shared).adopt(result)


def _behind(stages, records, state):
    """Return records whose drive is the output of stages."""
    for stage in stages:
        records = [
            replace(record, u=stage.run(record.u, record.dt, stage.init(record.u[0], state))[0])
            for record in records
        ]
    return records


def _part_of(result, keys, operator, columns=(), **others):
    """Return a part of an identification result, that of one or some steps.

    ``keys`` are the parameters of the part and their names in it, ``columns`` is a mask of the
    coefficients of its disturbances. The noise of a part is not known: only the response of the
    complete composition was measured.
    """
    changes = {
        field: {name: getattr(result, field).get(key) for key, name in keys.items()}
        for field in ("params", "params_std", "params_std_white")
        if getattr(result, field)
    }
    changes["undetermined"] = tuple(keys[key] for key in result.undetermined if key in keys)
    if result.joint_covariance is not None:
        rows = [list(result.params).index(key) for key in keys]
        rows += (len(result.params) + np.flatnonzero(columns)).tolist()
        changes["joint_covariance"] = result.joint_covariance[np.ix_(rows, rows)]
    return replace(result, operator=operator, noise_std=None, **changes, **others)


class Cascade(Composition):
    """Models in series, identified jointly: the output of one is the input of the next.

    The static gain and the intercept belong to one step, the hysteresis if there is one; all others
    have unit gain, since only the product can be identified. Steps are added one by one, each from
    its own data-driven starting values, then all are refined together; several linear dynamics are
    added in both orders, and the better fit is kept. In long records whose drive is sampled much
    faster than it varies, this uses every n-th sample, and the result is refined on all samples.

    For a step between two transfer functions (Wiener-Hammerstein) the product of the transfer
    functions is identified first, as if nothing were in between, and every division of its poles
    and zeros gives starting values (Sjöberg and Schoukens, *Automatica*, 2012).

    With ``hold="auto"`` the cascade is identified with either hold of the drive, and the better fit
    is kept. The first step with a ``hold`` receives the drive; signals behind it are smooth, so
    "auto" means first-order hold there.

    A step that is known already, such as a vibration mode measured at a small signal, is fitted
    first and put in a :class:`sklearn.frozen.FrozenEstimator`. All its parameters are then held,
    including gain and intercept, and the others are identified around it. With ``warm_start``, a
    later fit may start from there with all parameters free.

    Parameters
    ----------
    warm_start : bool, default=False
        Whether another ``fit`` starts from the parameters of the last one, if the steps still have
        the same names and parameters.

    Attributes
    ----------
    operator_ : Series

    Raises
    ------
    TypeError
        If a step is not a parametric model.
    NotFittedError
        If a step is held but not fitted.

    See Also
    --------
    Sum : Models in parallel.
    ScheduledParameters : A model whose parameters depend on a value per record.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Cascade
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
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
        initial_state=None,
        dt=None,
        method="variable_projection",
        warm_start=False,
    ):
        super().__init__(steps, initial_state=initial_state, dt=dt, method=method)
        self.warm_start = warm_start

    def _check_steps(self):
        super()._check_steps()
        for (name, _), model in list(zip(self._kept_steps(), self._models(), strict=True))[1:]:
            if model.reads_columns:
                raise ValueError(
                    f"The step '{name}' of Cascade reads columns of X: it must be the first."
                )

    def _holds(self, hold):
        # behind the first step with a hold the signal is smooth
        has_one = [
            any(key.split("__")[-1] == "hold" for key in model.get_params())
            for model in self._models()
        ]
        first = has_one.index(True) if any(has_one) else len(has_one)
        return [hold if i <= first else "foh" for i in range(len(has_one))]

    def _compose(self, names, stages):
        return Series(tuple(names), tuple(stages)).normalized()

    def subtree(self, driven, disturbances):
        models = zip(self._models(), driven.stages, strict=True)
        parts = tuple(model.subtree(stage, disturbances) for model, stage in models)
        specs, stages = iter(Series(driven.names, parts).entries()), []
        for stage in parts:
            held = [spec.held for _, spec in islice(specs, stage.n_parameters)]
            stages.append(_to_unit_gain(stage) if any(held) else stage)
        return replace(self._compose(driven.names, stages), model=as_node(self, steps=[]))

    def identify(self, data):
        self._check_steps()
        names = [name for name, _ in self._kept_steps()]
        if self.warm_start and list(getattr(self, "operators_", ())) == names:
            start = self._resume(self.operators_.values(), data)
            if start is not None:
                return refine(self, [start], data, self.method)
        divided = self._divided(data)
        if divided is not None:
            return divided
        thinned = None
        if self.any_interval and self.method == "variable_projection":
            thinned = thin_records(data)
        if thinned is None:
            results = [self._add_steps(data, order, self.method) for order in self._orders()]
            best = min(results, key=lambda result: result.error)
        else:
            results = [self._add_steps(thinned, order, ROUGH) for order in self._orders()]
            # structure such as the thresholds of plays comes from all samples
            distinct = _distinct(results)
            starts = [self._resume(operator.stages, data) or operator for operator in distinct]
            best = refine(self, starts, data, self.method)
            results.append(best)
        evaluations = sum(result.n_evaluations for result in results)
        return replace(best, n_evaluations=evaluations)

    def _divided(self, data):
        """Return the result for a step between two transfer functions, or None for other cascades.

        Starting values come from all divisions of the best linear approximation, see `Divisions`.
        """
        models, names = self._starting_models(), [name for name, _ in self._kept_steps()]
        if len(models) != 3 or not hasattr(models[0], "in_series_with"):
            return None
        first, middle, last = models
        whole, records = first.in_series_with(last), first_parts(data)
        if whole is None or any(s.signal_linear for s in _driven_starts(middle, records)):
            return None
        starts = whole.starting_values(records)
        linear = refine(whole, starts, records, ROUGH, with_errors=False)

        def fitting(parts):
            adapted = [m.adapted(part) for m, part in zip((first, last), parts, strict=True)]
            return None if None in adapted else adapted

        divisions = Divisions(linear.operator, records, self.free_run_state, fitting=fitting)
        in_between = divisions.started(lambda behind: _driven_starts(middle, behind))
        starts = [self._compose(names, stages) for _, stages in in_between]
        if not starts:
            return None
        result = refine(self, starts, records, ROUGH, with_errors=False)
        evaluations = linear.n_evaluations + result.n_evaluations
        # the input of the step depends on the present parts, so it starts again on all samples
        for method in (ROUGH, self.method):
            start = self._resume(result.operator.stages, data) or result.operator
            result = refine(self, [start], data, method, with_errors=method is self.method)
            evaluations += result.n_evaluations
        return replace(result, n_evaluations=evaluations)

    def _resume(self, stages, data):
        """Return the operator with the structure for the records and the values of given stages.

        None if the steps have other parameters than the stages, or are compositions.
        """
        resumed, records, state = [], data, self.free_run_state
        for stage, model in zip(stages, self._starting_models(), strict=True):
            if isinstance(model, Cascade) and isinstance(stage, Series):
                stage = model._resume(stage.stages, records)
            elif isinstance(model, HeldStep):
                [stage] = model.starting_values(records)
            elif not isinstance(model, Composition):
                starts = [split_disturbances(start)[0] for start in model.starting_values(records)]
                # of starts with the same entries, one with the same direction (sign) as the stage
                starts = [start for start in starts if start.entries() == stage.entries()]
                stage = _to_unit_gain(starts[0].unpack(stage.pack())) if starts else None
            else:
                stage = None
            if stage is None:
                return None
            resumed.append(stage)
            records = _behind([stage], records, state)
        return self._compose([name for name, _ in self._kept_steps()], resumed)

    def _orders(self):
        """Return the orders in which steps are added, each without the steps that are held.

        Three are tried. As given. With the dynamics from the last to the first: dynamics that are
        added first take over the effect of those that are missing, and the fit may stay in that
        optimum. With the limits of the drive and the delays, which precede a hysteresis, added
        last: before the other steps have a gain, they explain nothing.
        """
        models = self._models()
        given = [i for i, model in enumerate(models) if not isinstance(model, HeldStep)]
        dynamics = [i for i in given if models[i].stage_order == _DYNAMICS]
        dynamics = [i for i in dynamics if not models[i].reads_columns]  # those have to be first
        reversed_dynamics = dict(zip(dynamics, reversed(dynamics), strict=True))
        backwards = [reversed_dynamics.get(i, i) for i in given]
        limits_last = sorted(given, key=lambda i: models[i].stage_order < _HYSTERESIS)
        orders = [given, backwards, limits_last]
        return [order for k, order in enumerate(orders) if order not in orders[:k]]

    def identified_otherwise(self, data, starts):
        """Yield results of further orders, of joint starts of all steps, and of backward starts.

        In one of the orders a step is added last: the cascade then fits at least as well as without
        this step. There is nothing to combine where the second of two steps alone has parameters
        that are searched: its starts were tried with the first step, whose structure, such as the
        thresholds of plays, is that of the drive.
        """
        models, usual = self._models(), self._orders()
        free = [i for i, model in enumerate(models) if not isinstance(model, HeldStep)]
        for order in islice(permutations(free), _MOST_ORDERS):
            is_possible = order[0] == 0 or not models[0].reads_columns  # those have to be first
            if is_possible and list(order) not in usual:
                yield self._add_steps(data, order, self.method)
        products, (first, *others) = starts(), self._kept_steps()
        if products and not (len(others) == 1 and first[0] not in self._searched(products[0])):
            yield refine(self, products, data, self.method)
        yield from self._fitted_to_last_input(data)

    def _searched(self, operator):
        """Return the names of the steps with free entries that are not solved exactly."""
        held = self.held_parameters()
        specs = ((n, s) for n, s in operator.entries() if n not in held)
        return {name.split("__", 1)[0] for name, s in specs if not (s.linear or s.held)}

    def _fitted_to_last_input(self, data):
        """Yield results whose other steps are first fitted to the input of the last step.

        Only of a step whose output turns where its input does not, as that of a fold: its operator
        has ``unfolded(y)``, which returns an input (n_samples,) that gives the output.
        """
        names = [name for name, _ in self._kept_steps()]
        for last in _driven_starts(self._models()[-1], data) if len(names) > 1 else ():
            if not hasattr(last, "unfolded"):
                return
            inputs = [last.unfolded(record.y) for record in data]
            records = [replace(record, y=y) for record, y in zip(data, inputs, strict=True)]
            others = with_params(self, steps=self._kept_steps()[:-1])
            before = others._add_steps(records, others._orders()[0], ROUGH)
            start = self._compose(names, [*before.operator.stages, last])
            result = refine(self, [start], data, self.method)
            yield replace(result, n_evaluations=before.n_evaluations + result.n_evaluations)

    def _add_steps(self, data, order, method):
        """Add the steps in an order, each behind those before it; refine after each one."""
        steps, models = self._kept_steps(), self._starting_models()
        stages, evaluations, result, state = {}, 0, None, self.free_run_state
        for i, model in enumerate(models):
            if isinstance(model, HeldStep):
                [stages[i]] = model.starting_values(data)
        for i in order or [0]:
            places = sorted({*stages, i})
            if i and models[0].reads_columns and 0 in stages:
                stages[0] = _unbiased(stages[0])
            records = _behind([stages[j] for j in places if j < i], data, state)
            names = [steps[j][0] for j in places]
            candidates = [
                self._compose(names, [(stages | {i: operator})[j] for j in places])
                for operator, additive in map(
                    split_disturbances, models[i].starting_values(records)
                )
                if not additive
            ]
            if not candidates:
                raise ValueError(
                    f"The step '{names[places.index(i)]}' of Cascade is a disturbance, which adds "
                    "to the response of a model: use a Sum."
                )
            last = len(names) == len(steps)
            options = {"method": method if last else ROUGH, "with_errors": last}
            result = refine(self, candidates, data, **options)
            stages = dict(zip(places, result.operator.stages, strict=True))
            evaluations += result.n_evaluations
        return replace(result, n_evaluations=evaluations)


def _unlike(records):
    """Return the fraction of the response's variance that a line through the drive leaves."""
    u, y = (np.concatenate([getattr(r, name) for r in records]) for name in ("u", "y"))
    u, y = u - u.mean(), y - y.mean()
    power = (u @ u) * (y @ y)
    return 1.0 - (u @ y) ** 2 / power if power > 0.0 else 1.0


def _driven_starts(model, records):
    return [driven for driven, _ in map(split_disturbances, model.starting_values(records))]


def _distinct(results):
    """Return the best operator, and those of about the same error with other parameters."""
    results = sorted(results, key=lambda result: result.error)
    best = results[0]
    of_best = best.params.values(), best.params_std_white.values()
    values, std = (np.array(list(part)) for part in of_best)
    operators = [best.operator]
    for other in results[1:]:
        apart = np.abs(np.array(list(other.params.values())) - values) > std
        if other.error < _CLEARLY * best.error and apart.any():
            operators.append(other.operator)
    return operators


def _to_unit_gain(stage):
    """Return a stage with unit static gain, since another stage will take its gain over."""
    values, specs = stage.pack(), [spec for _, spec in stage.entries()]
    gains = [i for i, spec in enumerate(specs) if spec.gauge == 1.0]
    if len(gains) != 1 or stage.owns_gain or values[gains[0]] == 0.0:
        return stage
    gain = values[gains[0]]
    # if the gain is linear, the other linear values are in units of the response too
    scaled = [spec.linear and specs[gains[0]].linear for spec in specs]
    values = np.where(scaled, values / gain, values)
    values[gains[0]] = 1.0
    return stage.unpack(values)


def _unbiased(stage):
    """Return a linear sum with its first branch at unit gain and the others at zero.

    While later stages are missing, the other branches would be fitted to their effects.
    """
    specs = [spec for _, spec in stage.entries()]
    gains = [spec.gauge == 1.0 and spec.movable for spec in specs]
    if not stage.signal_linear or sum(gains) != 1:
        return stage
    linear = [spec.linear for spec in specs]
    return stage.unpack(np.where(gains, 1.0, np.where(linear, 0.0, stage.pack())))


def thin_records(records):
    """Return records with every n-th sample, about ``_ENOUGH`` in all, or None if not worthwhile.

    The response is exact at the samples that are kept, however fast it varies between them. The
    drive must not change: a record is thinned only as far as straight lines between the kept
    samples reproduce it.
    """
    total = sum(len(record.u) for record in records)
    if total < _LONG or any(len(record.segments) > 1 for record in records):
        return None
    thinned = [_thin(record, total // _ENOUGH) for record in records]
    return thinned if 2 * sum(len(record.u) for record in thinned) <= total else None


def _thin(record, step):
    while step > 1:
        kept = record.u[::step]
        covered = (len(kept) - 1) * step + 1
        lines = np.interp(np.arange(covered), np.arange(0, covered, step), kept)
        change = np.sqrt(np.mean(np.square(record.u[:covered] - lines)))
        if len(kept) > 1 and change <= _CHANGE * record.u.std():
            weights = None if record.weights is None else record.weights[::step]
            fields = {"u": kept, "y": record.y[::step], "dt": step * record.dt, "weights": weights}
            return replace(record, segments=(), **fields)
        step //= 2
    return record
