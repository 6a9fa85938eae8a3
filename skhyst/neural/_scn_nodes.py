"""Random hidden nodes of a stochastic configuration network, and how well they match a residual.

Nodes live in scaled inputs. A sigmoid node is ``1 / (1 + exp(-(w x + b)))`` with ``w`` and
``b`` uniform in ``[-scope, scope]``. A Gaussian node is ``exp(-|x - c|^2 / (2 sigma^2))`` whose
centre ``c`` is one of the samples, since lagged signals fill a thin part of any box, and whose
``1 / sigma`` is uniform in ``(0, scope]``: in both cases the scope is the steepest slope.
"""

import numpy as np

__all__ = ["ACTIVATIONS", "gaussian", "match", "sigmoid"]

_FAINT = 1e-5  # root mean square of activations that count as none
_BLOCK = 1 << 18  # activations held at a time: they stay in the cache


def sigmoid(X, nodes):
    """Return (n_samples, n_nodes); a row of ``nodes`` is the weights, then the bias."""
    z = X @ nodes[:, :-1].T
    z += nodes[:, -1]
    z *= 0.5
    np.tanh(z, out=z)  # the logistic function, without overflow
    z += 1.0
    z *= 0.5
    return z


def gaussian(X, nodes):
    """Return (n_samples, n_nodes); a row of ``nodes`` is the centre, then ``1 / sigma``."""
    # differences rather than the expanded square, which cancels where a node is narrow
    z = np.zeros((len(X), len(nodes)))
    for column in range(X.shape[1]):
        z += np.square(X[:, column : column + 1] - nodes[:, column])
    z *= -0.5 * np.square(nodes[:, -1])
    return np.exp(z, out=z)


def _draw_sigmoid(X, scope, size, rng):
    return rng.uniform(-scope, scope, (size, X.shape[1] + 1))


def _draw_gaussian(X, scope, size, rng):
    centers = X[rng.randint(len(X), size=size)]
    return np.column_stack([centers, scope * (1.0 - rng.uniform(size=size))])


ACTIVATIONS = {"sigmoid": (sigmoid, _draw_sigmoid), "rbf": (gaussian, _draw_gaussian)}


def match(activation, X, nodes, residual):
    """Return what a residual loses when one node is added to it by least squares.

    Parameters
    ----------
    activation : callable
        :func:`sigmoid` or :func:`gaussian`.
    X : ndarray of shape (n_samples, n_inputs)
    nodes : ndarray of shape (n_nodes, n_inputs + 1)
    residual : ndarray of shape (n_samples, n_outputs)

    Returns
    -------
    ndarray of shape (n_nodes, n_outputs)
        ``<e_q, g>^2 / <g, g>``, zero for a node that next to vanishes at all samples: it would
        act by its tail, with a giant weight.
    """
    products = np.zeros((len(nodes), residual.shape[1]))
    squares = np.zeros(len(nodes))
    rows = max(1, _BLOCK // len(nodes))
    for start in range(0, len(X), rows):
        block = slice(start, start + rows)
        g = activation(X[block], nodes)
        products += g.T @ residual[block]
        squares += np.einsum("ij,ij->j", g, g)
    squares[squares < _FAINT**2 * len(X)] = np.inf
    return np.square(products) / squares[:, np.newaxis]
