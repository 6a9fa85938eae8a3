"""What series and sums of models share."""

import dataclasses
from abc import abstractmethod

import numpy as np
from sklearn.frozen import FrozenEstimator
from sklearn.utils.validation import check_is_fitted

from .._sklearn import BaseComposition
from ..base import ParametricModel
from ..operators import FrozenOperator

__all__ = ["Composition", "HeldStep"]


class HeldStep(ParametricModel):
    """A fitted model as a step, held: it starts and ends as the operator that it has."""

    initial_state = "rest"

    def __init__(self, model):
        self.model = model

    @property
    def series_rank(self):
        return self.model.series_rank

    @property
    def _any_interval(self):
        return self.model._any_interval

    def starting_values(self, records):
        return [(FrozenOperator(self.model.operator_), ())]


class Composition(ParametricModel, BaseComposition):
    """Base of the compositions: named steps, whose parameters are ``name__parameter``."""

    _parameter_constraints = {**ParametricModel._parameter_constraints, "steps": [list]}

    def __init__(self, steps, *, initial_state="rest", dt=1.0, method="variable_projection"):
        self.steps = steps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    @property
    def named_steps(self):
        """The steps by name, unfitted: their parameters as given."""
        return dict(self.steps)

    @property
    def operators_(self):
        """The identified operator of each step, by name."""
        operator = self.operator_
        return dict(zip(operator.names, operator.stages, strict=True))

    def get_params(self, deep=True):
        """Return the parameters of the composition and, with ``deep``, those of its steps."""
        return self._get_params("steps", deep=deep)

    def set_params(self, **params):
        """Set parameters; ``name__parameter`` reaches into a step, ``name`` replaces it."""
        self._set_params("steps", **params)
        return self

    @property
    def _reads_columns(self):
        return any(model._reads_columns for model in self._models())

    def _signal(self, X, slices):
        signals = [m._signal(X, slices) for m in self._models() if m._reads_columns]
        # with the amplitude of the records as a last column, where one reads it
        return max(signals, key=np.size) if signals else super()._signal(X, slices)

    def _record_data(self, slices, X, y):
        self._check_steps()
        return super()._record_data(slices, X, y)

    def _check_steps(self):
        kind = type(self).__name__
        if not self.steps:
            raise ValueError(f"The 'steps' parameter of {kind} must not be empty.")
        self._validate_names([name for name, _ in self.steps])
        for name, step in self.steps:
            model = step.estimator if isinstance(step, FrozenEstimator) else step
            if not isinstance(model, ParametricModel):
                raise TypeError(
                    f"The steps of {kind} must be parametric models of skhyst. Got {step!r} "
                    f"as '{name}' instead."
                )
            if model is not step:
                check_is_fitted(
                    model,
                    msg=f"The step '{name}' of {kind} is frozen but not fitted: fit the model "
                    "before it goes into the FrozenEstimator.",
                )

    def _models(self):
        """Return the steps as models, those in a FrozenEstimator as held ones."""
        return [
            HeldStep(step.estimator) if isinstance(step, FrozenEstimator) else step
            for _, step in self.steps
        ]

    @property
    def _any_interval(self):
        return all(model._any_interval for model in self._models())

    @abstractmethod
    def _compose(self, names, stages):
        """Return the operator made of stages."""

    def starting_values(self, records):
        result = self._identify(records)
        return [(result.operator, result.disturbances)]

    def held_parameters(self):
        return frozenset(
            f"{name}__{entry}"
            for (name, _), model in zip(self.steps, self._models(), strict=True)
            for entry in model.held_parameters()
        )

    def _adopt(self, result):
        return super()._adopt(dataclasses.replace(result, operator=result.operator.released()))
