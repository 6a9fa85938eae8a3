"""What series and sums of models share."""

from abc import abstractmethod

from .._sklearn import BaseComposition
from ..base import ParametricModel

__all__ = ["Composition"]


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

    def _check_steps(self):
        kind = type(self).__name__
        if not self.steps:
            raise ValueError(f"The 'steps' parameter of {kind} must not be empty.")
        self._validate_names([name for name, _ in self.steps])
        for name, step in self.steps:
            if not isinstance(step, ParametricModel):
                raise TypeError(
                    f"The steps of {kind} must be parametric models of skhyst. Got {step!r} "
                    f"as '{name}' instead."
                )

    @abstractmethod
    def _compose(self, names, stages):
        """Return the operator made of stages."""

    def _starts(self, records):
        result = self._identify(records)
        return [(result.operator, result.disturbances)]

    def _fixed(self):
        return frozenset(f"{name}__{entry}" for name, step in self.steps for entry in step._fixed())
