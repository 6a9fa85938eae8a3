"""The steps of a contest, on candidates that are made up: no model is fitted here."""

from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.exceptions import FitFailedWarning

from skhyst.diagnosis import Effect, _contest
from skhyst.diagnosis._candidates import Candidate
from skhyst.diagnosis._contest import Contest
from skhyst.disturbance import OffsetOperator, SinusoidOperator
from skhyst.optimize import RecordData


class Names:
    """A structure that knows the effects in it, and how many values its parts have."""

    def __init__(self, effects, size=5, lines=()):
        self.effects, self.lines, self.input_history, self.declared = effects, lines, (), None
        self.root = SimpleNamespace(n_parameters=size)

    def without(self, name):
        return Names(tuple(own for own in self.effects if own != name))

    def part(self, name):
        return OffsetOperator(np.ones(1))

    def label(self, name):
        return name

    @property
    def disturbance_names(self):
        return tuple(name for name in self.effects if name in "op")

    names = ()


def candidate(effects, error, *, own=None, n_parameters=1, cost=None, size=5, lines=()):
    """Return a candidate with those effects, of which its last step has put in one, or ``own``."""
    own = tuple(effects[-1:]) if own is None else own
    cost = error**2 if cost is None else cost
    known = {"residuals": (np.full(4, error),), "weights": (None,), "error": error}
    structure = Names(tuple(effects), size, lines)
    return Candidate(own, structure, cost, cost, n_parameters, np.empty(0), **known)


class Margins:
    """It matters by a tenth, and is significant where it is lower by more than a fifth."""

    alpha, min_improvement = 0.05, 0.1

    def improves_enough(self, worse, better):
        return better.error < 0.9 * worse.error

    def p_value(self, worse, better, n_tried=1):
        return min(1.0, n_tried * (0.01 if better.error < 0.8 * worse.error else 0.5))

    def is_better(self, worse, better, n_tried=1):
        return (
            self.improves_enough(worse, better)
            and self.p_value(worse, better, n_tried) < self.alpha
        )


def effect(name, additive=False):
    return Effect(name, lambda: [object()], "", f"record {name}", additive)


DRIVEN, ADDITIVE = [effect(n) for n in "abcd"], [effect(n, True) for n in "op"]


@pytest.fixture
def known(monkeypatch):
    """Effects of one letter: o and p are functions of time alone."""
    monkeypatch.setattr(_contest, "EFFECTS", {e.name: e for e in DRIVEN + ADDITIVE})
    monkeypatch.setattr(_contest, "held_out", lambda c, records, folds: c)
    monkeypatch.setattr(_contest, "fold_errors", lambda c, records, folds: [c.error, 1.0])


def contest_of(**options):
    """Return a contest, and what it has told."""
    options = {
        "effects": DRIVEN + ADDITIVE,
        "records": ["record"],
        "folds": ["fold"],
        "criterion": Margins(),
        "max_effects": 3,
        "n_jobs": 1,
        "negligible": 1e-3,
        "report_progress": lambda *told: None,
        "renew": None,
        "judge": lambda c: None,
        **options,
    }
    return Contest(**options)


def screening(contest, errors):
    """Let the screening find candidates of those errors by the set of their effects."""
    asked = []

    def screened(base, pairs):
        asked.append([(e.name, "".join(c.structure.effects)) for e, c in pairs])
        variants, kept, seen = [], [], []
        for i, (e, c) in enumerate(pairs):
            names = (*c.structure.effects, e.name)
            error = errors.get("".join(sorted(names)))
            own = [] if error is None else [candidate(names, error)]
            variants.append(own * 2)
            kept += [i] * bool(own)
            seen.append((["record"], base.cost))
        return variants, kept, seen

    contest._screened = screened
    contest._fitted = lambda bases, found: [found[0][i][0] for i in found[1]]
    return asked


