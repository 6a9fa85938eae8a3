from functools import partial

import blind_study
import laboratory
import numpy as np
import pandas as pd
import plants
import pytest
from plants import effects, further_forms, motion, other_laws, recording
from plants import laboratory as lab
from scipy.special import gamma

from skhyst.datasets.simulation import Plant, first_order, oscillate, plays

pytestmark = pytest.mark.slow

PLANT = Plant({"dynamics": (partial(oscillate, frequency=1 / 25, damping=0.1),)})
DRIVE = np.cumsum(np.random.default_rng(0).normal(size=400)) / 20.0


def test_half_of_the_plan_hides_nothing_and_all_of_it_can_be_seen():
    cases = laboratory.plan()
    effects = pd.Series([case.effect for case in cases])
    text = f"{(effects == 'none').sum()} and {(effects != 'none').sum()} with `--plants 7`"
    assert text in " ".join(laboratory.__doc__.split())
    assert len({case.seed for case in cases}) == len(cases)
    nulls, others = (laboratory.plan(hiding=which) for which in ("nothing", "effects"))
    assert sorted(nulls + others) == sorted(cases)
    assert {case.effect for case in nulls} == {"none"}
    for case in cases:
        hidden = set(case.effect.split("+")) - {"none"}
        habit = lab.HABITS[case.kind]
        assert hidden <= set(habit.matrix[case.declared]) - habit.hides
        assert len(hidden) <= 1 + (case.kind == "unequal_pair")
        assert hidden <= set(other_laws.LAWS) or case.kind != "other_laws"
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
    one = lab.record_in(habit, "lag", "cascade", 3, noise=0.002)
    if habit in ("bench", "closed_loop"):
        other = lab.record_in(habit, "lag", "cascade", 3, noise=0.002)
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


def test_both_of_two_are_named_by_a_claim_each(row):
    rows = [
        row("lag+drift", "lag+drift", "+", kind="unequal_pair"),
        row("lag+drift", "drift+slew_limit", "+lag", kind="unequal_pair"),
        row("lag+drift", "lag", "drift", kind="unequal_pair"),
        row("lag+drift", "lag", kind="unequal_pair"),
        row("lag+drift", "lag+creep", "+", kind="unequal_pair"),
        row("lag+drift", "lag+drift+creep", "++", kind="unequal_pair"),
    ]
    table = laboratory.judged(rows)
    assert table["right"].tolist() == [True, True, False, False, False, True]
    assert table["wrong"].tolist() == [False, False, False, False, True, False]
    assert not table["null"].any()
    assert not table["false"].any()


@pytest.mark.parametrize(
    ("pair", "declared"),
    [
        (("lag", "output_saturation"), "prandtl_ishlinskii"),
        (("output_saturation", "creep"), "bouc_wen"),
        (("resonance", "asymmetry"), "cascade"),
    ],
)
def test_one_of_two_is_a_tenth_of_the_other_and_shows(pair, declared):
    recorded = lab.record_in("unequal_pair", pair, declared, 11, noise=0.0005)
    large, small = (recorded.truth["effect_over_noise"][name] for name in pair)
    assert small > 2.0
    wanted = max(0.1 * large, lab.SHOWING)
    assert small / wanted == pytest.approx(1.0, rel=0.25)


@pytest.mark.parametrize("name", effects.WEAKENED)
def test_what_is_weakened_fades(name):
    kind = next(i for i, d in enumerate(plants.BASES) if name in plants.MATRIX[d])
    plant, setting, *_ = recording.draw_plant(3, kind, 1500, 8, False, spread=True)
    bare = recording.respond(plant, [], setting)
    sizes = [
        recording.change(
            recording.put_in(np.random.default_rng(0), [name], plant, setting, last=last)[1], bare
        )
        for last in (1.0, 0.1, 0.01)
    ]
    assert sizes[2] < 0.5 * sizes[1] < 0.25 * sizes[0]


