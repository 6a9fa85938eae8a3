import ast
import dataclasses
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
import plants
import pytest
from blind_study import declared_model
from plants import (
    BASES,
    MATRIX,
    UNKNOWN,
    Plant,
    effect_pairs,
    make_recording,
    motion,
    physics,
    signals,
    unknown_structures,
)

SHORT = 2000


def records(frame):
    return [part.to_numpy().ravel() for _, part in frame.groupby(level="record")]


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def plant_of_plays(thresholds, weights):
    parameters = {"thresholds": np.array(thresholds), "weights": np.array(weights)}
    return Plant(core=(partial(physics.play_bank, **parameters),))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def draw_setting(**changes):
    setting = plants.Setting(
        drive=(-50.0, 50.0),
        response=(-1.0, 1.0),
        settled=(-1.0, 1.0),
        lengths=(1000,) * 8,
        mode=0.0,
        dt=0.001,
        unit=1.0,
    )
    return dataclasses.replace(setting, **changes)


def test_plants_share_no_code_with_the_package():
    trees = [ast.parse(path.read_text()) for path in Path(plants.__file__).parent.glob("*.py")]
    assert len(trees) > 5
    imported = {
        name.split(".")[0]
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.Import) or (isinstance(node, ast.ImportFrom) and not node.level)
        for name in (
            [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
        )
    }
    assert imported <= {"collections", "dataclasses", "functools", "numba", "numpy", "pandas"}


# ------------------------------------------------------------------------------------- signals


@pytest.mark.parametrize("signal", plants.SIGNALS)
@pytest.mark.parametrize("seed", range(5))
def test_signal_peaks_at_one_and_is_well_sampled(signal, seed):
    drive = signal(4000, np.random.default_rng(seed))
    assert drive.shape == (4000,)
    assert np.abs(drive).max() == pytest.approx(1.0)
    # The fastest edge crosses the full range in no less than two samples.
    assert np.abs(np.diff(drive)).max() < 1.0
    assert np.unique(drive).size > 20


@pytest.mark.parametrize("signal", [signals.multisine, signals.band_limited_noise])
def test_band_ends_at_a_thirtieth_of_the_sampling_rate(signal, rng):
    drive = signal(8000, rng) * np.hanning(8000)
    power = np.abs(np.fft.rfft(drive)) ** 2
    above = np.fft.rfftfreq(8000) > 1 / 29
    assert power[above].sum() < 1e-6 * power.sum()


def test_refined_drive_is_the_piecewise_linear_one(rng):
    drive = rng.standard_normal(20)
    fine = physics.refine(drive, 8)
    np.testing.assert_array_equal(fine[::8], drive)
    slopes = np.diff(fine).reshape(-1, 8) * 8
    np.testing.assert_allclose(slopes, np.repeat(np.diff(drive)[:, None], 8, axis=1), atol=1e-12)


# ------------------------------------------------------------------------------------- physics


def test_plays_follow_the_virgin_curve_and_the_main_loop():
    up = np.linspace(0, 2, 201)
    drive = np.concatenate([up, up[-2::-1]])
    out = physics.plays(drive, np.array([0.5]), np.ones(1))
    np.testing.assert_allclose(out[:201], np.maximum(up - 0.5, 0), atol=1e-14)
    np.testing.assert_allclose(out[201:], np.minimum(1.5, up[-2::-1] + 0.5), atol=1e-14)


@pytest.mark.parametrize("first", [-1.0, 0.3, 2.0])
def test_plays_start_as_if_loaded_for_the_first_time(first):
    thresholds, weights = np.array([0.0, 0.2, 0.7]), np.array([1.0, 0.5, 0.2])
    ramp = physics.plays(np.linspace(0, first, 50), thresholds, weights)
    assert physics.plays(np.array([first]), thresholds, weights)[0] == pytest.approx(ramp[-1])


