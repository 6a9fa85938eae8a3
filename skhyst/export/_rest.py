"""State of rest of a program as a function of its input, found by probing the steppers of a model.

A part without dynamics of its own, such as a hysteresis, is at rest at an input after one step to
it from the state at rest at zero: its memory is that of a first loading. The states of a linear
part at rest are affine in its input, and a step at this input does not change them. Both are tried
for each part, and kept only if a device with such an initial state responds like one that the model
itself has put to rest.
"""

from dataclasses import dataclass

import numpy as np

# levels of rest that are tried, as fractions of the range; zero, where devices begin, is the first
_LEVELS = (0.0, 1.0, -1.0, 0.61, -0.37, 0.1)
_WIDER = (16.0, 1.0)  # ranges for which rules are tried, as multiples of the range of the drive
_N_SAMPLES = 20  # samples of each drive that compares two devices
_PARTS = (0.5, 0.02)  # sizes of these drives, as fractions of the range
_SAME = 2e-13  # difference that counts as rounding, relative to the range of the output
_FAILED = (ArithmeticError, ValueError, TypeError, NotImplementedError, IndexError)


@dataclass(frozen=True)
class Rule:
    """Rule that puts one part to rest at its input ``v``.

    Parameters
    ----------
    first : ndarray of shape (n_states,)
        State at rest at ``v = 0`` if the state at rest is affine in ``v``, else the state from
        which a step to ``v`` leads to rest.
    slope : ndarray of shape (n_states,) or None
        Derivative of an affine state with respect to ``v``; None: a step is taken.
    """

    first: np.ndarray
    slope: np.ndarray | None = None

    def agrees(self, other):
        """Whether another rule leads to the same states."""
        if (self.slope is None) != (other.slope is None):
            return False
        a, b = (np.append(r.first, [] if r.slope is None else r.slope) for r in (self, other))
        return a.shape == b.shape and np.allclose(a, b, rtol=_SAME, atol=_SAME)


@dataclass(frozen=True)
class _Visit:
    """A part of a device at rest: its step, state, input and output."""

    step: object
    constants: tuple
    state: np.ndarray
    v: object
    y: float

    def answers(self, state, drive):
        """Return the output under a drive that begins in a state."""
        s = state.copy()
        return np.array([self.step(v, self.constants, s) for v in drive])


def parts_at_rest(compiled_step, u):
    """Return a visit to each part of a compiled step at rest at an input, in order of binding."""
    visits = []

    def binding(step, constants, s):
        number = len(visits)
        visits.append(None)

        def called(v):
            before = s.copy()
            y = step(v, constants, s)
            visits[number] = _Visit(step, constants, before, v, float(y))
            return y

        return called

    compiled_step.bound(compiled_step.state.copy(), binding)(u)
    return visits


def rest_rules(at_rest, drive):
    """Return the rule that puts each part to rest, and the range of the input for which it holds.

    Parameters
    ----------
    at_rest : callable
        Returns the stepper of the model at rest at an input.
    drive : ndarray of shape (n_samples, n_inputs)
        Inputs of the range that is wanted.

    Returns
    -------
    rules : list of Rule, or None
        None if the rest of a part is not known as a function of its input.
    ends : ndarray of shape (2, n_inputs)
    """
    largest = np.abs(drive).max(axis=0)
    largest[largest == 0.0] = 1.0
    for factor in _WIDER:
        size = factor * largest
        try:
            rules = _rules(at_rest, size, largest)
        except _FAILED:
            rules = None
        if rules is not None:
            return rules, np.array([-size, size])
    return None, None