# ------------------------------------------------------------------------------------ other laws


STEP = 1 / 32
FINE = np.interp(STEP * np.arange(3201), np.arange(101), DRIVE[:101])
SETTING = plants.Setting((-2.0, 1.0), (-1.0, 1.0), (-0.9, 1.1), (1000,) * 8, 0.0, 0.001, 1.0)


def test_plays_without_a_rate_are_plain_and_with_it_follow_the_filtered_one():
    thresholds, weights = np.array([0.0, 0.1, 0.4]), np.array([1.0, 0.5, 0.5])
    u, step = FINE, STEP
    plain = other_laws.rate_plays(u, step, thresholds, weights, 0.0, 0.0, 0.0, 5.0, True)
    np.testing.assert_allclose(plain, plays(u, step, thresholds, weights), atol=1e-12)
    at_once = plays(u, step, thresholds, weights, stretch=0.5, widening=0.2)
    known = other_laws.rate_plays(u, step, thresholds, weights, 0.5, 0.2, 0.0, 0.0, False)
    assert np.std(known - at_once) < 0.01 * np.std(at_once - plain)
    # a ramp that has gone on for long: the rate is the ramp's, and each play its slack behind
    ramp = 0.3 * step * np.arange(20_000)
    for signed in (True, False):
        y = other_laws.rate_plays(ramp, step, thresholds, weights, 0.5, 0.2, 0.1, 20.0, signed)
        slack = thresholds * 1.15 + 0.06 * (thresholds > 0.0)
        wide = weights * (1.0 + 0.03 * (thresholds > 0.0))
        assert y[-1] == pytest.approx(wide @ (ramp[-1] - slack), rel=1e-6)


def test_creep_of_a_ramp_is_the_integral_of_the_compliance():
    """Of the logarithm by hand, of a power by the gamma function."""
    step, n = 1 / 32, 6401
    ramp = step * np.arange(n)
    t = ramp[-1]
    power = partial(other_laws.by_power, size=0.05, exponent=0.3)
    y = other_laws.slow_step(ramp, step, power, 1000.0)
    fractional = 0.05 * gamma(1.3) * t**1.3 / gamma(2.3)
    assert y[-1] - t == pytest.approx(fractional, rel=1e-4)
    decades = partial(other_laws.by_logarithm, decade=0.05, shortest=3.0)
    y = other_laws.slow_step(ramp, step, decades, 1000.0)
    integral = 0.05 / np.log(10.0) * ((3.0 + t) * np.log1p(t / 3.0) - t)
    assert y[-1] - t == pytest.approx(integral, rel=1e-4)
    rest = other_laws.slow_step(np.full(500, 2.0), step, decades, 1000.0)
    np.testing.assert_allclose(rest, 2.0 + 2.0 * decades(1000.0))


@pytest.mark.parametrize("name", ["output_saturation", "input_saturation"])
def test_what_saturates_is_smooth_and_levels_off(name):
    low, high = SETTING.settled if name == "output_saturation" else SETTING.drive
    x = np.linspace(low, high, 2001)
    for seed in range(10):
        effect = other_laws.LAWS[name](np.random.default_rng(seed), SETTING)
        slope = np.diff(effect.stage(x, 1.0)) / np.diff(x)
        assert slope.max() == pytest.approx(1.0, abs=1e-5)
        assert slope.min() >= 0.0
        assert max(slope[0], slope[-1]) < 0.15
        assert np.abs(np.diff(slope)).max() < 0.01


def test_a_sensor_bends_and_its_slope_at_zero_is_one():
    x = np.linspace(-1, 1, 2001)
    for seed in range(10):
        law = other_laws.LAWS["static_nonlinearity"](np.random.default_rng(seed), SETTING).stage
        slope = np.diff(law(x, 1.0)) / np.diff(x)
        assert slope.min() > 0.0
        assert slope[1000] == pytest.approx(1.0, abs=0.01)
        assert 0.1 < np.abs(law(x, 1.0) - x).max() < 0.6


