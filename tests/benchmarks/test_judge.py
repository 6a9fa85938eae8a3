from contextlib import suppress
from types import SimpleNamespace

import blind_study
import judge
import laboratory
import numpy as np
import pandas as pd
import pytest
import small_inputs
from plants import MATRIX
from plants.laboratory import HABITS
from scipy import stats

from skhyst.diagnosis import effect_names


@pytest.fixture
def row():
    """Return a function that makes a row of the file."""

    def make(case, claimed="", truth="none", suite="blind", **more):
        return {
            **{"suite": suite, "case": case, "plants": "settling", "unit": "noise"},
            **{"truth": truth, "also": "", "asked": "noise", "claimed": claimed},
            **{"ambiguous": "", "p_values": "", "verdict": "noise", "warnings": ""},
            **{"message": "", "effect_over_noise": np.nan, "before": 5.0, "after": 1.0},
            **{"floor": 1.0, "ceiling": np.nan, "refitted": 1.0, "seconds": 1.0},
            **{"processor_seconds": 2.0, **more},
        }

    return make


def right(row):
    return dict(judge.right_of(SimpleNamespace(**row)))


def test_the_plan_is_a_balanced_part_of_the_studies():
    plan = judge.plan()
    assert len(set(plan)) == len(plan)
    plants = [judge.plant_of(search.case) for search in plan if search.suite == "blind"]
    assert set(plants) <= set(blind_study.plan(1, first_seed=0))
    singles = pd.DataFrame([plant for plant in plants if plant.kind == "single"])
    assert sorted(zip(singles["declared"], singles["effect"], strict=True)) == sorted(
        (declared, effect) for declared, effects in MATRIX.items() for effect in effects
    )
    assert np.ptp(singles["noise"].value_counts()) <= 1
    assert {plant.kind for plant in plants} == set(blind_study.KINDS)
    others = pd.DataFrame([plant for plant in plants if plant.kind not in ("single", "unknown")])
    assert (others.value_counts(["kind", "declared"]) == 2).all()
    plants = [judge.plant_of(search.case) for search in plan if search.suite == "laboratory"]
    assert set(plants) <= set(laboratory.plan(1, first_seed=0))
    assert sorted((plant.kind, plant.effect == "none") for plant in plants) == sorted(
        (habit, null) for habit in HABITS for null in (False, True)
    )


def test_settling_and_reported_plants_are_apart_and_more_are_whole_studies():
    settled, reported = ({*judge.plan(plants=1, first_seed=first)} for first in (0, 5000))
    assert {search.suite for search in settled & reported} == {"measured"}
    cases = {judge.plant_of(search.case) for search in reported if search.suite == "blind"}
    assert cases == set(blind_study.plan(1, first_seed=5000))


def test_a_claim_is_right_by_the_truth_of_its_row(row):
    null = {"ended", "right verdict", "not claimed", "no noise where there is more"}
    null |= {"floor at most 1.3"}
    assert right(row("0")) == dict.fromkeys(null, True)
    assert not right(row("0", "lag"))["not claimed"]
    assert right(row("0", "timing", also="timing"))["not claimed"]
    one = right(row("0", "lag", "lag"))
    assert all(one.values())
    assert "not claimed" not in one
    told = right(row("0", "delay", "lag", ambiguous="lag|timing"))
    assert (told["named"], told["or told as ambiguous"], told["no other name"]) == (0, 1, 1)
    more = right(row("0", "lag+drift", "lag", ambiguous="+"))
    assert (more["named"], more["no other name"]) == (1, 0)
    assert not right(row("0", "lag", "lag+drift"))["named"]
    assert right(row("0", "drift+lag", "lag+drift", ambiguous="+"))["named"]
    either = right(row("0", "lag", "creep|lag", ambiguous="resonance"))
    assert either["named"]
    faint = right(row("0", truth="lag", effect_over_noise=1.0))
    assert "named" not in faint


def test_two_effects_are_not_named_by_one_claim(row):
    both = right(row("0", "friction", "friction|backlash+friction|backlash"))
    assert not both["named"]
    assert right(row("0", "friction+backlash", "friction|backlash+friction|backlash"))["named"]


def test_noise_is_no_verdict_where_more_is_left(row):
    left = right(row("0", after=1.4, floor=1.4))
    assert not left["no noise where there is more"]
    assert not left["floor at most 1.3"]
    assert right(row("0", after=1.4, verdict="unexplained"))["no noise where there is more"]
    measured = right(row("0", suite="measured", unit="% of range", after=9.0, floor=9.0, asked=""))
    assert set(measured) == {"ended", "not claimed"}
    unknown = right(row("0", "lag", "unknown", asked="unexplained", verdict="unexplained"))
    assert unknown["right verdict"]
    assert not {"named", "no other name", "not claimed"} & set(unknown)


def test_what_raised_is_right_in_nothing_and_what_was_cut_off_is_not_judged(row):
    raised = right(row("0", truth="lag", verdict="", message="ValueError: no"))
    assert not any(raised.values())
    assert {"named", "right verdict", "ended"} <= set(raised)
    assert right(row("0", truth="lag", verdict="", message="not within 9 s")) == {"ended": False}


