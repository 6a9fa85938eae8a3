"""Polynomials and stop of a stage; what holds for all stages is in test_oscillator.py."""

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from skhyst.hysteresis import RestoringForce, RestoringForceOperator
from skhyst.hysteresis._restoring_force import slide
from skhyst.optimize import VariableProjection

W, ZETA, K, LIMIT = 60.0, 0.3, 4.0, 0.2
DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
SCALE = 0.5 * np.ptp(U)


@pytest.mark.parametrize("z", [-0.3, -0.1, 0.0, 0.2, 0.3])
@pytest.mark.parametrize("c", [-2.0, -0.3, -0.01, 0.01, 0.05, 0.4, 3.0])
def test_slide_solves_its_equation(c, z):
    b, k, limit = 0.4, 2.5, 0.3
    delta, mean, new, part = slide(c, b, z, k, limit)

    def force(part):
        return np.clip(z + k * part * delta, -limit, limit)

    average = quad(force, 0.0, 1.0, limit=200)[0]
    assert mean == pytest.approx(average, abs=1e-7)
    assert delta == pytest.approx(c - b * mean, abs=1e-14)
    assert new == pytest.approx(force(1.0), abs=1e-14)
    assert (part < 1.0) == (abs(z + k * delta) > limit)
    # the force grows on this part of the way only
    assert abs(z + k * part * delta) <= limit * (1.0 + 1e-12)
    assert force(part) == pytest.approx(new, abs=1e-14)


def test_force_unloads_when_the_motion_turns_round():
    """As (7) is printed it would stay at its limit for ever."""
    stage = RestoringForceOperator(W, ZETA, [0.3, 0.1], [0.2], K, LIMIT)
    u = np.interp(np.arange(4001) / 1000.0, [0, 1, 2, 3, 4], [0.0, 1.0, -1.0, 1.0, 0.0])
    state, forces = stage.init(0.0), []
    for value in u:
        state, _ = stage.step(state, value, 0.01)
        forces.append(state[2])
    assert max(forces) == pytest.approx(LIMIT)
    assert min(forces) == pytest.approx(-LIMIT)
    assert np.abs(np.diff(forces)).max() < 0.05 * LIMIT


def test_slow_loop_encloses_the_work_of_the_slips():
    """Quasi-static: the width of the loop between both branches is twice the slip level."""
    stage = RestoringForceOperator(W, ZETA, [], [], K, LIMIT)
    u = np.interp(np.arange(5001) / 1000.0, [0, 1, 3, 5], [0.0, 1.0, -1.0, 1.0])
    y, _ = stage.run(u, 1.0)
    down, up = y[1000:3001], y[3000:]
    middle = np.interp(0.0, u[3000:], up) - np.interp(0.0, -u[1000:3001], down)
    assert middle == pytest.approx(-2.0 * LIMIT, rel=1e-3)


def test_rest_without_equilibrium_is_finite():
    """A softening spring holds no more than so much."""
    stage = RestoringForceOperator(W, ZETA, [-0.5], [], K, LIMIT)
    state = stage.init(30.0)
    assert np.isfinite(state).all()


def test_rest_under_a_force_of_any_size():
    """Far out a hardening spring is cubic: a root finder comes there in many steps."""
    stage = RestoringForceOperator(W, ZETA, [0.2], [], 0.0, 0.0, scale=40.0)
    place, *_ = stage.init(-1.18e24)
    assert place + 0.2 * place**3 / 40.0**2 == pytest.approx(-1.18e24)


def test_wrong_scale():
    with pytest.raises(ValueError, match="'scale' parameter of RestoringForceOperator"):
        RestoringForceOperator(W, ZETA, [], [], K, LIMIT, scale=0.0)


@pytest.mark.parametrize(("gain", "unit"), [(3.0, 1e-6), (-3.0, 1e3)])
def test_duffing_oscillator(gain, unit):
    """Without hysteresis, the preload in the even term; against an integration in plain SciPy."""

    def motion(t, x):
        force = np.interp(t, TIME, U) + 0.2 - x[0] - 0.3 * x[0] ** 3 - x[1] / 20.0 * 0.3
        return [x[1], 400.0 * force]

    rest = np.roots([0.3, 0.0, 1.0, -0.2 - U[0]])
    rest = float(rest[np.isreal(rest)][0].real)
    q = solve_ivp(motion, (0.0, TIME[-1]), [rest, 0.0], t_eval=TIME, rtol=1e-8, max_step=DT).y[0]
    y = unit * (gain * q + 0.5)
    model = RestoringForce(3, damping_degree=1, fit_hysteresis=False, dt=DT).fit(U[:, None], y)
    expected = {
        "natural_frequency": 20.0,
        "damping_ratio": 0.15,
        "stiffness_coefficients[0]": 0.3 * SCALE**2,
        "preload": 0.2,
        "gain": unit * gain,
        "intercept": unit * 0.5,
    }
    assert model.params_ == pytest.approx(expected, rel=5e-3)
    assert model.fit_error_ < 1e-3 * np.std(y)
    assert np.isnan(model.physical_["x_s"])
    found = RestoringForce(3, damping_degree=1, fit_hysteresis=False, fit_preload=False, dt=DT)
    assert found.fit(U[:, None], y).operator_.preload == 0.0


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize(("degree", "size"), [(1, 0), (2, 0), (3, 1), (5, 2), (6, 2)])
def test_degrees(degree, size):
    plant = RestoringForceOperator(20.0, 0.3, [0.4], [0.3], 4.0, 0.3, 0.2, scale=SCALE)
    y, _ = plant.run(U[:400], DT)
    for name, other in (("stiffness", "damping"), ("damping", "stiffness")):
        options = {f"{name}_degree": degree, f"{other}_degree": 1}
        options["method"] = VariableProjection(max_evaluations=1)  # wherever the fit ends
        model = RestoringForce(n_substeps=2, dt=DT, **options).fit(U[:400, None], y)
        assert len(getattr(model.operator_, f"{name}_coefficients")) == size
        # the preload of a linear spring is an intercept
        assert ("preload" in model.params_) == (name == "stiffness" and size > 0)
