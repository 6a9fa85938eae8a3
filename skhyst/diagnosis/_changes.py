"""Changes by which an effect enters a model other than as a new stage of fixed order.

Each is a variant of an effect. Its method ``trees`` returns the changed trees at starting values,
and none where the change does not apply.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..base import with_params
from ..compose import (
    Cascade,
    Divisions,
    Feedback,
    Modulated,
    amplitude,
    is_constant,
    lags_of_column,
)
from ..fluid import TankChain
from ..hysteresis import (
    CoulombFrictionOperator,
    PrandtlIshlinskiiOperator,
    RateDependentPrandtlIshlinskii,
)
from ..linear import DynamicStiffnessOperator, GainOperator, TransferFunction
from ..operators import Scaled as ModulatedBy
from ..operators import SumOperator, bare, is_straight, of_columns, snake_case
from ..optimize import identify, predicted_cost, variable_projection
from ._constants import ENOUGH, FULL, NOTICEABLE, TOLERANCE, USUAL
from ._edits import (
    AddForce,
    Begin,
    Bias,
    Divide,
    Drive,
    Enrich,
    Hold,
    Insert,
    InsertAt,
    Modulate,
    ScaleEntries,
    Schedule,
    both_models,
)
from ._starts import Scene, driven_starts, inserted, with_same_input
from ._traits import lag_rates
from ._tree import BRIEFLY

# parameters of friction that grow with a normal load
_LEVELS = {"coulomb_force", "stribeck_force", "asymmetry", "friction"}


@dataclass(frozen=True)
class HeldDrive:
    """The drive between its samples follows another hold than declared, see ``LinearModel``.

    The hold is changed at the first linear dynamics of the series; their output is smooth.
    """

    hold: str

    def trees(self, name, scene):
        tree = scene.tree
        for stage in tree.stages:
            holds = getattr(stage.operator, "holds", ())
            if holds or sum(stage.operator.n_poles):
                own = stage.model.get_params().get("hold")
                if (
                    not {own, self.hold} <= set(holds)
                    or own == self.hold
                    or self._is_straight(scene)
                ):
                    return []
                return [tree.edited(name, Hold(stage.name, self.hold))]
        return []

    def _is_straight(self, scene):
        """Whether all drives are straight lines, which any interpolation leaves unchanged."""
        return self.hold == "bandlimited" and all(is_straight(r.u) for r in scene.records)


@dataclass(frozen=True)
class UnderWay:
    """The records start in motion: the device had not rested at the first value of the drive."""

    def trees(self, name, scene):
        tree = scene.tree
        unknown = tree.model.get_params().get("initial_state") != "rest"
        if unknown or all(operator.memoryless for operator in tree.operators):
            return []
        # a history affects the first samples most; the claimed effect's own one is estimated from
        # whole records
        parts = [r.first_part(len(r.u) // 3) for r in scene.records]
        return [tree.edited(name, Begin(tree.with_estimated_history(parts).input_history))]


@dataclass(frozen=True)
class FirstHysteresis:
    """A hysteresis as a new stage, in a model that has none.

    In front of the other stages, or behind linear dynamics (``behind``), as in a core behind the
    lag of its coil.
    """

    model: object
    behind: bool = False

    def trees(self, name, scene):
        tree = scene.tree
        if any(operator.owns_gain for operator in tree.operators):
            return []
        if not self.behind:
            return inserted(name, self.model, scene)
        found = []
        for at, (place, linear) in enumerate(tree.stages, 1):
            if linear.signal_linear and not linear.memoryless:
                starts = driven_starts(self.model, scene.records_at(at))
                edits = [InsertAt(place, self.model, start) for start in starts]
                found += [with_same_input(tree.edited(name, edit), at, scene) for edit in edits]
        return found


@dataclass(frozen=True)
class BehindHysteresis:
    """A model at its stage order, where a nonlinear part with memory stands before it."""

    model: object

    def trees(self, name, scene):
        before = scene.tree.operators[: scene.tree.position(self.model.stage_order)]
        if all(operator.memoryless or operator.signal_linear for operator in before):
            return []
        return inserted(name, self.model, scene)


@dataclass(frozen=True)
class InMotion:
    """A force in the equation of motion: a linear mode of the series becomes a nonlinear stage."""

    model: object

    def trees(self, name, scene):
        tree, found = scene.tree, []
        for at, stage in enumerate(tree.stages):
            if any(operator.owns_gain for operator in tree.operators[:at]):
                break
            if self._enriches(stage):
                mode, records = stage.operator.linear_mode(), scene.records_at(at)
                starts = driven_starts(self.model, records, mode=mode)
                edits = [Enrich(stage.name, self.model, start) for start in starts]
                found += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return found

    def _enriches(self, stage):
        """Whether a stage is a linear mode, or an equation of motion without the model's force."""
        if not stage.operator.n_parameters or stage.operator.linear_mode() is None:
            return False
        if type(stage.model) is type(self.model):
            more = both_models(stage.model, self.model).get_params()
            return more != stage.model.get_params()
        return stage.operator.signal_linear


