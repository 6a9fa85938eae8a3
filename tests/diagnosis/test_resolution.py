"""Resolution is raised before any physics, and predicts what is held out."""

from dataclasses import replace

import numpy as np
import pytest
import search_steps
import small_inputs

from skhyst.compose import Cascade, Sum
from skhyst.diagnosis._resolution import raised
from skhyst.disturbance import Offset
from skhyst.hysteresis import (
    MaxwellSlip,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    RateDependentPrandtlIshlinskii,
)
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain, KelvinVoigt
from skhyst.optimize import RecordData, block_folds
from skhyst.static import SmoothCurve

THRESHOLDS = np.array([0.0, 0.37, 1.13, 2.41])
WEIGHTS = np.array([1.0, 0.7, 0.5, 0.9])
NOISE = 0.02


def plays(u, thresholds=THRESHOLDS, weights=WEIGHTS):
    return small_inputs.plays(u, thresholds, weights)


def drive(seed=0, n=1200):
    u = np.convolve(np.random.default_rng(seed).normal(size=n + 59), np.ones(60), "valid")
    return 10.0 * (u - u.min()) / np.ptp(u) - 5.0


def noisy(y, noise=NOISE, seed=0):
    return y + noise * np.random.default_rng([seed, 1]).normal(size=len(y))


def declared(model, *data, dt=1.0):
    """Return the candidate of a declared model, its records and folds."""
    records, folds = block_folds([RecordData(u, y, dt) for u, y in data])
    tree = search_steps.fitted(model, records)
    return search_steps.candidate(tree, records, folds), records, folds


def test_a_damper_of_one_speed_needs_no_physics():
    """Stops are found under plays that were declared, and the error is that of the noise."""
    turns = np.cumsum(
        [0, *(p for a in (1, 2, 3, 4, 6, 8, 10, 12) for p in (a, -2 * a, 2 * a, -2 * a, a))]
    )
    way = np.append(0.0, np.cumsum(np.abs(np.diff(turns))))
    u = np.interp(np.arange(0.0, way[-1], 0.5), way, turns)
    y = noisy(0.3 * u + 8.0 * (u - plays(u, np.array([1.5]), np.ones(1))), 0.1)
    for model in (PrandtlIshlinskii(), PrandtlIshlinskii(form="stop"), PrandtlIshlinskii(60)):
        candidate, records, folds = declared(model, (u, y))
        found, (done,) = raised(candidate, records, folds)
        assert found.error == pytest.approx(0.1, rel=0.06)
        assert found.structure.operator.thresholds == pytest.approx([0.0, 1.5], abs=0.01)
        assert str(done) == f"{model.n_operators} plays, changed to 2"
        assert (done.error_before, done.error_after) == (candidate.error, found.error)
        # fitted from nothing, the model is as fine
        anew = found.structure.identified(records).operator
        np.testing.assert_array_equal(anew.thresholds, found.structure.operator.thresholds)


def test_each_kind_of_part_is_raised_within_its_tree():
    u = drive()
    slow = FirstOrderLagOperator(5.0).run(plays(u), 1.0)[0]
    bent = np.where(plays(u) > 4.0, 4.0 + 0.5 * (plays(u) - 4.0), plays(u))
    cascade = Cascade([("plays", PrandtlIshlinskii(8)), ("lag", FirstOrderLag())])
    zones = ModifiedPrandtlIshlinskii(8, dead_zone_thresholds=[4.0])
    for model, y in (
        (PrandtlIshlinskii(8), plays(u)),
        (PrandtlIshlinskii(20), -plays(u)),
        (cascade, slow),
        (RateDependentPrandtlIshlinskii(8), plays(u)),
        (zones, bent),
    ):
        candidate, records, folds = declared(model, (u, noisy(y)))
        found, (done,) = raised(candidate, records, folds)
        assert 4 <= done.after <= 6
        assert found.error == pytest.approx(NOISE, rel=0.06)
        assert candidate.error > 1.3 * found.error
        text = str(found.structure.estimator.get_params())
        assert "0.37" in text or "0.36" in text


