"""A claim names what the plant has, and its numbers are those of the plant."""

from functools import cache
from types import SimpleNamespace

import numpy as np
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
from skhyst.diagnosis._claim import Claim
from skhyst.diagnosis._evidence import gather_evidence
from skhyst.disturbance import Drift
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import (
    DynamicStiffness,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    SecondOrderMode,
)
from skhyst.records import Units, stack_records

SEED = 9000
IN_MOTION = ["hysteresis", "backlash", "friction", "cubic_stiffness", "slew_limit"]
RIVALS = {  # of each those that come nearest
    "lag": ["delay", "resonance", "creep"],
    "asymmetry": ["static_nonlinearity", "output_saturation", "lag"],
    "static_nonlinearity": ["asymmetry", "output_saturation", "lag"],
    "output_saturation": ["asymmetry", "static_nonlinearity", "lag"],
    "resonance": ["lag", "delay", "creep"],
    "creep": ["lag", "drift", "static_nonlinearity"],
    "drift": ["creep", "offset", "periodic_disturbance"],
    "offset": ["creep", "drift", "output_saturation"],
    "periodic_disturbance": ["drift", "offset", "resonance"],
}


@cache
def found(effect):
    """Return a recording and the search for its one effect, each made once."""
    declared = "second_order" if effect in IN_MOTION else "prandtl_ishlinskii"
    # records of several amplitudes are compared
    few = effect in plants.EFFECTS[11:] and effect != "amplitude_dependence"
    recording = make_recording(effect, declared, SEED, n_samples=2000 if few else 4000)
    model = SecondOrderMode()
    if declared != "second_order":
        model = PrandtlIshlinskii(thresholds=recording.truth["thresholds"])
    names = [effect, *RIVALS.get(effect, ())]
    search = EffectSearchCV(model, effects=names, cv=2, max_effects=2, random_state=0)
    return recording, search.fit(recording.X_train, recording.y_train)


def slow_but_few(cases):
    """Mark the cases of all effects but one of each kind as slow: a search takes seconds."""
    few = "creep", "dead_zone", "amplitude_dependence", "cubic_stiffness"
    cases = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case, marks=() if case[0] in few else pytest.mark.slow) for case in cases]


def numbers_and_truth(effect):
    recording, search = found(effect)
    assert search.effects_ == [effect]
    return search.evidence_[effect].numbers, recording.truth["parameters"]


def assert_near(number, truth, relative):
    """Check that a number is within six standard errors of the truth, or a small part of it."""
    value, std, _ = number
    assert abs(value - truth) <= np.nanmax([6.0 * std, relative * abs(truth)]), (value, std, truth)


def test_what_helps_only_together_with_others_is_said(monkeypatch):
    for name, made in (("_numbers", {}), ("draw", None)):
        monkeypatch.setattr(f"skhyst.diagnosis._evidence.{name}", lambda claim, made=made: made)
    claim = Claim(Effect("own", list, "A law.", ""), None, None, (), (), Units())

    def said(after, later):
        return gather_evidence(claim, 1.0, after, later).statement

    assert said(0.5, ["lag"]).endswith(
        "removes 75.0 % of the power of the held-out residual of the model without it or lag."
    )
    assert said(1.01, ["lag", "creep"]).endswith("only together with lag and creep.")
    assert "removes 0.0 %" in said(1.0, [])


@pytest.mark.slow
@pytest.mark.parametrize("effect", RIVALS)
def test_the_missing_effect_is_named_and_nothing_else_is_claimed(effect):
    recording, search = found(effect)
    assert search.effects_ == [effect]
    held_out = recording.X_test, recording.y_test
    error = search.held_out_error(*held_out)
    assert error < 1.10 * recording.noise_std
    assert error < 0.5 * search.held_out_error(*held_out, declared=True)
    assert search.verdict_ == "noise"
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.1)


@pytest.mark.parametrize("effect", slow_but_few(plants.EFFECTS))
def test_every_claim_has_a_sentence_numbers_and_a_picture(effect):
    _, search = found(effect)
    evidence = search.evidence_[effect]
    assert isinstance(evidence, Evidence)
    assert evidence.effect == effect
    assert evidence.statement.endswith("held-out residual of the model without it.")
    (row,) = search.history_[search.history_["effect"] == effect].to_dict("records")
    removed = 1.0 - (row["error_after"] / row["error_before"]) ** 2
    assert f"removes {100.0 * removed:.1f} % of the power" in evidence.statement
    assert evidence.numbers
    for value, std, unit in evidence.numbers.values():
        assert np.isfinite(value)
        assert np.isnan(std) or std > 0.0
        assert isinstance(unit, str)
    own = evidence.picture
    assert isinstance(own, Picture)
    assert own.title
    assert (own.below or own).x_label
    for panel in filter(None, (own, own.below)):
        assert panel.y_label
        assert any(label for label, *_ in panel.curves)
        for _, x, y, style in panel.curves:
            assert len(x) == len(y) > 0
            assert np.isfinite([x, y]).all()
            assert style in ("line", "points", "dashed")


