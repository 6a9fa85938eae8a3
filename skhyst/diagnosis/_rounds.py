"""Rounds of the search: try every effect, claim the simplest that explains, go back over the rest.

In each round every effect is put into the model so far. The candidates are halved (``_candidates``)
and what is left of them is held out, alone and in pairs: two effects of equal size may each leave
too much for a claim. The criterion (``_criterion``) says which are better than the model so far.
Of these, the ones that the data cannot tell from the best are kept, and the simplest of them is
claimed; the others are ambiguous with it. Then all is identified anew, and each effect is taken out
once: what is not needed is dropped, so that the order of claims does not decide.
"""

import time
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb

from joblib import Parallel, delayed

from ._candidates import halve, held_out, predicted, refitted
from ._constants import FACTOR
from ._course import least_certain
from ._effects import EFFECTS
from ._plausibility import is_plausible
from ._robust import huber_weights
from ._shortened import are_long, shortened, suffices


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
    say : callable
        Takes a line about progress.
    renew : callable or None
        Fits a declared black box again, see ``BlackBox.renew``.
    judge : callable
        Returns the judgement of what a candidate leaves.
    lost : list of ndarray of bool or None
        Lost readings of each record where the loss is Huber's; None where it is the square.
    history, ranking : list of dict
        A row a claim that is kept; a row a candidate and round.
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
    say: object
    renew: object
    judge: object
    lost: list | None = None
    history: list = field(default_factory=list)
    ranking: list = field(default_factory=list)
    dropped: list = field(default_factory=list)
    seconds: dict = field(default_factory=dict)
    judgement: object = None
    _number: int = 0
    _n_tried: int = 0
    _effort: int = 1

    def run(self, base):
        """Add effects to a candidate until none is better; return what it has become."""
        while len(self.history) < self.max_effects and base.error > self.negligible:
            self._number += 1
            base = self.weighed(base)
            self._n_tried = 0
            chosen = self._round(base) or self._round_again(base)
            if chosen is None:
                break
            base, self.judgement = chosen, None
            self.records = self._records(base)
            base = self._recheck(self._refreshed(base))
            if self.renew is not None:
                base = self.renew(base, base, self.records, thorough=True)
            if self.history:
                self.history[-1]["error_after"] = base.error
            self.records = self._records(base)
        return base

    def _round_again(self, base):
        """Do a round with larger budgets, where structure is left and nothing was claimed."""
        self.judgement = self.judge(base)
        if not self.judgement.structured:
            return None
        return self._round(base, effort=FACTOR)

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

    def _round(self, base, effort=1):
        """Return the candidate that is claimed, or None; budgets are larger by the effort."""
        self._effort = effort
        begin = time.perf_counter()
        parallel = Parallel(n_jobs=self.n_jobs, batch_size=1)
        taken = set(base.structure.effects) | set(self.dropped)
        effects = [effect for effect in self.effects if effect.name not in taken]
        screened = self._screened(base, [(effect, base) for effect in effects], parallel)
        self._add_time("screening", begin)
        begin = time.perf_counter()
        fitted = self._fitted([base] * len(effects), screened, parallel)
        singles = self._held_out(base, fitted, parallel)
        self._n_tried += sum(map(len, screened[0]))
        tested = list(singles)
        if len(self.history) + 2 <= self.max_effects:
            self._n_tried += comb(len(effects), 2)
            tested += self._pairs(base, singles, parallel)
        p_values = {c.effects: self.criterion.p_value(base, c, self._n_tried) for c in tested}
        chosen = self._chosen(base, tested, p_values)
        self._rank(base, effects, screened, tested, p_values, chosen)
        self._add_time("contest", begin)
        return chosen

    def _screened(self, base, pairs, parallel):
        """Return what halving leaves of effects and what they are put into, and what was screened.

        Of long records the first parts are screened.

        Returns
        -------
        variants : list of list of Candidate
            Of each pair, best first.
        kept : list of int
            The numbers of the pairs that stay.
        seen : list of (list of RecordData, float)
            Of each pair the records, and the sum of squares of the base in them.
        """
        whole, parts = (self.records, base.cost), shortened(self.records, base.residuals)
        short = parts and (parts, refitted(base, base.structure, parts).cost)
        seen = [
            short if parts and suffices(effect, c.structure, self.records, parts) else whole
            for effect, c in pairs
        ]
        starts = parallel(
            delayed(predicted)(effect, c.structure, records)
            for (effect, c), (records, _) in zip(pairs, seen, strict=True)
        )
        groups = [(own, *what) for own, what in zip(starts, seen, strict=True)]
        return *halve(groups, parallel, self._effort), seen

    def _fitted(self, bases, screened, parallel):
        """Return the best variant of each effect that stays, refitted to all samples.

        A variant that follows the residual where it was fitted may foretell badly: of those that
        are plausible the simplest that foretells as well as the best is taken: its error is hardly
        larger, and not told apart. ``bases`` are what the effects were put into.
        """
        variants, kept, seen = screened
        most = (1.0 - self.criterion.min_improvement) ** 2
        jobs = [
            (i, c)
            for i in kept
            for c in variants[i]
            if c.cost < most * seen[i][1] and self._is_plausible(c, bases[i], seen[i][0])
        ]
        tried = parallel(delayed(held_out)(c, seen[i][0], self.folds) for i, c in jobs)
        own = {i: [c for (j, _), c in zip(jobs, tried, strict=True) if j == i] for i, _ in jobs}
        best = [self._simplest(self._near_best(found))[0] for found in own.values()]
        # of long records, what fits their first parts is near the solution
        budget = self._effort * (FACTOR if are_long(self.records) else FACTOR**3)
        return parallel(delayed(refitted)(c, c.structure, self.records, budget) for c in best)

    def _is_plausible(self, candidate, base, records):
        margin = EFFECTS[candidate.effects[-1]].plausible
        return is_plausible(margin, candidate, base, records, self.criterion.alpha)

    def _near_best(self, variants):
        """Return the variants whose held-out error is not larger than the least by what matters."""
        least = min(c.error for c in variants)
        return [c for c in variants if (1.0 - self.criterion.min_improvement) * c.error <= least]

    def _simplest(self, candidates):
        """Return the simplest of those that the data cannot tell from the best, and all those."""
        best = min(candidates, key=lambda c: c.error)
        same = [c for c in candidates if not self.criterion.is_told_apart(c, best)]
        return min(same, key=lambda c: (len(c.effects), c.n_parameters, c.error)), same

    def _held_out(self, base, candidates, parallel):
        """Return the candidates held out."""
        if self.renew is None:
            return parallel(delayed(held_out)(c, self.records, self.folds) for c in candidates)
        rough = parallel(delayed(self.renew)(c, base, self.records) for c in candidates)
        rough.sort(key=lambda c: c.error)
        best = rough[: -(-len(rough) // FACTOR)]
        fine = parallel(delayed(self.renew)(c, c, self._records(c), thorough=True) for c in best)
        return fine + rough[len(best) :]

    def _pairs(self, base, singles, parallel):
        """Return the pairs of the best candidates, held out."""
        best = sorted(singles, key=lambda c: c.error)[: FACTOR + self._effort - 1]
        known = {effect.name: effect for effect in self.effects}
        # the better one comes first: the other starts from what that leaves
        pairs = [(known[b.effects[0]], a) for a, b in combinations(best, 2)]
        first = [a for _, a in pairs]
        fitted = self._fitted(first, self._screened(base, pairs, parallel), parallel)
        names = [c.structure.effects[len(base.structure.effects) :] for c in fitted]
        fitted = [replace(c, effects=own) for c, own in zip(fitted, names, strict=True)]
        return self._held_out(base, fitted, parallel)

    def _chosen(self, base, tested, p_values):
        """Return the simplest of the candidates that the data cannot tell from the best."""
        alone = {c.effects: c for c in tested if len(c.effects) == 1}
        claims = []
        for c in tested:
            if not (self.criterion.matters(base, c) and p_values[c.effects] < self.criterion.alpha):
                continue
            parts = [alone[(name,)] for name in c.effects if len(c.effects) > 1]
            if all(self.criterion.is_better(part, c, self._n_tried) for part in parts):
                claims.append(c)
        if not claims:
            return None
        chosen, same = self._simplest(claims)
        others = sorted((c for c in same if c is not chosen), key=lambda c: c.error)
        ambiguous = tuple(dict.fromkeys(n for c in others for n in c.effects))
        before = base
        for name in chosen.effects:
            after = chosen if name == chosen.effects[-1] else alone[(name,)]
            self.history.append(
                {
                    "effect": name,
                    "error_before": before.error,
                    "error_after": after.error,
                    "p_value": p_values[chosen.effects],
                    "ambiguous_with": tuple(n for n in ambiguous if n not in chosen.effects),
                    "experiment": EFFECTS[name].experiment if ambiguous else "",
                }
            )
            self.say(
                f"round {self._number}: {name}, held-out error {before.error:.4g} -> "
                f"{after.error:.4g}"
            )
            before = after
        return chosen

    def _rank(self, base, effects, screened, tested, p_values, chosen):
        tested = {c.effects[0]: c for c in tested if len(c.effects) == 1}
        claimed = chosen.effects if chosen else ()
        variants, _, seen = screened
        for effect, own, (_, cost) in zip(effects, variants, seen, strict=True):
            c = tested.get(effect.name)
            fit = own[0] if own else None
            added = (c or fit).n_parameters - base.n_parameters if c or fit else 0
            self.ranking.append(
                {
                    "round": self._number,
                    "effect": effect.name,
                    "screen": round(max(1.0 - fit.cost / cost, 0.0), 9) if fit else 0.0,
                    "error_before": base.error,
                    "error_after": c.error if c else float("nan"),
                    "p_value": p_values[c.effects] if c else float("nan"),
                    "n_parameters": max(added, 0),
                    "claimed": effect.name in claimed,
                }
            )

    # ------------------------------------------------------------------ after a claim

    def _refreshed(self, base):
        """Return a candidate identified anew from nothing, where that foretells better."""
        if are_long(self.records) or self.renew is not None:
            return base
        anew = refitted(base, base.structure.identified(self.records), self.records)
        if anew.cost >= base.cost:
            return base
        anew = held_out(anew, self.records, self.folds)
        return anew if anew.error < base.error else base

    def _recheck(self, base):
        """Drop what is not needed, now that all is fitted anew; return the candidate."""
        begin = time.perf_counter()
        while base.structure.effects:
            needless = []
            # what a black box leaves has a course of the box's own
            course = 0.0 if self.renew else least_certain(base.structure, self.records)
            for effect in base.structure.effects:
                reduced = refitted(base, base.structure.without(effect), self.records)
                if self.renew is None:
                    reduced = held_out(reduced, self.records, self.folds)
                else:
                    reduced = self.renew(reduced, base, self.records)
                if not self.criterion.is_needed(reduced, base, self._n_tried, course):
                    needless.append((reduced.error, effect, reduced))
            if not needless:
                break
            _, effect, base = min(needless, key=lambda entry: entry[0])
            self.dropped.append(effect)
            self.history = [row for row in self.history if row["effect"] != effect]
            self.say(f"{effect} is not needed: held-out error {base.error:.4g}")
        self._add_time("re-check", begin)
        return base

    def _add_time(self, stage, begin):
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin
