"""Changes by which an effect enters a model other than as a new stage of fixed order.

Each is a variant of an effect. Its method ``trees`` returns the changed trees at starting values,
and none where the change does not apply.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from .._validation import common_parameter
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
from ..operators import Scaled, SumOperator, bare, is_straight, of_columns, snake_case
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
                present = stage.model.get_params().get("hold")
                is_possible = {present, self.hold} <= set(holds) and present != self.hold
                if not is_possible or self._is_straight(scene):
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
        unknown = common_parameter(tree.model, "initial_state") != "rest"
        if unknown or all(operator.memoryless for operator in tree.operators):
            return []
        # a history affects the first samples most: this is a start for the fit to whole records
        parts = [r.first_part(len(r.u) // 3) for r in scene.records]
        start = tree.edited(name, Begin(tree.with_estimated_history(parts).input_history))
        # the parameters compensate for the state of rest: they are fitted together with it, too
        return [start, start.with_input_history(scene.records)]


@dataclass(frozen=True)
class FirstHysteresis:
    """A hysteresis as a new stage, in a model that has none.

    It precedes the other stages, or follows linear dynamics (``behind``), as in a magnetic core
    behind the lag of its coil.
    """

    model: object
    behind: bool = False

    def trees(self, name, scene):
        tree = scene.tree
        if any(operator.owns_gain for operator in tree.operators):
            return []
        if not self.behind:
            return inserted(name, self.model, scene)
        trees = []
        for at, (place, linear) in enumerate(tree.stages, 1):
            if linear.signal_linear and not linear.memoryless:
                starts = driven_starts(self.model, scene.records_at(at))
                edits = [InsertAt(place, self.model, start) for start in starts]
                trees += [with_same_input(tree.edited(name, edit), at, scene) for edit in edits]
        return trees


@dataclass(frozen=True)
class BehindHysteresis:
    """A model at its stage order, if a nonlinear part with memory precedes it."""

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
        tree, trees = scene.tree, []
        for at, stage in _stages_to_hysteresis(tree):
            if self._enriches(stage):
                mode, records = stage.operator.linear_mode(), scene.records_at(at)
                starts = driven_starts(self.model, records, mode=mode)
                edits = [Enrich(stage.name, self.model, start) for start in starts]
                trees += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return trees

    def _enriches(self, stage):
        """Whether a stage is a linear mode, or an equation of motion without the model's force."""
        if not stage.operator.n_parameters or stage.operator.linear_mode() is None:
            return False
        if type(stage.model) is type(self.model):
            richer = both_models(stage.model, self.model).get_params()
            return richer != stage.model.get_params()
        return stage.operator.signal_linear


@dataclass(frozen=True)
class InFeedback:
    """A curve in the feedback of linear dynamics with two poles or more, except a mode."""

    curve: object

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        for at, (place, linear) in _stages_to_hysteresis(tree):
            is_mode = linear.linear_mode() is not None  # see InMotion
            if moves(linear) and not is_mode and linear.n_poles[0] + 2 * linear.n_poles[1] > 1:
                loop = Feedback(tree.models[at], self.curve)
                starts = driven_starts(loop, scene.records_at(at), linear=linear)
                edits = [Enrich(place, loop, start) for start in starts]
                trees += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return trees


def _stages_to_hysteresis(tree):
    """Return the numbers and stages of a series up to the first one that owns the gain.

    The input of a stage behind such a part, a hysteresis, is neither a force nor a motion.
    """
    owners = [at for at, operator in enumerate(tree.operators) if operator.owns_gain]
    return list(enumerate(tree.stages))[: min(owners, default=len(tree.stages)) + 1]


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
        tree, trees = scene.tree, []
        tried = [tree.position(self.model.stage_order)]
        joints = range(int(tree.multi_input), len(tree.stages) + 1)
        for at in range(1, len(tree.stages)) if self.inner else joints:
            if at in tried or (self._is_linear and any(_commute(tree, at, i) for i in tried)):
                continue
            tried.append(at)
            before = tree.names[at - 1] if at else None
            starts = driven_starts(self.model, scene.records_at(at))
            edits = [InsertAt(before, self.model, start) for start in starts]
            trees += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return trees

    @property
    def _is_linear(self):
        return self.model.operator_class.signal_linear