def _rules(at_rest, size, drive_size):
    """Return the rules for inputs up to a size in each column, or None.

    They are also verified within the size of the drive.
    """
    levels = [part * size for part in _LEVELS] + [part * drive_size for part in _LEVELS[1:]]
    if len(size) > 1:  # columns move independently
        signs = np.where(np.arange(len(size)) % 2, 1.0, -0.6)
        levels += [signs * drive_size, signs[::-1] * size]
    steppers, visits = [], []
    for level in levels:
        stepper = at_rest(level)
        row = stepper.compiled_step.n_inputs is not None
        steppers.append(stepper)
        visits.append(parts_at_rest(stepper.compiled_step, level if row else float(level[0])))
    rules = [_rule(visits_of_part) for visits_of_part in zip(*visits, strict=True)]
    if None in rules:
        return None
    # the rules of all parts together, by later responses of the whole device
    for stepper, level in zip(steppers, levels, strict=True):
        by_rules = stepper.copy()
        by_rules.state = rest_state(stepper.compiled_step, rules, level)
        if not (
            _start_equally(stepper, by_rules, level, size)
            and _start_equally(stepper, by_rules, level, drive_size)
        ):
            return None
    return rules


def rest_state(compiled_step, rules, level):
    """Return the state (n_states,) of a device at rest at an input (n_inputs,), by the rules."""
    state, remaining = compiled_step.state.copy(), list(rules)

    def binding(step, constants, s):
        rule = remaining.pop(0)

        def called(v):
            s[:] = start = rule.first if rule.slope is None else rule.first + rule.slope * v
            y = step(v, constants, s)
            if rule.slope is not None:
                s[:] = start
            return y

        return called

    row = compiled_step.n_inputs is not None
    compiled_step.bound(state, binding)(level if row else float(level[0]))
    return state


def _rule(visits):
    """Return the rule of a part from its visits at several levels, or None; the first is zero."""
    first, *others = visits
    moved = [visit for visit in others if np.any(np.asarray(visit.v) != np.asarray(first.v))]
    if not first.state.size:
        return Rule(first.state)
    if all(_is_one_step(first, visit) for visit in moved):
        return Rule(first.state)
    if np.ndim(first.v):  # a state affine in several inputs is not tried
        return None
    if not moved:
        return Rule(first.state, 0.0 * first.state)
    farthest = max(moved, key=lambda visit: abs(visit.v - first.v))
    slope = (farthest.state - first.state) / (farthest.v - first.v)
    start = first.state - slope * first.v
    size = max(np.abs(farthest.state).max(), np.abs(first.state).max(), np.finfo(float).tiny)
    if all(
        np.allclose(start + slope * visit.v, visit.state, rtol=0.0, atol=_SAME * size)
        for visit in moved
    ):
        return Rule(start, slope)
    return None


def _is_one_step(first, visit):
    """Whether one step from the first state leads to the other, judged by later responses.

    States that differ only in numbers without effect on the response count as the same.
    """
    s = first.state.copy()
    visit.step(visit.v, visit.constants, s)
    size = np.max(np.abs(np.asarray(visit.v) - np.asarray(first.v)))
    for walk in _walks(np.shape(visit.v)):
        drive = visit.v + size * walk
        drive = drive if np.ndim(visit.v) else drive.tolist()
        if not _same(visit.answers(s, drive), visit.answers(visit.state, drive)):
            return False
    return True


def _start_equally(stepper, other, level, size):
    """Whether two devices at rest at a level respond equally."""
    row = stepper.compiled_step.n_inputs is not None
    for walk in _walks((len(size),)):
        u = level + size * walk
        u = u if row else u[:, 0]
        if not _same(stepper.copy().run(u), other.copy().run(u)):
            return False
    return True


def _walks(shape):
    """Yield drives about a level of rest: they leave it at once, or later, by much or by little."""
    rng = np.random.default_rng(0)
    for part in _PARTS:
        walk = part * rng.uniform(-1.0, 1.0, (_N_SAMPLES, *shape))
        yield walk
        walk = walk.copy()
        walk[:3] = 0.0
        yield walk


def _same(values, expected):
    """Whether two responses differ by no more than rounding."""
    span = np.ptp([0.0, *expected]) or 1.0
    return np.abs(np.subtract(values, expected)).max() <= _SAME * span
