"""Run a step to find the largest value of each number, and the branches that are taken.

A branch that no sample takes is run on a copy of the variables wherever it is skipped, so that the
sizes of its numbers are known, too (a trial). If that fails, the branch has no sizes.
"""

import itertools
import math
from collections import Counter

import numpy as np

from ._expressions import COMPARISONS
from ._interpreter import Interpreter

# operations that are allowed on an infinite number
_OF_INFINITY = {*COMPARISONS, "min", "max", "abs", "neg", "math.fabs", "math.copysign"}
_LONGEST_TRIAL = 1000  # iterations of a loop: in a trial it may not terminate
_FAILED = (ArithmeticError, ValueError, IndexError, NameError)
MAX_OPERATIONS = 2_300_000  # after the drive: about two seconds
_MAX_SEARCH = 1_500_000  # of these for further branches
_BITS = 50  # of the numbers of the program
_FEWER_BITS = 44  # with which a response that depends on rounding differs
_LIMITS = (16, 8, 4, 2)  # multiples of the largest input of the drive at which input is limited
_N_REST = 100  # samples
_FRACTIONS = (1.0, 1 / 16, 1 / 256)  # of the drive's range, for jumps
# relative levels: jumps between the ends every sample and every third sample, rests, ramps
_JUMPS = [0, 1] * 4 + 2 * ([0] * 3 + [1] * 3) + [0.5] * 3 + [0, 0.2, 0.4, 0.6, 0.8, 1, 0.7, 0.4]


def exponent(largest):
    """Return the binary digits before the point of numbers up to a size."""
    return math.frexp(largest)[1] if largest else 1


