"""Weights of one sign: the data say which, and a response that falls is the mirror image."""

import numpy as np
import pytest

from skhyst.compose import Cascade
from skhyst.control import InverseCompensator
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import (
    JilesAtherton,
    JilesAthertonOperator,
    KrasnoselskiiPokrovskii,
    MaxwellSlip,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    Preisach,
    RateDependentPrandtlIshlinskii,
)
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.persistence import from_json, to_json

DT = 0.01
THRESHOLDS, WEIGHTS = np.array([0.0, 0.3, 0.8]), np.array([1.0, 0.5, 0.6])
U = np.linspace(0.5, 2.0, 900) * np.sin(np.arange(900) * 0.05)
X = U[:, None]


def plays(u, thresholds=THRESHOLDS):
    """Return the plays of a drive, sample by sample, (n, n_plays)."""
    rows, play = [], np.zeros(len(thresholds))
    for value in u:
        play = np.maximum(value - thresholds, np.minimum(value + thresholds, play))
        rows.append(play)
    return np.array(rows)


LAGGING = 7.0 + plays(U) @ WEIGHTS + 1e-3 * np.random.default_rng(0).normal(size=len(U))
LEADING = 7.0 + (U[:, None] - plays(U)) @ WEIGHTS + 0.2 * U
MODELS = {
    "plays": (PrandtlIshlinskii(6), LAGGING),
    "stops": (PrandtlIshlinskii(6), LEADING),
    "slip elements": (MaxwellSlip(6, fit_damping=False, fit_stiffness=True), LEADING),
    "rate-dependent plays": (RateDependentPrandtlIshlinskii(6, dt=DT), LAGGING),
    "plays, then zones": (ModifiedPrandtlIshlinskii(6, n_dead_zones=1), LAGGING),
    "relays": (Preisach(6), LAGGING),
    "ramps": (KrasnoselskiiPokrovskii(6), LAGGING),
}


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.filterwarnings("ignore:The data do not determine:skhyst.exceptions.ConvergenceWarning")
def test_a_response_that_falls_is_fitted_as_its_mirror_image(kind):
    model, y = MODELS[kind]
    rising = model.fit(X, y)
    up, weights = rising.predict(X), rising.weights_
    down = model.fit(X, 20.0 - y)
    np.testing.assert_allclose(down.predict(X), 20.0 - up, atol=1e-6)
    np.testing.assert_allclose(down.weights_, -weights, atol=1e-4)
    assert weights.min() >= 0.0
    assert down.weights_.max() <= 0.0
    assert np.std(up - y) < 0.05 * np.std(y)
    np.testing.assert_array_equal(from_json(to_json(down)).predict(X), down.predict(X))


def test_a_flux_density_that_is_measured_the_other_way_round():
    y, _ = JilesAthertonOperator(1.3, 0.21, 0.25, 0.3, 0.2, gain=0.3, intercept=0.1).run(U, DT)
    rising, falling = (JilesAtherton(dt=DT).fit(X, sign * y) for sign in (1.0, -1.0))
    assert rising.params_["gain"] == pytest.approx(0.3, rel=1e-3)
    for name, sign in {"saturation": -1, "gain": -1, "intercept": -1, "pinning": 1}.items():
        assert falling.params_[name] == pytest.approx(sign * rising.params_[name], rel=1e-3)


@pytest.mark.parametrize(("y", "form"), [(LAGGING, "play"), (LEADING, "stop")])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_form_is_that_of_the_loops(y, form, sign):
    model = PrandtlIshlinskii(thresholds=THRESHOLDS).fit(X, sign * y)
    assert model.operator_.form == form
    assert model.operator_.falling == (sign < 0.0)


def test_a_form_that_is_asked_for_is_kept():
    for form in ("play", "stop"):
        assert PrandtlIshlinskii(6, form=form).fit(X, LAGGING).operator_.form == form


def test_noise_turns_no_response_round():
    """Where nothing speaks for another form or direction, it is plays that rise."""
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(size=len(U))
        assert PrandtlIshlinskii(10).fit(X, U + 0.1 * noise).operator_.form == "play"


@pytest.mark.parametrize(
    "model",
    [
        PrandtlIshlinskii(thresholds=THRESHOLDS, dt=DT),
        RateDependentPrandtlIshlinskii(thresholds=THRESHOLDS, variant="slope", dt=DT),
        ModifiedPrandtlIshlinskii(thresholds=THRESHOLDS, dead_zone_thresholds=[-1.0], dt=DT),
    ],
)
def test_the_inverse_of_a_response_that_falls(model):
    y = -plays(U) @ WEIGHTS
    model.fit(X, y)
    np.testing.assert_allclose(model.inverse_predict(y[:, None]), U, atol=1e-6)


def test_a_compensator_and_a_stepper_of_a_response_that_falls():
    y = 3.0 - plays(U) @ WEIGHTS
    model = PrandtlIshlinskii(thresholds=THRESHOLDS, dt=DT).fit(X, y)
    drive = InverseCompensator(model).fit(X, y).predict(y[:, None])
    np.testing.assert_allclose(drive, U, atol=1e-6)
    stepper = model.stepper(u0=U[0])
    np.testing.assert_allclose([stepper.step(value) for value in U], y, atol=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_plays_before_a_lag_fall_too(sign):
    y = FirstOrderLagOperator(0.05).run(sign * plays(U) @ WEIGHTS, DT)[0]
    steps = [("plays", PrandtlIshlinskii(thresholds=THRESHOLDS)), ("lag", FirstOrderLag())]
    model = Cascade(steps, dt=DT).fit(X, y)
    assert model.operators_["lag"].time_constant == pytest.approx(0.05, rel=1e-4)
    np.testing.assert_allclose(model.operators_["plays"].weights, sign * WEIGHTS, rtol=1e-4)


def test_a_response_to_nothing_still_warns():
    with pytest.warns(ConvergenceWarning) as warned:
        PrandtlIshlinskii(thresholds=[0.5]).fit(np.zeros_like(X), U)
    assert any("follows the drive in neither direction" in str(own.message) for own in warned)
