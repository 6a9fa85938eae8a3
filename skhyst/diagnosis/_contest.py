"""The steps of a search: effects are added to a model, removed from it, and contested.

**Grow.** Every effect is added to the current model at data-driven starting values; candidates are
halved and held out (``_candidates``). The one that lowers the held-out error most is kept, without
a test, and a second path continues with the simplest candidate that the data do not distinguish
from it. Effects that respond to the drive come first; functions of time alone follow where none of
these helps. Where no effect helps but the residual has structure, the three that fit best are tried
in pairs with every other one.

**Prune.** From the model with all effects, each effect is removed once: the full model is tested
against the model without it, so that chance is the residual of the full model. Of the effects that
the criterion (``_criterion``) does not need, the one whose removal costs least goes; and so on. A
function of time alone stays only where the course of the noise does not explain it (``_course``).
Choices that were made with an effect that is removed, such as the number of plays, may be wrong
without it: if it is the first effect of a path, the model grows again without it.

**Name.** Each remaining effect is contested by all others at its place. The name is that of the
least held-out error; a function of time alone gives way to an effect that responds to the drive, is
not rejected against it, and is simpler or predicts about as well. A simpler effect replaces the
best if it is nested in it, as far as the recording shows, and the larger one is not better by the
criterion.

A step is done once for a set of effects: its result is kept, and is what a checkpoint stores.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from joblib import delayed

from ..disturbance import SinusoidOperator
from ..optimize import variable_projection
from ._candidates import (
    completed,
    fold_errors,
    halve,
    halves,
    held_out,
    level_folds,
    longest_block,
    refitted,
    screened,
)
from ._constants import FEW, RUNG, TOLERANCE, USUAL
from ._course import course_p_values
from ._effects import EFFECTS
from ._jobs import side_by_side
from ._plausibility import has_its_name, is_plausible, ringing_time
from ._resolution import raised
from ._robust import huber_weights
from ._shortened import are_long, shortened, suffices
from ._traits import n_ringing


@dataclass
class Contest:
    """The steps of one search.

    Attributes
    ----------
    effects : list of Effect
        Effects to try.
    records, folds
        Of the contest, see :func:`held_out`.
    criterion : Criterion
    max_effects, n_jobs
        As of the search.
    negligible : float
        Held-out error below which no effect is sought.
    report_progress : callable
        Called with a line about progress or "", the round, the effect that is tried, the number of
        finished candidates of the step, and their total.
    renew : callable or None
        Fits a declared black box again after an effect is added or removed, see ``BlackBox.renew``.
        Candidates are driven by its out-of-fold prediction.
    judge : callable
        Returns the :class:`Judgement` of the residual of a candidate.
    lost : list of ndarray of bool or None
        Lost readings of each record for Huber's loss; None for squared loss.
    keep : callable or None
        Called with the steps after each one.
    steps : dict of str to dict
        Result of each finished step: ``candidates``, ``rows`` of the ranking, ``failed``
        candidates, and the number of contestants ``n_tried``.
    dropped : list of str
        Effects that were in the model at some stage of the search, and were removed.
    seconds : dict of str to float
    declared : Tree or None
        The declared model, with its declared resolution.
    """

    effects: list
    records: list
    folds: list
    criterion: Any
    max_effects: int
    n_jobs: int | None
    negligible: float
    report_progress: Callable
    renew: Callable | None
    judge: Callable
    lost: list | None = None
    keep: Callable | None = None
    steps: dict = field(default_factory=dict)
    dropped: list = field(default_factory=list)
    seconds: dict = field(default_factory=dict)
    declared: Any = None
    _visited: dict = field(default_factory=dict)  # those that this search has used
    _failures: list = field(default_factory=list)
    _best: dict = field(default_factory=dict)
    _judgements: dict = field(default_factory=dict)
    _contests: dict = field(default_factory=dict)
    _reidentified_fits: dict = field(default_factory=dict)
    _rounds: dict = field(default_factory=dict)
    _weighings: int = 0

    # ------------------------------------------------------------------ what was tried

    @property
    def n_tried(self):
        """Number of contestants that were screened for one model, and of all possible pairs."""
        singles = [step["n_tried"] for step in self._visited.values() if not step["in_pairs"]]
        pairs = [step["n_tried"] for step in self._visited.values() if step["in_pairs"]]
        return max(singles, default=1) + max(pairs, default=0)

    @property
    def ranking(self):
        """One row per effect and round, with the p-value corrected for all that was tried."""
        rows = [row for step in self._visited.values() for row in step["rows"]]
        family = self.n_tried  # an unknown p-value is NaN
        return [row | {"p_value": float(np.minimum(1.0, family * row["p_value"]))} for row in rows]

    @property
    def _helpful(self):
        """Names of the effects that have lowered the held-out error of some model.

        Also of those that fitted better by more than ``min_improvement`` but were not held out,
        because others fitted better still, such as curves in front of a saturating hysteresis.
        """
        rows = [row for step in self._visited.values() for row in step["rows"]]
        least = 1.0 - (1.0 - self.criterion.min_improvement) ** 2
        return {
            row["effect"]
            for row in rows
            if row["error_after"] < row["error_before"]
            or (np.isnan(row["error_after"]) and row["screen"] > least)
        }

    @property
    def failed(self):
        """One row per candidate that raised an error."""
        return [row for step in self._visited.values() for row in step["failed"]]

    # ------------------------------------------------------------------ resolution

    def raised(self, base):
        """Return a candidate with the resolution of least held-out error, and the changes."""
        begin = time.perf_counter()
        finer, done = raised(base, self.records, self.folds)
        self._add_time("resolution", begin)
        for change in done:
            self._report_progress(f"{change}: held-out error {change.error_after:.4g}")
        return finer, done

    def _finer(self, candidate):
        """Return a candidate with its best resolution, if its effects keep their names."""
        finer = replace(self.raised(candidate)[0], effects=candidate.effects)
        return finer if self._keeps_names(finer, candidate) else candidate

    # ------------------------------------------------------------------ grow

    def found(self, base):
        """Return the best model that grows from a base, pruned and named.

        If the first effect of a path is pruned, the choices that were made with it may be wrong:
        the search grows again without it, as if it were not among the effects.
        """
        barred, every, depth = set(), [], len(base.structure.effects)
        base = self._least(base)
        while True:
            pruned = set()
            for path in self.grow(base, barred):
                every.append(self.prune(path))
                first = path.structure.effects[depth : depth + 1]
                pruned.update(set(first).difference(every[-1].structure.effects))
            if not pruned:
                return self.named(min(every, key=lambda c: c.error))[0]
            barred |= pruned

    def grow(self, base, barred=()):
        """Add effects until the held-out error no longer falls; return the ends of the paths.

        Effects of the names in ``barred`` are not added.
        """
        paths, ends = [base], []
        while paths:
            further, claims = [], []
            for number, path in enumerate(paths):
                better = self._better(path, number == 0, barred)
                if not better:
                    ends.append(path)
                further += better
                claims += [c for c in better if self.criterion.is_better(path, c, self.n_tried)]
            paths = self._few(further, claims)
            for c in paths:
                self._report_progress(
                    f"{' + '.join(c.structure.effects)}: held-out error {c.error:.4g}"
                )
        return ends

    def _better(self, path, fully, barred=()):
        """Return the candidates with more effects that predict better than the end of a path.

        With ``fully``, all effects are tried; else those that have helped some model before. Those
        whose names are in ``barred`` are left out.
        """

        def allowed(candidates):
            return [c for c in candidates if set(barred).isdisjoint(c.structure.effects)]

        room = self.max_effects - len(path.structure.effects)
        if room <= 0 or path.error <= self.negligible:
            return []
        driven = allowed(self.extended(path, fully=fully))
        found = [c for c in driven if self.criterion.improves_enough(path, c)]
        if not found:
            added = allowed(self.extended(path, additive=True))
            found = [c for c in added if self.criterion.is_better(path, c, self.n_tried)]
        if not found and room > 1 and self.judgement(path).structured:
            pairs = allowed(self._pairs(path, driven))
            found = [c for c in pairs if self.criterion.improves_enough(path, c)]
        return found

    def _few(self, candidates, claims):
        """Return the candidates that continue: the best, and the simplest of equal ones.

        Both among all candidates and among those that would be claimed at once, so that one path at
        least does not begin with an effect that fits chance. Also the one of the best that leads
        when each is identified from scratch, with the resolution that it asks for.
        """
        least, few = {}, []
        for c in sorted(candidates, key=lambda c: c.error):
            least.setdefault(frozenset(c.structure.effects), c)
        claimed = {frozenset(c.structure.effects) for c in claims}
        for sets in (least, [names for names in least if names in claimed]):
            group = [least[names] for names in sets]
            if group:
                same = [c for c in group if not self.criterion.is_better(c, group[0])]
                simplest = min(same, key=lambda c: (c.n_parameters, c.error))
                finest = [self._refreshed(c) for c in group[:FEW]]
                best = min(finest, key=lambda c: c.error)
                few += [finest[0], best, self._refreshed(simplest)]
        return list({frozenset(c.structure.effects): c for c in few}.values())

    def _refreshed(self, base):
        """Return a candidate identified from scratch, with its best resolution.

        It is also tried with the declared resolution: terms may have been added to compensate for
        an effect that was missing then. The candidate that predicts best is returned.
        """
        if self.renew is not None:
            return self.renew(base, base, self.records_of(base), thorough=True)
        key = self._set(base), base.structure.effects, base.error
        if key not in self._reidentified_fits:
            self._reidentified_fits[key] = self._reidentified(base)
        return self._least(self._reidentified_fits[key])

    def _reidentified(self, base):
        records = self.records_of(base)
        tree, anew = base.structure, []
        trees = [] if are_long(records) else [tree.identified(records)]
        # compared by size: a tree from a checkpoint is another object
        if self.declared is not None and tree.declared is not None:
            sizes = {t.root.n_parameters for t in (tree.declared, self.declared)}
            if len(sizes) > 1:
                again = self.declared
                for name in tree.effects:
                    again = again.edited(name, *tree.edits_of(name))
                trees.append(again.identified(records))
        if tree.input_history:
            trees = [t.with_input_history(records) for t in (tree, *trees)]
        for other in trees:
            candidate = refitted(base, other, records)
            same = candidate.cost >= (1.0 - TOLERANCE) * base.cost  # within tolerance
            if not (same and other is trees[0]) and self._keeps_names(candidate, base):
                anew.append(held_out(candidate, records, self.folds))
        best = self._least(min(map(self._finer, [base, *anew]), key=lambda c: c.error))
        if best.structure.root.n_parameters == tree.root.n_parameters or not base.effects:
            return best
        return min([best, *self._variants_of(best)], key=lambda c: c.error)

    def _variants_of(self, base):
        """Return a better variant of the last effect of a candidate, as a list of one or none.

        The present variant was chosen with another resolution of the other parts.
        """
        name = base.effects[-1]
        key = f"{self._set(base)} and other variants of {name}"
        if not self._is_done(key):
            start = refitted(base, base.structure.without(name), self.records_of(base))
            pairs = [(effect, start) for effect in self.effects if effect.name == name]
            found = self._fitted([start], self._screened(start, pairs))
            self._keep(key, self._held_out(start, found))
        found = self.steps[key]["candidates"]
        return [self._finer(c) for c in found if self.criterion.improves_enough(base, c)]

    def _p_value(self, base, name, reduced):
        """Return the p-value of an effect of a candidate, for all that was tried.

        A drift or an offset is one slow course in each record, hence one block in the test of the
        criterion: its power is compared with that of the course of the noise itself. A sinusoid
        repeats within a record and passes both tests.
        """
        p_values = {}
        # the residual of a black box has a course that depends on the box
        if self.renew is None and EFFECTS[name].additive:
            p_values = course_p_values(base.structure, self.records_of(base))
        # none of a force within the driven part
        course = min(1.0, self.n_tried * p_values.get(name, 0.0))
        if name in p_values and not isinstance(base.structure.part(name), SinusoidOperator):
            return course
        return max(course, self.criterion.p_value(reduced, base, self.n_tried))

    # ------------------------------------------------------------------ prune

    def prune(self, base):
        """Remove the effects that are not needed, the least important first; return the candidate.

        An effect stays if without it another effect takes over its function under a name that no
        longer fits. Where the course of the noise explains an effect, but something is needed in
        its place, a rival replaces it, such as an offset per record for a drift. Two effects may
        compensate for each other, such as a lag and a lead: they are also removed together.
        """
        while base.structure.effects:
            names = base.structure.effects
            reduced = {(name,): self.without(base, name) for name in names}
            needless = {
                gone: c
                for gone, c in reduced.items()
                if not self._is_needed(base, *gone, c)
                and (self.criterion.improves_enough(c, base) or self._keeps_names(c, base))
            }
            if not needless:
                for first, second in combinations(names, 2):
                    both = reduced[first,]
                    if second in both.structure.effects:  # may be an edit of the first
                        both = self.without(both, second)
                    # each on its own; one may have gone with the other
                    alone = [
                        (c, name)
                        for c, name in ((reduced[first,], second), (reduced[second,], first))
                        if name in c.structure.effects
                    ]
                    needed = self.criterion.is_better(both, base, self.n_tried)
                    if not needed and not any(self._is_needed(*pair, both) for pair in alone):
                        needless[first, second] = both
            if not needless:
                break
            gone = min(needless, key=lambda names: needless[names].error)
            fewer, rival = needless[gone], None
            if self.criterion.is_better(fewer, base, self.n_tried):
                rival, _ = self._contested(base, *gone)
            self.dropped += [n for n in names if n not in fewer.structure.effects]
            base = rival or fewer
            self._report_progress(
                f"{' and '.join(gone)} not needed: held-out error {base.error:.4g}"
            )
        return base

    def _is_needed(self, base, name, reduced):
        """Whether a model is better than without one of its effects, beyond chance."""
        return (
            self.criterion.improves_enough(reduced, base)
            and self._p_value(base, name, reduced) < self.criterion.alpha
            and self._predicts_halves(base, name, reduced)
        )

    def _predicts_halves(self, base, name, reduced):
        """Whether a mode that rings for longer than a held-out block predicts half of each record.

        The blocks before and behind a held-out one determine the envelope of such a ringing within
        it, whatever has caused it, so that only the other half of the records is a test.
        """
        tree, records = base.structure, self.records_of(base)
        if tree.label(name) not in tree.names or not n_ringing(tree.part(name)):
            return True
        if ringing_time(tree.part(name)) <= longest_block(records, self.folds):
            return True
        folds = halves(records)
        return self.criterion.improves_enough(
            held_out(reduced, records, folds), held_out(base, records, folds)
        )

    def _keeps_names(self, candidate, base):
        """Whether effects of a candidate keep the properties of their names."""
        names = candidate.structure.effects
        return all(
            self._has_its_name(candidate, n) or not self._has_its_name(base, n) for n in names
        )

    def _has_its_name(self, candidate, name):
        records, margin = self.records_of(candidate), EFFECTS[name].plausible
        return has_its_name(name, margin, candidate.structure, records, self.criterion.alpha)

    def without(self, base, name):
        """Return the best model that was found without one of the effects of a candidate."""
        return self._least(self._without_effect(base, name))

    def _without_effect(self, base, name):
        """Return a candidate without one of its effects, refitted and held out."""
        key = f"{self._set(base)} without {name}"
        if not self._is_done(key):
            records = self.records_of(base)
            reduced = refitted(base, base.structure.without(name), records)
            if self.renew is None:
                reduced = held_out(reduced, records, self.folds)
            else:  # the remaining effects may compensate for the removed one
                reduced = self.renew(reduced, base, records)
            self._keep(key, [reduced])
        return self.steps[key]["candidates"][0]

    def _least(self, candidate):
        """Return the candidate of least error that was found with the same effects."""
        key = self._weighings, frozenset(candidate.structure.effects)
        known = self._best.setdefault(key, candidate)
        if candidate.error < known.error:
            self._best[key] = known = candidate
        return replace(known, effects=candidate.effects)

    # ------------------------------------------------------------------ name

    def named(self, base):
        """Return a candidate with the best name at each place, and the ambiguous names of each.

        It is pruned first: more has been tried, and smaller models have been found, since.
        """
        seen, base = set(), self.prune(self._least(base))
        while self._set(base) not in seen:
            seen.add(self._set(base))
            for name in base.structure.effects:
                rival, _ = self._contested(base, name)
                if rival is not None:
                    base = self.prune(rival)
                    break
        ambiguous = {}
        for name in base.structure.effects:
            rival, others = self._contested(base, name)
            if rival is not None:  # names alternate in a cycle
                others = dict.fromkeys((*rival.effects, *others))
            ambiguous[name] = tuple(other for other in others if other != name)
        return base, ambiguous

    def _contested(self, base, name):
        """Return the rival that replaces an effect, or None, and the names it is ambiguous with.

        These are the effects that are not distinguished from the best one. An effect without the
        property of its name stays only where it is better than every rival.
        """
        key = self._set(base), base.error, name, self.n_tried
        if key not in self._contests:
            self._contests[key] = self._contest(base, name)
        return self._contests[key]

    def _contest(self, base, name):
        reduced = self.without(base, name)
        tree = base.structure
        start = self._without_effect(base, name)
        if tree.effects[1:]:
            # the values before the removal: other effects do not yet compensate for it
            start = replace(start, structure=tree.without(name))
        rivals = self.extended(start, fully=False) + self.extended(start, additive=True)
        own = replace(base, effects=(name,))
        rivals = [
            c
            for c in rivals
            if self._is_needed(c, c.effects[0], reduced)
            # another variant of the same effect is a rival if it is simpler or the error falls
            # noticeably
            and (
                c.effects != (name,)
                or c.n_parameters < own.n_parameters
                or self.criterion.improves_enough(base, c)
            )
        ]
        rivals.sort(key=lambda c: c.error)
        # the best rivals are identified from scratch, as the model was
        rivals = [
            replace(self._variant([c, self._refreshed(c)]), effects=c.effects) if i < FEW else c
            for i, c in enumerate(rivals)
        ]
        alpha = self.criterion.alpha
        if self._has_its_name(base, name) or all(self.criterion.is_better(c, own) for c in rivals):
            rivals.append(own)
        chosen = min(rivals, key=lambda c: c.error)
        same = [c for c in rivals if self.criterion.p_value(c, chosen) >= alpha]
        if _is_additive(chosen):
            # what responds to the drive explains new records, a function of time alone does not
            driven = [
                c
                for c in same
                if not _is_additive(c)
                and (
                    c.n_parameters < chosen.n_parameters
                    or not self.criterion.improves_enough(c, chosen)
                )
            ]
            chosen = min(driven, key=lambda c: c.error, default=chosen)
        simpler = [
            c
            for c in rivals
            if c.n_parameters < chosen.n_parameters
            and not self.criterion.is_better(c, chosen)
            and self._contains(chosen, c)
        ]
        chosen = min(simpler, key=lambda c: (c.n_parameters, c.error), default=chosen)
        same = [c for c in same if c is not chosen and c.effects != chosen.effects]
        names = [c.effects[0] for c in sorted(same, key=lambda c: c.error)]
        return None if chosen is own else chosen, tuple(dict.fromkeys(names))

    def _contains(self, large, small):
        """Whether one candidate can reproduce the response of another, within the noise.

        It is fitted to the prediction of the other. If that prediction were the truth, the squared
        error of the larger model would grow by the noise that its parameters follow, and by the
        misfit of this fit: the other is nested if the misfit is the smaller part.
        """
        records = self.records_of(large)
        problem = small.structure.problem(self.records_of(small))
        every = np.ones(len(problem.segment_record), dtype=bool)
        predictions = problem.predictions(problem.x0, every)
        seen = [replace(r, y=y) for r, y in zip(records, predictions, strict=True)]
        follower = large.structure.problem(seen)
        solution = variable_projection(
            follower, follower.x0, tolerance=TOLERANCE, max_evaluations=USUAL
        )
        variance = large.cost / follower.segment_weight.sum()
        return bool(solution.cost < large.n_parameters * variance)

    # ------------------------------------------------------------------ results

    def claims(self, base, ambiguous):
        """Return one row per effect of a candidate, those that remove most of the error first.

        The errors are those of a sequence of models, from which the effect that matters least is
        removed in each step; the p-value is of the whole model against the model without the
        effect.
        """
        rows, last = [], base
        while last.structure.effects:
            reduced = [self.without(last, name) for name in last.structure.effects]
            less = min(reduced, key=lambda c: c.error)
            for name in last.structure.effects:
                if name in less.structure.effects:
                    continue
                others = ambiguous.get(name, ())
                rows.append(
                    {
                        "effect": name,
                        "error_before": less.error,
                        "error_after": last.error,
                        "p_value": self._p_value(base, name, self.without(base, name)),
                        "ambiguous_with": others,
                        "experiment": EFFECTS[name].experiment if others else "",
                    }
                )
            last = less
        return rows[::-1]

    def suspects(self, base):
        """Return the effects outside of a candidate that would lower its error, best first.

        For a model with the largest number of effects none are returned.
        """
        if len(base.structure.effects) >= self.max_effects or base.error <= self.negligible:
            return []
        found = self.extended(base) + self.extended(base, additive=True)
        found = [c for c in found if self.criterion.improves_enough(base, c)]
        errors = fold_errors(base, self.records_of(base), self.folds)
        rows = []
        for c in sorted(found, key=lambda c: c.error):
            after = fold_errors(c, self.records_of(c), self.folds)
            rows.append(
                {
                    "effect": c.effects[0],
                    "error_before": base.error,
                    "error_after": c.error,
                    "folds_better": sum(a < b for a, b in zip(after, errors, strict=True)),
                    "p_value": self._p_value(c, c.effects[0], base),
                }
            )
        return rows

    def extended(self, base, *, additive=False, fully=True):
        """Return the candidates with one more effect, held out.

        Parameters
        ----------
        base : Candidate
        additive : bool, default=False
            Whether functions of time alone are tried, or all other effects.
        fully : bool, default=True
            Whether all effects are tried, or only those that have helped some model of the search
            before.
        """
        number = self._rounds.setdefault(self._set(base), 1 + len(self._rounds))
        key = f"{self._set(base)} and {'an additive' if additive else 'a driven'} effect"
        if self._is_done(key):
            return self.steps[key]["candidates"]
        effects = (e.tried(base.structure, additive) for e in self.effects)
        effects = [e for e in effects if e is not None and e.name not in base.structure.effects]
        if not fully:
            key += " that has helped"
            if self._is_done(key):
                return self.steps[key]["candidates"]
            effects = [e for e in effects if e.name in self._helpful]
        begin = time.perf_counter()
        variants = self._screened(base, [(effect, base) for effect in effects])
        self._add_time("screening", begin)
        begin = time.perf_counter()
        found = self._held_out(base, self._fitted([base] * len(effects), variants))
        self._add_time("contest", begin)
        rows = self._ranked(number, base, effects, variants, found)
        self._keep(key, found, rows, sum(map(len, variants[0])))
        return found

    def _pairs(self, base, singles):
        """Return the candidates that fit best, each in a pair with every other effect, held out."""
        key = f"{self._set(base)} and a pair"
        if not self._is_done(key):
            begin = time.perf_counter()
            effects = [e for e in self.effects if e.name not in base.structure.effects]
            best = sorted(singles, key=lambda c: c.cost)[:FEW]
            pairs = [(e, c) for c in best for e in effects if e.name not in c.effects]
            fitted = self._fitted([c for _, c in pairs], self._screened(base, pairs))
            names = [c.structure.effects[len(base.structure.effects) :] for c in fitted]
            fitted = [replace(c, effects=added) for c, added in zip(fitted, names, strict=True)]
            found = self._held_out(base, fitted)
            self._add_time("pairs", begin)
            self._keep(key, found, n_tried=comb(len(effects), 2), in_pairs=True)
        return self.steps[key]["candidates"]

    def _is_done(self, key):
        """Whether a step is finished, by this search or by the one in its checkpoint."""
        if key in self.steps:
            self._visit(key)
        return key in self.steps

    def _visit(self, key):
        """Note a step as one of this search, and its candidates as known ones."""
        if key in self._visited:
            return
        self._visited[key] = self.steps[key]
        if self.renew is None:
            for candidate in self.steps[key]["candidates"]:
                self._least(candidate)

    def _keep(self, key, candidates, rows=(), n_tried=0, in_pairs=False):
        self.steps[key] = {
            "candidates": candidates,
            "rows": list(rows),
            "n_tried": n_tried,
            "in_pairs": in_pairs,
            "failed": [
                {"round": self._number, "effect": e, "error": why} for e, why in self._failures
            ],
        }
        self._failures.clear()
        self._visit(key)
        if self.keep is not None:
            self.keep(self.steps)

    @property
    def _number(self):
        """Number of the round: of models that effects were added to."""
        return max(len(self._rounds), 1)

    def _parallel(self, jobs):
        """Return the results of jobs, None for a job that failed."""
        done, failures = side_by_side(
            jobs, self.n_jobs, partial(self.report_progress, "", self._number)
        )
        self._failures += failures
        return done

    def _done(self, jobs):
        """Return the results of those jobs that did not fail."""
        return [result for result in self._parallel(jobs) if result is not None]

    def _screened(self, base, pairs):
        """Return the variants that halving keeps of (effect, candidate) pairs, and their records.

        Long records are screened by their first parts.

        Returns
        -------
        variants : list of list of Candidate
            Of each pair, best first.
        kept : list of int
            The numbers of the pairs that stay.
        seen : list of (list of RecordData, float)
            The records of each pair, and the cost of the candidate without the effect on them.
        """
        records = self.records_of(base)
        parts, seen = shortened(records, base.residuals), []
        costs = {id(c): refitted(c, c.structure, parts).cost for _, c in pairs} if parts else {}
        for effect, c in pairs:
            short = parts and suffices(effect, c.structure, records, parts)
            seen.append((parts, costs[id(c)]) if short else (records, c.cost))
        starts = self._parallel(
            delayed(screened)(effect, c.structure, part)
            for (effect, c), (part, _) in zip(pairs, seen, strict=True)
        )
        groups = [(begun or [], *data) for begun, data in zip(starts, seen, strict=True)]
        return *halve(groups, self._parallel), seen

    def _fitted(self, bases, screened):
        """Return the best variant of each effect that halving has kept, refitted to all samples.

        A variant that fits best may predict badly. Of the plausible variants, the simplest is taken
        whose error is hardly larger than that of the best, and not distinguished from it. ``bases``
        are the candidates that the effects were added to.
        """
        variants, kept, seen = screened
        most = (1.0 - self.criterion.min_improvement) ** 2
        jobs = [
            (i, c)
            for i in kept
            for c in variants[i]
            if c.predicted_cost < most * seen[i][1] and self._is_plausible(c, bases[i], seen[i][0])
        ]
        tried = self._parallel(delayed(held_out)(c, seen[i][0], self.folds) for i, c in jobs)
        tried = [(i, c) for (i, _), c in zip(jobs, tried, strict=True) if c is not None]
        by_pair = {i: [c for j, c in tried if j == i] for i, _ in tried}
        best = [(i, self._variant(found)) for i, found in by_pair.items()]
        # for long records, the fit of their first parts is close to the solution
        done = self._parallel(
            delayed(completed)(c, records, RUNG if are_long(records) else USUAL)
            for i, c in best
            for records in [self.records_of(bases[i])]
        )
        return [
            c
            for (i, _), c in zip(best, done, strict=True)
            if c is not None and self._is_plausible(c, bases[i], self.records_of(bases[i]))
        ]

    def _is_plausible(self, candidate, base, records):
        margin = EFFECTS[candidate.effects[-1]].plausible
        named = is_plausible(margin, candidate, base, records, self.criterion.alpha)
        return named and self._predicts_levels(candidate, base, records)

    def _predicts_levels(self, candidate, base, records):
        """Whether parameters that vary with a value per record predict records of other values.

        Folds of blocks cannot show that. Each level between others is held out.
        """
        if base.structure.lines or not candidate.structure.lines:
            return True
        folds = level_folds(candidate.structure.read(records))
        if not folds:
            return True
        new, old = (held_out(c, records, folds) for c in (candidate, base))
        return new.error < old.error

    def _variant(self, variants):
        """Return the simplest variant that predicts as well as the best."""
        best = min(variants, key=lambda c: c.error)
        near = [
            c for c in variants if (1.0 - self.criterion.min_improvement) * c.error <= best.error
        ]
        same = [c for c in near if self.criterion.p_value(c, best) >= self.criterion.alpha]
        return min(same or [best], key=lambda c: (c.n_parameters, c.error))

    def _held_out(self, base, candidates):
        """Return the candidates held out."""
        records = self.records_of(base)
        return self._done(delayed(held_out)(c, records, self.folds) for c in candidates)

    def _ranked(self, number, base, effects, screened, tested):
        """Yield one row per effect that was tried with a candidate."""
        tested = {c.effects[0]: c for c in tested}
        variants, _, seen = screened
        for effect, fits, (_, cost) in zip(effects, variants, seen, strict=True):
            c = tested.get(effect.name)
            fit = fits[0] if fits else None
            added = (c or fit).n_parameters - base.n_parameters if c or fit else 0
            yield {
                "round": number,
                "with_effects": " + ".join(base.structure.effects),
                "effect": effect.name,
                "screen": round(max(1.0 - fit.cost / cost, 0.0), 9) if fit else 0.0,
                "error_before": base.error,
                "error_after": c.error if c else float("nan"),
                "p_value": self.criterion.p_value(base, c) if c else float("nan"),
                "n_parameters": max(added, 0),
                "fold_errors": fold_errors(c, self.records_of(c), self.folds) if c else None,
            }

    def judgement(self, candidate):
        """Return the judgement of a candidate's residual, computed once."""
        key = self._set(candidate), candidate.error
        if key not in self._judgements:
            self._judgements[key] = self.judge(candidate)
        return self._judgements[key]

    # ------------------------------------------------------------------ records

    def records_of(self, candidate):
        """Return the records with the drive of a candidate."""
        return self.records if candidate.box is None else list(candidate.box.records)

    def weighed(self, base):
        """Return a candidate refitted with Huber's weights for its residual."""
        if self.lost is None:
            return base
        weights = huber_weights(base.residuals, lost=self.lost)
        self.records = [replace(r, weights=w) for r, w in zip(self.records, weights, strict=True)]
        self._weighings += 1  # all steps have to be repeated with the new weights
        base = refitted(base, base.structure, self.records)
        return held_out(base, self.records, self.folds)

    def _report_progress(self, text):
        self.report_progress(f"round {self._number}: {text}", self._number)

    def _add_time(self, stage, begin):
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin

    def _set(self, candidate):
        """Return a key of the set of effects, the resolution of the parts, and the weights."""
        names = " + ".join(sorted(candidate.structure.effects)) or "nothing"
        return f"{names}, {candidate.structure.root.n_parameters} values, weighed {self._weighings}"


def _is_additive(candidate):
    """Whether the last effect of a candidate is a function of time alone."""
    tree = candidate.structure
    return tree.label(candidate.effects[-1]) in tree.disturbance_names
