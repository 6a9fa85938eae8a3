"""A mass without a spring: exact motion, sticking, and starts that belong to the record."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from skhyst.compose import Sum
from skhyst.diagnosis import EFFECTS
from skhyst.diagnosis._starts import starting_trees
from skhyst.diagnosis._tree import Tree
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import FreeMass, FreeMassOperator
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.operators import Series, SumOperator
from skhyst.optimize import OperatorProblem, RecordData

DT = 0.01
TIME = DT * np.arange(1200)
U = 2.0 * np.sin(1.7 * TIME) + 2.0 * np.sin(4.9 * TIME + 1.0) + np.sin(11.0 * TIME)


@pytest.mark.parametrize("damping", [0.0, 1e-9, 0.7])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_without_friction_it_is_a_double_integrator(damping, hold):
    """The exponential of the block matrix of Van Loan, one sample after the other."""
    m, offset, drift = 0.5, 0.3, 0.2
    mass = FreeMassOperator(
        m, damping, force_offset=offset, force_drift=drift, intercept=0.4, hold=hold
    )
    block = np.array([[0, 1, 0, 0], [0, -damping / m, 1 / m, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    step, u = expm(block * DT), U[:200]
    state, expected = np.array([0.4, 0.0]), [0.4]
    for k in range(1, len(u)):
        slope = drift + (0.0 if hold == "zoh" else (u[k] - u[k - 1]) / DT)
        force = u[k - 1] + offset + drift * DT * (k - 1)
        state = (step @ np.append(state, [force, slope]))[:2]
        expected.append(state[0])
    np.testing.assert_allclose(mass.run(u, DT)[0], expected, rtol=0.0, atol=1e-13)


def test_it_stops_turns_and_sticks_at_the_right_times():
    """At constant acceleration, in samples that the events lie within."""
    mass = FreeMassOperator(2.0, friction=1.0, friction_asymmetry=0.2, hold="zoh")
    dt, forces = 0.7, np.array([3.2, 3.2, 0.0, 0.0, 0.0, 0.0, 1.1, -0.7, -1.8, -1.8])
    y, state = mass.run(forces, dt)
    # forward friction is 1.2, backward 0.8: two samples at 1.0, then -0.6 down to rest
    v = 1.0 * 2 * dt
    assert y[2] == pytest.approx(0.5 * (2 * dt) ** 2)
    stop = y[2] + v**2 / (2 * 0.6)
    np.testing.assert_allclose(y[6:9], stop, rtol=1e-14)  # 1.1 and -0.7 hold it where it is
    assert y[9] == pytest.approx(stop - 0.5 * 0.5 * dt**2)
    assert state[1] == pytest.approx(-0.5 * dt)


def test_it_breaks_away_where_the_force_reaches_the_level():
    """On a ramp, from the time t_b on, m x'' = r (t - t_b)."""
    mass, rate = FreeMassOperator(2.0, friction=1.0, force_offset=0.25, intercept=0.3), 0.37
    time = 0.9 * np.arange(12)
    y, _ = mass.run(rate * time, 0.9)
    since = np.maximum(time - 0.75 / rate, 0.0)
    np.testing.assert_allclose(y, 0.3 + rate * since**3 / 12.0, rtol=1e-14)


@pytest.mark.parametrize("level", [0.999, -0.999])
def test_it_sticks_below_the_level(level):
    mass = FreeMassOperator(0.1, 0.2, friction=0.7, stribeck_force=0.3, stribeck_velocity=0.1)
    y, state = mass.run(np.full(500, level), DT)
    assert np.all(y == 0.0)
    assert state[1] == 0.0
    moved, _ = mass.run(np.full(500, 1.002 * level), DT)
    assert level * moved[-1] > 0.1


PLANT = FreeMassOperator(
    0.5,
    0.8,
    friction=0.4,
    stribeck_force=0.3,
    stribeck_velocity=0.5,
    friction_gradient=-1.7,
    friction_center=0.2,
    cubic_stiffness=0.6,
    center=0.1,
    stop_stiffness=80.0,
    stop_damping=0.3,
    upper=0.6,
    n_substeps=2,
)


SUBSTEPS = (2, 4, 8, 256)


def test_other_forces_are_of_second_order():
    """Against SciPy with a steep friction law in place of the jump."""

    def force(x, v):
        curve = (0.4 + 0.3 * np.exp(-((v / 0.5) ** 2))) * max(1.0 - 1.7 * (x - 0.2), 0.0)
        contact = (80.0 * (x - 0.6) + 0.3 * v) * (x > 0.6)
        return 0.8 * v + np.tanh(v / 1e-4) * curve + 0.6 * (x - 0.1) ** 3 + contact

    n = 300
    drive = lambda t: np.interp(t, TIME, 3.0 * U)  # noqa: E731
    found = solve_ivp(
        lambda t, s: [s[1], (drive(t) - force(*s)) / 0.5],
        (0.0, TIME[n - 1]),
        [0.0, 0.0],
        method="LSODA",
        t_eval=TIME[:n],
        rtol=1e-8,
        atol=1e-10,
        max_step=DT,
    )
    fine = dataclasses.replace(PLANT, n_substeps=256).run(3.0 * U[:n], DT)[0]
    np.testing.assert_allclose(fine, found.y[0], atol=2e-3 * np.ptp(fine))
    smooth = dataclasses.replace(PLANT, upper=np.inf)  # a contact begins within a substep
    runs = [dataclasses.replace(smooth, n_substeps=k).run(3.0 * U[:n], DT)[0] for k in SUBSTEPS]
    errors = [np.sqrt(np.mean((own - runs[-1]) ** 2)) for own in runs[:-1]]
    assert errors[0] > 3.5 * errors[1] > 12.0 * errors[2]


def test_a_run_that_diverges_is_cut_off():
    y, _ = FreeMassOperator(0.1, cubic_stiffness=-9.0, center=0.0).run(np.ones(400), DT)
    assert np.isnan(y[-1])
    assert np.abs(y[np.isfinite(y)]).max() < 1e51


@pytest.mark.parametrize(
    ("name", "value"), [("mass", 0.0), ("mass", -1.0), ("hold", "line"), ("n_substeps", 0)]
)
def test_wrong_parameters_are_refused(name, value):
    with pytest.raises(ValueError, match=f"'{name}' parameter of FreeMassOperator must be"):
        dataclasses.replace(FreeMassOperator(1.0), **{name: value})


@pytest.mark.parametrize("alone", [True, False])
def test_derivatives_by_the_start(alone):
    lag = FirstOrderLagOperator(0.03, gain=1.0)
    plant = PLANT if alone else Series(("mass", "lag"), (PLANT, lag))
    assert plant.n_start == 2
    record = RecordData(U[:150], np.zeros(150), DT, start=np.array([0.2, 1.3]))
    problem = OperatorProblem(plant, [record])
    h, found = 1e-6, problem.history_sensitivities(plant, record)
    for i in range(2):
        ends = [
            problem.simulate(plant, dataclasses.replace(record, start=record.start + move))
            for move in (h * np.eye(2)[i], -h * np.eye(2)[i])
        ]
        np.testing.assert_allclose(found[:, i], (ends[0] - ends[1]) / (2.0 * h), atol=1e-6)
    y, _ = problem.operator.sensitivities(record.u, np.empty((150, 0)), DT, record.start)
    np.testing.assert_allclose(y, problem.simulate(plant, record), atol=1e-13)


def noisy(operator, seed, u=U, start=None):
    y, _ = operator.run(u, DT, None if start is None else operator.init(u[0], start))
    return y + 1e-3 * np.ptp(y) * np.random.default_rng(seed).normal(size=len(y))


def assert_within(model, plant, errors=3.0):
    for name, value in model.params_.items():
        assert abs(value - getattr(plant, name)) < errors * model.params_std_[name], name


def test_parameters_are_found_within_their_errors():
    plant = FreeMassOperator(
        0.5, 0.8, 0.3, friction=1.0, force_offset=0.1, force_drift=0.02, intercept=0.3, hold="zoh"
    )
    model = FreeMass(True, damping_asymmetry=True, fit_force_drift=True, hold="zoh", dt=DT)
    model.fit(U[:, None], noisy(plant, 0))
    assert_within(model, plant)
    assert model.params_std_["mass"] < 0.01
    assert model.operator_.n_substeps == 1


@pytest.mark.slow
def test_friction_along_the_way_is_found_within_its_errors():
    """Its level is that at the middle of the response, where the gradient does not change it."""
    plant = FreeMassOperator(0.5, 0.8, friction=0.5, friction_gradient=0.3, friction_center=0.0)
    model = FreeMass(True, friction_gradient=True, fit_force_offset=False, dt=DT)
    found = model.fit(U[:, None], noisy(dataclasses.replace(plant, n_substeps=4), 0)).operator_
    at_middle = 1.0 + plant.friction_gradient * found.friction_center
    expected = {
        "friction": plant.friction * at_middle,
        "friction_gradient": plant.friction_gradient / at_middle,
    }
    assert_within(model, dataclasses.replace(plant, **expected))
    assert model.params_std_["friction_gradient"] < 0.02


def test_behind_missing_rows_it_begins_elsewhere():
    plant, kept = FreeMassOperator(0.5, 0.8, intercept=0.2), np.r_[0:200, 215:400]
    frame = pd.DataFrame({"force": U[:400]}, pd.Index(TIME[:400], name="time"))
    model = FreeMass().fit(frame.iloc[kept], noisy(plant, 0, U[:400])[kept])  # warnings are errors
    assert_within(model, plant)


@pytest.mark.slow
def test_rows_behind_missing_ones_are_left_out_beside_a_part_that_is_in_motion():
    u, kept = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 15), 20), np.r_[0:200, 240:300]
    u[:5] = 0.0
    plant = SumOperator(("mass", "lag"), (FreeMassOperator(0.5, 0.2), FirstOrderLagOperator(0.5)))
    frame = pd.DataFrame({"force": u}, pd.Index(TIME[:300], name="time"))
    model = Sum([("mass", FreeMass(fit_force_offset=False)), ("lag", FirstOrderLag())])
    with pytest.warns(ConvergenceWarning, match="60 rows behind missing rows are left out"):
        model.fit(frame.iloc[kept], noisy(plant, 0, u)[kept])
    for name, value in {"mass__mass": 0.5, "lag__time_constant": 0.5, "lag__gain": 1.0}.items():
        assert model.params_[name] == pytest.approx(value, abs=4.0 * model.params_std_[name])
        assert model.params_std_[name] < 0.05 * value


@pytest.mark.slow
def test_each_record_has_its_own_start():
    plant = FreeMassOperator(0.5, 0.8, friction=1.0, force_offset=0.1)
    starts = np.array([[3.0, 1.5], [-2.0, -0.7]])
    drives = [U[:600], U[600:]]
    index = pd.MultiIndex.from_product([["a", "b"], TIME[:600]], names=["record", "time"])
    y = np.concatenate(
        [noisy(plant, k, drives[k], start) for k, start in enumerate(starts)],
    )
    X, y = pd.DataFrame({"force": U}, index), pd.Series(y, index)
    model = FreeMass(True, initial_state="estimate").fit(X, y)
    assert_within(model, plant)
    np.testing.assert_allclose(model.initial_values_, starts, atol=0.05)
    assert model.operator_.intercept == pytest.approx(model.initial_values_[:, 0].mean())
    assert "intercept" not in model.params_
    known = y.where(np.tile(np.arange(600) < 100, 2))
    error = model.predict(X, y_start=known) - y
    assert np.sqrt(np.mean(error**2)) < 3.0 * model.fit_error_


def test_asymmetry_is_an_offset_where_the_mass_slides():
    plant = FreeMassOperator(0.5, 0.8, friction=1.0, friction_asymmetry=0.2)
    model = FreeMass(True, friction_asymmetry=True, dt=DT)
    slides = 1.0 + 3.0 * np.sign(np.sin(3.0 * TIME))  # it turns at once, and never rests
    with pytest.warns(ConvergenceWarning, match="do not determine .*force_offset"):
        model.fit(slides[:, None], noisy(plant, 1, slides))


@pytest.mark.parametrize(
    ("effect", "entry"),
    [
        ("friction", "friction"),
        ("friction", "friction_gradient"),
        ("offset", "force_offset"),
        ("drift", "force_drift"),
        ("cubic_stiffness", "cubic_stiffness"),
        ("end_stops", "upper"),
    ],
)
def test_an_effect_is_one_more_force(effect, entry):
    """What it adds is free to move, and the model that is declared stays as it is otherwise."""
    plant = FreeMassOperator(0.5, 0.8, friction=0.5, force_offset=0.1, force_drift=0.02)
    model = FreeMass(fit_force_offset=False, dt=DT)
    record = RecordData(U[:400], noisy(plant, 0, U[:400]), DT)
    declared = Tree.of(model, FreeMassOperator(0.5, 0.8))
    found = [own for group in starting_trees(EFFECTS[effect], declared, [record]) for own in group]
    richer = [own for own in found if own.edits[0][1].kind == "exchange"]
    assert richer
    for tree in richer:
        assert isinstance(tree.model, FreeMass)
        assert tree.model.dt == DT
    moves = [
        own
        for own in richer
        if entry in dict(own.operator.entries()) and entry not in own.model.held_parameters()
    ]
    assert moves
    assert any(getattr(own.operator, entry) != 0.0 for own in moves)
