r"""Linear difference equations at another sampling interval.

.. math:: y(k) = \sum_i a_i \, y(k - i) + \sum_{j, i} b_{ji} \, u_j(k - i)

has a state x in observer form, :math:`x(k + 1) = A x(k) + B u(k)`, :math:`y = x_1 + D u`, and
the inputs, which are held between samples, are included as states:

.. math::
    \begin{pmatrix} x \\ u \end{pmatrix}(k + 1) =
    \begin{pmatrix} A & B \\ 0 & I \end{pmatrix} \begin{pmatrix} x \\ u \end{pmatrix}(k)

Over r intervals the matrix is raised to the power r. This exists for integer r, and otherwise if no
pole is zero or negative: such poles do not result from any system in continuous time.
"""

import numpy as np
from scipy.linalg import fractional_matrix_power
from scipy.signal import ss2tf

_WHOLE = 1e-9  # relative difference of a ratio of intervals from a whole number
_ON_AXIS = 1e-9  # angle of a negative pole, and magnitude of one at zero


def at_ratio(inputs, output_lags, weights, ratio):
    """Return the terms of a linear model at ``ratio`` times its sampling interval.

    Parameters
    ----------
    inputs : sequence of (int, int)
        Column and lag of each term of an input.
    output_lags : sequence of int
        Lag of each term of the output.
    weights : ndarray of shape (n_terms,)
        Of the inputs, then of the outputs.
    ratio : float
        New interval over the old one.

    Returns
    -------
    inputs : list of (int, int)
    output_lags : list of int
    weights : ndarray of shape (n_terms,)

    Raises
    ------
    ValueError
        If no system in continuous time has the poles, and ``ratio`` is not a whole number.
    """
    order = max([1, *output_lags, *(lag for _, lag in inputs)])
    columns = sorted({column for column, _ in inputs})
    a, b = np.zeros(order + 1), np.zeros((order + 1, len(columns)))
    for lag, weight in zip(output_lags, weights[len(inputs) :], strict=True):
        a[lag] += weight
    for (column, lag), weight in zip(inputs, weights, strict=False):
        b[lag, columns.index(column)] += weight
    system = np.eye(order + len(columns))
    system[:order, :order] = np.eye(order, k=1)
    system[:order, 0] = a[1:]
    system[:order, order:] = b[1:] + np.outer(a[1:], b[0])
    poles = np.linalg.eigvals(system[:order, :order])
    whole = round(ratio)
    if whole >= 1 and abs(ratio - whole) <= _WHOLE * ratio:
        system = np.linalg.matrix_power(system, whole)
    else:
        bad = (np.abs(poles) < _ON_AXIS) | (np.abs(np.angle(poles)) > np.pi - _ON_AXIS)
        if bad.any():
            raise ValueError(
                f"A model with the pole {poles[bad][0].real:.3g} has no exact one at {ratio:g} "
                "times its sampling interval: only whole multiples have, since no system in "
                "continuous time has a pole at zero (a delay) or a negative one."
            )
        system = fractional_matrix_power(system, ratio).real
    parts = system[:order, :order], system[:order, order:], np.eye(1, order), b[:1]
    transfer_functions = [ss2tf(*parts, input=j) for j in range(len(columns))]
    direct = {column for column, lag in inputs if lag == 0}
    terms = [
        (column, lag, numerator[0, lag])
        for column, (numerator, _) in zip(columns, transfer_functions, strict=True)
        for lag in range(order + 1)
        if lag or column in direct
    ]
    denominator = -np.poly(parts[0])[1:]
    inputs = [(column, lag) for column, lag, _ in terms]
    return inputs, list(range(1, order + 1)), np.array([*(w for *_, w in terms), *denominator])
