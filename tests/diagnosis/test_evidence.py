"""The numbers of a claim are those of the plant."""

import numpy as np
import pandas as pd
import plants
import pytest
from plants import make_recording, physics

from skhyst.compose import Cascade
from skhyst.datasets.simulation import dead_zones, plays
from skhyst.diagnosis import (
    Effect,
    EffectSearchCV,
    Evidence,
    Picture,
    register_effect,
    unregister_effect,
)
from skhyst.disturbance import Drift
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import DynamicStiffness, FirstOrderLag, SecondOrderMode

SEED = 9000
# what is declared, and the seed of the plant, where they are not those of the others
DECLARED = {
    "hysteresis": "second_order",
    "backlash": "second_order",
    "friction": "second_order",
    "cubic_stiffness": "second_order",
    "slew_limit": "second_order",
}
MODELS = {"prandtl_ishlinskii": PrandtlIshlinskii, "second_order": SecondOrderMode}
NEW = plants.EFFECTS[11:]
_found = {}


def found(effect):
    """Return a recording and the search for its one effect, each made once."""
    if effect not in _found:
        declared = DECLARED.get(effect, "prandtl_ishlinskii")
        n_samples = 2000 if effect in NEW else 4000
        recording = make_recording(effect, declared, SEED, n_samples=n_samples)
        search = EffectSearchCV(MODELS[declared](), effects=[effect], max_effects=1, random_state=0)
        search.fit(recording.X_train, recording.y_train)
        _found[effect] = recording, search
    return _found[effect]


def numbers_and_truth(effect):
    recording, search = found(effect)
    assert search.effects_ == [effect]
    return search.evidence_[effect].numbers, recording.truth["parameters"]


def assert_near(number, truth, relative):
    """Check that a number is within six standard errors of the truth, or a small part of it."""
    value, std, _ = number
    assert abs(value - truth) <= np.nanmax([6.0 * std, relative * abs(truth)]), (value, std, truth)


@pytest.mark.parametrize("effect", plants.EFFECTS)
def test_every_claim_has_a_sentence_numbers_and_a_picture(effect):
    _, search = found(effect)
    evidence = search.evidence_[effect]
    assert isinstance(evidence, Evidence)
    assert evidence.effect == effect
    assert evidence.statement.endswith("held-out residual.")
    removed = 1.0 - (search.error_after_ / search.error_before_) ** 2
    assert f"removes {100.0 * removed:.1f} % of the power" in evidence.statement
    assert evidence.numbers
    for value, std, unit in evidence.numbers.values():
        assert np.isfinite(value)
        assert np.isnan(std) or std > 0.0
        assert isinstance(unit, str)
    assert isinstance(evidence.picture, Picture)
    assert evidence.picture.title
    assert evidence.picture.x_label
    assert evidence.picture.y_label
    assert evidence.picture.curves
    for label, x, y, style in evidence.picture.curves:
        assert label or style == "dashed"
        assert len(x) == len(y) > 0
        assert np.isfinite(x).all()
        assert np.isfinite(y).all()
        assert style in ("line", "points", "dashed")


def test_lag():
    numbers, truth = numbers_and_truth("lag")
    assert_near(numbers["time constant"], truth["tau"], 0.005)
    assert_near(numbers["corner frequency"], 1.0 / (2.0 * np.pi * truth["tau"]), 0.005)
    assert numbers["time constant"][1] < 0.02 * truth["tau"]
    assert numbers["time constant"][2] == "s"


def test_delay():
    numbers, truth = numbers_and_truth("delay")
    assert_near(numbers["delay"], truth["delay"], 0.005)
    assert numbers["delay"][1] < 0.02 * truth["delay"]


def test_resonance():
    numbers, truth = numbers_and_truth("resonance")
    assert_near(numbers["natural frequency"], truth["frequency"], 0.005)
    assert_near(numbers["damping ratio"], truth["damping"], 0.03)
    assert numbers["natural frequency"][2] == "Hz"


def test_creep():
    numbers, truth = numbers_and_truth("creep")
    total = truth["compliances"].sum()
    assert numbers["creep over the settled response"][0] == pytest.approx(
        total / (1.0 + total), rel=0.15
    )


def test_offset():
    numbers, truth = numbers_and_truth("offset")
    values = truth["values"][: plants.N_TRAIN]
    assert numbers["spread between records"][0] == pytest.approx(np.ptp(values), rel=0.02)


def test_drift():
    numbers, truth = numbers_and_truth("drift")
    assert numbers["largest span in a record"][0] == pytest.approx(
        truth["spans"][: plants.N_TRAIN].max(), rel=0.05
    )


def test_periodic_disturbance():
    numbers, truth = numbers_and_truth("periodic_disturbance")
    order = np.argsort(truth["frequencies"])
    names = [name for name in numbers if name.startswith("frequency")]
    assert len(names) == len(order)
    names.sort(key=lambda name: numbers[name][0])
    for name, i in zip(names, order, strict=True):
        assert_near(numbers[name], truth["frequencies"][i], 0.001)
        amplitude = numbers[name.replace("frequency", "amplitude")][0]
        assert amplitude == pytest.approx(truth["amplitudes"][i], rel=0.03)


@pytest.mark.parametrize("effect", ["input_saturation", "output_saturation"])
def test_saturation(effect):
    numbers, truth = numbers_and_truth(effect)
    levels = {"lower level": truth["low"], "upper level": truth["high"]}
    levels = {name: level for name, level in levels.items() if np.isfinite(level)}
    assert set(numbers) == set(levels)  # a side that is not clipped is not claimed
    for name, level in levels.items():
        assert_near(numbers[name], level, 0.01)


def shape(v, y):
    """Return a curve by its ends and its straight line: no scale of either axis matters."""
    return (v - v[0]) / (v[-1] - v[0]), (y - y[0]) / (y[-1] - y[0])


@pytest.mark.parametrize("effect", ["asymmetry", "static_nonlinearity"])
def test_curve(effect):
    recording, search = found(effect)
    truth = recording.truth
    drives = [u.to_numpy() for _, u in recording.X_train["drive"].groupby(level="record")]
    v = np.concatenate([plays(u, 1.0, truth["thresholds"], truth["weights"]) for u in drives])
    v = np.linspace(v.min(), v.max(), 500)
    own = dict(truth["parameters"])
    law = getattr(physics, own.pop("law")) if "law" in own else dead_zones
    expected = shape(v, law(v, 1.0, **own))
    hysteresis, curve = search.best_estimator_.operator_.stages
    v = np.concatenate([hysteresis.run(u, 1.0)[0] for u in drives])
    v = np.linspace(v.min(), v.max(), 500)
    x, y = shape(v, curve.run(v, 1.0)[0])
    np.testing.assert_allclose(np.interp(expected[0], x, y), expected[1], atol=0.015)
    bend = search.evidence_[effect].numbers["departure from a straight line over the range"][0]
    assert 0.02 < bend < 0.4


def test_dead_zone():
    numbers, truth = numbers_and_truth("dead_zone")
    assert_near(numbers["width of the band"], 2.0 * truth["half_width"], 0.01)
    assert_near(numbers["middle of the band"], truth["center"], 0.01)


def test_the_gain_falls_to_nothing_within_a_dead_zone():
    recording, search = found("dead_zone")
    truth = recording.truth["parameters"]
    for label, x, y, _ in search.evidence_["dead_zone"].picture.curves:
        inside = np.abs(x - truth["center"]) < 0.5 * truth["half_width"]
        outside = np.abs(x - truth["center"]) > 1.5 * truth["half_width"]
        assert inside.any()
        falls = np.median(y[inside]) < 0.1 * np.median(y[outside])
        assert falls == (label != "without the band")


def test_backlash():
    numbers, truth = numbers_and_truth("backlash")
    assert_near(numbers["play"], 2.0 * truth["half_width"], 0.01)
    assert numbers["play"][2] == {"first": "drive", "last": "response"}[truth["place"]]


