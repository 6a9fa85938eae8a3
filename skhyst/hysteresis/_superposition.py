"""What the weighted sums of plays, stops, relays or ramps share."""

import dataclasses

import numpy as np

from ..operators import Operator

__all__ = ["Superposition", "as_constant"]


def as_constant(values):
    """Return a read-only copy: kernels are compiled once for each kind of array."""
    constant = np.array(values, dtype=float, ndmin=1)
    constant.flags.writeable = False
    return constant


class Superposition(Operator):
    """Base of the sums: array fields are read-only, and weights free unless ``non_negative``."""

    carries_scale = True
    rank = 10

    def __post_init__(self):
        for field in dataclasses.fields(self):
            if field.type is np.ndarray:
                object.__setattr__(self, field.name, as_constant(getattr(self, field.name)))

    def __reduce__(self):  # without the tables that are derived from the fields
        fields = dataclasses.fields(self)
        return type(self), tuple(getattr(self, field.name) for field in fields)

    def parameter_specs(self):
        """Return the identifiable fields; the weights have a bound if ``non_negative``."""
        specs = super().parameter_specs()
        if not self.non_negative:
            for name, spec in specs.items():
                if spec.linear and spec.lower == 0.0:
                    specs[name] = dataclasses.replace(spec, lower=-np.inf)
        return specs