class Ranges(Interpreter):
    """The largest absolute value ("size") of each number over a drive.

    Numbers are distinguished by the step of the model that they belong to: ``step`` is the index of
    its call in the body of the model, None for the model itself.

    Parameters
    ----------
    model : Slice
        See :func:`~skhyst.export._composed_step.model_step`.
    state : ndarray of shape (n_states,)
    drive : ndarray of shape (n_samples, n_inputs)
    """

    _first = "Z, L, P, E = self._tables()"

    def __init__(self, model, state, drive):
        super().__init__(model, state)
        self.begin = model, state
        self._names["note"] = self._note
        self._seen, self._attempted, self._infinite = _Sizes(), _Sizes(), set()
        self._taken, self._skipped = set(), set()  # branches: each may be in both
        self._sizes, self._is_trial, self._n_left = self._seen, False, math.inf
        self._is_search = False
        for u in drive:
            self.answer(u)
        self._n_left = MAX_OPERATIONS

    def answer(self, u):
        """Return the response to the next sample of a drive, (n_inputs,)."""
        for x in u:
            self._note(self._number(None, "u"), float(x))
        return super().answer(u)

    def of(self, step, *key):
        """Return the largest size of a number, None if no sample and no trial computed it."""
        return self.size(self._numbers.get((step, *key)))

    def size(self, number):
        """Return the largest size by its key in the program that is run, an integer."""
        return self._seen.get(number, self._attempted.get(number))

    def may_be_infinite(self, step, *key):
        """Whether the number was infinite at a sample or in a trial."""
        return self._numbers.get((step, *key)) in self._infinite

    @property
    def is_cut(self):
        """Whether the number of operations was exhausted before all samples were run."""
        return self._n_left <= 0

    def search(self, n_operations):
        """Limit the number of further operations, and start no second trial of a branch."""
        self._n_left, self._is_search = min(self._n_left, n_operations), True

    @property
    def taken_branches(self):
        """Branches that samples have taken."""
        return set(self._taken)

    @property
    def branches(self):
        """Number of branches that samples have taken, and of all that are known."""
        return len(self._taken), len(self._taken | self._skipped)

    @property
    def not_taken(self):
        """Number of branches that no sample has taken, by the name of the function."""
        places = {number: place for place, number in self._numbers.items()}
        missed = (places[number] for number in self._skipped - self._taken)
        return Counter(part.function.name for (_, part), *_ in missed)

    def extend(self, drive, bits, grows):
        """Run more samples; undo them if the law fails there, or numbers grow too large.

        Parameters
        ----------
        drive : ndarray of shape (n_samples, n_inputs)
        bits : int
            Number of bits by which sizes may exceed those seen before.
        grows : bool
            Whether all sizes are updated; else only those of numbers that no sample has computed,
            or that were 0. The sizes of a trial may be far from those of samples.

        Returns
        -------
        bool
            Whether the samples were accepted; if not, the state is unchanged.
        """
        memory = self.memory()
        known, attempted = self._seen, self._attempted
        self._sizes = self._seen = _Sizes()
        self._attempted = _Sizes(attempted)
        try:
            fits = all(self._n_left <= 0 or math.isfinite(self.answer(u)) for u in drive)
        except _FAILED:
            fits = False
        sizes, self._seen = self._seen, _Sizes(known)
        self._attempted.update(attempted)
        for key, size in sizes.items():
            if size and known.get(key):
                fits = fits and exponent(size) <= exponent(known[key]) + bits
            if grows or not known.get(key):
                self._seen[key] = max(size, known.get(key, 0.0))
        self._sizes = self._seen
        if not fits:
            self.restore(memory)
        return fits

    def memory(self):
        """Return a copy of the state, for :meth:`restore`."""
        seen, attempted = _Sizes(self._seen), _Sizes(self._attempted)
        sets = (set(places) for places in (self._infinite, self._taken, self._skipped))
        return self._state.copy(), seen, attempted, *sets

    def restore(self, memory):
        """Restore the state of a :meth:`memory`, except for the number of operations left."""
        self._state[:], self._seen, self._attempted, *sets = memory
        self._infinite, self._taken, self._skipped = sets
        self._sizes = self._seen

    def keep(self, places):
        """Discard the branches that the program does not contain."""
        numbers = {self._number(*place) for place in places}
        self._taken &= numbers
        self._skipped &= numbers

    def reset_branches(self, taken):
        """Reset the branches that are taken to another set; the others count as not taken."""
        self._skipped |= self._taken - taken
        self._taken = taken

    def _tables(self):
        """Return what the program that is run calls Z, L, P and E.

        Sizes; branches that samples take; branches of which no trial is needed again; and the set
        to which a branch is added that is entered now.
        """
        tried = self._skipped if self._is_search else ()
        entered = self._skipped if self._is_trial else self._taken
        return self._sizes, self._taken, tried, entered

    def _noted(self, name, *key, operands=()):
        """Return the line that notes the size of a variable, see :class:`Interpreter`."""
        number, arguments = self._number(*key), "".join(f", {x}" for x in operands)
        return f"if not abs({name}) <= Z[{number}]: note({number}, {name}{arguments})"

    def _note(self, number, value, *operands):
        """Note a number that is larger than before, or not finite."""
        size, sizes = abs(value), self._sizes
        if size < math.inf:
            sizes[number] = max(float(size), sizes[number])
            return
        if operands and not self._is_trial:
            _, part, _ = next(key for key, other in self._numbers.items() if other == number)
            self._check(part.function.name, *operands)
        sizes.setdefault(number, 0.0)
        if size == math.inf:
            self._infinite.add(number)

    def _noted_state(self, name, step):
        return f"self._note_state({self._number(step, 's')}, {name})"

    def _note_state(self, number, state):
        ends = min(state, default=0.0), max(state, default=0.0)
        for x in ends if math.isfinite(ends[1] - ends[0]) else state:
            self._note(number, x)

    def _checked(self, op, name, part):
        if op in _OF_INFINITY:
            return None
        return f"if {name} - {name}: self._check({part.function.name!r}, {name})"

    def _check(self, function, *operands):
        if not self._is_trial and any(map(math.isinf, operands)):
            raise ValueError(
                f"'{function}' computes with an infinite number, which has no form in integers."
            )

    def _entered(self, place):
        return f"E.add({self._number(*place)})"

    def _tried(self, place, trial):
        number = self._number(*place)
        known = f"{number} in L or {number} in P"
        return f"if not ({known}): self._try({number}, {trial()}, locals())"

    def _try(self, number, trial, variables):
        """Run a trial of a branch that no sample has taken."""
        self._skipped.add(number)
        previous, self._sizes, self._is_trial = (self._sizes, self._is_trial), self._attempted, True
        try:
            self._run_trial(trial, variables)
        except _FAILED:
            pass
        finally:
            self._sizes, self._is_trial = previous

    def _counted(self, n):
        return f"self._n_left -= {n}" if n else None

    def _turns(self):
        return range(_LONGEST_TRIAL) if self._is_trial else super()._turns()


class _Sizes(dict):
    """Largest sizes by number, -1 where there is none yet."""

    def __missing__(self, number):
        return -1.0


