"""What a program computes, whatever its language: a step, its rest, and the drives of its test."""

from dataclasses import dataclass
from numbers import Real
from pathlib import Path

import numpy as np

from .._files import replacing
from .._validation import finite_numbers
from ..operators import Signal, Stepper
from ..records import valid_interval
from ._bounds import longest_loops
from ._composed_step import model_step
from ._interpreter import Interpreter
from ._rest import rest_rules
from ._single import check_single, checked_ends
from ._tunable import derived, entries_of

TOLERANCES = {"float64": 1e-12, "float32": 1e-6}  # as fractions of the response's range
_N_TEST = 200


class Source:
    """A model as a stepper and a way to make it again; parameters are those of :func:`to_c`.

    Attributes
    ----------
    stepper : Stepper
        Its state is that from which the program begins.
    dt : float or None
        Sampling interval in s, if it is known.
    step : Slice
        The step of the whole model.
    n_inputs : int
    by_row : bool
        Whether a step takes an array.
    entries : tuple of Entry
        Parameters that can be changed at run time.
    tuned : Derived or None
        The constants that depend on them.
    """

    def __init__(self, model, dtype, dt, initial_state, u0, tunable, form, tolerance):
        if form not in ("table", "step"):
            raise ValueError(
                f"The 'form' parameter of to_c must be 'table' or 'step'. Got {form!r} instead."
            )
        if tolerance is not None and not (isinstance(tolerance, Real) and 0.0 < tolerance < np.inf):
            raise ValueError(
                "The 'tolerance' parameter of to_c must be a number above 0 or None. Got "
                f"{tolerance!r} instead."
            )
        self.what, self.u0, self.entries, self.tuned = type(model).__name__, u0, (), None
        self._tolerance = TOLERANCES.get(dtype) if tolerance is None else float(tolerance)
        self._dtype, self._form, self._given = dtype, form, (dt, initial_state)
        self._remembers = isinstance(model, Stepper) or hasattr(model, "bound")
        if tunable:
            if dtype == "int32" or self._remembers:
                raise ValueError(
                    "The 'tunable' parameter of to_c must be empty for 'int32', whose numbers are "
                    "sized by their constants, and for steppers, whose model is not known. Got "
                    f"{tunable!r} instead."
                )
            self.entries, self._with_values = entries_of(model, tunable)
            # as for other values: zeros become tiny, which keeps the structure of the step the same
            model = self._with_values([entry.value for entry in self.entries])
        self._model = model
        self.stepper, self.dt = self._made(model, u0)
        self.compiled_step = self.stepper.compiled_step
        only = self.compiled_step.double_only
        if only and not (dtype == "float64" or (dtype == "float32" and tolerance)):
            raise ValueError(
                f"The 'dtype' parameter of to_c must be 'float64' for {only}, or 'float32' with a "
                f"'tolerance'. Got {dtype!r} instead."
            )
        self.by_row = self.compiled_step.n_inputs is not None
        self.n_inputs = self.compiled_step.n_inputs or 1
        if tunable:
            self.tuned = derived(
                self.entries, lambda x: self._at_rest(u0, self._with_values(x)).compiled_step
            )
        self.step = model_step(self.compiled_step, tuned=self.tuned)

    def _made(self, model, level):
        stepper, dt = stepper_of(model, *self._given, level)
        return (_compacted(stepper) if self._form == "step" else stepper), dt

    def _at_rest(self, level, model):
        """Return the stepper of a model at rest at a level, (n_inputs,) or as ``u0``."""
        if np.ndim(level) and not self.by_row:
            level = float(level[0])
        return self._made(model, level)[0]

    @property
    def rest(self):
        """One sample (1, n_inputs) at which the device rests."""
        return _at(self.u0, 1, self.n_inputs)

    def inputs(self, drive):
        """Return the drive of the test, (n_samples, n_inputs); None stands for the default one."""
        if drive is not None:
            return _columns(drive, self.n_inputs)
        phase = np.arange(_N_TEST) / _N_TEST  # turning points at many levels, a smooth start
        swing = np.sin(2 * np.pi * 5 * phase) * (1.0 - phase) + 0.3 * np.sin(2 * np.pi * 17 * phase)
        return _at(self.u0, _N_TEST, self.n_inputs) + swing[:, None] / 1.3

    def deviates(self, drive):
        """Return lines of a comment: how far the response without tables is from the model's."""
        if self._form == "table":
            return []
        expected = answers(stepper_of(self._model, *self._given, self.u0)[0], drive)
        error = np.abs(answers(self.stepper, drive) - expected).max()
        error /= np.ptp([0.0, *expected]) or 1.0
        return [
            f"Laws are integrated instead of looked up: within {1.05 * error:.1e} of the range",
            "of the model's response under the drive of the test.",
        ]

    def bounds(self):
        """Return lines of a comment: how often long loops run at most, by their functions."""
        found = longest_loops(self.step).items()
        return [f"At most {n} turns of a loop per call of '{name}'." for name, n in found]

    def tested(self, drive):
        """Return the :class:`Expected` of the program in floating point under a drive."""
        number = np.dtype(self._dtype).type
        drive = self.inputs(drive).astype(number).astype(float)
        names, limits = conditions(self.stepper, True), self.compiled_step.limits
        rules = ends = level = values = checked = missed = None
        if not self._remembers:
            rules, ends = rest_rules(lambda at: self._at_rest(at, self._model), drive)
        tuned = () if self.tuned is None else self.tuned.first
        runs = [(self.stepper.copy(), tuned)]
        # without rules a program cannot be put to rest at another input, and is not tested so
        if rules is not None:
            level = (0.61 * drive.max(axis=0) + 0.39 * drive.min(axis=0)).astype(number)
            runs.append((self._at_rest(level.astype(float), self._model), tuned))
        if self.tuned is not None:
            low, high = np.transpose([(entry.low, entry.high) for entry in self.entries])
            values = low + (high - low) * np.where(np.arange(len(low)) % 2, 0.3, 0.7)
            values = values.astype(number).astype(float)
            changed = self._with_values(values)
            changed_stepper = self._at_rest(self.u0, changed)
            changed_stepper.state = self.stepper.state
            if changed_stepper.compiled_step.limits != limits:
                limits = None  # they are parameters
            others, _ = rest_rules(lambda at: self._at_rest(at, changed), drive)
            pairs = zip(rules or (), others or (), strict=False)
            if not (rules and others and all(a.agrees(b) for a, b in pairs)):
                rules = None  # the state at rest depends on the parameters, which may change
                del runs[1:]
            runs.append((changed_stepper, self.tuned.at(values)))
        outputs = [answers(stepper, drive) for stepper, _ in runs]
        span = np.ptp([0.0, *np.ravel(outputs)]) or 1.0
        tolerance = max(self._tolerance, 2.0 * self._rounded(drive, runs, outputs, number) / span)
        if self._dtype == "float32":
            for (stepper, constants), y in zip(runs, outputs, strict=True):
                check_single(self.step, stepper.state, drive, y, span, tolerance, constants)
            checked, missed = self._checked(drive, runs, span, tolerance)
        bits = [certain_bits(stepper, drive, names, number) for stepper, _ in runs]
        last = self.stepper.output
        last = answers(self.stepper, self.rest)[0] if last is None else last
        extremes = self._extremes(drive, number)
        bits.append(certain_bits(self.stepper, extremes, names, number, checked))
        known = rules, ends, level, values, checked, missed
        return Expected(drive, outputs, span, tolerance, last, *known, limits, extremes, bits)

    def _extremes(self, drive, number):
        """Return inputs beyond the drive and the range of the fit, (n_samples, n_inputs)."""
        low, high = self._ranges(drive)
        size = (high - low) + (high == low)
        largest = 0.9 * float(np.finfo(number).max)
        levels = np.array([0.5, 1.3, 1.3, -0.3, -0.3, 17.0, -16.0, 0.5, 0.5])[:, None]
        rows = np.concatenate([low + size * levels, np.full((6, len(low)), largest)])
        rows[-5::2] *= -1.0
        rows = np.concatenate([rows, np.tile(0.5 * (low + high), (3, 1))])
        return rows.astype(number).astype(float)

    def _ranges(self, drive):
        """Return the least and the largest values of the drive and of the fit, (2, n_inputs)."""
        ranges = np.array([drive.min(axis=0), drive.max(axis=0)])
        for k, signal in enumerate(self.stepper.inputs):
            known = [x for x in (signal.low, signal.high) if np.isfinite(x)]
            ranges[:, k] = np.min([*ranges[:, k], *known]), np.max([*ranges[:, k], *known])
        return ranges

    def _checked(self, drive, runs, span, tolerance):
        """Return a range of the input, (2, n_inputs), and the error of single precision in it."""
        ranges = self._ranges(drive)
        found = [
            checked_ends(self.step, stepper, ranges, span, tolerance, answers, constants)
            for stepper, constants in runs[:: max(len(runs) - 1, 1)]
        ]
        ends, errors = zip(*found, strict=True)
        low, high = np.transpose(ends, (1, 0, 2))
        return np.array([low.max(axis=0), high.min(axis=0)]), max(errors)

    def _rounded(self, drive, runs, outputs, number):
        """Return the largest change of the responses under rounding of input and constants."""
        # errors of the input: alternating, and of one sign
        eps = np.finfo(number).eps
        rounding = 0.5 * eps * (1.0 - 2.0 * (np.arange(len(drive)) % 2))
        largest = max(
            np.abs(answers(stepper, drive * (1.0 + relative_error[:, None])) - output).max()
            for (stepper, _), output in zip(runs, outputs, strict=True)
            for relative_error in (rounding, -rounding, abs(rounding), -abs(rounding))
        )
        if self.tuned is not None:  # and of the constants, which the program computes
            alternating = 1.0 - 2.0 * (np.arange(len(self.tuned.first)) % 2)
            for sign in (alternating, -alternating):
                rounded = runs[-1][1] * (1.0 + 2.0 * eps * sign)
                device = Interpreter(self.step, self.stepper.state, rounded)
                largest = max(
                    largest, np.abs([device.answer(u) for u in drive] - outputs[-1]).max()
                )
        return largest


