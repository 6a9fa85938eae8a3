r"""Poles of a rational function from values at complex frequencies: relaxed vector fitting.

Data are blocks of equations ``target(s) = sum_i N_i(s) / D(s) regressor_i(s)`` with a common
denominator D and separate numerators for each block. A frequency response is such a block, with the
regressor 1; so are the transforms of records, with the transforms of the inputs and, for the
transient due to the ends of a record, 1 as regressors.

With poles a_k, the functions ``sigma(s) = d + sum_k c_k / (s - a_k)`` and ``sigma N_i / D`` with
the same poles solve a linear least-squares problem; the zeros of sigma are the next poles
(Gustavsen and Semlyen, *IEEE Transactions on Power Delivery*, 1999; relaxed: Gustavsen, *IEEE
Transactions on Power Delivery*, 2006). It is the iteration of Sanathanan and Koerner, *IEEE
Transactions on Automatic Control*, 1963, in a basis that stays well conditioned (Deschrijver et
al., *IEEE Microwave and Wireless Components Letters*, 2008). Each block is condensed by a QR
factorisation before they are stacked.
"""

from dataclasses import dataclass

import numpy as np

_ITERATIONS = 10
_DAMPING = 0.02  # ratio of the initial poles
_SLOWEST = 1e-9  # least distance of a stable pole from the imaginary axis, relative to its size


@dataclass(frozen=True)
class RationalBlock:
    """Equations that share numerators: target (n,), regressors (n, q), weights (n,)."""

    target: np.ndarray
    regressors: np.ndarray
    weight: np.ndarray


def vector_fit(s, blocks, n_poles, *, feedthrough=True, stable=True):
    """Return the common poles of blocks of equations.

    Parameters
    ----------
    s : ndarray of shape (n,), complex
        Points on the imaginary axis, rad/s; the same for all blocks.
    blocks : sequence of RationalBlock
        With the same denominator.
    n_poles : int
        Degree of the denominator.
    feedthrough : bool, default=True
        Whether numerators may have the degree of the denominator; otherwise one less.
    stable : bool, default=True
        Mirror poles of the right half plane at the imaginary axis.

    Returns
    -------
    poles : ndarray of shape (n_poles,), complex
        rad/s; each pole with positive imaginary part is followed by its conjugate.
    cost : float
        Weighted sum of squares of the residual.
    """
    size = np.abs(s)
    unit = np.exp(np.mean(np.log(size[size > 0.0])))
    x = s / unit
    low, high = size[size > 0.0].min() / unit, size.max() / unit
    best = None
    for spread in (np.geomspace, np.linspace):
        frequencies = spread(low, high, n_poles // 2 + 2)[1:-1]
        pairs = frequencies * (-_DAMPING + 1j)
        poles = np.stack([pairs, pairs.conj()], axis=1).ravel()
        poles = np.r_[poles, [-np.sqrt(low * high)] * (n_poles % 2)]
        for _ in range(_ITERATIONS):
            poles = _relocate(x, blocks, poles, feedthrough)
            if stable:
                real = np.minimum(-np.abs(poles.real), -_SLOWEST * np.abs(poles))
                poles = real + 1j * poles.imag
        _, cost = rational_residues(x, blocks, poles, feedthrough=feedthrough)
        if best is None or cost < best[1]:
            best = unit * poles, cost
    return best


def rational_residues(s, blocks, poles, *, feedthrough=True):
    """Return the coefficients of each block in the basis of :func:`_basis`, and the cost.

    Parameters are those of :func:`vector_fit`; ``poles`` are as it returns them.

    Returns
    -------
    coefficients : list of ndarray of shape (n_poles [+ 1], q)
        Real; the last row is the feed-through.
    cost : float
        Weighted sum of squares of the residual.
    """
    basis = _basis(s, poles, feedthrough)
    coefficients, cost = [], 0.0
    for block in blocks:
        rows = _real(block.weight[:, None] * _products(basis, block.regressors))
        target = _real(block.weight * block.target)
        scale = np.linalg.norm(rows, axis=0)
        scale[scale == 0.0] = 1.0
        solution = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
        cost += float(np.sum((target - rows @ solution) ** 2))
        coefficients.append(solution.reshape(basis.shape[1], -1))
    return coefficients, cost


def _real(values):
    return np.concatenate([values.real, values.imag])


def _products(basis, regressors):
    return (basis[:, :, None] * regressors[:, None, :]).reshape(len(basis), -1)


def _basis(s, poles, feedthrough):
    """Return partial fractions (n, n_poles [+ 1]) for real coefficients: two columns per pair."""
    columns = np.empty((len(s), len(poles) + feedthrough), dtype=complex)
    columns[:, -1] = 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        fractions = 1.0 / (s[:, None] - poles)
    columns[:, : len(poles)] = fractions
    first = np.flatnonzero(poles.imag > 0.0)
    columns[:, first] = fractions[:, first] + fractions[:, first + 1]
    columns[:, first + 1] = 1j * (fractions[:, first] - fractions[:, first + 1])
    return columns


def _relocate(s, blocks, poles, feedthrough):
    """Return the zeros of sigma."""
    n = len(poles)
    own_basis, common_basis = _basis(s, poles, feedthrough), _basis(s, poles, True)
    condensed, power = [], 0.0
    for block in blocks:
        weight = block.weight[:, None]
        numerators = weight * _products(own_basis, block.regressors)
        denominator = -weight * block.target[:, None] * common_basis
        rows = _real(np.concatenate([numerators, denominator], axis=1))
        condensed.append(np.linalg.qr(rows, mode="r")[numerators.shape[1] :, numerators.shape[1] :])
        power += float(np.sum(np.abs(block.weight * block.target) ** 2))
    # on average over the points, sigma is 1: this keeps it from vanishing
    mean = np.sqrt(power) * common_basis.real.mean(axis=0)
    rows = np.concatenate([*condensed, mean[None]])
    target = np.r_[np.zeros(len(rows) - 1), np.sqrt(power)]
    scale = np.linalg.norm(rows, axis=0)
    scale[scale == 0.0] = 1.0
    sigma = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
    # the zeros of sigma are those of its numerator, which needs a leading coefficient
    if abs(sigma[n]) < 1e-8 * max(np.abs(sigma).max(), np.finfo(float).tiny):
        return poles
    first = np.flatnonzero(poles.imag > 0.0)
    a, b = np.diag(poles.real), np.ones(n)
    a[first, first + 1], a[first + 1, first] = poles.imag[first], -poles.imag[first]
    b[first], b[first + 1] = 2.0, 0.0
    return _ordered(np.linalg.eigvals(a - np.outer(b, sigma[:n]) / sigma[n]))


def _ordered(poles):
    upper = poles[poles.imag > 0.0]
    real = poles[poles.imag == 0.0]
    return np.r_[np.stack([upper, upper.conj()], axis=1).ravel(), real]
