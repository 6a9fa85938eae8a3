"""What every operator must do, whatever it is."""

import copy
import dataclasses
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from operator_cases import DT, OPERATORS, N, make_drive, responses

import skhyst
from skhyst.discovery import all_operators
from skhyst.linear import MultiInputTransferFunctionOperator
from skhyst.operators import (
    InverseOperator,
    OnColumnOperator,
    Scaled,
    Stepper,
    check_operator,
)
from skhyst.static import StaticOperator

ABSTRACT = {StaticOperator}
# in test_multi_input.py and test_columns.py
SEVERAL_INPUTS = {MultiInputTransferFunctionOperator, OnColumnOperator, Scaled}
UNDRIVEN = {"drift", "sinusoid", "sum"}  # they go on by themselves
# an integrator has no rest, nor has a mass without a spring, unless friction holds it
UNDRIVEN |= {name for name in OPERATORS if "free mass" in name and "rigid" not in name}
UNDRIVEN |= {name for name in OPERATORS if "integrator" in name}


@pytest.fixture(params=OPERATORS, scope="module")
def name(request):
    return request.param


@pytest.fixture(scope="module")
def operator(name):
    return OPERATORS[name]


@pytest.fixture(scope="module")
def u():
    return make_drive()


def flatten(state):
    """Turn a state into numbers."""
    if isinstance(state, tuple):
        return np.concatenate([np.empty(0), *(flatten(part) for part in state)])
    if dataclasses.is_dataclass(state):
        return flatten(dataclasses.astuple(state))
    return np.ravel(np.asarray(state, dtype=float))


def test_every_operator_is_covered():
    classes = {kind for _, kind in all_operators() if not issubclass(kind, InverseOperator)}
    assert classes - ABSTRACT - SEVERAL_INPUTS == {type(op) for op in OPERATORS.values()}


@settings(deadline=None, max_examples=8)
@given(
    initial_state=st.sampled_from(["rest", "zero"]),
    cuts=st.lists(st.integers(1, N - 1), max_size=5, unique=True),
)
def test_cut_signal_gives_the_whole(operator, u, initial_state, cuts):
    """So the past does not know the future either."""
    if not operator.causal:
        pytest.skip("it looks ahead")
    state = operator.init(u[0], initial_state)
    whole, last = operator.run(u, DT, state)
    parts = []
    for part in np.split(u, sorted(cuts)):
        y, state = operator.run(part, DT, state)
        parts.append(y)
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(flatten(state), flatten(last), rtol=1e-11, atol=1e-12)


def test_step_by_step_from_rest_equals_run(operator, u):
    if not operator.causal:
        pytest.skip("it looks ahead")
    state = operator.init(u[0])
    y = np.empty(N)
    for k, value in enumerate(u):
        state, y[k] = operator.step(state, value, DT)
    np.testing.assert_allclose(y, operator.run(u, DT)[0], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_compiled_step_equals_run(name, operator, u, initial_state):
    """Sample by sample, at once, from a state that was kept, and from a state in mid-run."""
    state = operator.init(u[0], initial_state)
    if not operator.causal:
        with pytest.raises(NotImplementedError, match="cannot be stepped"):
            operator.compiled_step(DT, state)
        return
    expected, _ = operator.run(u, DT, state)
    compiled_step, cut = operator.compiled_step(DT, state), N // 3
    stepper = Stepper(compiled_step)
    steps = [stepper.step(value) for value in u[:cut]]
    kept = stepper.state
    steps += [stepper.step(value) for value in u[cut:]]
    stepper.state = kept
    middle = Stepper(operator.compiled_step(DT, operator.run(u[:cut], DT, state)[1]))
    tolerance = 1e-12 * max(np.ptp(expected), 1.0)
    for found in (steps, Stepper(compiled_step).run(u), stepper.run(u[cut:]), middle.run(u[cut:])):
        np.testing.assert_allclose(found, expected[-len(found) :], rtol=0, atol=tolerance)


def test_the_state_of_a_stepper_is_all_that_it_remembers(operator, u):
    """One that has rested elsewhere, or moved another way, goes on alike from a state."""
    if not operator.causal:
        return
    stepper = Stepper(operator.compiled_step(DT, operator.init(u[0])))
    stepper.run(u[:20])
    kept, expected = stepper.state, stepper.run(u[20:])
    for state in (
        operator.init(u[0] + 0.7),
        operator.init(u[0], "zero"),
        operator.run(0.5 - u[:31], DT)[1],
    ):
        other = Stepper(operator.compiled_step(DT, state))
        other.state = kept
        np.testing.assert_array_equal(other.run(u[20:]), expected)


def test_sensitivities_returns_what_run_returns(operator, u):
    for initial_state in ("rest", "zero"):
        y, dy = operator.sensitivities(u, np.ones((N, 2)), DT, initial_state)
        expected, _ = operator.run(u, DT, operator.init(u[0], initial_state))
        np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-13)
        assert dy.shape == (N, 2 + operator.n_parameters)
        assert dy.flags.c_contiguous


