"""Series and sums of operators, which are operators again, and operators held in them."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import attrgetter

import numpy as np
from scipy.linalg import block_diag

from ..records import Units
from ._compiled_step import CompiledLaw, CompiledSeries, CompiledSum, nothing
from ._linear_inverse import InverseLinearOperator
from ._protocol import Operator
from ._root_inverse import RootInverseOperator, inverse_of

_DRIVEN = "model"  # name of the driven part, where something stands beside it


class _ByEntries(Operator):
    """An operator that is told by its entries, not by fields of its own."""

    def parameter_specs(self):
        return dict(self.entries())

    def sizes(self):
        return {name: 1 for name, _ in self.entries()}


class WrappedOperator(_ByEntries):
    """Base of what wraps one operator, the field ``operator``, and is like it by default.

    A subclass with entries of its own says in ``_marks`` what becomes of a mask over those of the
    operator.
    """

    @property
    def _like(self):
        return self.operator

    def _marks(self, mask):
        return mask

    def unpack(self, vector):
        return replace(self, operator=self.operator.unpack(vector))

    def at(self, schedule):
        return replace(self, operator=self.operator.at(schedule))

    def init(self, u0, initial_state="rest"):
        return self.operator.init(u0, initial_state)

    def run(self, u, dt, state=None):
        return self.operator.run(u, dt, state)

    def compiled_step(self, dt, state):
        return self.operator.compiled_step(dt, state)

    def inverse(self):
        return inverse_of(self.operator)


# what is declared of the operator within holds for the whole, attributes and methods alike
for _name in (
    *("signal_linear", "owns_gain", "stage_order", "n_poles", "memoryless", "causal", "at_once"),
    *("n_ringing", "lag_rates", "linear_mode", "presliding_displacement", "characteristics"),
    *("entries", "pack", "parameter_units"),
):
    setattr(WrappedOperator, _name, property(attrgetter(f"_like.{_name}")))
for _name in ("linear_mask", "gauge_entries", "gauge_mask", "constant_mask"):
    setattr(
        WrappedOperator, _name, lambda self, name=_name: self._marks(getattr(self._like, name)())
    )


@dataclass(frozen=True)
class FrozenOperator(WrappedOperator):
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
    owns_gain = False

    def entries(self):
        return []

    def pack(self):
        return np.empty(0)

    def unpack(self, vector):
        return self

    def _marks(self, mask):
        return mask[:0]

    def sensitivities(self, u, du, dt, initial_state="rest"):
        return self.operator.propagate(u, du, dt, initial_state)


@dataclass(frozen=True)
class _Composition(_ByEntries):
    names: tuple
    stages: tuple

    @property
    def signal_linear(self):
        return all(stage.signal_linear for stage in self.stages)

    @property
    def owns_gain(self):
        return any(stage.owns_gain for stage in self.stages)

    @property
    def memoryless(self):
        return all(stage.memoryless for stage in self.stages)

    @property
    def causal(self):
        return all(stage.causal for stage in self.stages)

    @property
    def at_once(self):
        return all(stage.at_once for stage in self.stages)

    @property
    def stage_order(self):
        return max((stage.stage_order for stage in self.stages), default=Operator.stage_order)

    @property
    def n_poles(self):
        counts = [stage.n_poles for stage in self.stages]
        return sum(real for real, _ in counts), sum(pairs for _, pairs in counts)

    def n_ringing(self):
        return sum(stage.n_ringing() for stage in self.stages)

    def lag_rates(self):
        return [rate for stage in self.stages for rate in stage.lag_rates()]

    def linear_mode(self):
        return self.stages[0].linear_mode() if len(self.stages) == 1 else None

    @property
    def presliding_displacement(self):
        ways = (stage.presliding_displacement for stage in self.stages)
        return next((way for way in ways if way is not None), None)

    def entries(self):
        return [
            (f"{name}__{entry}", spec)
            for name, stage in zip(self.names, self.stages, strict=True)
            for entry, spec in stage.entries()
        ]

    def parameter_units(self):
        return {
            f"{name}__{entry}": unit
            for name, stage in zip(self.names, self._stage_units(), strict=True)
            for entry, unit in stage.items()
        }

    def _stage_units(self):
        """Return the units of each stage's entries by their names, seen from the whole."""
        return [stage.parameter_units() for stage in self.stages]

    def pack(self):
        return np.concatenate([np.empty(0), *(stage.pack() for stage in self.stages)])

    def unpack(self, vector):
        stages, start = [], 0
        for stage in self.stages:
            end = start + stage.n_parameters
            stages.append(stage.unpack(vector[start:end]))
            start = end
        return type(self)(self.names, tuple(stages))

    @cached_property
    def n_parameters(self):
        return sum([stage.n_parameters for stage in self.stages])

    def normalized(self):
        """Return a copy whose held freedoms (static gains, intercepts) stand at their gauge."""
        return self._at_gauge()

    def _at_gauge(self):
        values, entries = self.pack(), self.entries()
        for i in np.flatnonzero(self.gauge_mask()):
            values[i] = entries[i][1].gauge
        return self.unpack(values)

    def released(self):
        """Return a copy with the operators themselves in place of those that are held."""
        return type(self)(self.names, tuple(map(_released, self.stages)))

    def at(self, schedule):
        return type(self)(self.names, tuple(stage.at(schedule) for stage in self.stages))

    def gauge_entries(self):
        return _joined(stage.gauge_entries() for stage in self.stages)

    def _compiled_step(self, dt, states):
        """Return each stage's step."""
        return tuple(
            s.compiled_step(dt, state) for s, state in zip(self.stages, states, strict=True)
        )


