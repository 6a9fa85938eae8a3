"""Evidence for curves and limits of the series, and for play operators."""

from dataclasses import replace

import numpy as np

from ..linear import LinearOperator
from ..static import SoftSaturationOperator
from ._evidence_base import Picture, binned, by_direction, compared, directions

__all__ = ["CURVES", "describe_stage", "describe_tanks", "hysteresis_in_series"]

_FAST = 0.9  # quantile of the drive's rate at which a growth with the rate is stated
_SHOWN = 0.98  # quantile of the drive's rate up to which a growth with the rate is drawn
_LOOP = 400  # samples of a branch
_GAIN_BINS = 30  # of the drive
_SMALL = 1e-3  # power of the drive's steps, of the largest, that shows no gain
_FAR = 2.0  # level of a saturation over the range seen, from which it is a guess


def _stage_picture(title, claim, x_label="input of the missing stage", y_label=None):
    """Draw what the stage adds against its input, by direction: measured and identified."""
    inputs = claim.inputs()
    _, measured, identified = claim.left_out()
    curves = by_direction(inputs, directions(inputs), measured, identified)
    return Picture(title, x_label, y_label or "what it adds (response)", curves)


def _curved(title, sentence):
    def describe(claim):
        v = np.concatenate(claim.inputs())
        grid = np.linspace(v.min(), v.max(), 300)
        deviation = claim.operator.run(grid, claim.records[0].dt)[0] - grid
        line = np.polyval(np.polyfit(grid, deviation, 1), grid)
        bend = np.ptp(deviation - line) / np.ptp(grid)
        numbers = claim.all_numbers()
        numbers["departure from a straight line over the range"] = (float(bend), np.nan, "")
        picture = _stage_picture(title, claim)
        return f"{sentence}, by {100 * bend:.2g} % of the range.", numbers, picture

    return describe


def _saturation(place):
    def describe(claim):
        if isinstance(claim.operator, SoftSaturationOperator):
            return _soft_saturation(place, claim)
        numbers = {f"{key} level": (*value, place) for key, value in claim.values.items()}
        levels = " and ".join(f"{value:.4g}" for value, *_ in numbers.values())
        statement = f"The {place} follows up to {levels} and stays flat beyond."
        picture = _stage_picture(f"Saturation of the {place}", claim, f"{place} before it")
        return statement, numbers, picture

    return describe


def _soft_saturation(place, claim):
    operator = claim.operator
    level, knee = claim.number("level", place), claim.number("knee", "")
    v = np.concatenate(claim.inputs())
    ends = np.array([v.min(), v.max()])
    lost = np.abs(operator.run(ends, claim.records[0].dt)[0] - ends)
    numbers = {"level beyond the middle": level, "sharpness of the knee": knee}
    if operator.center:
        numbers["middle"] = claim.number("center", place)
    numbers["what it takes at the ends"] = (float(lost.max()), np.nan, "response")
    statement = (
        f"The {place} levels off towards {level[0]:.4g} beyond its middle, with a rounded knee of "
        f"sharpness {knee[0]:.3g}."
    )
    if level[0] > _FAR * np.abs(ends - operator.center).max():
        statement = (
            f"The {place} begins to level off: the ends of its range lose up to {lost.max():.4g}. "
            "How far it would rise is not in these data."
        )
    picture = _stage_picture(f"Saturation of the {place}", claim, f"{place} before it")
    return statement, numbers, picture


def _dead_zone(claim):
    width, center = claim.number("half_width", "drive", 2.0), claim.number("center", "drive")
    span = float(np.ptp(np.concatenate(claim.inputs())))
    numbers = {
        "width of the band": width,
        "middle of the band": center,
        "width over the range of the drive": (width[0] / span, width[1] / span, ""),
    }
    half = 0.5 * width[0]
    statement = (
        f"Between {center[0] - half:.4g} and {center[0] + half:.4g} of the drive nothing moves, "
        f"{100.0 * width[0] / span:.3g} % of its range."
    )
    return statement, numbers, _gain_by_drive(claim)