def test_a_step_is_done_once_and_kept(known):
    """What responds to the drive, and what does not, are steps of their own."""
    kept = []
    contest = contest_of(keep=lambda steps: kept.append(len(steps)))
    asked = screening(contest, {"a": 0.5, "c": 2.0, "p": 0.7})
    base = candidate("", 1.0)
    assert [c.effects for c in contest.extended(base)] == [("a",), ("c",)]
    assert [c.effects for c in contest.extended(base, additive=True)] == [("p",)]
    for _ in range(2):
        assert [c.error for c in contest.extended(base)] == [0.5, 2.0]
    assert asked == [[(n, "") for n in "abcd"], [(n, "") for n in "op"]]
    assert kept == [1, 2]
    assert contest.n_tried == 4  # two variants of each of two effects
    again = contest_of(steps=contest.steps)
    screening(again, {})
    assert again.n_tried == 1  # nothing of what was kept has been come to
    assert [c.error for c in again.extended(base)] == [0.5, 2.0]
    assert again.n_tried == 4
    assert set(contest.seconds) == {"screening", "contest"}
    assert all(0.0 <= spent < 60.0 for spent in contest.seconds.values())


def test_a_model_without_an_effect_is_the_best_that_was_found(known, monkeypatch):
    """A fit from where an effect was may fail; what was found before is better."""
    again = contest_of(steps={})
    for contest in (contest_of(steps=again.steps), again):  # the second goes on with the first's
        screening(contest, {"a": 0.5, "b": 0.7})
        contest.extended(candidate("", 1.0))
        monkeypatch.setattr(contest, "_without_effect", lambda base, name: candidate("a", 0.9))
        assert contest.without(candidate("ab", 0.4), "b").error == 0.5


def test_beside_other_effects_those_are_tried_that_have_helped_before(known):
    contest = contest_of()
    asked = screening(contest, {"a": 0.5, "b": 0.95, "c": 2.0, "ab": 0.4, "ad": 0.3})
    first = candidate("", 1.0)
    contest.extended(first)
    path = candidate("a", 0.5)
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4]
    assert asked[1:] == [[("b", "a")]]  # c has not helped, a is there
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4]
    assert len(asked) == 2
    assert [c.error for c in contest.extended(path)] == [0.4, 0.3]
    assert asked[2:] == [[("b", "a"), ("c", "a"), ("d", "a")]]
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4, 0.3]  # all is known
    rounds = [(row["round"], row["with_effects"], row["effect"]) for row in contest.ranking]
    assert rounds[:4] == [(1, "", n) for n in "abcd"]
    assert {own[:2] for own in rounds[4:]} == {(2, "a")}


def test_what_fits_better_but_was_never_held_out_is_tried_beside_others(known):
    """Others have fitted better still: nothing is known of it."""
    contest = contest_of()
    asked = screening(contest, {"a": 0.5, "b": 0.7, "c": 0.96, "ab": 0.4})
    contest._fitted = lambda bases, found: [found[0][0][0]]  # the first of those in question
    contest.extended(candidate("", 1.0))
    contest.extended(candidate("a", 0.5), fully=False)
    assert asked[1] == [("b", "a")]  # c fits hardly better


def test_the_ranking_tells_what_each_effect_has_achieved(known):
    contest = contest_of()
    screening(contest, {"a": 0.5, "c": 2.0})
    contest.extended(candidate("", 1.0, n_parameters=1))
    rows = {row["effect"]: row for row in contest.ranking}
    assert (rows["a"]["error_before"], rows["a"]["error_after"]) == (1.0, 0.5)
    assert rows["a"]["screen"] == 0.75  # of the sum of squares
    assert rows["c"]["screen"] == 0.0  # it is not lower
    assert rows["a"]["p_value"] == pytest.approx(4 * 0.01)
    assert rows["c"]["p_value"] == 1.0
    assert rows["a"]["fold_errors"] == [0.5, 1.0]
    assert rows["a"]["n_parameters"] == 0
    assert rows["b"]["screen"] == rows["b"]["n_parameters"] == 0
    assert np.isnan([rows["b"]["error_after"], rows["b"]["p_value"]]).all()
    assert rows["b"]["fold_errors"] is None


def test_pairs_are_of_the_three_that_fit_best_with_every_other(known):
    contest = contest_of()
    asked = screening(contest, {"ab": 0.3})
    costs = {"a": 3.0, "b": 1.0, "c": 4.0, "d": 2.0}
    singles = [candidate(n, 1.0, cost=cost) for n, cost in costs.items()]
    found = contest._pairs(candidate("", 1.0), singles)
    assert {c.effects for c in found} == {("a", "b"), ("b", "a")}
    tried = set(asked[0])
    assert {second for _, second in tried} == {"a", "b", "d"}
    assert len(tried) == 3 * 5
    assert all(first != second for first, second in tried)
    assert contest.n_tried == 1 + 15  # of six effects, beside the model itself