def _commute(tree, at, other):
    """Whether linear dynamics have the same effect at two joints of the series."""
    between = tree.operators[min(at, other) : max(at, other)]
    return all(operator.signal_linear for operator in between)


@dataclass(frozen=True)
class MoreTerms:
    """A further force that the model of a stage has as an option, and that is switched off.

    Options are boolean parameters of the model, and degrees; see :func:`both_models`.
    """

    model: object

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        for at, richer in self.places(tree):
            stage = tree.stages[at]
            starts = driven_starts(richer, scene.records_at(at), near=stage.operator)
            edits = [Enrich(stage.name, self.model, replace(start, model=None)) for start in starts]
            trees += scene.promising([tree.edited(name, edit) for edit in edits], at)
        return trees

    def places(self, tree):
        """Return the stages of a tree that can have the force, and their models with it."""
        found = []
        for at, stage in enumerate(tree.stages):
            if type(stage.model) is type(self.model):
                richer = both_models(stage.model, self.model)
                if richer.get_params() != stage.model.get_params():
                    found.append((at, richer))
        return found


@dataclass(frozen=True)
class InBetween:
    """A model between two parts of linear dynamics, if the predicted cost falls noticeably.

    With ``with_zeros``, the dynamics are first given as many zeros as poles: without a nonlinearity
    between them, zeros of one part may have cancelled poles of the other.
    """

    model: object
    with_zeros: bool = False

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        if tree.multi_input or tree.input_history or tree.lines:
            return []
        for at, place in enumerate(tree.names):
            divisions = scene.kept((at, self.with_zeros), self._divisions)
            if divisions is not None:
                starts = divisions.started(partial(driven_starts, self.model))
                trees += [
                    tree.edited(name, Divide(place, self.model, operators))
                    for relative_cost, operators in starts
                    if relative_cost < 1.0 - NOTICEABLE
                ]
        return trees

    @staticmethod
    def _divisions(scene, at, with_zeros):
        """Return the ways to divide a stage in two, or None if it is no such dynamics."""
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
    """A rounded saturation of the response; the stages before it are refitted to its input.

    The recorded response, unsaturated, estimates that input.
    """

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
            linear_part = _refitted_to([_before(r, start) for r in scene.records], tree)
            found.append(linear_part.edited(name, Insert(self.model, start)))
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
    """Return a tree whose linear parameters are fitted to records, the others held.

    A Gauss-Newton step is exact in them.
    """
    problem = tree.problem(records)
    gram = problem.total(problem.evaluate(problem.x0))
    linear = np.flatnonzero(problem.linear)
    hessian = gram[np.ix_(linear, linear)]
    scale = np.sqrt(np.diag(hessian))
    scale[scale == 0.0] = 1.0
    step = np.linalg.lstsq(hessian / np.outer(scale, scale), gram[linear, -1] / scale, rcond=None)[
        0
    ]
    x = problem.x0.copy()
    x[linear] -= step / scale
    return tree.at(problem, np.clip(x, problem.lower, problem.upper))


@dataclass(frozen=True)
class Folded:
    """A reading that folds back at the end of its range, if unfolding makes it smoother.

    The present model was fitted to the folded response, so it is identified from scratch on the
    unfolded one. Only the record of largest range is used: with several records, the sign of the
    response in each would have to be found too.
    """

    model: object

    def trees(self, name, scene):
        tree, widest = scene.tree, max(scene.records, key=lambda r: np.ptp(r.y))
        if tree.input_history or tree.lines:
            return []
        start = driven_starts(self.model, [replace(widest, u=widest.y)])[0]
        ends = [record.y.min() if start.side > 0 else record.y.max() for record in scene.records]
        start = replace(start, level=float(start.side * min(start.side * end for end in ends)))
        y = start.unfolded(widest.y)
        roughness = [np.square(np.diff(signal, 2)).sum() for signal in (widest.y, y)]
        if roughness[1] > (1.0 - NOTICEABLE) * roughness[0]:
            return []
        return [tree.identified([replace(widest, y=y)]).edited(name, Insert(self.model, start))]