@dataclass(frozen=True)
class Expected:
    """What the test of a program in floating point expects.

    Parameters
    ----------
    drive : ndarray of shape (n_samples, n_inputs)
    outputs : list of ndarray of shape (n_samples,)
        Responses from the first state; from rest at another level, if that is known; with other
        parameters, if they can be changed.
    span, tolerance : float
        Range of the outputs, and the allowed error, relative to it.
    last : float
        Output before the first sample.
    rules : list of Rule or None
        Rules that put the parts to rest, None if they are not known.
    ends : ndarray of shape (2, n_inputs) or None
        Inputs for which the rules hold.
    level : ndarray of shape (n_inputs,) or None
        The other level of rest.
    values : ndarray of shape (n_entries,) or None
        Values of the other parameters.
    checked : ndarray of shape (2, n_inputs) or None
        Inputs for which single precision has been tested, None in double precision.
    missed : float or None
        Its largest error under jumps and random values within the drive, relative to the range.
    limits : tuple of (float, float, float) or None
        Of the output, see :class:`~skhyst.operators.CompiledStep`.
    extremes : ndarray of shape (n_extremes, n_inputs)
        Inputs after which the status is checked, and that the output is within limits.
    bits : list of ndarray of shape (n_samples, 2)
        Of each of the outputs, and of the extremes, see :func:`certain_bits`.
    """

    drive: np.ndarray
    outputs: list
    span: float
    tolerance: float
    last: float
    rules: list | None
    ends: np.ndarray | None
    level: np.ndarray | None
    values: np.ndarray | None
    checked: np.ndarray | None
    missed: float | None
    limits: tuple | None
    extremes: np.ndarray
    bits: list

    def precision(self):
        """Return lines of a comment: how single precision has been tested, if it is used."""
        if self.checked is None:
            return []
        low, high = (", ".join(f"{x:.6g}" for x in end) for end in self.checked)
        return [
            "Single precision has been tested with jumps and random values",
            f"from {low} to {high}.",
            f"Within the drive's range the largest error was {self.missed:.1e} of the response's;",
            "that of other drives may be larger.",
        ]