class _Rounded(Interpreter):
    """Run a model with saturating numbers of some bits, scaled to the sizes that are known."""

    _first = "E = self.taken_branches"

    def __init__(self, ranges, bits, spare):
        super().__init__(*ranges.begin)
        self._numbers, self._units = ranges._numbers, _Units(ranges, bits)
        self._most = 2.0 ** (bits + spare)
        self._names |= {"U": self._units, "far": self._far, "common": self._common}
        self.taken_branches = set()  # by samples

    def _stored(self, name, *key):
        number = self._number(*key)
        is_within = f"-{self._most!r} <= {name} / U[{number}] <= {self._most!r}"
        rounded = f"round({name} / U[{number}]) * U[{number}]"
        return f"{name} = {rounded} if {is_within} else far({name}, U[{number}])"

    def _compared(self, names, args, frame):
        keys = ((*frame, x.args[0] if x.op == "name" else id(x)) for x in args if x.value is None)
        units = "".join(f", U[{self._number(*key)}]" for key in keys)
        return [f"common({name}{units})" for name in names]

    @staticmethod
    def _common(value, *units):
        """Return a number with the last digit of the coarser of two that are compared."""
        unit = max(units, default=math.nan)
        rounded = round(value / unit) * unit if math.isfinite(value / unit) else value
        return rounded or value  # the program compares exactly with what is below its digits

    def _far(self, value, unit):
        """Return a number that is too large, limited; without a size or not finite, as it is."""
        is_kept = math.isnan(unit) or not math.isfinite(value)
        return value if is_kept else math.copysign(self._most * unit, value)

    def _entered(self, place):
        return f"E.add({self._number(*place)})"

    def memory(self):
        """Return a copy of the state, for :meth:`restore`."""
        return self._state.copy(), set(self.taken_branches)

    def restore(self, memory):
        """Restore the state of a :meth:`memory`."""
        self._state[:], self.taken_branches = memory

    def agrees(self, drive, outputs, allowed):
        """Run a drive; return whether the responses are the given ones; if not, undo the run."""
        memory = self.memory()
        self._units.clear()  # of sizes that may have changed
        try:
            agrees = all(
                abs(self.answer(u) - y) <= allowed for u, y in zip(drive, outputs, strict=True)
            )
        except _FAILED:
            agrees = False
        if not agrees:
            self.restore(memory)
        return agrees


class _Units(dict):
    """Values of the last digit of rounded numbers, NaN for a number without a size."""

    def __init__(self, ranges, bits):
        self._ranges, self._bits = ranges, bits

    def __missing__(self, number):
        size = self._ranges.size(number)
        self[number] = 2.0 ** max(exponent(size) - self._bits, -1000) if size else math.nan
        return self[number]


def explore(ranges, counts, units, spare, answers):
    """Extend a drive by jumps between its ends, and beyond them up to limits of the input.

    Numbers may become larger under jumps and rests than under a slow drive. Jumps are over the full
    range of the drive, then over fractions of it while some branches have not been taken. The test
    uses them, too, except where a response depends on rounding, as where a law jumps.

    Parameters
    ----------
    ranges : Ranges
        After the drive has been run.
    counts : ndarray of shape (n_samples, n_inputs)
        The drive in units of the input, integers.
    units : tuple of float
        Units of input and output.
    spare : int
        Bits by which numbers may exceed their sizes under the drive and its jumps; if they exceed
        them by more, the limits of the input are set nearer to the drive.
    answers : callable
        Returns the response of the Python model to a drive.

    Returns
    -------
    counts : ndarray of shape (n_more, n_inputs)
        The drive and its extension for the test, in which limited input is at the ends of 32 bits.
    ends : ndarray of shape (2, n_inputs)
        Limits of the input.
    """
    unit, allowed = units[0], 0.25 * units[1]  # a quarter of the tolerance of the test
    drive, rounded = unit * counts, _Rounded(ranges, _FEWER_BITS, spare)
    rounded.agrees(drive, answers(drive), math.inf)
    ranges.reset_branches(set(rounded.taken_branches))
    *wider_limits, (low, high) = limits(counts)
    n_states = len(ranges.begin[1])

    def follow(jumps, bits, grows):
        """Run jumps; return whether they are accepted, and whether the test can use them."""
        nonlocal drive
        taken_before = ranges.taken_branches
        if not ranges.extend(unit * jumps, bits, grows):
            return False, False
        extended = np.append(drive, unit * jumps, axis=0)
        is_tested = not ranges.is_cut and rounded.agrees(
            unit * jumps, answers(extended)[len(drive) :], allowed
        )
        if is_tested:
            drive = extended
            ranges.reset_branches(set(rounded.taken_branches))
        else:
            ranges.reset_branches(taken_before)
        return True, is_tested

    def reaches_branches(jumps):
        """Run jumps; return whether the test can use them for further branches; else undo them."""
        nonlocal drive
        before, taken = (drive, ranges.memory(), rounded.memory()), ranges.branches[0]
        if follow(jumps, spare, False)[1] and ranges.branches[0] > taken:
            return True
        drive = before[0]
        ranges.restore(before[1])
        rounded.restore(before[2])
        return False

    for fraction in _FRACTIONS:  # smaller jumps only if larger ones have missed a branch
        jumps = _jumps(low, high, fraction)
        # sizes may grow by twice the spare bits, which leaves 38
        if follow(jumps, 2 * spare, True)[1]:
            counts = np.append(counts, jumps, axis=0)
        taken, known = ranges.branches
        if taken == known:
            break
    # the widest limits of the input at which no number exceeds its spare bits
    for ends in (*wider_limits, np.array([low, high])):
        jumps = _jumps(*ends)
        fits, is_tested = follow(jumps, spare, False)
        if is_tested:  # with the extreme integers, so that the test sees the input limited
            jumps = np.where(jumps == ends[0], -(2**31), jumps)
            jumps = np.where(jumps == ends[1], 2**31 - 1, jumps)
            counts = np.append(counts, jumps, axis=0)
        if fits:
            break
    ranges.search(_MAX_SEARCH)
    searches = (_searches(*pair, n_states) for pair in ((low, high), ends))
    for jumps in itertools.chain(*searches):
        taken, known = ranges.branches
        if taken == known or ranges.is_cut:
            break
        if reaches_branches(jumps):
            counts = np.append(counts, jumps, axis=0)
    return counts, ends