@dataclass(frozen=True)
class InFeedback:
    """A curve in the feedback of linear dynamics with two poles or more, except a mode."""

    curve: object

    def trees(self, name, scene):
        tree, found = scene.tree, []
        for at, (place, linear) in enumerate(tree.stages):
            if any(operator.owns_gain for operator in tree.operators[:at]):
                break
            is_mode = linear.linear_mode() is not None  # see InMotion
            if moves(linear) and not is_mode and linear.n_poles[0] + 2 * linear.n_poles[1] > 1:
                loop = Feedback(tree.models[at], self.curve)
                starts = driven_starts(loop, scene.records_at(at), linear=linear)
                edits = [Enrich(place, loop, start) for start in starts]
                found += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return found


def moves(linear):
    """Whether an operator is linear dynamics without direct feedthrough."""
    is_linear = linear.signal_linear and linear.n_parameters and sum(linear.n_poles)
    if not (is_linear and hasattr(linear, "hold") and linear.gain and not linear.n_start):
        return False
    return linear.state_space()[3] == 0.0


@dataclass(frozen=True)
class AtJoints:
    """A model at the joints of the series, other than the one of its stage order.

    With ``inner``, only at joints between two stages. Linear dynamics commute: they are tried once
    between two parts that are not linear.
    """

    model: object
    inner: bool = False

    def trees(self, name, scene):
        tree, found = scene.tree, []
        seen = [tree.position(self.model.stage_order)]
        ends = range(int(tree.multi_input), len(tree.stages) + 1)
        for at in range(1, len(tree.stages)) if self.inner else ends:
            if at in seen or (self._is_linear and any(_commute(tree, at, own) for own in seen)):
                continue
            seen.append(at)
            place = tree.names[at - 1] if at else None
            starts = driven_starts(self.model, scene.records_at(at))
            edits = [InsertAt(place, self.model, start) for start in starts]
            found += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return found

    @property
    def _is_linear(self):
        return self.model.operator_class.signal_linear


def _commute(tree, at, other):
    """Whether linear dynamics have the same effect at two joints of the series."""
    between = tree.operators[min(at, other) : max(at, other)]
    return all(operator.signal_linear for operator in between)


@dataclass(frozen=True)
class MoreTerms:
    """A further force that a stage's model has as an option, and that is switched off.

    Options are parameters of the model; where they mean nothing else, False is off.
    """

    model: object

    def trees(self, name, scene):
        tree, found = scene.tree, []
        for at, more in self.places(tree):
            stage = tree.stages[at]
            starts = driven_starts(more, scene.records_at(at), near=stage.operator)
            edits = [Enrich(stage.name, self.model, replace(own, model=None)) for own in starts]
            found += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return found

    def places(self, tree):
        """Return the stages of a tree that can have the force, and their models with it."""
        found = []
        for at, stage in enumerate(tree.stages):
            if type(stage.model) is type(self.model):
                more = both_models(stage.model, self.model)
                if more.get_params() != stage.model.get_params():
                    found.append((at, more))
        return found


