"""Sums of decision trees that see their own past outputs, and those of scikit-learn as such.

All nodes lie in one array, each tree depth first, so that the left child of a node comes right
after it, often in the same line of the cache. A node of ``NODE`` is a threshold, the feature that
is compared with it, and the place of the right child; a leaf has the feature -1 and its value in
the place of the threshold.
"""

from dataclasses import dataclass

import numpy as np

from .._jit import jit
from ._runs import Lags, clipped
from ._steps import Step

NODE = np.dtype([("threshold", np.float64), ("feature", np.int32), ("right", np.int32)])


@jit
def _sum(nodes, roots, row):
    total = 0.0
    for root in roots:
        place = root
        while True:
            node = nodes[place]
            feature = node["feature"]
            if feature < 0:
                break
            place = place + 1 if row[feature] <= node["threshold"] else np.int64(node["right"])
        total += nodes[place]["threshold"]
    return total


@jit
def trees_run(centre, scale, nodes, roots, single, offset, factor, inputs, lags, bound, y):
    """Run a sum of trees over its past outputs; see :class:`TreesStep`."""
    n_samples, n_inputs = inputs.shape
    before = len(y) - n_samples
    row = np.empty(n_inputs + len(lags))
    for i in range(n_samples):
        k = before + i
        for j in range(len(row)):
            signal = inputs[i, j] if j < n_inputs else y[k - lags[j - n_inputs]]
            feature = (signal - centre[j]) / scale[j]
            row[j] = np.float64(np.float32(feature)) if single else feature
        value = offset + factor * _sum(nodes, roots, row)
        y[k] = clipped(value, bound)


@dataclass(frozen=True)
class TreesStep(Step):
    """``offset + factor * sum of trees``."""

    lags: Lags
    centre: np.ndarray  # (n_signals,): features are (signal - centre) / scale
    scale: np.ndarray
    nodes: np.ndarray  # of NODE, those of all trees
    roots: np.ndarray  # place of each tree's first node
    single: bool  # whether they are then rounded to single precision before they are compared
    offset: float
    factor: float

    _loop = staticmethod(trees_run)


def flatten_trees(trees):
    """Return (nodes, roots, single, offset, factor) of the mean of fitted decision trees."""
    parts = []
    for tree in trees:
        inner = tree.tree_
        if inner.n_outputs != 1:
            return None
        left, value = inner.children_left, inner.value[:, 0, 0]
        parts.append(
            _depth_first(left, inner.children_right, inner.feature, inner.threshold, value)
        )
    return *_joined(parts), True, 0.0, 1.0 / len(parts)


def flatten_boosting(ensemble):
    """Return the same of a ``GradientBoostingRegressor``, unless it starts from another model."""
    if isinstance(ensemble.init_, str):
        offset = 0.0
    elif type(ensemble.init_).__name__ == "DummyRegressor":
        offset = float(np.ravel(ensemble.init_.constant_)[0])
    else:
        return None
    nodes, roots, single, _, _ = flatten_trees(ensemble.estimators_[:, 0])
    return nodes, roots, single, offset, ensemble.learning_rate


def flatten_histograms(ensemble):
    """Return the same of a ``HistGradientBoostingRegressor``, unless it has categories."""
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
    return *_joined(parts), False, offset, 1.0


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