def _gain_by_drive(claim):
    """Draw the gain against the drive; behind dynamics, what the stage takes."""
    title = "Dead zone"
    if any(isinstance(stage, LinearOperator) for stage in claim.structure.operators[claim.at :]):
        return _stage_picture(title, claim, "drive")
    steps = [np.diff(u) for u in claim.inputs()]
    middles = np.concatenate([0.5 * (u[1:] + u[:-1]) for u in claim.inputs()])
    power = np.concatenate([step**2 for step in steps])
    small = power < (np.ptp(middles) / _GAIN_BINS) ** 2  # no step across the band
    curves = []
    for label, responses, style in (
        ("measured", claim.measured, "points"),
        ("identified", claim.modelled, "line"),
        ("without the band", claim.rest.respond(claim.records), "dashed"),
    ):
        products = [step * np.diff(y) for step, y in zip(steps, responses, strict=True)]
        x, product = binned(middles[small], np.concatenate(products)[small], _GAIN_BINS)
        _, size = binned(middles[small], power[small], _GAIN_BINS)
        kept = size > _SMALL * size.max()
        curves.append((label, x[kept], product[kept] / size[kept], style))
    return Picture(title, "drive", "gain (response/drive)", tuple(curves))


def _backlash(claim):
    unit = "drive" if claim.operator.rank == 0 else "response"
    gap = claim.number("half_gap", unit, 2.0)
    span = float(np.ptp(np.concatenate(claim.inputs())))
    numbers = {
        "play": gap,
        "play over the range of the motion": (gap[0] / span, gap[1] / span, ""),
    }
    statement = (
        f"After each turn the {unit} moves {gap[0]:.4g} before anything follows, "
        f"{100.0 * gap[0] / span:.3g} % of the range, wherever it turns."
    )
    picture = _stage_picture("Backlash", claim, f"{unit} before the play")
    if unit == "response":
        v = np.concatenate(claim.inputs())
        ends = np.array([v.min(), v.max()])
        for label, sign in (("half the play", 1.0), ("", -1.0)):
            level = (label, ends, np.full(2, 0.5 * sign * gap[0]), "dashed")
            picture = replace(picture, curves=(*picture.curves, level))
    return statement, numbers, picture


def _slew_limit(claim):
    rate = claim.number("rate", "drive/s")
    inputs, dts = claim.inputs(), [r.dt for r in claim.records]
    limited = [
        np.abs(np.diff(claim.operator.run(u, dt)[0])) / dt > 0.999 * rate[0]
        for u, dt in zip(inputs, dts, strict=True)
    ]
    fastest = max(np.abs(np.diff(u)).max() / dt for u, dt in zip(inputs, dts, strict=True))
    numbers = {
        "limit": rate,
        "fastest drive": (float(fastest), np.nan, "drive/s"),
        "part of the time at the limit": (float(np.concatenate(limited).mean()), np.nan, ""),
    }
    statement = f"The drive reaches the actuator at {rate[0]:.4g} per second at the most."
    return statement, numbers, _edge_picture(claim)


def _edge_picture(claim):
    """Draw the stretch of a record in which the limit takes most."""
    taken = [
        np.abs(u - claim.operator.run(u, r.dt)[0])
        for u, r in zip(claim.inputs(), claim.records, strict=True)
    ]
    number = int(np.argmax([part.max() for part in taken]))
    own, dt = taken[number], claim.records[number].dt
    middle = int(np.argmax(own))
    after = own[middle:] <= 1e-6 * own.max()
    width = int(np.argmax(after)) if after.any() else len(after)
    rows = slice(max(middle - 2 * width - 10, 0), middle + 4 * width + 20)
    time = dt * np.arange(len(own))[rows]
    curves = tuple(
        (label, time, signals[number][rows], style)
        for label, signals, style in (
            ("measured", claim.measured, "points"),
            ("with the limit", claim.modelled, "line"),
            ("without it", claim.rest.respond(claim.records), "dashed"),
        )
    )
    return Picture("The edge on which the limit takes most", "time (s)", "response", curves)


def _loop(operator, low, high, dt):
    """Return the drive and both branches of a loop between two drives, run slowly."""
    way = np.linspace(low, high, _LOOP)
    drive = np.concatenate([np.linspace(0.0, low, _LOOP), way, way[::-1], way])
    y = operator.run(drive, dt)[0]
    return way, y[-_LOOP:], y[2 * _LOOP : 3 * _LOOP][::-1]