@dataclass(frozen=True)
class InBetween:
    """A model between two parts of linear dynamics, if the predicted cost falls noticeably.

    With ``with_zeros``, the dynamics are first given as many zeros as poles: zeros of the two parts
    may cancel poles where nothing stands in between.
    """

    model: object
    with_zeros: bool = False

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if tree.multi_input or tree.input_history or tree.lines:
            return []
        for at, place in enumerate(tree.names):
            divisions = scene.kept((at, self.with_zeros), self._divisions)
            if divisions is not None:
                ways = divisions.started(partial(driven_starts, self.model))
                found += [
                    tree.edited(name, Divide(place, self.model, parts))
                    for left, parts in ways
                    if left < 1.0 - NOTICEABLE
                ]
        return found

    @staticmethod
    def _divisions(scene, at, with_zeros):
        tree, operator = scene.tree, scene.tree.operators[at]
        if not hasattr(operator, "divisions") or len(operator.poles()) < 2:
            return None
        if with_zeros and len(operator.poles()) == np.size(operator.numerator):
            return None  # it has as many zeros as poles already
        operator = _with_zeros(tree, at, scene) if with_zeros else operator
        behind = tree.operators[at + 1 :]
        return Divisions(operator, scene.records_at(at), tree.state, behind=behind)


def _with_zeros(tree, at, scene):
    """Return a stage's transfer function with as many zeros as poles, briefly fitted."""
    operator = tree.operators[at]
    missing = len(operator.poles()) - np.size(operator.numerator)
    richer = replace(operator, numerator=np.append(operator.numerator, np.zeros(missing)))
    model = tree.models[at].resolved(richer)
    starts = [richer, *driven_starts(model, scene.records_at(at))]
    problems = [tree.with_stage(at, model.tree(start)).problem(scene.records) for start in starts]
    best = min(problems, key=lambda problem: predicted_cost(problem, problem.x0))
    solution = variable_projection(best, best.x0, tolerance=TOLERANCE, max_evaluations=USUAL)
    return tree.with_stage(at, model.tree(richer)).at(best, solution.x).operators[at]


@dataclass(frozen=True)
class Knee:
    """A rounded saturation of the response; the stages before it are refitted to its input."""

    model: object

    def trees(self, name, scene):
        tree = scene.tree
        at = tree.position(self.model.stage_order)
        if at < len(tree.stages) or (tree.model.reads_columns and not tree.multi_input):
            return inserted(name, self.model, scene)
        found = []
        starts = driven_starts(self.model, [replace(r, u=r.y) for r in scene.records])
        lowest = min(start.level for start in starts)
        for start in starts:
            reach = max(float(np.abs(r.y - start.center).max()) for r in scene.records) or 1.0
            # all levels have to lie above the largest response
            start = replace(start, level=start.level / lowest * reach / FULL)
            grown = _refitted_to([_before(r, start) for r in scene.records], tree)
            found.append(grown.edited(name, Insert(self.model, start)))
        return scene.promising(found, 0)


def _before(record, knee):
    """Return a record whose response is that before a knee, clipped where the knee is flat."""
    y = np.clip(record.y, knee.center - FULL * knee.level, knee.center + FULL * knee.level)
    y = knee.unsaturated(y)
    # the inverse of the knee divides an error by its slope, so the weight is the slope squared
    weights = np.square(knee.sensitivities(y, np.ones((len(y), 1)), record.dt)[1][:, 0])
    if record.weights is not None:
        weights = weights * record.weights
    return replace(record, y=y, weights=weights)


def _refitted_to(records, tree):
    """Return a tree whose linear parameters are fitted to records, the others held."""
    problem = tree.problem(records)
    gram = problem.total(problem.evaluate(problem.x0))
    linear = np.flatnonzero(problem.linear)
    own = gram[np.ix_(linear, linear)]
    scale = np.sqrt(np.diag(own))
    scale[scale == 0.0] = 1.0
    step = np.linalg.lstsq(own / np.outer(scale, scale), gram[linear, -1] / scale, rcond=None)[0]
    x = problem.x0.copy()
    x[linear] -= step / scale
    return tree.at(problem, np.clip(x, problem.lower, problem.upper))