def test_a_dozen_samples_have_a_picture():
    """Of what was identified: no line of so few is distinguished from the noise."""
    u = np.random.default_rng(0).normal(size=12).cumsum()
    y, _ = FirstOrderLagOperator(3.0).run(u, 1.0)
    search = EffectSearchCV(Gain(), effects=["lag"], cv=2, max_effects=1).fit(u[:, None], y)
    ((_, frequency, gain, _),) = [
        c for c in search.evidence_["lag"].picture.curves if c[0] != "measured"
    ]
    assert len(frequency) == len(gain) > 0


CREEP = "creep over the settled response"
# effect -> name of a number, what it is by the truth, and a small part of it
NUMBERS = [
    ("lag", "time constant", lambda t: t["tau"], 0.005),
    ("lag", "corner frequency", lambda t: 0.5 / (np.pi * t["tau"]), 0.005),
    ("delay", "delay", lambda t: t["delay"], 0.005),
    ("resonance", "natural frequency", lambda t: t["frequency"], 0.005),
    ("resonance", "damping ratio", lambda t: t["damping"], 0.03),
    ("creep", CREEP, lambda t: 100.0 - 100.0 / (1.0 + t["compliances"].sum()), 0.02),
    ("offset", "spread between records", lambda t: np.ptp(t["values"][: plants.N_TRAIN]), 0.02),
    ("drift", "largest span in a record", lambda t: t["spans"][: plants.N_TRAIN].max(), 0.05),
    ("dead_zone", "width of the band", lambda t: 2.0 * t["half_width"], 0.01),
    ("dead_zone", "center", lambda t: t["center"], 0.01),
    ("backlash", "play", lambda t: 2.0 * t["half_width"], 0.01),
    ("slew_limit", "largest rate", lambda t: t["rate"], 0.01),
    ("rate_dependence", "dilation", lambda t: t["dilation"], 0.02),
    ("friction", "coulomb ratio", lambda t: t["coulomb"] / t["static"], 0.05),
    ("friction", "stribeck velocity", lambda t: t["velocity"], 0.1),
    ("hysteresis", "hysteresis stiffness", lambda t: t["stiffness"], 0.1),
    ("hysteresis", "presliding displacement", lambda t: t["limit"], 0.1),
    ("auxiliary_input", "gain", lambda t: t["gain"], 0.02),
    ("auxiliary_input", "time constant", lambda t: t["tau"], 0.05),
]


@pytest.mark.parametrize(("effect", "name", "truth", "relative"), slow_but_few(NUMBERS))
def test_numbers_are_those_of_the_plant(effect, name, truth, relative):
    numbers, parameters = numbers_and_truth(effect)
    assert_near(numbers[name], truth(parameters), relative)


@pytest.mark.slow
def test_units_are_those_of_what_the_part_stands_between():
    units = {
        ("dead_zone", "width of the band"): "drive",
        ("output_saturation", "upper level"): "response",
        ("input_saturation", "lower level"): "drive",
        ("resonance", "natural frequency"): "Hz",
        ("friction", "stribeck velocity"): "response/s",
        ("auxiliary_input", "gain"): "response/temperature",
        ("creep", CREEP): "%",
    }
    for (effect, name), unit in units.items():
        assert numbers_and_truth(effect)[0][name][2] == unit
    place = numbers_and_truth("backlash")[1]["place"]
    assert numbers_and_truth("backlash")[0]["play"][2] == {"first": "drive"}.get(place, "response")


@pytest.mark.slow
def test_periodic_disturbance():
    numbers, truth = numbers_and_truth("periodic_disturbance")
    lines = [int(name.split()[1]) for name in numbers if name.startswith("amplitude ")]
    found = sorted((-numbers[f"amplitude {i}"][0], i) for i in lines)[: len(truth["amplitudes"])]
    assert len(found) == len(truth["amplitudes"])
    order = np.argsort(-truth["amplitudes"])
    for (amplitude, i), place in zip(found, order, strict=True):
        assert_near(numbers[f"frequency {i}"], truth["frequencies"][place], 0.001)
        assert -amplitude == pytest.approx(truth["amplitudes"][place], rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["input_saturation", "output_saturation"])
