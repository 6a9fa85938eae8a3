"""A model as a list of stages, into which an effect can be put."""

import re
from dataclasses import dataclass, replace

import numpy as np
from sklearn.base import clone
from sklearn.frozen import FrozenEstimator

from ..compose import Cascade, Sum
from ..operators import SeriesOperator, SumOperator
from ..optimize import OperatorProblem, identify

__all__ = ["Structure"]


@dataclass(frozen=True)
class Structure:
    """Stages in series and disturbances beside them, unfitted models and operators alike.

    Attributes
    ----------
    names, models, operators : tuple
        Of the stages, in the order of the signal.
    beside_names, beside_models, disturbances : tuple
        Of what is added to the response.
    state : {"rest", "zero"}
        State before each record.
    """

    names: tuple
    models: tuple
    operators: tuple
    beside_names: tuple = ()
    beside_models: tuple = ()
    disturbances: tuple = ()
    state: str = "rest"

    @classmethod
    def from_result(cls, estimator, result):
        """Take apart a declared model and what identification found for it."""
        state = estimator._free_run_state()
        if isinstance(estimator, Cascade):
            names, models = zip(*estimator.steps, strict=True)
            return cls(names, models, result.operator.stages, state=state)
        name = snake_case(type(estimator).__name__)
        beside = tuple(f"{name}_disturbance{i}" for i in range(len(result.disturbances)))
        return cls(
            (name,),
            (estimator,),
            (result.operator,),
            beside,
            (None,) * len(beside),
            result.disturbances,
            state,
        )

    def series(self):
        """Return the driven part as one operator."""
        return SeriesOperator(self.names, self.operators).normalized()

    def problem(self, records):
        """Return the least-squares problem of all free parameters."""
        fixed = {
            f"{name}__{entry}"
            for name, model in zip(self.names, self.models, strict=True)
            for entry in model._fixed()
        }
        return OperatorProblem(
            self.series(),
            records,
            disturbances=self.disturbances,
            fixed=fixed,
            initial_state=self.state,
        )

    def at(self, problem, x):
        """Return the structure with the operators at ``x``."""
        series, disturbances = problem.unpack(x)
        return replace(self, operators=series.stages, disturbances=disturbances)

    def position(self, rank):
        """Return where in the series a stage of this rank goes."""
        behind = [i + 1 for i, stage in enumerate(self.operators) if stage.rank <= rank]
        return max(behind, default=0)

    def insert(self, name, model, operator):
        """Return the structure with one more stage."""
        at = self.position(model._rank)
        return replace(
            self,
            names=(*self.names[:at], name, *self.names[at:]),
            models=(*self.models[:at], model, *self.models[at:]),
            operators=(*self.operators[:at], operator, *self.operators[at:]),
        )

    def beside(self, name, model, disturbance):
        """Return the structure with one more disturbance."""
        return replace(
            self,
            beside_names=(*self.beside_names, name),
            beside_models=(*self.beside_models, model),
            disturbances=(*self.disturbances, disturbance),
        )

    def run(self, records, first=0, last=None, signals=None):
        """Return the output of a stretch of the series for each record."""
        outputs = []
        for number, record in enumerate(records):
            u = record.u if signals is None else signals[number]
            for stage in self.operators[first:last]:
                u = stage.run(u, record.dt, stage.init(u[0], self.state))[0]
            outputs.append(u)
        return outputs

    def n_coefficients(self):
        """Number of coefficients that each record has of its own."""
        return sum(np.size(disturbance.coefficients) for disturbance in self.disturbances)

    def _stands_alone(self):
        """Whether the driven part is one model without a Cascade, which one that is held needs."""
        return len(self.models) == 1 and not isinstance(self.models[0], FrozenEstimator)

    def estimator(self, declared):
        """Return the unfitted model: the declared one with what was added."""
        models = [clone(model) for model in self.models]
        if any(model is None for model in self.beside_models):
            raise ValueError(
                "A declared Sum with disturbances cannot be searched: declare the driven part."
            )
        options = {"initial_state": declared.initial_state, "dt": declared.dt}
        if self._stands_alone():
            name, driven = self.names[0], models[0]
        else:
            name = "model"
            driven = Cascade(list(zip(self.names, models, strict=True)), **options)
        if not self.beside_models:
            return driven
        beside = [(n, clone(m)) for n, m in zip(self.beside_names, self.beside_models, strict=True)]
        return Sum([(name, driven), *beside], **options)

    def fitted(self, declared, records, slices):
        """Return the model, fitted on all records from the operators here."""
        estimator = self.estimator(declared)
        operator = self.operators[0] if self._stands_alone() else self.series()
        if self.beside_models:
            operator = SumOperator((estimator.steps[0][0],), (operator,))
        result = identify(
            [(operator, self.disturbances)],
            records,
            fixed=estimator._fixed(),
            initial_state=self.state,
        )
        estimator._adopt(result)
        estimator.records_ = slices
        return estimator, result


def snake_case(name):
    """Return ``PrandtlIshlinskii`` as ``prandtl_ishlinskii``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()