@dataclass(frozen=True)
class Folded:
    """A reading that folds back at the end of its range, where unfolding makes it smoother.

    The model is identified from scratch on the unfolded response, since the declared one was fitted
    to the folded one. Only the record of largest range is used: with several records, the sign of
    the response in each would have to be found too.
    """

    model: object

    def trees(self, name, scene):
        tree, most = scene.tree, max(scene.records, key=lambda r: np.ptp(r.y))
        if tree.input_history or tree.lines:
            return []
        start = driven_starts(self.model, [replace(most, u=most.y)])[0]
        ends = [record.y.min() if start.side > 0 else record.y.max() for record in scene.records]
        start = replace(start, level=float(start.side * min(start.side * end for end in ends)))
        y = start.unfolded(most.y)
        bends = [np.square(np.diff(signal, 2)).sum() for signal in (most.y, y)]
        if bends[1] > (1.0 - NOTICEABLE) * bends[0]:
            return []
        return [tree.identified([replace(most, y=y)]).edited(name, Insert(self.model, start))]


@dataclass(frozen=True)
class InStages:
    """First-order lags in series become a chain of tanks, if they are the first dynamics."""

    overflow: bool
    fit_exponents: bool

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if tree.multi_input or any(operator.owns_gain for operator in tree.operators):
            return []
        for at, (place, operator) in enumerate(tree.stages):
            old = tree.models[at]
            rates = lag_rates(operator) if hasattr(operator, "with_poles") else []
            if not rates:
                continue
            model = TankChain(
                len(rates),
                overflow=self.overflow,
                fit_exponents=self.fit_exponents,
                fit_intercept=old.fit_intercept,
                hold=old.hold,
            )
            records = scene.records_at(at)
            starts = model.starts_of(rates, records)
            candidates = [tree.edited(name, Enrich(place, model, start)) for start in starts]
            candidates = scene.promising(candidates, at)
            if at == len(tree.stages) - 1:
                # the overflow is so nonlinear that one step from the linear chain does not predict
                # the cost
                starts = [candidate.operators[at] for candidate in candidates]
                start = self._approached(model, starts, records, tree.state)
                candidates.insert(0, tree.edited(name, Enrich(place, model, start)))
            found += candidates
        return found

    @staticmethod
    def _approached(model, starts, records, state):
        """Return the tanks fitted briefly to the first part of the records."""
        share = min(1.0, ENOUGH / sum(len(r.u) for r in records))
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
                method=BRIEFLY,
            )
            starts = [result.operator]
        return starts[0]


@dataclass(frozen=True)
class ParallelForce:
    """A force in parallel with those of a force model, whose drive is the measured motion.

    With ``with_gain``, also in parallel with a static gain.
    """

    model: object
    with_gain: bool = False

    def trees(self, name, scene):
        tree, found = scene.tree, []
        for at, (place, operator) in enumerate(tree.stages):
            if any(before.owns_gain for before in tree.operators[:at]):
                break  # behind it there is no motion
            parts = operator.stages if isinstance(operator, SumOperator) else (operator,)
            if not any(map(self._stands_beside, parts)):
                continue
            rest = [
                replace(r, u=u) for r, u in zip(scene.residuals, scene.signals(at), strict=True)
            ]
            model = _of_motion(self.model, parts[0])
            starts = driven_starts(model, rest)
            if all(type(part) is not type(starts[0]) for part in parts):
                edits = [AddForce(place, model, start) for start in starts]
                found += [tree.edited(name, edit) for edit in edits]
        return found

    def _stands_beside(self, part):
        is_spring = self.with_gain and isinstance(part, GainOperator)
        return is_spring or isinstance(part, DynamicStiffnessOperator | CoulombFrictionOperator)


@dataclass(frozen=True)
class BesideHysteresis(ParallelForce):
    """A model in parallel with a hysteresis, or with the forces of a force model."""

    def _stands_beside(self, part):
        moves = part.linear_mode() is not None or part.n_start  # it is driven by a force
        return part.stage_order == 10 and not (moves or part.children)


def _of_motion(model, declared):
    """Return a force model that takes the same measured motion as a declared force.

    If that is a velocity and the model takes a displacement, an integrator precedes the model.
    """
    motion = getattr(declared, "motion", getattr(declared, "drive", None))
    if motion != "velocity":
        return model
    if "motion" in model.get_params():
        return with_params(model, motion="velocity")
    integrator = TransferFunction(0, integrators=1)
    return Cascade([("displacement", integrator), (snake_case(type(model).__name__), model)])