class SeriesOperator(_Composition):
    """Operators in series: the output of one is the input of the next."""

    def linear_mask(self):
        # Parameters of one stage only, behind which everything is linear in the signal; the
        # stage that has most of them. Two such stages would be bilinear.
        sizes = [stage.n_parameters for stage in self.stages]
        masks = [np.zeros(size, dtype=bool) for size in sizes]
        held = np.split(self.gauge_mask(), np.cumsum(sizes)[:-1])
        best = 0
        for i in reversed(range(len(self.stages))):
            mask = self.stages[i].linear_mask() & ~held[i]
            if mask.sum() > masks[best].sum() or i == best:
                masks[best] = np.zeros_like(masks[best])
                best, masks[i] = i, mask
            if not self.stages[i].signal_linear:
                break
        return _joined(masks)

    def constant_mask(self):
        masks = [stage.constant_mask() for stage in self.stages]
        for i in reversed(range(1, len(masks))):  # before a stage that is not linear none is left
            if not self.stages[i].signal_linear:
                masks[:i] = [np.zeros_like(mask) for mask in masks[:i]]
        return _joined(masks)

    def _owners(self):
        """Return the number of the stage that keeps gain and intercept, in a list; or none."""
        owners = [i for i, stage in enumerate(self.stages) if stage.owns_gain][:1]
        return owners or [i for i, s in enumerate(self.stages) if s.gauge_entries().any()][-1:]

    def gauge_mask(self):
        owners = self._owners()
        masks = [
            stage.gauge_mask() | (stage.gauge_entries() & (i not in owners))
            for i, stage in enumerate(self.stages)
        ]
        return _joined(masks)

    def _stage_units(self):
        # up to the stage that has the gain signals are in units of the drive, then of the response
        owner = max(self._owners(), default=len(self.stages) - 1)
        words = ["drive" if i <= owner else "response" for i in range(len(self.stages) + 1)]
        return [
            {entry: Units(*around).of(unit) for entry, unit in units.items()}
            for units, around in zip(super()._stage_units(), pairwise(words), strict=True)
        ]

    def normalized(self):
        """Return a copy whose held freedoms (static gains, intercepts) stand at their gauge.

        The stage that keeps them takes over those of the others where all are linear.
        """
        return SeriesOperator(self.names, _gathered(self.stages))._at_gauge()

    def without(self, name):
        """Return the series without a stage; linear ones take over its static gain and intercept.

        Examples
        --------
        >>> from skhyst.linear import FirstOrderLagOperator, SecondOrderModeOperator
        >>> from skhyst.operators import SeriesOperator
        >>> stages = SecondOrderModeOperator(30.0, 0.1), FirstOrderLagOperator(0.1, gain=2.0)
        >>> SeriesOperator(("mode", "lag"), stages).without("lag").stages[0].gain
        2.0
        """
        at = self.names.index(name)
        names = self.names[:at] + self.names[at + 1 :]
        return SeriesOperator(names, _gathered(self.stages, without=at))

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

    def compiled_step(self, dt, state):
        return CompiledSeries(self._compiled_step(dt, state))

    def ahead(self, dt, u0, tol=1e-9):
        """Return the stages' steps and the sum of their samples; see the base."""
        compiled_step, samples = [], 0
        for stage in self.stages:
            own, later = stage.ahead(dt, u0, tol)
            compiled_step.append(own)
            samples += later
            u0 = stage.run(np.array([u0]), dt)[0][0]
        return CompiledSeries(tuple(compiled_step)), samples

    def inverse(self):
        """Return the series of the inverses, last stage first."""
        return SeriesOperator(self.names[::-1], tuple(map(inverse_of, reversed(self.stages))))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        for stage in self.stages:
            u, du = stage.sensitivities(u, du, dt, initial_state)
        return u, du

    def propagate(self, u, du, dt, initial_state="rest"):
        for stage in self.stages:
            u, du = stage.propagate(u, du, dt, initial_state)
        return u, du


