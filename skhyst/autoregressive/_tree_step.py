"""Sums of decision trees with feedback of their past outputs, extracted from scikit-learn.

All nodes are in one array, each tree depth first, so that the left child of a node comes right
after it, often in the same cache line. A node of ``NODE`` is a threshold, the feature that is
compared with it, and the index of the right child; a leaf has the feature -1 and its value as
threshold.
"""

from dataclasses import dataclass

import numpy as np

from .._jit import bind, jit
from ._runs import Lags
from ._steps import Step, run

NODE = np.dtype([("threshold", np.float64), ("feature", np.int32), ("right", np.int32)])


@jit(inline=True)
def _packed(nodes, place):
    """Return threshold, feature and right child of a node of ``NODE``."""
    node = nodes[place]
    return node["threshold"], node["feature"], np.int64(node["right"])


@jit
def _plain(nodes, place):
    """Return the same from a row of an array of floats."""
    return nodes[place, 0], int(nodes[place, 1]), int(nodes[place, 2])


def step(nodes, place):
    """Placeholder of the function that reads a node."""
    raise NotImplementedError


def trees(x, at, c):
    """Return a sum of trees; ``c`` are the fields of :class:`TreesStep`."""
    centre, scale, nodes, roots, offset, factor = c
    for j in range(centre.size):
        x[at + j] = (x[at + j] - centre[j]) / scale[j]
    total = 0.0
    for k in range(roots.size):
        place = int(roots[k])
        threshold, feature, right = step(nodes, place)
        while feature >= 0:
            place = place + 1 if x[at + feature] <= threshold else right
            threshold, feature, right = step(nodes, place)
        total += threshold
    return offset + factor * total


@dataclass(frozen=True)
class TreesStep(Step):
    """``offset + factor * sum of trees``."""

    lags: Lags
    centre: np.ndarray  # (n_signals,): features are (signal - centre) / scale
    scale: np.ndarray
    nodes: np.ndarray  # of NODE, those of all trees
    roots: np.ndarray  # index of each tree's first node
    offset: float
    factor: float

    _loop = staticmethod(bind(run, bind(trees, _packed)))

    def _constants(self):
        return self.centre, self.scale, self.nodes, self.roots, self.offset, self.factor

    def plain_law(self):
        centre, scale, nodes, *others = self._constants()
        rows = np.stack([nodes[name].astype(float) for name in NODE.names], axis=1)
        return _TREES, (centre, scale, rows, *others)


_TREES = bind(trees, _plain)


def rounded_at(thresholds):
    """Return thresholds for float64 signals that decide as the given ones do for float32 signals.

    scikit-learn rounds signals to float32 before it compares them. Rounding is monotone: signals
    below the midpoint between the largest float32 that is not above the threshold and the next one
    are rounded down, the midpoint itself to the one whose last bit is zero.
    """
    below = thresholds.astype(np.float32)
    below = np.where(below > thresholds, np.nextafter(below, np.float32(-np.inf)), below)
    above = np.nextafter(below, np.float32(np.inf))
    half = 0.5 * (below.astype(float) + above)
    return np.where(half.astype(np.float32) == below, half, np.nextafter(half, -np.inf))


def flatten_trees(trees):
    """Return (nodes, roots, offset, factor) of the mean of fitted decision trees."""
    parts = []
    for tree in trees:
        inner = tree.tree_
        if inner.n_outputs != 1:
            return None
        left, value = inner.children_left, inner.value[:, 0, 0]
        threshold = rounded_at(inner.threshold)
        parts.append(_depth_first(left, inner.children_right, inner.feature, threshold, value))
    return *_joined(parts), 0.0, 1.0 / len(parts)


def flatten_boosting(ensemble):
    """Return the trees of a ``GradientBoostingRegressor``, unless it starts from another model."""
    if isinstance(ensemble.init_, str):
        offset = 0.0
    elif type(ensemble.init_).__name__ == "DummyRegressor":
        offset = float(np.ravel(ensemble.init_.constant_)[0])
    else:
        return None
    nodes, roots, _, _ = flatten_trees(ensemble.estimators_[:, 0])
    return nodes, roots, offset, ensemble.learning_rate


def flatten_histograms(ensemble):
    """Return the trees of a ``HistGradientBoostingRegressor``, unless it has categories."""
    parts = []
    for (predictor,) in ensemble._predictors:
        nodes = predictor.nodes
        if nodes["is_categorical"].any():
            return None
        left = np.where(nodes["is_leaf"], -1, nodes["left"].astype(np.int64))
        parts.append(
            _depth_first(
                left, nodes["right"], nodes["feature_idx"], nodes["num_threshold"], nodes["value"]
            )
        )
    offset = float(np.ravel(ensemble._baseline_prediction)[0])
    return *_joined(parts), offset, 1.0


def _depth_first(left, right, feature, threshold, value):
    """Return the nodes of one tree, the left child of each right after it."""
    n_nodes = len(left)
    inner = left >= 0
    order = np.arange(n_nodes)
    if (left[inner] != order[inner] + 1).any():
        order, stack = [], [0]
        while stack:
            place = stack.pop()
            order.append(place)
            if left[place] >= 0:
                stack += [right[place], left[place]]
        order = np.array(order, dtype=np.int64)
    place = np.empty(n_nodes, dtype=np.int64)
    place[order] = np.arange(len(order))
    inner = inner[order]
    nodes = np.zeros(len(order), dtype=NODE)
    nodes["threshold"] = np.where(inner, threshold[order], value[order])
    nodes["feature"] = np.where(inner, feature[order], -1)
    nodes["right"] = np.where(inner, place[np.where(inner, right[order], 0)], 0)
    return nodes


def _joined(parts):
    sizes = np.array([len(part) for part in parts], dtype=np.int64)
    roots = np.cumsum(sizes) - sizes
    for part, root in zip(parts, roots, strict=True):
        part["right"] += np.int32(root)
    return np.concatenate(parts), roots
