"""Error of a step in single precision: the step is run with each number rounded.

If a law has fading memory, rounding errors stay small. In an unstable recursion, or if nearly equal
numbers are subtracted, they may become as large as the response.
"""

import math

import numpy as np

from ._expressions import Call
from ._interpreter import Interpreter
from ._ranges import MAX_OPERATIONS, fast_drive

_FAILED = (ArithmeticError, ValueError, IndexError)
_BEYOND = (16.0, 256.0)  # multiples of the range of the drive that are tried
_STEPS = 2**20  # levels of a range


class _Single(Interpreter):
    """Run a model in single precision, or only one of its steps."""

    def __init__(self, model, state, tuned, only=None):
        super().__init__(model, state, np.float32(tuned))
        self._only, self._n_left = only, math.inf
        self._names["float32"] = np.float32

    def restart(self, state):
        """Begin in another state."""
        self._state[:] = np.asarray(state, dtype=float).tolist()

    def limit(self, n_operations):
        """Limit the number of further operations, beyond which loops end with an error."""
        self._n_left = n_operations

    def _counted(self, n):
        return f"self._n_left -= {n}" if n else None

    def _turns(self):
        while self._n_left > 0:
            yield
        raise ArithmeticError("The loops are too long to be interpreted.")

    def _stored(self, name, step, *key):
        return f"{name} = float(float32({name}))" if self._only in (None, step) else None

    def _constant(self, value, step):
        return float(np.float32(value)) if self._only in (None, step) else value


def check_single(model, state, drive, outputs, span, tolerance, tuned=()):
    """Raise a ValueError if the response of a model in single precision is not accurate enough.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._composed_step.model_step`.
    state : ndarray of shape (n_states,)
    drive : ndarray of shape (n_samples, n_inputs)
        Numbers that single precision represents exactly.
    outputs : ndarray of shape (n_samples,)
        Response of the model in double precision.
    span, tolerance : float
        Range of the outputs, and the largest error allowed, relative to it.
    tuned : ndarray of shape (n_constants,), optional
        Constants that can be changed at run time.

    Raises
    ------
    ValueError
        With the step whose rounding alone has the largest effect, the error and the sample.
    """
    error, n = _largest_error(_Single(model, state, tuned), drive, outputs, tolerance * span)
    if error <= tolerance * span:
        return
    names = {k: s.function.name for k, s in enumerate(model.body) if isinstance(s, Call)}
    until_failure = drive[:n], outputs[:n], np.inf
    errors = {k: _largest_error(_Single(model, state, tuned, k), *until_failure)[0] for k in names}
    raise ValueError(
        f"Single precision cannot hold '{names[max(errors, key=errors.get)]}': at sample {n} the "
        f"response is wrong by {error / span:.1e} of the range, {tolerance:.1e} is allowed. The "
        "'dtype' must be 'float64'."
    )


def checked_ends(model, stepper, ranges, span, tolerance, answers, tuned=()):
    """Return a range of the input in which single precision is accurate enough, and the error.

    The input jumps within a range, and then within that of the drive: the response to either must
    be accurate relative to its own range, so that digits which are lost under large inputs do not
    stay lost. Multiples of the range of the drive are tried as long as this holds, and takes few
    enough operations.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._composed_step.model_step`.
    stepper : Stepper
        In its first state.
    ranges : ndarray of shape (2, n_inputs)
        Smallest and largest values of the drive.
    span, tolerance : float
        Range of the response in the test, and the largest error allowed, relative to it, or to the
        range of the response to the jumps if that is larger; or twice the effect of rounding the
        input, where that is more.
    answers : callable
        Returns the response (n_samples,) of a stepper in Python to a drive (n_samples, n_inputs).
    tuned : ndarray of shape (n_constants,), optional
        Constants that can be changed at run time.

    Returns
    -------
    ends : ndarray of shape (2, n_inputs)
    error : float
        Largest error under jumps and random values within the range of the drive, relative to
        the range of the response to them, or to ``span`` if that is larger.

    Raises
    ------
    ValueError
        If the response to jumps within the range of the drive is not accurate enough.
    """
    low, high = ranges
    single, size = _Single(model, stepper.state, tuned), np.abs(ranges).max(axis=0)
    size[size == 0.0] = 1.0
    usual, found = _fast(low, high), []

    def error(*parts):
        """Return the largest error relative to the one allowed, infinite where a law diverges."""
        try:
            return relative_error(*parts)
        except _FAILED:
            return np.inf

    def relative_error(*parts):
        drive, n = np.concatenate(parts), len(parts[0])
        single.restart(stepper.state)
        expected, worst = answers(stepper, drive), 0.0
        if not np.isfinite(expected).all():
            return np.inf
        for part in [slice(0, n), slice(n, None)][: len(parts)]:
            rounding = np.zeros((len(drive), 1))
            rounding[part, 0] = 0.5 * np.finfo(np.float32).eps
            rounding[part][1::2] *= -1.0
            moved = [answers(stepper, drive * (1.0 + sign * rounding))[part] for sign in (1, -1)]
            range_ = max(np.ptp([0.0, *expected[part]]), span)
            rounded = 2.0 * np.abs(np.subtract(moved, expected[part])).max()
            allowed = max(tolerance * range_, rounded)
            largest, _ = _largest_error(single, drive[part], expected[part], allowed)
            found.append(largest / range_)
            worst = max(worst, largest / allowed)
            if worst > 1.0:
                break
        return worst

    with np.errstate(all="ignore"):
        lost = error(usual)  # at the first sample that is wrong
        missed = found[0] if found else np.inf
        if 1.0 < lost < np.inf:  # where it is infinite the law diverges, which the status tells
            raise ValueError(
                "Single precision cannot hold the response to jumps within the range of the "
                f"drive: its error is {lost:.3g} times the {tolerance:.1e} of the range that are "
                "allowed. The 'dtype' must be 'float64', or the 'tolerance' larger."
            )
        ends = ranges
        for multiple in _BEYOND:
            wider = multiple * np.array([-size, size])
            single.limit(MAX_OPERATIONS)
            if error(_fast(*wider), usual) > 1.0:
                break
            ends = wider
    return ends, missed


def _fast(low, high):
    """Return jumps and random values between two ends, which single precision represents."""
    levels = fast_drive(np.zeros(len(low)), np.full(len(low), _STEPS)) / _STEPS
    largest = np.finfo(np.float32).max
    return np.clip(low + (high - low) * levels, -largest, largest).astype(np.float32).astype(float)


def _largest_error(single, drive, outputs, allowed):
    """Return the largest error, up to one beyond ``allowed``, and the number of samples run."""
    largest, n = 0.0, 0
    for n, (u, y) in enumerate(zip(drive, outputs, strict=True), 1):  # noqa: B007
        try:
            error = abs(single.answer(u) - y)
        except _FAILED:
            error = np.inf
        if not error <= largest:  # NaN counts as infinite
            largest = np.inf if np.isnan(error) else error
        if largest > allowed:
            break
    return largest, n
