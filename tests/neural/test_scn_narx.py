"""Networks with lags: compiled free runs, and hysteresis and its inverse from the free run."""

from itertools import pairwise

import numpy as np
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.autoregressive import NARXRegressor
from skhyst.autoregressive._gaussian_loops import gaussian_run
from skhyst.neural import SCNRegressor


def bouc_wen(u):
    """Hysteresis of unit slope and unit limit, integrated in small steps."""
    fine = np.interp(np.arange(0, len(u), 0.02), np.arange(len(u)), u)
    h, out = 0.0, np.zeros(len(fine))
    for k, du in enumerate(np.diff(fine)):
        h += du * (1.0 - abs(h) * (0.6 * np.sign(h * du) + 0.4))
        out[k + 1] = h
    return out[::50]


def swings(peaks, step=0.1):
    """Return a drive from zero to each peak in turn, in steps of at most this."""
    corners = np.r_[0.0, peaks]
    parts = [
        np.linspace(a, b, 1 + int(np.ceil(abs(b - a) / step)))[1:] for a, b in pairwise(corners)
    ]
    return np.concatenate([[0.0], *parts])


@pytest.fixture(scope="module")
def training():
    peaks = 2.5 * np.exp(-0.08 * np.arange(28)) * (-1.0) ** np.arange(28)
    u = swings(peaks)
    return u, bouc_wen(u)


@pytest.mark.parametrize("activation", ["sigmoid", "rbf"])
@pytest.mark.parametrize("scaling", ["standard", "whiten"])
def test_compiled_run_is_that_of_the_estimator(training, activation, scaling):
    u, y = training
    network = SCNRegressor(20, activation=activation, scaling=scaling, random_state=0)
    for estimator in (network, make_pipeline(StandardScaler(), network)):
        model = NARXRegressor(estimator, initial_output=0.0).fit(u[:, None], y)
        assert model.compiled_
        run, past, before = model.predict(u[:150, None]), 0.0, u[0]
        for k, now in enumerate(u[:150]):
            past, before = model.estimator_.predict([[now, before, past]])[0], now
            assert run[k] == pytest.approx(past, rel=1e-9, abs=1e-11)


def test_gaussian_kernel_is_its_python_original():
    rng = np.random.default_rng(0)
    arguments = (
        rng.normal(size=(30, 2)),
        rng.normal(size=(4, 3)),
        rng.normal(size=(3, 5)),
        -rng.uniform(0.1, 1.0, 5),
        rng.normal(size=6),
        np.array([1, 3]),
    )
    for bound in (10.0, 0.5):
        runs = []
        for function in (gaussian_run, gaussian_run.py_func):
            y = np.r_[0.1, -0.2, 0.3, np.zeros(30)]
            runs.append((function(*arguments, bound, y), y))
        assert runs[0][0] == runs[1][0]
        np.testing.assert_allclose(runs[0][1], runs[1][1], rtol=1e-12, atol=1e-14)
    assert runs[0][0] < 30


def test_hysteresis_and_its_inverse_in_the_free_run(training):
    """Loops that were not in the training, to a percent of their height, and back."""
    u, y = training
    held_out = swings([2.0, -2.0, 2.0, -2.0, 0.5, 1.5, -1.0, 2.2])
    truth = bouc_wen(held_out)
    network = SCNRegressor(60, scaling="whiten", tolerance=1e-6, random_state=0)
    model = NARXRegressor(network, initial_output=0.0).fit(u[:, None], y)
    error = np.abs(model.predict(held_out[:, None]) - truth).max()
    assert error < 0.01 * np.ptp(truth)
    # the displacement of an actuator is the drive less part of it
    inverse = NARXRegressor(network, initial_output=0.0).fit((u - 0.45 * y)[:, None], u)
    found = inverse.predict((held_out - 0.45 * truth)[:, None])
    assert np.abs(found - held_out).max() < 0.02 * np.ptp(held_out)
