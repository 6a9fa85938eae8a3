"""Series and sums of operators, which are operators again, and operators held in them."""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from ._protocol import Operator

__all__ = [
    "FrozenOperator",
    "SeriesOperator",
    "SumOperator",
]


@dataclass(frozen=True)
class FrozenOperator(Operator):
    """An operator whose parameters are known: none of them is identified.

    In a series it keeps its own gain and intercept, and does not carry those of the others.

    Parameters
    ----------
    operator : Operator

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLagOperator
    >>> from skhyst.operators import FrozenOperator
    >>> lag = FirstOrderLagOperator(0.03, gain=1.4)
    >>> lag.n_parameters, FrozenOperator(lag).n_parameters
    (3, 0)
    """

    operator: Operator

    @property
    def signal_linear(self):
        return self.operator.signal_linear

    @property
    def rank(self):
        return self.operator.rank

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(u, dt, state)

    def linearize(self, u, du, dt, initial_state="rest"):
        return self.operator.carry(u, du, dt, initial_state)


@dataclass(frozen=True)
class _Composition(Operator):
    names: tuple
    stages: tuple

    @property
    def signal_linear(self):
        return all(stage.signal_linear for stage in self.stages)

    @property
    def carries_scale(self):
        return any(stage.carries_scale for stage in self.stages)

    @property
    def rank(self):
        return max(stage.rank for stage in self.stages)

    def parameter_specs(self):
        return dict(self.entries())

    def entries(self):
        return [
            (f"{name}__{entry}", spec)
            for name, stage in zip(self.names, self.stages, strict=True)
            for entry, spec in stage.entries()
        ]

    def sizes(self):
        return dict.fromkeys((name for name, _ in self.entries()), 1)

    def pack(self):
        return np.concatenate([np.empty(0), *(stage.pack() for stage in self.stages)])

    def unpack(self, vector):
        return type(self)(
            self.names,
            tuple(
                stage.unpack(part)
                for stage, part in zip(self.stages, self._split(vector), strict=True)
            ),
        )

    @property
    def n_parameters(self):
        return sum(stage.n_parameters for stage in self.stages)

    def _split(self, vector):
        sizes = [stage.n_parameters for stage in self.stages]
        return [
            vector[end - size : end] for size, end in zip(sizes, accumulate(sizes), strict=True)
        ]

    def normalized(self):
        """Return a copy whose held freedoms (static gains, intercepts) stand at their gauge."""
        values, entries = self.pack(), self.entries()
        for i in np.flatnonzero(self.gauge_mask()):
            values[i] = entries[i][1].gauge
        return self.unpack(values)

    def released(self):
        """Return a copy with the operators themselves in place of those that are held."""
        return type(self)(self.names, tuple(map(_released, self.stages)))

    def at(self, schedule):
        return type(self)(self.names, tuple(stage.at(schedule) for stage in self.stages))

    def init(self, u0, initial_state="rest"):
        raise NotImplementedError


class SeriesOperator(_Composition):
    """Operators in series: the output of one is the input of the next."""

    def linear_mask(self):
        # Parameters of one stage only, behind which everything is linear in the signal; the
        # stage that has most of them. Two such stages would be bilinear.
        masks = [np.zeros(stage.n_parameters, dtype=bool) for stage in self.stages]
        best = 0
        for i in reversed(range(len(self.stages))):
            mask = self.stages[i].linear_mask() & ~self.stages[i].gauge_mask()
            if mask.sum() > masks[best].sum() or i == best:
                masks[best] = np.zeros_like(masks[best])
                best, masks[i] = i, mask
            if not self.stages[i].signal_linear:
                break
        return np.concatenate(masks)

    def gauge_entries(self):
        return np.concatenate([np.empty(0, bool), *(s.gauge_entries() for s in self.stages)])

    def gauge_mask(self):
        gauges = [stage.gauge_entries() for stage in self.stages]
        owners = [i for i, stage in enumerate(self.stages) if stage.carries_scale][:1]
        owners = owners or [i for i, gauge in enumerate(gauges) if gauge.any()][-1:]
        masks = [
            stage.gauge_mask() | (gauge & (i not in owners))
            for i, (stage, gauge) in enumerate(zip(self.stages, gauges, strict=True))
        ]
        return np.concatenate([np.empty(0, bool), *masks])

    def init(self, u0, initial_state="rest"):
        states = []
        for stage in self.stages:
            state = stage.init(u0, initial_state)
            states.append(state)
            # the output at rest is the rest input of the next stage; the interval is immaterial
            u0 = stage.run(np.array([u0], dtype=float), 1.0, state)[0][0]
        return tuple(states)

    def run(self, u, dt, state=None):
        states = []
        for stage, old in zip(self.stages, state or [None] * len(self.stages), strict=True):
            u, new = stage.run(u, dt, old)
            states.append(new)
        return u, tuple(states)

    def inverse(self):
        """Return the series of the inverses, last stage first."""
        return SeriesOperator(
            self.names[::-1], tuple(stage.inverse() for stage in reversed(self.stages))
        )

    def linearize(self, u, du, dt, initial_state="rest"):
        for stage in self.stages:
            u, du = stage.linearize(u, du, dt, initial_state)
        return u, du

    def carry(self, u, du, dt, initial_state="rest"):
        for stage in self.stages:
            u, du = stage.carry(u, du, dt, initial_state)
        return u, du


class SumOperator(_Composition):
    """Operators in parallel: their outputs are added."""

    def linear_mask(self):
        return np.concatenate([np.empty(0, bool), *(s.linear_mask() for s in self.stages)])

    def gauge_entries(self):
        # a common gain can be taken out of the first branch only
        masks = [
            stage.gauge_entries() & (_is_intercept(stage) | (i == 0))
            for i, stage in enumerate(self.stages)
        ]
        return np.concatenate([np.empty(0, bool), *masks])

    def gauge_mask(self):
        # several intercepts add up to one: the first branch that has one keeps it
        masks, taken = [np.empty(0, bool)], False
        for stage in self.stages:
            mask = stage.gauge_mask()
            intercept = _is_intercept(stage)
            masks.append(mask | (intercept & taken))
            taken = taken or bool((intercept & ~mask).any())
        return np.concatenate(masks)

    def init(self, u0, initial_state="rest"):
        return tuple(stage.init(u0, initial_state) for stage in self.stages)

    def run(self, u, dt, state=None):
        states, total = [], np.zeros(len(u))
        for stage, old in zip(self.stages, state or [None] * len(self.stages), strict=True):
            y, new = stage.run(u, dt, old)
            total += y
            states.append(new)
        return total, tuple(states)

    def linearize(self, u, du, dt, initial_state="rest"):
        total, carried, own = np.zeros(len(u)), np.zeros_like(du), []
        for stage in self.stages:
            y, dy = stage.linearize(u, du, dt, initial_state)
            total += y
            carried += dy[:, : du.shape[1]]
            own.append(dy[:, du.shape[1] :])
        return total, np.concatenate([carried, *own], axis=1)


def _released(operator):
    if isinstance(operator, FrozenOperator):
        operator = operator.operator
    return operator.released() if isinstance(operator, _Composition) else operator


def _is_intercept(operator):
    return np.array([spec.gauge == 0.0 for _, spec in operator.entries()], dtype=bool)
