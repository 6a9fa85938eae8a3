from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from skhyst.autoregressive._recurrent_loops import (
    ACTIVATIONS,
    _exponentials,
    linear_run,
    network_run,
)

LAGS = np.array([1, 3])


def network(layers, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    widths = np.array(layers)
    widest = -(-max(layers) // 4) * 4
    weights = np.zeros((len(layers) - 1, widest, widest))
    biases = np.zeros((len(layers) - 1, widest))
    for k, (n_in, n_out) in enumerate(pairwise(layers)):
        weights[k, :n_in, :n_out] = rng.standard_normal((n_in, n_out)) / np.sqrt(n_in)
        biases[k, :n_out] = rng.standard_normal(n_out)
    first = rng.standard_normal((4, layers[0]))
    return (
        first,
        rng.standard_normal(layers[0]),
        widths,
        weights,
        biases,
        scale * rng.standard_normal(layers[-1] + 1),
    )


def test_linear_run_is_a_recursive_filter():
    rng = np.random.default_rng(0)
    u = rng.standard_normal((200, 1))
    y = np.zeros(203)
    assert linear_run(u, np.array([0.5, 0.6, -0.3]), 0.2, LAGS, 1e9, y) == 200
    expected = lfilter([1.0], [1.0, -0.6, 0.0, 0.3], 0.5 * u[:, 0] + 0.2)
    np.testing.assert_allclose(y[3:], expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("layers", [[5], [6, 3], [4, 9, 2]])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_network_run(layers, activation):
    apply = {
        "identity": lambda x: x,
        "relu": lambda x: np.maximum(x, 0.0),
        "logistic": lambda x: 1.0 / (1.0 + np.exp(-x)),
        "tanh": np.tanh,
    }[activation]
    inputs = np.random.default_rng(1).standard_normal((50, 2))
    arrays = network(layers, scale=0.2)
    first, offsets, widths, weights, biases, last = arrays
    expected = [0.1, -0.2, 0.3]
    for row in inputs:
        x = apply(np.append(row, [expected[-1], expected[-3]]) @ first + offsets)
        for k in range(len(widths) - 1):
            x = apply(x @ weights[k, : widths[k], : widths[k + 1]] + biases[k, : widths[k + 1]])
        expected.append(x @ last[:-1] + last[-1])
    for run in (network_run, network_run.py_func):
        y = np.append([0.1, -0.2, 0.3], np.zeros(50))
        assert run(inputs, *arrays, ACTIVATIONS[activation], LAGS, 1e9, y) == 50
        np.testing.assert_allclose(y, expected, rtol=1e-10, atol=1e-10)


def test_exponential():
    x = np.concatenate([np.linspace(-700.0, 700.0, 9999), np.linspace(-1e-3, 1e-3, 101)])
    found, powers = x.copy(), np.empty(x.size)
    _exponentials(found, x.size, powers.view(np.int64), powers)
    np.testing.assert_allclose(found, np.exp(x), rtol=2e-15)
    beyond = np.array([-1e300, 1e300, -np.inf, np.inf])
    _exponentials(beyond, 4, powers.view(np.int64), powers)
    np.testing.assert_allclose(beyond, np.exp([-700.0, 700.0, -700.0, 700.0]), rtol=2e-15)


@pytest.mark.parametrize("value", [1e30, -1e30, np.nan])
def test_outputs_are_bounded(value):
    inputs = np.zeros((5, 1))
    inputs[2] = value
    y = np.zeros(6)
    assert linear_run(inputs, np.array([1.0, 0.0]), 0.0, np.array([1]), 7.0, y) == 2
    np.testing.assert_array_equal(y, [0, 0, 0, -7.0 if value < 0 else 7.0, 0, 0])
