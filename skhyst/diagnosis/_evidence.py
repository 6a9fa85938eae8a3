"""What a claim rests on: a sentence, numbers with their errors, and a picture."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import csd, welch

__all__ = ["Evidence", "Picture", "gather_evidence"]

_COHERENT = 0.8  # squared coherence above which a measured frequency response is drawn
_BINS = 40
_DRAWN_RECORDS = 5


@dataclass(frozen=True)
class Picture:
    """Curves to draw: each is (label, x, y, style), style "line", "points" or "dashed"."""

    title: str
    x_label: str
    y_label: str
    curves: tuple
    x_log: bool = False
    y_log: bool = False


@dataclass(frozen=True)
class Evidence:
    """What a claim rests on.

    ``numbers`` maps a name to (value, standard error or NaN, unit).
    """

    effect: str
    statement: str
    numbers: dict
    picture: Picture


def gather_evidence(effect, structure, result, records, before, after):
    """Return the evidence for a claimed effect.

    Parameters
    ----------
    effect : Effect
    structure : Structure
        The augmented model at its solution.
    result : IdentificationResult
        Of the augmented model, fitted on all records.
    records : sequence of RecordData
    before, after : Contestant
        Held-out residuals of the declared and of the augmented model.
    """
    name = effect.name
    values = _values(name, structure, result)
    share = 100.0 * (1.0 - (after.error / before.error) ** 2) if before.error > 0.0 else 0.0
    if effect.beside:
        operator = structure.disturbances[structure.beside_names.index(name)]
        describe = _BESIDE.get(name, _other_beside)
        statement, numbers, picture = describe(
            operator, values, result, structure, records, before, after
        )
    else:
        at = structure.names.index(name)
        describe = _IN_SERIES.get(name, _other_stage)
        statement, numbers, picture = describe(
            structure.operators[at], values, structure, at, records
        )
    statement = (
        f"{statement} The augmented model removes {share:.1f} % of the power of the declared "
        "model's held-out residual."
    )
    return Evidence(name, statement, numbers, picture)


def _values(name, structure, result):
    """Return the effect's own parameters: name -> (value, standard error)."""
    marks = [f"{name}__"]
    if name in structure.beside_names:
        marks.append(f"disturbance{structure.beside_names.index(name)}__")
    found = {}
    for key, value in result.params.items():
        for mark in marks:
            if key.startswith(mark) or f"__{mark}" in key:
                found[key.split(mark, 1)[1]] = (value, result.params_std[key])
    return found


# ------------------------------------------------------------------ stages of the series


def _measured_response(structure, at, records):
    """Return frequency (Hz), the measured response of the missing stage, and its coherence.

    Input is the model without the stage, output the measurement: what lies between them is what
    the stage has to do.
    """
    rest = replace(
        structure, operators=tuple(op for i, op in enumerate(structure.operators) if i != at)
    )
    length = min(1024, *(len(record.u) for record in records))
    sums = [0.0, 0.0, 0.0]
    for record, x in zip(records, rest.run(records), strict=True):
        options = {"fs": 1.0 / record.dt, "nperseg": length, "detrend": "linear"}
        frequency, cross = csd(x, record.y, **options)
        for i, part in enumerate((cross, welch(x, **options)[1], welch(record.y, **options)[1])):
            sums[i] = sums[i] + part * len(x)
    cross, input_power, output_power = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        response = cross / input_power
        coherence = np.abs(cross) ** 2 / (input_power * output_power)
    kept = (coherence > _COHERENT) & (frequency > 0.0)
    return frequency[kept], response[kept]


def _gain_picture(title, operator, structure, at, records):
    frequency, response = _measured_response(structure, at, records)
    dt = records[0].dt
    grid = np.geomspace(1.0 / (dt * max(len(r.u) for r in records)), 0.5 / dt, 300)
    return Picture(
        title,
        "frequency (Hz)",
        "gain of the missing stage",
        (
            ("measured", frequency, np.abs(response), "points"),
            ("identified", grid, np.abs(operator.frequency_response(grid)), "line"),
        ),
        x_log=True,
        y_log=True,
    )


def _lag(operator, values, structure, at, records):
    tau, std = values["time_constant"]
    corner = 1.0 / (2.0 * np.pi * tau)
    numbers = {
        "time constant": (tau, std, "s"),
        "corner frequency": (corner, corner * std / tau, "Hz"),
    }
    statement = f"Gain and phase fall together above {corner:.4g} Hz, as behind a low-pass."
    return statement, numbers, _gain_picture("Low-pass", operator, structure, at, records)


