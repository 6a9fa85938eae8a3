"""The observer: what theory says of Kalman filters."""

import copy
import pickle
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import solve_discrete_lyapunov
from sklearn.linear_model import Ridge
from sklearn.utils.validation import NotFittedError

from skhyst.compose import Cascade
from skhyst.control import Observer
from skhyst.control._kalman import driven_by_noise, with_predicted_readings
from skhyst.exceptions import ConvergenceWarning
from skhyst.export import to_c
from skhyst.hysteresis import (
    BoucWenStage,
    BoucWenStageOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)

DT, N = 1e-3, 8000
PLAYS = PrandtlIshlinskiiOperator(np.arange(3.0), np.array([1.0, 0.4, 0.3]))
MODE, LAG = SecondOrderModeOperator(400.0, 0.05), FirstOrderLagOperator(4e-3)
NOISE, DRIFT, PROCESS = 0.05, 0.3, 0.1


def stds(observer):
    return observer.noise_std_, observer.drift_std_, observer.process_std_


@pytest.fixture(scope="module")
def data():
    """A device that is the model, with a random walk, unknown motion, and noise."""
    rng = np.random.default_rng(0)
    u = 3.0 * np.sin(np.cumsum(rng.normal(0.05, 0.05, N)))
    true, _ = LAG.run(MODE.run(PLAYS.run(u, DT)[0], DT)[0], DT)
    stray = LAG.run(MODE.run(np.repeat(rng.normal(size=N), 1), DT)[0], DT)[0]
    true = true + PROCESS * stray / stray.std() + DRIFT * np.sqrt(DT) * rng.normal(size=N).cumsum()
    return u[:, None], true, true + NOISE * rng.normal(size=N)


@pytest.fixture(scope="module")
def observer(data):
    u, _, reading = data
    steps = [
        ("plays", PrandtlIshlinskii(thresholds=np.arange(3.0))),
        ("mode", SecondOrderMode()),
        ("lag", FirstOrderLag()),
    ]
    return Observer(Cascade(steps, dt=DT).fit(u, reading)).fit(u, reading)


@pytest.mark.parametrize("gain", [1e-90, 1.0, 1e90, 0.0])
def test_states_behind_white_noise_vary_by_one_in_any_unit(gain):
    a, b, c, _ = driven_by_noise([GainOperator(gain), MODE, LAG], DT)
    covariance, expected = solve_discrete_lyapunov(a, np.outer(b, b)), float(gain > 0.0)
    np.testing.assert_allclose(np.diag(covariance), expected, rtol=1e-6)
    np.testing.assert_allclose(c @ covariance @ c, expected, rtol=1e-6)


def recursion(operator, variances, u, reading):
    """Return the estimates of a plain Kalman filter of all linear states, with all covariances."""
    plays, *linear = operator.stages
    v, _ = plays.run(u, DT)
    (a1, p1, q1, c1, _), (a2, p2, q2, c2, _) = (stage.discrete(DT) for stage in linear)
    n1, n = len(p1), len(p1) + len(p2) + 1
    f, before, now = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    f[:n1, :n1], before[:n1], now[:n1] = a1, p1, q1
    # the second stage sees the output of the first before and now
    f[n1:-1, :n1] = np.outer(p2, c1) + np.outer(q2, c1 @ a1)
    f[n1:-1, n1:-1], f[-1, -1] = a2, 1.0
    before[n1:-1], now[n1:-1] = q2 * (c1 @ p1), q2 * (c1 @ q1)
    h, g = np.r_[np.zeros(n1), c2, 1.0], before + now
    noise, drift, process = variances
    x1 = linear[0].init(v[0])[0]
    x = np.r_[x1, linear[1].init(c1 @ x1)[0], 0.0]
    # the motion's variance, of unit input, by the sum of its impulse response
    response, size = g.copy(), 0.0
    for _ in range(20000):
        size, response = size + (h @ response) ** 2, f @ response
    q = process / size * np.outer(g, g)
    q[-1, -1] += drift * DT
    p, estimates = q.copy(), np.empty(len(u))
    for _ in range(20000):  # until it is stationary
        k = p @ h / (h @ p @ h + noise)
        p = f @ (p - np.outer(k, h @ p)) @ f.T + q
    last = v[0]
    for i in range(len(u)):
        x = f @ x + before * last + now * v[i]
        last = v[i]
        x = x + k * (reading[i] - operator.stages[-1].intercept - h @ x)
        estimates[i] = operator.stages[-1].intercept + h @ x
    return estimates, h @ p @ h + noise