def conditions(stepper, is_real):
    """Return the names of the conditions that a status can have; each has a bit, in this order."""
    names = [flag for flag, _ in stepper.compiled_step.flags] + ["refused"] * is_real
    names += ["extrapolated"] * bool(stepper.watched)
    return list(dict.fromkeys([*names, "overrange"]))


def certain_bits(stepper, drive, names, number, checked=None):
    """Return the bits of the status at each sample that a program in any rounding has.

    Parameters
    ----------
    stepper : Stepper
        In its first state.
    drive : ndarray of shape (n_samples, n_inputs)
    names : list of str
        Of the bits, see :func:`conditions`.
    number : numpy scalar type, or float
        Type of the numbers of the program; or the unit of the input, for integers.
    checked : ndarray of shape (2, n_inputs), optional
        Inputs beyond which numbers may differ from those of Python, until the next start.

    Returns
    -------
    ndarray of int of shape (n_samples, 2)
        Bits that are set, and bits that are not set, whatever rounding of the input makes.
    """
    if isinstance(number, float):
        error = 0.25 * number * np.ones_like(drive)
    else:
        error = 8.0 * np.finfo(number).eps * drive
    error[1::2] *= -1.0
    all_bits, row = 2 ** len(names) - 1, stepper.compiled_step.n_inputs
    bits = np.tile([all_bits, all_bits], (len(drive), 1))
    largest = np.finfo(float).max
    # rounding decides of limits and ranges alone
    for sign in (0.0, 1.0, -1.0) if {*names} - {"refused", "overrange"} else (0.0,):
        device = stepper.copy()
        device.state = stepper.state  # with no sample before the first
        for k, u in enumerate(np.clip(drive + sign * error, -largest, largest)):
            with np.errstate(all="ignore"):
                device.step(u if row else u[0])
            status = device.status
            found = sum(2**i for i, name in enumerate(names) if name in status)
            bits[k] &= found, all_bits - found
    if checked is not None:
        lost = np.logical_or.accumulate(((drive < checked[0]) | (drive > checked[1])).any(axis=1))
        bits[lost] = 2 ** names.index("overrange"), 0
    return bits


