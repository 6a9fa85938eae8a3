"""Evidence for what belongs to records: disturbances, amplitudes and further columns of X."""

import numpy as np
from scipy.signal import welch

from ..compose import amplitude, sensitivity_name
from ..optimize import variable_projection
from ._evidence_base import Picture, binned, compared
from ._tree import as_read

__all__ = [
    "BESIDE",
    "describe_beside",
    "describe_branch",
    "describe_modulation",
    "describe_schedule",
]

_DRAWN_RECORDS = 5
_DRAWN_PARAMETERS = 3
_ALONE = 24  # records that are fitted on their own, at the most
_ALONE_EVALUATIONS = 8
_VISIBLE = 0.01  # change of a parameter over the records, relative to the largest, that is drawn


# ------------------------------------------------------------------ beside the model


def _time_picture(title, claim):
    operator = claim.operator
    coefficients, curves = claim.coefficients(operator), []
    for i, record in enumerate(claim.records[:_DRAWN_RECORDS]):
        time = record.dt * np.arange(len(record.u))
        thin = max(len(time) // 400, 1)
        own = operator.basis(time) @ coefficients[i]
        left = claim.measured[i] - claim.modelled[i] + own
        curves.append((f"residual, record {i}", time[::thin], left[::thin], "points"))
        curves.append((f"identified, record {i}", time, own, "line"))
    return Picture(title, "time since the record's start (s)", "residual (response)", tuple(curves))


def _offset(claim):
    constants = claim.coefficients(claim.operator)[:, 0]
    numbers = {
        "spread between records": (float(np.ptp(constants)), np.nan, "response"),
        "mean": (float(constants.mean()), np.nan, "response"),
    }
    statement = (
        f"The records' constants spread over {np.ptp(constants):.4g} in units of the response."
    )
    return statement, numbers, _time_picture("Offset", claim)


def _drift(claim):
    spans = [
        float(np.ptp(claim.operator.basis(r.dt * np.arange(len(r.u))) @ own))
        for r, own in zip(claim.records, claim.coefficients(claim.operator), strict=True)
    ]
    numbers = {"largest span in a record": (max(spans), np.nan, "response")}
    statement = f"The residual moves slowly by up to {max(spans):.4g} within a record."
    return statement, numbers, _time_picture("Drift", claim)


def _periodic(claim):
    operator, records = claim.operator, claim.records
    own, n = claim.coefficients(operator), np.size(operator.frequencies)
    numbers = {}
    for i in range(n):
        numbers[f"frequency {i + 1}"] = claim.number("frequencies", "Hz", index=i)
        amplitude = np.hypot(own[:, i], own[:, n + i])
        numbers[f"amplitude {i + 1}"] = (float(amplitude.mean()), np.nan, "response")
    lines = ", ".join(f"{frequency:.5g}" for frequency in operator.frequencies)
    without = [
        y - x + operator.basis(r.dt * np.arange(len(y))) @ c
        for y, x, r, c in zip(claim.measured, claim.modelled, records, own, strict=True)
    ]
    curves, length = [], min(4096, *(len(r.u) for r in records))
    for label, residuals in (
        ("without the lines", without),
        ("with the lines", claim.after.residuals),
    ):
        total = 0.0
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


def describe_beside(claim):
    """Describe a disturbance of which nothing else is known."""
    statement = "The disturbance improves the held-out prediction."
    return statement, claim.all_numbers(), _time_picture("Disturbance", claim)


BESIDE = {"offset": _offset, "drift": _drift, "periodic_disturbance": _periodic}


# ------------------------------------------------------------------ further columns of X


def _column_name(claim, column):
    return claim.columns[column] if len(claim.columns) else f"column {column}"


def _in_column(claim, column):
    return np.concatenate([record.auxiliary[:, column - 1] for record in claim.records])


def describe_branch(claim):
    """Describe what a column of X adds to the response."""
    structure = claim.structure
    (branch,) = structure.edits_of(claim.name)
    name, values = _column_name(claim, branch.column), claim.values
    others = structure.without(claim.name)
    measured, identified = map(np.concatenate, claim.lacking(others.respond(claim.records)))
    middle = identified.mean()
    column = _in_column(claim, branch.column)
    gain, std = values.get("gain", (np.nan, np.nan))
    coherent = 1.0 - np.var(measured - identified) / np.var(measured)
    numbers = {
        f"gain from {name}": (gain, std, f"response/{name}"),
        f"part of the residual that follows {name}": (float(max(coherent, 0.0)), np.nan, ""),
        f"range of {name}": (float(np.ptp(column)), np.nan, name),
    }
    statement = f"The response follows {name} by {gain:.4g}"
    x, x_label = column, name
    if "time_constant" in values:
        tau, tau_std = values["time_constant"]
        numbers["time constant"] = (tau, tau_std, "s")
        statement += f", with a time constant of {tau:.4g} s"
        x, x_label = identified / gain, f"{name}, behind the time constant"
    picture = Picture(
        f"Residual against {name}",
        x_label,
        "what the drive does not explain (response)",
        compared(x, measured - middle, identified - middle),
    )
    return statement + ".", numbers, picture


# ------------------------------------------------------------------ in the parameters


def describe_modulation(claim):
    """Describe a response that is scaled by the record's amplitude or by a column of X."""
    structure, records = claim.structure, claim.records
    (modulation,) = structure.edits_of(claim.name)
    (sensitivity,) = structure.values["scaled by", str(modulation.column)]
    plain = others = structure.without(claim.name)
    for name, edit in others.edits:
        plain = plain.without(name) if edit.kind == "branch" else plain
    unscaled, with_branches = plain.respond(records), others.respond(records)
    measured = [
        y - (both - alone)
        for y, both, alone in zip(claim.measured, with_branches, unscaled, strict=True)
    ]
    if modulation.column == "amplitude":
        name, unit = "half range of the drive in a record", "drive"
        x = np.array([amplitude(r.u) for r in records])
        gains = np.array([_slope(u, y) for u, y in zip(unscaled, measured, strict=True)])
    else:
        name = unit = _column_name(claim, modulation.column)
        x, gains = _gains_by_column(
            _in_column(claim, modulation.column), np.concatenate(unscaled), np.concatenate(measured)
        )
    entry = sensitivity_name(1 + structure.scaled_by.index(str(modulation.column)))
    std = next(
        (s for key, s in claim.result.params_std.items() if key.split("__")[-1] == entry), np.nan
    )
    order = np.argsort(x)
    x, gains = x[order], gains[order]
    ends = np.array([x[0], x[-1]])
    lines = 1.0 + sensitivity * (ends - modulation.reference)
    span = float(np.ptp(x))
    numbers = {
        "change of the gain": (sensitivity, std, f"1/{unit}"),
        "change of the gain over the range": (
            sensitivity * span,
            std * span,
            "",
        ),
        "gain is one at": (modulation.reference, np.nan, unit),
    }
    statement = (
        f"The gain changes by {100.0 * sensitivity * span:+.3g} % from {ends[0]:.4g} to "
        f"{ends[1]:.4g} of the {name}."
    )
    picture = Picture(
        f"Gain against {'amplitude' if unit == 'drive' else name}",
        name,
        "gain over that of the model",
        (("measured", x, gains, "points"), ("identified", ends, lines, "line")),
    )
    return statement, numbers, picture


def _slope(x, y):
    x = x - x.mean()
    return float(x @ y / (x @ x))


def _gains_by_column(column, unscaled, measured):
    """Return the middle of each bin of a column and the gain in it."""
    x, power = binned(column, unscaled**2)
    _, product = binned(column, unscaled * measured)
    kept = power > 0.01 * power.max()  # too little motion elsewhere
    return x[kept], product[kept] / power[kept]


def describe_schedule(claim):
    """Describe parameters that are lines in the amplitude of a record, or in a column."""
    structure, records = claim.structure, claim.records
    (schedule,) = structure.edits_of(claim.name)
    if schedule.by == "amplitude":
        name, unit = "half range of the drive in a record", "drive"
    else:
        name = unit = _column_name(claim, schedule.by)
    groups = _groups(structure, schedule)
    lines = {
        label: sum(np.array(structure.lines[entry]) for entry in entries)
        for label, entries in groups.items()
    }
    size = {label: float(np.mean(np.abs(line))) for label, line in lines.items()}
    change = {
        label: float(line[1] - line[0]) / size[label]
        for label, line in lines.items()
        if size[label] > 0.0
    }
    drawn = sorted(change, key=lambda label: -abs(change[label]))[:_DRAWN_PARAMETERS]
    drawn = [label for label in drawn if abs(change[label]) >= _VISIBLE * abs(change[drawn[0]])]
    numbers = {f"change of {label} over the range": (change[label], np.nan, "") for label in drawn}
    numbers |= {
        "smallest": (float(schedule.low), np.nan, unit),
        "largest": (float(schedule.high), np.nan, unit),
    }
    x = np.array([r.schedule for r in as_read(structure.model, records)])
    alone = _fitted_alone(claim, [groups[label] for label in drawn])
    ends, curves = np.array([schedule.low, schedule.high]), []
    for label, values in zip(drawn, alone.T, strict=True):
        own = values / size[label]
        curves.append((f"{label}, records alone", x[: len(own)], own, "points"))
        curves.append((f"{label}, identified", ends, lines[label] / size[label], "line"))
    changes = " and ".join(f"{label} by {100.0 * change[label]:+.3g} %" for label in drawn)
    statement = (
        f"Each record alone fits well, together they do not: from {schedule.low:.4g} to "
        f"{schedule.high:.4g} of the {name} the model changes, {changes}."
    )
    picture = Picture(
        f"Parameters against {'amplitude' if unit == 'drive' else name}",
        name,
        "parameter over its mean",
        tuple(curves),
    )
    return statement, numbers, picture


def _groups(structure, schedule):
    """Return what is drawn of the entries that follow the record: label -> entries.

    Plays are many and alike: their weights count together, and those with memory once more.
    """
    groups = {}
    for stage, operator in zip(structure.names, structure.operators, strict=True):
        for entry in structure.lines:
            if entry[0] != stage or entry[1].endswith("intercept"):
                continue
            label = entry[1].replace("_", " ")
            if label.startswith("weights[") and hasattr(operator, "thresholds"):
                threshold = operator.thresholds[int(label.removeprefix("weights[").rstrip("]"))]
                if schedule.by == "amplitude" and threshold >= schedule.low:
                    continue  # not every record reaches it
                groups.setdefault("sum of all weights", []).append(entry)
                if threshold > 0.0:
                    groups.setdefault("weights with memory", []).append(entry)
            else:
                groups.setdefault(
                    label if len(structure.names) == 1 else f"{stage}: {label}", []
                ).append(entry)
    return groups


def _fitted_alone(claim, groups):
    """Return sums of parameters of each record fitted on its own, (n_records, n_groups)."""
    structure, found = claim.structure, []
    plain = structure.without(claim.name)
    for record in claim.records[:_ALONE]:
        (own,) = as_read(structure.model, [record])
        single = plain.with_stages(structure.stages_at(own.schedule))
        problem = single.problem([record])
        solution = variable_projection(problem, problem.x0, max_evaluations=_ALONE_EVALUATIONS)
        values = single.at(problem, solution.x).values
        found.append([float(sum(values[entry] for entry in entries)[0]) for entries in groups])
    return np.array(found)
