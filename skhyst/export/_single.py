"""Error of a step in single precision: the step is run with each number rounded.

If a law has fading memory, rounding errors stay small. In an unstable recursion, or if nearly equal
numbers are subtracted, they may become as large as the response.
"""

import numpy as np

from ._expressions import Call
from ._interpreter import Interpreter

_FAILED = (ArithmeticError, ValueError, IndexError)


class _Single(Interpreter):
    """Run a model in single precision, or only one of its steps."""

    def __init__(self, model, state, tuned, only=None):
        super().__init__(model, state, np.float32(tuned))
        self._only = only
        self._names["float32"] = np.float32

    def _stored(self, name, step, *key):
        return f"{name} = float(float32({name}))" if self._only in (None, step) else None

    def _constant(self, value, step):
        return float(np.float32(value)) if self._only in (None, step) else value


def check_single(model, state, drive, outputs, span, tolerance, tuned=()):
    """Raise a ValueError if the response of a model in single precision is not accurate enough.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._model.model_step`.
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