def test_the_interval_of_discordant_pairs_is_exact():
    # 8 better, 2 worse: 2 (1 + 10 + 45) / 1024; and the bounds solve the binomial tails for 2.5 %
    share, (low, high), p = judge.discordant(8, 2)
    assert share == 0.8
    assert p == pytest.approx(112 / 1024)
    assert stats.binom.sf(7, 10, low) == pytest.approx(0.025)
    assert stats.binom.cdf(8, 10, high) == pytest.approx(0.025)
    assert judge.discordant(0, 5)[2] == pytest.approx(2 / 32)
    assert judge.discordant(0, 5)[1][1] == pytest.approx(1 - 0.025 ** (1 / 5))
    assert judge.discordant(0, 0)[1:] == ((0.0, 1.0), 1.0)


def test_errors_are_compared_by_their_geometric_mean():
    old = pd.Series([1.0, 2.0, 4.0, np.nan, 1.0, 0.0])
    mean, (low, high), count = judge.ratio(old * [2.0, 2.0, 0.5, 1.0, np.nan, 1.0], old)
    assert count == 3
    assert mean == pytest.approx(2 ** (1 / 3))
    logs = np.log([2.0, 2.0, 0.5])
    test = stats.ttest_1samp(logs, 0.0).confidence_interval(0.95)
    np.testing.assert_allclose([low, high], np.exp(test))


def write(path, rows):
    pd.DataFrame(rows).reindex(columns=judge.COLUMNS).to_csv(path, index=False)
    return str(path)


A, B, GONE = (f"none none bouc_wen 0.002 {seed} 6000" for seed in (1, 2, 3))
C = "single lag bouc_wen 0.002 4 6000"
SMALL = "white_noise; 0"


def test_rows_are_paired_by_suite_and_case(tmp_path, row, capsys):
    old = [row(A), row(B, "lag"), row(SMALL, suite="small"), row(C, "lag"), row(GONE)]
    new = [row(C), row(A, after=2.0), row(B, seconds=9.0), row(SMALL, suite="small")]
    files = [write(tmp_path / name, rows) for name, rows in (("new", new), ("old", old))]
    assert judge.main(["--output", files[0], "--against", files[1]]) == 0
    told = capsys.readouterr().out
    assert "in one of the files alone, not compared: 1 rows" in told
    assert "changed: 3 of 4 rows" in told
    assert f"blind {A}: after 1 -> 2\n" in told
    assert f"blind {B}: claimed lag -> -\n" in told
    assert f"blind {C}: claimed lag -> -\n" in told
    assert SMALL not in told
    blind = told[told.index("blind, 3 rows") : told.index("small, 1 rows")]
    assert "1 ->    0 of 1; better 0, worse 1: share 0.00 (0.00 to 0.97), p = 1" in blind
    assert "1 ->    2 of 2; better 1, worse 0: share 1.00 (0.03 to 1.00), p = 1" in blind
    assert f"x {2 ** (1 / 3):.4f}" in blind
    assert "all suites, 4 rows" in told
    assert "no row differs" not in told


def test_seconds_are_no_difference(tmp_path, row, capsys):
    old = [row(A), row(B, message="not within 9 s", after=np.nan, before=np.nan)]
    new = [{**part, "seconds": 7.0, "processor_seconds": 8.0} for part in old]
    files = [write(tmp_path / name, rows) for name, rows in (("new", new), ("old", old))]
    judge.main(["--output", files[0], "--against", files[1]])
    told = capsys.readouterr().out
    assert told.endswith("no row differs\n")
    assert "x 4.0000" in told
    write(files[1], old[:1])
    judge.main(["--output", files[0], "--against", files[1]])
    assert capsys.readouterr().out.endswith("no row that both have differs\n")


def test_what_the_clock_has_cut_off_is_no_difference(tmp_path, row, capsys):
    old, new = [row(A), row(B)], [row(A), row(B, message="not within 9 s", after=np.nan)]
    files = [write(tmp_path / name, rows) for name, rows in (("new", new), ("old", old))]
    judge.main(["--output", files[0], "--against", files[1]])
    told = capsys.readouterr().out
    assert "rows not compared: 1\n" in told
    assert told.endswith("no row differs\n")
    assert "worse 1" in next(line for line in told.splitlines() if line.startswith("  ended"))


def test_the_truth_is_that_of_the_judge_not_of_the_file(tmp_path, row):
    table = judge.read(write(tmp_path / "rows", [row(C, "lag", "creep", also="drift")]))
    assert table.loc[0, ["truth", "also", "named"]].tolist() == ["lag", "", 1.0]


def test_a_file_with_other_columns_is_refused(tmp_path, row):
    path = tmp_path / "rows.csv"
    pd.DataFrame([{**row(A), "colour": "red"}]).to_csv(path, index=False)
    with pytest.raises(
        ValueError, match=r"columns of .* are not those of these rows: \['colour'\]"
    ):
        judge.read(path)
    with pytest.raises(ValueError, match="columns"):
        judge.main(["--output", str(path), "--suites", "small", "--only", "white"])