def test_slip_elements_curves_and_creep_units_are_raised():
    u = drive()
    force = noisy(u - plays(u, np.array([1.5]), np.ones(1)))
    candidate, records, folds = declared(MaxwellSlip(6, fit_damping=False), (u, force))
    found, (done,) = raised(candidate, records, folds)
    assert done.after <= 3
    assert found.error == pytest.approx(NOISE, rel=0.06)
    bent = noisy(u + 0.01 * u**3 - 0.001 * u**4)
    curve = Cascade([("gain", Gain()), ("curve", SmoothCurve(2))])
    candidate, records, folds = declared(curve, (u, bent))
    found, _ = raised(candidate, records, folds)
    assert found.structure.models[1].degree >= 4
    assert found.error == pytest.approx(NOISE, rel=0.1)  # a fold extrapolates to the ends
    steps = np.repeat(np.random.default_rng(0).normal(size=30), 40)
    y, states = np.array(steps), [(0.1, 0.03), (0.2, 0.3), (0.1, 2.0)]
    for compliance, tau in states:
        x, rest = 0.0, []
        for value in steps:  # the drive jumps and then stays
            x += (value - x) * (1.0 - np.exp(-0.01 / tau))
            rest.append(x)
        y = y + compliance * np.array(rest)
    creep = KelvinVoigt(1, hold="zoh", initial_state="zero", dt=0.01)
    candidate, records, folds = declared(creep, (steps, noisy(y, 0.02)), dt=0.01)
    found, done = raised(candidate, records, folds)
    assert found.error <= candidate.error
    assert [own.after for own in done] in ([2], [3])


def test_offsets_of_records_and_records_held_out_whole():
    drives = [drive(1), 0.5 * drive(2), 0.7 * drive(3)]
    data = [(u, noisy(plays(u) + i, seed=i)) for i, u in enumerate(drives)]
    model = Sum([("plays", PrandtlIshlinskii(8)), ("offset", Offset())])
    candidate, records, folds = declared(model, *data)
    found, (done,) = raised(candidate, records, folds)
    assert 4 <= done.after <= 7
    assert found.error == pytest.approx(NOISE, rel=0.06)


def test_a_part_that_is_right_stays_as_it_is():
    u = drive()
    candidate, records, folds = declared(Gain(), (u, noisy(u)))
    assert raised(candidate, records, folds) == (candidate, [])


def test_effects_are_taken_out_of_a_tree_that_is_as_fine_as_before():
    u = drive()
    y = noisy(FirstOrderLagOperator(5.0).run(plays(u), 1.0)[0])
    candidate, records, folds = declared(PrandtlIshlinskii(8), (u, y))
    lag, *_ = search_steps.variants("lag", candidate.structure, records)
    lag = search_steps.refit(lag, records, folds)
    found, (done,) = raised(lag, records, folds)
    assert done.stage == "prandtl_ishlinskii"
    plain = found.structure.without("lag")
    thresholds = found.structure.operators[0].thresholds
    np.testing.assert_array_equal(plain.operator.thresholds, thresholds)
    assert plain.model.thresholds == thresholds.tolist()


def test_what_an_effect_has_brought_in_is_raised_too():
    u = drive()
    candidate, records, folds = declared(Gain(), (u, noisy(plays(u))))
    variants = search_steps.variants("hysteresis", candidate.structure, records)
    effect = next(c for c in variants if c.structure.names[0] == "hysteresis")
    effect = search_steps.refit(effect, records, folds)
    found, (done,) = raised(effect, records, folds)
    assert (done.stage, done.before) == ("hysteresis", 10)
    assert 4 <= done.after <= 6
    lag, *_ = search_steps.variants("lag", found.structure, records)
    tree = lag.structure.without("lag")
    np.testing.assert_array_equal(
        tree.operators[0].thresholds, found.structure.operators[0].thresholds
    )


def test_the_leading_form_enters_beside_a_gain():
    """A damper under a gain that was declared: the force leads the displacement."""
    t = np.arange(900)
    u = (0.2 + 2.0 * t / 900) * np.sin(2 * np.pi * t / 90)
    force = [0.0]
    for step in np.diff(u):
        force.append(np.clip(force[-1] + step, -0.5, 0.5))
    candidate, records, folds = declared(Gain(), (u, noisy(np.array(force) + 0.1 * u, 1e-3)))
    variants = search_steps.variants("hysteresis", candidate.structure, records)
    effect = next(c for c in variants if c.structure.names[0] == "hysteresis")
    assert effect.structure.operators[0].form == "stop"
    found = search_steps.refit(effect, records, folds)
    found, _ = raised(found, records, folds)
    assert found.error < 1.1e-3
    assert replace(found).error < 0.01 * candidate.error
