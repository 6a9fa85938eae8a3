"""Runs what has been read, to see how large its numbers become, and which branches are taken.

A branch that no sample leads to is tried, on a copy of what there is, wherever it is passed by: its
numbers are taken for as large as they would be there. Such a trial may fail, and then the branch
has no sizes.
"""

import math
from collections import Counter

import numpy as np

from ._expressions import COMPARISONS
from ._interpreter import Interpreter

# what is done with an infinite number, but for arithmetic
_OF_INFINITY = {*COMPARISONS, "min", "max", "abs", "neg", "math.fabs", "math.copysign"}
_LONGEST_TRIAL = 1000  # turns of a loop, which may have no end where it would not begin
_FAILED = (ArithmeticError, ValueError, IndexError, KeyError)
_LONGEST_RUN = 1_000_000  # operations beyond the drive, some seconds
_BITS = 44  # of numbers that are rounded: fewer than the 50 of a program
_BEYOND = (16, 8, 4, 2)  # times the largest input of the drive, where input is held
_PARTS = (1.0, 1 / 16, 1 / 256)  # of the drive's range
# between the ends of a range: from one to the other each sample and each third, rests, ramps
_JUMPS = [0, 1] * 4 + 2 * ([0] * 3 + [1] * 3) + [0.5] * 3 + [0, 0.2, 0.4, 0.6, 0.8, 1, 0.7, 0.4]


def exponent(largest):
    """Return the binary digits before the point of numbers up to a size."""
    return math.frexp(largest)[1] if largest else 1


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
        self.begin = model, state
        self._seen, self._tried, self._infinite = {}, {}, set()
        self._led, self._passed = set(), set()  # places; the branches that are taken, and are not
        self._sizes, self._is_trial, self._left = self._seen, False, math.inf
        for u in drive:
            self.answer(u)
        self._left = _LONGEST_RUN

    @property
    def _longest(self):
        return _LONGEST_TRIAL if self._is_trial else None

    def of(self, step, *key):
        """Return the largest size, None where no sample and no trial led there."""
        return self._seen.get((step, *key), self._tried.get((step, *key)))

    def may_be_infinite(self, step, *key):
        """Say whether a number was seen that is."""
        return (step, *key) in self._infinite

    @property
    def is_cut(self):
        """Whether there was no time for all that was to be run."""
        return self._left <= 0

    @property
    def led(self):
        """The branches that were taken."""
        return set(self._led)

    @property
    def branches(self):
        """How many branches the samples have taken, and how many there are."""
        return len(self._led), len(self._led | self._passed)

    @property
    def passed_by(self):
        """How many branches no sample has taken, by the name of the function."""
        return Counter(part.function.name for (_, part), *_ in self._passed - self._led)

    def go_on(self, drive, bits, grows):
        """Go on with more samples, unless the law fails there, or numbers grow too large.

        Parameters
        ----------
        drive : ndarray of shape (n_samples, n_inputs)
        bits : int
            By which numbers may grow beyond what was seen.
        grows : bool
            Whether sizes become what is seen; else only those of numbers that had none, or were 0.

        Returns
        -------
        bool
            Whether these samples are among what was seen; else nothing is changed.
        """
        before = self._state.copy(), set(self._infinite), set(self._led), set(self._passed)
        known, tried = self._seen, self._tried
        self._sizes = self._seen = {}
        self._tried = dict(tried)
        try:
            fits = all(self._left <= 0 or math.isfinite(self.answer(u)) for u in drive)
        except _FAILED:
            fits = False
        sizes, new = {**tried, **known}, self._seen
        self._seen, self._tried = dict(known), {**self._tried, **tried}
        for key, size in new.items():
            if size and sizes.get(key):
                fits = fits and exponent(size) <= exponent(sizes[key]) + bits
            if grows or not sizes.get(key):
                self._seen[key] = max(size, known.get(key, 0.0))
        if not fits:
            self._seen, self._tried = known, tried
            self._state[:], self._infinite, self._led, self._passed = before
        self._sizes = self._seen
        return fits

    def take_back(self, led):
        """Count branches as not taken, but for those that had been."""
        self._passed |= self._led - led
        self._led = led

    def _note(self, key, *values):
        if any(map(math.isinf, values)):
            self._infinite.add(key)
        sizes = [abs(float(v)) for v in values if math.isfinite(v)]
        self._sizes[key] = max([self._sizes.get(key, 0.0), *sizes])

    def _try(self, work, env, place):
        """Do some work on a copy, unless a sample has led to that place."""
        if place in self._led:
            return
        self._passed.add(place)
        before, self._sizes, self._is_trial = (self._sizes, self._is_trial), self._tried, True
        try:
            work({k: x.copy() if isinstance(x, np.ndarray) else x for k, x in env.items()})
        except _FAILED:
            pass
        finally:
            self._sizes, self._is_trial = before

    def _lead(self, place):
        (self._passed if self._is_trial else self._led).add(place)

    def _computed(self, op, values, frame):
        self._left -= 1
        if not self._is_trial and op not in _OF_INFINITY and any(map(math.isinf, values)):
            raise ValueError(
                f"'{frame[1].function.name}' computes with an infinite number, which has no form "
                "in integers."
            )


