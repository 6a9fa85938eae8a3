"""The numbers of a claim are those of the plant."""

import numpy as np
import plants
import pytest
from plants import EFFECTS, make_recording

from skhyst.compose import Cascade
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
from skhyst.linear import FirstOrderLag

SEED = 9000
_found = {}


def found(effect):
    """Return a recording and the search for its one effect, each made once."""
    if effect not in _found:
        recording = make_recording(effect, "prandtl_ishlinskii", SEED, n_samples=4000)
        search = EffectSearchCV(
            PrandtlIshlinskii(), effects=[effect], max_effects=1, random_state=0
        )
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
    assert abs(value - truth) <= max(6.0 * std, relative * abs(truth)), (value, std, truth)


@pytest.mark.parametrize("effect", EFFECTS)
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
        assert label
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
    v = np.concatenate([plants.plays(u, truth["thresholds"], truth["weights"]) for u in drives])
    v = np.linspace(v.min(), v.max(), 500)
    own = dict(truth["parameters"])
    law = getattr(plants, own.pop("law", "dead_zones"))
    expected = shape(v, law(v, 1.0, **own))
    hysteresis, curve = search.best_estimator_.operator_.stages
    v = np.concatenate([hysteresis.run(u, 1.0)[0] for u in drives])
    v = np.linspace(v.min(), v.max(), 500)
    x, y = shape(v, curve.run(v, 1.0)[0])
    np.testing.assert_allclose(np.interp(expected[0], x, y), expected[1], atol=0.015)
    bend = search.evidence_[effect].numbers["departure from a straight line over the range"][0]
    assert 0.02 < bend < 0.4


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
