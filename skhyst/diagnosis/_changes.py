"""Ways for an effect to enter a model other than as one more stage of fixed rank.

Each is a variant of an effect whose ``structures`` returns the structures at its starting values,
none where it does not apply.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..compose import Sum, amplitude, is_constant
from ..fluid import TankChain
from ..hysteresis import (
    CoulombFrictionOperator,
    PrandtlIshlinskiiOperator,
    RateDependentPrandtlIshlinskii,
    RestoringForce,
)
from ..linear import (
    DynamicStiffnessOperator,
    FirstOrderLagOperator,
    GainOperator,
    LinearOperator,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from ..operators import SumOperator, take_apart
from ..optimize import VariableProjection, identify
from ._noise import FEW_TURNS, visible_turns
from ._starts import Scene, beside, inserted
from ._structure import Schedule

__all__ = [
    "BesideForce",
    "Driven",
    "FirstHysteresis",
    "InMotion",
    "InStages",
    "Knee",
    "MovedModes",
    "PerRecord",
    "RateDependence",
    "Scaled",
    "SlowerThanDrive",
    "n_ringing",
]

_SPREAD = 0.05  # of a number of the records, relative, above which parameters may depend on it
_DAMPED = float(np.sqrt(0.5))  # damping ratio from which a pair of poles has no peak
_TANKS = 3  # in a row, at the most
_BEYOND = 0.6  # of the largest response: levels of a knee start at least a tenth above it
_FULL = 0.98  # of the level of a knee, up to which the response is undone
_FIRST = 4000  # samples that starting values of tanks are improved on
_BRIEFLY = VariableProjection(tolerance=1e-3, max_evaluations=10)


def n_ringing(stages):
    """Return the number of pairs of poles that overshoot."""
    ratios = [getattr(s, "damping_ratios", getattr(s, "damping_ratio", ())) for s in stages]
    return sum(np.count_nonzero(np.asarray(own) < _DAMPED) for own in ratios)


@dataclass(frozen=True)
class SlowerThanDrive:
    """A drift, unless all records are of a loop or two, in which it could mimic anything."""

    model: object

    def structures(self, name, scene):
        moving = [r.drive for r in scene.records if np.ptp(r.drive) > 0.0]
        few = min(self.model.degree, FEW_TURNS)
        if moving and all(visible_turns(u) <= few for u in moving):
            return []
        return beside(name, self.model, scene)


@dataclass(frozen=True)
class FirstHysteresis:
    """A model with memory in the series, where none is yet."""

    model: object

    def structures(self, name, scene):
        stages = scene.structure.operators
        if any(not isinstance(s, LinearOperator) and s.carries_scale for s in stages):
            return []
        return inserted(name, self.model, scene)


@dataclass(frozen=True)
class InMotion:
    """A force in the equation of motion: a mode that the drive moves becomes a richer stage."""

    model: object

    def structures(self, name, scene):
        structure = scene.structure
        found = []
        for at, (model, operator) in enumerate(
            zip(structure.models, structure.operators, strict=True)
        ):
            if _is_moved(model, operator, self.model) and not any(
                stage.carries_scale for stage in structure.operators[:at]
            ):
                starts = self.model.starting_values(
                    scene.records_at(at), mode=_linear_part(operator)
                )
                candidates = [
                    structure.exchange(name, at, self.model, start)
                    for start, _ in map(take_apart, starts)
                ]
                found += scene.promising(candidates, at)
        return found


def _linear_part(operator):
    """Return the mode of a stage without its other forces."""
    if isinstance(operator, TransferFunctionOperator):
        frequency, damping = operator.natural_frequencies[0], operator.damping_ratios[0]
    else:
        frequency, damping = operator.natural_frequency, operator.damping_ratio
    return SecondOrderModeOperator(
        float(frequency), float(damping), operator.gain, operator.intercept
    )


def _is_moved(model, operator, richer):
    """Whether a stage is a mode, or one with fewer forces than the richer model."""
    if isinstance(operator, SecondOrderModeOperator):
        return True
    if isinstance(operator, TransferFunctionOperator):
        return operator.n_poles == (0, 1) and not np.size(operator.numerator)
    plain = isinstance(model, RestoringForce) and not model.fit_hysteresis
    return plain and isinstance(richer, RestoringForce) and richer.fit_hysteresis


@dataclass(frozen=True)
class Knee:
    """A rounded saturation of the response, fitted to which the stages before it start anew."""

    model: object

    def structures(self, name, scene):
        structure = scene.structure
        at = structure.position(self.model.series_rank)
        if at < len(structure.operators) or structure.branches or structure.modulations:
            return inserted(name, self.model, scene)
        found = []
        mirrored = [replace(r, u=r.y) for r in scene.records]
        for start, _ in map(take_apart, self.model.starting_values(mirrored)):
            reach = max(float(np.abs(r.y - start.center).max()) for r in scene.records)
            # of the levels that the response stays below
            start = replace(start, level=start.level + (reach or 1.0) * _BEYOND)
            grown = _refitted_to([_before(r, start) for r in scene.records], structure)
            found.append(grown.insert(name, self.model, start))
        return scene.promising(found, 0)


def _before(record, knee):
    """Return the record with what a knee makes its response of, as far as the response tells."""
    y = np.clip(record.y, knee.center - _FULL * knee.level, knee.center + _FULL * knee.level)
    y = knee.inverse(y)
    # an error before the knee counts as what is left of it behind
    weights = np.square(knee.linearize(y, np.ones((len(y), 1)), record.dt)[1][:, 0])
    if record.weights is not None:
        weights = weights * record.weights
    return replace(record, y=y, weights=weights)


def _refitted_to(records, structure):
    """Return the structure with its linear parameters, and no other, fitted to records."""
    problem = structure.problem(records)
    gram = problem.total(problem.evaluate(problem.x0))
    linear = np.flatnonzero(problem.linear)
    own = gram[np.ix_(linear, linear)]
    scale = np.sqrt(np.diag(own))
    scale[scale == 0.0] = 1.0
    step = np.linalg.lstsq(own / np.outer(scale, scale), gram[linear, -1] / scale, rcond=None)[0]
    x = problem.x0.copy()
    x[linear] -= step / scale
    return structure.at(problem, np.clip(x, problem.lower, problem.upper))


@dataclass(frozen=True)
class InStages:
    """First-order stages in a row become tanks, where nothing comes before them."""

    overflow: bool
    fit_exponents: bool

    def structures(self, name, scene):
        structure = scene.structure
        if scene.multi_input or any(stage.carries_scale for stage in structure.operators):
            return []
        found = []
        for at, (old, operator) in enumerate(
            zip(structure.models, structure.operators, strict=True)
        ):
            rates = _rates_of_lags(operator)
            if not rates:
                continue
            model = TankChain(
                len(rates),
                overflow=self.overflow,
                fit_exponents=self.fit_exponents,
                fit_intercept=old.fit_intercept,
                hold=old.hold,
                initial_state=old.initial_state,
                dt=old.dt,
            )
            records = scene.records_at(at)
            starts = model.starts_of(rates, records)
            candidates = [structure.exchange(name, at, model, start) for start in starts]
            candidates = scene.promising(candidates, at)
            if at == len(structure.operators) - 1:
                # tanks that overflow are too far from what they replace for one step to tell
                starts = [candidate.operators[at] for candidate in candidates]
                start = self._approached(model, starts, records, structure.state)
                candidates.insert(0, structure.exchange(name, at, model, start))
            found += candidates
        return found

    @staticmethod
    def _approached(model, starts, records, state):
        """Return the tanks fitted briefly to the first part of the records."""
        share = min(1.0, _FIRST / sum(len(r.u) for r in records))
        parts = []
        for r in records:
            n = max(int(share * len(r.u)), 2)
            weights = None if r.weights is None else r.weights[:n]
            parts.append(
                replace(r, u=r.u[:n], y=r.y[:n], segments=(), weights=weights, auxiliary=None)
            )
        exponents = frozenset(name for name, _ in starts[0].entries() if "exponents" in name)
        for held in [model.held_parameters() | exponents, model.held_parameters()][
            : 1 + model.fit_exponents
        ]:
            result = identify(
                [(start, ()) for start in starts],
                parts,
                fixed=held,
                initial_state=state,
                method=_BRIEFLY,
            )
            starts = [result.operator]
        return starts[0]


def _rates_of_lags(operator):
    """Return the rates of first-order lags in a row, 1/s, [] where a stage is anything else."""
    if isinstance(operator, FirstOrderLagOperator):
        return [1.0 / operator.time_constant]
    if isinstance(operator, SecondOrderModeOperator):
        pairs = [(operator.natural_frequency, operator.damping_ratio)]
        constants = []
    elif isinstance(operator, TransferFunctionOperator) and not np.size(operator.numerator):
        pairs = list(zip(operator.natural_frequencies, operator.damping_ratios, strict=True))
        constants = list(operator.time_constants)
    else:
        return []
    if any(damping < _DAMPED for _, damping in pairs) or len(constants) + 2 * len(pairs) > _TANKS:
        return []
    rates = [1.0 / constant for constant in constants]
    for frequency, damping in pairs:  # a pair that does not ring is as two equal lags
        apart = np.exp(np.arccosh(max(damping, 1.0)))
        rates += [frequency / apart, frequency * apart]
    return [float(rate) for rate in rates]


@dataclass(frozen=True)
class BesideForce:
    """A force beside those of a force model, whose drive is the measured motion."""

    model: object

    def structures(self, name, scene):
        structure = scene.structure.labelled(name)
        label, found = structure.label(name), []
        for at, (stage, operator) in enumerate(
            zip(structure.names, structure.operators, strict=True)
        ):
            names, parts, steps = (stage,), (operator,), [(stage, structure.models[at])]
            if isinstance(operator, SumOperator):
                names, parts, steps = operator.names, operator.stages, structure.models[at].steps
            if not isinstance(parts[0], DynamicStiffnessOperator | CoulombFrictionOperator):
                continue
            rest = [
                replace(r, u=u) for r, u in zip(scene.residuals, scene.signals(at), strict=True)
            ]
            starts = [take_apart(start)[0] for start in self.model.starting_values(rest)]
            if any(isinstance(part, type(starts[0])) for part in parts):
                continue
            model = Sum([*steps, (label, self.model)])
            found += [
                structure.exchange(
                    name, at, model, SumOperator((*names, label), (*parts, start)).normalized()
                )
                for start in starts
            ]
        return found


@dataclass(frozen=True)
class RateDependence:
    """Plays whose thresholds, or weights, follow the rate of the drive."""

    variant: str

    def structures(self, name, scene):
        structure = scene.structure
        found = []
        for at, operator in enumerate(structure.operators):
            if (
                not isinstance(operator, PrandtlIshlinskiiOperator)
                or operator.form != "play"
                or operator.drive_offset
            ):
                continue
            old = structure.models[at]
            model = RateDependentPrandtlIshlinskii(
                variant=self.variant,
                thresholds=np.array(operator.thresholds),
                non_negative=operator.non_negative,
                fit_intercept=old.fit_intercept,
            )
            for start, _ in map(take_apart, model.starting_values(scene.records_at(at))):
                warm = replace(
                    start, weights=np.array(operator.weights), intercept=operator.intercept
                )
                found.append(structure.exchange(name, at, model, warm))
            return scene.promising(found, at)
        return found


@dataclass(frozen=True)
class Driven:
    """What a further column of X adds to the response."""

    model: object

    def structures(self, name, scene):
        found = []
        for column in _moving_columns(scene):
            records = [
                replace(r, u=np.ascontiguousarray(r.auxiliary[:, column - 1]), before=None)
                for r in scene.residuals
            ]
            starts = [take_apart(start)[0] for start in self.model.starting_values(records)]
            found += [scene.structure.branch(name, self.model, s, column) for s in starts]
        return found


@dataclass(frozen=True)
class Scaled:
    """The response is scaled by a further column of X, or by the amplitude of the record."""

    by: str

    def structures(self, name, scene):
        structure = scene.structure
        taken = structure.modulated_by()
        if scene.multi_input or self.by in taken:
            return []
        if self.by == "amplitude":
            amplitudes = [amplitude(r.u) for r in scene.records]
            if not _differ(amplitudes):
                return []
            mean = np.average(amplitudes, weights=[len(r.u) for r in scene.records])
            return [structure.modulated(name, "amplitude", float(mean))]
        return [
            structure.modulated(name, column, float(_column(scene, column).mean()))
            for column in _moving_columns(scene)
            if column not in taken
        ]


@dataclass(frozen=True)
class PerRecord:
    """Parameters are straight lines in a number of the record: its amplitude, or a column."""

    by: str
    which: str  # "dynamics" or "all"

    def structures(self, name, scene):
        structure = scene.structure
        if structure.schedule is not None or scene.multi_input:
            return []
        found = []
        for by in ["amplitude"] if self.by == "amplitude" else _levels(scene):
            schedule = Schedule(by, 0.0, 1.0, {})
            numbers = [schedule.number(record) for record in scene.records]
            if not _differ(numbers):
                continue
            names = self._entries(structure)
            if names:
                values = dict(
                    zip(
                        [entry for entry, _ in structure.series().entries()],
                        structure.series().pack(),
                        strict=True,
                    )
                )
                lines = {entry: (values[entry],) * 2 for entry in names}
                found.append(
                    structure.scheduled(name, Schedule(by, min(numbers), max(numbers), lines))
                )
        return found

    def _entries(self, structure):
        """Return the names of the entries that follow the record, none where it makes no sense."""
        series = structure.series()
        held = {
            f"{stage}__{entry}"
            for stage, model in zip(structure.names, structure.models, strict=True)
            for entry in model.held_parameters()
        }
        dynamics = {
            f"{stage}__{entry}"
            for stage, operator in zip(structure.names, structure.operators, strict=True)
            for entry, spec in operator.entries()
            if isinstance(operator, LinearOperator) and not spec.linear
        }
        free = [
            entry
            for (entry, _), gauge in zip(series.entries(), series.gauge_mask(), strict=True)
            if not gauge and entry not in held
        ]
        if self.which == "dynamics":
            return [entry for entry in free if entry in dynamics]
        return free if len(free) > len(dynamics) and not _is_intercept_only(free) else []


@dataclass(frozen=True)
class MovedModes:
    """Modes that move with the amplitude, behind dynamics whose own poles are not known.

    The poles are those of large amplitudes; at small ones zeros cancel them.
    """

    n_modes: int

    def structures(self, name, scene):
        structure = scene.structure
        if structure.schedule is not None or not isinstance(structure.operators[-1], GainOperator):
            return []
        schedule = Schedule("amplitude", 0.0, 1.0, {})
        numbers = [schedule.number(record) for record in scene.records]
        if not _differ(numbers):
            return []
        middle = 0.5 * (min(numbers) + max(numbers))
        large = [r for r, number in zip(scene.records, numbers, strict=True) if number > middle]
        model = TransferFunction(2 * self.n_modes, n_zeros=2 * self.n_modes)
        found = []
        for candidate in inserted(name, model, Scene(structure, large)):
            at = candidate.place(name)
            operator, label = candidate.operators[at], candidate.names[at]
            lines = {
                f"{label}__numerator[{i}]": (0.0, value)
                for i, value in enumerate(operator.numerator)
            }
            own = Schedule("amplitude", min(numbers), max(numbers), lines)
            found.append(structure.inserted_by_record(name, model, operator, own))
        return found


def _is_intercept_only(entries):
    return all(entry.endswith("__intercept") for entry in entries)


def _differ(numbers):
    """Whether the numbers of the records are spread enough for parameters to depend on them."""
    size = max(map(abs, numbers))
    return len(numbers) > 1 and size > 0.0 and np.ptp(numbers) > _SPREAD * size


def _column(scene, column):
    return np.concatenate([r.auxiliary[:, column - 1] for r in scene.records])


def _moving_columns(scene):
    """Return the numbers of the columns of X, beside the first, that are not constant."""
    if scene.records[0].auxiliary is None:
        return []
    n_columns = scene.records[0].auxiliary.shape[1]
    return [c for c in range(1, n_columns + 1) if np.ptp(_column(scene, c)) > 0.0]


def _levels(scene):
    """Return the columns that are constant in each record."""
    found = []
    for column in _moving_columns(scene):
        size = np.abs(_column(scene, column)).max()
        if all(is_constant(r.auxiliary[:, column - 1], size) for r in scene.records):
            found.append(column)
    return found
