from itertools import pairwise

import blind_study
import numpy as np
import pandas as pd
import plants
import pytest
from blind_study import Case, judge, main, plan, read_rows, run, summary


def test_plan_holds_what_the_study_asks_for():
    cases = plan()
    assert len(set(cases)) == len(cases)
    counts = pd.Series([case.kind for case in cases]).value_counts()
    others = {"none": 200, "none_coloured": 100, "two": 60, "unknown": 40}
    assert counts.to_dict() == {"single": 15 * sum(map(len, plants.MATRIX.values())), **others}
    assert f"{len(cases)} plants with" in blind_study.__doc__
    assert {case.effect for case in cases if case.kind == "unknown"} == set(plants.UNKNOWN)
    assert {case.effect for case in cases if case.kind == "single"} == set(plants.EFFECTS)
    for kind in others:
        some = [case for case in cases if case.kind == kind]
        assert {case.declared for case in some} == set(plants.BASES)
        assert {case.noise for case in some} == set(blind_study.NOISES)
    for structure in plants.UNKNOWN:
        assert len({case.noise for case in cases if case.effect == structure}) == 3


@pytest.mark.slow
def test_no_plant_belongs_to_two_studies(row):
    """As many plants as there may be, of studies beside each other and at the ends."""
    settling, reported = blind_study.SETTLING_SEEDS, blind_study.REPORTED_SEEDS
    used = [
        {case.seed for case in plan(blind_study.MOST, first_seed=first)}
        for first in (settling[-1], reported[0], reported[1], reported[-1])
    ]
    assert max(used[0] | {case.seed for case in plan(first_seed=0)}) < min(used[1])
    assert all(max(a) < min(b) for a, b in pairwise(used))
    assert max(used[-1]) < 2**32
    assert len(plan()) == len(plan(first_seed=0))
    for options in ({"first_seed": 1000}, {"first_seed": -1}, {"plants": 0}, {"plants": 101}):
        with pytest.raises(ValueError, match="must be"):
            plan(**options)
    assert "reported on those of 5000" in summary([row("lag")])
    assert "no report" in summary([row("lag")], first_seed=3)


def test_plants_of_earlier_studies_are_found_again():
    """Seeds to settle on are those that the recordings of all versions were made from."""
    cases = plan(1, first_seed=7)
    assert Case("single", "lag", "cascade", 0.002, 3107, 6000) in cases
    assert Case("none", "none", "cascade", 0.0005, 100_008, 6000) in cases
    assert next(case.seed for case in cases if case.kind == "two") == 200_007


def test_a_part_of_the_plan_is_a_part():
    assert set(plan(2, [0.002], ["two", "single"])) <= set(plan())


@pytest.mark.parametrize(
    ("claimed", "ambiguous", "right", "told"),
    [
        ("lag", "", True, True),
        ("lag+creep", "+", True, True),
        ("creep", "lag|delay", False, True),
        ("creep+lag", "delay+", False, False),
        ("", "", False, False),
    ],
)
def test_the_first_claim_counts(claimed, ambiguous, right, told, row):
    (judged,) = judge([row("lag", claimed, ambiguous)]).itertuples()
    assert judged.right == right
    assert judged.right_or_ambiguous == told


@pytest.mark.parametrize(
    ("claimed", "ambiguous", "right", "told"),
    [
        ("lag+drift", "+", True, True),
        ("drift+lag+offset", "++", True, True),
        ("drift+creep", "+lag", False, True),
        ("creep", "lag|drift", False, False),
        ("lag", "", False, False),
    ],
)
def test_both_effects_count_in_any_order(claimed, ambiguous, right, told, row):
    (judged,) = judge([row("lag+drift", claimed, ambiguous, "two")]).itertuples()
    assert judged.all == right
    assert judged.all_or_ambiguous == told


def test_summary_prints_each_figure_beside_its_bar(row):
    rows = [
        row("lag", "lag"),
        row("lag", "creep", "lag"),
        row("lag", "", effect_over_noise=1.0, after=1.3),
        row("none", kind="none", effect_over_noise=np.nan),
        row("none", "auxiliary_input", kind="none", column="temperature"),
        row("none", kind="none_coloured", after=1.2),
        row("lag+drift", "drift+lag", "+", "two"),
        row("switching_gain", kind="unknown", verdict="unexplained", after=3.0),
        row("drift", named="error", verdict="", after=np.nan, before=np.nan, message="ValueError"),
    ]
    text = summary(rows)
    assert "0.2 % noise, strict: 1 of 3 = 33.3 % (at least 98 %: MISSED)" in text
    assert "or told as ambiguous: 2 of 3 = 66.7 %" in text
    assert "fainter effects, not judged: 0 of 1 named rightly, 1 not claimed" in text
    assert "both of two effects named: 1 of 1 = 100.0 % (at least 92 %: kept)" in text
    assert "claims where nothing is missing: 1 of 3 = 33.3 % (at most 0.333 %: MISSED)" in text
    assert "white noise: 1 of 2 = 50.0 % (at most 0.333 %: MISSED)" in text
    assert "coloured noise, drives repeated: 0 of 1 = 0.0 % (at most 0.333 %: kept)" in text
    assert "claims of an idle column, in all plants that carry one: 1 of 1" in text
    assert "called unexplained: 1 of 1 = 100.0 % (at least 95 %: kept)" in text
    assert "within 1.10: 5 of 7 = 71.4 % (at least 95 %: MISSED)" in text
    assert "searches that raised: 1 of 9" in text
    assert "not as asked: 4 of 9" in text


def test_a_stopped_study_goes_on_where_it_ended(tmp_path, monkeypatch, capsys, row):
    searched = []

    def study(case):
        searched.append(case)
        found = row(case.effect, "" if case.effect == "none" else case.effect)
        return {**found, **case._asdict()}

    monkeypatch.setattr(blind_study, "study", study)
    path = tmp_path / "rows.csv"
    options = ["--jobs", "1", "--plants", "1", "--only", "lag,none", "--output", str(path)]
    main([*options, "--kinds", "single"])
    first = list(searched)
    assert len(first) == 12
    main(options)
    assert len(searched) == len(set(searched)) == 12 + 60
    cases = [case for case in plan(1) if case.effect in ("lag", "none")]
    assert set(read_rows(path, cases)) == set(cases) == set(searched)
    capsys.readouterr()
    main(options)
    assert len(searched) == 72
    assert "first effect named rightly" in capsys.readouterr().out
    assert list(run(cases, 1, limit=-1.0)) == []


def test_a_search_that_fails_is_a_row(monkeypatch):
    def fail(*_):
        raise ValueError("no")

    monkeypatch.setattr(blind_study, "search", fail)
    found = blind_study.study(Case("single", "lag", "second_order", 0.002, 0, 1500))
    assert found["named"] == "error"
    assert found["message"] == "ValueError: no"
    assert "FAILED" in summary([found])


def test_models_that_are_not_fitted_again_are_counted(row):
    errors = 0.99, 1.0, 1.009, 1.02, float("nan")
    rows = [row("lag", "lag", refitted=error) for error in errors]
    (told,) = [text for text in summary(rows).splitlines() if text.startswith("fitted again")]
    assert "3 of 4" in told
