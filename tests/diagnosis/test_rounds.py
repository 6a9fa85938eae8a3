"""The rounds of a search: pairs of effects, and what becomes of claims that others replace."""

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from skhyst.diagnosis import EFFECTS
from skhyst.diagnosis._candidates import Candidate, held_out
from skhyst.diagnosis._criterion import Criterion
from skhyst.diagnosis._rounds import Rounds
from skhyst.diagnosis._tree import Tree
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLagOperator
from skhyst.optimize import RecordData

COUNT, N, DT = 4, 400, 0.01


@pytest.fixture(scope="module")
def missing_two():
    """Records of plays behind which are a lag and an offset, and the declared plays."""
    rng = np.random.default_rng(9400)
    lag = FirstOrderLagOperator(0.05)
    segments = tuple(pairwise(np.linspace(0, N, 7).astype(int).tolist()))
    drives = [np.cumsum(rng.standard_normal(N)) / 5.0 for _ in range(COUNT)]
    model = PrandtlIshlinskii(4)
    records = [RecordData(u, u + 0.3 * np.sin(u), DT, segments=segments) for u in drives]
    tree = Tree.from_result(model, model.identify(records))
    found = []
    for record, v, offset in zip(records, tree.run(records), (0.8, -1.1, 0.4, -0.2), strict=True):
        y = lag.run(v, DT)[0] + offset
        found.append(replace(record, y=y + 0.005 * rng.standard_normal(N)))
    tree = Tree.from_result(model, model.identify(found))
    problem = tree.problem(found)
    cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
    record_of = np.concatenate([np.full(len(r.segments), i) for i, r in enumerate(found)])
    folds = [(record_of != k, record_of == k) for k in range(COUNT)]
    base = Candidate((), tree, cost, cost, len(problem.x0), problem.x0)
    return found, folds, held_out(base, found, folds)


def rounds_of(records, folds, *names, structured=True):
    judge = SimpleNamespace(structured=structured)
    effects, criterion = [EFFECTS[name] for name in names], Criterion(0.01, 0.05)
    return Rounds(effects, records, folds, criterion, 3, 1, 0.0, print, None, lambda _: judge)


class NotAlone(Criterion):
    """One for which each effect hides the other."""

    def p_value(self, worse, better, n_tried=1):
        alone = len(better.structure.effects) == 1
        return 1.0 if alone else super().p_value(worse, better, n_tried)


def test_two_effects_are_claimed_together_where_neither_is_enough(missing_two):
    records, folds, base = missing_two
    names = "lag", "offset", "static_nonlinearity"
    found = {}
    for structured in (True, False):
        rounds = rounds_of(records, folds, *names, structured=structured)
        rounds.criterion = NotAlone(0.01, 0.05)
        found[structured] = rounds.run(base).structure.effects
        assert {row["effect"] for row in rounds.history} == set(found[structured])
        alone = [row for row in rounds.ranking if row["round"] == 1]
        assert len(alone) == len(names)
        assert all(0.0 <= row["screen"] < 1.0 for row in alone)  # parts of the cost
    assert set(found[True]) == {"lag", "offset"}
    assert not found[False]  # where only noise is left, no pair is tried


def test_effects_alone_and_pairs_have_half_of_the_level_each(missing_two):
    records, folds, base = missing_two
    names = "lag", "offset", "delay", "dead_zone"
    rounds = rounds_of(records, folds, *names)
    rounds._singles(base, rounds.effects)
    assert rounds._n_tried == 2 * sum(len(EFFECTS[name].variants()) for name in names)
    rounds = rounds_of(records, folds, *names)
    rounds.criterion = Criterion(0.01, 1.0 - 1e-9)
    assert rounds._round(base) is None
    assert rounds._n_tried == 2 * 6


def test_a_pair_is_claimed_only_where_both_are_needed(missing_two, monkeypatch):
    records, folds, base = missing_two
    rounds = rounds_of(records, folds, "lag", "offset", "asymmetry")
    rounds._n_tried = 1
    lag, offset = rounds._singles(base, rounds.effects[:2])[0]
    both = {c.effects: c for c in rounds._pairs(base, [lag, offset], rounds.effects)}
    needed = {frozenset(names): rounds._needs_all(c) for names, c in both.items()}
    assert needed[frozenset(("lag", "offset"))]
    assert not any(need for names, need in needed.items() if "asymmetry" in names)
    pair = both["lag", "offset"]
    assert rounds._is_better(base, pair)
    monkeypatch.setattr(rounds, "_needs", lambda candidate, reduced: False)
    assert rounds._chosen(base, [pair]) is None


def test_a_simpler_effect_takes_the_place_of_an_earlier_one(missing_two):
    """A creep without a part that follows at once is a lag; it has one parameter more."""
    records, folds, base = missing_two
    rounds = rounds_of(records, folds, "creep", "offset")
    claimed = rounds.run(base)
    assert set(claimed.structure.effects) == {"creep", "offset"}
    rounds.effects.append(EFFECTS["lag"])
    contested = rounds.run(claimed)
    assert set(contested.structure.effects) == {"lag", "offset"}
    assert {row["effect"] for row in rounds.history} == {"lag", "offset"}
    assert contested.error < 1.05 * claimed.error
    assert "creep" in rounds.dropped


def test_no_set_of_effects_is_claimed_twice(missing_two):
    records, folds, base = missing_two
    rounds = rounds_of(records, folds, "lag", "offset")
    rounds._claimed.add(frozenset(("lag", "offset")))
    assert len(rounds.run(base).structure.effects) == 1


def test_what_is_uncertain_stays_where_the_search_would_go_back(missing_two, monkeypatch):
    """Each effect may hide the other: neither is certain, and without both much is lost."""
    records, folds, base = missing_two
    rounds = rounds_of(records, folds, "lag", "offset")
    both = rounds.run(base)
    monkeypatch.setattr(rounds, "_needs", lambda candidate, reduced: False)
    lesser = min(rounds._without(both, name).error for name in both.structure.effects)
    assert rounds._recheck(both, 0.5 * lesser) is both
    assert len(rounds._recheck(both, lesser).structure.effects) == 1
