"""Pictures of a claimed effect: measured, and as identified."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ..compose import amplitude
from ..inspection import binned_statistics, branch, spectrum
from ..linear import frequency_response
from ..records import by_interval, stack_records


@dataclass(frozen=True)
class Picture:
    """A picture as data: its curves and labels.

    Parameters
    ----------
    title, x_label, y_label : str
        With units in brackets.
    curves : tuple of (str, ndarray, ndarray, str)
        Label, x, y and style ("line", "points" or "dashed") of each curve.
    x_log, y_log : bool, default=False
        Whether an axis is logarithmic.
    below : Picture, default=None
        A second picture to be drawn underneath, such as the phase under the gain.
    surface : tuple of ndarray, default=None
        Contours: x (n,), y (m,), values and density of the data, both (m, n), NaN where no data
        are.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple = field(repr=False)
    x_log: bool = False
    y_log: bool = False
    below: "Picture | None" = None
    surface: tuple | None = field(default=None, repr=False)


def draw(claim):
    """Return the picture of a claim, by the kind of its edit, or the one that its effect names."""
    title = claim.effect.name.replace("_", " ").capitalize()
    name = claim.effect.picture or ("time" if claim.kind == "additive" else "curve")
    picture = _PICTURES[claim.kind if claim.kind in _PICTURES else name](title, claim)
    return _in_units(picture, claim.words)


def _in_units(picture, words):
    """Return a picture whose labels end in the units of the recording."""
    below = None if picture.below is None else _in_units(picture.below, words)
    labels = {name: words.label(getattr(picture, name)) for name in ("x_label", "y_label")}
    return replace(picture, below=below, **labels)


def _styled(x, measured, identified):
    """Return the two curves measured and identified over the same x."""
    return ("measured", x, measured, "points"), ("identified", x, identified, "line")


def _spans(signals):
    """Return the rows of each signal in the concatenation of all signals."""
    return [slice(a, b) for a, b in pairwise(np.cumsum([0, *map(len, signals)]))]


# ------------------------------------------------------------------ against a signal


def _means(x, measured, identified, by_direction=False):
    """Return curves of bin means against a signal ``x``; all are lists of one array per record."""
    rising = np.concatenate([branch(signal) > 0 for signal in x])
    sides = {", rising": rising, ", falling": ~rising} if by_direction else {"": slice(None)}
    x, measured, identified = map(np.concatenate, (x, measured, identified))
    return tuple(
        (f"{source}{label}", *binned_statistics(x[side], values[side])[:2], style)
        for source, _, values, style in _styled(x, measured, identified)
        for label, side in sides.items()
        if x[side].size
    )


def _largest_loop(x, measured, identified):
    """Return curves along the largest swing of a signal and its neighbouring swings."""
    swings = []
    for number, signal in enumerate(x):
        turns = [0, *np.flatnonzero(np.diff(branch(signal))), len(signal) - 1]
        for i, (start, stop) in enumerate(pairwise(turns)):
            rows = slice(turns[max(i - 1, 0)], turns[min(i + 2, len(turns) - 1)] + 1)
            swings.append((abs(signal[stop] - signal[start]), number, rows))
    _, number, rows = max(swings, key=lambda swing: swing[0])
    return _styled(*(signals[number][rows] for signals in (x, measured, identified)))


def _curve(title, claim, loop=False):
    """Draw the contribution of a stage against its input, by direction, or along a loop.

    A stage that owns the gain of the series is drawn against the response without it: against its
    input, the line of the gain would hide the rest.
    """
    without, measured, identified = claim.without_effect()
    x, x_label = claim.inputs(), f"its input ({claim.units[0]})"
    if claim.operator.owns_gain:
        x, x_label = without, "response without it"
    signals = x, measured, identified
    curves = _largest_loop(*signals) if loop else _means(*signals, by_direction=True)
    return Picture(title, x_label, "contribution (response)", curves)