def hysteresis_in_series(claim):
    """Describe play operators that have been put into the series."""
    drive = np.concatenate(claim.inputs())
    _, up, down = _loop(claim.operator, drive.min(), drive.max(), claim.records[0].dt)
    span = max(up.max(), down.max()) - min(up.min(), down.min())
    width = float(np.abs(up - down).max() / span)
    weights, thresholds = np.array(claim.operator.weights), np.array(claim.operator.thresholds)
    numbers = {
        "loop width over the range": (width, np.nan, ""),
        "part of the response that has memory": (
            float(weights[thresholds > 0.0].sum() / weights.sum()),
            np.nan,
            "",
        ),
    }
    statement = (
        f"The branches of the largest loop are {100.0 * width:.3g} % of the range apart, however "
        "slow."
    )
    without, measured, identified = claim.left_out()
    picture = Picture(
        "Hysteresis",
        "response without hysteresis",
        "what the hysteresis adds (response)",
        by_direction(without, directions(without), measured, identified),
    )
    return statement, numbers, picture


def _rate_dependence(claim):
    operator, records = claim.operator, claim.records
    rates = [np.abs(np.gradient(u, r.dt)) for u, r in zip(claim.inputs(), records, strict=True)]
    fast = float(np.quantile(np.concatenate(rates), _FAST))
    half = 0.5 * float(np.ptp(np.concatenate(claim.inputs())))
    if operator.dilation:
        growth = claim.number("dilation", "drive s/drive")
        numbers = {
            "growth of the thresholds with the rate": (*growth[:2], "s"),
            "growth at fast motion": (growth[0] * fast, growth[1] * fast, "drive"),
        }
        relative, what = growth[0] * fast / half, "thresholds grow by"
    else:
        change = float(np.sum(operator.rate_weights)) * fast
        numbers = {"change of the gain at fast motion": (change, np.nan, "response/drive")}
        relative, what = change / float(np.sum(operator.weights)), "gain changes by"
    numbers["fast motion"] = (fast, np.nan, "drive/s")
    numbers["change at fast motion, relative"] = (float(relative), np.nan, "")
    of = "the drive's half range" if operator.dilation else "itself"
    statement = (
        f"At {fast:.4g} of the drive a second, which a tenth of the samples exceed, the "
        f"hysteresis' {what} {100.0 * relative:.3g} % of {of}."
    )
    slow = claim.with_stage(replace(operator, dilation=0.0, rate_weights=()))
    rising = np.where(directions([r.u for r in records]), -1.0, 1.0)
    signals = claim.lacking(slow.respond(records))
    x = np.concatenate(rates)
    kept = x <= np.quantile(x, _SHOWN)
    curves = compared(x[kept], *((rising * np.concatenate(v))[kept] for v in signals))
    title, y_label = "Hysteresis against rate", "growth of the loop, half width (response)"
    return statement, numbers, Picture(title, "rate of the drive (drive/s)", y_label, curves)


def describe_tanks(claim):
    """Describe stages that empty by a power of their level, and overflow."""
    chain = claim.operator
    u = np.concatenate(claim.inputs())
    grid = np.linspace(u.min(), u.max(), 300)
    powers = " and ".join(f"{p:.3g}" for p in chain.exponents)
    statement = f"The stages empty by the power {powers} of their level, not in proportion to it"
    numbers = claim.all_numbers()
    if chain.is_limited:
        top = chain.gain * chain.ceilings[-1] + chain.intercept
        numbers["response at the ceiling"] = (float(top), np.nan, "response")
        statement += f", and the response ends at {top:.4g}"
    linear = claim.structure.without(claim.name).operators[claim.at]
    curves = [
        (label, grid, np.array([stage.run([v], 1.0, stage.init(v))[0][0] for v in grid]), style)
        for label, stage, style in (
            ("identified", chain, "line"),
            ("declared stage", linear, "dashed"),
        )
    ]
    return f"{statement}.", numbers, Picture("Response at rest", "drive", "response", curves)


def describe_stage(claim):
    """Describe an effect of which nothing else is known."""
    picture = _stage_picture(claim.structure.names[claim.at].replace("_", " "), claim)
    return "The stage improves the held-out prediction.", claim.all_numbers(), picture


CURVES = {
    "asymmetry": _curved("Asymmetry", "One-sided dead zones bend the response"),
    "static_nonlinearity": _curved("Static nonlinearity", "The reading is a curve of the response"),
    "input_saturation": _saturation("drive"),
    "output_saturation": _saturation("response"),
    "dead_zone": _dead_zone,
    "backlash": _backlash,
    "slew_limit": _slew_limit,
    "rate_dependence": _rate_dependence,
}
