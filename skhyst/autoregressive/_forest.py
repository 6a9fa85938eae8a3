"""The trees of scikit-learn's ensembles as one array of nodes, see ``_tree_loops``."""

import numpy as np

from ._tree_loops import NODE

__all__ = ["flatten_boosting", "flatten_histograms", "flatten_trees"]


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
