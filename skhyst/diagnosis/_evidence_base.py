"""What all evidence is made of: the claim, its numbers, its picture, and what the model lacks."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..inspection._signals import branch
from ..operators import SumOperator

__all__ = ["Claim", "Evidence", "Picture", "binned", "by_direction", "compared", "directions"]

_BINS = 24
_FEWEST = 4  # samples of a bin that is drawn


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


@dataclass(frozen=True)
class Claim:
    """A claimed effect in the augmented model, and the records.

    Attributes
    ----------
    name : str
    structure : Tree
        The augmented model at its solution.
    result : IdentificationResult
        Of the augmented model, fitted on all records.
    records : sequence of RecordData
    before, after : Contestant
        Held-out residuals of the declared and of the augmented model.
    columns : sequence of str
        Names of the columns of X; empty where they have none.
    """

    name: str
    structure: object
    result: object
    records: tuple
    before: object
    after: object
    columns: tuple = ()

    @cached_property
    def at(self):
        """The number of the stage that the effect is, or has changed."""
        return self.structure.place(self.name)

    @cached_property
    def label(self):
        """The name of what was added for the effect."""
        return self.structure.label(self.name)

    @cached_property
    def is_part(self):
        """Whether the effect is one part of a sum of forces."""
        return self.structure.is_part(self.name)

    @cached_property
    def operator(self):
        """The operator that the effect is, or has become a part of."""
        return self.structure.part(self.name)

    @cached_property
    def values(self):
        """The parameters of the operator: name -> (value, standard error)."""
        structure = self.structure
        place = structure.edits_of(self.name)[0].place
        marks = [f"{self.label}__"]
        if place and not self.is_part:
            marks = [f"{place}__"]
        elif self.label in structure.beside_names:
            marks.append(f"disturbance{structure.beside_names.index(self.label)}__")
        found = {}
        for key, value in self.result.params.items():
            for mark in marks:
                if key.startswith(mark) or f"__{mark}" in key:
                    found[key.split(mark, 1)[1]] = (value, self.result.params_std[key])
        if not found and place:  # a single model has no names of stages
            keys = {key.removeprefix("model__"): key for key in self.result.params}
            found = {
                short: (self.result.params[key], self.result.params_std[key])
                for short, key in keys.items()
                if "__" not in short
            }
        return found

    def number(self, key, unit, factor=1.0, index=None):
        """Return (value, standard error, unit) of a parameter, times a factor."""
        value = np.ravel(getattr(self.operator, key))[index or 0]
        std = self.values.get(key if index is None else f"{key}[{index}]", (value, np.nan))[1]
        return float(factor * value), float(abs(factor) * std), unit

    def all_numbers(self):
        """Return every parameter as a number."""
        return {key: (*value, "") for key, value in self.values.items()}

    # ------------------------------------------------------------------ signals

    def coefficients(self, disturbance):
        """Return what belongs to each record of a disturbance, (n_records, n_coefficients)."""
        others = self.structure.disturbances
        at = next(i for i, other in enumerate(others) if other is disturbance)
        start = sum(np.size(other.coefficients) for other in others[:at])
        size = np.size(disturbance.coefficients)
        return self.result.record_coefficients[:, start : start + size]

    @cached_property
    def measured(self):
        """The response of each record without the disturbances."""
        found = [np.array(record.y) for record in self.records]
        for disturbance in self.structure.disturbances:
            for y, record, own in zip(
                found, self.records, self.coefficients(disturbance), strict=True
            ):
                y -= disturbance.basis(record.dt * np.arange(len(y))) @ own
        return found

    @cached_property
    def modelled(self):
        """The response of the driven part to each record."""
        return self.structure.respond(self.records)

    def inputs(self):
        """Return what goes into the stage in each record."""
        return self.structure.run(self.records, last=self.at)

    @cached_property
    def rest(self):
        """The model without the stage, or without the part of the sum that the effect is."""
        structure, at = self.structure, self.at
        if self.is_part:
            stage, model = structure.operators[at], structure.models[at]
            kept = [i for i, name in enumerate(stage.names) if name != self.label]
            own = SumOperator(
                tuple(stage.names[i] for i in kept), tuple(stage.stages[i] for i in kept)
            )
            return self.with_stage(own, model)
        return structure.cut(structure.names[at])

    def with_stage(self, operator, model=None):
        """Return the model with another operator in the effect's place."""
        changes = {} if model is None else {"model": model}
        return self.structure.with_stage(self.at, operator=operator, **changes)

    def lacking(self, without):
        """Return what a model lacks: of the measurement, and of the augmented model."""
        return (
            [y - x for y, x in zip(self.measured, without, strict=True)],
            [y - x for y, x in zip(self.modelled, without, strict=True)],
        )

    def left_out(self):
        """Return what the rest responds, and what it lacks; see :meth:`lacking`.

        Where the effect carries the gain of the series, a straight line gives the rest its own.
        """
        without = self.rest.respond(self.records)
        if self.structure.operators[self.at].carries_scale and not self.is_part:
            x, y = np.concatenate(without), np.concatenate(self.measured)
            slope, constant = np.polyfit(x, y, 1)
            without = [slope * part + constant for part in without]
        return without, *self.lacking(without)


def directions(signals):
    """Return whether each sample of all records rises."""
    return np.concatenate([branch(signal) > 0 for signal in signals])


def binned(x, values, bins=_BINS):
    """Return the means of two signals over bins of the first.

    Edges are halfway between those of equal width and those of equal numbers of samples: neither
    the ends of the range nor the places where the signal dwells are missed.
    """
    part = np.linspace(0.0, 1.0, bins + 1)
    low, high = np.min(x), np.max(x)
    edges = 0.5 * (low + (high - low) * part + np.quantile(x, part))
    which = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, bins - 1)
    count = np.bincount(which, minlength=bins)
    full = count >= min(_FEWEST, x.size)
    count = count[full]
    return tuple(np.bincount(which, v, minlength=bins)[full] / count for v in (x, values))


def compared(x, measured, identified, bins=_BINS):
    """Return curves of a signal's mean against another, measured and identified."""
    return (
        ("measured", *binned(x, measured, bins), "points"),
        ("identified", *binned(x, identified, bins), "line"),
    )


def by_direction(x, rising, measured, identified):
    """Return curves of a signal's mean against another, apart for either direction.

    All are lists of one array a record but ``rising``, which is one array.
    """
    x = np.concatenate(x)
    curves = []
    for source, values, style in (
        ("measured", measured, "points"),
        ("identified", identified, "line"),
    ):
        values = np.concatenate(values)
        for label, side in (("rising", rising), ("falling", ~rising)):
            if side.any():
                curves.append((f"{source}, {label}", *binned(x[side], values[side]), style))
    return tuple(curves)