def test_saturation(effect):
    numbers, truth = numbers_and_truth(effect)
    levels = {"lower level": truth["low"], "upper level": truth["high"]}
    # a side that is not clipped is not claimed
    assert set(numbers) == {name for name, level in levels.items() if np.isfinite(level)}
    for name, number in numbers.items():
        assert_near(number, levels[name], 0.01)


def shape(v, y):
    """Return a curve by its ends and its straight line: no scale of either axis matters."""
    return (v - v[0]) / (v[-1] - v[0]), (y - y[0]) / (y[-1] - y[0])


@pytest.mark.slow
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
    bend = search.evidence_[effect].numbers["departure from a straight line"][0]
    assert 2.0 < bend < 40.0


def picture(effect):
    """Return the curves of a picture by label, and those of the one below it."""
    own = found(effect)[1].evidence_[effect].picture
    below = own.below.curves if own.below else ()
    return [{label: (x, y) for label, x, y, _ in curves} for curves in (own.curves, below)]


def test_a_dead_zone_takes_all_that_comes_into_it_within_the_band():
    truth = found("dead_zone")[0].truth["parameters"]
    curves, _ = picture("dead_zone")
    for x, y in curves.values():
        low, high = (truth["center"] + side * truth["half_width"] for side in (-1.0, 1.0))
        inside = (x > low) & (x < high)
        slope = np.polyfit(x[inside], y[inside], 1)[0]
        assert abs(np.polyfit(x[x < low], y[x < low], 1)[0]) < 0.2 * abs(slope)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["lag", "resonance", "delay"])
def test_gain_and_phase_are_those_of_the_plant(effect):
    truth = found(effect)[0].truth["parameters"]
    gains, phases = picture(effect)
    frequency, gain = gains["identified"]
    s = 2j * np.pi * frequency
    w = 2.0 * np.pi * truth.get("frequency", 1.0)
    law = {
        "lag": lambda: 1.0 / (1.0 + s * truth["tau"]),
        "delay": lambda: np.exp(-s * truth["delay"]),
        "resonance": lambda: 1.0 / ((s / w) ** 2 + 2.0 * truth["damping"] * s / w + 1.0),
    }[effect]()
    below = frequency < np.median(frequency)
    np.testing.assert_allclose(gain[below], np.abs(law)[below], rtol=0.05)
    phase = np.degrees(np.unwrap(np.angle(law)))
    np.testing.assert_allclose(phases["identified"][1][below], phase[below], atol=5.0)
    x, measured = gains["measured"]
    assert np.median(np.abs(measured / np.interp(x, frequency, gain) - 1.0)) < 0.1


def test_creep_relaxes_after_a_step():
    truth = found("creep")[0].truth["parameters"]
    (curves, _), gain = picture("creep"), found("creep")[1].evidence_["creep"].picture.below
    time, step = curves["identified"]
    relaxed = -np.expm1(-time[:, None] / truth["taus"]) @ truth["compliances"]
    np.testing.assert_allclose(step, 1.0 + relaxed, rtol=0.02)
    assert gain.x_log


@pytest.mark.slow
def test_rates():
    numbers, truth = numbers_and_truth("slew_limit")
    assert numbers["fastest drive"][0] > truth["rate"]
    numbers, truth = numbers_and_truth("rate_dependence")
    half = 0.5 * np.ptp(found("rate_dependence")[0].X_train["drive"])
    growth = 100.0 * truth["dilation"] * numbers["fast motion"][0] / half
    assert numbers["growth at fast motion"][0] == pytest.approx(growth, rel=0.02)


@pytest.mark.slow
def test_friction_follows_the_sign_of_the_velocity():
    numbers, truth = numbers_and_truth("friction")
    peak = np.abs(found("friction")[0].X_train["drive"]).max()
    assert_near(numbers["breakaway force"], truth["static"] * peak, 0.05)
    v, force = picture("friction")[0]["identified"]
    moves = np.abs(v) > 0.05 * np.ptp(v)
    assert np.all(np.sign(force[moves]) == np.sign(v[moves]))


def test_cubic_stiffness():
    recording, _ = found("cubic_stiffness")
    numbers, truth = numbers_and_truth("cubic_stiffness")
    share = truth["k3_over_k"] * numbers["full amplitude"][0] ** 2
    first, third = 1.0 + 0.75 * share, 0.25 * share  # harmonics of x + share x^3 under a cosine
    nonlinear = numbers["nonlinear over linear spring force at full amplitude"]
    assert_near(nonlinear, 100.0 * share, 0.05)
    assert_near(numbers["third harmonic of the force"], 100.0 * third / first, 0.05)
    frequency = recording.truth["mode"]["frequency"]
    assert_near(numbers["resonance at small amplitude"], frequency, 0.01)
    assert_near(numbers["resonance at full amplitude"], frequency * np.sqrt(first), 0.02)