def test_derivatives_and_pieces(operator, u):
    for start in (0.4, 0.0, -0.4):
        check_operator(operator, u - u[0] + start, DT)


def test_tangents_are_carried_one_by_one(operator, u):
    du = np.cumsum(np.random.default_rng(0).normal(size=(N, 2)), axis=0)
    _, both = operator.sensitivities(u, du, DT)
    _, alone = operator.sensitivities(u, np.empty((N, 0)), DT)
    np.testing.assert_allclose(alone, both[:, 2:], rtol=1e-12, atol=1e-13)
    for j in range(2):
        _, one = operator.sensitivities(u, du[:, [j]], DT)
        np.testing.assert_allclose(one, both[:, [j, *range(2, both.shape[1])]], 1e-12, 1e-13)


@pytest.mark.parametrize("driven", sorted(set(OPERATORS) - {"drift", "sinusoid"}))
def test_behind_a_step_only_what_moves_at_rest_moves(driven, u):
    operator = OPERATORS[driven]
    if not operator.moves_at_rest:
        y, _ = operator.run(np.append(u[:20], np.full(N, 0.37)), DT, operator.init(u[0]))
        np.testing.assert_allclose(y[35:], y[-1], rtol=1e-12)  # behind a delay of 9 samples


@pytest.mark.parametrize("driven", sorted(set(OPERATORS) - UNDRIVEN))
def test_rest_stays_at_rest(driven):
    operator = OPERATORS[driven]
    for level in (0.0, 0.4, -1.3):
        y, state = operator.run(np.full(N, level), DT, operator.init(level, "rest"))
        np.testing.assert_allclose(y, y[0], rtol=1e-12, atol=1e-13)
        later, _ = operator.run(np.full(N, level), DT, state)
        np.testing.assert_allclose(later, y[0], rtol=1e-11, atol=1e-12)


def test_states_and_inputs_are_left_alone(operator, u):
    signal, du = u.copy(), np.ones((N, 1))
    _, state = operator.run(signal, DT)
    kept = copy.deepcopy(state)
    vector = operator.pack()
    first = operator.run(signal, DT, state)[0]
    operator.step(state, 3.0, DT)
    operator.sensitivities(signal, du, DT)
    np.testing.assert_array_equal(flatten(state), flatten(kept))
    np.testing.assert_array_equal(operator.run(signal, DT, state)[0], first)
    np.testing.assert_array_equal(signal, u)
    np.testing.assert_array_equal(du, 1.0)
    np.testing.assert_array_equal(operator.pack(), vector)