def check_fast(ranges, counts, units, spare, answers):
    """Raise a ValueError if the numbers of a program have too few digits for fast drives.

    The error of its response to jumps and random values within the range of the drive must be at
    most a unit of output, or twice the change of the Python model's response under a rounding of
    the input. Parameters are those of :func:`explore`.
    """
    ends = counts.min(axis=0), counts.max(axis=0)
    drive = units[0] * fast_drive(*ends)
    rounding = 2.0**-_BITS * (1.0 - 2.0 * (np.arange(len(drive)) % 2))[:, None]
    expected, *disturbed = (answers(drive * (1.0 + sign * rounding)) for sign in (0, 1, -1))
    allowed = max(units[1], 2.0 * np.abs(np.subtract(disturbed, expected)).max())
    rounded = _Rounded(ranges, _BITS, spare)
    try:
        error = np.abs([rounded.answer(u) for u in drive] - expected).max()
    except _FAILED:
        error = math.inf
    if np.isfinite(expected).all() and not error <= allowed:
        raise ValueError(
            "Integers cannot hold the response to fast drives: it is wrong by "
            f"{error / units[1]:.3g} units of output. The parameters may be far from what the data "
            "determine (see 'identifiability_'). The 'output_unit' must be larger, or the 'dtype' "
            "'float64'."
        )


def fast_drive(low, high):
    """Return integer rows of jumps between the ends, and of random values."""
    return np.append(_jumps(low, high), _noise(low, high), axis=0)


def limits(counts):
    """Return possible limits of the input (2, n_inputs), from the widest to the drive's own."""
    low, high = counts.min(axis=0), counts.max(axis=0)
    low, high = low - (low == high), high + (low == high)
    largest = max(abs(low).max(), abs(high).max())
    symmetric = np.full((2, len(low)), [[-1], [1]])
    return [*(symmetric * min(n * largest, 2**31 - 1) for n in _LIMITS), np.array([low, high])]


def _jumps(low, high, fraction=1.0):
    """Return rows of jumps between the ends."""
    return _rows(0.5 + fraction * (np.array(_JUMPS) - 0.5), low, high)


def _noise(low, high):
    """Return rows of random values."""
    return _rows(np.random.default_rng(0).random(_N_REST), low, high)


def _rows(levels, low, high):
    """Return rows at levels relative to the ends; each column is there at other samples."""
    levels = np.transpose([np.roll(levels, 3 * k) for k in range(len(low))])
    return np.round(low + (high - low) * levels).astype(np.int64)


def _searches(low, high, n_states):
    """Yield drives for branches that jumps do not take.

    Values one unit apart, a ramp over the pieces of a curve, random values, rests longer than the
    dynamics, and swings whose amplitude grows, and then falls so slowly that each turning point
    stays in memory.
    """
    for level in (0.0, 1.0, 0.5):
        nudges = np.array([0, 1, 0, 0, -1, 0, -1, 1, 0])[:, None]
        yield np.clip(_rows(np.full(len(nudges), level), low, high) + nudges, low, high)
    ramp = np.linspace(0.0, 1.0, _N_REST)
    yield _rows(np.append(ramp, ramp[::-1]), low, high)
    yield _noise(low, high)
    yield _rows(np.repeat([1.0, 0.0], 2 * _N_REST), low, high)
    amplitudes = np.append(np.linspace(0.0, 1.0, _N_REST), np.linspace(1.0, 0.0, n_states + 2))
    swings = 0.5 * amplitudes * (-1.0) ** np.arange(len(amplitudes))
    for fraction in _FRACTIONS:
        yield _rows(0.5 + fraction * swings, low, high)