def test_suspects_would_help_most_but_are_not_in(known):
    contest = contest_of()
    screening(contest, {"a": 0.7, "b": 0.95, "d": 0.5, "abd": 0.5})
    rows = contest.suspects(candidate("", 1.0))
    assert [(row["effect"], row["error_before"], row["error_after"]) for row in rows] == [
        ("d", 1.0, 0.5),
        ("a", 1.0, 0.7),
    ]
    assert [row["folds_better"] for row in rows] == [1, 1]  # the other fold is the same
    assert [row["p_value"] for row in rows] == pytest.approx([6 * 0.01] * 2)
    assert contest.suspects(candidate("abc", 1.0)) == []  # as many as there may be
    assert contest.suspects(candidate("", 1e-3)) == []  # nothing is left
    assert len(contest.suspects(candidate("ab", 1.0))) == 1


def noise_has(contest, course):
    """Let noise alone have the course of the candidates for which ``course`` is true."""
    tested = contest.criterion.p_value
    contest._p_value = lambda base, name, reduced: (
        1.0 if course(base) else tested(reduced, base, contest.n_tried)
    )


def tried(**errors):
    """Name an effect by its error, that without it, and those with others in its place."""
    contest = contest_of()
    base = candidate("a", errors.pop("a"), n_parameters=3)
    reduced = candidate("", errors.pop("none"))
    contest._without_effect = lambda base, name: reduced
    sizes = errors.pop("sizes", {})
    rivals = [candidate(n, e, n_parameters=sizes.get(n, 3)) for n, e in errors.items()]
    contest.extended = lambda start, fully=True, additive=False: [
        c for c in rivals if (c.effects[0] in "op") == additive
    ]
    contest._refreshed = lambda c: c
    noise_has(contest, lambda c: c.effects == ("p",))
    contest._has_its_name = lambda c, name: True
    contest._contains = lambda large, small: small.effects != ("d",)
    chosen, others = contest._contested(base, "a")
    return chosen and chosen.effects[0], others


def test_the_name_is_that_of_the_least_error(known):
    assert tried(none=1.0, a=0.5) == (None, ())
    assert tried(none=1.0, a=0.5, b=0.45) == ("b", ("a",))  # which is not told from it
    assert tried(none=1.0, a=0.5, b=0.3) == ("b", ())
    assert tried(none=1.0, a=0.5, b=0.55, c=0.52) == (None, ("c", "b"))
    assert tried(none=1.0, a=0.5, b=0.45, c=0.48) == ("b", ("c", "a"))
    assert tried(none=1.0, a=0.5, b=0.7) == (None, ())  # told from it
    assert tried(none=1.0, a=0.5, b=0.95) == (None, ())  # no better than nothing
    # a function of time helps no new record
    assert tried(none=1.0, a=0.5, o=0.46) == (None, ("o",))
    assert tried(none=1.0, a=0.5, b=0.48, o=0.46) == ("b", ("o", "a"))
    assert tried(none=1.0, a=0.5, o=0.44) == ("o", ("a",))
    assert tried(none=1.0, a=0.5, o=0.44, sizes={"o": 4}) == (None, ("o",))
    assert tried(none=1.0, a=0.5, o=0.3, sizes={"o": 4}) == ("o", ())
    assert tried(none=1.0, a=0.5, p=0.45) == (None, ())  # the noise's own course


def test_a_simpler_name_is_preferred_where_it_is_nested_and_not_rejected(known):
    assert tried(none=1.0, a=0.5, b=0.55, sizes={"b": 2}) == ("b", ("a",))
    assert tried(none=1.0, a=0.5, d=0.55, sizes={"d": 2}) == (None, ("d",))  # it is not nested
    assert tried(none=1.0, a=0.5, b=0.7, sizes={"b": 2}) == (None, ())  # it is rejected
    assert tried(none=1.0, a=0.5, b=0.55, c=0.56, sizes={"b": 2, "c": 1}) == ("c", ("a", "b"))


def test_an_effect_that_is_not_what_its_name_says_goes_where_a_rival_is(known):
    contest = contest_of()
    contest._without_effect = lambda base, name: candidate("", 1.0)
    contest._refreshed = lambda c: c
    contest._has_its_name = lambda c, name: False
    contest._contains = lambda *_: True
    contest.extended = lambda start, fully=True, additive=False: []
    assert contest._contested(candidate("a", 0.5), "a") == (None, ())
    rivals = [candidate("b", 0.6)]
    contest.extended = lambda start, fully=True, additive=False: rivals * (not additive)
    (chosen, others) = contest._contested(candidate("a", 0.49), "a")
    assert (chosen.effects, others) == (("b",), ())


