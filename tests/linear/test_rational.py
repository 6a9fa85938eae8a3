"""Rational transfer functions of several inputs, and conversions from and to other packages."""

import pickle

import numpy as np
import pytest
from scipy import signal

from skhyst.linear import (
    DelayOperator,
    MultiInputTransferFunctionOperator,
    TransferFunctionOperator,
)
from skhyst.operators import Stepper

DT, N = 0.01, 60
FREQUENCY = np.geomspace(0.01, 100.0, 40)
PARTS = np.array([0.02]), np.array([70.0]), np.array([0.3])


def make(delays=(), hold="foh"):
    numerators, gains = np.array([[0.2, -0.1], [1.0, 0.3]]), np.array([1.3, -0.4])
    return MultiInputTransferFunctionOperator(
        *PARTS, numerators, gains, np.array(delays), 0.4, hold
    )


OPERATORS = {
    "straight": make(),
    "held": make(hold="zoh"),
    "delayed": make((0.013, 0.0371)),
    "one delayed": make((0.0, 0.0371)),
}


@pytest.fixture(params=OPERATORS)
def operator(request):
    return OPERATORS[request.param]


@pytest.fixture
def u():
    return 0.4 + np.cumsum(np.random.default_rng(0).normal(size=(N, 2)), axis=0)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_output_is_the_sum_of_the_inputs_own(operator, u, initial_state):
    total = 0.4
    for i in range(2):
        v = u[:, i]
        if len(operator.delays):
            delay = DelayOperator(operator.delays[i])
            v = delay.run(v, DT, delay.init(v[0], initial_state))[0]
        part = operator.part(i)
        total = total + part.run(v, DT, part.init(v[0], initial_state))[0]
    y, _ = operator.run(u, DT, operator.init(u[0], initial_state))
    np.testing.assert_allclose(y, total, rtol=1e-9, atol=1e-9)
    assert len(operator.init(u[0])[0]) == len(operator.poles()) == 3


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_tangents_are_central_differences(operator, u, initial_state):
    y, dy = operator.sensitivities(u, np.empty((N, 0)), DT, initial_state)
    free_run = operator.run(u, DT, operator.init(u[0], initial_state))[0]
    np.testing.assert_allclose(y, free_run, rtol=1e-11, atol=1e-11)
    gain, by = operator.frequency_tangents(FREQUENCY)
    np.testing.assert_allclose(gain, operator.frequency_response(FREQUENCY), rtol=1e-12)
    vector = operator.pack()
    assert len(operator.entries()) == len(vector)
    for j in np.flatnonzero(vector):
        h = np.zeros(len(vector))
        h[j] = 1e-6 * abs(vector[j])
        above, below = operator.unpack(vector + h), operator.unpack(vector - h)
        runs = [o.run(u, DT, o.init(u[0], initial_state))[0] for o in (above, below)]
        found = (runs[0] - runs[1]) / (2.0 * h[j])
        np.testing.assert_allclose(dy[:, j], found, atol=1e-6 * np.abs(found).max())
        found = above.frequency_response(FREQUENCY) - below.frequency_response(FREQUENCY)
        scale = max(np.abs(by[:, :, j]).max(), 1e-3)
        np.testing.assert_allclose(by[:, :, j], found / (2.0 * h[j]), atol=1e-6 * scale)


def test_cut_stepped_and_pickled(operator, u):
    whole, _ = operator.run(u, DT)
    state, y = operator.init(u[0]), []
    for part in np.split(u, [1, 7, 30]):
        own, state = operator.run(part, DT, state)
        y.append(own)
    np.testing.assert_allclose(np.concatenate(y), whole, rtol=1e-11, atol=1e-12)
    again, state = pickle.loads(pickle.dumps(operator)), operator.init(u[0])
    stepped = np.empty(N)
    for k in range(N):
        state, stepped[k] = again.step(state, u[k], DT)
    np.testing.assert_allclose(stepped, whole, rtol=1e-11, atol=1e-12)
    stepper = Stepper(operator.compiled_step(DT, operator.init(u[0])))
    compiled_step = [stepper.step(row) for row in u[:7]]
    _, middle = operator.run(u[:7], DT)
    for behind in (stepper, Stepper(operator.compiled_step(DT, middle))):
        found = np.append(compiled_step, behind.run(u[7:]))
        np.testing.assert_allclose(found, whole, rtol=0, atol=1e-12 * max(np.ptp(whole), 1.0))


def test_nothing_comes_before_it(u):
    with pytest.raises(ValueError, match="must come first"):
        OPERATORS["straight"].sensitivities(u, np.ones((N, 1)), DT)