def test_slew_limit():
    numbers, truth = numbers_and_truth("slew_limit")
    assert_near(numbers["limit"], truth["rate"], 0.01)
    assert numbers["fastest drive"][0] > truth["rate"]
    assert 0.0 < numbers["part of the time at the limit"][0] < 0.5


def test_rate_dependence():
    numbers, truth = numbers_and_truth("rate_dependence")
    assert_near(numbers["growth of the thresholds with the rate"], truth["dilation"], 0.02)
    growth = numbers["growth at fast motion"][0]
    assert growth == pytest.approx(truth["dilation"] * numbers["fast motion"][0], rel=0.02)


def test_friction():
    recording, search = found("friction")
    numbers, truth = numbers_and_truth("friction")
    peak = np.abs(recording.X_train["drive"]).max()
    assert_near(numbers["friction of slow sliding"], truth["static"] * peak, 0.05)
    assert truth["stribeck"]
    ratio = truth["coulomb"] / truth["static"]
    assert_near(numbers["friction of fast over slow sliding"], ratio, 0.05)
    assert_near(numbers["Stribeck velocity"], truth["velocity"], 0.1)
    _, v, force, _ = search.evidence_["friction"].picture.curves[0]
    assert np.mean(np.sign(force) == np.sign(v)) > 0.9


def test_cubic_stiffness():
    recording, _ = found("cubic_stiffness")
    numbers, truth = numbers_and_truth("cubic_stiffness")
    half = numbers["full amplitude"][0]
    share = truth["k3_over_k"] * half**2
    assert_near(numbers["nonlinear over linear spring force at full amplitude"], share, 0.05)
    # balance of the first and third harmonics of x + s x^3 under x = cos
    first, third = 1.0 + 0.75 * share, 0.25 * share
    assert_near(numbers["third harmonic of the spring force"], third / first, 0.05)
    frequency = recording.truth["mode"]["frequency"]
    assert_near(numbers["resonance at small amplitude"], frequency, 0.01)
    assert_near(numbers["resonance at full amplitude"], frequency * np.sqrt(first), 0.02)


def test_hysteresis_in_the_equation_of_motion():
    _, search = found("hysteresis")
    numbers, truth = numbers_and_truth("hysteresis")
    assert truth["law"] == "force"
    force = truth["stiffness"] * truth["limit"]  # over the gain of the drive
    stage = search.best_estimator_.operator_
    assert_near(numbers["largest hysteretic force"], force / abs(stage.gain), 0.1)
    curves = {label: (x, y) for label, x, y, _ in search.evidence_["hysteresis"].picture.curves}
    rising, falling = (np.mean(curves[f"measured, {way}"][1]) for way in ("rising", "falling"))
    assert (rising - falling) * np.sign(stage.gain) > 0.0  # against the motion


def test_auxiliary_input():
    numbers, truth = numbers_and_truth("auxiliary_input")
    column = truth["column"]
    assert_near(numbers[f"gain from {column}"], truth["gain"], 0.02)
    assert numbers[f"gain from {column}"][2] == f"response/{column}"
    if truth["law"] == "lag":
        assert_near(numbers["time constant"], truth["tau"], 0.05)
    assert numbers[f"part of the residual that follows {column}"][0] > 0.9


def test_amplitude_dependence_of_the_gain():
    t = np.arange(300) * 0.01
    X, y, rng = [], [], np.random.default_rng(SEED)
    for number, amplitude in enumerate((1.0, 2.0, 3.0, 4.0)):
        drive = amplitude * np.sin(2.0 * np.pi * t + 0.3 * number)
        index = pd.MultiIndex.from_product([[number], t], names=["record", "time"])
        X.append(pd.DataFrame({"drive": drive}, index=index))
        gain = 5.0 * (1.0 + 0.1 * amplitude)
        y.append(pd.Series(gain * drive + 0.01 * rng.standard_normal(t.size), index=index))
    search = EffectSearchCV(
        PrandtlIshlinskii(thresholds=[0.0]), effects=["amplitude_dependence"], max_effects=1
    ).fit(pd.concat(X), pd.concat(y))
    assert search.effects_ == ["amplitude_dependence"]
    (_, x, gains, _), *_ = search.evidence_["amplitude_dependence"].picture.curves
    np.testing.assert_allclose(gains / gains[0], (1.0 + 0.1 * x) / (1.0 + 0.1 * x[0]), rtol=0.01)