@dataclass(frozen=True)
class InStages:
    """First-order lags in series become a chain of tanks, if no stage before them has a gain."""

    overflow: bool
    fit_exponents: bool

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        if tree.multi_input or any(operator.owns_gain for operator in tree.operators):
            return []
        for at, (place, operator) in enumerate(tree.stages):
            linear = tree.models[at]
            rates = lag_rates(operator) if hasattr(operator, "with_poles") else []
            if not rates:
                continue
            model = TankChain(
                len(rates),
                overflow=self.overflow,
                fit_exponents=self.fit_exponents,
                fit_intercept=linear.fit_intercept,
                hold=linear.hold,
            )
            records = scene.records_at(at)
            starts = model.starts_of(rates, records)
            candidates = [tree.edited(name, Enrich(place, model, start)) for start in starts]
            candidates = scene.promising(candidates, at)
            if at == len(tree.stages) - 1:
                # the overflow is so nonlinear that one step from the linear chain does not predict
                # the cost of a fit
                starts = [candidate.operators[at] for candidate in candidates]
                start = self._approached(model, starts, records, tree.state)
                candidates.insert(0, tree.edited(name, Enrich(place, model, start)))
            trees += candidates
        return trees

    @staticmethod
    def _approached(model, starts, records, state):
        """Return the tanks fitted briefly to the first part of the records, exponents last."""
        fraction = min(1.0, ENOUGH / sum(len(r.u) for r in records))
        first_parts = []
        for r in records:
            n = max(int(fraction * len(r.u)), 2)
            weights = None if r.weights is None else r.weights[:n]
            first_parts.append(
                replace(r, u=r.u[:n], y=r.y[:n], segments=(), weights=weights, auxiliary=None)
            )
        exponents = frozenset(name for name, _ in starts[0].entries() if "exponents" in name)
        held = model.held_parameters()
        for fixed in [held | exponents, *([held] if model.fit_exponents else [])]:
            pairs, options = [(s, ()) for s in starts], {"initial_state": state, "method": BRIEFLY}
            starts = [identify(pairs, first_parts, fixed=fixed, **options).operator]
        return starts[0]


@dataclass(frozen=True)
class ParallelForce:
    """A force in parallel with those of a force model, whose drive is the measured motion.

    With ``with_gain``, also in parallel with a static gain.
    """

    model: object
    with_gain: bool = False

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        for at, (place, operator) in _stages_to_hysteresis(tree):
            parts = operator.stages if isinstance(operator, SumOperator) else (operator,)
            if not any(map(self._is_parallel, parts)):
                continue
            inputs = zip(scene.residuals, scene.signals(at), strict=True)
            model = _of_motion(self.model, parts[0])
            records = [replace(r, u=u) for r, u in inputs]
            starts = [_with_best_gain(start, records) for start in driven_starts(model, records)]
            if all(type(part) is not type(starts[0]) for part in parts):
                edits = [AddForce(place, model, start) for start in starts]
                trees += [tree.edited(name, edit) for edit in edits]
        return trees

    def _is_parallel(self, part):
        """Whether the force may act in parallel with a part of a stage."""
        is_spring = self.with_gain and isinstance(part, GainOperator)
        return is_spring or isinstance(part, DynamicStiffnessOperator | CoulombFrictionOperator)


def _with_best_gain(operator, records):
    """Return linear dynamics with the gain that fits the records best; others as they are."""
    if not (operator.signal_linear and "gain" in vars(operator)):
        return operator
    fitted = np.concatenate([operator.run(r.u, r.dt)[0] for r in records])
    power = fitted @ fitted
    gain = fitted @ np.concatenate([r.y for r in records]) / power if power else 1.0
    return replace(operator, gain=float(operator.gain * gain))


@dataclass(frozen=True)
class BesideHysteresis(ParallelForce):
    """A model in parallel with a hysteresis, or with the forces of a force model."""

    def _is_parallel(self, part):
        force_driven = part.linear_mode() is not None or part.n_start
        return part.stage_order == 10 and not (force_driven or part.children)


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
        tree, trees = scene.tree, []
        if not tree.stages or tree.multi_input:
            return []
        place, operator = tree.stages[0]
        parts = operator.stages if isinstance(operator, SumOperator) else (operator,)
        if not isinstance(parts[0], DynamicStiffnessOperator | CoulombFrictionOperator):
            return []
        has_friction = any(isinstance(part, CoulombFrictionOperator) for part in parts)
        for column in _moving_columns(scene):
            load = column, float(np.abs(_column(scene, column)).mean())
            if has_friction:
                edit = ScaleEntries(place, *load, scales=_of_friction(operator), magnitude=True)
                trees.append(tree.edited(name, edit))
                continue
            force = _of_motion(self.model, parts[0])
            model = Modulated(force, column, magnitude=True)
            for start in driven_starts(force, scene.residuals):
                loaded = Scaled(of_columns(start), *load, magnitude=True)
                trees.append(tree.edited(name, AddForce(place, model, loaded)))
        return trees