def test_play_operators_are_rate_independent(rng):
    plant = plant_of_plays([0.0, 0.1, 0.4], [0.5, 0.3, 0.2])
    drive = rng.uniform(-1, 1, 100)
    slow = np.interp(np.arange(496) / 5, np.arange(100), drive)
    np.testing.assert_allclose(plant.respond(slow)[::5], plant.respond(drive), atol=1e-12)


def test_first_order_matches_the_exact_ramp_response():
    tau, step = 5.0, 1 / 16
    t = step * np.arange(2000)
    exact = t - tau * (1 - np.exp(-t / tau))
    np.testing.assert_allclose(physics.first_order(t, step, tau), exact, atol=1e-6)


def test_second_order_matches_the_exact_ramp_response():
    frequency, damping, step = 1 / 20, 0.1, 1 / 16
    w = 2 * np.pi * frequency
    wd, sigma = w * np.sqrt(1 - damping**2), damping * w
    t = step * np.arange(4000)
    # x = t - 2z/w + e^(-sigma t) (a cos wd t + b sin wd t), x(0) = x'(0) = 0
    a = 2 * damping / w
    b = (sigma * a - 1) / wd
    exact = t - a + np.exp(-sigma * t) * (a * np.cos(wd * t) + b * np.sin(wd * t))
    np.testing.assert_allclose(
        physics.second_order(t, step, frequency, damping), exact, rtol=0, atol=1e-5
    )


@pytest.mark.parametrize(
    "law",
    [
        lambda u, h: physics.first_order(u, h, 7.0),
        lambda u, h: physics.second_order(u, h, 1 / 25, 0.05),
    ],
)
def test_dynamics_settle_at_the_drive(law):
    drive = np.concatenate([np.full(10, -0.4), np.full(20_000, 1.7)])
    out = law(drive, 0.25)
    np.testing.assert_allclose(out[:10], -0.4, atol=1e-14)
    assert out[-1] == pytest.approx(1.7, abs=1e-9)
    assert np.abs(np.diff(out)).max() < 0.5


def test_creep_creeps_to_its_settled_share_at_rest():
    taus, compliances = np.array([3.0, 40.0]), np.array([0.1, 0.2])
    step = np.concatenate([np.zeros(2), np.ones(4000)])
    out = physics.kelvin_voigt(step, 0.25, taus, compliances)
    assert out[2] == pytest.approx(1.0, abs=0.01)  # the elastic part is immediate
    assert out[-1] == pytest.approx(1.3, abs=1e-6)
    remaining = 1.3 - out[2:]
    assert np.all(np.diff(remaining[:2000]) < 0)
    # The slow unit is alone in the end and decays by its own time constant.
    assert remaining[1200] / remaining[1360] == pytest.approx(np.e, rel=1e-3)


def test_delayed_plant_is_the_shifted_plant(rng):
    base = plant_of_plays([0.0, 0.2], [0.6, 0.4])
    drive = np.interp(np.arange(400), np.arange(0, 401, 20), rng.uniform(-1, 1, 21))
    whole = base.insert("dynamics", lambda u, h: physics.pure_delay(u, h, 3.0))
    np.testing.assert_allclose(whole.respond(drive)[3:], base.respond(drive)[:-3], atol=1e-12)
    part = base.insert("dynamics", lambda u, h: physics.pure_delay(u, h, 2.5))
    fine = base.respond(physics.refine(drive, 2))
    np.testing.assert_allclose(part.respond(drive)[3:], fine[1:-4:2][: 400 - 3], atol=1e-12)


def test_bouc_wen_follows_the_closed_form_of_its_virgin_curve():
    limit = 0.3
    drive = np.linspace(0, 2, 400)
    out = physics.bouc_wen(drive, 0.1, 2.0, 0.4, limit, 0.7, 1.0)
    expected = 2.0 * (drive - 0.4 * limit * (1 - np.exp(-drive / limit)))
    np.testing.assert_allclose(out, expected, atol=1e-9)


FREQUENCY, DAMPING, STEP = 1 / 40, 0.1, 1 / 16


