"""Sums of decision trees, evaluated row by row or in a free run over their own past outputs.

All nodes lie in one array, each tree depth first, so that the left child of a node comes right
after it, often in the same line of the cache. A node of ``NODE`` is a threshold, the feature that
is compared with it, and the place of the right child; a leaf has the feature -1 and its value in
the place of the threshold.
"""

import numpy as np

from .._jit import jit

__all__ = [
    "NODE",
    "trees_rows",
    "trees_run",
]

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
def _feature(value, centre, scale, single):
    value = (value - centre) / scale
    return np.float64(np.float32(value)) if single else value


@jit
def trees_rows(nodes, roots, centre, scale, single, Z, out):
    """Fill ``out`` (n,) with the sums of the trees for the rows of ``Z`` (n, n_features)."""
    row = np.empty(Z.shape[1])
    for i in range(len(Z)):
        for j in range(Z.shape[1]):
            row[j] = _feature(Z[i, j], centre[j], scale[j], single)
        out[i] = _sum(nodes, roots, row)


@jit
def trees_run(nodes, roots, centre, scale, single, offset, factor, inputs, lags, bound, y):
    """Run ``offset + factor * sum of trees`` over its past outputs.

    Parameters
    ----------
    nodes : ndarray of NODE
        Nodes of all trees.
    roots : ndarray of int
        Place of each tree's first node.
    centre, scale : ndarray of shape (n_features,)
        Features are ``(signal - centre) / scale``.
    single : bool
        Whether the features are then rounded to single precision before they are compared.
    offset, factor : float
        Output is ``offset`` plus ``factor`` times the sum of the trees.
    inputs : ndarray of shape (n, n_inputs)
        Lagged inputs: the first features.
    lags : ndarray of int
        Lags of the output: the features after them.
    bound : float
        Magnitude beyond which outputs are cut off.
    y : ndarray of shape (start + n,)
        Outputs before the run; the others are filled.

    Returns
    -------
    n_good : int
        Samples before the first one that was cut off.
    """
    n_samples, n_inputs = inputs.shape
    before = len(y) - n_samples
    n_good = n_samples
    row = np.empty(n_inputs + len(lags))
    for i in range(n_samples):
        k = before + i
        for j in range(n_inputs):
            row[j] = _feature(inputs[i, j], centre[j], scale[j], single)
        for j in range(n_inputs, len(row)):
            past = y[k - lags[j - n_inputs]]
            row[j] = _feature(past, centre[j], scale[j], single)
        value = offset + factor * _sum(nodes, roots, row)
        if not abs(value) <= bound:
            n_good = min(n_good, i)
            value = -bound if value < 0.0 else bound
        y[k] = value
    return n_good