def test_names_are_contested_until_they_stay(known):
    """A rival takes the place, the rest is pruned, and no set of effects is come to twice."""
    contest = contest_of()
    rivals = {"a": "b", "b": "c", "c": None}
    contest.prune = lambda c: c
    contest._contested = lambda base, name: (
        rivals[name] and candidate(rivals[name], 0.5),
        (f"not {name}", "a"),
    )
    base, others = contest.named(candidate("a", 0.5))
    assert (base.structure.effects, others) == (("c",), {"c": ("not c", "a")})
    rivals["c"] = "a"
    base, others = contest.named(candidate("a", 0.5))
    # in a circle each name is ambiguous with the one that would follow, and none with itself
    assert (base.structure.effects, others) == (("a",), {"a": ("b", "not a")})


def test_a_rival_takes_the_place_of_what_the_noise_makes_where_something_is_needed(known):
    contest, errors = contest_of(), {"": 1.0, "p": 0.5, "o": 0.45}
    contest.without = contest._without_effect = lambda base, name: candidate("", errors[""])
    contest._keeps_names = contest._has_its_name = lambda *_: True
    noise_has(contest, lambda c: c.effects == ("p",))
    contest.extended = lambda start, fully=True, additive=False: (
        [candidate("o", errors["o"])] * additive
    )
    contest._refreshed = lambda c: c
    pruned = contest.prune(candidate("p", errors["p"]))
    assert (pruned.structure.effects, contest.dropped) == (("o",), ["p"])
    contest.extended = lambda start, fully=True, additive=False: []
    contest._contests.clear()
    assert contest.prune(candidate("p", errors["p"])).structure.effects == ()


def test_the_best_that_was_seen_of_a_set_of_effects_is_kept(known):
    contest = contest_of()
    assert contest._least(candidate("ab", 0.5, own=("b",))).error == 0.5
    better = contest._least(candidate("ba", 0.4, own=("a",)))
    assert (better.error, better.effects) == (0.4, ("a",))
    again = contest._least(candidate("ab", 0.45, own=("b",)))
    assert (again.error, again.effects) == (0.4, ("b",))
    contest._weighings += 1  # of other weights nothing is known yet
    assert contest._least(candidate("ab", 0.45)).error == 0.45


def test_names_that_were_right_stay_right(known):
    contest = contest_of()
    right = {(1.0, "a"), (0.5, "a"), (0.5, "b")}
    contest._has_its_name = lambda c, name: (c.error, name) in right
    base = candidate("ab", 1.0)
    assert contest._keeps_names(candidate("ab", 0.5), base)
    assert not contest._keeps_names(candidate("ab", 2.0), base)  # a no longer is
    assert contest._keeps_names(candidate("b", 2.0), base)  # b was not
    contest.raised = lambda c: (candidate("ab", c.error / 2.0, own=()), [])
    assert contest._finer(candidate("ab", 1.0)).error == 0.5
    assert contest._finer(candidate("ab", 1.0)).effects == ("b",)
    contest.raised = lambda c: (candidate("ab", 2.0), [])
    assert contest._finer(base) is base


@pytest.mark.parametrize(
    ("name", "p_value", "stays"), [("a", 0.9, True), ("o", 0.009, True), ("o", 0.0126, False)]
)
def test_a_function_of_time_is_more_than_the_noise(known, monkeypatch, name, p_value, stays):
    """At the level of all that was tried, here four; a sinusoid also in blocks of samples."""
    monkeypatch.setattr(_contest, "course_p_values", lambda *_: {"o": p_value, "p": 1.0})
    contest = contest_of()
    contest._visited = {"step": {"n_tried": 4, "in_pairs": False}}
    without = candidate("", 1.0)
    assert contest._is_needed(candidate(name, 0.5), name, without) == stays
    assert not contest._is_needed(candidate(name, 0.95), name, without)
    assert contest._is_needed(candidate(name, 0.85), name, without) == (stays and name == "o")
    monkeypatch.setattr(Names, "part", lambda *_: SinusoidOperator(np.ones(2), np.ones(1)))
    assert not contest._is_needed(candidate(name, 0.85), name, without)
    assert contest._is_needed(candidate(name, 0.5), name, without) == stays
    contest.renew = True  # what a black box leaves has a course of the box's own
    assert contest._is_needed(candidate(name, 0.5), name, without)


