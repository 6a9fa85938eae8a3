"""What a claim rests on: a sentence, numbers with their errors, and a picture."""

import re
from dataclasses import dataclass

import numpy as np

from ._by_record import NUMBERS, column_numbers
from ._characteristics import OF_CLASSES, characteristics
from ._claim import Claim
from ._pictures import Picture, draw
from ._report_text import in_words, listed, plus_minus, unit_of

__all__ = ["Evidence", "gather_evidence"]

_LONGEST = 6  # values of a vector that are listed one by one; more are in the list of parameters
_TOLD = 4  # numbers in the sentence, at the most
_NOT_ITS_OWN = ("gain", "intercept")  # of a stage, for what it does to the signal
_SPOKEN = {"lower": ("lower level", 1.0), "upper": ("upper level", 1.0)} | {
    "half_width": ("width of the band", 2.0),
    "half_gap": ("play", 2.0),
}  # parameters that an engineer counts otherwise: name and factor


@dataclass(frozen=True)
class Evidence:
    """What a claim rests on.

    ``numbers`` maps a name to (value, standard error or NaN, unit).
    """

    effect: str
    statement: str
    numbers: dict
    picture: Picture


def gather_evidence(effect, structure, result, records, before, after, names):
    """Return the evidence for a claimed effect.

    Parameters
    ----------
    effect : Effect
    structure : Structure
        The augmented model at its solution.
    result : IdentificationResult
        Of the augmented model, fitted on all records.
    records : sequence of RecordData
    before, after : Candidate
        Held-out residuals of the declared and of the augmented model.
    names : tuple (columns, response)
        Names of the columns of X, none where they have none, and of y.

    Returns
    -------
    Evidence
    """
    columns, response = names
    claim = Claim(
        effect, structure, result, tuple(records), before, after, tuple(columns), response
    )
    share = 100.0 * (1.0 - (after.error / before.error) ** 2) if before.error > 0.0 else 0.0
    numbers, leading = NUMBERS.get(claim.kind, _numbers)(claim), _leading(claim)
    first = [n for start in leading for n in numbers if re.fullmatch(rf"{start}( \d+)?", n)]
    words = unit_of(columns[0]) if len(columns) else "", unit_of(response)
    numbers = {
        name: (float(numbers[name][0]), float(numbers[name][1]), in_words(numbers[name][2], *words))
        for name in dict.fromkeys([*first, *numbers])
    }
    told = listed(
        f"{name} {plus_minus(*numbers[name][:2])} {numbers[name][2]}".strip()
        for name in (first or list(numbers))[:_TOLD]
    )
    statement = (
        f"{effect.law} Identified: {told}. The augmented model removes {share:.1f} % of the power "
        "of the declared model's held-out residual."
    )
    return Evidence(effect.name, statement.strip(), numbers, draw(claim))


def _leading(claim):
    """Return the names, without a number, of what matters most; none where all do alike."""
    if claim.kind in NUMBERS:
        return []
    names = [name for name, *_ in OF_CLASSES.get(type(claim.operator), ())]
    return ["gain", *names] if claim.kind == "branch" else names


def _numbers(claim):
    """Return name -> (value, standard error, unit): what characterises a part, its parameters."""
    keys, entries = list(claim.keys), claim.operator.entries()
    free = [[name for name, _ in entries].index(key) for key in keys]
    x = claim.operator.pack()
    x[free] = [claim.values[key][0] for key in keys]
    operator = claim.operator.unpack(x)
    found = dict(_derived(operator, claim.seen, free, claim.covariance(keys)))
    if claim.kind == "branch":
        found |= column_numbers(claim)
    sizes = operator.sizes()
    for key, index in zip(keys, free, strict=True):
        name, _, number = key.rstrip("]").partition("[")
        if sizes[name] > _LONGEST or (name in _NOT_ITS_OWN and claim.kind != "branch"):
            continue
        label, factor = _SPOKEN.get(name, (name.replace("_", " "), 1.0))
        unit = entries[index][1].unit
        if unit == "rad/s":
            unit, factor = "Hz", 0.5 / np.pi
        if number:
            label = re.sub("([^s])s$", r"\1", re.sub("ies$", "ys", label))
            label += f" {int(number) + 1}" if sizes[name] > 1 else ""
        value, std = claim.values[key]
        found.setdefault(label, (factor * value, factor * std, unit))
    return {
        name: (value, std, in_words(unit, *claim.units))
        for name, (value, std, unit) in found.items()
    }


def _derived(operator, seen, free, covariance):
    """Yield (name, (value, standard error, unit)) of the characteristics, to first order."""
    x, std = operator.pack(), np.sqrt(np.diag(covariance))
    known = np.flatnonzero(np.isfinite(std) & (std > 0.0))
    bounds = [(spec.lower, spec.upper) for _, spec in operator.entries()]
    values = characteristics(operator, seen)
    slopes = {name: np.zeros(len(known)) for name in values}
    for column, i in enumerate(known):
        at, sides = free[i], []
        for sign in (-0.5, 0.5):
            moved = x.copy()
            moved[at] = np.clip(x[at] + sign * std[i], *bounds[at])
            sides.append((moved[at], characteristics(operator.unpack(moved), seen)))
        (low, below), (high, above) = sides
        for name, (value, _) in values.items():
            ends = [side.get(name, (value,))[0] for side in (below, above)]
            slopes[name][column] = (ends[1] - ends[0]) / (high - low)
    own = covariance[np.ix_(known, known)]
    for name, (value, unit) in values.items():
        error = np.sqrt(max(slopes[name] @ own @ slopes[name], 0.0))
        yield name, (value, error or np.nan, unit)