def test_an_elastic_play_follows_its_equation():
    """tau y' is the way beyond the slack; with stiff ends it is a play."""
    u, step = FINE, STEP
    y = other_laws.elastic_play(u, step, 0.1, 0.5)
    way = 0.5 * (u[1:] + u[:-1]) - 0.5 * (y[1:] + y[:-1])
    beyond = np.sign(way) * np.maximum(np.abs(way) - 0.1, 0.0)
    assert np.std(0.5 * np.diff(y) / step - beyond) < 0.02 * np.std(beyond)
    stiff = other_laws.elastic_play(u, step, 0.1, 1e-4)
    np.testing.assert_allclose(stiff, plays(u, step, [0.1], [1.0]), atol=0.01 * np.ptp(u))


def test_a_second_spring_acts_beyond_its_gap():
    step = 1 / 16
    drive = 0.8 * np.sin(2 * np.pi * step * np.arange(8000) / 60)
    path = motion.stopped_mode(drive, step, 1 / 40, 0.1, 0.3, 0.7)
    w, x = 2 * np.pi / 40, path[1:-1]
    v, a = (path[2:] - path[:-2]) / (2 * step), (path[2:] - 2 * x + path[:-2]) / step**2
    left = drive[1:-1] - x - 0.2 / w * v - a / w**2
    expected = 0.7 * np.sign(x) * np.maximum(np.abs(x) - 0.3, 0.0)
    np.testing.assert_allclose(left, expected, atol=2e-3)


def test_stops_push_and_damp_beyond_their_places():
    step = 1 / 64
    drive = 0.9 * np.sin(2 * np.pi * step * np.arange(32_000) / 60)
    path = further_forms.knocking_mode(drive, step, 1 / 40, 0.1, -0.5, 0.3, 6.0, 0.4)
    w, x = 2 * np.pi / 40, path[1:-1]
    v, a = (path[2:] - path[:-2]) / (2 * step), (path[2:] - 2 * x + path[:-2]) / step**2
    left = drive[1:-1] - x - 0.2 / w * v - a / w**2
    beyond = x - np.clip(x, -0.5, 0.3)
    expected = 6.0 * beyond + 0.8 / w * v * (beyond != 0.0)
    jump = np.convolve(np.diff(beyond != 0.0, prepend=False), np.ones(3), "same") > 0
    np.testing.assert_allclose(left[~jump], expected[~jump], atol=2e-2)
    assert np.abs(expected).max() > 0.3


@pytest.mark.parametrize("curve", [1, 2])
def test_falls_of_the_friction_differ_and_end_alike(curve):
    v = np.linspace(0.0, 3.0, 7)
    part = {1: np.exp(-v), 2: 1.0 / (1.0 + v**2)}[curve]
    level = [motion._stribeck(one, 0.2, 0.1, 1.0, curve) for one in v]
    np.testing.assert_allclose(level, 0.1 + 0.1 * part)


@pytest.mark.parametrize("habit", ["other_laws", "further_forms"])
def test_effects_of_other_laws_show_and_none_is_that_of_the_study(habit):
    """Each effect in one of the plants that can have it."""
    possible = lab.HABITS[habit].possible
    in_plant = {effect: declared for declared in plants.BASES for (effect,) in possible(declared)}
    for effect, declared in in_plant.items():
        other = lab.record_in(habit, effect, declared, 1, noise=0.0005)
        assert np.isfinite(np.concatenate([other.y_train, other.y_test])).all(), effect
        assert 2.0 < other.truth["effect_over_noise"][effect] < 400.0, effect
        if effect not in plants.EFFECTS:
            continue
        usual = lab.record_in("bench", effect, declared, 1, noise=0.0005)
        np.testing.assert_array_equal(other.X_train["drive"], usual.X_train["drive"], effect)
        assert (other.y_train - usual.y_train).std() > 3.0 * other.noise_std, effect
