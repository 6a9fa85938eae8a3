"""Rounds of the search: screen, contest, claim, and go back over what was claimed before.

Effects are added one by one, the most convincing first. After each claim those before it are
contested once more: one that a later effect has made needless is dropped, so that the order in
which effects were added does not decide which are kept. Where no effect qualifies alone, the best
few are contested in pairs: two effects of equal size may each leave too much for a claim. Where
most of what is left is structure, an effect that explains most of it need not be significant among
all that were tried. Where that is so at the end, the first choice may have been the wrong one: the
search begins again from others of the first round.
"""

import time
from dataclasses import dataclass, field, replace
from itertools import combinations
from math import comb

import numpy as np
from joblib import Parallel, delayed

from ..hysteresis import OscillatorOperator
from ._changes import n_ringing
from ._contest import (
    contest,
    held_out,
    independent_share,
    paired_p_value,
    refitted,
    refitted_from,
    relative_gain,
    screen,
)
from ._effects import EFFECTS
from ._robust import huber_weights
from ._shortened import are_long, shortened, suffices
from ._starts import dynamics_anew, hysteresis_anew, stage_anew

__all__ = ["Rounds"]

_CONTESTED = 6  # candidates of a round that are refitted jointly, at the most
_ALWAYS_CONTESTED = 3
_HOPEFUL = 16.0  # sum of squares after screening, relative to the best, for the others of these
_CLOSE = 4.0  # sum of squares, relative to the best, up to which a candidate is held out
_SAME_ERROR = 0.005  # relative difference of held-out errors that is no difference
_SIMILAR_ERROR = 0.05  # by so much a simpler candidate may be worse, if the data allow
_THOROUGH = 1.5  # error, relative to the best, up to which a black box is fitted thoroughly
_PAIRED = 4  # candidates that are contested in pairs
_STRUCTURE = 0.5  # part of the power left from which on something is known to be missing
_BEGINNINGS = 2  # other ones, best fit first


