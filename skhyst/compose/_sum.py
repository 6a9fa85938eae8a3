"""Models in parallel."""

from dataclasses import replace

from sklearn.frozen import FrozenEstimator

from ..base import as_node, refine, with_params
from ..linear import Gain, GainOperator
from ..operators import Operator, SumOperator, split_disturbances
from ._cascade import Composition, HeldStep
from ._columns import FirstColumn


class Sum(Composition):
    """Models in parallel, identified jointly: their outputs are added.

    Additive disturbances (:mod:`skhyst.disturbance`) may be among them; their coefficients are
    solved record by record. With an offset or a drift, which have a constant for each record, the
    driven models have no intercept. A step that is known already is held as in a :class:`Cascade`:
    the fitted model in a :class:`sklearn.frozen.FrozenEstimator`.

    Attributes
    ----------
    operator_ : SumOperator
    record_coefficients_ : ndarray of shape (n_records, n_coefficients)
        Of the additive disturbances, if there are any.

    See Also
    --------
    Cascade : Models in series.
    OnColumn : A model driven by another column of X, to be added.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Sum
    >>> from skhyst.disturbance import Drift
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> drive = np.sin(np.linspace(0, 40, 2000))
    >>> y = 2.0 * drive + np.linspace(0, 1, 2000)
    >>> steps = [("hysteresis", PrandtlIshlinskii(5)), ("drift", Drift(degree=1))]
    >>> model = Sum(steps).fit(drive.reshape(-1, 1), y)
    >>> bool(np.allclose(model.predict(drive.reshape(-1, 1)), y))
    True
    """

    _parallel = True
    _left_out = ("drop",)

    def _kept_steps(self):
        """Return the steps that are kept; "passthrough" is a unit gain that is held."""
        passed = FrozenEstimator(with_params(Gain(), operator_=GainOperator(1.0)))
        return [(n, passed if step == "passthrough" else step) for n, step in super()._kept_steps()]

    def _models(self):
        """Return the steps as models; if one reads columns, the others read the first one."""
        models = super()._models()
        if not any(model.reads_columns for model in models):
            return models
        return [m if m.reads_columns or _is_disturbance(m) else FirstColumn(m, 0) for m in models]

    def operator_input(self, X, slices):
        signal, unscheduled = super().operator_input(X, slices)
        schedules_of_steps = [model.operator_input(X, slices)[1] for model in self._models()]
        known = [
            schedules for schedules in schedules_of_steps if any(s is not None for s in schedules)
        ]
        return signal, known[0] if known else unscheduled

    def _compose(self, names, stages):
        return SumOperator(tuple(names), tuple(stages)).normalized()

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        """Names of the steps that are additive disturbances."""
        return tuple(name for name, model in self._kept_steps() if _is_disturbance(model))

    def subtree(self, driven, disturbances):
        driven_stages, stages = iter(driven.stages), []
        for model in self._models():
            stage = None if _is_disturbance(model) else next(driven_stages)
            stages.append(model.subtree(stage, disturbances))
        names = tuple(name for name, _ in self._kept_steps())
        return SumOperator(names, tuple(stages), model=as_node(self, steps=[])).normalized()

    def identify(self, data):
        self._check_steps()
        return self._identified_from(0, data)

    def identified_otherwise(self, data, starts):
        """Yield results with each step identified first, and of joint starts of all steps.

        A step that is identified first is fitted alone: the sum then fits at least as well as this
        step.
        """
        for first in range(1, len(self._kept_steps())):
            yield self._identified_from(first, data)
        products = starts()
        if products:
            yield refine(self, products, data)

    def _identified_from(self, first, data):
        """Identify each step from the residual of those before it, then all; see `identify`."""
        state = self.free_run_state
        models = self._starting_models()
        operators, disturbances, evaluations = {}, {}, 0
        records, last = data, None

        def order(i):  # held steps are known: subtracted from the response first
            return not isinstance(models[i], HeldStep), i != first, i

        for i in sorted(range(len(models)), key=order):
            result = models[i].identify(records)
            evaluations += result.n_evaluations
            if not (_is_disturbance(models[i]) or isinstance(models[i], HeldStep)):
                last = i, records
            records = [
                replace(record, y=record.y - part)
                for record, part in zip(records, result.outputs(records, state), strict=True)
            ]
            if not _is_disturbance(models[i]):
                operators[i] = result.operator
            disturbances[i] = result.disturbances
        additive = tuple(branch for i in sorted(disturbances) for branch in disturbances[i])
        alone = len(operators) == 1 and not additive
        branches = (
            [operators] if alone or not last else [operators, *self._others(operators, *last)]
        )
        steps = self._kept_steps()
        names = [steps[i][0] for i in sorted(operators)]
        starts = [self._compose(names, [branch[i] for i in sorted(branch)]) for branch in branches]
        result = refine(self, [(start, additive) for start in starts], data)
        return replace(result, n_evaluations=evaluations + result.n_evaluations)

    def _others(self, operators, i, records):
        """Return the branches with each starting value of the last driven one, ``i``.

        The branches identified before it may have explained a part of its response, so the values
        found for their residual need not lead to the joint optimum. If it is linear in the signal,
        further starts gain little.
        """
        model = self._starting_models()[i]
        if isinstance(model, Composition) or operators[i].signal_linear:
            return []
        starts = [split_disturbances(start)[0] for start in model.starting_values(records)]
        return [operators | {i: operator} for operator in starts] if len(starts) > 1 else []


def _is_disturbance(model):
    return getattr(model, "operator_class", Operator).is_disturbance
