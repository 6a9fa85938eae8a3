"""Output weights of a stochastic configuration network, updated node by node.

The three algorithms of Wang and Li (2017). Each starts from the mean of the targets and keeps the
residual of what it holds. ``add(g)`` adds a node with activations (n_samples,) and returns whether
it was taken; ``weights()`` returns coefficients (n_nodes, n_outputs) and intercepts (n_outputs,).
"""

import numpy as np
from scipy.linalg import solve_triangular

_AMPLIFICATION = 1e7  # of errors of the activations in the weights, at most


class Constructive:
    """SC-I: the new node takes what it can from the residual; earlier weights stand."""

    def __init__(self, y):
        self._mean = y.mean(axis=0)
        self.residual = y - self._mean
        self._coef = []

    def add(self, g):
        coef = g @ self.residual / (g @ g)
        self.residual -= np.outer(g, coef)
        self._coef.append(coef)
        return True

    def weights(self):
        return np.reshape(self._coef, (-1, len(self._mean))), self._mean


class Window:
    """SC-II: least squares over the last nodes and the constant; earlier weights stand."""

    def __init__(self, y, width):
        self._nodes = []
        self._width = width
        self._intercept = y.mean(axis=0)
        self.residual = y - self._intercept
        self._coef = np.empty((0, y.shape[1]))

    def add(self, g):
        self._nodes = [*self._nodes, g][-self._width :]
        q, r = np.linalg.qr(np.column_stack([np.ones(len(g)), *self._nodes]))
        change = q.T @ self.residual
        self.residual -= q @ change
        change = solve_triangular(r, change)
        self._intercept = self._intercept + change[0]
        self._coef = np.vstack([self._coef, np.zeros((1, self._coef.shape[1]))])
        self._coef[len(self._coef) - len(change) + 1 :] += change[1:]
        return True

    def weights(self):
        return self._coef, self._intercept


class LeastSquares:
    """SC-III: least squares over all nodes and the constant.

    The basis is orthogonalised as it grows (Gram-Schmidt, twice), so that a node costs
    O(n_samples n_nodes). A node that satisfies the supervisory inequality cannot lie in the span
    of the earlier ones, to which the residual is orthogonal, but many of them may come close
    together: one whose weight would amplify round-off and little else is refused.
    """

    def __init__(self, y, max_nodes, alpha):
        self._alpha = alpha
        n = min(max_nodes + 1, len(y))
        self._q = np.empty((len(y), n), order="F")
        self._r = np.zeros((n, n))  # of columns of unit length
        self._z = np.zeros((n, y.shape[1]))
        self._length = np.empty(n)
        self._size = 0
        self.residual = y.copy()
        self.add(np.ones(len(y)))

    def add(self, g):
        k, length = self._size, np.linalg.norm(g)
        basis, new, parts = self._q[:, :k], g / length, np.zeros(k)
        for _ in range(2):
            part = basis.T @ new
            new -= basis @ part
            parts += part
        rest = np.linalg.norm(new)
        column = solve_triangular(self._r[:k, :k], parts) if k else parts
        # length of the new column of the inverse of r: how the node's weight amplifies errors
        if np.sqrt(1.0 + column @ column) > _AMPLIFICATION * rest:
            return False
        new /= rest
        self._q[:, k], self._r[:k, k], self._r[k, k] = new, parts, rest
        self._z[k], self._length[k] = new @ self.residual, length
        self.residual -= np.outer(new, self._z[k])
        self._size = k + 1
        return True

    def weights(self):
        k = self._size
        r, z, length = self._r[:k, :k], self._z[:k], self._length[:k, np.newaxis]
        if self._alpha == 0.0:
            solution = solve_triangular(r, z) / length
        else:
            penalty = np.sqrt(self._alpha) * np.eye(k)[1:]  # not on the constant
            stacked = np.vstack([r * length.T, penalty])
            solution = np.linalg.lstsq(stacked, np.vstack([z, np.zeros((k - 1, z.shape[1]))]))[0]
        return solution[1:], solution[0]
