"""Pictures of what a model lacks: measured, and as identified."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.signal import csd, savgol_filter, welch

from ..inspection import branch, spectrum
from ._by_record import fitted_alone, gains_by_number, most_changed, quantities

__all__ = ["Picture", "draw"]


@dataclass(frozen=True)
class Picture:
    """Curves to draw: each is (label, x, y, style), style "line", "points" or "dashed".

    ``below`` is a second picture that belongs under it, such as the phase under the gain.
    """

    title: str
    x_label: str
    y_label: str
    curves: tuple
    x_log: bool = False
    y_log: bool = False
    below: "Picture | None" = None


def draw(claim):
    """Return the picture of a claim, by the way in which the effect entered."""
    if claim.kind in _OF_KINDS:
        return _OF_KINDS[claim.kind](claim)
    name = claim.effect.picture or ("time" if claim.kind == "beside" else "curve")
    return _PICTURES[name](claim)


def _title(claim, text=""):
    return f"{claim.effect.name.replace('_', ' ').capitalize()}{text}"


# ------------------------------------------------------------------ against a signal


def _binned(x, values, bins=40):
    """Return the means of two signals over bins of the first.

    Edges are halfway between those of equal width and those of equal numbers of samples: neither
    the ends of the range nor the places where the signal dwells are missed.
    """
    part = np.linspace(0.0, 1.0, bins + 1)
    low, high = np.min(x), np.max(x)
    edges = 0.5 * (low + (high - low) * part + np.quantile(x, part))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)
    full = count >= min(4, x.size)
    return tuple(np.bincount(which, v, minlength=bins)[full] / count[full] for v in (x, values))


def _compared(x, measured, identified, rising=None):
    """Return curves of means against a signal, measured and identified, by direction if given."""
    x, measured, identified = map(np.concatenate, (x, measured, identified))
    sides = {"": slice(None)}
    if rising is not None:
        rising = np.concatenate(rising)
        sides = {", rising": rising, ", falling": ~rising}
    return tuple(
        (f"{source}{label}", *_binned(x[side], values[side]), style)
        for source, values, style in (
            ("measured", measured, "points"),
            ("identified", identified, "line"),
        )
        for label, side in sides.items()
        if x[side].size
    )


def _rising(signals):
    return [branch(signal) > 0 for signal in signals]


def _largest_loop(x, measured, identified):
    """Return curves along the largest swing of a signal and those beside it."""
    swings = []
    for number, signal in enumerate(x):
        turns = [0, *np.flatnonzero(np.diff(branch(signal))), len(signal) - 1]
        for i in range(1, len(turns)):
            first, last = turns[max(i - 2, 0)], turns[min(i + 1, len(turns) - 1)]
            size = abs(signal[turns[i]] - signal[turns[i - 1]])
            swings.append((size, number, slice(first, last + 1)))
    _, number, rows = max(swings, key=lambda swing: swing[0])
    return tuple(
        (label, x[number][rows], signals[number][rows], style)
        for label, signals, style in (
            ("measured", measured, "points"),
            ("identified", identified, "line"),
        )
    )


def _curve(claim, loop=False):
    """Draw what a stage adds against what comes into it, by direction, or along a loop.

    One that carries the gain of the series is drawn against the response without it.
    """
    without, measured, identified = claim.left_out()
    x, x_label = claim.inputs(), f"what comes into it ({claim.units[0]})"
    if claim.operator.carries_scale:
        x, x_label = without, "response without it"
    if loop:
        curves = _largest_loop(x, measured, identified)
    else:
        curves = _compared(x, measured, identified, _rising(x))
    return Picture(_title(claim), x_label, "what it adds (response)", curves)


class _Balance:
    """The balance of forces of a stage: what mass, damper and linear spring leave of the drive.

    ``displacement``, ``velocity`` and ``force`` are lists of one array a record: displacement and
    velocity in units of the response, forces in units of the drive.
    """

    def __init__(self, claim, measured):
        operator = claim.operator
        w, zeta, gain = operator.natural_frequency, operator.damping_ratio, operator.gain
        self.displacement, self.velocity, self.force = [], [], []
        signals = zip(
            claim.records,
            claim.seen.inputs,
            claim.seen.outputs,
            claim.measured,
            claim.modelled,
            strict=True,
        )
        for record, drive, stage, y, model in signals:
            # behind further stages the motion is not measured: the model's, and what it leaves
            motion = stage + (y - model) if measured else stage
            window = int(2.0 * np.pi / w / record.dt / 8.0) // 2 * 2 + 1  # an eighth of a period
            window = min(window, (len(motion) - 1) // 2 * 2 + 1)
            smooth, v, a = _derivatives(motion, record.dt, window)
            x = smooth - operator.intercept
            left = drive - (a / w**2 + 2.0 * zeta * v / w + x) / gain
            left += getattr(operator, "preload", 0.0)
            inner = slice(window // 2, len(x) - window // 2)  # derivatives are poor at the ends
            self.displacement.append(x[inner])
            self.velocity.append(v[inner])
            self.force.append(left[inner])


def _derivatives(motion, dt, window):
    """Return a motion, its velocity and its acceleration, smoothed where that bends nothing."""
    if window >= 5:
        return [savgol_filter(motion, window, 3, k, dt) for k in range(3)]
    # too few samples a period for a polynomial: those of the sine series between the ends
    n = len(motion)
    ends = np.linspace(motion[0], motion[-1], n)
    odd = np.concatenate([motion - ends, (ends - motion)[-2:0:-1]])
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(odd), dt)
    transform = np.fft.rfft(odd)
    v, a = (np.fft.irfft(factor * transform, len(odd))[:n] for factor in (1j * omega, -(omega**2)))
    return motion, v + (motion[-1] - motion[0]) / (dt * max(n - 1, 1)), a


def _force(claim, against, loop=False):
    """Draw a force against displacement, by direction or along a loop, or against velocity.

    In an equation of motion it is what mass, damper and linear spring leave of the drive.
    """
    if claim.in_motion:
        y_label, units = "force that the linear stage leaves (drive)", "response"
        # against the model's velocity: the noise of a measured one would blur the jump
        forces = [_Balance(claim, measured) for measured in (True, False)]
        x = getattr(forces[against == "velocity"], against)
        measured, identified = (own.force for own in forces)
    elif claim.is_part:
        y_label, units = "force that the others leave (response)", claim.units[0]
        x = claim.inputs()
        if against == "velocity":
            x = [np.gradient(u, r.dt) for u, r in zip(x, claim.records, strict=True)]
        measured, identified = claim.lacking(claim.rest.respond(claim.records))
    else:
        return _curve(claim, loop)
    if loop:
        curves = _largest_loop(x, measured, identified)
    else:
        rising = _rising(x) if against == "displacement" else None
        curves = _compared(x, measured, identified, rising)
    units += "/s" if against == "velocity" else ""
    return Picture(_title(claim), f"{against} ({units})", y_label, curves)


# ------------------------------------------------------------------ against frequency


def _measured_response(claim, numbers):
    """Return frequency (Hz) and the measured response of the missing stage, where coherent.

    Input is the model without the stage, output the measurement: what lies between them is what
    the stage has to do. ``numbers`` are those of the records to take.
    """
    records, measured = ([own[i] for i in numbers] for own in (claim.records, claim.measured))
    length = min(1024, *(len(record.u) for record in records))
    sums = [0.0, 0.0, 0.0]
    for record, x, y in zip(records, claim.rest.respond(records), measured, strict=True):
        options = {"fs": 1.0 / record.dt, "nperseg": length, "detrend": "linear"}
        frequency, cross = csd(x, y, **options)
        for i, part in enumerate((cross, welch(x, **options)[1], welch(y, **options)[1])):
            sums[i] = sums[i] + part * len(x)
    cross, input_power, output_power = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        response = cross / input_power
        coherence = np.abs(cross) ** 2 / (input_power * output_power)
    # 60 dB below the peak what comes in is what leaks through the window
    kept = (coherence > 0.8) & (frequency > 0.0) & (input_power > 1e-6 * input_power.max())
    return frequency[kept], response[kept]


def _own_response(operator, claim, highest):
    """Return frequency (Hz) and the response of a linear operator to a pulse."""
    dt, n_samples = claim.records[0].dt, max(len(r.u) for r in claim.records)
    pulse = np.zeros(n_samples)
    start = operator.init(0.0, "zero")
    rest = operator.run(pulse, dt, start)[0]
    pulse[1] = 1.0
    transfer = np.fft.rfft(operator.run(pulse, dt, start)[0] - rest) / np.fft.rfft(pulse)
    frequency = np.fft.rfftfreq(n_samples, dt)
    kept = (frequency > 0.0) & (frequency <= max(2.0 * highest, 5.0 * frequency[1]))
    return frequency[kept], transfer[kept]


def _gain_and_phase(title, curves):
    """Return the picture of frequency responses, each (label, frequency, response, style)."""
    phase = Picture(
        "",
        "frequency (Hz)",
        "phase (degrees)",
        tuple((label, f, np.degrees(np.unwrap(np.angle(h))), s) for label, f, h, s in curves),
        x_log=True,
    )
    gains = tuple((label, f, np.abs(h), style) for label, f, h, style in curves)
    return Picture(title, "", "gain of the missing stage", gains, True, True, phase)


def _frequency(claim):
    """Draw gain and phase of what the model lacks; lines of the residual for what is beside."""
    if claim.kind == "beside":
        return _lines(claim)
    frequency, response = _measured_response(claim, range(len(claim.records)))
    highest = frequency.max(initial=0.0)
    curves = (
        ("measured", frequency, response, "points"),
        ("identified", *_own_response(claim.operator, claim, highest), "line"),
    )
    return _gain_and_phase(_title(claim), curves)


def _relaxation(claim):
    """Draw the response to a step over log time, and gain and phase."""
    operator, dt = claim.operator, claim.records[0].dt
    n = max(len(r.u) for r in claim.records)
    step = operator.run(np.ones(n), dt, operator.init(0.0, "zero"))[0]
    time = dt * np.arange(n)
    late = np.unique(np.geomspace(1, n - 1, 300).astype(int))
    curve = ("identified", time[late], step[late], "line")
    below = _frequency(claim)
    below = replace(below, x_label=below.below.x_label, y_log=False, below=None, title="")
    return Picture(
        _title(claim, " after a step"),
        "time after the step (s)",
        "response to a step of one",
        (curve,),
        x_log=True,
        below=below,
    )


def _lines(claim):
    """Draw the spectrum of what is left, with and without the disturbance."""
    edges = np.cumsum([0, *(len(r.u) for r in claim.records)])
    spans = [slice(a, b) for a, b in pairwise(edges)]
    dt = claim.records[0].dt
    left = [y - x for y, x in zip(claim.measured, claim.modelled, strict=True)]
    own = claim.disturbed()
    curves = tuple(
        (label, *spectrum(np.concatenate(signals), spans, dt), "line")
        for label, signals in (
            ("without it", [a + b for a, b in zip(left, own, strict=True)]),
            ("with it", left),
        )
    )
    return Picture(
        _title(claim), "frequency (Hz)", "residual (response / sqrt Hz)", curves, True, True
    )


def _moved(claim):
    """Draw a stage that the amplitude changes, at the smallest and at the largest."""
    schedule, series = claim.structure.schedule, claim.structure.series()
    middle = 0.5 * (schedule.low + schedule.high)
    above = [i for i, r in enumerate(claim.records) if schedule.number(r) > middle]
    frequency, response = _measured_response(claim, above)
    highest = frequency.max(initial=0.0)
    curves = [("measured, large", frequency, response, "points")]
    for label, number, style in (
        ("large", schedule.high, "line"),
        ("small", schedule.low, "dashed"),
    ):
        stage = schedule.applied(series).at(number).operator.stages[claim.at]
        curves.append((f"identified, {label}", *_own_response(stage, claim, highest), style))
    return _gain_and_phase(_title(claim, ": amplitudes"), curves)


# ------------------------------------------------------------------ over time


def _time(claim):
    """Draw a disturbance in the first records, or the stretch on which a stage does most."""
    if claim.kind == "beside":
        curves = []
        own = claim.disturbed()
        for i, record in enumerate(claim.records[:4]):
            time, part = (
                record.dt * np.arange(len(record.u)),
                slice(0, None, len(record.u) // 400 or 1),
            )
            left = claim.measured[i] - claim.modelled[i] + own[i]
            curves.append((f"record {i}", time[part], left[part], "points"))
            curves.append(("", time[part], own[i][part], "line"))
        title = _title(claim, ": measured (points) and identified (lines)")
        x_label, y_label = "time since the record's start (s)", "residual (response)"
        return Picture(title, x_label, y_label, tuple(curves))
    without = claim.rest.respond(claim.records)
    added = [np.abs(x - y) for x, y in zip(claim.modelled, without, strict=True)]
    number = int(np.argmax([part.max() for part in added]))
    own, dt = added[number], claim.records[number].dt
    middle = int(np.argmax(own))
    after = own[middle:] <= 1e-3 * own[middle]
    width = int(np.argmax(after)) if after.any() else len(after)
    rows = slice(max(middle - 2 * width - 10, 0), middle + 4 * width + 20)
    curves = tuple(
        (label, dt * np.arange(len(own))[rows], signals[number][rows], style)
        for label, signals, style in (
            ("measured", claim.measured, "points"),
            ("with it", claim.modelled, "line"),
            ("without it", without, "dashed"),
        )
    )
    return Picture(_title(claim, ", where it does most"), "time (s)", "response", curves)


# ------------------------------------------------------------------ against a number


def _rate(claim):
    """Draw by how much a loop grows with the rate of what comes into it."""
    operator, inputs = claim.operator, claim.seen.inputs
    slow = claim.with_stage(replace(operator, dilation=0.0, rate_weights=()))
    measured, identified = (
        [np.where(up, -1.0, 1.0) * own for up, own in zip(_rising(inputs), signals, strict=True)]
        for signals in claim.lacking(slow.respond(claim.records))
    )
    rates = [np.abs(np.gradient(u, r.dt)) for u, r in zip(inputs, claim.records, strict=True)]
    most = np.quantile(np.concatenate(rates), 0.98)
    kept = [rate <= most for rate in rates]
    signals = (
        [own[k] for own, k in zip(values, kept, strict=True)]
        for values in (rates, measured, identified)
    )
    y_label = "growth of the loop, half width (response)"
    return Picture(_title(claim), "rate of the drive (drive/s)", y_label, _compared(*signals))


def _column(claim):
    """Draw what the drive does not explain against a column, or what its dynamics make of it."""
    others = tuple(b for b in claim.structure.branches if b is not claim.branch)
    without = replace(claim.structure, branches=others).respond(claim.records)
    measured, identified = claim.lacking(without)
    middle = np.concatenate(identified).mean()
    gain = claim.operator.gain or 1.0
    x, x_label = claim.in_column(), claim.column_name
    if "time_constant" in claim.values:
        x, x_label = [own / gain for own in identified], f"{x_label}, behind the time constant"
    curves = _compared(x, [y - middle for y in measured], [y - middle for y in identified])
    return Picture(_title(claim), x_label, "what the drive does not explain (response)", curves)


def _gain_by_number(claim):
    """Draw the gain against the column, or the amplitude, that scales the response."""
    modulation, x, gains = gains_by_number(claim)
    ends = np.array([x.min(), x.max()])
    lines = 1.0 + modulation.sensitivity * (ends - modulation.reference)
    curves = (("measured", x, gains, "points"), ("identified", ends, lines, "line"))
    return Picture(_title(claim), claim.column_name, "gain over that of the model", curves)


def _scheduled(claim):
    """Draw what depends on a number of the record: identified, and of records fitted alone."""
    schedule = claim.structure.schedule
    low, high = (quantities(claim, number) for number in (schedule.low, schedule.high))
    drawn, ends = most_changed(low, high), np.array([schedule.low, schedule.high])
    numbers, alone = fitted_alone(claim, drawn)
    curves = []
    for name, values in zip(drawn, alone.T, strict=True):
        mean = 0.5 * (low[name][0] + high[name][0])
        curves.append((f"{name}, records alone", numbers, values / mean, "points"))
        curves.append((name, ends, np.array([low[name][0], high[name][0]]) / mean, "line"))
    return Picture(_title(claim), claim.column_name, "over its mean", tuple(curves))


_PICTURES = {
    "curve": _curve,
    "loop": lambda claim: _force(claim, "displacement", loop=True),
    "displacement": lambda claim: _force(claim, "displacement"),
    "velocity": lambda claim: _force(claim, "velocity"),
    "frequency": _frequency,
    "relaxation": _relaxation,
    "time": _time,
    "rate": _rate,
}
_OF_KINDS = {
    "branch": _column,
    "modulation": _gain_by_number,
    "schedule": _scheduled,
    "scheduled stage": _moved,
}
