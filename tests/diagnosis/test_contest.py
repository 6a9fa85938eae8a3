"""What a contest decides, in worlds where the error of each set of effects is known: no fits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import search_steps

from skhyst.diagnosis import Effect, _contest
from skhyst.disturbance import OffsetOperator, SinusoidOperator
from skhyst.optimize import RecordData

U = np.arange(4.0)
DRIVEN, OF_TIME = "abcd", "op"
EFFECTS = [
    Effect(name, lambda: [object()], "", f"record {name}", name in OF_TIME)
    for name in DRIVEN + OF_TIME
]


class Model:
    """A structure that knows the effects in it, and its error."""

    input_history, declared, names = (), None, ()
    root = SimpleNamespace(n_parameters=5)

    def __init__(self, effects, error=np.nan, lines=()):
        self.effects, self.error, self.lines = tuple(effects), error, lines

    def without(self, name):
        return Model(own for own in self.effects if own != name)

    def identified(self, records):
        return self

    def read(self, records):
        return records

    def part(self, name):
        return OffsetOperator(np.ones(1))

    def label(self, name):
        return name

    @property
    def disturbance_names(self):
        return tuple(name for name in self.effects if name in OF_TIME)

    def problem(self, records):
        return SimpleNamespace(
            segment_record=[0],
            segment_weight=np.ones(1),
            x0=None,
            names=self.effects,
            predictions=lambda x, *_: [record.y for record in records],
        )


def candidate(effects, error, *, cost=None, n_parameters=1, lines=()):
    """Return a model with those effects, of which the last one was added last.

    With every effect it fits twice as well, whatever its error on what it has not seen.
    """
    if cost is None:
        cost = 0.5 ** len(effects) * min(error, 1.0) ** 2
    known = {"residuals": (np.full(4, error),), "weights": (None,), "error": error}
    model = Model(effects, error, lines)
    return search_steps.candidate(
        model, effects=effects[-1:], cost=cost, n_parameters=n_parameters, **known
    )


class Margins:
    """It matters by a tenth, and is significant where it is lower by more than a fifth."""

    alpha, min_improvement = 0.05, 0.1

    def __init__(self, unsure=()):
        self.unsure = unsure  # effects that are never significant

    def improves_enough(self, worse, better):
        return better.error < 0.9 * worse.error

    def p_value(self, worse, better, n_tried=1):
        sure = better.error < 0.8 * worse.error and not set(better.effects) & set(self.unsure)
        return min(1.0, n_tried * (0.01 if sure else 0.5))

    def is_better(self, worse, better, n_tried=1):
        enough = self.improves_enough(worse, better)
        return enough and self.p_value(worse, better, n_tried) < self.alpha


class World:
    """What there is to find: the errors of sets of effects, and what a name depends on."""

    def __init__(self, monkeypatch):
        self.errors, self.sizes, self.costs = {}, {}, {}
        self.variants = {}  # of an effect, where it has several
        self.refits = {}  # errors where a fit from another model ends elsewhere
        self.dropped = ""  # effects that halving leaves out
        self.is_right = lambda model, name: True
        self.is_noise = lambda model: False
        self.nested = lambda model: True
        self.level_errors = {}
        self.asked, self.completions, self.refitted = [], [], []
        fakes = {
            "EFFECTS": {effect.name: effect for effect in EFFECTS},
            "screened": self._screened,
            "halve": lambda groups, _: (
                [found for found, *_ in groups],
                [i for i, (found, *_) in enumerate(groups) if found and self._stays(found[0])],
            ),
            "held_out": self._held_out,
            "completed": self._completed,
            "refitted": self._refitted,
            "fold_errors": lambda c, records, folds: [c.error, 1.0],
            "shortened": lambda *_: None,
            "are_long": lambda records: len(records) > 1,
            "raised": lambda base, *_: (base, []),
            "level_folds": lambda records: ["level"] if self.level_errors else [],
            "has_its_name": lambda name, margin, model, *_: self.is_right(model, name),
            "is_plausible": lambda margin, c, *_: self.is_right(c.structure, c.effects[-1]),
            "course_p_values": lambda model, _: {
                name: 1.0 for name in model.disturbance_names if self.is_noise(model)
            },
            "variable_projection": lambda problem, *_, **options: SimpleNamespace(
                cost=0.0 if self.nested(problem) else np.inf
            ),
        }
        for name, fake in fakes.items():
            monkeypatch.setattr(_contest, name, fake)

    def model(self, effects, error=None):
        key = "".join(sorted(effects))
        error = self.errors[key] if error is None else error
        sizes = self.costs.get(key), self.sizes.get(key, len(effects))
        return candidate(effects, error, cost=sizes[0], n_parameters=sizes[1])

    def _stays(self, c):
        return c.effects[-1] not in self.dropped

    def _screened(self, effect, structure, records):
        before = "".join(structure.effects)
        self.asked.append((effect.name, before))
        if effect.name in self.variants:
            return self.variants[effect.name]
        known = "".join(sorted(before + effect.name)) in self.errors
        return [self.model((*structure.effects, effect.name))] if known else []

    def _held_out(self, c, records, folds):
        error = self.level_errors[c.structure.lines] if folds == ["level"] else c.error
        return replace(c, error=error)

    def _completed(self, c, records, max_evaluations):
        self.completions.append((c.error, max_evaluations))
        return c

    def _refitted(self, base, structure, records):
        before, after = ("".join(tree.effects) for tree in (base.structure, structure))
        self.refitted.append(after)
        return self.model(structure.effects, self.refits.get((before, after)))


@pytest.fixture
def world(monkeypatch):
    return World(monkeypatch)


def contest_of(**options):
    known = {"criterion": Margins(), "negligible": 1e-3, "effects": EFFECTS}
    known["judge"] = lambda c: SimpleNamespace(structured=False)
    records = options.pop("records", [RecordData(U, U, 0.1)])
    return search_steps.contest(records, ["fold"], **known | options)


def contest_after_one_trial(world):
    """Return a contest of one effect of the drive, which was of no use, and those of time."""
    world.errors = world.errors | {"d": 20.0}
    contest = contest_of(effects=EFFECTS[3:])
    contest.extended(candidate("", 1.0))
    assert contest.n_tried == 1
    return contest


def names_of(candidates):
    return ["".join(c.structure.effects) for c in candidates]


# ------------------------------------------------------------------------------------ single steps


def test_a_step_is_done_once_and_kept(world):
    """What responds to the drive, and what does not, are steps of their own."""
    world.errors = {"": 1.0, "a": 0.5, "c": 2.0, "p": 0.7}
    kept = []
    contest = contest_of(keep=lambda steps: kept.append(len(steps)))
    base = candidate("", 1.0)
    assert names_of(contest.extended(base)) == ["a", "c"]
    assert names_of(contest.extended(base, additive=True)) == ["p"]
    for _ in range(2):
        assert [c.error for c in contest.extended(base)] == [0.5, 2.0]
    assert world.asked == [(n, "") for n in DRIVEN + OF_TIME]
    assert kept == [1, 2]
    assert contest.n_tried == 2  # variants of driven effects
    again = contest_of(steps=contest.steps)
    assert again.n_tried == 1  # nothing of what was kept has been come to
    assert [c.error for c in again.extended(base)] == [0.5, 2.0]
    assert again.n_tried == 2
    assert len(world.asked) == 6
    assert set(contest.seconds) == {"screening", "contest"}
    contest.lost = [U > 9.0]
    contest.weighed(candidate("", 1.0))  # with other weights all steps are done anew
    contest.extended(base)
    assert len(world.asked) == 10


def test_a_model_without_an_effect_is_the_best_that_was_found(world):
    """A fit from where an effect was may fail; what was found before is better."""
    world.errors, world.refits = {"": 1.0, "a": 0.5, "b": 0.7}, {("ab", "a"): 0.9}
    again = contest_of(steps={})
    for contest in (contest_of(steps=again.steps), again):  # the second goes on with the first's
        contest.extended(candidate("", 1.0))
        assert contest.without(candidate("ab", 0.4), "b").error == 0.5


def test_what_is_taken_out_is_fitted_again_once(world):
    """Where a black box was declared it is fitted too."""
    world.errors = {"b": 0.7}
    contest, base = contest_of(), candidate("ab", 0.5)
    for _ in range(2):
        reduced = contest.without(base, "a")
        assert (reduced.structure.effects, reduced.error) == (("b",), 0.7)
    assert world.refitted == ["b"]
    renewed = []
    contest = contest_of(
        renew=lambda c, own, records: renewed.append(c.error) or candidate("b", 0.6)
    )
    assert contest.without(base, "a").error == 0.6
    assert renewed == [0.7]


def test_beside_other_effects_those_are_tried_that_have_helped_before(world):
    world.errors = {"": 1.0, "a": 0.5, "b": 0.95, "c": 2.0, "ab": 0.4, "ad": 0.3}
    contest, path = contest_of(), candidate("a", 0.5)
    contest.extended(candidate("", 1.0))
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4]
    assert world.asked[4:] == [("b", "a")]  # c has not helped, a is there
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4]
    assert len(world.asked) == 5
    assert [c.error for c in contest.extended(path)] == [0.4, 0.3]
    assert world.asked[5:] == [("b", "a"), ("c", "a"), ("d", "a")]
    assert [c.error for c in contest.extended(path, fully=False)] == [0.4, 0.3]  # all is known
    rounds = [(row["round"], row["with_effects"], row["effect"]) for row in contest.ranking]
    assert rounds[:4] == [(1, "", n) for n in DRIVEN]
    assert {own[:2] for own in rounds[4:]} == {(2, "a")}


def test_what_fits_better_but_was_never_held_out_is_tried_beside_others(world):
    """Others have fitted better still: nothing is known of it."""
    world.errors = {"": 1.0, "a": 0.5, "b": 0.7, "c": 0.96, "ab": 0.4}
    world.costs, world.dropped = {"c": 0.95}, "bc"
    contest = contest_of()
    contest.extended(candidate("", 1.0))
    contest.extended(candidate("a", 0.5), fully=False)
    assert world.asked[4:] == [("b", "a")]  # c fits hardly better


def test_the_ranking_has_a_row_per_effect_with_its_errors(world):
    world.errors = {"": 1.0, "a": 0.5, "c": 2.0, "d": 1.1}
    world.costs = {"a": 0.25, "c": 0.5, "d": 4.0}
    contest = contest_of()
    contest.extended(candidate("", 1.0))
    rows = {row["effect"]: row for row in contest.ranking}
    assert (rows["a"]["error_before"], rows["a"]["error_after"]) == (1.0, 0.5)
    assert rows["a"]["screen"] == 0.75  # of the sum of squares
    assert rows["d"]["screen"] == 0.0  # it is not lower
    assert rows["a"]["p_value"] == pytest.approx(3 * 0.01)  # of all that was tried
    assert rows["c"]["p_value"] == 1.0
    assert rows["a"]["fold_errors"] == [0.5, 1.0]
    assert rows["a"]["n_parameters"] == 0
    assert rows["b"]["screen"] == rows["b"]["n_parameters"] == 0
    for name in "bd":  # what fits no better is not held out
        assert np.isnan([rows[name]["error_after"], rows[name]["p_value"]]).all()
        assert rows[name]["fold_errors"] is None


def test_of_variants_those_are_held_out_that_may_matter_and_are_plausible(world):
    """By a tenth of the error, so 0.81 of the sum of squares; of each effect one is completed."""

    def variant(name, error, n_parameters=1):
        return candidate(name, error, cost=error**2, n_parameters=n_parameters)

    few, many = variant("a", 0.85, 2), variant("a", 0.82, 3)
    world.variants = {
        "a": [many, few, variant("a", 0.91), variant("a", 0.3)],
        "b": [variant("b", 0.899), variant("b", 0.75, 3)],  # the best is noticeably better
        "c": [variant("c", 0.5)],
    }
    world.dropped, world.is_right = "c", lambda model, name: model.error != 0.3
    contest = contest_of()
    assert [c.error for c in contest.extended(candidate("", 1.0))] == [0.85, 0.75]
    assert world.completions == [(0.85, 27), (0.75, 27)]
    contest_of(records=contest.records * 2).extended(candidate("", 1.0))  # long ones
    assert world.completions[2:] == [(0.85, 3), (0.75, 3)]


@pytest.mark.parametrize(
    ("errors", "declared", "predicts"),
    [
        ({("line",): 0.99, (): 1.0}, (), True),
        ({("line",): 1.01, (): 1.0}, (), False),
        ({("line",): 1.01, ("declared",): 1.0}, ("declared",), True),
        ({}, (), True),  # no level can be held out
    ],
)
def test_lines_in_a_number_of_the_record_predict_other_numbers(world, errors, declared, predicts):
    """Better than the model without them, where a level can be held out."""
    world.level_errors = errors
    world.variants = {"a": [candidate("a", 0.5, lines=("line",))], "b": [candidate("b", 0.5)]}
    found = contest_of().extended(candidate("", 1.0, lines=declared))
    assert names_of(found) == ["a", "b"][not predicts :]


def test_suspects_would_help_most_but_are_not_in(world):
    world.errors = {"": 1.0, "a": 0.7, "b": 0.95, "d": 0.5, "abd": 0.5}
    contest = contest_of()
    rows = contest.suspects(candidate("", 1.0))
    assert [(row["effect"], row["error_before"], row["error_after"]) for row in rows] == [
        ("d", 1.0, 0.5),
        ("a", 1.0, 0.7),
    ]
    assert [row["folds_better"] for row in rows] == [1, 1]  # the other fold is the same
    assert [row["p_value"] for row in rows] == pytest.approx([3 * 0.01] * 2)
    assert contest.suspects(candidate("abc", 1.0)) == []  # as many as there may be
    assert contest.suspects(candidate("", 1e-3)) == []  # nothing is left
    assert len(contest.suspects(candidate("ab", 1.0))) == 1


def test_claims_are_reported_in_the_order_of_what_they_remove(world):
    """Of three effects the error without each, and without the next, and so on."""
    world.errors = {"abc": 1.0, "ab": 1.5, "bc": 4.0, "ac": 2.0, "b": 6.0, "a": 3.0, "": 9.0}
    contest = contest_after_one_trial(world)
    rows = contest.claims(candidate("abc", 1.0), {"b": ("x",)})
    told = [(r["effect"], r["error_before"], r["error_after"], r["experiment"]) for r in rows]
    assert told == [("a", 9.0, 3.0, ""), ("b", 3.0, 1.5, "record b"), ("c", 1.5, 1.0, "")]
    assert [row["p_value"] for row in rows] == [0.01] * 3
    assert [row["ambiguous_with"] for row in rows] == [(), ("x",), ()]


def test_a_residual_is_judged_once(world):
    judged = []
    contest = contest_of(judge=lambda c: judged.append(c.error) or c.error)
    for error in (1.0, 1.0, 0.5, 1.0):
        assert contest.judgement(candidate("a", error)) == error
    assert judged == [1.0, 0.5]


def test_weights_are_those_of_the_residual_where_the_loss_is_robust(world, monkeypatch):
    monkeypatch.setattr(_contest, "huber_weights", lambda residuals, lost: [np.full(4, 0.5)])
    world.errors, base = {"a": 0.4}, candidate("a", 0.5)
    assert contest_of().weighed(base) is base
    contest = contest_of(lost=[U > 9.0])
    assert contest.weighed(base).error == 0.4
    np.testing.assert_array_equal(contest.records[0].weights, np.full(4, 0.5))


# --------------------------------------------------------------------------------------- it grows


def ends(world, errors, **options):
    world.errors = errors
    return names_of(contest_of(**options).grow(candidate("", 1.0)))


def test_paths_go_on_until_nothing_is_better(world):
    """The best, and the simplest that is not distinguished from it; the ends have no better one."""
    told, world.sizes = [], {"a": 3, "b": 2, "c": 9, "d": 2}
    errors = {"": 1.0, "a": 0.5, "b": 0.6, "c": 0.55, "d": 0.61, "bc": 0.3}
    assert ends(world, errors, report_progress=lambda text, *_: told.append(text)) == ["a", "bc"]
    assert [text for text in told if text][-1].endswith("b + c: held-out error 0.3")
    world.sizes = {}
    assert ends(world, errors) == ["a"]


def test_a_path_begins_with_what_would_be_claimed_at_once(world):
    errors = {"": 1.0, "a": 0.5, "b": 0.7}
    assert ends(world, errors, criterion=Margins(unsure="a"), max_effects=1) == ["a", "b"]


def test_what_responds_to_the_drive_is_added_before_functions_of_time_and_pairs(world):
    structured = {"judge": lambda c: SimpleNamespace(structured=True), "max_effects": 2}
    useless = {"a": 0.99, "b": 0.99}
    world.costs = {"a": 0.4, "b": 0.4}
    assert ends(world, {"a": 0.85, "b": 0.99, "o": 0.1, "ab": 0.8}, **structured) == ["a"]
    assert {effect for effect, before in world.asked if not before} == set(DRIVEN)
    # a function of time alone only where it is significant
    assert ends(world, useless | {"o": 0.4, "ab": 0.1}, **structured) == ["o"]
    assert ends(world, useless | {"o": 0.85, "ab": 0.3}, **structured) == ["ab"]
    assert ends(world, useless | {"o": 0.85, "ab": 0.3}, max_effects=2) == [""]
    assert ends(world, useless | {"o": 0.85, "ab": 0.3}, **structured | {"max_effects": 1}) == [""]
    assert ends(world, {"a": 0.85}, max_effects=0) == [""]
    assert ends(world, {"a": 0.85}, negligible=1.0) == [""]


def test_pairs_are_of_the_three_that_fit_best_with_every_other(world):
    world.costs = {"a": 3.0, "b": 1.0, "c": 4.0, "d": 2.0, "ab": 0.5}
    world.errors = dict.fromkeys(DRIVEN, 1.0) | {"ab": 0.3}
    contest = contest_of(judge=lambda c: SimpleNamespace(structured=not c.effects))
    (found,) = contest.grow(candidate("", 1.0, cost=10.0))
    assert set(found.structure.effects) == set("ab")
    tried = set(world.asked[6:21])
    assert {second for _, second in tried} == {"a", "b", "d"}
    assert len(tried) == 3 * 5
    assert all(first != second for first, second in tried)
    assert contest.n_tried == 4 + 15  # variants, and pairs of six effects


@pytest.mark.parametrize(("right", "error"), [(True, 0.25), (False, 0.5)])
def test_the_resolution_follows_unless_an_effect_loses_its_name(world, monkeypatch, right, error):
    def raised(base, *_):
        return (candidate("a", 0.25) if base.error == 0.5 else base), []

    monkeypatch.setattr(_contest, "raised", raised)
    world.errors, world.is_right = {"a": 0.5}, lambda model, name: right or model.error == 0.5
    assert [c.error for c in contest_of().grow(candidate("", 1.0))] == [error]


@pytest.mark.parametrize("names", ["p", "ap"])
def test_an_effect_that_misleads_hides_nothing_that_is_found_without_it(world, names):
    """What p is beside a, which helps and is not needed, the noise makes; alone it is more."""
    world.errors = {"": 1.0, "a": 0.88, "ap": 0.6, "p": 0.7}
    world.refits = {("ap", "p"): 0.72}
    world.is_noise = lambda model: "p" in model.effects and model.error != 0.7
    contest = contest_of(effects=[e for e in EFFECTS if e.name in names])
    found = contest.found(candidate("", 1.0))
    assert (found.structure.effects, found.error) == (("p",), 0.7)


# ------------------------------------------------------------------------------------ it is pruned


def pruned(world, errors, right=True):
    """Prune the largest model that is known; return the effects that stay, and the removed ones."""
    world.errors, largest = errors, max(errors, key=len)
    world.is_right = lambda model, name: right or len(model.effects) == len(largest)
    contest = contest_after_one_trial(world)
    left = contest.prune(candidate(largest, errors[largest]))
    return "".join(left.structure.effects), "".join(contest.dropped)


def test_what_is_missed_least_goes_first(world):
    assert pruned(world, {"ab": 1.0, "a": 1.05, "b": 1.02, "": 2.0}) == ("b", "a")
    assert pruned(world, {"ab": 1.0, "a": 1.02, "b": 1.05, "": 2.0}) == ("a", "b")
    assert pruned(world, {"ab": 1.0, "a": 2.0, "b": 2.0, "": 2.0}) == ("ab", "")
    assert pruned(world, {"a": 1.0, "": 1.2}) == ("", "a")  # it matters, and is not significant
    assert pruned(world, {"a": 1.0, "": 1.3}) == ("a", "")


def test_effects_that_compensate_for_each_other_are_taken_out_together(world):
    assert pruned(world, {"ab": 1.0, "a": 2.0, "b": 2.0, "": 1.05}) == ("", "ab")
    three = {"abc": 1.0, "ab": 2.0, "bc": 2.0, "ac": 2.0, "a": 3.0, "c": 3.0, "": 4.0}
    assert pruned(world, three | {"b": 1.05}) == ("b", "ac")
    assert pruned(world, three | {"b": 3.0}) == ("abc", "")


def test_an_effect_stays_without_which_another_would_not_be_what_it_is(world):
    assert pruned(world, {"ab": 1.0, "a": 1.02, "b": 1.05, "": 2.0}, right=False) == ("ab", "")
    # not the same without it
    assert pruned(world, {"ab": 1.0, "a": 1.15, "b": 1.05, "": 2.0}, right=False) == ("a", "b")


@pytest.mark.parametrize("rival", ["o", ""])
def test_a_rival_takes_the_place_of_what_the_noise_makes_where_something_is_needed(world, rival):
    world.errors = {"": 1.0, "p": 0.5} | ({"o": 0.45} if rival else {})
    world.is_noise = lambda model: "p" in model.effects
    contest = contest_after_one_trial(world)
    left = contest.prune(candidate("p", 0.5))
    assert (names_of([left]), contest.dropped) == ([rival], ["p"])


@pytest.mark.parametrize(
    ("name", "p_value", "stays"), [("a", 0.9, True), ("o", 0.009, True), ("o", 0.0126, False)]
)
def test_a_function_of_time_is_more_than_the_noise(world, monkeypatch, name, p_value, stays):
    """At the level of all that was tried, here four; a sinusoid also in blocks of samples."""
    monkeypatch.setattr(_contest, "course_p_values", lambda *_: {"o": p_value, "p": 1.0})
    world.errors = dict.fromkeys(("", *DRIVEN), 1.0)
    contest = contest_of()
    contest.extended(candidate("", 1.0))
    assert contest.n_tried == 4

    def is_needed(error):
        return contest.prune(candidate(name, error)).structure.effects == (name,)

    assert is_needed(0.5) == stays
    assert not is_needed(0.95)
    assert is_needed(0.85) == (stays and name == "o")
    monkeypatch.setattr(Model, "part", lambda *_: SinusoidOperator(np.ones(2), np.ones(1)))
    assert not is_needed(0.85)
    assert is_needed(0.5) == stays
    contest.renew = True  # what a black box leaves has a course of the box's own
    assert is_needed(0.5)


# ------------------------------------------------------------------------------------- it is named


def named(world, sizes=(), **errors):
    """Return the name of the effect ``a``, and what it is ambiguous with."""
    world.errors, world.sizes = {"": 1.0} | errors, dict.fromkeys(errors, 3) | dict(sizes)
    world.is_noise = lambda model: model.effects == ("p",)
    world.nested = lambda problem: True
    if "d" in errors:  # it is nested in nothing
        world.nested = lambda problem: False
    contest = contest_of()
    contest.extended(candidate("", 1.0))
    base, ambiguous = contest.named(world.model("a"))
    ((name, others),) = ambiguous.items()
    assert base.structure.effects == (name,)
    return name, "".join(others)


def test_the_name_is_that_of_the_least_error(world):
    assert named(world, a=0.5) == ("a", "")
    assert named(world, a=0.5, b=0.45) == ("b", "a")  # which is not distinguished from it
    assert named(world, a=0.5, b=0.3) == ("b", "")
    assert named(world, a=0.5, b=0.55, c=0.52) == ("a", "cb")
    assert named(world, a=0.5, b=0.45, c=0.48) == ("b", "ca")
    assert named(world, a=0.5, b=0.7) == ("a", "")  # distinguished from it
    assert named(world, a=0.5, b=0.95) == ("a", "")  # no better than nothing
    # a function of time helps no new record
    assert named(world, a=0.5, o=0.46) == ("a", "o")
    assert named(world, a=0.5, b=0.48, o=0.46) == ("b", "oa")
    assert named(world, a=0.5, o=0.44) == ("o", "a")
    assert named(world, a=0.5, o=0.44, sizes={"o": 4}) == ("a", "o")
    assert named(world, a=0.5, o=0.3, sizes={"o": 4}) == ("o", "")
    assert named(world, a=0.5, p=0.45) == ("a", "")  # the noise's own course


def test_a_simpler_name_is_preferred_where_it_is_nested_and_not_rejected(world):
    assert named(world, a=0.5, b=0.55, sizes={"b": 2}) == ("b", "a")
    assert named(world, a=0.5, d=0.55, sizes={"d": 2}) == ("a", "d")  # it is not nested
    assert named(world, a=0.5, b=0.7, sizes={"b": 2}) == ("a", "")  # it is rejected
    assert named(world, a=0.5, b=0.55, c=0.56, sizes={"b": 2, "c": 1}) == ("c", "ab")


def test_an_effect_that_is_not_what_its_name_says_goes_where_a_rival_is(world):
    world.is_right = lambda model, name: name != "a"
    assert named(world, a=0.49) == ("a", "")
    assert named(world, a=0.49, b=0.6) == ("b", "")
    assert named(world, a=0.48, b=0.7) == ("a", "")  # significantly better


def test_names_that_follow_each_other_in_a_circle_are_ambiguous(world, monkeypatch):
    """No set of effects is come to twice, and none is ambiguous with itself."""
    monkeypatch.setattr(_contest, "has_its_name", lambda *_: False)
    assert named(world, a=0.5, b=0.5) == ("a", "b")
