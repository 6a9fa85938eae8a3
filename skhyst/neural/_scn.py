"""Stochastic configuration network: its random nodes, and how they are admitted.

Nodes are functions of scaled inputs. Centres of Gaussian nodes are samples, since lagged signals
fill only a thin part of any box. For either kind of node the scope is the steepest slope.

Output weights are updated node by node, by one of the three algorithms of Wang and Li (2017). Each
starts from the mean of the targets and keeps the current ``residual``. ``add(g)`` adds a node with
activations (n_samples,) and returns whether it was accepted; ``weights()`` returns coefficients
(n_nodes, n_outputs) and intercepts (n_outputs,).
"""

import warnings
from copy import copy
from functools import partial
from numbers import Integral, Real
from typing import Self

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.base import BaseEstimator, MultiOutputMixin
from sklearn.metrics import r2_score
from sklearn.model_selection import train_test_split
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from .._signals import input_signals
from .._sklearn import Interval, StrOptions, fit_context
from .._validation import (
    ScoredMixin,
    as_floats,
    refuse_large,
    refuse_size,
    refuse_std,
    rest_input,
)
from ..autoregressive import compiled_regressor
from ..exceptions import ConvergenceWarning
from ..operators import Signal, Stepper

_AMPLIFICATION = 1e7  # largest amplification of errors of the activations in the weights


class Constructive:
    """SC-I: the weight of the new node alone minimises the residual; earlier weights are kept."""

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
    """SC-II: least squares over the last nodes and the constant; earlier weights are kept."""

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
    of the earlier ones, to which the residual is orthogonal, but it can be close to it: a node
    whose weight would mainly amplify round-off is refused.
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
        basis, direction, coefficients = self._q[:, :k], g / length, np.zeros(k)
        for _ in range(2):
            projection = basis.T @ direction
            direction -= basis @ projection
            coefficients += projection
        rest = np.linalg.norm(direction)
        column = solve_triangular(self._r[:k, :k], coefficients) if k else coefficients
        # length of the new column of the inverse of r: how the node's weight amplifies errors
        if np.sqrt(1.0 + column @ column) > _AMPLIFICATION * rest:
            return False
        direction /= rest
        self._q[:, k], self._r[:k, k], self._r[k, k] = direction, coefficients, rest
        self._z[k], self._length[k] = direction @ self.residual, length
        self.residual -= np.outer(direction, self._z[k])
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


