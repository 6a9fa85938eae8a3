"""A system of python-control answers what the model answers."""

import sys

import numpy as np
import pytest
from operator_cases import DT, OPERATORS, make_drive
from scipy.signal import lti

from skhyst.compose import Cascade
from skhyst.export import to_control
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import (
    DelayOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
)
from skhyst.operators import Series, Stepper

control = pytest.importorskip("control", reason="systems are those of the extra control")
LINEAR = [name for name, operator in OPERATORS.items() if operator.signal_linear]
LINEAR = [  # equations of motion are stepped by their own rule, also where no force is curved
    name
    for name in LINEAR
    if OPERATORS[name].causal
    and not OPERATORS[name].is_disturbance
    and not any(own in name for own in ("stage", "free mass"))
]
CURVED = ["plays", "Bouc-Wen", "both limits", "sum", "friction stage", "free mass"]


def answers(system, u):
    """Return the response to a drive, from rest."""
    time = DT * np.arange(len(u))
    if isinstance(system, control.StateSpace):
        return control.forced_response(system, time, u).outputs
    return control.input_output_response(system, time, u).outputs


@pytest.mark.parametrize("name", LINEAR)
def test_what_is_linear_is_a_state_space(name):
    operator, u = OPERATORS[name], make_drive()
    u = np.append(np.zeros(8), u - u[0])  # differences begin with fewer samples
    system = to_control(operator, DT)
    assert isinstance(system, control.StateSpace)
    assert system.dt == DT
    y, _ = operator.run(u, DT)
    rest, _ = operator.run(np.zeros(len(u)), DT)
    np.testing.assert_allclose(answers(system, u), y - rest, atol=1e-11 * np.ptp(y))


@pytest.mark.parametrize("name", CURVED)
def test_all_else_is_its_step(name):
    operator, u = OPERATORS[name], make_drive()
    system = to_control(operator, DT, u0=u[0])
    assert system.dt == DT
    state = operator.init(u[0])
    expected = Stepper(operator.compiled_step(DT, state)).run(u)
    np.testing.assert_allclose(answers(system, u), expected, atol=1e-12 * np.ptp(expected))


def test_the_response_at_a_frequency_is_that_of_the_model():
    """Between samples the drive is a straight line, which is (sin(x) / x)^2 of a sine."""
    mode, delay, dt = SecondOrderModeOperator(300.0, 0.1, 2.0, 0.5), DelayOperator(3e-3), 1e-4
    system = to_control(Series(("delay", "mode"), (delay, mode)), dt)
    frequency = np.array([1.0, 30.0, 60.0])
    late = np.exp(-2j * np.pi * frequency * delay.delay)
    found = system(np.exp(2j * np.pi * frequency * dt))
    expected = late * mode.frequency_response(frequency)
    assert np.abs(found / expected - 1.0).max() < (np.pi * 60.0 * dt) ** 2


def test_fitted_models_close_a_loop():
    time = DT * np.arange(400)
    u = 3.0 * np.sin(2.0 * time) * np.cos(7.0 * time)
    plays, mode = OPERATORS["plays"], SecondOrderModeOperator(30.0, 0.4)
    y, _ = mode.run(plays.run(u, DT)[0], DT)
    stages = [("plays", PrandtlIshlinskii(3)), ("mode", SecondOrderMode())]
    model = Cascade(stages, dt=DT).fit(u[:, None], y)
    system = to_control(model)
    np.testing.assert_allclose(answers(system, u), model.predict(u[:, None]), atol=1e-9)
    linear = SecondOrderMode(dt=DT).fit(u[:, None], y)
    assert isinstance(to_control(linear), control.StateSpace)
    integral = control.tf([2.0 * DT], [1.0, -1.0], dt=DT, inputs="e", outputs="u")
    error = control.summing_junction(["r", "-y"], "e")
    stage = control.nlsys(
        system.updfcn, system.outfcn, inputs="u", outputs="y", states=system.nstates, dt=DT
    )
    loop = control.interconnect([error, integral, stage], inputs="r", outputs="y")
    steps = control.input_output_response(loop, time, np.ones(len(time))).outputs
    assert abs(steps[-1] - 1.0) < 1e-3


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_there_and_back_with_a_delay(hold):
    """A system in discrete time is the model again, whose delay is a number of samples."""
    system = lti([3.0, 40.0], [1.0, 8.0, 900.0])
    model = TransferFunction.from_system(system, hold=hold, delay=3 * DT, dt=DT)
    again = TransferFunction.from_system(to_control(model, DT), hold=hold)
    assert again.params_ == pytest.approx(model.params_, rel=1e-8)
    assert (again.delay, again.dt) == (pytest.approx(3 * DT), DT)


def test_what_is_missing_is_told(monkeypatch):
    with pytest.raises(ValueError, match="'dt' parameter of to_control"):
        to_control(OPERATORS["lag"])
    with pytest.raises(NotImplementedError, match="looks ahead"):
        to_control(OPERATORS["time shift, ahead"], DT)
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ImportError, match=r"skhyst\[control\]"):
        to_control(OPERATORS["lag"], DT)
