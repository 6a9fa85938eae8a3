"""Several inputs and responses with loops: derivatives, recovery, stepping, refusals."""

import numpy as np
import pytest

from skhyst.compose import ModalFeedback, SampledFeedback
from skhyst.compose._modal_feedback import _Problem
from skhyst.exceptions import ConvergenceWarning, ExtrapolationWarning
from skhyst.linear import ModalModel, SampledStateSpace
from skhyst.optimize._variable_projection import Solution
from skhyst.persistence import from_json, to_json

DT = 0.01


def device(n_outputs=2):
    """Return a real pole and a pair with two loops, two inputs."""
    a = np.array([[0.4, 0.0, 0.0], [0.0, 0.7, 0.5], [0.0, -0.5, 0.7]])
    b, c = np.array([[0.4, -0.6], [1.0, 0.3], [0.2, 0.5]]), np.array([[0.5, 1.0, 0.0], [1, 0.2, 1]])
    d, intercept = np.array([[0.0, 0.1], [0.2, 0.0]]), np.array([0.3, -0.2])
    linear = SampledStateSpace(a, b, c[:n_outputs], d[:n_outputs], DT, intercept[:n_outputs])
    e, f = (
        np.array([[0.1, 0.2], [0.2, 0.0], [0.0, -0.3]]),
        np.array([[0.2, 0.5, 0], [-0.3, 0, 0.4]]),
    )
    return SampledFeedback(linear, e, f, np.array([[0.1, 0.0], [0.0, 0.3]]), np.array([0.2, -0.5]))


def test_derivatives():
    """Those of the solver agree with central differences, the state at rest among them."""
    u = np.random.default_rng(0).normal(size=(30, 2))
    problem = _Problem([(u, device().run(u, DT)[0])], device(), 0)
    operator = problem.operator(problem.x0)
    np.testing.assert_allclose(operator.run(u, DT)[0], device().run(u, DT)[0], rtol=1e-11)
    _, dy = problem.tangents(operator, u, *problem.begun(operator, u[0]))
    for k in range(len(problem.x0)):
        ends = []
        for sign in (1.0, -1.0):
            x = problem.x0.copy()
            x[k] += sign * 1e-5
            ends.append(problem.operator(x).run(u, DT)[0])
        found = (ends[0] - ends[1]) / 2e-5
        np.testing.assert_allclose(dy[:, :, k], found, atol=1e-6 * np.abs(dy).max())


def test_derivatives_of_the_poles_and_what_is_determined():
    """At rest under any inputs; scaled and turned states leave three directions undetermined."""
    u, u0 = np.random.default_rng(0).normal(size=(200, 2)), np.array([0.7, -0.4])
    y = device().run(u, DT)[0]
    problem = _Problem([(u, y)], device(), 0)
    poles, by = problem.pole_slopes(problem.x0, u0)
    for k in range(len(problem.x0)):
        ends = []
        for sign in (1.0, -1.0):
            x = problem.x0.copy()
            x[k] += sign * 1e-5
            moved = problem.operator(x).poles_at(u0)
            ends.append([moved[np.argmin(np.abs(moved - pole))] for pole in poles])
        np.testing.assert_allclose(by[:, k], np.subtract(*ends) / 2e-5, atol=1e-8)
    gram = problem.evaluate(problem.x0)
    _, determined = problem.covariance(Solution(problem.x0, 1.0, gram, 1, True, ""))
    # A, G and the bias, D and the intercept of either response
    np.testing.assert_array_equal(np.flatnonzero(determined), np.r_[0:3, 21:27, 30:33, 36:39])
    np.testing.assert_allclose(by @ np.linalg.eigh(gram[:-1, :-1])[1][:, :3], 0.0, atol=1e-7)


