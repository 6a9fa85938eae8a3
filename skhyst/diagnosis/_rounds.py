"""Rounds of the search: try every effect, claim the simplest that explains, go back over the rest.

In each round every effect is put into the model so far. The candidates are halved and held out
(``_candidates``), and the criterion (``_criterion``) says which are better than the model so far.
Of these, the ones that the data cannot tell from the best are kept, and the simplest of them is
claimed; the others are ambiguous with it. Two effects may each leave too much for a claim: where
nothing is claimed and structure is left, the three candidates that fit best are halved once more
with every other effect in them, as in a beam search.

After a claim all is identified anew, and each effect is taken out once: what is not needed is
dropped. In the end every effect that was claimed while others were missing is contested: another
one may explain as well beside what was found later. So the order of claims does not decide.
"""

import time
from dataclasses import dataclass, field, replace
from functools import partial
from math import comb

from joblib import delayed

from ._candidates import (
    completed,
    fold_errors,
    halve,
    held_out,
    level_folds,
    refitted,
    screened,
)
from ._constants import FACTOR
from ._course import course_p_values
from ._effects import EFFECTS
from ._jobs import side_by_side
from ._plausibility import has_its_name, is_plausible
from ._robust import huber_weights
from ._shortened import are_long, shortened, suffices

# what a search is decided by after a claim, see `Rounds.state`
_STATE = ("records", "history", "ranking", "dropped", "failed", "_number", "_n_tried")


