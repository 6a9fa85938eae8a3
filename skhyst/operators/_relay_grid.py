"""What the operators over the half plane ``alpha >= beta`` share: levels and cells."""

import numpy as np

__all__ = ["cell_indices", "check_grid"]


def cell_indices(n_levels):
    """Return the intervals of alpha and of beta of each cell, two arrays (n (n - 1) / 2,)."""
    return np.tril_indices(n_levels - 1)


def check_grid(operator):
    """Turn array fields into read-only arrays; refuse levels and weights that do not fit."""
    kind = type(operator).__name__
    for name in ("levels", "weights", "reversible"):
        if hasattr(operator, name):
            constant = np.array(getattr(operator, name), dtype=float, ndmin=1)
            constant.flags.writeable = False
            object.__setattr__(operator, name, constant)
    levels, weights = operator.levels, operator.weights
    if levels.ndim != 1 or levels.size < 2 or not np.all(levels[1:] > levels[:-1]):
        raise ValueError(
            f"The 'levels' parameter of {kind} must be a list of two or more ascending values. "
            f"Got {levels!r} instead."
        )
    n_cells = levels.size * (levels.size - 1) // 2
    if weights.shape != (n_cells,):
        raise ValueError(
            f"The 'weights' parameter of {kind} must have one value for each of the {n_cells} "
            f"cells between {levels.size} levels. Got shape {weights.shape} instead."
        )