@dataclass(frozen=True)
class LoadedForce:
    """Coulomb friction that grows with the magnitude of a further column, such as a load.

    It is added in parallel with the forces of a force model, or the column scales the declared
    friction if that does not depend on the load.
    """

    model: object

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if not tree.stages or tree.multi_input:
            return []
        place, operator = tree.stages[0]
        parts = operator.stages if isinstance(operator, SumOperator) else (operator,)
        if not isinstance(parts[0], DynamicStiffnessOperator | CoulombFrictionOperator):
            return []
        declared = any(isinstance(part, CoulombFrictionOperator) for part in parts)
        for column in _moving_columns(scene):
            own = {"magnitude": True, "scales": _of_friction(operator)}
            load = column, float(np.abs(_column(scene, column)).mean())
            if declared:
                found.append(tree.edited(name, ScaleEntries(place, *load, **own)))
                continue
            force = _of_motion(self.model, parts[0])
            model = Modulated(force, column, magnitude=True)
            for start in driven_starts(force, scene.residuals):
                loaded = ModulatedBy(of_columns(start), *load, magnitude=True)
                found.append(tree.edited(name, AddForce(place, model, loaded)))
        return found


@dataclass(frozen=True)
class LoadedMotion:
    """Friction in the equation of motion that grows with the magnitude of a further column.

    It scales the friction that other changes add, or else the friction of the first stage.
    """

    changes: tuple

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if not tree.stages or tree.multi_input:
            return []
        loads = [(c, float(np.abs(_column(scene, c)).mean())) for c in _moving_columns(scene)]
        slides = [one for own in self.changes if loads for one in own.trees(name, scene)]
        for one in slides or [tree]:
            own = {"magnitude": True, "scales": _within_first(one)}
            if not _LEVELS.isdisjoint(own["scales"]):
                edits = [ScaleEntries(one.names[0], *load, **own) for load in loads]
                found += [one.edited(name, edit) for edit in edits]
        return found


def _within_first(tree):
    """Return the parameters that the first stage can scale by a column, sample by sample."""
    return bare(tree.operators[0]).scaled_within if tree.stages else ()


def _of_friction(operator):
    """Return the names of those entries of an operator that are levels of Coulomb friction."""
    names = [name for name, _ in operator.entries()]
    return tuple(name for name in names if name.split("__")[-1] in _LEVELS)


@dataclass(frozen=True)
class FollowedWidth:
    """Plays as the first stage, whose thresholds are all proportional to a further column of X."""

    def trees(self, name, scene):
        tree = scene.tree
        if tree.multi_input or "thresholds" not in _within_first(tree):
            return []
        return [
            tree.edited(name, ScaleEntries(tree.names[0], c, float(mean), ("thresholds",)))
            for c in _moving_columns(scene)
            for mean in [_column(scene, c).mean()]
        ]


@dataclass(frozen=True)
class RateDependence:
    """Plays whose thresholds or weights depend on the rate of the drive, smoothed or not."""

    variant: str
    smoothing: str = "none"

    def trees(self, name, scene):
        for at, (place, operator) in enumerate(scene.tree.stages):
            if (
                not isinstance(operator, PrandtlIshlinskiiOperator)
                or operator.form != "play"
                or operator.drive_offset
            ):
                continue
            model = RateDependentPrandtlIshlinskii(
                variant=self.variant,
                smoothing=self.smoothing,
                thresholds=np.array(operator.thresholds),
                non_negative=operator.non_negative,
            )
            known = {
                "weights": np.array(operator.weights),
                "intercept": operator.intercept,
                "falling": operator.falling,
            }
            starts = driven_starts(model, scene.records_at(at))
            edits = [Enrich(place, model, replace(start, **known)) for start in starts]
            return scene.promising([scene.tree.edited(name, edit) for edit in edits], at)
        return []