def test_samples_that_are_not_scored():
    """Only later ones count, whatever part of them is in memory at once."""
    u = np.random.default_rng(0).normal(size=(600, 2))
    y = device().run(u, DT)[0] + 1.0
    problem = _Problem([(u, y)], device(), 550)
    operator = problem.operator(problem.x0)
    run, dy = problem.tangents(operator, u, *problem.begun(operator, u[0]))
    columns = np.concatenate([dy, (run - y)[:, :, None]], axis=2)[550:].reshape(100, -1)
    gram = problem.evaluate(problem.x0)
    np.testing.assert_allclose(gram, columns.T @ columns, rtol=1e-9, atol=1e-9)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_recovery_and_units():
    """The loops of a device are found, where its best linear approximation is not enough."""
    X = np.random.default_rng(1).normal(size=(500, 2))
    y = device().run(X, DT)[0]
    model = ModalFeedback(3, n_loops=2, dt=DT).fit(X[:400], y[:400])
    linear = ModalModel(3, dt=DT).fit(X[:400], y[:400])
    left = np.std((model.predict(X) - y)[400:])
    assert left < 0.02 * np.std((linear.predict(X) - y)[400:])
    inputs, units = np.array([1e-3, 1e3]), np.array([1e6, 1e-3])
    model.fit(X[:400] * inputs, y[:400] * units)
    left = np.std(model.predict(X * inputs) / units - y)
    assert left < 0.02 * np.std(linear.predict(X) - y)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_standard_deviation_of_a_prediction():
    """The response lies in the intervals of the parameters' errors, a sample in those of both."""
    rng = np.random.default_rng(3)
    X = rng.normal(size=(500, 2))
    y = device().run(X, DT)[0]
    noise = 0.03 * y.std(axis=0)
    measured = y + noise * rng.normal(size=y.shape)
    model = ModalFeedback(3, n_loops=2, dt=DT).fit(X[:300], measured[:300])
    np.testing.assert_allclose(model.noise_std_, noise, rtol=0.15)
    found, std = (values[300:] for values in model.predict(X, return_std=True))
    of_run = np.sqrt(std**2 - model.noise_std_**2)
    assert np.mean(np.abs(found - y[300:]) <= 1.96 * of_run) > 0.85
    assert 0.9 < np.mean(np.abs(found - measured[300:]) <= 1.96 * std) < 0.99


def test_one_response_is_stepped_and_saved():
    X = np.random.default_rng(2).normal(size=(120, 2))
    y = device(1).run(X, DT)[0][:, 0]
    with (
        pytest.warns(ConvergenceWarning, match="ModalFeedback has not converged"),
        pytest.warns(ConvergenceWarning, match="ModalModel has not converged"),
    ):
        model = ModalFeedback(3, n_loops=2, dt=DT, max_evaluations=3).fit(X, y)
    whole = model.predict(X)
    np.testing.assert_allclose(model.stepper(u0=X[0]).run(X), whole, rtol=1e-10)
    np.testing.assert_array_equal(from_json(to_json(model)).predict(X), whole)
    with pytest.warns(ExtrapolationWarning, match="values of column 1"):
        model.predict(X * [1.0, 9.0])
    known = np.where(np.arange(60) < 10, whole[60:], np.nan)
    late = model.predict(X[60:], y_start=known)
    np.testing.assert_allclose(late, whole[60:], atol=1e-5 * np.ptp(whole))
    with pytest.warns(ConvergenceWarning, match="2 known responses for 3 states"):
        model.predict(X[60:], y_start=np.where(np.arange(60) < 2, whole[60:], np.nan))
    device_in_motion = model.stepper_from(X[60:90], whole[60:90])
    np.testing.assert_allclose(device_in_motion.run(X[90:]), whole[90:], atol=1e-5 * np.ptp(whole))
    first, state = model.operator_.run(X[:50], DT)
    rest = model.operator_.run(X[50:], DT, state)[0]
    np.testing.assert_array_equal(np.concatenate([first, rest])[:, 0], whole)
    with pytest.raises(NotImplementedError, match="2 responses cannot be stepped"):
        device().compiled_step(DT, np.zeros(3))
    with pytest.raises(ValueError, match=r"sampled every 0\.01 s"):
        device().run(X, 2.0 * DT)