def _resonance(operator, values, structure, at, records):
    key = next(key for key in values if key.startswith("natural_freq"))
    damping = key.replace("natural_frequencies", "damping_ratios")
    damping = damping.replace("natural_frequency", "damping_ratio")
    (w, w_std), (zeta, zeta_std) = values[key], values[damping]
    frequency = w / (2.0 * np.pi)
    numbers = {
        "natural frequency": (frequency, w_std / (2.0 * np.pi), "Hz"),
        "damping ratio": (zeta, zeta_std, ""),
    }
    statement = f"A mode at {frequency:.4g} Hz with damping ratio {zeta:.3g} is excited."
    return statement, numbers, _gain_picture("Resonance", operator, structure, at, records)


def _delay(operator, values, structure, at, records):
    delay, std = values["delay"]
    frequency, response = _measured_response(structure, at, records)
    phase = np.unwrap(np.angle(response)) if len(response) else np.empty(0)
    statement = f"The phase falls in proportion to frequency, {delay:.4g} s, and the gain stays."
    picture = Picture(
        "Delay",
        "frequency (Hz)",
        "phase of the missing stage (rad)",
        (
            ("measured", frequency, phase, "points"),
            ("identified", frequency, -2.0 * np.pi * frequency * delay, "line"),
        ),
    )
    return statement, {"delay": (delay, std, "s")}, picture


def _creep(operator, values, structure, at, records):
    n = np.size(operator.compliances)
    scalar = (
        [("compliances", "time_constants")]
        if n == 1 and "compliances" in values
        else [(f"compliances[{i}]", f"time_constants[{i}]") for i in range(n)]
    )
    numbers, total = {}, 0.0
    for i, (compliance, constant) in enumerate(scalar, start=1):
        c, c_std = values[compliance]
        total += c
        numbers[f"time constant {i}"] = (*values[constant], "s")
        numbers[f"creep {i} over the prompt response"] = (c, c_std, "")
    numbers["creep over the settled response"] = (total / (1.0 + total), np.nan, "")
    dt, span = records[0].dt, max(len(r.u) * r.dt for r in records)
    time = np.geomspace(dt, span, 200)
    step = 1.0 + sum(
        c * -np.expm1(-time / tau)
        for c, tau in zip(operator.compliances, operator.time_constants, strict=True)
    )
    statement = (
        f"After each change of the drive the response relaxes by another {100 * total:.3g} % of "
        "its prompt part."
    )
    picture = Picture(
        "Creep after a step",
        "time after the step (s)",
        "response over its prompt part",
        (("identified", time, step, "line"),),
        x_log=True,
    )
    return statement, numbers, picture


def _curve_picture(title, operator, structure, at, records, y_label="deviation (response)"):
    """Draw what the stage adds against its input, and what was measured, by branch."""
    inputs = structure.run(records, last=at)
    rest = replace(
        structure, operators=tuple(op for i, op in enumerate(structure.operators) if i != at)
    )
    without = rest.run(records)
    v = np.concatenate(inputs)
    missing = np.concatenate([r.y - x for r, x in zip(records, without, strict=True)])
    rising = np.concatenate([np.gradient(x) > 0.0 for x in inputs])
    grid = np.linspace(v.min(), v.max(), 300)
    curves = []
    if at >= max(i for i, op in enumerate(structure.operators) if op.carries_scale or i == 0):
        curves.append(("identified", grid, operator.run(grid, records[0].dt)[0] - grid, "line"))
    edges = np.linspace(v.min(), v.max(), _BINS + 1)
    for label, branch in (("measured, rising", rising), ("measured, falling", ~rising)):
        which = np.digitize(v[branch], edges[1:-1])
        count = np.bincount(which, minlength=_BINS)
        total = np.bincount(which, missing[branch], minlength=_BINS)
        center = np.bincount(which, v[branch], minlength=_BINS)
        full = count > 0
        curves.append((label, center[full] / count[full], total[full] / count[full], "points"))
    return Picture(title, "input of the missing stage", y_label, tuple(curves))


def _curved(title, sentence):
    def describe(operator, values, structure, at, records):
        v = np.concatenate(structure.run(records, last=at))
        grid = np.linspace(v.min(), v.max(), 300)
        deviation = operator.run(grid, records[0].dt)[0] - grid
        line = np.polyval(np.polyfit(grid, deviation, 1), grid)
        bend = np.ptp(deviation - line) / np.ptp(grid)
        numbers = {key: (*value, "") for key, value in values.items()}
        numbers["departure from a straight line over the range"] = (float(bend), np.nan, "")
        picture = _curve_picture(title, operator, structure, at, records)
        return f"{sentence}, by {100 * bend:.2g} % of the range.", numbers, picture

    return describe


def _saturation(place):
    def describe(operator, values, structure, at, records):
        numbers = {f"{key} level": (*value, place) for key, value in values.items()}
        levels = " and ".join(f"{value:.4g}" for value, _ in values.values())
        statement = f"The {place} follows up to {levels} and stays flat beyond."
        title = f"Saturation of the {place}"
        return statement, numbers, _curve_picture(title, operator, structure, at, records)

    return describe


