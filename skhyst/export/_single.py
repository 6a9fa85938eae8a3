"""Error of a step in single precision: it is run with each number rounded, and compared.

If a law has fading memory, rounding errors stay small. Otherwise, as in an unstable recursion, or
if nearly equal numbers are subtracted, they may become as large as the response.
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
        With the step that has the largest error of its own, the error and the sample.
    """
    error, n = _lost(_Single(model, state, tuned), drive, outputs, tolerance * span)
    if error <= tolerance * span:
        return
    steps = {k: s.function.name for k, s in enumerate(model.body) if isinstance(s, Call)}
    until = drive[:n], outputs[:n], np.inf
    alone = {k: _lost(_Single(model, state, tuned, k), *until)[0] for k in steps}
    raise ValueError(
        f"Single precision cannot hold '{steps[max(alone, key=alone.get)]}': at sample {n} the "
        f"response is wrong by {error / span:.1e} of the range, {tolerance:.1e} is allowed. The "
        "'dtype' must be 'float64'."
    )


def _lost(single, drive, outputs, enough):
    """Return the largest error up to the first beyond ``enough``, and the number of samples run."""
    worst, n = 0.0, 0
    for n, (u, y) in enumerate(zip(drive, outputs, strict=True), 1):  # noqa: B007
        try:
            error = abs(single.answer(u) - y)
        except _FAILED:
            error = np.inf
        worst = error if error > worst else worst if error <= worst else np.inf  # NaN: infinite
        if worst > enough:
            break
    return worst, n