def test_of_variants_those_are_held_out_that_may_matter_and_are_plausible(known, monkeypatch):
    """By a tenth of the error, so 0.81 of the sum of squares; of each effect one is completed."""
    completions = []

    def completed(c, records, evaluations):
        completions.append((c.error, evaluations))
        return c

    monkeypatch.setattr(_contest, "completed", completed)
    monkeypatch.setattr(_contest, "are_long", lambda records: records == ["long"])
    contest = contest_of()
    contest._is_plausible = lambda c, base, records: c.error != 0.3
    bases = [candidate("", 1.0)] * 3
    few, many = candidate("a", 0.85, n_parameters=2), candidate("a", 0.82, n_parameters=3)
    variants = [
        [many, few, candidate("a", 0.91), candidate("a", 0.3)],
        [candidate("b", 0.899)],
        [candidate("c", 0.5)],
    ]
    seen = [(["record"], 1.0)] * 3
    found = contest._fitted(bases, (variants, [0, 1], seen))  # the third was left out by halving
    assert [c.error for c in found] == [0.85, 0.899]
    assert completions == [(0.85, 27), (0.899, 27)]
    contest.records = ["long"]
    contest._fitted(bases, (variants, [1], seen))
    assert completions[2:] == [(0.899, 3)]


def test_what_fails_costs_its_candidate(known):
    contest = contest_of()

    def job(c):
        if c.error > 1.0:
            raise ValueError("no solution")
        return c

    jobs = [_contest.delayed(job)(candidate(n, e)) for n, e in (("a", 1.0), ("c", 2.0))]
    with pytest.warns(FitFailedWarning, match="c is left out"):
        found = contest._done(jobs)
    assert [c.error for c in found] == [1.0]
    contest._keep("step", found)
    assert contest.failed == [{"round": 1, "effect": "c", "error": "ValueError: no solution"}]
    contest._keep("next", [])
    assert len(contest.failed) == 1


def test_lines_in_a_number_of_the_record_predict_other_numbers(known, monkeypatch):
    """Better than the model without them, where a level can be held out."""
    folds = ["level"]
    monkeypatch.setattr(_contest, "level_folds", lambda records: folds)
    contest, base = contest_of(), candidate("", 1.0)

    def predicts(error, lines=("line",)):
        c = candidate("a", error, lines=lines)
        c.structure.read = lambda records: records
        return contest._predicts_levels(c, base, ["record"])

    assert predicts(0.99)
    assert not predicts(1.01)
    assert predicts(1.01, lines=())
    base.structure.lines = ("declared",)
    assert predicts(1.01)
    base.structure.lines = ()
    folds.clear()
    assert predicts(1.01)


def test_a_residual_is_judged_once(known):
    judged = []
    contest = contest_of(judge=lambda c: judged.append(c.error) or c.error)
    for error in (1.0, 1.0, 0.5, 1.0):
        assert contest.judgement(candidate("a", error)) == error
    assert judged == [1.0, 0.5]


def test_paths_go_on_until_nothing_is_better(known):
    """Each as far as it comes; the ends are those that have no better one."""
    told = []
    contest = contest_of(report_progress=lambda *own: told.append(own[0]))
    better = {"": ["a", "b"], "a": [], "b": ["bc"], "bc": []}
    errors = {"": 1.0, "a": 0.5, "b": 0.6, "bc": 0.3}
    contest._better = lambda path, *_: [
        candidate(n, errors[n]) for n in better["".join(path.structure.effects)]
    ]
    contest._few = lambda candidates, claims: candidates
    contest._refreshed = lambda c: c
    ends = contest.grow(candidate("", 1.0))
    assert ["".join(c.structure.effects) for c in ends] == ["a", "bc"]
    assert told[-1].endswith("b + c: held-out error 0.3")