def test_read_only_and_strided_inputs(operator, u):
    expected = operator.run(u, DT)[0]
    _, dy = operator.sensitivities(u, np.ones((N, 1)), DT)
    frozen, du = u.copy(), np.ones((N, 1))
    frozen.flags.writeable = du.flags.writeable = False
    np.testing.assert_array_equal(operator.run(frozen, DT)[0], expected)
    np.testing.assert_array_equal(operator.sensitivities(frozen, du, DT)[1], dy)
    strided = np.stack([u, -u], axis=1)[:, 0]
    np.testing.assert_array_equal(operator.run(strided, DT)[0], expected)
    np.testing.assert_array_equal(
        operator.sensitivities(strided, np.ones((N, 2))[:, ::2], DT)[1], dy
    )


def test_pack_and_unpack_are_inverse(operator, u):
    vector = operator.pack()
    assert vector.shape == (operator.n_parameters,)
    assert len(operator.entries()) == operator.n_parameters
    assert len({name for name, _ in operator.entries()}) == operator.n_parameters
    again = operator.unpack(vector)
    np.testing.assert_array_equal(again.run(u, DT)[0], operator.run(u, DT)[0])
    moved = operator.unpack(1.01 * vector)
    np.testing.assert_array_equal(moved.pack(), 1.01 * vector)
    np.testing.assert_array_equal(operator.pack(), vector)


def test_linear_parameters_are_linear_all_at_once(operator, u):
    """The second difference of the output along any direction of them is zero."""
    mask = np.array([spec.linear for _, spec in operator.entries()], dtype=bool)
    rng = np.random.default_rng(1)
    direction = np.where(mask, rng.normal(size=mask.size), 0.0)
    y = [operator.unpack(operator.pack() + a * direction).run(u, DT)[0] for a in (0.0, 1.0, 2.0)]
    np.testing.assert_allclose(y[2] - 2 * y[1] + y[0], 0.0, atol=1e-11)
    if mask.any():
        assert np.abs(y[1] - y[0]).max() > 1e-3


def test_signal_linear_means_affine_in_the_signal(name, operator, u):
    other = np.cos(np.arange(N) / 5.0)
    y = [operator.run(u + a * other, DT)[0] for a in (0.0, 1.0, 2.0)]
    bent = np.abs(y[2] - 2 * y[1] + y[0]).max() > 1e-9
    assert bent == (not (operator.signal_linear or name == "no limit"))


def test_it_keeps_the_model_that_it_belongs_to(operator):
    own = dataclasses.replace(operator, model="its own")
    whole = pickle.loads(pickle.dumps(own)), copy.deepcopy(own)
    for again in (own.unpack(own.pack()), own.at(2.0), *whole):
        assert again.model == "its own"
    assert repr(own) == repr(operator)
    assert own.released().model is None


def test_pickle_and_copy_keep_the_output(operator, u):
    expected = operator.run(u, DT)[0]
    operator.sensitivities(u, np.empty((N, 0)), DT)
    for again in (pickle.loads(pickle.dumps(operator)), copy.deepcopy(operator)):
        np.testing.assert_array_equal(again.run(u, DT)[0], expected)


def test_operators_are_frozen(operator):
    field = next(iter(dataclasses.fields(operator)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(operator, field.name, None)


# ------------------------------------------------------------------------------- compiled loops

PLAIN = (
    "import operator_cases, pickle, sys; pickle.dump(operator_cases.responses(), sys.stdout.buffer)"
)


@pytest.fixture(scope="module")
def plain():
    folders = [Path(skhyst.__file__).parents[1], Path(__file__).parent]
    environment = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(map(str, folders)),
    }
    run = subprocess.run([sys.executable, "-c", PLAIN], env=environment, capture_output=True)
    assert run.returncode == 0, run.stderr.decode()
    return pickle.loads(run.stdout)


def test_compiled_equals_plain_python(plain):
    compiled = responses()
    assert set(compiled) == set(plain)
    for name, found in compiled.items():
        scale = np.abs(plain[name]).max(axis=0, initial=1e-300)
        np.testing.assert_allclose(
            found / scale, plain[name] / scale, rtol=0, atol=1e-12, err_msg=name
        )