class SumOperator(_Composition):
    """Operators in parallel: their outputs are added."""

    def linear_mask(self):
        return _joined(stage.linear_mask() for stage in self.stages)

    def constant_mask(self):
        return _joined(stage.constant_mask() for stage in self.stages)

    def gauge_entries(self):
        # a common gain can be taken out of the first branch only
        masks = [
            stage.gauge_entries() & (Operator.constant_mask(stage) | (i == 0))
            for i, stage in enumerate(self.stages)
        ]
        return _joined(masks)

    def gauge_mask(self):
        # several intercepts add up to one: the first branch that has one keeps it
        masks, taken = [], False
        for stage in self.stages:
            mask = stage.gauge_mask()
            intercept = Operator.constant_mask(stage)
            masks.append(mask | (intercept & taken))
            taken = taken or bool((intercept & ~mask).any())
        return _joined(masks)

    def init(self, u0, initial_state="rest"):
        return tuple(stage.init(u0, initial_state) for stage in self.stages)

    def run(self, u, dt, state=None):
        states, total = [], np.zeros(len(u))
        for stage, old in zip(self.stages, state or [None] * len(self.stages), strict=True):
            y, new = stage.run(u, dt, old)
            total += y
            states.append(new)
        return total, tuple(states)

    @property
    def intercept(self):
        """Sum of those of the parts, where all are linear."""
        return sum(stage.intercept for stage in self.stages)

    def discrete(self, dt):
        """Return the matrices of the parts side by side; see ``LinearOperator.discrete``."""
        ad, b0, b1, c, d = zip(*(stage.discrete(dt) for stage in self.stages), strict=True)
        return block_diag(*ad), *map(np.concatenate, (b0, b1, c)), sum(d)

    def inverse(self):
        """Return the inverse of the sum, which looks ahead where all parts are linear."""
        if not self.stages:
            raise ValueError("A sum of nothing has no inverse.")
        is_linear = all(hasattr(stage, "discrete") for stage in self.stages)
        return InverseLinearOperator(self) if is_linear else RootInverseOperator(self)

    def compiled_step(self, dt, state):
        return CompiledSum(self._compiled_step(dt, state) or (CompiledLaw(nothing, (), ()),))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        total, carried, own = np.zeros(len(u)), np.zeros_like(du), []
        for stage in self.stages:
            y, dy = stage.sensitivities(u, du, dt, initial_state)
            total += y
            carried += dy[:, : du.shape[1]]
            own.append(dy[:, du.shape[1] :])
        return total, np.concatenate([carried, *own], axis=1)


