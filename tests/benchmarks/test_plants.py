import dataclasses
from functools import cache, partial

import numpy as np
import pandas as pd
import plants
import pytest
from blind_study import declared_model
from plants import (
    BASES,
    MATRIX,
    UNKNOWN,
    effect_pairs,
    make_recording,
    motion,
    physics,
    signals,
    unknown_structures,
)

from skhyst.datasets.simulation import bouc_wen, first_order, oscillate, plays

pytestmark = pytest.mark.slow

SHORT = 2000


def records(frame):
    return [part.to_numpy().ravel() for _, part in frame.groupby(level="record")]


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


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


@pytest.mark.parametrize("signal", plants.SIGNALS)
def test_signal_peaks_at_one_and_is_well_sampled(signal):
    for seed in range(5):
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


# ------------------------------------------------------------------------------------- physics


@pytest.mark.parametrize(
    ("law", "exact"),
    [
        (partial(physics.first_order, tau=5.0), partial(first_order, tau=5.0)),
        (
            partial(motion.mode, frequency=1 / 20, damping=0.1),
            partial(oscillate, frequency=1 / 20, damping=0.1),
        ),
    ],
)
def test_steps_of_runge_and_kutta_agree_with_the_exact_solution(law, exact, rng):
    drive = np.interp(np.arange(4000) / 16, np.arange(251), np.cumsum(rng.uniform(-1, 1, 251)))
    np.testing.assert_allclose(law(drive, 1 / 16), exact(drive, 1 / 16), rtol=0, atol=1e-5)
    held = np.concatenate([np.full(10, -0.4), np.full(20_000, 1.7)])
    out = law(held, 0.25)
    np.testing.assert_allclose(out[:10], -0.4, atol=1e-14)
    assert out[-1] == pytest.approx(1.7, abs=1e-9)


def test_bouc_wen_agrees_with_the_exact_solution(rng):
    drive, h = np.cumsum(rng.uniform(-1, 1, 300)), 0.0
    found = physics.bouc_wen(drive, 0.1, 2.0, 0.4, 0.3, 0.7, 1.0)
    for before, u, y in zip([0.0, *drive], drive, found, strict=False):
        h = bouc_wen(h, u - before, 0.3, 0.7)
        assert y == pytest.approx(2.0 * (u - 0.4 * h), abs=1e-6)


FREQUENCY, DAMPING, STEP = 1 / 40, 0.1, 1 / 16
DRIVE = 0.8 * np.sin(2 * np.pi * STEP * np.arange(8000) / 60)
BOUC_WEN = {"stiffness": 0.5, "limit": 0.3, "ratio": 0.7, "exponent": 1.5}


def pulse(x):
    return 0.2 * np.sin(2 * np.pi * STEP * np.arange(1, x.size + 1) / 90 + 1.0)


def sliding(v, static):
    level = 0.1 + (static - 0.1) * np.exp(-((v / 0.02) ** 2))
    return np.where(np.abs(v) > 0.005, np.sign(v) * level, np.nan)


# of each law the force of displacement and velocity, not a number where it is undetermined
FORCES = {
    "cubic": (partial(motion.mode, cubic=0.2), lambda x, v: 0.2 * x**3, 2e-4),
    "hysteretic": (
        partial(motion.mode, **BOUC_WEN),
        lambda x, v: 0.5 * (physics.bouc_wen(x, STEP, 1.0, -1.0, 0.3, 0.7, 1.5) - x),
        1e-3,
    ),
    "pulsating": (
        partial(motion.mode, depth=0.2, pump=1 / 90, phase=1.0),
        lambda x, v: pulse(x) * x,
        2e-4,
    ),
    "coulomb": (
        partial(motion.coulomb_mode, static=0.1, coulomb=0.1, velocity=0.02),
        lambda x, v: sliding(v, 0.1),
        2e-3,
    ),
    "stribeck": (
        partial(motion.coulomb_mode, static=0.16, coulomb=0.1, velocity=0.02),
        lambda x, v: sliding(v, 0.16),
        2e-3,
    ),
}