@pytest.mark.parametrize(("n_first", "n_second"), [(0, 1), (1, 0), (1, 1), (1, 2), (2, 1), (0, 2)])
def test_numerator_spans_every_polynomial_of_its_degree(n_first, n_second):
    tau = np.array([0.3, 1.7])[:n_first]
    w, zeta = np.array([1.1, 2.3])[:n_second], np.array([0.2, 0.7])[:n_second]
    degree = n_first + 2 * n_second
    # as many points as coefficients, on a circle: N = G D is then a polynomial known exactly
    s = 1.5 * np.exp(2j * np.pi * np.arange(degree + 1) / (degree + 1))
    denominator = np.ones_like(s)
    for value in tau:
        denominator *= value * s + 1
    for a, b in zip(w, zeta, strict=True):
        denominator *= s**2 / a**2 + 2 * b * s / a + 1
    for n_zeros in range(degree + 1):
        rows = []
        for weights in np.vstack([np.zeros(n_zeros), np.eye(n_zeros)]):
            operator = TransferFunctionOperator(tau, w, zeta, weights)
            a, b, c, d = operator.state_space()
            gains = [c @ np.linalg.solve(point * np.eye(degree) - a, b) + d for point in s]
            values = gains * denominator
            rows.append(np.fft.fft(values) / (degree + 1) / 1.5 ** np.arange(degree + 1))
        coefficients = np.array(rows)
        np.testing.assert_allclose(coefficients[:, n_zeros + 1 :], 0.0, atol=1e-12)
        np.testing.assert_allclose(coefficients[:, 0], 1.0, rtol=1e-12)  # static gain
        assert np.linalg.matrix_rank(coefficients, tol=1e-9) == n_zeros + 1


# --------------------------------------------------------------------------------- other packages

SYSTEMS = {
    "transfer function": signal.TransferFunction([3.0, 4.0], [1.0, 3.0, 2.0]),
    "zeros, poles, gain": signal.ZerosPolesGain([-3, -40], [-2, -100, -5 + 60j, -5 - 60j], 1000.0),
    "feed-through": signal.TransferFunction([2.0, 1.0], [1.0, 3.0]),
    "equal poles": signal.TransferFunction([1.0], [1.0, 2.0, 1.0]),
    "decades apart": signal.ZerosPolesGain([-1.0], [-1e-3, -1e4], 1.0),
    "unstable": signal.TransferFunction([1.0], [1.0, 1.0, -2.0]),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_from_scipy_and_back(name):
    system = SYSTEMS[name]
    operator = TransferFunctionOperator.from_scipy(system)
    omega = np.geomspace(0.1, 10.0, 30) * np.abs(system.poles).max()
    expected = signal.freqresp(system, omega)[1]
    found = operator.frequency_response(omega / (2.0 * np.pi))
    np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())
    for roots in ("poles", "zeros"):
        expected = np.sort_complex(np.asarray(getattr(system, roots), dtype=complex))
        own = np.sort_complex(getattr(operator, roots)())
        np.testing.assert_allclose(own, expected, rtol=1e-6)
    again = TransferFunctionOperator.from_scipy(operator.to_scipy())
    np.testing.assert_allclose(again.frequency_response(omega / (2.0 * np.pi)), found, rtol=1e-6)


def test_two_inputs_to_scipy_and_back():
    again = TransferFunctionOperator.from_scipy(OPERATORS["straight"].to_scipy())
    expected = OPERATORS["straight"].frequency_response(FREQUENCY)
    np.testing.assert_allclose(again.frequency_response(FREQUENCY), expected, rtol=1e-7)
    with pytest.raises(ValueError, match="delay"):
        OPERATORS["delayed"].to_scipy()


@pytest.mark.parametrize(
    ("system", "message"),
    [
        (signal.dlti([1.0], [1.0, 0.5], dt=0.1), "continuous time"),
        (signal.TransferFunction([1.0], [1.0, 0.0]), "no pole at zero"),
        (signal.TransferFunction([2.0], [1.0]), "at least one pole"),
        (signal.TransferFunction([1.0, 2.0, 3.0], [0.1, 1.0]), "no more zeros than poles"),
        (signal.ZerosPolesGain([-1.0, -2.0], [-3.0], 1.0), "no more zeros than poles"),
        (signal.StateSpace([[-1.0]], [[1.0]], [[1.0], [2.0]], [[0.0], [0.0]]), "one response"),
    ],
)
def test_systems_that_are_refused(system, message):
    with pytest.raises(ValueError, match=message):
        TransferFunctionOperator.from_scipy(system)
    with pytest.raises(TypeError, match=r"scipy\.signal\.lti"):
        TransferFunctionOperator.from_scipy(3.0)