def whole_limits(stepper, unit):
    """Return a stepper whose limits are whole units of the output, rounded inwards.

    Raises
    ------
    ValueError
        If no whole number of units is within them.
    """
    limits = stepper.compiled_step.limits
    if limits is None:
        return stepper
    low, high, change = (
        x if np.isinf(x) else unit * _rounded_to(round_, x / unit)
        for round_, x in zip((np.ceil, np.floor, np.floor), limits, strict=True)
    )
    if low > high or change < unit:
        raise ValueError(
            "The 'output_unit' parameter of to_c must be at most the largest change of the drive "
            f"from sample to sample, {limits[2]:g}, and the range of its limits, "
            f"{limits[1] - limits[0]:g}. Got {unit!r} instead."
        )
    step = stepper.compiled_step.within(low, high, change)
    signals = {"inputs": stepper.inputs, "result": stepper.result, "preview": stepper.preview}
    other, state, held = Stepper(step, stepper.dt, **signals), stepper.state, list(step.held)
    state[held] = np.clip(state[held], low, high)
    other.state = state
    return other


def _rounded_to(round_, x):
    """Return a number rounded up or down, unless it is whole but for rounding."""
    near = np.round(x)
    return float(near if abs(x - near) <= 4.0 * np.finfo(float).eps * abs(x) else round_(x))


def answers(stepper, drive):
    """Return the response (n_samples,) of the Python model to a drive (n_samples, n_inputs)."""
    device, row = stepper.copy(), stepper.compiled_step.n_inputs
    return np.array([device.step(u if row else u[0]) for u in drive])


def _compacted(stepper):
    """Return a stepper in the same state whose laws are integrated instead of looked up."""
    step = stepper.compiled_step.compacted()
    if not np.array_equal(stepper.state, stepper.compiled_step.state):
        raise ValueError(
            "The 'form' parameter of to_c must be 'table' for a stepper that has been run. Got "
            "'step' instead."
        )
    signals = {"inputs": stepper.inputs, "result": stepper.result, "preview": stepper.preview}
    return Stepper(step, stepper.dt, **signals)