@pytest.mark.parametrize("name", FORCES)
def test_equations_of_motion_balance(name):
    """What they lack, u - x - 2 z x' / w - x'' / w^2, is the force of the law."""
    law, force, tolerance = FORCES[name]
    path = law(DRIVE, STEP, frequency=FREQUENCY, damping=DAMPING)
    w, x = 2 * np.pi * FREQUENCY, path[1:-1]
    v = (path[2:] - path[:-2]) / (2 * STEP)
    a = (path[2:] - 2 * x + path[:-2]) / STEP**2
    left, expected = DRIVE[1:-1] - x - 2 * DAMPING / w * v - a / w**2, force(x, v)
    known = np.isfinite(expected)
    np.testing.assert_allclose(left[known], expected[known], atol=tolerance)
    if "static" in law.keywords:
        assert np.abs(left).max() < 1.01 * law.keywords["static"]
        still = law(0.1 * DRIVE, STEP, frequency=FREQUENCY, damping=DAMPING)
        np.testing.assert_array_equal(still, 0.0)


def test_stiff_bristles_are_coulomb_friction():
    levels = FREQUENCY, DAMPING, 0.1, 0.1, 0.02
    coulomb = motion.coulomb_mode(DRIVE, STEP, *levels)
    lugre = motion.lugre_mode(DRIVE, STEP, *levels, 1000.0, 2 * np.sqrt(1000.0))
    assert rms(lugre - coulomb) < 0.002 * np.ptp(coulomb)


@pytest.mark.parametrize("name", ["cubic", "hysteretic", "stribeck", "bristles"])
@pytest.mark.parametrize("level", [-0.7, 0.05])
def test_records_begin_at_rest(name, level):
    bristles = {"static": 0.12, "coulomb": 0.1, "velocity": 0.02, "bristle": 50.0}
    law = partial(motion.lugre_mode, **bristles, bristle_damping=5.0)
    law = FORCES[name][0] if name in FORCES else law
    x = law(np.full(200, level), STEP, frequency=FREQUENCY, damping=DAMPING)
    np.testing.assert_allclose(x, x[0], atol=1e-9)


# ------------------------------------------------------------------------------------- effects


def drawn(name, count=30, **changes):
    """Draw an effect by as many seeds."""
    setting = draw_setting(**changes)
    return [plants.LAWS[name](np.random.default_rng(seed), setting) for seed in range(count)]


def test_asymmetry_is_one_sided_monotone_and_kinked():
    x = np.linspace(-1, 1, 4001)
    for effect in drawn("asymmetry"):
        y = effect.stage(x, 1.0)
        departure, slope = y - x, np.diff(y) / np.diff(x)
        untouched = x < 0 if np.abs(departure[-1]) > np.abs(departure[0]) else x > 0
        np.testing.assert_array_equal(departure[untouched], 0)
        assert slope.min() > 0.2
        assert 0.15 <= np.abs(departure).max() <= 0.3501
        straight = np.abs(np.diff(slope, prepend=1)) < 1e-6
        assert 3 <= np.unique(np.round(slope, 3)[straight]).size <= 5


def test_static_nonlinearity_is_smooth_and_monotone():
    x = np.linspace(-1, 1, 2001)
    for effect in drawn("static_nonlinearity"):
        y = effect.stage(x, 1.0)
        slope = np.diff(y) / np.diff(x)
        assert slope.min() > 0
        assert np.abs(np.diff(slope)).max() < 0.003
        assert slope[1000] == pytest.approx(1.0, abs=0.01)
        assert 0.17 < np.abs(y - x).max() < 0.45


def test_lag_leaves_the_gain_at_rest_alone():
    step = np.concatenate([np.zeros(1), np.ones(1000)])
    for effect in drawn("lag"):
        assert 3 <= effect.truth["tau"] / 0.001 <= 30
        assert effect.stage(step, 1.0)[-1] == pytest.approx(1.0, abs=1e-9)


def test_resonance_keeps_away_from_the_declared_mode():
    mode = 1 / 26  # cycles per sample
    for effect in drawn("resonance", mode=mode):
        ratio = effect.truth["frequency"] * draw_setting().dt / mode
        assert max(ratio, 1 / ratio) >= 1.5


# ----------------------------------------------------------------------------------- recordings


@cache
def recorded(effect, declared):
    return make_recording(effect, declared, 1, n_samples=SHORT)


