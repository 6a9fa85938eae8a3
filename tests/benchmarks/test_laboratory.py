from functools import partial

import blind_study
import laboratory
import numpy as np
import pandas as pd
import plants
import pytest
from plants import laboratory as lab

from skhyst.datasets.simulation import Plant, first_order, oscillate

PLANT = Plant({"dynamics": (partial(oscillate, frequency=1 / 25, damping=0.1),)})
DRIVE = np.cumsum(np.random.default_rng(0).normal(size=400)) / 20.0


def test_half_of_the_plan_hides_nothing_and_all_of_it_can_be_seen():
    cases = laboratory.plan()
    effects = pd.Series([case.effect for case in cases])
    text = f"{(effects == 'none').sum()} and {(effects != 'none').sum()} with `--plants 7`"
    assert text in " ".join(laboratory.__doc__.split())
    assert len({case.seed for case in cases}) == len(cases)
    for case in cases:
        possible = set(plants.MATRIX[case.declared]) - lab.HABITS[case.kind].hides
        assert case.effect == "none" or case.effect in possible
    kinds = {case.kind for case in cases if case.effect == "none"}
    assert kinds == set(lab.HABITS) == {case.kind for case in cases if case.effect != "none"}


def test_no_plant_is_one_of_the_blind_study():
    others = {case.seed for case in blind_study.plan(blind_study.MOST)}
    for plants_of_each in (1, 100):
        own = {case.seed for case in laboratory.plan(plants_of_each)}
        assert max(others) < min(own)
        assert max(own) < min(case.seed for case in blind_study.plan(first_seed=5001))


def test_a_response_read_late_is_that_of_the_sample_before():
    bench = lab.read(PLANT, DRIVE, lab.Condition())
    np.testing.assert_allclose(bench, PLANT.respond(DRIVE), rtol=1e-12)
    late = lab.read(PLANT, DRIVE, lab.Condition(late=1.0))
    np.testing.assert_allclose(late[1:], bench[:-1], rtol=1e-12)
    early = lab.read(PLANT, DRIVE, lab.Condition(late=-1.0))
    np.testing.assert_allclose(early[:-1], bench[1:], rtol=1e-12)
    fast = lab.read(PLANT, DRIVE, lab.Condition(skew=1.0 / 399.0))
    half = lab.read(PLANT, DRIVE, lab.Condition(late=-0.5))
    assert fast[0] == bench[0]
    assert fast[200] == pytest.approx(half[200], abs=0.01 * np.ptp(bench))


def test_a_held_drive_is_that_of_an_exact_step():
    lag = Plant({"dynamics": (partial(first_order, tau=5.0),)})
    held = lab.read(lag, DRIVE, lab.Condition(hold="step"))
    expected, x = [], DRIVE[0]
    for u in DRIVE:
        expected.append(x)
        x = u + (x - u) * np.exp(-1.0 / 5.0)
    # the edge is a thirty-second of a sample wide
    np.testing.assert_allclose(held, expected, atol=0.01 * np.ptp(DRIVE))


def test_a_sensor_has_the_faults_that_are_asked_for():
    clean = np.sin(np.arange(20_000) / 50.0)

    def noise(**faults):
        return lab.measured(np.random.default_rng(1), clean, 0.01, lab.Condition(**faults)) - clean

    assert noise().std() == pytest.approx(0.01, rel=0.03)
    assert noise(line=2.0).std() == pytest.approx(0.01 * np.sqrt(3.0), rel=0.03)
    off = np.abs(noise(outliers=0.01)) > 0.06
    assert off.mean() == pytest.approx(0.01, rel=0.3)
    steps = (noise(levels=100) + clean) / (np.ptp(clean) / 100)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    slow = noise(colour={"law": "autoregressive", "coefficient": 0.9})
    assert np.corrcoef(slow[1:], slow[:-1])[0, 1] == pytest.approx(0.9, abs=0.03)


@pytest.mark.parametrize("habit", lab.HABITS)
def test_a_recording_is_repeatable_and_as_its_condition_says(habit):
    one, other = (lab.record_in(habit, "lag", "cascade", 3, noise=0.002) for _ in range(2))
    pd.testing.assert_frame_equal(one.X_train, other.X_train)
    pd.testing.assert_series_equal(one.y_train, other.y_train)
    condition = one.truth["condition"]
    records = one.X_train.index.get_level_values("record").unique()
    assert len(records) == condition.records
    assert len(one.X_train) == pytest.approx(condition.n_samples, rel=0.2)
    assert len(one.X_test.index.get_level_values("record").unique()) == 3
    assert one.truth["effect_over_noise"]["lag"] > 0.0
    error = (one.y_train - one.y_train_clean).std() / one.noise_std
    assert error > 0.5
    if condition.period:
        u = one.X_train["drive"].to_numpy()
        turn = np.exp(-2j * np.pi * np.arange(u.size) / condition.period)
        assert abs(turn @ u) == pytest.approx(0.5 * np.abs(u).max() * u.size, rel=0.05)


def test_the_drive_of_a_closed_loop_follows_from_the_response():
    """u = r + g L (r - y): the part of the drive that is no reference carries the noise."""
    noisy, quiet = (
        lab.record_in("closed_loop", "none", "second_order", 5, noise=noise)
        for noise in (0.02, 1e-9)
    )
    drives = [recording.X_train["drive"].to_numpy() for recording in (noisy, quiet)]
    responses = [recording.y_train.to_numpy() for recording in (noisy, quiet)]
    drive, response = (own[0] - own[1] for own in (drives, responses))
    first = noisy.X_train.index.get_level_values("record") == 0
    scale = max(np.abs(part["drive"]).max() for part in (quiet.X_train, quiet.X_test))
    filtered = first_order(response[first], 1.0, lab.SLOWNESS)
    assert np.corrcoef(drive[first], -filtered)[0, 1] > 0.99
    assert np.abs(drive).max() < 0.1 * scale


def test_names_are_false_or_wrong_where_neither_plant_nor_condition_has_them(row):
    rows = [
        row("none", "timing", kind="late"),
        row("none", "lag", "timing|delay", kind="late"),
        row("none", "timing+drift", "+", kind="late"),
        row("none", "timing", kind="bench"),
        row("lag", "timing+lag", "+", kind="late"),
        row("lag", "timing", kind="late"),
        row("lag", "timing+creep", "+resonance", kind="late"),
        row("lag", "timing+creep", "+lag", kind="late"),
        row("lag", kind="late"),
    ]
    table = laboratory.judged(rows)
    assert table["false"].tolist() == [False, False, True, True] + 5 * [False]
    assert table["right"].tolist()[4:] == [True, False, False, True, False]
    assert table["wrong"].tolist()[4:] == [False, False, True, False, False]
    text = laboratory.summary(rows, 0)
    assert "no report" in text
    assert "claims where nothing is missing: 2 of 4" in text
    assert "wrong names: 1 of 5" in text
