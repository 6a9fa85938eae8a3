"""The evidence of a claim: a sentence, numbers with their errors, and a picture."""

import re
import warnings
from dataclasses import dataclass, field, replace

import numpy as np

from ..records import Units
from ._pictures import Picture, changes_by_number, draw
from ._report_text import listed, plus_minus
from ._traits import characteristics

# parameters with another name or factor in common use
_LABELS = {
    "half_width": ("width of the band", 2.0),
    "half_gap": ("play", 2.0),
    "lower": ("lower level", 1.0),
    "upper": ("upper level", 1.0),
    "rate": ("largest rate", 1.0),
    "static_level": ("breakaway force", 1.0),
    "friction": ("Coulomb force", 1.0),
    "coulomb_force": ("Coulomb force", 1.0),
}
# numbered weights and coefficients mean little one by one
_LESS_TELLING = re.compile("(weight|coefficient|compliance|numerator)s? ")


@dataclass(frozen=True)
class Evidence:
    """The evidence of a claim.

    Parameters
    ----------
    effect : str
        Name of the effect.
    statement : str
        The evidence in one sentence.
    numbers : dict of str to (float, float, str)
        Value, standard error or NaN, and unit, by name.
    picture : Picture
        Curves that show the effect.
    """

    effect: str
    statement: str
    numbers: dict
    picture: Picture = field(repr=False)


def gather_evidence(claim, before, after, later):
    """Return the evidence of a claim.

    ``before`` and ``after`` are the held-out errors without and with it, both without the effects
    that are ``later`` in the sequence of models.
    """
    found, words = _tried("numbers", _numbers, claim, {}), replace(claim.words, time="s")
    numbers = {
        name: (float(value), float(std), words.of(unit))
        for name, (value, std, unit) in found.items()
    }
    known = [name for name, (value, std, _) in numbers.items() if not std > abs(value)]
    texts = [name for name in known if not _LESS_TELLING.match(name)] or known or list(numbers)
    texts = [
        f"{name} {plus_minus(*numbers[name][:2])} {numbers[name][2]}".strip() for name in texts[:4]
    ]
    texts = f"Identified: {listed(texts)}. " if texts else ""
    share = 100.0 * (1.0 - (after / before) ** 2) if before > 0.0 else 0.0
    without = f" or {listed(later)}" if later else ""
    removes = (
        f"It removes {share:.1f} % of the power of the held-out residual of the model without it"
        f"{without}."
    )
    if later and share < 0.1:
        removes = f"It lowers the held-out error only together with {listed(later)}."
    statement = f"{claim.effect.law} {texts}{removes}"
    picture = _tried("picture", draw, claim, Picture(claim.effect.name, "", "", ()))
    return Evidence(claim.effect.name, statement.strip(), numbers, picture)


def _tried(what, make, claim, instead):
    """Return the result of a function of a claim; if it raises an error, warn and return another.

    A user's own law may raise at values that no fit has visited; the search itself is complete.
    """
    try:
        return make(claim)
    except Exception as error:
        warnings.warn(
            f"The {what} of {claim.effect.name} could not be made, {type(error).__name__}: {error}",
            RuntimeWarning,
            stacklevel=2,
        )
        return instead


def _numbers(claim):
    """Return the numbers of a claim: of a part, or of the parameters that it changes."""
    return _of_parts(claim.counted()) if claim.operator else changes_by_number(claim)


def _of_parts(claim):
    """Return the parameters and characteristics of a part: name -> (value, standard error, unit).

    Parameters that the part had before the effect are left out. Levels are also given as a fraction
    of half the recorded range, widths as a fraction of the range.
    """
    keys, entries = list(claim.keys), claim.operator.entries()
    free = [[name for name, _ in entries].index(key) for key in keys]
    x = claim.operator.pack()
    x[free] = [claim.values[key][0] for key in keys]
    operator, signals = claim.operator.unpack(x), claim.seen
    found = dict(_derived(operator, signals, free, claim.covariance(keys)))
    if claim.kind == "branch":
        measured, identified = map(np.concatenate, claim.model_residuals(claim.without))
        explained = 100.0 * (1.0 - np.var(measured - identified) / np.var(measured))
        found["part of the residual that it explains"] = explained, np.nan, "%"
    outputs = np.concatenate(signals.outputs)
    half_ranges = {"drive": 0.5 * np.ptp(signals.ends), "response": 0.5 * np.ptp(outputs)}
    for key, index in zip(keys, free, strict=True):
        name, _, number = key.rstrip("]").partition("[")
        size = sum(other.partition("[")[0] == name for other, _ in entries)
        spec = entries[index][1]
        if size > 6 or name in claim.not_new:  # a longer vector is in the table of parameters only
            continue
        label, factor = _LABELS.get(name, (re.sub("_+", " ", name), 1.0))
        if number:
            label = re.sub("([^s])s$", r"\1", re.sub("ies$", "ys", label))
            label += f" {int(number) + 1}" if size > 1 else ""
        factor, unit = (0.5 / np.pi, "Hz") if spec.unit == "rad/s" else (factor, spec.unit)
        value, std = (factor * v for v in claim.values[key])
        found.setdefault(label, (value, std, unit))
        if unit in half_ranges and not number and (spec.log or spec.linear):
            scale = 100.0 / (factor * half_ranges[unit])
            found[f"{label} over the range"] = scale * value, scale * std, "%"
    stage_units = Units(*claim.units, claim.words.time)
    return {name: (v, std, stage_units.of(unit)) for name, (v, std, unit) in found.items()}


def _characteristics(operator, signals):
    """Return name -> (value, unit) of those characteristics of an operator that are finite."""
    found = {}
    for name, (values, unit) in characteristics(operator, signals).items():
        values = np.ravel(values)
        for i, value in enumerate(values, start=1):
            if np.isfinite(value):
                found[f"{name} {i}" if len(values) > 1 else name] = float(value), unit
    return found


def _derived(operator, signals, free, covariance):
    """Yield (name, (value, standard error, unit)) of characteristics.

    The errors are propagated linearly, with slopes between half a standard error on either side.
    """
    x, std = operator.pack(), np.sqrt(np.diag(covariance))
    # an error below the rounding of its value makes no difference
    known = np.flatnonzero(np.isfinite(std) & (std > np.spacing(np.abs(x[free]))))
    values, specs = _characteristics(operator, signals), operator.entries()
    slopes = {name: np.zeros(len(known)) for name in values}
    for column, i in enumerate(known):
        spec, ends, sides = specs[free[i]][1], [], []
        for step in (-0.5 * std[i], 0.5 * std[i]):
            moved = x.copy()
            moved[free[i]] = np.clip(x[free[i]] + step, spec.lower, spec.upper)
            ends.append(moved[free[i]])
            sides.append(_characteristics(operator.unpack(moved), signals))
        for name, (value, _) in values.items():
            below, above = (side.get(name, (value,))[0] for side in sides)
            slopes[name][column] = (above - below) / (ends[1] - ends[0])
    covariance = covariance[np.ix_(known, known)]
    for name, (value, unit) in values.items():
        error = np.sqrt(max(slopes[name] @ covariance @ slopes[name], 0.0))
        yield name, (value, error or np.nan, unit)
