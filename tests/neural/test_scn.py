"""The supervisory inequality, the residual, units, early stopping, hysteresis."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.special import expit
from sklearn.base import clone

from skhyst.autoregressive import NARXRegressor
from skhyst.exceptions import ConvergenceWarning
from skhyst.neural import SCNRegressor

ALGORITHMS = ["SC-I", "SC-II", "SC-III"]
ACTIVATIONS = ["sigmoid", "rbf"]


def scn(max_nodes, **options):
    """A network that grows to this size."""
    return SCNRegressor(max_nodes, **{"tolerance": 0.0, "random_state": 0} | options)


def bumps(x):
    """The one-dimensional test function of Wang and Li (2017)."""
    return (
        0.2 * np.exp(-((10 * x - 4) ** 2))
        + 0.5 * np.exp(-((80 * x - 40) ** 2))
        + 0.3 * np.exp(-((80 * x - 20) ** 2))
    )


def surface(seed=0, n=300):
    """Two outputs of three inputs in unlike units."""
    X = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 3)) * [1.0, 1e3, 1e-6]
    a, b, c = (X / [1.0, 1e3, 1e-6]).T
    return X, np.column_stack([1e-3 * np.sin(3 * a) * b, 50.0 + np.tanh(2 * a + c) - b * c])


def hidden(model, X):
    """Activations of a fitted network, written down anew."""
    if model.activation == "sigmoid":
        return expit(X @ model.hidden_weights_.T + model.hidden_biases_)
    distances = (X[:, np.newaxis] - model.centers_) @ model.scaling_
    return np.exp(-np.sum(distances**2, axis=2) / (2.0 * model.widths_**2))


def residuals(model, X, y):
    """Residual before each node and behind the last, by least squares on the first nodes."""
    g, coef = hidden(model, X), model.coef_.T
    constant = np.ones((len(X), 1))
    for n in range(model.n_nodes_ + 1):
        if model.algorithm == "SC-I":  # earlier weights never change
            yield y - y.mean(axis=0) - g[:, :n] @ coef[:n]
        else:
            basis = np.hstack([constant, g[:, :n]])
            yield y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("algorithm", ["SC-I", "SC-III"])
@pytest.mark.parametrize("scaling", ["standard", "whiten"])
def test_every_node_satisfies_the_supervisory_inequality(algorithm, activation, scaling):
    X, y = surface()
    options = {"algorithm": algorithm, "activation": activation, "scaling": scaling}
    model = scn(15, tolerance=0.01, random_state=1, **options).fit(X, y)
    g, history, unit = hidden(model, X), model.history_, y.std(axis=0)
    e = [part / unit for part in residuals(model, X, y)]
    for n in range(model.n_nodes_):
        r, size = history["contraction"][n], n + 1
        gain = (e[n].T @ g[:, n]) ** 2 / (g[:, n] @ g[:, n])
        squares = np.sum(e[n] ** 2, axis=0)
        xi = gain - (1.0 - r - (1.0 - r) / (size + 1)) * squares
        assert (xi >= -1e-9 * squares).all()
        np.testing.assert_allclose(xi, history["xi"][n], rtol=1e-6, atol=1e-8)
        # what the inequality is for: a known rate of convergence
        assert np.sum(e[n + 1] ** 2) <= (r + (1 - r) / (size + 1) + 1e-9) * np.sum(e[n] ** 2)
        total = np.sqrt(np.mean(e[n + 1] ** 2))
        np.testing.assert_allclose(history["residual"][n], total, rtol=1e-6)
    np.testing.assert_allclose(y - model.predict(X), e[-1] * unit, atol=1e-9)


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_residual_never_grows(algorithm, activation):
    X, y = surface(2)
    model = scn(60, algorithm=algorithm, activation=activation, window=5).fit(X, y)
    assert model.stop_reason_ == "max_nodes"
    assert (np.diff(np.r_[1.0, model.history_["residual"]]) <= 1e-15).all()
    relative = (y - model.predict(X)) / y.std(axis=0)
    assert np.sqrt(np.mean(relative**2)) == pytest.approx(model.history_["residual"][-1])


def test_a_window_over_all_nodes_is_global_least_squares():
    X, y = surface(3)
    wide = scn(25, algorithm="SC-II", window=25).fit(X, y)
    full = scn(25, algorithm="SC-III").fit(X, y)
    np.testing.assert_allclose(wide.predict(X), full.predict(X), rtol=1e-7)
    one = scn(9, algorithm="SC-II", window=1).fit(X, y)
    # the last node and the constant are fitted to what the earlier ones leave
    left = (y - one.predict(X)) / y.std(axis=0)
    last = np.column_stack([np.ones(len(X)), hidden(one, X)[:, -1]])
    np.testing.assert_allclose(last.T @ left, 0.0, atol=1e-9)


def test_orthogonal_to_all_nodes_even_where_they_are_many():
    x = np.linspace(0.0, 1.0, 400)[:, np.newaxis]
    model = scn(120).fit(x, bumps(x[:, 0]))
    left = bumps(x[:, 0]) - model.predict(x)
    g = hidden(model, x)
    parts = g.T @ left / np.linalg.norm(g, axis=0) / np.linalg.norm(bumps(x[:, 0]))
    assert np.abs(parts).max() < 1e-10


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_function_of_wang_and_li(activation):
    """Root mean square error of 1 % of the range with at most 60 nodes, on a grid not seen."""
    rng = np.random.default_rng(0)
    x, grid = rng.uniform(size=(600, 1)), np.linspace(0.0, 1.0, 300)[:, np.newaxis]
    y, truth = bumps(x[:, 0]), bumps(grid[:, 0])
    tolerance = 0.01 * np.ptp(truth) / y.std()
    counts, errors = {name: [] for name in ("SC-I", "SC-III")}, []
    for seed in range(3):
        options = {"activation": activation, "tolerance": tolerance, "random_state": seed}
        for name in counts:
            model = scn(60, algorithm=name, **options).fit(x, y)
            counts[name].append(model.n_nodes_)
        assert model.stop_reason_ == "tolerance"
        errors.append(np.sqrt(np.mean((model.predict(grid) - truth) ** 2)))
    assert (np.array(counts["SC-III"]) <= counts["SC-I"]).all()
    assert np.median(errors) <= 0.012 * np.ptp(truth)


def test_steeper_scopes_need_fewer_nodes_on_steep_functions():
    """The scopes 150, 160, ..., 200 that the paper takes for its function."""
    x = np.random.default_rng(0).uniform(size=(1000, 1))
    y, options = bumps(x[:, 0]), {"tolerance": 0.06, "random_state": 0}
    steep = SCNRegressor(scopes=range(150, 201, 10), **options).fit(x, y)
    assert steep.n_nodes_ <= 30 < SCNRegressor(**options).fit(x, y).n_nodes_


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("scaling", ["standard", "whiten"])
@pytest.mark.parametrize("unit", [1e-9, 1e6, 1e150])
def test_units(activation, scaling, unit):
    X, y = surface(4, 120)
    model = SCNRegressor(12, activation=activation, scaling=scaling, random_state=0).fit(X, y)
    other = clone(model).fit(X * [unit, 1.0, -1.0], y * [1.0, 1.0 / unit])
    np.testing.assert_array_equal(other.history_["scope"], model.history_["scope"])
    expected = model.predict(X)
    if activation == "rbf":  # random weights know no sign; samples as centres turn around with X
        found = other.predict(X * [unit, 1.0, -1.0]) * [1.0, unit]
        np.testing.assert_allclose(found, expected, rtol=1e-6)
    shifted = X * [unit, 1.0, 1.0] + [0.0, 5e3, 0.0]
    same = clone(model).fit(shifted, y * [1.0, unit])
    np.testing.assert_allclose(same.predict(shifted) / [1.0, unit], expected, rtol=1e-6)


def test_whitening_sees_the_difference_of_neighbours():
    """A response to the rate of a slow signal, from two neighbouring samples."""
    time = np.linspace(0.0, 1.0, 2000)
    u = np.sin(2 * np.pi * 3 * time)
    X, y = np.column_stack([u[1:], u[:-1]]), np.tanh(5e2 * np.diff(u))
    errors = {}
    for scaling in ("standard", "whiten"):
        model = scn(25, scaling=scaling).fit(X, y)
        errors[scaling] = model.history_["residual"][-1]
    assert errors["whiten"] < 0.01
    assert errors["whiten"] < 0.2 * errors["standard"]
    # inputs that are the same add nothing
    twice = scn(25, scaling="whiten").fit(np.column_stack([X, X[:, 0]]), y)
    assert twice.history_["residual"][-1] < 0.01


def test_ridge_is_that_of_the_hidden_layer():
    X, y = surface(5)
    model = SCNRegressor(20, alpha=2.0, random_state=0).fit(X, y)
    free = SCNRegressor(20, random_state=0).fit(X, y)
    np.testing.assert_array_equal(model.hidden_weights_, free.hidden_weights_)
    unit = y.std(axis=0)
    g = hidden(model, X)
    centred, target = g - g.mean(axis=0), (y - y.mean(axis=0)) / unit
    expected = np.linalg.solve(centred.T @ centred + 2.0 * np.eye(20), centred.T @ target)
    np.testing.assert_allclose(model.coef_.T / unit, expected, rtol=1e-6, atol=1e-9)
    assert np.linalg.norm(model.coef_ / unit[:, None]) < np.linalg.norm(free.coef_ / unit[:, None])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_early_stopping_keeps_the_best_network(algorithm):
    rng = np.random.default_rng(6)
    x = rng.uniform(-1.0, 1.0, (150, 1))
    y = np.sin(4 * x[:, 0]) + 0.3 * rng.normal(size=150)
    stopping = {"early_stopping": True, "validation_fraction": 0.3, "n_iter_no_change": 6}
    model = scn(60, algorithm=algorithm, **stopping).fit(x, y)
    scores = model.history_["validation_score"]
    assert len(scores) == model.n_nodes_ == len(model.coef_)
    assert model.validation_score_ == scores[-1] == scores.max()
    assert model.stop_reason_ == "validation"
    if algorithm != "SC-III":
        return
    grid = np.linspace(-1.0, 1.0, 200)[:, np.newaxis]
    error = np.sqrt(np.mean((model.predict(grid) - np.sin(4 * grid[:, 0])) ** 2))
    assert error < 0.2
    with pytest.raises(ValueError, match="hold out 2 of n_samples=3"):
        model.fit(x[:3], y[:3])


def test_nothing_admissible_is_said():
    rng = np.random.default_rng(7)
    X, y = rng.normal(size=(2000, 1)), rng.normal(size=2000)
    model = scn(100, scopes=[0.01], contraction=[0.5], n_candidates=3, tolerance=0.1)
    with pytest.warns(ConvergenceWarning, match="No candidate for node 1"):
        model.fit(X, y)
    assert (model.n_nodes_, model.stop_reason_) == (0, "no_candidate")
    np.testing.assert_allclose(model.predict(X), y.mean())


def test_constants():
    X = np.column_stack([np.linspace(0.0, 1.0, 50), np.full(50, 0.1)])
    model = SCNRegressor(random_state=0).fit(X, np.full(50, 0.3))
    assert (model.n_nodes_, model.stop_reason_) == (0, "tolerance")
    np.testing.assert_allclose(model.predict(X), 0.3)
    # a constant output beside another, a constant input beside another
    y = np.column_stack([np.sin(5 * X[:, 0]), np.full(50, -2.0)])
    model.fit(X, y)
    assert model.stop_reason_ == "tolerance"
    assert model.coef_.shape == (2, model.n_nodes_)
    np.testing.assert_allclose(model.predict(X)[:, 1], -2.0)
    with pytest.warns(ConvergenceWarning, match="No candidate"):
        model.set_params(scaling="whiten").fit(X[:, 1:], X[:, 0])


def test_exact_fit_ends():
    x = np.linspace(0.0, 1.0, 8)[:, np.newaxis]
    model = scn(500, n_candidates=300).fit(x, np.random.default_rng(0).normal(size=8))
    assert model.n_nodes_ <= 7
    assert model.history_["residual"][-1] < 1e-10


@pytest.mark.parametrize(
    "options",
    [
        {"scopes": [1.0, 0.0]},
        {"scopes": []},
        {"contraction": [0.9, 1.0]},
        {"contraction": [[0.5]]},
        {"activation": "relu"},
        {"algorithm": "SC-IV"},
        {"scaling": None},
        {"max_nodes": 0},
        {"alpha": -1.0},
        {"alpha": 1.0, "algorithm": "SC-I"},  # needs global least squares
    ],
)
def test_wrong_parameters(options):
    name = next(iter(options))
    with pytest.raises(ValueError, match=f"The '{name}' parameter of SCNRegressor must be"):
        SCNRegressor(**options).fit(*surface())


# ------------------------------------------------------------------- hysteresis, in a NARX model


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


def test_hysteresis_and_its_inverse_in_the_free_run():
    """Loops that were not in the training, to a percent of their height, and back."""
    u = swings(2.5 * np.exp(-0.08 * np.arange(28)) * (-1.0) ** np.arange(28))
    y = bouc_wen(u)
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