def _other_stage(operator, values, structure, at, records):
    numbers = {key: (*value, "") for key, value in values.items()}
    title = structure.names[at].replace("_", " ")
    return (
        "The stage improves the held-out prediction.",
        numbers,
        _curve_picture(title, operator, structure, at, records),
    )


_IN_SERIES = {
    "lag": _lag,
    "resonance": _resonance,
    "delay": _delay,
    "creep": _creep,
    "asymmetry": _curved("Asymmetry", "One-sided dead zones bend the response"),
    "static_nonlinearity": _curved("Static nonlinearity", "The reading is a curve of the response"),
    "input_saturation": _saturation("drive"),
    "output_saturation": _saturation("response"),
}


# ------------------------------------------------------------------ beside the series


def _coefficients(operator, structure, result):
    """Return the disturbance's coefficients, (n_records, n_coefficients)."""
    at = next(i for i, d in enumerate(structure.disturbances) if d is operator)
    start = sum(np.size(d.coefficients) for d in structure.disturbances[:at])
    return result.record_coefficients[:, start : start + np.size(operator.coefficients)]


def _time_picture(title, operator, coefficients, records, residuals):
    curves = []
    for i, record in enumerate(records[:_DRAWN_RECORDS]):
        time = record.dt * np.arange(len(record.u))
        thin = max(len(time) // 400, 1)
        curves.append((f"residual, record {i}", time[::thin], residuals[i][::thin], "points"))
        curves.append(
            (f"identified, record {i}", time, operator.basis(time) @ coefficients[i], "line")
        )
    return Picture(title, "time since the record's start (s)", "residual (response)", tuple(curves))


def _offset(operator, values, result, structure, records, before, after):
    constants = _coefficients(operator, structure, result)[:, 0]
    numbers = {
        "spread between records": (float(np.ptp(constants)), np.nan, "response"),
        "mean": (float(constants.mean()), np.nan, "response"),
    }
    statement = (
        f"The records' constants spread over {np.ptp(constants):.4g} in units of the response."
    )
    picture = _time_picture(
        "Offset", operator, constants[:, None], records, _declared(structure, records)
    )
    return statement, numbers, picture


def _drift(operator, values, result, structure, records, before, after):
    own = _coefficients(operator, structure, result)
    spans = [
        float(np.ptp(operator.basis(r.dt * np.arange(len(r.u))) @ c))
        for r, c in zip(records, own, strict=True)
    ]
    numbers = {"largest span in a record": (max(spans), np.nan, "response")}
    statement = f"The residual moves slowly by up to {max(spans):.4g} within a record."
    picture = _time_picture("Drift", operator, own, records, _declared(structure, records))
    return statement, numbers, picture


def _declared(structure, records):
    """Return what the driven part leaves in each record."""
    return [r.y - x for r, x in zip(records, structure.run(records), strict=True)]


def _periodic(operator, values, result, structure, records, before, after):
    own = _coefficients(operator, structure, result)
    n = np.size(operator.frequencies)
    numbers = {}
    for i in range(n):
        frequency, std = values[f"frequencies[{i}]"]
        amplitude = np.hypot(own[:, i], own[:, n + i])
        numbers[f"frequency {i + 1}"] = (frequency, std, "Hz")
        numbers[f"amplitude {i + 1}"] = (float(amplitude.mean()), np.nan, "response")
    lines = ", ".join(f"{values[f'frequencies[{i}]'][0]:.5g}" for i in range(n))
    curves = []
    for label, residuals in (
        ("driven part alone", _declared(structure, records)),
        ("with the lines", after.residuals),
    ):
        total, length = 0.0, min(4096, *(len(r.u) for r in records))
        for record, residual in zip(records, residuals, strict=True):
            finite = residual[np.isfinite(residual)]
            if len(finite) >= length:
                frequency, power = welch(finite, 1.0 / record.dt, nperseg=length)
                total = total + power
        if np.ndim(total):
            curves.append((label, frequency[1:], np.sqrt(total[1:] / len(records)), "line"))
    picture = Picture(
        "Lines in the residual",
        "frequency (Hz)",
        "residual (response / sqrt Hz)",
        tuple(curves),
        x_log=True,
        y_log=True,
    )
    return f"The residual has lines at {lines} Hz that the drive does not have.", numbers, picture


def _other_beside(operator, values, result, structure, records, before, after):
    own = _coefficients(operator, structure, result)
    numbers = {key: (*value, "") for key, value in values.items()}
    picture = _time_picture("Disturbance", operator, own, records, _declared(structure, records))
    return "The disturbance improves the held-out prediction.", numbers, picture


_BESIDE = {"offset": _offset, "drift": _drift, "periodic_disturbance": _periodic}