_ROUND_OFF = 1e-13  # residual of an exact fit, in standard deviations of the targets
_EXTREME = 1e152  # largest value and, inverted, smallest, whose squares are finite
_TRIES = 5  # candidates of a scope that may be refused for round-off before it is widened
_DEPENDENT = 1e-10  # spread of a principal component, relative to the largest, that is round-off
_FAINT = 1e-5  # root mean square of activations below which a node counts as zero
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
    """Return by how much one more node reduces the squared residual, (n_nodes, n_outputs).

    That is ``<e_q, g>^2 / <g, g>``, or zero for a node that almost vanishes at all samples: only
    its tail would act, with a huge weight.
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


class SCNRegressor(MultiOutputMixin, ScoredMixin, BaseEstimator):
    r"""Stochastic configuration network: random hidden nodes, admitted one at a time.

    .. math:: f_L(x) = \beta_0 + \sum_{j=1}^{L} \beta_j\, g(x; w_j, b_j)

    With the residual :math:`e_{L-1} = y - f_{L-1}` of each output :math:`q`, node :math:`L` is
    drawn at random and is admitted only if it satisfies the supervisory inequality

    .. math::
        \xi_{L,q} = \frac{\langle e_{L-1,q}, g \rangle^2}{\langle g, g \rangle}
        - (1 - r - \mu_L) \langle e_{L-1,q}, e_{L-1,q} \rangle \ge 0,
        \qquad \mu_L = \frac{1 - r}{L + 1},

    so that the residual decreases at a known rate whatever was drawn. Of ``n_candidates`` nodes the
    admissible one with the largest sum of :math:`\xi_{L,q}` is taken. If none is admissible, the
    contraction :math:`r` is relaxed; if that does not help, the scope :math:`\lambda` of the draw
    is widened and new candidates are drawn.

    The nodes have no memory. Inside :class:`~skhyst.autoregressive.NARXRegressor`, or after
    :class:`~skhyst.preprocessing.PlayOperators`, the network models hysteresis.

    Parameters
    ----------
    max_nodes : int, default=100
        Largest number of nodes.
    algorithm : {"SC-III", "SC-II", "SC-I"}, default="SC-III"
        Output weights by least squares over all nodes, over the last ``window`` nodes, or of the
        new node alone. The last two keep the weights of earlier nodes.
    activation : {"sigmoid", "rbf"}, default="sigmoid"
        :math:`1 / (1 + e^{-(w x + b)})`, with :math:`w, b` uniform in
        :math:`[-\lambda, \lambda]`, or :math:`\exp(-|x - c|^2 / 2 \sigma^2)`, with a sample as
        centre :math:`c` and :math:`1 / \sigma` uniform in :math:`(0, \lambda]`. Both act on scaled
        inputs, so that :math:`\lambda` has no unit.
    scaling : {"standard", "whiten"}, default="standard"
        Scale each input by its mean and standard deviation, or also rotate them to principal
        components of unit variance. Use ``"whiten"`` for lagged inputs: neighbouring samples of a
        signal are nearly equal, and hysteresis depends on their difference.
    scopes : array-like of float, default=(0.5, 1, 5, 10, 30, 50, 100, 150, 200, 250)
        Scopes :math:`\lambda`, tried in this order for each node.
    contraction : array-like of float, default=(0.9, 0.99, ..., 0.999999)
        Values of :math:`r`, between 0 and 1, tried in this order in each scope.
    n_candidates : int, default=100
        Nodes drawn in each scope.
    tolerance : float, default=0.01
        The network is complete when the root mean square of each output's residual is at most
        this fraction of the output's standard deviation.
    window : int, default=10
        Nodes whose weights SC-II solves for.
    alpha : float, default=0.0
        Ridge penalty on the output weights of SC-III: ``alpha`` times the sum of their squares is
        added to the sum of squared residuals, all with outputs of unit standard deviation. It acts
        on the weights of the finished network; nodes are admitted without it.
    early_stopping : bool, default=False
        Hold out ``validation_fraction`` of the samples, stop when their R2 has not improved for
        ``n_iter_no_change`` nodes, and keep the network that was best on them. The samples are
        drawn at random, which assumes that the noise of neighbouring samples is independent.
    validation_fraction : float, default=0.1
        Fraction of the samples that is held out.
    n_iter_no_change : int, default=10
        Nodes to wait for an improvement.
    random_state : int, RandomState instance or None, default=None
        Source of the candidates and of the held-out samples.

    Attributes
    ----------
    n_nodes_ : int
        Number of nodes.
    coef_ : ndarray of shape (n_nodes,) or (n_outputs, n_nodes)
        Output weights, units of the output.
    intercept_ : float or ndarray of shape (n_outputs,)
        Constant, units of the output.
    hidden_weights_ : ndarray of shape (n_nodes, n_features)
        Input weights of sigmoid nodes, per unit of the input.
    hidden_biases_ : ndarray of shape (n_nodes,)
        Biases of sigmoid nodes.
    centers_ : ndarray of shape (n_nodes, n_features)
        Centres of Gaussian nodes, units of the input.
    widths_ : ndarray of shape (n_nodes,)
        :math:`\sigma` of Gaussian nodes, in scaled inputs.
    scaling_ : ndarray of shape (n_features, n_components)
        Matrix :math:`S` of the scaled inputs :math:`(x - \bar x)^T S` of Gaussian nodes.
    history_ : dict of str to ndarray
        A value for each node: ``scope``, ``contraction``, ``residual`` (root mean square of the
        residual with the node, relative to that of the centred outputs), ``xi`` (n, n_outputs;
        outputs of unit standard deviation) and, with early stopping, ``validation_score``.
    validation_score_ : float
        R2 on the held-out samples; with early stopping only.
    stop_reason_ : {"tolerance", "max_nodes", "validation", "no_candidate"}
        Why no further node was added.
    n_features_in_ : int
        Number of inputs.
    feature_names_in_ : ndarray of str
        Names of the inputs, where ``X`` has them.

    Warns
    -----
    ConvergenceWarning
        No candidate satisfied the inequality before the tolerance was reached: draw more
        candidates, widen ``scopes``, or bring ``contraction`` closer to 1.

    See Also
    --------
    skhyst.autoregressive.NARXRegressor : Lagged signals for this network.
    skhyst.preprocessing.PlayOperators : Hysteretic features for it.

    Notes
    -----
    Candidates that vanish almost everywhere are not admitted, nor, with SC-III, those that are
    linear combinations of earlier nodes up to round-off: their weights would be huge. A node costs
    O(n_samples n_candidates n_features) to draw, and with SC-III O(n_samples n_nodes) to add.

    References
    ----------
    .. [1] Wang and Li, *IEEE Transactions on Cybernetics*, 2017, Algorithms SC-I to SC-III.
    .. [2] Han et al., *An Identification Method for Dynamic Systems with SCNs Hysteresis
       Compensator*, undated, (9), (10), (13).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.neural import SCNRegressor
    >>> x = np.linspace(0.0, 1.0, 200).reshape(-1, 1)
    >>> model = SCNRegressor(tolerance=0.01, random_state=0).fit(x, np.sin(8 * x[:, 0]))
    >>> model.stop_reason_, model.n_nodes_ <= 20
    ('tolerance', True)
    """

    _parameter_constraints = {
        "max_nodes": [Interval(Integral, 1, None, closed="left")],
        "algorithm": [StrOptions({"SC-I", "SC-II", "SC-III"})],
        "activation": [StrOptions(set(ACTIVATIONS))],
        "scaling": [StrOptions({"standard", "whiten"})],
        "scopes": ["array-like"],
        "contraction": ["array-like"],
        "n_candidates": [Interval(Integral, 1, None, closed="left")],
        "tolerance": [Interval(Real, 0, None, closed="left")],
        "window": [Interval(Integral, 1, None, closed="left")],
        "alpha": [Interval(Real, 0, None, closed="left")],
        "early_stopping": ["boolean"],
        "validation_fraction": [Interval(Real, 0, 1, closed="neither")],
        "n_iter_no_change": [Interval(Integral, 1, None, closed="left")],
        "random_state": ["random_state"],
    }

    def __init__(
        self,
        max_nodes=100,
        *,
        algorithm="SC-III",
        activation="sigmoid",
        scaling="standard",
        scopes=(0.5, 1.0, 5.0, 10.0, 30.0, 50.0, 100.0, 150.0, 200.0, 250.0),
        contraction=(0.9, 0.99, 0.999, 0.9999, 0.99999, 0.999999),
        n_candidates=100,
        tolerance=0.01,
        window=10,
        alpha=0.0,
        early_stopping=False,
        validation_fraction=0.1,
        n_iter_no_change=10,
        random_state=None,
    ):
        self.max_nodes = max_nodes
        self.algorithm = algorithm
        self.activation = activation
        self.scaling = scaling
        self.scopes = scopes
        self.contraction = contraction
        self.n_candidates = n_candidates
        self.tolerance = tolerance
        self.window = window
        self.alpha = alpha
        self.early_stopping = early_stopping
        self.validation_fraction = validation_fraction
        self.n_iter_no_change = n_iter_no_change
        self.random_state = random_state

    @fit_context(prefer_skip_nested_validation=True)
    def fit(self, X, y) -> Self:
        """Build the network.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs.
        y : array-like of shape (n_samples,) or (n_samples, n_outputs)
            Outputs.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If scopes are not positive, contractions are outside (0, 1), there is a penalty for an
            algorithm that does not solve for all weights, or too few samples to hold some out.
        """
        X, y = as_floats(self, X, y, multi_output=True, ensure_min_samples=2)
        refuse_size("X", X, _EXTREME)
        refuse_size("y", y, _EXTREME)
        scopes, contraction = self._read_grids()
        rng = check_random_state(self.random_state)
        columns = y.reshape(len(X), -1)
        held_out = None
        if self.early_stopping:
            n_out = max(2, round(self.validation_fraction * len(X)))
            if n_out > len(X) - 2:
                raise ValueError(
                    f"Early stopping would hold out {n_out} of n_samples={len(X)}: "
                    "SCNRegressor must keep two to fit."
                )
            X, X_out, columns, y_out = train_test_split(
                X, columns, test_size=n_out, random_state=rng
            )
            held_out = X_out, y_out
        x_mean, scaling, unscaling = self._scaling_of(X)
        y_mean, y_scale = _location_and_scale(columns)
        if held_out:
            held_out = (held_out[0] - x_mean) @ scaling, (held_out[1] - y_mean) / y_scale
        X, columns = (X - x_mean) @ scaling, (columns - y_mean) / y_scale
        nodes, coef, intercept = self._build(X, columns, held_out, scopes, contraction, rng)
        self.n_nodes_ = len(nodes)
        if self.activation == "sigmoid":
            self.hidden_weights_ = nodes[:, :-1] @ scaling.T
            self.hidden_biases_ = nodes[:, -1] - self.hidden_weights_ @ x_mean
        else:
            self.centers_ = x_mean + nodes[:, :-1] @ unscaling
            self.widths_ = 1.0 / nodes[:, -1]
            self.scaling_ = scaling
        self.coef_ = (coef * y_scale).T
        self.intercept_ = y_mean + intercept * y_scale
        if y.ndim == 1:
            self.coef_, self.intercept_ = self.coef_[0], float(self.intercept_[0])
        return self

    def _read_grids(self):
        grids = []
        for name, upper in (("scopes", np.inf), ("contraction", 1.0)):
            grid = np.asarray(getattr(self, name), dtype=float)
            if grid.ndim != 1 or not grid.size or not ((grid > 0.0) & (grid < upper)).all():
                kind = "positive numbers" if upper == np.inf else "numbers between 0 and 1"
                raise ValueError(
                    f"The '{name}' parameter of SCNRegressor must be a list of {kind}. "
                    f"Got {getattr(self, name)!r} instead."
                )
            grids.append(grid)
        if self.alpha > 0.0 and self.algorithm != "SC-III":
            raise ValueError(
                "The 'alpha' parameter of SCNRegressor must be 0 where 'algorithm' is "
                f"{self.algorithm!r}. Got {self.alpha!r} instead."
            )
        return grids

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = self.algorithm != "SC-III"  # weights are never revised
        return tags

    def _scaling_of(self, X):
        """Return the mean, the matrix that scales centred rows, and the one that undoes it."""
        mean, scale = _location_and_scale(X)
        if self.scaling == "standard":
            return mean, np.diag(1.0 / scale), np.diag(scale)
        _, spread, axes = np.linalg.svd((X - mean) / scale, full_matrices=False)
        spread /= np.sqrt(len(X))
        kept = spread > _DEPENDENT * spread[0]
        spread, axes = spread[kept], axes[kept]
        return mean, (axes / spread[:, np.newaxis] / scale).T, spread[:, np.newaxis] * axes * scale

    def _build(self, X, y, held_out, scopes, contraction, rng):
        """Grow the network on standardised data; return nodes, coefficients and intercepts."""
        activation, solver = ACTIVATIONS[self.activation][0], self._solver(y)
        nodes, hidden, total, best = [], [], np.linalg.norm(y), (-np.inf, 0, None)
        names = ["scope", "contraction", "residual", "xi", *["validation_score"] * bool(held_out)]
        history = {name: [] for name in names}
        while (reason := self._reason_to_stop(solver.residual, len(nodes), best[1])) is None:
            candidates = self._candidates(
                X, solver.residual, len(nodes) + 1, scopes, contraction, rng
            )
            # lazily: another candidate is only evaluated if the solver refuses the one before
            accepted = (c for c in candidates if solver.add(activation(X, c[0][np.newaxis])[:, 0]))
            next_node = next(accepted, None)
            if next_node is None:
                reason = "no_candidate"
                break
            node, scope, r, xi = next_node
            nodes.append(node)
            values = [scope, r, np.linalg.norm(solver.residual) / total, xi]
            if held_out:
                hidden.append(activation(held_out[0], node[np.newaxis])[:, 0])
                coef, intercept = solver.weights()
                score = r2_score(held_out[1], np.transpose(hidden) @ coef + intercept)
                if score > best[0]:
                    best = score, len(nodes), (coef.copy(), np.copy(intercept))
                values.append(score)
            for name, value in zip(names, values, strict=True):
                history[name].append(value)
        if reason == "no_candidate":
            warnings.warn(
                f"No candidate for node {len(nodes) + 1} satisfied the supervisory inequality, and "
                f"the residual is {np.linalg.norm(solver.residual) / total:.2g} of the outputs' "
                "standard deviation. Increase 'n_candidates', widen 'scopes', or bring "
                "'contraction' closer to 1.",
                ConvergenceWarning,
                stacklevel=4,
            )
        n, weights = len(nodes), solver.weights()
        if held_out:
            self.validation_score_ = float(best[0]) if best[2] else float("nan")
            n, weights = best[1:] if best[2] else (n, weights)
        self.stop_reason_ = reason
        self.history_ = {name: np.array(values[:n]) for name, values in history.items()}
        return np.reshape(nodes[:n], (n, X.shape[1] + 1)), *weights

    def _solver(self, y):
        if self.algorithm == "SC-III":
            return LeastSquares(y, self.max_nodes, self.alpha)
        return Window(y, self.window) if self.algorithm == "SC-II" else Constructive(y)

    def _reason_to_stop(self, residual, n_nodes, n_best):
        """Return why no further node is to be added, or None."""
        tolerance = max(self.tolerance, _ROUND_OFF) * np.sqrt(len(residual))
        if (np.linalg.norm(residual, axis=0) <= tolerance).all():
            return "tolerance"
        if n_nodes == min(self.max_nodes, len(residual) - 1):
            return "max_nodes"
        if self.early_stopping and n_nodes - n_best >= self.n_iter_no_change:
            return "validation"
        return None

    def _candidates(self, X, residual, size, scopes, contraction, rng):
        """Yield (node, scope, r, xi) of admissible candidates, the best of each scope first."""
        activation, draw = ACTIVATIONS[self.activation]
        squares = np.square(residual).sum(axis=0)
        bounds = 1.0 - contraction - (1.0 - contraction) / (size + 1)
        for scope in scopes:
            nodes = draw(X, scope, self.n_candidates, rng)
            gains = match(activation, X, nodes, residual)
            admissible = (gains >= bounds[:, np.newaxis, np.newaxis] * squares).all(axis=2)
            first = np.where(admissible.any(axis=0), admissible.argmax(axis=0), len(bounds))
            order = np.lexsort((-gains.sum(axis=1), first))[:_TRIES]
            for best in order[first[order] < len(bounds)]:
                level = first[best]
                yield nodes[best], scope, contraction[level], gains[best] - bounds[level] * squares

    def predict(self, X, return_std=False) -> np.ndarray:
        """Return the output of the network.

        Parameters
        ----------
        X : array-like of shape (n_samples, n_features)
            Inputs of the network.
        return_std : bool, default=False
            Must be False: the nodes are drawn at random.

        Returns
        -------
        ndarray of shape (n_samples,) or (n_samples, n_outputs)
        """
        check_is_fitted(self)
        refuse_std(self, return_std, "whose nodes are drawn at random")
        X = as_floats(self, X, reset=False)
        refuse_large("X", X, _EXTREME)
        if self.activation == "sigmoid":
            hidden = sigmoid(X, np.column_stack([self.hidden_weights_, self.hidden_biases_]))
        else:
            nodes = np.column_stack([self.centers_ @ self.scaling_, 1.0 / self.widths_])
            hidden = gaussian(X @ self.scaling_, nodes)
        return hidden @ self.coef_.T + self.intercept_

    def stepper(self, dt=None, u0=0.0, initial_state=None) -> Stepper:
        """Return the fitted network as a simulated device that is stepped sample by sample.

        Parameters
        ----------
        dt, u0, initial_state : float, float or array-like, str, default=None, 0.0, None
            Those of all models. They have no effect: the network has no memory.

        Returns
        -------
        Stepper
            ``step(u) -> y`` of a number, or of a row of inputs where there are several.

        Raises
        ------
        NotImplementedError
            If the network has several outputs.
        ValueError
            If a parameter has an invalid value.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.neural import SCNRegressor
        >>> x = np.linspace(0.0, 1.0, 200).reshape(-1, 1)
        >>> model = SCNRegressor(random_state=0).fit(x, np.sin(8 * x[:, 0]))
        >>> bool(np.isclose(model.stepper().step(x[7, 0]), model.predict(x)[7]))
        True
        """
        check_is_fitted(self)
        rest_input(u0, initial_state, self.n_features_in_, f"{type(self).__name__}.stepper")
        step = compiled_regressor(self, self.n_features_in_)
        again = partial(copy(self).stepper, dt, u0, initial_state)
        inputs = input_signals(self, step.n_inputs)
        return Stepper(step, dt, inputs=inputs, result=Signal("response"), remake=again)


def _location_and_scale(values):
    """Return the mean and the standard deviation of columns, 1 where a column is constant."""
    peak = np.abs(values).max(axis=0)
    peak[peak == 0.0] = 1.0
    relative = values / peak  # squares of the values themselves may overflow
    mean, scale = relative.mean(axis=0), relative.std(axis=0)
    return peak * mean, np.where(scale > 10.0 * np.finfo(float).eps, peak * scale, 1.0)