@dataclass
class Rounds:
    """The rounds of one search.

    Attributes
    ----------
    effects : list of Effect
        To try.
    records, folds
        Of the contest, see :func:`held_out`.
    criterion : Criterion
    max_effects, n_jobs
        As of the search.
    negligible : float
        Held-out error below which nothing is sought.
    tell : callable
        Takes a line about progress or "", and the round, what is tried, how many of the step are
        done and how many there are.
    renew : callable or None
        Fits a declared black box again, see ``BlackBox.renew``.
    judge : callable
        Returns the judgement of what a candidate leaves.
    lost : list of ndarray of bool or None
        Lost readings of each record where the loss is Huber's; None where it is the square.
    keep : callable or None
        Takes the state after each claim.
    history, ranking, failed : list of dict
        A row a claim that is kept; a row a candidate and round; a row a candidate that raised.
    dropped : list of str
        Claims that later ones made needless.
    judgement : Judgement or None
        Of the last candidate, where it was asked for.
    seconds : dict of str to float
    """

    effects: list
    records: list
    folds: list
    criterion: object
    max_effects: int
    n_jobs: int | None
    negligible: float
    tell: object
    renew: object
    judge: object
    lost: list | None = None
    keep: object = None
    history: list = field(default_factory=list)
    ranking: list = field(default_factory=list)
    dropped: list = field(default_factory=list)
    failed: list = field(default_factory=list)
    seconds: dict = field(default_factory=dict)
    judgement: object = None
    _number: int = 0
    _claimed: set = field(default_factory=set)  # sets of effects, none of which is claimed again
    _n_tried: int = 0

    def _parallel(self, jobs):
        """Return what jobs return, None of one that fails: it costs its candidate."""
        done, failures = side_by_side(jobs, self.n_jobs, partial(self.tell, "", self._number))
        self.failed += [
            {"round": self._number, "effect": effect, "error": error} for effect, error in failures
        ]
        return done

    def _done(self, jobs):
        """Return what jobs return that do not fail."""
        return [own for own in self._parallel(jobs) if own is not None]

    def state(self, base):
        """Return what the search goes on from, see :meth:`resumed`."""
        own = {name: getattr(self, name) for name in _STATE}
        effects, claimed = [e.name for e in self.effects], [sorted(own) for own in self._claimed]
        return own | {"base": base, "effects": effects, "claimed": claimed}

    def resumed(self, state):
        """Go on from a state; return the candidate."""
        for name in _STATE:
            setattr(self, name, state[name])
        self.effects = [e for e in self.effects if e.name in state["effects"]]
        self._claimed = set(map(frozenset, state["claimed"]))
        return state["base"]

    def run(self, base):
        """Add effects to a candidate until none is better; return what it has become."""
        while True:
            base = self._grown(base)
            other = self._contested(base) or self._without_course(base)
            if other is None:
                return base
            base = self._settled(other, base.error)

    def _grown(self, base):
        """Claim effects, round after round, until none is better; return the candidate."""
        while len(self.history) < self.max_effects and base.error > self.negligible:
            if self._number == FACTOR * self.max_effects:  # claims that are dropped again
                break
            self._number += 1
            base = self.weighed(base)
            chosen = self._round(base)
            if chosen is None:
                break
            base = self._settled(chosen, base.error)
        return base

    def _settled(self, base, before):
        """Return a candidate with a new effect, identified anew and without what is not needed.

        ``before`` is the held-out error without the new effect.
        """
        self.judgement, self.records = None, self._records(base)
        base = self._recheck(self._refreshed(base), before)
        if self.renew is not None:
            base = self.renew(base, base, self.records, thorough=True)
        if self.history:
            self.history[-1]["error_after"] = base.error
        self.records = self._records(base)
        if self.keep is not None:
            self.keep(self.state(base))
        return base

    def weighed(self, base):
        """Return a candidate refitted with the weights that its residual asks for."""
        if self.lost is None:
            return base
        weights = huber_weights(base.residuals, lost=self.lost)
        self.records = [replace(r, weights=w) for r, w in zip(self.records, weights, strict=True)]
        base = refitted(base, base.structure, self.records)
        return held_out(base, self.records, self.folds)

    def _records(self, candidate):
        """Return the records as a candidate sees them."""
        return self.records if candidate.box is None else list(candidate.box.records)

    # ------------------------------------------------------------------ one round

    def _round(self, base):
        """Return the candidate that is claimed, or None."""
        effects = self._open(base)
        self._say(f"{len(effects)} effects are tried")
        singles, screened = self._singles(base, effects)
        begin = time.perf_counter()
        tested, chosen = singles, self._chosen(base, singles)
        in_pairs = len(self.history) + 2 <= self.max_effects
        if chosen is None and in_pairs and self._is_structured(base):
            tested = singles + self._pairs(base, singles, effects)
            self._n_tried = max(self._n_tried, 2 * comb(len(effects), 2))
            chosen = self._chosen(base, tested)
        self._rank(base, effects, screened, tested, chosen)
        self._add_time("contest", begin)
        if chosen is None:
            self._say(f"nothing, held-out error {base.error:.4g}")
        return chosen

    def _open(self, base):
        """Return the effects that a candidate has not."""
        return [e for e in self.effects if e.name not in base.structure.effects]

    def _is_structured(self, base):
        self.judgement = self.judgement or self.judge(base)
        return self.judgement.structured

    def _singles(self, base, effects):
        """Return the candidates with one more effect, held out, and what was screened."""
        begin = time.perf_counter()
        screened = self._screened(base, [(effect, base) for effect in effects])
        self._add_time("screening", begin)
        begin = time.perf_counter()
        singles = self._held_out(base, self._fitted([base] * len(effects), screened))
        self._n_tried = 2 * sum(map(len, screened[0]))  # half of alpha, the other is for pairs
        self._add_time("contest", begin)
        return singles, screened

    def _screened(self, base, pairs):
        """Return what halving leaves of effects and what they are put into, and what was screened.

        Of long records the first parts are screened.

        Returns
        -------
        variants : list of list of Candidate
            Of each pair, best first.
        kept : list of int
            The numbers of the pairs that stay.
        seen : list of (list of RecordData, float)
            Of each pair the records, and the sum of squares of what the effect is put into.
        """
        parts, seen = shortened(self.records, base.residuals), []
        costs = {id(c): refitted(c, c.structure, parts).cost for _, c in pairs} if parts else {}
        for effect, c in pairs:
            short = parts and suffices(effect, c.structure, self.records, parts)
            seen.append((parts, costs[id(c)]) if short else (self.records, c.cost))
        starts = self._parallel(
            delayed(screened)(effect, c.structure, records)
            for (effect, c), (records, _) in zip(pairs, seen, strict=True)
        )
        groups = [(own or [], *what) for own, what in zip(starts, seen, strict=True)]
        return *halve(groups, self._parallel), seen

    def _fitted(self, bases, screened):
        """Return the best variant of each effect that stays, refitted to all samples.

        A variant that follows the residual where it was fitted may predict badly: of those that
        are plausible the simplest that predicts as well as the best is taken: its error is hardly
        larger, and not told apart. ``bases`` are what the effects were put into.
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
        own = {i: [c for j, c in tried if j == i] for i, _ in tried}
        best = [self._variant(found) for found in own.values()]
        # of long records, what fits their first parts is near the solution
        budget = FACTOR if are_long(self.records) else FACTOR**3
        return self._done(delayed(completed)(c, self.records, budget) for c in best)

    def _is_plausible(self, candidate, base, records):
        margin = EFFECTS[candidate.effects[-1]].plausible
        named = is_plausible(margin, candidate, base, records, self.criterion.alpha)
        return named and self._predicts_levels(candidate, base, records)

    def _predicts_levels(self, candidate, base, records):
        """Whether parameters that follow a number of the record suit records at other numbers.

        Blocks of every record do not tell. Each record between others is held out.
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

    def _simplest(self, candidates):
        """Return the simplest of those than which the best is not better, and all those."""
        best = min(candidates, key=lambda c: c.error)
        same = [c for c in candidates if not self.criterion.is_better(c, best)]
        return min(same, key=lambda c: (len(c.effects), c.n_parameters, c.error)), same

    def _held_out(self, base, candidates):
        """Return the candidates held out."""
        if self.renew is None:
            return self._done(delayed(held_out)(c, self.records, self.folds) for c in candidates)
        rough = self._done(delayed(self.renew)(c, base, self.records) for c in candidates)
        rough.sort(key=lambda c: c.error)
        best = rough[: -(-len(rough) // FACTOR)]
        fine = self._done(delayed(self.renew)(c, c, self._records(c), thorough=True) for c in best)
        return fine + rough[len(best) :]

    def _pairs(self, base, singles, effects):
        """Return the candidates that fit best, each with every other effect too, held out."""
        best = sorted(singles, key=lambda c: c.cost)[:FACTOR]
        pairs = [(e, c) for c in best for e in effects if e.name not in c.effects]
        fitted = self._fitted([c for _, c in pairs], self._screened(base, pairs))
        names = [c.structure.effects[len(base.structure.effects) :] for c in fitted]
        fitted = [replace(c, effects=own) for c, own in zip(fitted, names, strict=True)]
        return self._held_out(base, fitted)

    def _chosen(self, base, tested):
        """Return the simplest of the candidates that the data cannot tell from the best."""
        claims = [c for c in tested if self._is_better(base, c) and self._needs_all(c)]
        if not claims:
            return None
        chosen, same = self._simplest(claims)
        alone = {c.effects: c for c in tested}
        steps = [alone[(name,)] for name in chosen.effects[:-1]] + [chosen]
        self._claim(base, steps, [c for c in same if c is not chosen])
        return chosen

    def _is_better(self, worse, better):
        new = frozenset(better.structure.effects) not in self._claimed
        return new and self.criterion.is_better(worse, better, self._n_tried)

    def _needs(self, candidate, reduced):
        return self.criterion.predicts_better(reduced, candidate, self._n_tried)

    def _needs_all(self, candidate):
        """Whether a pair predicts better than each of its effects without the other."""
        pair = candidate.effects if len(candidate.effects) > 1 else ()
        return all(self._needs(candidate, self._without(candidate, name)) for name in pair)

    def _claim(self, base, steps, others):
        """Add a row for each further effect of a candidate, and what is ambiguous with it."""
        chosen = steps[-1]
        self._claimed.add(frozenset(chosen.structure.effects))
        p_value = self.criterion.p_value(base, chosen, self._n_tried)
        for name, before, after in zip(chosen.effects, [base, *steps], steps, strict=False):
            self.history.append(
                {
                    "effect": name,
                    "error_before": before.error,
                    "error_after": after.error,
                    "p_value": p_value,
                    **_ambiguous(name, chosen, others),
                }
            )
            self._say(f"{name}, held-out error {before.error:.4g} -> {after.error:.4g}")

    def _rank(self, base, effects, screened, tested, chosen):
        tested = {c.effects[0]: c for c in tested if len(c.effects) == 1}
        claimed = chosen.effects if chosen else ()
        variants, _, seen = screened
        for effect, own, (_, cost) in zip(effects, variants, seen, strict=True):
            c = tested.get(effect.name)
            fit = own[0] if own else None
            p_value = self.criterion.p_value(base, c, self._n_tried) if c else float("nan")
            added = (c or fit).n_parameters - base.n_parameters if c or fit else 0
            self.ranking.append(
                {
                    "round": self._number,
                    "effect": effect.name,
                    "screen": round(max(1.0 - fit.cost / cost, 0.0), 9) if fit else 0.0,
                    "error_before": base.error,
                    "error_after": c.error if c else float("nan"),
                    "p_value": p_value,
                    "n_parameters": max(added, 0),
                    "claimed": effect.name in claimed,
                    "fold_errors": fold_errors(c, self.records, self.folds) if c else None,
                }
            )

    # ------------------------------------------------------------------ after a claim

    def _without(self, base, effect):
        """Return a candidate without one of its effects, held out."""
        reduced = refitted(base, base.structure.without(effect), self.records)
        if self.renew is None:
            return held_out(reduced, self.records, self.folds)
        return self.renew(reduced, base, self.records)

    def _contested(self, base):
        """Return a candidate with another effect in the place of one; None where all stay.

        An effect was claimed while others were missing. Beside these, another one may predict
        better, or be simpler and not told apart.
        """
        for row in self.history if len(self.history) > 1 else ():
            name = row["effect"]
            reduced, own = self._without(base, name), replace(base, effects=(name,))
            # a rival begins where the others are, which make up for nothing yet
            start = replace(reduced, structure=base.structure.without(name))
            singles, _ = self._singles(start, [e for e in self._open(start) if e.name != name])
            claims = [c for c in singles if self._is_better(reduced, c)]
            chosen, same = self._simplest([own, *claims])
            others = [c for c in same if c is not chosen]
            if chosen is not own:
                self._drop(reduced)
                self._claim(reduced, [chosen], others)
                return chosen
            row |= _ambiguous(name, own, others)
        return None

    def _without_course(self, base):
        """Return a candidate without what is no more than the noise's own course; None otherwise.

        Before the end, what is missing would count as noise.
        """
        # what a black box leaves has a course of the box's own
        if self.renew or not base.structure.disturbances:
            return None
        p_values = course_p_values(base.structure, self.records)
        effect = max(p_values, key=p_values.get, default=None)
        if effect is None or self._n_tried * p_values[effect] < self.criterion.alpha:
            return None
        self.effects = [e for e in self.effects if e.name != effect]
        reduced = self._without(base, effect)
        self._drop(reduced)
        return reduced

    def _drop(self, reduced):
        left = frozenset(reduced.structure.effects)
        gone = [row["effect"] for row in self.history if row["effect"] not in left]
        self.dropped += gone
        self._claimed.add(left)
        self.history = [row for row in self.history if row["effect"] in left]
        self._say(f"not needed: {', '.join(gone)}; held-out error {reduced.error:.4g}")

    def _refreshed(self, base):
        """Return a candidate identified anew from nothing, where that predicts better."""
        if are_long(self.records) or self.renew is not None:
            return base
        trees = [base.structure.identified(self.records)]
        if base.structure.input_history:
            anew = [replace(t, input_history=()) for t in (base.structure, *trees)]
            trees = [t.with_input_history(self.records) for t in anew]
        anew = [refitted(base, tree, self.records) for tree in trees]
        anew = min(anew, key=lambda c: c.cost)
        if anew.cost >= base.cost:
            return base
        anew = held_out(anew, self.records, self.folds)
        return anew if anew.error < base.error else base

    def _recheck(self, base, before):
        """Drop what is not needed, now that all is fitted anew; return the candidate.

        What is left predicts no worse than before the newest claim, or the search would go back.
        """
        begin = time.perf_counter()
        most = before / (1.0 - self.criterion.min_improvement)
        while base.structure.effects:
            needless = []
            for effect in base.structure.effects:
                reduced = self._without(base, effect)
                needed = reduced.error > most or self._needs(base, reduced)
                if not needed and self._keeps_names(reduced.structure):
                    needless.append(reduced)
            if not needless:
                break
            base = min(needless, key=lambda own: own.error)
            self._drop(base)
        self._add_time("re-check", begin)
        return base

    def _keeps_names(self, tree):
        """Whether no effect of a tree has taken over what another was."""
        return all(
            has_its_name(name, EFFECTS[name].plausible, tree, self.records, self.criterion.alpha)
            for name in tree.effects
        )

    def _say(self, text):
        self.tell(f"round {self._number}: {text}", self._number)

    def _add_time(self, stage, begin):
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin


def _ambiguous(name, chosen, others):
    """Return what is told of other candidates in the row of an effect, the better ones first."""
    ordered = sorted(others, key=lambda c: c.error)
    names = dict.fromkeys(n for c in ordered for n in c.effects if n not in chosen.effects)
    return {
        "ambiguous_with": tuple(names),
        "experiment": EFFECTS[name].experiment if names else "",
    }