def stepper_of(model, dt, initial_state, u0):
    """Return a model as a stepper, and the sampling interval, None if it is not known."""
    dt = None if dt is None else valid_interval(dt, "to_c")
    finite_numbers(u0, "to_c", "u0", "a finite number, or one for each input")
    if hasattr(model, "stepper"):
        options = {} if initial_state is None else {"initial_state": initial_state}
        model = model.stepper(dt, *([u0] if np.any(u0) else []), **options)
    elif hasattr(model, "init"):
        if dt is None:
            raise ValueError("The 'dt' parameter of to_c must be given, in s, for an operator.")
        model = model.compiled_step(dt, model.init(u0, initial_state or "rest"))
    if hasattr(model, "bound"):
        model = Stepper(model)
    if not isinstance(model, Stepper):
        raise TypeError(
            "The 'model' parameter of to_c must be a fitted model, or have a 'stepper' that "
            f"is a Stepper, or an operator. Got {model!r} instead."
        )
    return model, model.dt if dt is None else dt


def legend(stepper, dt, units):
    """Return lines that describe input and output, and lines on the preview.

    Returns
    -------
    signals : list of str
        One for each input, and for the output.
    preview : list of str
    """
    input_unit, output_unit = units
    n = stepper.compiled_step.n_inputs
    signals = (*(stepper.inputs or (Signal("input"),) * (n or 1)), stepper.result)
    signals = [*signals[:-1], signals[-1] or Signal("output")]
    listed = isinstance(input_unit, list | tuple)
    named = [*(input_unit if listed else [input_unit] * (n or 1)), output_unit]
    if len(named) != len(signals) or not all(u is None or isinstance(u, str) for u in named):
        raise ValueError(
            "The 'input_unit' and 'output_unit' parameters of to_c must be names of units, of the "
            f"inputs one name or {n or 1}. Got {input_unit!r} and {output_unit!r} instead."
        )
    lines = []
    for unit, signal in zip(named, signals, strict=True):
        text = signal.name + (f" in {unit}" if unit else "")
        if signal.is_limited:
            text += f"; range: {signal.low:.9g} to {signal.high:.9g}"
            text += f" and {signal.rate:.9g} per s" if np.isfinite(signal.rate) else ""
        for mark in ("*/", "/*", "(*", "*)", "??", "??"):  # those of comments, and of trigraphs
            text = text.replace(mark, " ".join(mark))
        lines.append(" ".join(text.split()))
    if not stepper.preview:
        return lines, []
    seconds = "" if dt is None else f", {stepper.preview * dt:.6g} s,"
    return lines, [
        f"What it returns belongs to the input {stepper.preview} samples{seconds} earlier: give",
        "the reference early by this preview.",
    ]


def range_tests(stepper, eps):
    """Yield what tells that a signal has left the range of the fit.

    Parameters
    ----------
    stepper : Stepper
    eps : float
        Relative rounding of the numbers of the program, by which the range is wider.

    Yields
    ------
    k : int
        Number of the signal among the inputs and the output.
    relation : str
        ``"<"`` or ``">"``.
    value : float
        What the signal, or its change, is compared with.
    place : int or None
        Number of the signal among those whose last value is needed for the change; None: the
        signal itself is compared.
    """
    n_moving = 0
    for k, low, high, change in stepper.watched:
        rounding = eps * max(abs(x) for x in (low, high, 0.0) if np.isfinite(x))
        ends = ("<", low - rounding, None), (">", high + rounding, None)
        for relation, value, place in (*ends, (">", change + 2.0 * rounding, n_moving)):
            if np.isfinite(value):
                yield k, relation, value, place
        n_moving += bool(np.isfinite(change))


def written(folder, texts):
    """Write files by their names into a folder, which is created if it is missing."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / file for file in texts]
    with replacing(*paths) as parts:
        for part, text in zip(parts, texts.values(), strict=True):
            part.write_text(text, encoding="utf-8")
    return paths


def _columns(drive, n_inputs):
    """Return the first ``n_inputs`` columns of a drive, (n_samples, n_inputs)."""
    drive = np.asarray(drive, dtype=float)
    drive = drive[:, None] if drive.ndim == 1 else drive
    if drive.shape[1] < n_inputs:
        raise ValueError(
            f"The 'drive' parameter of to_c must have {n_inputs} columns. Got {drive.shape[1]} "
            "instead."
        )
    return drive[:, :n_inputs]


def _at(u0, n_samples, n_inputs):
    """Return a constant input, (n_samples, n_inputs)."""
    return np.zeros((n_samples, n_inputs)) + np.ravel(u0)[:n_inputs]