def test_a_stopped_run_goes_on_where_it_ended(tmp_path, monkeypatch, capsys):
    searched = []

    def known(case, data):
        searched.append(case)
        return {"claimed": "", "verdict": "noise", "before": 1 / 3, "after": 1.0, "seconds": 0.1}

    monkeypatch.setattr(judge, "_small", known)
    path = tmp_path / "rows.csv"
    options = ["--output", str(path), "--suites", "small"]
    judge.main([*options, "--only", "white_noise"])
    assert searched == ["white_noise; 0", "white_noise; 1"]
    judge.main([*options, "--only", "noise; 1"])
    assert searched[2:] == ["autoregressive_noise; 1", "flicker_noise; 1"]
    assert "1 of 3 plants are in" in capsys.readouterr().out
    table = judge.read(path)
    assert list(table["case"]) == searched
    assert set(table["before"]) == {0.333333}
    assert set(table["plants"]) == {"settling"}


def test_recordings_that_are_absent_are_left_out(tmp_path, monkeypatch, capsys):
    searched = []
    monkeypatch.setattr(judge, "_measured", lambda case, data: searched.append(case) or {})
    (tmp_path / "mr_damper").mkdir()
    judge.main(["--suites", "measured", "--data", str(tmp_path)])
    assert searched == ["mr_damper", "mr_damper_currents", "mr_damper_currents" + judge.FIRST_ALONE]
    assert "left out, absent from" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        judge.main(["--suites", "measured", "--data", str(tmp_path / "mr_damper")])
    assert "no rows are left" in capsys.readouterr().err


def test_a_row_that_takes_too_long_says_only_that(monkeypatch):
    def endless(case, data):
        while True:
            with suppress(Exception):  # as a search survives its candidates
                sum(range(1000))

    monkeypatch.setattr(judge, "_small", endless)
    found = judge.row_of(judge.Search("small", "white_noise; 5000"), 5000, 0.05, None)
    assert found["message"] == "not within 0.05 s"
    assert found["plants"] == "reported"
    assert not {"verdict", "after"} & {name for name, value in found.items() if value}


def test_a_search_that_raises_is_a_row(monkeypatch):
    def broken(case, data):
        raise ValueError("no")

    monkeypatch.setattr(judge, "_measured", broken)
    found = judge.row_of(judge.Search("measured", "piezo_afm"), 0, 9.0, None)
    assert found["message"] == "ValueError: no"
    assert found["truth"] == "asymmetry"


@pytest.mark.parametrize("name", small_inputs.CASES)
def test_what_is_known_of_a_small_input_is_of_the_library(name):
    case = small_inputs.CASES[name]
    known = {*effect_names(), "none", "unknown", ""}
    assert {*case.truth.replace("+", "|").split("|"), *case.also.split("|")} <= known
    assert {*case.verdict.split("|")} <= {"noise", "unexplained", "undetermined", ""}
    (X, y, noise), (_, y_test, _) = small_inputs.records(name, 0)
    assert len(X) == len(y)
    assert 0.0 < noise < 0.02 * np.ptp(y)
    assert not np.array_equal(y, y_test)


def test_small_devices_follow_their_equations():
    u = np.array([0.0, 1.0, 2.0, 1.5, -1.0])
    np.testing.assert_allclose(
        small_inputs.plays(u, np.array([0.5]), np.ones(1)), [0, 0.5, 1.5, 1.5, -0.5]
    )
    np.testing.assert_allclose(small_inputs.stop(u, 0.5), [0, 0.5, 0.5, 0, -0.5])
    step = np.r_[0.0, np.ones(50)]
    expected = np.r_[0.0, 1.0 - np.exp(-np.arange(1, 51) / 7.0)]
    np.testing.assert_allclose(small_inputs.lag(step, 7.0), expected, atol=1e-12)


def test_a_small_mass_swings_rests_and_sticks():
    frequency, damping = 20.0, 0.1
    step = np.r_[0.0, np.ones(200)]
    y = small_inputs.mass(step, frequency, damping)
    w, t = 2 * np.pi * frequency, small_inputs.STEP * np.arange(-0.5, 200)  # a ramp of one sample
    free = w * np.sqrt(1 - damping**2)
    swing = np.exp(-damping * w * t) * (np.cos(free * t) + damping * w / free * np.sin(free * t))
    np.testing.assert_allclose(y[1:], (1.0 - swing)[1:], atol=0.01)
    held = small_inputs.mass(np.r_[0.0, np.full(50, 0.3)], frequency, damping, dry=0.31)
    np.testing.assert_array_equal(held, 0.0)
    rest = small_inputs.mass(np.full(50, 1.3), frequency, damping, cubic=0.3)
    np.testing.assert_allclose(rest, 1.0, rtol=1e-9)  # x + 0.3 x^3 = 1.3