def test_halving_the_step_changes_nothing_that_shows():
    """Of each effect in one of the plants that can have it."""
    for effect, declared in {e: d for d in BASES for e in ("none", *MATRIX[d])}.items():
        coarse = recorded(effect, declared)
        fine = make_recording(effect, declared, 1, n_samples=SHORT, substeps=2 * plants.SUBSTEPS)
        change = coarse.y_train_clean - fine.y_train_clean
        assert rms(change) < 0.1 * coarse.noise_std, effect


@pytest.mark.parametrize("declared", BASES)
def test_effects_show_against_the_same_plant_without_them(declared):
    bare = recorded("none", declared)
    assert bare.truth["effect_over_noise"] == {}
    for effect in MATRIX[declared]:
        r = recorded(effect, declared)
        assert np.isfinite(np.concatenate([r.y_train, r.y_test])).all(), effect
        assert 0.5 < r.truth["effect_over_noise"][effect] < 200, effect
        if effect == "amplitude_dependence":
            continue  # it is recorded with other drives
        np.testing.assert_array_equal(bare.X_train["drive"], r.X_train["drive"], effect)
        change = rms(r.y_train_clean - bare.y_train_clean)
        assert 0.003 < change / np.ptp(bare.y_train_clean) < 0.5, effect
        # but for gain and offset it cannot be more
        assert r.truth["effect_over_noise"][effect] * r.noise_std < 1.001 * change, effect


@pytest.mark.parametrize(
    ("effect", "declared"),
    [
        *[("none", d) for d in BASES],
        *[(MATRIX[d][-1], d) for d in BASES],
        ("parametric_resonance", "cascade"),
    ],
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


def test_laws_of_the_noise():
    """Of unit variance at all times; autoregressive by its lag, flicker noise by its power."""
    for law in ({"law": "autoregressive", "coefficient": 0.9}, {"law": "flicker"}):
        rng = np.random.default_rng(0)
        drawn = np.array([signals.draw_noise(rng, 1000, **law) for _ in range(2000)])
        np.testing.assert_allclose(drawn.std(axis=0), 1.0, atol=0.08)
        if "coefficient" in law:
            assert np.mean(drawn[:, 1:] * drawn[:, :-1]) == pytest.approx(0.9, abs=0.01)
        else:
            power = np.mean(np.abs(np.fft.rfft(drawn * np.hanning(1000))) ** 2, axis=0)
            slope = np.polyfit(np.log(np.arange(5, 400)), np.log(power[5:400]), 1)[0]
            assert slope == pytest.approx(-1.0, abs=0.05)


def test_coloured_noise_and_repeated_drives():
    coefficients = []
    for seed in range(40):
        r = make_recording("none", "second_order", seed, n_samples=1500, coloured=True, repeats=2)
        coefficients.append(r.truth["noise"].get("coefficient", np.nan))
    known = np.array(coefficients)[np.isfinite(coefficients)]
    assert 0.6 < known.size / 40 < 0.9
    assert 0.5 <= known.min() < 0.6 < 0.9 < known.max() <= 0.97
    white = make_recording("none", "second_order", seed, n_samples=1500)
    assert white.truth["noise"] == {"law": "white"}
    assert r.noise_std == white.noise_std
    assert list(r.X_train.index.unique("record")) == list(range(10))
    assert list(r.X_test.index.unique("record")) == list(range(10, 16))
    np.testing.assert_array_equal(r.X_train["drive"], np.tile(white.X_train["drive"], 2))
    first, second = (r.y_train - r.y_train_clean).to_numpy().reshape(2, -1)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.3


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
        out = plays(drive, 1.0, r.truth["thresholds"], r.truth["weights"])
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
        virgin = plays(drive[:1], 1.0, r.truth["thresholds"], r.truth["weights"])[0]
        assert clean[0] == pytest.approx(gain * virgin, rel=1e-9, abs=1e-12 * np.ptp(clean))


@pytest.mark.parametrize(("effect", "declared"), [("nosuch", BASES[0]), ("lag", "nosuch")])
def test_unknown_names_are_refused(effect, declared):
    with pytest.raises(ValueError, match="not in tuple"):
        make_recording(effect, declared, 0)