@pytest.mark.slow
def test_it_is_the_kalman_filter_of_all_linear_states(observer, data):
    u, _, reading = data
    operator, own = observer.model_.operator_, [std**2 for std in stds(observer)]
    expected, variance = recursion(operator, own, u[:1000, 0], reading[:1000])
    found = observer.filter(u[:1000], reading[:1000])
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.ptp(reading))
    for values in zip(u[:3, 0], reading, strict=False):
        observer.update(*values)
    assert observer.innovation_std == pytest.approx(np.sqrt(variance), rel=1e-9)
    observer.reset()


def test_the_variances_are_those_of_the_device(observer):
    np.testing.assert_allclose(stds(observer), (NOISE, DRIFT, PROCESS), rtol=0.15)


def test_innovations_are_white(observer, data):
    u, _, reading = data
    e = observer.innovations(u, reading)
    correlations = [e[lag:] @ e[:-lag] / (e @ e) for lag in range(1, 21)]
    # chi-square of 20 degrees of freedom, one in a thousand
    assert N * np.square(correlations).sum() < 45.3


def test_the_estimate_is_better_than_model_and_reading(observer, data):
    u, true, reading = data
    error = np.std(observer.filter(u, reading) - true)
    assert error < 0.7 * NOISE
    assert error < 0.5 * np.std(observer.model_.predict(u) - true)


def test_lost_readings_are_foretold(observer, data):
    """A filter that goes on through them is off where they are, and soon no more."""
    u, true, reading = data
    index = pd.Index(DT * np.arange(N), name="time")
    kept = np.ones(N, dtype=bool)
    kept[np.random.default_rng(1).choice(np.arange(1, N - 1), 200, replace=False)] = False
    X, y = pd.DataFrame(u, index), pd.Series(reading, index)
    found = observer.filter(X[kept], y[kept])
    assert np.std(found - true[kept]) < 1.1 * np.std(observer.filter(u, reading) - true)
    e = observer.innovations(X[kept], y[kept])
    assert np.std(e) == pytest.approx(np.std(observer.innovations(u, reading)), rel=0.1)
    again = Observer(observer.model_).fit(X[kept], y[kept])
    np.testing.assert_allclose(stds(again), stds(observer), rtol=0.1)
    # what stands in a lost row is not read
    state, step = observer.compiled_step(DT, u[0]).state, observer.compiled_step(DT, u[0])
    rows = np.column_stack([u[:100], reading[:100]])
    lost = np.isin(np.arange(100), [20, 21, 60])
    wrong = np.where(lost[:, None] & [False, True], 1e3, rows)
    told = [
        with_predicted_readings(step.innovating, state.copy(), own, lost) for own in (rows, wrong)
    ]
    np.testing.assert_allclose(told[0], told[1], atol=1e-9)
    innovations = step.innovating(state.copy())(told[0])
    np.testing.assert_allclose(innovations[lost], 0.0, atol=1e-12)


def test_samples_one_by_one(observer, data):
    u, _, reading = data
    expected = observer.filter(u[:300], reading[:300])
    innovations = observer.innovations(u[:300], reading[:300])
    found = [observer.update(*row) for row in zip(u[:200, 0], reading, strict=False)]
    np.testing.assert_allclose(found, expected[:200], rtol=1e-12)
    assert observer.innovation == pytest.approx(innovations[199])
    state = observer.state
    for _ in range(2):  # and again from there
        observer.state = state
        later = [observer.update(*row) for row in zip(u[200:300, 0], reading[200:], strict=False)]
        np.testing.assert_allclose(later, expected[200:], rtol=1e-12)
    observer.reset()
    assert observer.update(u[0, 0], reading[0]) == expected[0]


def test_what_is_refused_changes_nothing(observer, data):
    u, _, reading = data
    observer.reset()
    with pytest.raises(ValueError, match="finite"):
        observer.update(np.nan, 0.0)
    with pytest.raises(AttributeError, match="has seen no sample"):
        observer.state  # noqa: B018
    expected = observer.update(u[0, 0], reading[0])
    state = observer.state
    for row in ((0.0, np.nan), (np.inf, 0.0)):
        with pytest.raises(ValueError, match="finite"):
            observer.update(*row)
        np.testing.assert_array_equal(observer.state, state)
    assert observer.estimate == expected


def test_an_offset_goes_to_the_walk(observer, data):
    u, true, reading = data
    observer.reset()
    for row in zip(u[:, 0], true + 7.0, strict=True):
        observer.update(*row)
    observer_of_same = Observer(observer.model_).fit(u, reading)
    for row in zip(u[:, 0], true, strict=True):
        observer_of_same.update(*row)
    shift = observer.disturbance_estimate - observer_of_same.disturbance_estimate
    assert shift == pytest.approx(7.0, abs=0.01)
    observer.reset()


