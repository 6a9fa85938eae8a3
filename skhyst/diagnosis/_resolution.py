"""Resolution before physics: the number and positions of terms, found before any effect.

A part with too few terms, or with terms at other positions than the device, leaves a misfit that
looks like an effect. So the resolution of each part is raised or lowered to the least held-out
error, see :mod:`skhyst.optimize`. Where there are several records, those within the range of the
others are held out whole, so that terms that only fit a single record are not accepted.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from ..operators import parts_with_resolution
from ..optimize import exchanged, merged_segments, whole_record_folds
from ._candidates import held_out, refitted
from ._shortened import shortened

# Samples above which the first parts of the records are scanned: a scan has about a hundred
# columns, which then take a hundred megabytes.
_LONGEST = 100_000


@dataclass(frozen=True)
class Raised:
    """A change of the resolution of a part.

    Attributes
    ----------
    stage : str
        Name of the stage that the part is, or belongs to.
    name : str
        What its terms are called, in the plural.
    before, after : int
        Number of terms.
    error_before, error_after : float
        Held-out error of the model, units of the response.
    """

    stage: str
    name: str
    before: int
    after: int
    error_before: float
    error_after: float

    def __str__(self):
        if self.after == self.before:
            return f"{self.before} {self.name}, thresholds refitted"
        return f"{self.before} {self.name}, changed to {self.after}"


def raised(candidate, records, folds):
    """Return a candidate whose parts have the resolution of least held-out error, and the changes.

    Parameters
    ----------
    candidate : Candidate
        At its solution, held out.
    records : list of RecordData
    folds : list of (train, test)
        As for ``held_out``.

    Returns
    -------
    candidate : Candidate
        Held out; the given one if nothing predicts better.
    done : list of Raised
        In the order of the parts; none for a part that is unchanged.
    """
    parts = records
    if sum(len(record.u) for record in records) > _LONGEST:
        parts = shortened(records, candidate.residuals) or records
    inner = whole_record_folds(parts, folds)
    if not candidate.structure.disturbances:
        parts, inner = merged_segments(parts, inner)
    done = []
    for at, prefix in _places(candidate.structure):
        place = _Place.of(candidate.structure, parts, at, prefix)
        found = exchanged(place, inner)
        if found is place:
            continue
        anew = refitted(candidate, found.resolved(), records)
        anew = held_out(anew, records, folds)
        if not anew.error < candidate.error:
            continue
        counts = [own.part.resolution.of(own.part) for own in (place, found)]
        name, errors = place.part.resolution.name, (candidate.error, anew.error)
        done.append(Raised(place.tree.names[at], name, *counts, *errors))
        candidate = anew
    return candidate, done


def _places(tree):
    """Return the stages with a resolution, and the path of the part within each.

    A part with entries that vary from record to record is left unchanged.
    """
    scheduled = {stage for stage, _ in tree.lines}
    return [
        (at, prefix)
        for at, (name, operator) in enumerate(tree.stages)
        if name not in scheduled
        for prefix, _, _ in parts_with_resolution(operator)
    ]


@dataclass(frozen=True)
class _Place:
    """A part of a tree, in the form that :func:`skhyst.optimize.exchanged` needs."""

    tree: object
    records: list
    at_stage: int
    prefix: str
    part: object

    @classmethod
    def of(cls, tree, records, at, prefix):
        return cls(tree, records, at, prefix, cls._part_of(tree, at, prefix))

    @staticmethod
    def _part_of(tree, at, prefix):
        return next(p for own, p, _ in parts_with_resolution(tree.operators[at]) if own == prefix)

    def inputs(self):
        """Return the records with the input of the part as their drive."""
        signals = self.tree.run(self.records, last=self.at_stage)
        return [replace(r, u=u) for r, u in zip(self.records, signals, strict=True)]

    def name(self, entry):
        """Return the name of an entry of the part in the problem."""
        return self._path + entry

    @cached_property
    def _path(self):
        """The prefix of the names of the part's entries in the problem."""
        first = f"{self.part.resolution.weights}[0]"
        whole = self.tree.operator
        keys = zip(whole.keys(self.tree.name), whole.entries(), strict=True)
        stage = self.tree.names[self.at_stage], self.prefix + first
        return next(name for key, (name, _) in keys if key == stage).removesuffix(first)

    def _with(self, part):
        """Return the operator of the stage with another part."""
        stage = self.tree.operators[self.at_stage]
        puts = {prefix: put for prefix, _, put in parts_with_resolution(stage)}
        return puts[self.prefix](part)

    def problem(self, part):
        """Return the least-squares problem of the tree with another part at this place."""
        return self.tree.with_stage(self.at_stage, self._with(part)).problem(self.records)

    def at(self, problem, x):
        """Return the place with the operators of a problem at ``x``."""
        tree = self.tree.with_operators(*problem.unpack(x))
        return replace(self, tree=tree, part=self._part_of(tree, self.at_stage, self.prefix))

    def resolved(self):
        """Return the tree with the part, and with a model of its resolution."""
        part = self.part
        if part.model is not None:
            part = replace(part, model=part.model.resolved(part))
        operator = self._with(part)
        if part.model is None:  # it belongs to a single model
            operator = replace(operator, model=operator.model.resolved(operator))
        tree = self.tree.with_stage(self.at_stage, operator)
        return replace(tree, moved=(*tree.moved, self.tree.names[self.at_stage]))
