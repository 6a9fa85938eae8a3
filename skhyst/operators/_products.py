"""Polynomial of several signals at one sample."""

from .._jit import jit


@jit(inline=True)
def sum_of_products(weights, terms, x, at):
    """Return the sum of weighted products of signals.

    Parameters
    ----------
    weights : ndarray of shape (n_terms,)
    terms : ndarray of shape (n_terms, degree)
        The factors of each term, positions among the signals; -1 stands for the factor one.
    x : ndarray
        Has the signals from the place ``at`` on.
    at : int

    Returns
    -------
    float
    """
    total = 0.0
    for t in range(weights.size):
        value = weights[t]
        for j in range(terms.shape[1]):
            if terms[t, j] >= 0:
                value *= x[at + int(terms[t, j])]
        total += value
    return total