@dataclass(frozen=True)
class Driven:
    """A model driven by a further column of X, added to the response or to the drive."""

    model: object
    to_drive: bool = False

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if self.to_drive and (tree.input_history or tree.lines):
            return []
        for column in _moving_columns(scene):
            records = [
                replace(r, u=np.ascontiguousarray(r.auxiliary[:, column - 1]), before=None)
                for r in scene.residuals
            ]
            starts = driven_starts(self.model, records)
            if self.to_drive:  # at zero gain: the first step predicts the gain
                mean = float(_column(scene, column).mean())
                edits = [Bias(self.model, replace(s, gain=0.0), column, mean) for s in starts]
            else:
                edits = [Drive(self.model, s, column) for s in starts]
            found += [tree.edited(name, edit) for edit in edits]
        return found


@dataclass(frozen=True)
class Scaled:
    """A further column of X, or the amplitude of the record, scales the response.

    A column may act through a lag, as the current of a coil or a heater does.
    """

    by: str
    lagged: bool = False

    def trees(self, name, scene):
        tree = scene.tree
        if tree.multi_input:
            return []
        if self.by == "amplitude":
            amplitudes = _numbers(scene, "amplitude")
            sizes = [len(r.u) for r in scene.records]
            means = {"amplitude": np.average(amplitudes, weights=sizes)}
            means = means if _differ(amplitudes) else {}
        else:
            means = {column: _column(scene, column).mean() for column in _moving_columns(scene)}
        lags = lags_of_column(scene.records) if self.lagged else [None]
        return [
            tree.edited(name, Modulate(column, float(mean), lag))
            for column, mean in means.items()
            if str(column) not in tree.scaled_by
            for lag in lags
        ]


@dataclass(frozen=True)
class PerRecord:
    """Parameters that are straight lines in a value per record: its amplitude, or a column."""

    by: str
    which: str  # "dynamics" or "all"

    def trees(self, name, scene):
        tree, found = scene.tree, []
        if tree.lines or tree.multi_input or not Schedule.entries(tree, self.which):
            return []
        for by in ["amplitude"] if self.by == "amplitude" else _levels(scene):
            numbers = _numbers(scene, by)
            if _differ(numbers):
                edit = Schedule(by, min(numbers), max(numbers), self.which)
                found.append(tree.edited(name, edit))
        return found


@dataclass(frozen=True)
class MovedModes:
    """Modes whose frequency depends on the amplitude, behind dynamics whose poles are not known.

    The poles are those at large amplitudes; at small amplitudes zeros cancel them.
    """

    n_modes: int

    def trees(self, name, scene):
        tree, numbers = scene.tree, _numbers(scene, "amplitude")
        if tree.lines or type(tree.operators[-1]) is not GainOperator or not _differ(numbers):
            return []
        ends = min(numbers), max(numbers)
        is_large = np.array(numbers) > 0.5 * sum(ends)
        large = [
            r
            for r, own in zip(tree.records_with_history(scene.records), is_large, strict=True)
            if own
        ]
        model = TransferFunction(2 * self.n_modes, n_zeros=2 * self.n_modes)
        found = []
        for candidate in inserted(name, model, Scene(replace(tree, input_history=()), large)):
            candidate = replace(candidate, input_history=tree.input_history)
            operator = candidate.part(name)
            lines = {f"numerator[{i}]": (0.0, value) for i, value in enumerate(operator.numerator)}
            found.append(candidate.edited(name, Schedule("amplitude", *ends, lines)))
        return found


def _differ(numbers):
    """Whether the values of the records vary enough for parameters to depend on them."""
    size = max(map(abs, numbers))
    return len(numbers) > 1 and size > 0.0 and np.ptp(numbers) > NOTICEABLE * size


def _column(scene, column):
    return np.concatenate([r.auxiliary[:, column - 1] for r in scene.records])


def _numbers(scene, by):
    """Return a value for each record: its amplitude, or the mean of a column."""
    if by == "amplitude":
        return [amplitude(r.u) for r in scene.records]
    return [float(r.auxiliary[:, by - 1].mean()) for r in scene.records]


def _moving_columns(scene):
    """Return the numbers of the columns of X, other than the first, that are not constant."""
    if scene.records[0].auxiliary is None or scene.tree.multi_input:
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
