"""Runs what has been read, to see how large its numbers become.

A branch that no sample leads to is tried, on a copy of what there is, wherever it is passed by: its
numbers are taken for as large as they would be there. Such a trial may fail, and then the branch
has no sizes.
"""

import math

import numpy as np

from ._expressions import COMPARISONS
from ._interpreter import Interpreter

# what is done with an infinite number, but for arithmetic
_OF_INFINITY = {*COMPARISONS, "min", "max", "abs", "neg", "math.fabs", "math.copysign"}
_LONGEST_TRIAL = 1000  # turns of a loop, which may have no end where it would not begin
_FAILED = (ArithmeticError, ValueError, IndexError, KeyError)


class Ranges(Interpreter):
    """The largest size of each number, over a drive.

    Numbers are told apart by the step of the model that they belong to, ``step``, the place of its
    call in the body of the whole model; None for the model itself.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._model.model_step`.
    state : ndarray of shape (n_states,)
    drive : ndarray of shape (n_samples, n_inputs)
    """

    def __init__(self, model, state, drive):
        super().__init__(model, state)
        self._seen, self._tried, self._infinite, self._led = {}, {}, set(), set()
        self._sizes = self._seen
        for u in drive:
            self.answer(u)

    @property
    def _longest(self):
        return _LONGEST_TRIAL if self._sizes is self._tried else None

    def of(self, step, *key):
        """Return the largest size, None where no sample and no trial led there."""
        return self._seen.get((step, *key), self._tried.get((step, *key)))

    def may_be_infinite(self, step, *key):
        """Say whether a number was seen that is."""
        return (step, *key) in self._infinite

    def _note(self, key, *values):
        if any(map(math.isinf, values)):
            self._infinite.add(key)
        sizes = [abs(float(v)) for v in values if math.isfinite(v)]
        self._sizes[key] = max([self._sizes.get(key, 0.0), *sizes])

    def _try(self, work, env, place):
        """Do some work on a copy, unless a sample has led to that place."""
        if place in self._led:
            return
        before, self._sizes = self._sizes, self._tried
        try:
            work({k: x.copy() if isinstance(x, np.ndarray) else x for k, x in env.items()})
        except _FAILED:
            pass
        finally:
            self._sizes = before

    def _lead(self, place):
        if self._sizes is self._seen:
            self._led.add(place)

    def _computed(self, op, values, frame):
        real = self._sizes is self._seen
        if real and op not in _OF_INFINITY and any(map(math.isinf, values)):
            raise ValueError(
                f"'{frame[1].function.name}' computes with an infinite number, which has no form "
                "in integers."
            )