@dataclass(frozen=True)
class LoadedMotion:
    """Friction in the equation of motion that grows with the magnitude of a further column.

    The column scales the friction that ``changes`` add, or, if none applies, that of the first
    stage.
    """

    changes: tuple

    def trees(self, name, scene):
        tree, trees = scene.tree, []
        if not tree.stages or tree.multi_input:
            return []
        loads = [(c, float(np.abs(_column(scene, c)).mean())) for c in _moving_columns(scene)]
        with_friction = [t for change in self.changes if loads for t in change.trees(name, scene)]
        for changed in with_friction or [tree]:
            scales = _scalable_by_column(changed)
            if not _LEVELS.isdisjoint(scales):
                edits = [ScaleEntries(changed.names[0], *load, scales, True) for load in loads]
                trees += [changed.edited(name, edit) for edit in edits]
        return trees


def _scalable_by_column(tree):
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
        if tree.multi_input or "thresholds" not in _scalable_by_column(tree):
            return []
        means = {c: float(_column(scene, c).mean()) for c in _moving_columns(scene)}
        edits = [ScaleEntries(tree.names[0], *item, ("thresholds",)) for item in means.items()]
        return [tree.edited(name, edit) for edit in edits]


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
        tree, trees = scene.tree, []
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
                edits = [
                    Bias(self.model, replace(start, gain=0.0), column, mean) for start in starts
                ]
            else:
                edits = [Drive(self.model, start, column) for start in starts]
            trees += [tree.edited(name, edit) for edit in edits]
        return trees


@dataclass(frozen=True)
class Scaling:
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
            amplitudes = _values_per_record(scene, "amplitude")
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
        tree, trees = scene.tree, []
        if tree.lines or tree.multi_input or not Schedule.entries(tree, self.which):
            return []
        for by in ["amplitude"] if self.by == "amplitude" else _constant_per_record(scene):
            values = _values_per_record(scene, by)
            if _differ(values):
                edit = Schedule(by, min(values), max(values), self.which)
                trees.append(tree.edited(name, edit))
        return trees


@dataclass(frozen=True)
class MovedModes:
    """Modes that appear at large amplitudes only, in a model whose last stage is a static gain.

    Their poles are identified at large amplitudes; at small amplitudes zeros cancel them.
    """

    n_modes: int

    def trees(self, name, scene):
        tree, amplitudes = scene.tree, _values_per_record(scene, "amplitude")
        if tree.lines or type(tree.operators[-1]) is not GainOperator or not _differ(amplitudes):
            return []
        ends = min(amplitudes), max(amplitudes)
        is_large = np.array(amplitudes) > 0.5 * sum(ends)
        records = tree.records_with_history(scene.records)
        large = [r for r, is_one in zip(records, is_large, strict=True) if is_one]
        model = TransferFunction(2 * self.n_modes, n_zeros=2 * self.n_modes)
        trees = []
        for candidate in inserted(name, model, Scene(replace(tree, input_history=()), large)):
            candidate = replace(candidate, input_history=tree.input_history)
            operator = candidate.part(name)
            lines = {f"numerator[{i}]": (0.0, value) for i, value in enumerate(operator.numerator)}
            trees.append(candidate.edited(name, Schedule("amplitude", *ends, lines)))
        return trees


def _differ(values):
    """Whether the values of the records vary enough for parameters to depend on them."""
    size = max(map(abs, values))
    return len(values) > 1 and size > 0.0 and np.ptp(values) > NOTICEABLE * size


def _column(scene, column):
    """Return the samples of a column of X in all records."""
    return np.concatenate([r.auxiliary[:, column - 1] for r in scene.records])


def _values_per_record(scene, by):
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


def _constant_per_record(scene):
    """Return the columns that are constant in each record, but not in all."""
    found = []
    for column in _moving_columns(scene):
        size = np.abs(_column(scene, column)).max()
        if all(is_constant(r.auxiliary[:, column - 1], size) for r in scene.records):
            found.append(column)
    return found