def force_balance(x, drive):
    """Return what the equation of motion lacks: drive - x - 2 z x' / w - x'' / w^2."""
    w = 2 * np.pi * FREQUENCY
    v = (x[2:] - x[:-2]) / (2 * STEP)
    a = (x[2:] - 2 * x[1:-1] + x[:-2]) / STEP**2
    return drive[1:-1] - x[1:-1] - 2 * DAMPING / w * v - a / w**2, x[1:-1], v


class TestEquationsOfMotion:
    drive = 0.8 * np.sin(2 * np.pi * STEP * np.arange(8000) / 60)

    def test_cubic_spring(self):
        x = motion.cubic_mode(self.drive, STEP, FREQUENCY, DAMPING, 0.2)
        force, x, _ = force_balance(x, self.drive)
        np.testing.assert_allclose(force, 0.2 * x**3, atol=2e-4)

    @pytest.mark.parametrize("static", [0.1, 0.16])
    def test_coulomb_friction(self, static):
        x = motion.coulomb_mode(self.drive, STEP, FREQUENCY, DAMPING, static, 0.1, 0.02)
        force, _, v = force_balance(x, self.drive)
        moving = np.abs(v) > 0.005
        expected = 0.1 + (static - 0.1) * np.exp(-((v / 0.02) ** 2))
        np.testing.assert_allclose(force[moving], (np.sign(v) * expected)[moving], atol=2e-3)
        assert np.abs(force).max() < 1.01 * static

    def test_it_sticks_below_the_static_level(self):
        x = motion.coulomb_mode(0.1 * self.drive, STEP, FREQUENCY, DAMPING, 0.1, 0.1, 0.02)
        np.testing.assert_array_equal(x, 0.0)

    def test_stiff_bristles_are_coulomb_friction(self):
        levels = FREQUENCY, DAMPING, 0.1, 0.1, 0.02
        coulomb = motion.coulomb_mode(self.drive, STEP, *levels)
        damping = 2 * np.sqrt(1000.0)
        lugre = motion.lugre_mode(self.drive, STEP, *levels, 1000.0, damping)
        assert rms(lugre - coulomb) < 0.002 * np.ptp(coulomb)

    def test_hysteretic_force(self):
        parameters = {"stiffness": 0.5, "limit": 0.3, "ratio": 0.7, "exponent": 1.5}
        x = motion.hysteretic_mode(self.drive, STEP, FREQUENCY, DAMPING, **parameters)
        force, x, _ = force_balance(x, self.drive)
        z = physics.bouc_wen(x, STEP, 1.0, -1.0, 0.3, 0.7, 1.5) - x
        np.testing.assert_allclose(force, 0.5 * z, atol=1e-3)

    @pytest.mark.parametrize(
        ("law", "parameters"),
        [
            (motion.cubic_mode, (0.2,)),
            (motion.hysteretic_mode, (0.5, 0.3, 0.7, 1.5)),
            (motion.coulomb_mode, (0.12, 0.1, 0.02)),
            (motion.lugre_mode, (0.12, 0.1, 0.02, 50.0, 5.0)),
        ],
    )
    @pytest.mark.parametrize("level", [-0.7, 0.05])
    def test_records_begin_at_rest(self, law, parameters, level):
        x = law(np.full(200, level), STEP, FREQUENCY, DAMPING, *parameters)
        np.testing.assert_allclose(x, x[0], atol=1e-9)


def test_slew_limit_lets_slow_motion_pass(rng):
    drive = np.cumsum(rng.uniform(-1, 1, 200))
    np.testing.assert_allclose(physics.slew_limited(drive, 1.0, 1.0), drive, atol=1e-12)
    step = np.concatenate([np.zeros(3), np.full(20, 1.0)])
    out = physics.slew_limited(step, 0.5, 0.2)
    np.testing.assert_allclose(np.diff(out)[2:12], 0.1, atol=1e-12)
    assert out[-1] == 1.0