@pytest.mark.parametrize("names", ["p", "ap"])
def test_an_effect_that_misleads_hides_nothing_that_is_found_without_it(known, names):
    """What p is beside a, which helps and is not needed, the noise makes; alone it is more."""
    contest = contest_of(
        effects=[e for e in DRIVEN + ADDITIVE if e.name in names],
        judge=lambda c: SimpleNamespace(structured=False),
    )
    screening(contest, {"a": 0.88, "ap": 0.6, "p": 0.7})
    left = {("ap", "a"): 0.62, ("ap", "p"): 0.88}
    contest.without = lambda base, name: candidate(
        base.structure.without(name).effects, left.get(("".join(base.structure.effects), name), 1.0)
    )
    contest._refreshed, contest._keeps_names = lambda c: c, lambda *_: True
    noise_has(contest, lambda c: "p" in c.effects and c.error != 0.7)
    contest._contested = lambda base, name: (None, ())
    found = contest.found(candidate("", 1.0))
    assert (found.structure.effects, found.error) == (("p",), 0.7)


def test_what_is_taken_out_is_fitted_again_once(known, monkeypatch):
    """Where a black box was declared it is fitted too."""
    done = []

    def refitted(c, structure, records):
        done.append(structure.effects)
        return candidate(structure.effects, 0.7)

    monkeypatch.setattr(_contest, "refitted", refitted)
    contest, base = contest_of(), candidate("ab", 0.5)
    for _ in range(2):
        reduced = contest.without(base, "a")
        assert (reduced.structure.effects, reduced.error) == (("b",), 0.7)
    assert done == [("b",)]
    renewed = []
    contest = contest_of(
        renew=lambda c, own, records: renewed.append(c.error) or candidate("b", 0.6)
    )
    assert contest.without(base, "a").error == 0.6
    assert renewed == [0.7]


def test_weights_are_of_what_is_left_where_the_loss_is_robust(known, monkeypatch):
    """All steps are then done anew."""
    monkeypatch.setattr(_contest, "huber_weights", lambda residuals, lost: [np.full(4, 0.5)])
    monkeypatch.setattr(_contest, "refitted", lambda c, structure, records: candidate("a", 0.4))
    base = candidate("a", 0.5)
    assert contest_of().weighed(base) is base
    u = np.arange(4.0)
    contest = contest_of(lost=[u > 9.0], records=[RecordData(u, u, 0.1)])
    contest._keep(contest._set(base), [base])
    assert contest._is_done(contest._set(base))
    assert contest.weighed(base).error == 0.4
    np.testing.assert_array_equal(contest.records[0].weights, np.full(4, 0.5))
    first = contest._set(base)
    assert not contest._is_done(first)
    contest.weighed(base)
    assert contest._set(base) != first


def test_a_name_is_plausible_by_its_margin_and_by_what_it_predicts(known, monkeypatch):
    contest = contest_of()
    for named in (True, False):
        for predicts in (True, False):
            monkeypatch.setattr(_contest, "is_plausible", lambda *_, named=named: named)
            contest._predicts_levels = lambda *_, predicts=predicts: predicts
            found = contest._is_plausible(candidate("a", 0.5), candidate("", 1.0), [])
            assert found == (named and predicts)


def pruned(errors, right=True):
    """Prune the effects a, b and c whose models have those errors; return what is left."""
    contest = contest_of(report_progress=lambda *_: None)
    found = {names: candidate(names, error) for names, error in errors.items()}
    contest.without = lambda base, name: found[
        "".join(n for n in base.structure.effects if n != name)
    ]
    noise_has(contest, lambda c: False)
    contest._has_its_name = lambda c, name: right or c is found[max(found, key=len)]
    return "".join(contest.prune(found[max(found, key=len)]).structure.effects)


def test_what_is_missed_least_goes_first(known):
    assert pruned({"ab": 1.0, "a": 1.05, "b": 1.02, "": 2.0}) == "b"
    assert pruned({"ab": 1.0, "a": 1.02, "b": 1.05, "": 2.0}) == "a"
    assert pruned({"ab": 1.0, "a": 2.0, "b": 2.0, "": 1.05}) == ""  # they compensate
    assert pruned({"ab": 1.0, "a": 2.0, "b": 2.0, "": 2.0}) == "ab"
    assert pruned({"a": 1.0, "": 1.2}) == ""  # it matters, and is not significant
    assert pruned({"a": 1.0, "": 1.3}) == "a"


def test_an_effect_stays_without_which_another_would_not_be_what_it_is(known):
    assert pruned({"ab": 1.0, "a": 1.02, "b": 1.05, "": 2.0}, right=False) == "ab"
    assert pruned({"ab": 1.0, "a": 1.15, "b": 1.05, "": 2.0}, right=False) == "a"  # not the same
