r"""Modes of several inputs and responses, in the frequency domain.

With the sections of :mod:`skhyst.linear` as diagonal blocks of A,

.. math:: Y_o(k) = \bigl(C_o (s_k I - A)^{-1} B + D_o\bigr) U(k)

has residues of rank one: each mode has one row of participation factors (in B) and one shape (in
C), so that there are as many states as poles. C and D are linear, the poles and B are searched; a
factor that B and C of a section can exchange is fixed by the damping of the solver alone.
"""

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

from ._pole_starts import sections


def _resolvent(s, time_constants, w, zeta):
    """Return the entries of ``(s I - A)^-1``: first order (n, n_first), second (n, n_second)."""
    first = 1.0 / (s[:, None] + 1.0 / time_constants)
    second = 1.0 / (s[:, None] ** 2 + 2.0 * zeta * w * s[:, None] + w**2)
    return first, second


class ModalProblem:
    """Least squares of a modal model, with the interface that the solver needs.

    Parameters
    ----------
    s : ndarray of shape (n_rows,), complex
        rad/s, one per row; rows of different excitations may have the same.
    drives : ndarray of shape (n_rows, n_inputs), complex
    responses : ndarray of shape (n_rows, n_outputs), complex
    weights : ndarray of shape (n_rows, n_outputs)
    parts : tuple of ndarray
        Time constants, natural frequencies, damping ratios at the start.
    b : ndarray of shape (n_states, n_inputs)
        At the start.
    """

    def __init__(self, s, drives, responses, weights, parts, b):
        self.s, self.drives, self.responses, self.weights = s, drives, responses, weights
        self.n_first, self.n_second = len(parts[0]), len(parts[1])
        self.n_states, self.n_inputs = b.shape
        self.n_outputs = responses.shape[1]
        n_linear = self.n_outputs * (self.n_states + self.n_inputs)
        self.x0 = np.concatenate([np.log(np.concatenate(parts)), b.ravel(), np.zeros(n_linear)])
        self.n_poles = self.n_first + 2 * self.n_second
        self.lower, self.upper = np.full(len(self.x0), -np.inf), np.full(len(self.x0), np.inf)
        self.log = np.arange(len(self.x0)) < self.n_poles
        self.linear = np.arange(len(self.x0)) >= len(self.x0) - n_linear
        self.scale = float(np.sum(np.abs(weights * responses) ** 2))

    def split(self, x):
        """Return the parts, B (n_states, n_inputs), C (n_outputs, n_states) and D."""
        n, m, p = self.n_states, self.n_inputs, self.n_outputs
        poles, b, linear = np.split(x, [self.n_poles, self.n_poles + n * m])
        linear = linear.reshape(p, n + m)
        parts = np.split(np.exp(poles), [self.n_first, self.n_first + self.n_second])
        return parts, b.reshape(n, m), linear[:, :n], linear[:, n:]

    @staticmethod
    def matrix(parts):
        """Return A, the sections on its diagonal."""
        tau, w, zeta = parts
        second = [np.array([[0.0, b], [-b, -2.0 * z * b]]) for b, z in zip(w, zeta, strict=True)]
        return block_diag(*(np.array([[-1.0 / value]]) for value in tau), *second)

    def evaluate(self, x, *, select=None):
        """Return the Gram matrix of ``[J, r]``."""
        (tau, w, zeta), b, c, d = self.split(x)
        s, f = self.s[:, None], self.n_first
        first, second = _resolvent(self.s, tau, w, zeta)
        forced = self.drives @ b.T
        up, low = forced[:, f::2], forced[:, f + 1 :: 2]
        state = np.empty_like(forced)
        state[:, :f] = first * forced[:, :f]
        state[:, f::2] = second * ((s + 2.0 * zeta * w) * up + w * low)
        state[:, f + 1 :: 2] = second * (s * low - w * up)
        n, m, k = self.n_states, self.n_inputs, self.n_poles
        gram = np.zeros((len(x) + 1, len(x) + 1))
        for o in range(self.n_outputs):
            adjoint = np.empty_like(forced)
            up, low = c[o, f::2], c[o, f + 1 :: 2]
            adjoint[:, :f] = first * c[o, :f]
            adjoint[:, f::2] = second * ((s + 2.0 * zeta * w) * up - w * low)
            adjoint[:, f + 1 :: 2] = second * (w * up + s * low)
            columns = np.empty((len(s), k + n * m + n + m + 1), dtype=complex)
            # the logarithms' derivatives: A = -1 / tau, and [[0, w], [-w, -2 zeta w]]
            columns[:, :f] = adjoint[:, :f] * state[:, :f] / tau
            adjoint1, adjoint2 = adjoint[:, f::2], adjoint[:, f + 1 :: 2]
            state1, state2 = state[:, f::2], state[:, f + 1 :: 2]
            turned = adjoint2 * (2.0 * zeta * w * state2)
            by_w = adjoint1 * (w * state2) - adjoint2 * (w * state1) - turned
            columns[:, f : f + self.n_second] = by_w
            columns[:, f + self.n_second : k] = -turned
            by_b = adjoint[:, :, None] * self.drives[:, None, :]
            columns[:, k : k + n * m] = by_b.reshape(len(s), n * m)
            columns[:, k + n * m : -1 - m] = state
            columns[:, -1 - m : -1] = self.drives
            columns[:, -1] = state @ c[o] + self.drives @ d[o] - self.responses[:, o]
            columns *= self.weights[:, o, None]
            rows = np.concatenate([columns.real, columns.imag])
            product = rows.T @ rows
            first_linear = k + n * m + o * (n + m)
            unknowns = np.r_[: k + n * m, first_linear : first_linear + n + m, len(x)]
            gram[np.ix_(unknowns, unknowns)] += product
        return gram

    def total(self, blocks, select=None):
        """Return the Gram matrix."""
        return blocks

    def covariance(self, solution):
        """Return the covariance of the unknowns; poles are in it by their logarithms.

        Factors that B and C can exchange are not determined, and are left out: neither poles nor
        responses depend on them.
        """
        hessian = solution.gram[:-1, :-1]
        scale = np.sqrt(np.maximum(np.diag(hessian), np.finfo(float).tiny))
        hessian = hessian / np.outer(scale, scale)
        n_unknowns = np.linalg.matrix_rank(hessian, tol=1e-10, hermitian=True)
        variance = solution.cost / max(2 * self.responses.size - n_unknowns, 1)
        inverse = np.linalg.pinv(hessian, rcond=1e-10, hermitian=True)
        with np.errstate(over="ignore", invalid="ignore"):  # of poles that are not determined
            return variance * inverse / np.outer(scale, scale)