@pytest.mark.parametrize("seed", range(30))
def test_asymmetry_is_one_sided_monotone_and_kinked(seed):
    law = plants.LAWS["asymmetry"](np.random.default_rng(seed), draw_setting()).stage
    x = np.linspace(-1, 1, 4001)
    departure, slope = law(x, 1.0) - x, np.diff(law(x, 1.0)) / np.diff(x)
    untouched = x < 0 if np.abs(departure[-1]) > np.abs(departure[0]) else x > 0
    np.testing.assert_array_equal(departure[untouched], 0)
    assert slope.min() > 0.2
    assert 0.15 <= np.abs(departure).max() <= 0.3501
    assert 3 <= np.unique(np.round(slope, 3)[np.abs(np.diff(slope, prepend=1)) < 1e-6]).size <= 5


@pytest.mark.parametrize("seed", range(30))
def test_static_nonlinearity_is_smooth_and_monotone(seed):
    law = plants.LAWS["static_nonlinearity"](np.random.default_rng(seed), draw_setting()).stage
    x = np.linspace(-1, 1, 2001)
    slope = np.diff(law(x, 1.0)) / np.diff(x)
    assert slope.min() > 0
    assert np.abs(np.diff(slope)).max() < 0.003
    assert slope[1000] == pytest.approx(1.0, abs=0.01)
    assert 0.17 < np.abs(law(x, 1.0) - x).max() < 0.45


@pytest.mark.parametrize("seed", range(20))
def test_lag_leaves_the_gain_at_rest_alone(seed):
    effect = plants.LAWS["lag"](np.random.default_rng(seed), draw_setting())
    assert 3 <= effect.truth["tau"] / 0.001 <= 30
    step = np.concatenate([np.zeros(1), np.ones(1000)])
    assert effect.stage(step, 1.0)[-1] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_resonance_keeps_away_from_the_declared_mode(seed):
    setting = draw_setting(mode=1 / 26)
    effect = plants.LAWS["resonance"](np.random.default_rng(seed), setting)
    ratio = effect.truth["frequency"] * setting.dt / setting.mode
    assert max(ratio, 1 / ratio) >= 1.5


# ----------------------------------------------------------------------------------- recordings


@cache
def recorded(effect, declared):
    return make_recording(effect, declared, 1, n_samples=SHORT)


SENSIBLE = [(effect, declared) for declared in BASES for effect in MATRIX[declared]]
NOTHING = [("none", declared) for declared in BASES]


@pytest.mark.parametrize(("effect", "declared"), [*NOTHING, *SENSIBLE])
class TestEveryPlant:
    def test_halving_the_step_changes_nothing_that_shows(self, effect, declared):
        coarse = recorded(effect, declared)
        fine = make_recording(effect, declared, 1, n_samples=SHORT, substeps=2 * plants.SUBSTEPS)
        change = coarse.y_train_clean - fine.y_train_clean
        assert rms(change) < 0.1 * coarse.noise_std

    def test_effect_shows_against_the_same_plant_without_it(self, effect, declared):
        bare, r = recorded("none", declared), recorded(effect, declared)
        assert np.isfinite(np.concatenate([r.y_train, r.y_test])).all()
        if effect == "none":
            assert r.truth["effect_over_noise"] == {}
            return
        assert 0.5 < r.truth["effect_over_noise"][effect] < 200
        if effect == "amplitude_dependence":
            return  # it is recorded with other drives
        np.testing.assert_array_equal(bare.X_train["drive"], r.X_train["drive"])
        change = rms(r.y_train_clean - bare.y_train_clean) / np.ptp(bare.y_train_clean)
        assert 0.003 < change < 0.5
        # but for gain and offset it cannot be more
        assert r.truth["effect_over_noise"][effect] * r.noise_std < 1.001 * change * np.ptp(
            bare.y_train_clean
        )