@dataclass
class Rounds:
    """The rounds of one search.

    Attributes
    ----------
    effects : list of Effect
        To try.
    records, folds
        Of the contest, see :func:`held_out`.
    alpha, min_improvement, max_effects, n_jobs
        As of the search.
    negligible : float
        Held-out error below which nothing is sought.
    say : callable
        Takes a line about progress.
    renew : callable or None
        Fits a declared black box again, see ``BlackBox.renew``.
    judge : callable
        Takes a contestant and the records, returns the :class:`Judgement` of what is left.
    lost : list of ndarray of bool or None
        Lost readings of each record where the loss is Huber's; None where it is the square.
    history, ranking : list of dict
        A row a claim that is kept; a row a candidate and round.
    dropped : list of str
        Claims that later ones made needless.
    seconds : dict of str to float
    """

    effects: list
    records: list
    folds: list
    alpha: float
    min_improvement: float
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
    _number: int = 0
    _simpler: dict = field(default_factory=dict)  # effect -> simpler ones that were promising
    _first: tuple = ()  # what the first round started from, its records and what it has tested
    _judged: tuple = (None, None)  # the contestant that was judged last, and its judgement

    def run(self, base):
        """Add effects to a contestant until none qualifies; return what it has become."""
        found = self._forward(base)
        alike = self.renew is None and self.lost is None  # errors are of the same samples
        if alike and self._first and self.max_effects > 1:
            found = self._from_another(found)
        return found

    def _forward(self, base):
        while len(self.history) < self.max_effects and base.error > self.negligible:
            self._number += 1
            base = self.weighed(base)
            claims, tested = self._round(base)
            self._first = self._first or (base, self.records, tested)
            if not claims:
                break
            if self.renew is None:
                last, row = claims[-1]
                last = self._refreshed(last)
                claims[-1] = last, row | {"error_after": last.error}
            for contestant, row in claims:
                self.history.append(row)
                base = contestant
                self.say(
                    f"round {self._number}: {row['effect']}, held-out error "
                    f"{row['error_before']:.4g} -> {row['error_after']:.4g}"
                )
                self.records = self._records(base)
            base = self._recheck(base)
            if self.renew is not None:
                base = self.renew(base, base, self.records, thorough=True)
            self.records = self._records(base)
        return base

    def judged(self, contestant):
        """Return the judgement of what a contestant leaves."""
        if self._judged[0] is not contestant:
            self._judged = contestant, self.judge(contestant, self.records)
        return self._judged[1]

    def _leaves_structure(self, contestant):
        return self.judged(contestant).gain >= _STRUCTURE

    def _refreshed(self, base):
        """Return a contestant with its dynamics identified anew, where that foretells better.

        Before the claim they had made up for what was missing, and a local search may leave them
        there. What oscillates in itself is identified from nothing only where much is left.
        """
        if are_long(self.records):
            return base
        structures = dynamics_anew(base.structure, self.records)
        oscillates = isinstance(base.structure.operators[-1], OscillatorOperator)
        if oscillates and self._leaves_structure(base):
            structures += stage_anew(base.structure, self.records)
        if not structures:
            return base
        anew = refitted_from(base, structures, self.records)
        if anew.cost > (1.0 - self.min_improvement) * base.cost:
            return base
        anew = replace(held_out(anew, self.records, self.folds), p_value=base.p_value)
        return anew if anew.error < base.error else base

    def _from_another(self, found):
        """Return what the search finds from another first effect, where that explains what is left.

        What fits best alone may stand for two effects at once, and what is right alone may foretell
        badly as long as the other is missing. Where no set leaves noise, none is known to be right,
        and the first is kept.
        """
        base, records, tested = self._first
        if found.error <= self.negligible or not self._leaves_structure(found):
            return found
        begun = found.structure.added[:1]
        others = sorted((c for c in tested if c.effect not in dict(begun)), key=lambda c: c.cost)
        others = [c for c in others if self._fits(base, c)][:_BEGINNINGS]
        n_sets = max(comb(len(tested), 2), 1)
        ends = []
        for first in others:
            self.say(f"beginning again with {first.effect}")
            ranking = [
                row | {"claimed": row["effect"] == first.effect}
                for row in self.ranking
                if row["round"] == 1
            ]
            trial = replace(
                self,
                records=records,
                history=[_row(base, first, ())],
                ranking=ranking,
                dropped=[],
                _number=1,
                _simpler={},
            )
            end = trial._forward(first)
            p_value = min(1.0, n_sets * self._p_value(base, end))
            better = (
                end.error < (1.0 - self.min_improvement) * found.error
                and len(others) * self._p_value(found, end) < self.alpha
            )
            if (
                (better or self._is_simpler(end, found))
                and self._matters(base, end)
                and p_value < self.alpha
                and not trial._leaves_structure(end)
            ):
                trial.history[0]["p_value"] = min(trial.history[0]["p_value"], p_value)
                ends.append((end, trial))
        if not ends:
            return found
        found = self._simplest([end for end, _ in ends])
        trial = next(trial for end, trial in ends if end is found)
        self.records, self.history = trial.records, trial.history
        self.ranking, self.dropped = trial.ranking, trial.dropped
        self._judged = trial._judged
        return found

    def weighed(self, base):
        """Return a contestant refitted with the weights that its residual asks for."""
        if self.lost is None:
            return base
        weights = huber_weights(base.residuals, lost=self.lost)
        self.records = [replace(r, weights=w) for r, w in zip(self.records, weights, strict=True)]
        return held_out(refitted(base, base.structure, self.records), self.records, self.folds)

    def _records(self, contestant):
        """Return the records as a contestant sees them."""
        return self.records if contestant.box is None else list(contestant.box.records)

    # ------------------------------------------------------------------ one round

    def _round(self, base):
        """Return the contestants that qualify, each with its row, and all that were tested."""
        begin = time.perf_counter()
        parallel = Parallel(n_jobs=self.n_jobs, batch_size=1)
        taken = self._taken(base)
        effects = [effect for effect in self.effects if effect.name not in taken]
        screened = self._screened(base, [(effect, base) for effect in effects], parallel)
        bar = (1.0 - self.min_improvement) * base.cost
        hopeful = [(e.name, s) for e, s in zip(effects, screened, strict=True) if s.cost < bar]
        hopeful.sort(key=lambda entry: entry[1].cost)
        promising = [s for _, s in hopeful]
        n_candidates = len(promising)  # all others cannot be claimed, whatever they predict
        self._add_time("screening", begin)
        begin = time.perf_counter()
        chosen, tested = [], []
        while promising and not chosen:
            # what screens badly may have started badly: it has its turn where others do not qualify
            batch = [
                s
                for place, s in enumerate(promising[:_CONTESTED])
                if place < _ALWAYS_CONTESTED or s.cost <= _HOPEFUL * promising[0].cost
            ]
            promising = promising[len(batch) :]
            contested = self._contest(base, batch, parallel)
            tested += self._tested(base, contested, parallel, n_candidates)
            claims = [c for c in tested if self._qualifies(base, c)]
            chosen = [self._choose(base, claims, tested)] if claims else []
        for contestant, _ in chosen:
            self._simpler[contestant.effect] = [
                name
                for name, s in hopeful
                if s.n_parameters < contestant.n_parameters
                and EFFECTS[name].beside == EFFECTS[contestant.effect].beside
            ][:_ALWAYS_CONTESTED]
        self._add_time("contest", begin)
        if not chosen and len(self.history) + 2 <= self.max_effects:
            begin = time.perf_counter()
            chosen = self._pair(base, tested, parallel, n_candidates)
            self._add_time("pairs", begin)
        if not chosen and self.renew is None:
            chosen = self._evident(base, tested)
        self.series_rank(base, effects, screened, tested, {row["effect"] for _, row in chosen})
        return chosen, tested

    def _screened(self, base, candidates, parallel):
        """Return what screening finds for effects, each put into a contestant's structure.

        Where first parts of the records are screened, their sums of squares are made comparable
        with those of the whole by what the base leaves in both.
        """
        parts = shortened(self.records, base.residuals)
        seen = [
            parts
            if parts is not None and suffices(effect, c.structure, self.records, parts)
            else None
            for effect, c in candidates
        ]
        beginnings = {id(c): self._beginnings(c) for _, c in candidates}
        found = parallel(
            delayed(screen)(effect, beginnings[id(c)], self.records if own is None else own)
            for (effect, c), own in zip(candidates, seen, strict=True)
        )
        if not any(seen):
            return found
        ratio = base.cost / refitted(base, base.structure, parts).cost
        return [
            s if own is None else replace(s, cost=s.cost * ratio, parts=own)
            for s, own in zip(found, seen, strict=True)
        ]

    def _beginnings(self, contestant):
        """Return the structures in which effects are screened: as it is, and begun anew."""
        structure = contestant.structure
        anew = None if are_long(self.records) else hysteresis_anew(structure, self.records)
        return [structure] if anew is None else [structure, anew]

    def _contest(self, base, screened, parallel):
        return contest(screened, self.records, parallel, lambda c: self._is_plausible(base, c))

    def _tested(self, base, contested, parallel, n_candidates):
        """Return the contestants near the best, held out and tested against the base."""
        if self.renew is not None:
            contested = self._renewed(base, contested, parallel)
        lowest = min((c.cost for c in contested), default=0.0)
        finalists = parallel(
            delayed(held_out)(c, self._records(c), self.folds)
            for c in contested
            if c.cost <= _CLOSE * lowest
        )
        finalists = self._or_simpler(base, finalists, parallel)
        gains = [relative_gain(base.squared_errors, c.squared_errors) for c in finalists]
        factor = max(n_candidates * independent_share(gains), 1.0)
        return [replace(c, p_value=min(1.0, factor * self._p_value(base, c))) for c in finalists]

    def _or_simpler(self, base, finalists, parallel):
        """Return the contestants, each as its simpler variant where that foretells better.

        A simpler one is held out where it fits about as well, or where the contestant is no gain:
        what fits best has learned what else is missing, too, if it has the parameters for that.
        """
        bar = (1.0 - self.min_improvement) * base.error
        jobs = [
            (number, simpler)
            for number, c in enumerate(finalists)
            if self.renew is None
            for simpler in c.simpler
            if (c.error > bar or simpler.cost <= (1.0 + _SIMILAR_ERROR) ** 2 * c.cost)
            and self._is_plausible(base, simpler)
        ]
        tried = parallel(delayed(held_out)(c, self.records, self.folds) for _, c in jobs)
        best = list(finalists)
        for (number, _), c in zip(jobs, tried, strict=True):
            best[number] = min(best[number], c, key=lambda c: c.error)
        return [replace(c, simpler=()) for c in best]

    def _renewed(self, base, contested, parallel):
        """Return the contestants with the black box fitted again, thoroughly for the best."""
        rough = parallel(delayed(self.renew)(c, base, self.records) for c in contested)
        bar = _THOROUGH * min((c.error for c in rough), default=0.0)
        best = [c for c in rough if c.error <= bar]
        fine = parallel(delayed(self.renew)(c, c, self._records(c), thorough=True) for c in best)
        return fine + [c for c in rough if c.error > bar]

    def _is_plausible(self, base, contestant):
        """Tell whether the identified effect is still what its name says."""
        if _have_changed_places(base, contestant):
            return False
        return _is_plausible(contestant, self._records(contestant))

    def _p_value(self, worse, better):
        groups = np.repeat(range(len(self.records)), [len(r.segments) for r in self.records])
        return paired_p_value(worse.squared_errors, better.squared_errors, groups)

    def _fits(self, base, contestant):
        return contestant.cost < (1.0 - self.min_improvement) ** 2 * base.cost

    def _matters(self, base, contestant):
        # a base that is foretold badly from some fold is not yet one that lacks something
        lower = contestant.error < (1.0 - self.min_improvement) * base.error
        return lower and self._fits(base, contestant)

    def _qualifies(self, base, contestant):
        return contestant.p_value < self.alpha and self._matters(base, contestant)

    def _evident(self, base, tested):
        """Return the choice among effects that explain most of what is known to be structure.

        That something is missing is certain then, however many effects were tried.
        """
        bar = np.sqrt(1.0 - _STRUCTURE) * base.error
        most = [replace(c, p_value=self._p_value(base, c)) for c in tested if c.error <= bar]
        claims = [c for c in most if self._qualifies(base, c)]
        if not claims or not self._leaves_structure(base):
            return []
        return [self._choose(base, claims, tested)]

    def _choose(self, base, claims, tested):
        """Return the simplest of the candidates that the data cannot tell from the best.

        Once one of them has shown that something is missing, the held-out error decides what it
        is: the correction no longer matters, since one will be claimed.
        """
        shown = min(c.p_value for c in claims)
        claims = [
            replace(c, p_value=shown)
            for c in tested
            if self._matters(base, c) and self._p_value(base, c) < self.alpha
        ]
        best = min(claims, key=lambda c: c.error)
        same = [c for c in claims if self._alike(c, best)]
        chosen = self._simplest(same)
        others = tuple(c.effect for c in sorted(same, key=lambda c: c.error) if c is not chosen)
        return chosen, _row(base, chosen, others)

    def series_rank(self, base, effects, screened, tested, claimed):
        tested = {c.effect: c for c in tested}
        for effect, s in zip(effects, screened, strict=True):
            c = tested.get(effect.name)
            added = (c.n_parameters if c else s.n_parameters) - base.n_parameters
            self.ranking.append(
                {
                    "round": self._number,
                    "effect": effect.name,
                    "screen": round(max(1.0 - s.cost / base.cost, 0.0), 9),
                    "error_before": base.error,
                    "error_after": c.error if c else np.nan,
                    "p_value": c.p_value if c else np.nan,
                    "n_parameters": max(added, 0),
                    "claimed": effect.name in claimed,
                }
            )

    # ------------------------------------------------------------------ more than one effect

    def _pair(self, base, tested, parallel, n_effects):
        """Return two contestants in a row where the best qualifies with both effects only."""
        hopeful = [c for c in tested if c.error < (1.0 - self.min_improvement) * base.error]
        hopeful.sort(key=lambda c: c.error)
        pairs = list(combinations(hopeful[:_PAIRED], 2))
        if not pairs:
            return []
        both = self._added(base, [(b.effect, a) for a, b in pairs], parallel)
        tested = self._tested(base, both, parallel, comb(n_effects, 2))
        alone = {c.effect: c for c in hopeful}
        firsts = [alone[c.structure.added[-2][0]] for c in tested]
        claims = [
            (c, first)
            for c, first in zip(tested, firsts, strict=True)
            if self._qualifies(base, c) and c.error < (1.0 - self.min_improvement) * first.error
        ]
        if not claims:
            return []
        chosen, first = min(claims, key=lambda pair: pair[0].error)
        first = replace(first, p_value=chosen.p_value)
        return [(first, _row(base, first, ())), (chosen, _row(first, chosen, ()))]

    def _recheck(self, base):
        """Drop what the effects added later have made needless; return the contestant."""
        begin = time.perf_counter()
        while len(base.structure.added) > 1:
            needless = []
            for effect in base.structure.removable()[:-1]:
                reduced = refitted(base, base.structure.without(effect), self.records)
                if self.renew is None:
                    reduced = held_out(reduced, self.records, self.folds)
                else:
                    reduced = self.renew(reduced, base, self.records)
                if not (
                    self._p_value(reduced, base) < self.alpha
                    and base.error < (1.0 - self.min_improvement) * reduced.error
                ):
                    needless.append((reduced.error, effect, reduced))
            if not needless:
                break
            _, effect, base = min(needless, key=lambda entry: entry[0])
            self.dropped.append(effect)
            self.history = [row for row in self.history if row["effect"] != effect]
            self.say(f"{effect} is no longer needed: held-out error {base.error:.4g}")
        if self.renew is None:
            for effect in base.structure.removable()[:-1]:
                base = self._simplified(base, effect)
        self._add_time("re-check", begin)
        return base

    def _simplified(self, base, effect):
        """Return the contestant with a simpler effect in the place of one, where it does as well.

        Before the last effect was known, the one may have had a part of it to explain. So both are
        put in anew.
        """
        taken = self._taken(base)
        names = [name for name in self._simpler.get(effect, ()) if name not in taken]
        if not names:
            return base
        last = base.structure.added[-1][0]
        rest = refitted(base, base.structure.without(last).without(effect), self.records)
        serial = Parallel(n_jobs=1)
        firsts = self._added(rest, [(name, rest) for name in names], serial)
        both = self._added(rest, [(last, first) for first in firsts], serial)
        for c in sorted(both, key=lambda c: c.n_parameters):
            c = held_out(c, self.records, self.folds)
            if self._is_simpler(c, base):
                simpler = c.structure.added[-2][0]
                self.dropped.append(effect)
                for row in self.history:
                    if row["effect"] == effect:
                        others = tuple(n for n in row["ambiguous_with"] if n != simpler)
                        row |= {"effect": simpler, "ambiguous_with": others}
                self.say(f"{simpler} does as well as {effect}: held-out error {c.error:.4g}")
                return replace(c, simpler=())
        return base

    def _added(self, base, pairs, parallel):
        """Return the plausible contestants that effects, given by name, make of contestants."""
        known = {effect.name: effect for effect in self.effects}
        screened = self._screened(base, [(known[name], c) for name, c in pairs], parallel)
        return self._contest(base, [s for s in screened if s.beginnings], parallel)

    def _taken(self, base):
        return {name for name, _ in base.structure.added} | set(self.dropped)

    def _simplest(self, contestants):
        """Return the one with the fewest parameters among those about as good as the best."""
        best = min(contestants, key=lambda c: c.error)
        near = [c for c in contestants if self._is_as_good(c, best)]
        return min(near, key=lambda c: (c.n_parameters, c.error))

    def _is_simpler(self, contestant, than):
        fewer = contestant.n_parameters < than.n_parameters
        return fewer and self._is_as_good(contestant, than)

    def _is_as_good(self, worse, better):
        close = worse.error <= (1.0 + _SIMILAR_ERROR) * better.error
        return close and self._alike(worse, better)

    def _alike(self, worse, better):
        """Whether two held-out errors agree, or the data cannot tell them apart."""
        same = worse.error <= (1.0 + _SAME_ERROR) * better.error
        return same or self._p_value(worse, better) > self.alpha

    def _add_time(self, stage, begin):
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - begin


def _row(base, chosen, others):
    return {
        "effect": chosen.effect,
        "error_before": base.error,
        "error_after": chosen.error,
        "p_value": chosen.p_value,
        "ambiguous_with": others,
        "experiment": EFFECTS[chosen.effect].experiment if others else "",
    }


def _is_plausible(contestant, records):
    """Tell whether the operator of an effect is still what the name says."""
    name, structure = contestant.effect, contestant.structure
    plausible = EFFECTS[name].plausible
    if plausible is None:
        return True
    operator = structure.operator(name)
    if structure.label(name) in structure.beside_names:
        return plausible(operator, np.array([]), records)
    last = structure.place(name) + (not structure.is_part(name))  # a force is driven by the motion
    return plausible(operator, np.concatenate(structure.run(records, last=last)), records)


def _have_changed_places(base, contestant):
    """Tell whether a stage was added that rings, in the place of one that no longer does.

    It is then the mode that was there before, and what is new is what that one has become.
    """
    name, structure = contestant.effect, contestant.structure
    if structure.label(name) not in structure.names or not n_ringing([structure.operator(name)]):
        return False
    return n_ringing(structure.operators) <= n_ringing(base.structure.operators)