def test_without_noise_of_its_own_it_is_the_free_run(observer, data):
    u, _, reading = data
    alone = Observer(observer.model_, disturbance=None, process_std=0.0).fit(u, reading)
    np.testing.assert_allclose(alone.filter(u, reading), alone.model_.predict(u), atol=1e-12)
    left = reading - alone.model_.predict(u)
    assert alone.noise_std_ == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.02)


def test_given_variances_are_kept(observer, data):
    given = Observer(observer.model_, noise_std=0.2, drift_std=0.1, process_std=0.3).fit(
        data[0], data[2]
    )
    np.testing.assert_allclose(stds(given), (0.2, 0.1, 0.3))


def test_a_perfect_recording():
    u = np.sin(0.1 * np.arange(400))
    y, _ = LAG.run(u, DT)
    observer = Observer(FirstOrderLag(dt=DT)).fit(u[:, None], y)
    assert 0.0 < observer.noise_std_ < 1e-6
    np.testing.assert_allclose(observer.filter(u[:, None], y), y, atol=1e-6)
    for value, reading in zip(u, y, strict=True):
        observer.update(value, reading)
    observer.reset()
    with pytest.warns(ConvergenceWarning, match="in the same units"):  # one over the other
        [observer.update(*row) for row in zip(u, 1e-3 * y, strict=True)]


def test_pickled_in_service(observer, data):
    u, _, reading = data
    for k in range(30):
        observer.update(u[k, 0], reading[k])
    again = pickle.loads(pickle.dumps(observer))
    copies = again, copy.deepcopy(observer), pickle.loads(pickle.dumps(again))
    for own in (observer, *copies):  # each goes on where it was
        own.found = [own.update(u[k, 0], reading[k]) for k in range(30, 60)]
        assert own.found == observer.found
        assert own.innovation == observer.innovation
    np.testing.assert_array_equal(
        again.filter(u[:50], reading[:50]), observer.filter(u[:50], reading[:50])
    )
    observer.reset()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler")
def test_it_is_written_as_c(observer, tmp_path):
    to_c(observer.compiled_step(), tmp_path, "observer", dt=DT)
    command = ["cc", "-std=c99", "-Wall", "-Werror", "-o", "program", "observer_test.c"]
    subprocess.run([*command, "observer.c", "-lm"], cwd=tmp_path, check=True)
    assert subprocess.run("./program", cwd=tmp_path).returncode == 0


def test_wrong_models(data):
    u, _, reading = data
    with pytest.raises(TypeError, match="'model' parameter of Observer must be a parametric model"):
        Observer(Ridge()).fit(u, reading)
    with pytest.raises(NotFittedError):
        Observer(FirstOrderLag()).update(0.0, 0.0)


def test_unscented_is_kalman_where_all_is_linear():
    """Once the covariance is stationary; with the hold that noise has in the other filter."""
    rng = np.random.default_rng(1)
    u = rng.normal(size=(2000, 1))
    mode = SecondOrderModeOperator(300.0, 0.1, hold="zoh")
    reading = mode.run(u[:, 0] + 0.1 * rng.normal(size=len(u)), DT)[0] + 0.1 * rng.normal(size=2000)
    model = SecondOrderMode(hold="zoh", dt=DT).fit(u, reading)
    given = {"noise_std": 0.1, "drift_std": 1.0, "process_std": 0.1}
    observers = [
        Observer(model, method=method, **given).fit(u, reading)
        for method in ("unscented", "linear")
    ]
    found, expected = (own.filter(u, reading)[1500:] for own in observers)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    found, expected = (own.innovations(u, reading)[1500:] for own in observers)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    with pytest.raises(NotImplementedError, match="linear"):
        to_c(observers[0].compiled_step(), "nowhere", "observer", dt=DT)


def test_hysteresis_in_the_motion():
    """What else drives the motion is told from the reading better than by a linear mode."""
    rng = np.random.default_rng(2)
    stage = BoucWenStageOperator(300.0, 0.05, 1.0, 0.5, n_substeps=2)
    u = 2.0 * np.sin(np.cumsum(rng.normal(0.1, 0.1, 1500)))
    true, _ = stage.run(u + 0.3 * rng.normal(size=len(u)), DT)
    reading = true + 0.05 * rng.normal(size=len(u))
    model = BoucWenStage(n_substeps=2, dt=DT).fit_from(stage, u[:, None], reading)
    errors = {}
    for method in ("auto", "linear"):
        observer = Observer(model, method=method, drift_std=0.0).fit(u[:, None], reading)
        errors[method] = np.std(observer.filter(u[:, None], reading) - true)
    assert errors["auto"] < errors["linear"] < np.std(model.predict(u[:, None]) - true)