@pytest.mark.parametrize(
    ("effect", "declared"),
    [*NOTHING, *[(MATRIX[d][-1], d) for d in BASES], ("parametric_resonance", "cascade")],
)
def test_the_same_seed_makes_the_same_recording(effect, declared):
    one, two = (make_recording(effect, declared, 5, n_samples=SHORT) for _ in range(2))
    pd.testing.assert_frame_equal(one.X_train, two.X_train)
    pd.testing.assert_series_equal(one.y_train, two.y_train)
    pd.testing.assert_series_equal(one.y_test, two.y_test)
    other = make_recording(effect, declared, 6, n_samples=SHORT)
    assert not np.allclose(one.y_train, other.y_train)


@pytest.mark.parametrize("noise", [0.0005, 0.01])
def test_noise_is_white_gaussian_and_of_the_level_asked_for(noise):
    r = make_recording("lag", "bouc_wen", 1, n_samples=SHORT, noise=noise)
    assert r.noise_std == pytest.approx(noise * np.ptp(r.y_train_clean), rel=1e-9)
    noise = np.concatenate([r.y_train - r.y_train_clean, r.y_test - r.y_test_clean])
    noise = noise / r.noise_std
    assert rms(noise) == pytest.approx(1.0, abs=0.05)
    assert abs(noise.mean()) < 0.05
    assert abs(np.mean(noise[1:] * noise[:-1])) < 0.05
    assert np.mean(noise**4) == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("declared", BASES)
def test_declared_model_without_effect_is_fitted_to_the_noise(declared):
    noise = 0.002
    r = make_recording("none", declared, 2, noise=noise, n_samples=4000)
    model = declared_model(declared, noise).fit(r.X_train, r.y_train)
    error = rms(r.y_test - model.predict(r.X_test))
    assert error < 1.10 * r.noise_std


@pytest.mark.parametrize("declared", BASES)
def test_unknown_structures_show(declared):
    for name in unknown_structures(declared):
        r = make_recording(name, declared, 0, n_samples=SHORT)
        assert np.isfinite(np.concatenate([r.y_train, r.y_test])).all()
        assert 1.0 < r.truth["effect_over_noise"][name] < 100
    assert set(UNKNOWN) - set(unknown_structures(declared)) <= {"parametric_resonance"}


@pytest.mark.parametrize("declared", BASES)
def test_two_effects_are_both_there(declared, rng):
    pairs = effect_pairs(declared)
    assert len(pairs) > 50
    for one, two in rng.permutation(pairs)[:3]:
        r = make_recording((one, two), declared, 0, n_samples=SHORT)
        assert np.isfinite(np.concatenate([r.y_train, r.y_test])).all()
        assert set(r.truth["effect_over_noise"]) == {one, two}
        assert min(r.truth["effect_over_noise"].values()) > 0.5


def test_distractions_leave_the_plant_alone():
    seen = set()
    for seed in range(12):
        r = make_recording("none", "second_order", seed, n_samples=1500, distract=True)
        plain = make_recording("none", "second_order", seed, n_samples=1500)
        assert r.truth["mode"] == plain.truth["mode"]
        peaks = r.X_train["drive"].abs().groupby(level="record").max()
        spread = peaks.min() / peaks.max()
        seen.add((r.truth["column"], bool(spread < 0.35)))
        if r.truth["column"]:
            assert list(r.X_train.columns) == ["drive", "temperature"]
            pd.testing.assert_series_equal(r.y_train, plain.y_train)
            assert np.ptp(r.X_test["temperature"]) > 0
    assert seen == {("", False), ("", True), ("temperature", False)}


@pytest.mark.parametrize("declared", BASES)
def test_records_are_labelled_timed_and_of_the_size_asked_for(declared):
    r = make_recording("lag", declared, 2, n_samples=SHORT)
    assert list(r.X_train.columns) == ["drive"]
    assert len(r.X_train) == SHORT
    assert list(r.X_train.index.unique("record")) == [0, 1, 2, 3, 4]
    assert list(r.X_test.index.unique("record")) == [5, 6, 7]
    for X, y, clean in (
        (r.X_train, r.y_train, r.y_train_clean),
        (r.X_test, r.y_test, r.y_test_clean),
    ):
        assert X.index.names == ["record", "time"]
        assert X.index.equals(y.index)
        assert X.index.equals(clean.index)
        for _, part in X.groupby(level="record"):
            time = part.index.get_level_values("time")
            assert time[0] == 0.0
            np.testing.assert_allclose(np.diff(time), r.sampling_interval, rtol=1e-6)
            assert len(part) > 0.6 * SHORT / 5
    assert 1e-4 <= r.sampling_interval <= 1e-2
    with pytest.raises(dataclasses.FrozenInstanceError):
        r.noise_std = 0.0