def force_recording(extra):
    """Return motions of a mass on a spring and dashpot and their forces, with an extra force."""
    rng, X, y = np.random.default_rng(SEED), [], []
    t = np.arange(500) * 2e-3
    for number in range(4):
        x = 2.0 * np.sin(2.0 * np.pi * (1.0 + 0.5 * number) * t)
        x += 0.7 * np.sin(2.0 * np.pi * 4.3 * t + number) * np.sin(2.0 * np.pi * 0.8 * t)
        v = np.diff(x, prepend=2.0 * x[0] - x[1]) / 2e-3
        force = 0.1 * v + 3.0 * x + extra(x, v) + 0.03 * rng.standard_normal(t.size)
        index = pd.MultiIndex.from_product([[number], t], names=["record", "time"])
        X.append(pd.DataFrame({"displacement": x}, index=index))
        y.append(pd.Series(force, index=index, name="force"))
    return pd.concat(X), pd.concat(y)


def elastic_then_sliding(x, v):
    force, last, out = 0.0, 0.0, []
    for position in x:
        force = min(max(force + 15.0 * (position - last), -3.0), 3.0)
        last = position
        out.append(force)
    return np.array(out)


@pytest.mark.parametrize(
    ("effect", "extra", "name", "level"),
    [
        ("friction", lambda x, v: 4.0 * np.tanh(v / 0.5), "Coulomb force", 4.0),
        ("hysteresis", elastic_then_sliding, "largest hysteretic force", 3.0),
    ],
)
def test_forces_beside_a_declared_force(effect, extra, name, level):
    model = DynamicStiffness(fit_mass=False)
    search = EffectSearchCV(model, effects=[effect], max_effects=1)
    search.fit(*force_recording(extra))
    assert search.effects_ == [effect]
    evidence = search.evidence_[effect]
    assert evidence.numbers[name][0] == pytest.approx(level, rel=0.1)
    assert max(np.abs(y).max() for _, _, y, _ in evidence.picture.curves) < 1.5 * level


@pytest.mark.parametrize("beside", [False, True], ids=["in series", "beside"])
def test_an_effect_of_ones_own_has_evidence_too(beside):
    name, model = ("my_drift", Drift(3)) if beside else ("my_lag", FirstOrderLag())
    register_effect(Effect(name, lambda: [model], "A law.", "An experiment.", beside=beside))
    try:
        recording, _ = found("drift" if beside else "lag")
        search = EffectSearchCV(PrandtlIshlinskii(), effects=[name], max_effects=1)
        search.fit(recording.X_train, recording.y_train)
    finally:
        unregister_effect(name)
    evidence = search.evidence_[name]
    assert "improves the held-out prediction" in evidence.statement
    assert evidence.picture.curves
    if not beside:
        time_constant = evidence.numbers["time_constant"]
        assert_near(time_constant, recording.truth["parameters"]["tau"], 0.005)


def test_evidence_behind_declared_dynamics():
    """The names of parameters in a longer cascade are told apart."""
    recording = make_recording("lag", "cascade", SEED, n_samples=4000)
    model = Cascade([("hysteresis", PrandtlIshlinskii()), ("lag_of_mine", FirstOrderLag())])
    search = EffectSearchCV(model, effects=["resonance"], max_effects=1)
    search.fit(recording.X_train, recording.y_train)
    assert search.effects_ == ["resonance"]
    numbers, mode = search.evidence_["resonance"].numbers, recording.truth["mode"]
    assert_near(numbers["natural frequency"], mode["frequency"], 0.02)
    assert_near(numbers["damping ratio"], mode["damping"], 0.1)