class _Rounded(Interpreter):
    """Runs a model with numbers of few bits, for the sizes that they have, and saturates."""

    def __init__(self, ranges, spare):
        super().__init__(*ranges.begin)
        self._ranges, self._spare = ranges, spare

    def _number(self, value, step, *key):
        size = self._ranges.of(step, *key) if key else None
        if not size or not math.isfinite(value):
            return value
        last, most = exponent(size) - _BITS, 2 ** (_BITS + self._spare)
        return math.ldexp(max(-most, min(round(math.ldexp(value, -last)), most)), last)

    def agrees(self, drive, outputs, allowed):
        """Go on with a drive, and say whether the answers are these; else nothing is changed."""
        before = self._state.copy()
        try:
            agrees = all(
                abs(self.answer(u) - y) <= allowed for u, y in zip(drive, outputs, strict=True)
            )
        except _FAILED:
            agrees = False
        if not agrees:
            self._state[:] = before
        return agrees


def explore(ranges, counts, units, spare, answers):
    """Go on beyond a drive: with jumps between its ends, and with input that is held.

    What a law makes of a change, a lead or a rest is not seen in a slow drive. Jumps are through
    its whole range, then through parts of it while there are branches that have not been taken.
    They are for the test, too, but where an answer hangs on a rounding, as where a law jumps.

    Parameters
    ----------
    ranges : Ranges
        Has seen the drive.
    counts : ndarray of shape (n_samples, n_inputs)
        The drive in units of the input, integers.
    units : tuple of float
        Of input and output.
    spare : int
        Bits by which numbers may grow beyond what the drive and its jumps make of them: where they
        do by more, input is held nearer to the drive.
    answers : callable
        Returns the response of the Python model to a drive.

    Returns
    -------
    counts : ndarray of shape (n_more, n_inputs)
        The drive and what follows it in the test, where input to be held is at the ends of 32 bits.
    ends : ndarray of shape (2, n_inputs)
        Where input is held.
    """
    unit, allowed = units[0], 0.25 * units[1]  # a quarter of what the test allows
    drive, rounded = unit * counts, _Rounded(ranges, spare)
    rounded.agrees(drive, answers(drive), math.inf)
    low, high = counts.min(axis=0), counts.max(axis=0)
    low, high = low - (low == high), high + (low == high)

    def follow(jumps, bits, grows):
        """Go on, and say whether that is possible, and whether it is for the test."""
        nonlocal drive
        led = ranges.led
        if not ranges.go_on(unit * jumps, bits, grows):
            return False, False
        more = np.append(drive, unit * jumps, axis=0)
        is_tested = not ranges.is_cut and rounded.agrees(
            unit * jumps, answers(more)[len(drive) :], allowed
        )
        if is_tested:
            drive = more
        else:
            ranges.take_back(led)
        return True, is_tested

    for part in _PARTS:
        jumps = _jumps(low, high, part)
        if follow(jumps, 2 * spare, True)[1]:  # as many again, which leaves 38
            counts = np.append(counts, jumps, axis=0)
        taken, there_are = ranges.branches
        if taken == there_are:
            break
    largest = max(abs(low).max(), abs(high).max())
    for ends in [
        *(np.full((2, len(low)), [[-1], [1]]) * min(n * largest, 2**31 - 1) for n in _BEYOND),
        np.array([low, high]),
    ]:
        jumps = _jumps(*ends)
        fits, is_tested = follow(jumps, spare, False)
        if is_tested:
            jumps = np.where(jumps == ends[0], -(2**31), jumps)
            jumps = np.where(jumps == ends[1], 2**31 - 1, jumps)
            counts = np.append(counts, jumps, axis=0)
        if fits:
            break
    return counts, ends


def _jumps(low, high, part=1.0):
    """Return rows that jump, each column at times of its own."""
    levels = np.transpose([np.roll(_JUMPS, 3 * k) for k in range(len(low))])
    levels = 0.5 + part * (levels - 0.5)
    return np.round(low + (high - low) * levels).astype(np.int64)