def _joined(masks):
    return np.concatenate([np.empty(0, bool), *masks])


def _gathered(stages, without=None):
    """Return the stages, or all but one, with static gain and intercept on the last linear one.

    Nothing moves where a stage carries a scale of its own or is no linear one.
    """
    kept = [i for i in range(len(stages)) if i != without]
    scaled = [i for i, stage in enumerate(stages) if _may_give_or_take(stage)]
    between = stages[scaled[0] : scaled[-1] + 1] if scaled else ()
    if (
        not set(scaled) & set(kept)
        or any(stage.owns_gain for stage in stages)
        or not all(stage.signal_linear for stage in between)
        or not all({"gain", "intercept"} <= set(stages[i].sizes()) for i in scaled)
    ):
        return tuple(stages[i] for i in kept)
    owner = max(set(scaled) & set(kept))
    gain, intercept = 1.0, 0.0
    for i in scaled:
        gain *= stages[i].gain
        intercept = stages[i].gain * intercept + stages[i].intercept
    own = dict.fromkeys(scaled, (1.0, 0.0)) | {owner: (gain, intercept)}
    return tuple(_with_gain(stages[i], *own[i]) if i in own else stages[i] for i in kept)


def _may_give_or_take(stage):
    """Whether a stage has a gain or an intercept, unless it is a sum that has none of its own."""
    mask, entries = stage.gauge_entries(), stage.entries()
    gauges = [spec.gauge for (_, spec), own in zip(entries, mask, strict=True) if own]
    is_bare = isinstance(stage, SumOperator) and stage.pack()[mask].tolist() == gauges
    return bool(gauges) and not is_bare


def _with_gain(stage, gain, intercept):
    """Return a linear stage of the same shape with another static gain and intercept."""
    specs = stage.parameter_specs()
    if stage.gain and specs["gain"].linear:  # then all that is linear has units of the response
        linear = [spec.linear for _, spec in stage.entries()]
        stage = stage.unpack(np.where(linear, gain / stage.gain, 1.0) * stage.pack())
    return replace(stage, gain=gain, intercept=intercept)


def add_disturbances(operator, disturbances, names=None):
    """Return the sum of a driven operator and of what stands beside it, by default unnamed."""
    if not disturbances:
        return operator
    names = names or tuple(f"disturbance{i}" for i in range(len(disturbances)))
    return SumOperator((_DRIVEN, *names), (operator, *disturbances))


def split_disturbances(start):
    """Return the driven part of an operator, and a tuple of what stands beside it.

    Parameters
    ----------
    start : Operator or tuple of (Operator, tuple of Operator)
        A pair is returned as it is.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.disturbance import OffsetOperator
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import SumOperator, split_disturbances
    >>> total = SumOperator(("gain", "offset"), (GainOperator(2.0), OffsetOperator(np.zeros(1))))
    >>> driven, beside = split_disturbances(total)
    >>> driven.names, len(beside)
    (('gain',), 1)
    """
    if isinstance(start, tuple):
        return start
    if start.is_disturbance:
        return SumOperator((), ()), (start,)
    stages = start.stages if isinstance(start, SumOperator) else ()
    others = tuple(stage for stage in stages if stage.is_disturbance)
    if not others:
        return start, ()
    pairs = zip(start.names, stages, strict=True)
    driven = {name: stage for name, stage in pairs if not stage.is_disturbance}
    if tuple(driven) == (_DRIVEN,):
        return driven[_DRIVEN], others
    return SumOperator(tuple(driven), tuple(driven.values())), others


def _released(operator):
    if isinstance(operator, FrozenOperator):
        operator = operator.operator
    return operator.released() if isinstance(operator, _Composition) else operator
