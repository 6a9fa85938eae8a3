"""Evidence for linear dynamics in the series."""

import numpy as np
from scipy.signal import csd, welch

from ..compose import amplitude
from ._evidence_base import Picture

__all__ = ["DYNAMICS", "describe_moved_modes"]

_COHERENT = 0.8  # squared coherence above which a measured frequency response is drawn


def _measured_response(claim, numbers=None):
    """Return frequency (Hz) and the measured response of the missing stage, where coherent.

    Input is the model without the stage, output the measurement: what lies between them is what
    the stage has to do. ``numbers`` are those of the records to take, all by default.
    """
    numbers = range(len(claim.records)) if numbers is None else numbers
    records = [claim.records[i] for i in numbers]
    length = min(1024, *(len(record.u) for record in records))
    sums = [0.0, 0.0, 0.0]
    measured = [claim.measured[i] for i in numbers]
    for record, x, y in zip(records, claim.rest.respond(records), measured, strict=True):
        options = {"fs": 1.0 / record.dt, "nperseg": length, "detrend": "linear"}
        frequency, cross = csd(x, y, **options)
        for i, part in enumerate((cross, welch(x, **options)[1], welch(y, **options)[1])):
            sums[i] = sums[i] + part * len(x)
    cross, input_power, output_power = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        response = cross / input_power
        coherence = np.abs(cross) ** 2 / (input_power * output_power)
    kept = (coherence > _COHERENT) & (frequency > 0.0)
    return frequency[kept], response[kept]


def _gain_picture(title, claim):
    frequency, response = _measured_response(claim)
    dt = claim.records[0].dt
    grid = np.geomspace(1.0 / (dt * max(len(r.u) for r in claim.records)), 0.5 / dt, 300)
    identified = np.abs(claim.operator.frequency_response(grid))
    return Picture(
        title,
        "frequency (Hz)",
        "gain of the missing stage",
        (
            ("measured", frequency, np.abs(response), "points"),
            ("identified", grid, identified, "line"),
        ),
        x_log=True,
        y_log=True,
    )


def _lag(claim):
    tau, std, _ = claim.number("time_constant", "s")
    corner = 1.0 / (2.0 * np.pi * tau)
    numbers = {
        "time constant": (tau, std, "s"),
        "corner frequency": (corner, corner * std / tau, "Hz"),
    }
    statement = f"Gain and phase fall together above {corner:.4g} Hz, as behind a low-pass."
    return statement, numbers, _gain_picture("Low-pass", claim)


def _resonance(claim):
    values = claim.values
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
    return statement, numbers, _gain_picture("Resonance", claim)


def _delay(claim):
    delay, std, _ = claim.number("delay", "s")
    frequency, response = _measured_response(claim)
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


def _creep(claim):
    operator, records = claim.operator, claim.records
    n = np.size(operator.compliances)
    indices = [None] if n == 1 and "compliances" in claim.values else range(n)
    numbers = {}
    for i, index in enumerate(indices, start=1):
        compliance = claim.number("compliances", "", index=index)
        numbers[f"time constant {i}"] = claim.number("time_constants", "s", index=index)
        numbers[f"creep {i} over the prompt response"] = compliance
    total = float(np.sum(operator.compliances))
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


DYNAMICS = {"lag": _lag, "resonance": _resonance, "delay": _delay, "creep": _creep}


def describe_moved_modes(claim):
    """Describe modes that the amplitude moves, from the zeros of the stage to its poles."""
    schedule = claim.structure.edits_of(claim.name)[-1]
    small, large = (
        claim.structure.stages_at(number)[claim.at].operator
        for number in (schedule.low, schedule.high)
    )
    before, after = (
        np.sort(np.abs(roots[roots.imag > 0.0])) / (2.0 * np.pi)
        for roots in (large.zeros().astype(complex), large.poles().astype(complex))
    )
    numbers = {f"mode {i}, large amplitude": (f, np.nan, "Hz") for i, f in enumerate(after, 1)}
    statement = f"Modes near {', '.join(f'{f:.4g}' for f in after)} Hz change with the amplitude."
    if len(before) == len(after):
        numbers |= {
            f"mode {i}, small amplitude": (f, np.nan, "Hz") for i, f in enumerate(before, 1)
        }
        moves = [f"from {a:.5g} to {b:.5g} Hz" for a, b in zip(before, after, strict=True)]
        statement = f"Modes move with the amplitude: {', '.join(moves)}."
    middle = 0.5 * (schedule.low + schedule.high)
    above = [i for i, r in enumerate(claim.records) if amplitude(r.u) > middle]
    frequency, response = _measured_response(claim, above)
    grid = np.linspace(0.5 * after.min(), 1.5 * after.max(), 400)
    near = (frequency >= grid[0]) & (frequency <= grid[-1])
    curves = [("measured, large amplitude", frequency[near], np.abs(response[near]), "points")]
    for label, operator, style in (("large", large, "line"), ("small", small, "dashed")):
        gain = np.abs(operator.frequency_response(grid))
        curves.append((f"identified, {label} amplitude", grid, gain, style))
    picture = Picture(
        "Modes that move", "frequency (Hz)", "gain of the missing stage", tuple(curves), y_log=True
    )
    return statement, numbers, picture
