"""Resolution before physics: how many terms the data ask for, and where, before any effect.

A part whose terms are too few, or stand elsewhere than those of the device, leaves a misfit that
looks like an effect. So the resolution of each part is raised, or lowered, as the held-out error
says, see :mod:`skhyst.optimize`. It pays for its parameters: where there are several records, those
of which the others know the range are held out whole, so that a second record is not swallowed.
"""

from dataclasses import dataclass, replace
from functools import cached_property

from ..operators import parts_with_resolution
from ..optimize import exchanged, merged_segments, whole_record_folds
from ._candidates import held_out, refitted
from ._shortened import shortened

# Samples above which the first parts of the records are scanned: about a hundred columns of a scan
# take a hundred megabytes there.
_LONGEST = 100_000


@dataclass(frozen=True)
class Raised:
    """What was done to the resolution of a part.

    Attributes
    ----------
    stage : str
        Name of the stage that the part is, or is in.
    name : str
        What its terms are, in the plural.
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
            return f"{self.before} {self.name}, moved to where the data ask for them"
        return f"{self.before} {self.name}, the data ask for {self.after}"


def raised(candidate, records, folds):
    """Return a candidate with parts as fine as the data ask for, and what was done.

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
        Held out; the same where nothing predicts better.
    done : list of Raised
        In the order of the parts, none for a part that stays as it is.
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
    """Return the stages with a resolution, and where in each of them the part is.

    A part some of whose entries follow a number of the record stays as it is.
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
    """A part of a tree, as :func:`skhyst.optimize.exchanged` wants it."""

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
        """Return the records with what comes into the part as their drive."""
        signals = self.tree.run(self.records, last=self.at_stage)
        return [replace(r, u=u) for r, u in zip(self.records, signals, strict=True)]

    def name(self, entry):
        """Return the name of an entry of the part in the problem."""
        return self._path + entry

    @cached_property
    def _path(self):
        """What the problem puts before the names of the part's entries."""
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
        """Return the least-squares problem of the tree with another part in the place."""
        return self.tree.with_stage(self.at_stage, self._with(part)).problem(self.records)

    def at(self, problem, x):
        """Return the place with the operators of a problem at ``x``."""
        tree = self.tree.with_operators(*problem.unpack(x))
        return replace(self, tree=tree, part=self._part_of(tree, self.at_stage, self.prefix))

    def resolved(self):
        """Return the tree with the part, and with a model that says so."""
        part = self.part
        if part.model is not None:
            part = replace(part, model=part.model.resolved(part))
        operator = self._with(part)
        if part.model is None:  # it is inside of a single model
            operator = replace(operator, model=operator.model.resolved(operator))
        return self.tree.with_stage(self.at_stage, operator)