def _balance(claim, motions, reach):
    """Return displacements, velocities, and the drive minus the forces of mass, damper and spring.

    All are lists of one array per record, in units of the response; forces are in units of the
    drive. Frequencies above ``reach`` times the resonance are removed as noise.
    """
    operator, signals = claim.operator, []
    while not hasattr(operator, "natural_frequency"):  # its friction follows a load
        operator = operator.operator
    w, zeta, gain = operator.natural_frequency, operator.damping_ratio, operator.gain
    preload = getattr(operator, "preload", 0.0)
    for record, drive, motion in zip(claim.records, claim.seen.inputs, motions, strict=True):
        # derivatives of the sine series of the motion minus the line between its ends
        n, dt = len(motion), record.dt
        line = np.linspace(motion[0], motion[-1], n)
        odd_extension = np.concatenate([motion - line, (line - motion)[-2:0:-1]])
        omega = 2.0 * np.pi * np.fft.rfftfreq(len(odd_extension), dt)
        series = np.fft.rfft(odd_extension) * np.clip(2.0 - omega / (reach * w), 0.0, 1.0)
        x, v, a = (
            np.fft.irfft((1j * omega) ** k * series, len(odd_extension))[:n] for k in range(3)
        )
        x, v = x + line - operator.intercept, v + (motion[-1] - motion[0]) / (dt * (n - 1))
        force = drive - (a / w**2 + 2.0 * zeta * v / w + x) / gain + preload
        margin = min(int(np.pi / (4.0 * w * dt)), n // 4)  # an eighth of a period at either end
        signals.append([signal[margin : n - margin] for signal in (x, v, force)])
    return zip(*signals, strict=True)


def _force(title, claim, against="displacement", loop=False):
    """Draw a force against displacement, by direction or along a loop, or against velocity."""
    over_velocity = against == "velocity"
    if claim.in_motion:
        y_label, unit = "residual force of the linear stage (drive)", "response"
        motions = claim.seen.outputs
        # behind further stages the motion is not measured: the model's motion plus the residual
        records = zip(motions, claim.measured, claim.modelled, strict=True)
        x, _, measured = _balance(claim, [stage + y - model for stage, y, model in records], 4.0)
        # over the model's velocity: the noise of the measured one would blur the jump
        _, modelled, identified = _balance(claim, motions, np.inf)
        x = modelled if over_velocity else x
    elif claim.is_part:
        y_label, unit = "residual force of the other terms (response)", claim.units[0]
        x = _rates(claim, claim.inputs()) if over_velocity else claim.inputs()
        measured, identified = claim.model_residuals(claim.without)
    else:
        return _curve(title, claim, loop)
    signals = x, measured, identified
    curves = _largest_loop(*signals) if loop else _means(*signals, by_direction=not over_velocity)
    return Picture(title, f"{against} ({unit}{'/s' if over_velocity else ''})", y_label, curves)


def _rates(claim, signals):
    return [np.gradient(u, r.dt) for u, r in zip(signals, claim.records, strict=True)]


def _rate(title, claim):
    """Draw the contribution of the rate in rate-dependent plays against the rate of the drive."""
    # the same plays at rate zero: what they lack is the contribution of the rate
    slow = replace(claim.operator, dilation=0.0, stretch=0.0, rate_weights=())
    slow = claim.structure.with_stage(claim.at, operator=slow)
    lacking = claim.model_residuals(slow.respond(claim.records))
    curves = _means(_rates(claim, claim.seen.inputs), *lacking)
    return Picture(title, "rate of the drive (drive/s)", "contribution (response)", curves)


# ------------------------------------------------------------------ against frequency


def _measured_response(claim, numbers):
    """Return frequency (Hz) and the measured response of the effect's stage, where coherent.

    The input is the response without the stage, the output the measurement. ``numbers`` are those
    of the records to use; records of each sampling interval are evaluated on their own.
    """
    records = [claim.records[i] for i in numbers]
    responses = [
        _lines(*([part[numbers[i]] for i in group] for part in (claim.without, claim.measured)), dt)
        for dt, group in by_interval(records).items()
    ]
    frequency, response = (np.concatenate(part) for part in zip(*responses, strict=True))
    order = np.argsort(frequency, kind="stable")
    return frequency[order], response[order]


def _lines(inputs, outputs, dt):
    """Return frequency (Hz) and frequency response between signals, where they are coherent."""
    sizes = [len(x) for x in inputs]
    length = min(1024, *sizes, max(sum(sizes) // 4, 4))  # several segments, even from one record
    options = {"method": "h1", "segment_length": length, "detrend": "linear"}
    pairs = zip(inputs, outputs, strict=True)
    estimate = frequency_response(*stack_records(pairs, dt=dt), **options)
    frequency, density = spectrum(np.concatenate(inputs), _spans(inputs), dt)
    usable = (np.ravel(estimate.coherence) > 0.8) & (estimate.frequency > 0.0)
    if frequency.size:  # too few samples have no spectrum
        # 60 dB below the strongest line, the input is mostly leakage of the window
        usable &= np.interp(estimate.frequency, frequency, density) > 1e-3 * density.max()
    return estimate.frequency[usable], np.ravel(estimate.response)[usable]


def _stage_response(operator, claim, highest):
    """Return frequency (Hz) and frequency response of a linear operator, from its pulse response.

    Records of longer sampling intervals add only frequencies below those of the others.
    """
    frequency, transfer = np.empty(0), np.empty(0)
    for dt, numbers in by_interval(claim.records).items():
        n_samples = max(len(claim.records[i].u) for i in numbers)
        pulse = np.zeros(n_samples)
        start = operator.init(0.0, "zero")
        at_rest = operator.run(pulse, dt, start)[0]
        pulse[1] = 1.0
        response = np.fft.rfft(operator.run(pulse, dt, start)[0] - at_rest) / np.fft.rfft(pulse)
        grid = np.fft.rfftfreq(n_samples, dt)
        below = (grid > 0.0) & (grid < frequency.min(initial=np.inf))
        frequency = np.concatenate([grid[below], frequency])
        transfer = np.concatenate([response[below], transfer])
    is_shown = frequency <= max(2.0 * highest, 5.0 * frequency[0])
    return frequency[is_shown], transfer[is_shown]


def _frequency(title, claim):
    """Draw gain and phase of the effect's stage, at both ends of the schedule if there is one."""
    numbers, stages = range(len(claim.records)), [("identified", claim.operator, "line")]
    if claim.operator is None:  # a scheduled stage is another operator at each amplitude
        schedule = claim.edits[-1]
        middle = 0.5 * (schedule.low + schedule.high)
        numbers = [i for i, r in enumerate(claim.records) if amplitude(r.u) > middle]
        ends = ("large", schedule.high, "line"), ("small", schedule.low, "dashed")
        stages = [(f"{label} amplitude", claim.stage_at(at), style) for label, at, style in ends]
    frequency, response = _measured_response(claim, numbers)
    highest = frequency.max(initial=0.0)
    curves = [("measured", frequency, response, "points")]
    curves += [
        (label, *_stage_response(stage, claim, highest), style) for label, stage, style in stages
    ]
    phases = tuple((label, f, np.degrees(np.unwrap(np.angle(h))), s) for label, f, h, s in curves)
    gains = tuple((label, f, np.abs(h), style) for label, f, h, style in curves)
    below = Picture("", "frequency (Hz)", "phase (degrees)", phases, x_log=True)
    return Picture(title, "", "gain of the missing stage", gains, True, True, below)


def _relaxation(title, claim):
    """Draw the response to a step over log time, and the gain."""
    operator, record = claim.operator, max(claim.records, key=lambda r: len(r.u))
    n = len(record.u)
    late = np.unique(np.geomspace(1, n - 1, 300).astype(int))
    step = operator.run(np.ones(n), record.dt, operator.init(0.0, "zero"))[0]
    curve = ("identified", record.dt * late, step[late], "line")
    gain = replace(_frequency("", claim), x_label="frequency (Hz)", y_log=False, below=None)
    labels = "time after a step (s)", "response to a step of one"
    return Picture(title, *labels, (curve,), x_log=True, below=gain)


# ------------------------------------------------------------------ over time


def _additive(claim):
    """Return the residual of the model without a disturbance, and the disturbance, by record."""
    courses = claim.course(claim.operator)
    signals = zip(claim.measured, claim.modelled, courses, strict=True)
    return [y - x + part for y, x, part in signals], courses


def _spectra(title, claim):
    """Draw the spectrum of the residual, with and without a disturbance."""
    without, courses = _additive(claim)
    with_it = [x - y for x, y in zip(without, courses, strict=True)]
    groups, curves = by_interval(claim.records), []
    for dt, numbers in groups.items():
        interval = f", every {dt:.3g} s" if len(groups) > 1 else ""
        for label, signals in (("without it", without), ("with it", with_it)):
            group = [signals[i] for i in numbers]
            density = spectrum(np.concatenate(group), _spans(group), dt)
            curves.append((f"{label}{interval}", *density, "line"))
    y_label = "residual (response/√Hz)"
    return Picture(title, "frequency (Hz)", y_label, tuple(curves), x_log=True, y_log=True)


def _time(title, claim):
    """Draw a disturbance in the first records, or a stage where its contribution is largest."""
    if claim.kind != "additive":  # an eighth of the record around the largest contribution
        without = claim.without
        contributions = [np.abs(x - y) for x, y in zip(claim.modelled, without, strict=True)]
        number = int(np.argmax([part.max() for part in contributions]))
        peak, n = int(np.argmax(contributions[number])), len(contributions[number])
        rows = slice(max(peak - n // 16, 0), peak + n // 16)
        time = claim.records[number].dt * np.arange(n)[rows]
        signals = (outputs[number][rows] for outputs in (claim.measured, claim.modelled))
        curves = (*_styled(time, *signals), ("without it", time, without[number][rows], "dashed"))
        return Picture(title, "time (s)", "response", curves)
    curves = []
    for i, (record, r, course) in enumerate(zip(claim.records, *_additive(claim), strict=True)):
        rows = slice(0, None, max(len(course) // 400, 1))
        time = (record.dt * np.arange(len(course)))[rows]
        curves += [(f"record {i}", time, r[rows], "points"), ("", time, course[rows], "line")]
    x_label, y_label = "time since the record's start (s)", "residual (response)"
    # with more than four records the colours would repeat
    return Picture(f"{title}, identified as lines", x_label, y_label, tuple(curves[:8]))


# ------------------------------------------------------------------ against a value per record


def _column(title, claim):
    """Draw the residual without a further column against that column, or its lagged value."""
    measured, identified = claim.model_residuals(claim.without)
    x, x_label = claim.in_column(), claim.column_name
    if "time_constant" in claim.values and claim.operator.gain:
        # the output of a first-order lag over its gain is the lagged column
        x = [response / claim.operator.gain for response in identified]
        x_label = f"{x_label}, behind the time constant"
    curves = _means(x, measured, identified)
    return Picture(title, x_label, "response not explained by the drive (response)", curves)


def _by_number(title, claim):
    """Draw gains against a value per record, or against the mean of a column in each bin."""
    number, gains = _gains(claim)
    below = None
    for label, pair in reversed(gains.items()):
        x_label = "" if below else claim.column_name
        below = Picture(
            "", x_label, f"{label}, over the model's", _styled(number, *pair), below=below
        )
    return replace(below, title=title)


def _gains(claim):
    """Return the values in ascending order, and label -> measured and identified gains at each.

    Gains are slopes against the response of the model without the dependence: of the whole
    response, and of its part that is not proportional to the drive (the opening of the loop). There
    is one value per record, or per bin of a column that moves within records.
    """
    column, drive = np.concatenate(claim.in_column()), np.concatenate([r.u for r in claim.records])
    base = np.concatenate(claim.without)
    inputs = np.column_stack([base, np.ones_like(base), drive])
    signals = np.column_stack([np.concatenate(y) for y in (claim.measured, claim.modelled)])
    stretches = _spans(claim.measured)
    if any(np.ptp(column[rows]) > 0.0 for rows in stretches):
        # a column that moves within records: bins of equally many samples
        stretches = np.array_split(np.argsort(column, kind="stable"), 24)
    stretches.sort(key=lambda rows: column[rows].mean())
    labels = {"gain": 2, "opening of the loop": 3}
    if 1.0 - np.corrcoef(base, drive)[0, 1] ** 2 < 1e-6:  # no loop
        del labels["opening of the loop"]
    return np.array([column[rows].mean() for rows in stretches]), {
        label: np.array([np.linalg.lstsq(inputs[r, :n], signals[r])[0][0] for r in stretches]).T
        for label, n in labels.items()
    }


def changes_by_number(claim):
    """Return name -> (value, standard error, unit) of an effect without an operator of its own."""
    if claim.kind == "scheduled stage":
        return _moved_modes(claim)
    if claim.kind == "start":
        return _memory(claim)
    number, gains = _gains(claim)
    name, unit, structure = claim.column_name, claim.column_unit, claim.structure
    changes = {
        f"change of the {label}": (_change(gain[0], gain[-1]), np.nan, "%")
        for label, (_, gain) in gains.items()
    }
    if claim.kind == "modulation":
        index = structure.scaled_by.index(str(claim.column))
        stds = [s for n, s in claim.result.params_std.items() if "sensitivity" in n.split("__")[-1]]
        (sensitivity,) = structure.values["scaled by", str(claim.column)]
        changes["sensitivity of the gain"] = sensitivity, stds[index], f"1/{unit}"
    else:
        for (stage, entry), (low, high) in structure.lines.items():
            if "[" not in entry and entry != "intercept":
                label = f"{stage}: {entry}".replace("_", " ")
                changes[f"change of {label}"] = _change(low, high), np.nan, "%"
    ends = {"smallest": number[0], "largest": number[-1]}
    return changes | {f"{label} {name}": (end, np.nan, unit) for label, end in ends.items()}


def _change(low, high):
    """Return the change between two values in percent of their mean absolute value."""
    return 200.0 * (high - low) / (abs(low) + abs(high) or 1.0)


def _memory(claim):
    """Return the size of the response to the input history, and how long it exceeds the noise."""
    contributions = [np.abs(x - y) for x, y in zip(claim.modelled, claim.without, strict=True)]
    residuals = [y - x for y, x in zip(claim.measured, claim.modelled, strict=True)]
    noise = np.sqrt(np.mean(np.square(np.concatenate(residuals))))
    durations = [
        record.dt * np.flatnonzero(contribution > noise).max(initial=0)
        for record, contribution in zip(claim.records, contributions, strict=True)
    ]
    largest = max(contribution.max() for contribution in contributions)
    return {
        "largest part of the response": (largest, np.nan, "response"),
        "longest time above the noise": (max(durations), np.nan, claim.words.in_time("s")),
    }


def _moved_modes(claim):
    """Return the frequencies of the modes of a scheduled stage at large and at small amplitudes."""
    stage, modes = claim.stage_at(claim.edits[-1].high), {}
    # the poles are those at large amplitudes; at small amplitudes zeros cancel them
    for label, roots in (("large", stage.poles()), ("small", stage.zeros())):
        roots = np.asarray(roots, dtype=complex)
        frequencies = np.sort(np.abs(roots[roots.imag > 0.0])) / (2.0 * np.pi)
        for i, frequency in enumerate(frequencies, start=1):
            modes[f"mode {i}, {label} amplitude"] = frequency, np.nan, claim.words.in_time("Hz")
    return modes


_PICTURES = {
    "curve": _curve,
    "loop": lambda title, claim: _force(title, claim, loop=True),
    "displacement": _force,
    "velocity": lambda title, claim: _force(title, claim, "velocity"),
    "rate": _rate,
    "frequency": _frequency,
    "relaxation": _relaxation,
    "spectrum": _spectra,
    "time": _time,
    # by the kind of the edit
    "branch": _column,
    "modulation": _by_number,
    "schedule": _by_number,
    "scheduled stage": _frequency,
    "start": _time,
}
