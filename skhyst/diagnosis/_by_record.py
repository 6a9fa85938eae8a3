"""Numbers of effects that depend on the record, or on a column, and are no part of their own."""

from dataclasses import replace

import numpy as np

from ..optimize import variable_projection
from ._characteristics import Seen, characteristics

__all__ = [
    "NUMBERS",
    "column_numbers",
    "fitted_alone",
    "gains_by_number",
    "most_changed",
    "quantities",
]


def gains_by_number(claim):
    """Return the modulation, its number (ascending) and the measured gain over the model's.

    One value a record where the amplitude scales, else one for each of a few bins of the column.
    """
    structure, records = claim.structure, claim.records
    (modulation,) = (m for m in structure.modulations if m.effect == claim.effect.name)
    others = tuple(m for m in structure.modulations if m is not modulation)
    unscaled = replace(structure, modulations=others, branches=()).respond(records)
    beside = replace(structure, modulations=others).respond(records)
    measured = [y - (b - x) for y, b, x in zip(claim.measured, beside, unscaled, strict=True)]
    if modulation.column == "amplitude":
        x = np.array([0.5 * np.ptp(record.u) for record in records])
        gains = [np.polyfit(u, y, 1)[0] for u, y in zip(unscaled, measured, strict=True)]
    else:
        column, u, y = map(np.concatenate, (claim.in_column(), unscaled, measured))
        x, gains = [], []
        for part in np.array_split(np.argsort(column, kind="stable"), 24):
            x.append(column[part].mean())
            gains.append(u[part] @ y[part] / (u[part] @ u[part] or np.nan))
    order = np.argsort(x)
    return modulation, np.array(x)[order], np.array(gains)[order]


def _modulation(claim):
    modulation, x, _ = gains_by_number(claim)
    number = claim.structure.modulations.index(modulation)
    names = [n for n in claim.result.params if n.rpartition("__")[2].startswith("sensitivity")]
    std = claim.result.params_std[names[number]]
    name, unit = claim.column_name, claim.column_unit
    span = 100.0 * float(np.ptp(x))
    return {
        f"change of the gain over the range of the {name}": (
            modulation.sensitivity * span,
            std * span,
            "%",
        ),
        "change of the gain": (modulation.sensitivity, std, f"1/{unit}"),
        "gain is one at": (modulation.reference, np.nan, unit),
    }


def column_numbers(claim):
    """Return what a column is for the response, beyond the parameters of what it drives."""
    others = tuple(b for b in claim.structure.branches if b is not claim.branch)
    without = replace(claim.structure, branches=others).respond(claim.records)
    measured, identified = map(np.concatenate, claim.lacking(without))
    part = 100.0 * max(1.0 - np.var(measured - identified) / np.var(measured), 0.0)
    name, column = claim.column_name, np.concatenate(claim.in_column())
    return {
        f"part of the residual that follows {name}": (part, np.nan, "%"),
        f"range of {name}": (np.ptp(column), np.nan, name),
    }


def quantities(claim, number):
    """Return name -> (value, unit) of the stages as they are in a record with this number."""
    structure = claim.structure
    series = structure.schedule.applied(structure.series()).at(number).operator
    return _of_series(claim, series)


def _of_series(claim, series):
    """Return what characterises the stages of a series, and their scheduled scalars.

    What depends on the range seen is of the record with the smallest: all records reach it.
    """
    structure, found = claim.structure, {}
    least = min(claim.records, key=lambda record: np.ptp(record.u))
    for at, (label, stage) in enumerate(zip(structure.names, series.stages, strict=True)):
        inputs = structure.run([least], last=at)
        outputs = structure.run([least], last=at + 1)
        own = characteristics(stage, Seen(inputs, outputs, [least.dt]))
        for (name, spec), value in zip(stage.entries(), stage.pack(), strict=True):
            scheduled = f"{label}__{name}" in structure.schedule.lines
            if scheduled and "[" not in name and name != "intercept":
                own[name.replace("_", " ")] = (value, spec.unit)
        before = f"{label}: " if len(structure.names) > 1 else ""
        found |= {f"{before}{name}": value for name, value in own.items()}
    return found


def most_changed(low, high):
    """Return the names of the few quantities that change most, relative, most first."""
    change = {
        name: abs(high[name][0] - low[name][0]) / (abs(high[name][0]) + abs(low[name][0]) or 1.0)
        for name in low
        if name in high
    }
    order = sorted(change, key=lambda name: -change[name])[:3]
    return [name for name in order if change[name] >= 0.01 * change[order[0]]]


def fitted_alone(claim, names, most=24):
    """Return the numbers of records, and quantities of each fitted alone, (n_records, n_names)."""
    structure, found = claim.structure, []
    schedule, series = structure.schedule, structure.series()
    records = claim.records[:most]
    for record in records:
        own = schedule.applied(series).at(schedule.number(record)).operator
        single = replace(structure, schedule=None, operators=own.stages)
        problem = single.problem([record])
        solution = variable_projection(problem, problem.x0, max_evaluations=8)
        values = _of_series(claim, single.at(problem, solution.x).series())
        found.append([values.get(name, (np.nan,))[0] for name in names])
    return np.array([schedule.number(r) for r in records]), np.array(found)


def _schedule(claim):
    schedule = claim.structure.schedule
    low, high = (quantities(claim, number) for number in (schedule.low, schedule.high))
    found = {}
    for name in most_changed(low, high):
        (a, _), (b, _) = low[name], high[name]
        found[f"change of {name}"] = (200.0 * (b - a) / (abs(a) + abs(b)), np.nan, "%")
    unit = claim.column_unit
    return found | {
        f"smallest {claim.column_name}": (schedule.low, np.nan, unit),
        f"largest {claim.column_name}": (schedule.high, np.nan, unit),
    }


def _moved_modes(claim):
    schedule, series = claim.structure.schedule, claim.structure.series()
    large = schedule.applied(series).at(schedule.high).operator.stages[claim.at]
    found = {}
    # the poles are those of large amplitudes; at small ones zeros cancel them
    for label, roots in (("large", large.poles()), ("small", large.zeros())):
        roots = np.asarray(roots, dtype=complex)
        frequencies = np.sort(np.abs(roots[roots.imag > 0.0])) / (2.0 * np.pi)
        for i, frequency in enumerate(frequencies, start=1):
            found[f"mode {i}, {label} amplitude"] = (frequency, np.nan, "Hz")
    return found


NUMBERS = {
    "modulation": _modulation,
    "schedule": _schedule,
    "scheduled stage": _moved_modes,
}