@pytest.mark.parametrize("seed", range(4))
def test_held_out_records_stay_within_the_range_fitted_on(seed):
    r = make_recording("none", "prandtl_ishlinskii", seed, n_samples=SHORT)
    full = r.X_train["drive"].abs().max()
    for drive in records(r.X_test):
        assert np.abs(drive).max() <= full
        assert np.ptp(drive) > 0.3 * full
    assert sorted(r.truth["signals"][:5]) == sorted(s.__name__ for s in plants.SIGNALS)
    assert len(set(r.truth["signals"][5:])) == 3


def test_clean_response_without_effect_is_the_superposition_of_its_plays():
    r = make_recording("none", "prandtl_ishlinskii", 4, n_samples=SHORT)
    for drive, clean in zip(records(r.X_train), records(r.y_train_clean), strict=True):
        out = physics.plays(drive, r.truth["thresholds"], r.truth["weights"])
        np.testing.assert_allclose(clean, out, rtol=1e-9, atol=1e-9 * np.ptp(clean))


@pytest.mark.parametrize("effect", ["drift", "offset", "periodic_disturbance"])
def test_what_stands_beside_does_not_know_the_drive(effect):
    bare = make_recording("none", "cascade", 7, n_samples=SHORT)
    r = make_recording(effect, "cascade", 7, n_samples=SHORT)
    added = r.y_train_clean - bare.y_train_clean
    scale = np.ptp(bare.y_train_clean)
    for number, (_, part) in enumerate(added.groupby(level="record")):
        size = np.ptp(part) / scale
        if effect == "drift":
            assert 0.03 < size < 0.21
            assert part.iloc[0] == pytest.approx(0, abs=1e-12 * scale)
        elif effect == "offset":
            assert size < 1e-12
            value = r.truth["parameters"]["values"][number]
            assert part.iloc[0] == pytest.approx(value, rel=1e-9)
            assert 0.02 <= abs(value) / scale <= 0.1
        else:
            t = part.index.get_level_values("time").to_numpy()
            angles = 2 * np.pi * np.outer(t, r.truth["parameters"]["frequencies"])
            basis = np.hstack([np.cos(angles), np.sin(angles)])
            left = part - basis @ np.linalg.lstsq(basis, part.to_numpy(), rcond=None)[0]
            assert np.abs(left).max() < 1e-6 * scale


def test_saturation_stops_at_its_levels():
    for seed in range(4):
        r = make_recording("output_saturation", "cascade", seed, n_samples=SHORT)
        low, high = r.truth["parameters"]["low"], r.truth["parameters"]["high"]
        reached = (r.y_train_clean == high).any() or (r.y_train_clean == low).any()
        assert reached
        assert r.y_train_clean.between(low, high).all()


def test_the_beginning_of_a_record_is_at_rest():
    r = make_recording("creep", "cascade", 0, n_samples=SHORT)
    gain = 1 + r.truth["parameters"]["compliances"].sum()
    for drive, clean in zip(records(r.X_train), records(r.y_train_clean), strict=True):
        virgin = physics.plays(drive[:1], r.truth["thresholds"], r.truth["weights"])[0]
        assert clean[0] == pytest.approx(gain * virgin, rel=1e-9, abs=1e-12 * np.ptp(clean))


@pytest.mark.parametrize(("effect", "declared"), [("nosuch", BASES[0]), ("lag", "nosuch")])
def test_unknown_names_are_refused(effect, declared):
    with pytest.raises(ValueError, match="not in tuple"):
        make_recording(effect, declared, 0)