@pytest.mark.slow
def test_hysteresis_in_the_equation_of_motion():
    _, search = found("hysteresis")
    numbers, truth = numbers_and_truth("hysteresis")
    assert truth["law"] == "force"
    stage = search.best_estimator_.operator_
    force = truth["stiffness"] * truth["limit"] / abs(stage.gain)
    assert_near(numbers["largest hysteretic force"], force, 0.1)
    for x, y in picture("hysteresis")[0].values():  # the force dissipates what goes round
        assert np.trapezoid(y, x) * np.sign(stage.gain) > 0.0
        assert np.median(np.abs(y)) == pytest.approx(force, rel=0.2)


@pytest.mark.slow
def test_auxiliary_input_explains_the_residual():
    numbers, _ = numbers_and_truth("auxiliary_input")
    assert numbers["part of the residual that it explains"][0] > 90.0


def test_amplitude_dependence_of_the_gain():
    t, rng = np.arange(300) * 0.01, np.random.default_rng(SEED)
    sizes = np.array([1.0, 2.0, 3.0, 4.0])
    drives = [a * np.sin(2.0 * np.pi * t + 0.3 * number) for number, a in enumerate(sizes)]
    gains = 5.0 * (1.0 + 0.1 * sizes)
    X, y = stack_records([(u, k * u) for u, k in zip(drives, gains, strict=True)], dt=0.01)
    search = EffectSearchCV(
        PrandtlIshlinskii(thresholds=[0.0]), effects=["amplitude_dependence"], max_effects=1
    ).fit(X, y + 0.01 * rng.standard_normal(len(y)))
    assert search.effects_ == ["amplitude_dependence"]
    evidence = search.evidence_["amplitude_dependence"]
    (_, x, gains, _), *_ = evidence.picture.curves
    change = 200.0 * (1.4 - 1.1) / (1.4 + 1.1)
    assert evidence.numbers["change of the gain"][0] == pytest.approx(change, rel=0.02)
    np.testing.assert_allclose(gains / gains[0], (1.0 + 0.1 * x) / (1.0 + 0.1 * x[0]), rtol=0.01)


def force_recording(extra):
    """Return motions of a mass on a spring and dashpot and their forces, with an extra force."""
    rng, records, t = np.random.default_rng(SEED), [], np.arange(500) * 2e-3
    for number in range(4):
        x = 2.0 * np.sin(2.0 * np.pi * (1.0 + 0.5 * number) * t)
        x += 0.7 * np.sin(2.0 * np.pi * 4.3 * t + number) * np.sin(2.0 * np.pi * 0.8 * t)
        v = np.diff(x, prepend=2.0 * x[0] - x[1]) / 2e-3
        noise = 0.03 * rng.standard_normal(t.size)
        records.append((x, 0.1 * v + 3.0 * x + extra(x, v) + noise))
    return stack_records(records, dt=2e-3)


def elastic_then_sliding(x, v):
    return 7.5 * (x - plays(x, 1.0, np.array([0.4]), np.array([1.0])))


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


@pytest.mark.slow
def test_an_effect_of_ones_own_beside_the_model_has_evidence_too():
    register_effect(Effect("own", lambda: [Drift(3)], "A law.", "An experiment.", additive=True))
    try:
        recording, _ = found("drift")
        search = EffectSearchCV(PrandtlIshlinskii(), effects=["own"], max_effects=1)
        search.fit(recording.X_train, recording.y_train)
    finally:
        unregister_effect("own")
    assert search.evidence_["own"].statement.startswith("A law. Identified: ")
    assert search.evidence_["own"].picture.curves


@pytest.mark.slow
def test_evidence_behind_declared_dynamics():
    """The names of parameters in a longer cascade are distinguished."""
    recording = make_recording("lag", "cascade", SEED, n_samples=4000)
    model = Cascade([("hysteresis", PrandtlIshlinskii()), ("lag_of_mine", FirstOrderLag())])
    search = EffectSearchCV(model, effects=["resonance"], max_effects=1)
    search.fit(recording.X_train, recording.y_train)
    assert search.effects_ == ["resonance"]
    numbers, mode = search.evidence_["resonance"].numbers, recording.truth["mode"]
    assert_near(numbers["natural frequency"], mode["frequency"], 0.02)
    assert_near(numbers["damping ratio"], mode["damping"], 0.1)


def test_without_a_covariance_errors_are_independent():
    values = {"a": (1.0, 0.5), "b": (3.0, 0.1)}
    claim = SimpleNamespace(result=SimpleNamespace(covariance=None), values=values)
    np.testing.assert_allclose(Claim.covariance(claim, ["b", "a"]), np.diag([0.01, 0.25]))