def modal_start(poles, residues, n_poles):
    r"""Reduce a partial-fraction expansion of full rank to modes of rank one.

    The expansion is realised with as many copies of the poles as it has inputs or responses, and
    reduced to ``n_poles`` states by balanced truncation (Moore, *IEEE Transactions on Automatic
    Control*, 1981).

    Parameters
    ----------
    poles : ndarray of shape (n,), complex
        Stable, as :func:`vector_fit` returns them.
    residues : ndarray of shape (n, n_outputs, n_inputs)
        Coefficients in the basis of :func:`rational_residues`.
    n_poles : int
        At most ``n`` times the smaller number of inputs and responses.

    Returns
    -------
    parts : tuple of ndarray
        Time constants, natural frequencies, damping ratios.
    b : ndarray of shape (n_poles, n_inputs)
    """
    if residues.shape[1] < residues.shape[2]:
        a, b, c = _realize(poles, residues.transpose(0, 2, 1))
        a, b, c = a.T, c.T, b.T
    else:
        a, b, c = _realize(poles, residues)
    unit = np.median(np.abs(poles))
    a = a / unit
    # Gramians of controllability and of observability
    gram_c = solve_continuous_lyapunov(a, -b @ b.T)
    gram_o = solve_continuous_lyapunov(a.T, -c.T @ c)
    root_c, root_o = _root(gram_c), _root(gram_o)
    u, size, vh = np.linalg.svd(root_o.T @ root_c)
    kept = size[:n_poles] > 1e-12 * size[0]
    scale = 1.0 / np.sqrt(np.where(kept, size[:n_poles], np.inf))
    left, right = scale[:, None] * (u[:, :n_poles].T @ root_o.T), root_c @ vh[:n_poles].T
    small, b = left @ a @ (right * scale), left @ b
    small[~kept, ~kept] = -1.0  # a state that is not controllable or not observable
    values, vectors = np.linalg.eig(small)
    values = -np.maximum(np.abs(values.real), 1e-6 * np.abs(values)) + 1j * values.imag
    return _sections_of(unit * values, np.linalg.solve(vectors, b.astype(complex)))


def _root(gramian):
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _realize(poles, residues):
    """Return A, B, C with a copy of the poles per input."""
    n, n_outputs, n_inputs = residues.shape
    first = np.flatnonzero(poles.imag > 0.0)
    a, b = np.diag(poles.real), np.ones((n, 1))
    a[first, first + 1], a[first + 1, first] = poles.imag[first], -poles.imag[first]
    b[first], b[first + 1] = 2.0, 0.0
    # the two fractions of a pair are the first state, and the second one with its sign
    eye = np.eye(n_inputs)
    c = residues.transpose(1, 2, 0).reshape(n_outputs, n_inputs * n)
    return np.kron(eye, a), np.kron(eye, b), c


def _sections_of(poles, b):
    """Return the sections of poles and the real rows of B that belong to them."""
    tolerance = 1e-9 * np.abs(poles)
    upper = np.flatnonzero(poles.imag > tolerance)
    real = np.flatnonzero(np.abs(poles.imag) <= tolerance)
    real = real[np.argsort(-poles[real].real)]  # slowest first, as sections() pairs them
    parts = sections(np.concatenate([poles[upper], poles[upper].conj(), poles[real]]))
    rows = []
    if len(real) % 2:
        rows.append(b[real[:1]].real)
        real = real[1:]
    pairs = [(i, None) for i in upper] + list(zip(real[::2], real[1::2], strict=True))
    for (i, j), w, zeta in zip(pairs, parts[1], parts[2], strict=True):
        section = np.array([[0.0, w], [-w, -2.0 * zeta * w]])
        values, vectors = np.linalg.eig(section)
        if j is None:
            vector = vectors[:, np.argmax(values.imag)]
            rows.append(2.0 * np.real(np.outer(vector, b[i])))
        else:
            slow = np.argmax(values.real)
            rows.append(
                np.real(np.outer(vectors[:, slow], b[i]) + np.outer(vectors[:, 1 - slow], b[j]))
            )
    sizes = [np.linalg.norm(row) for row in rows]
    return parts, np.concatenate(
        [row / size if size > 0.0 else row + 1.0 for row, size in zip(rows, sizes, strict=True)]
    )
