r"""Stable inversion of linear dynamics, over complete records or with a preview.

A discrete system ``w[k+1] = A w[k] + B u[k]``, ``y[k] = C w[k] + D u[k]`` is solved for its input:

    u[k] = (y[k] - C w[k]) / D,    w[k+1] = (A - B C / D) w[k] + (B / D) y[k].

Where D is zero the input acts one sample later, and ``y[k+1] = C A w[k] + C B u[k]`` is used
instead; and so on. The eigenvalues of ``A - B C / D`` are the zeros of the system. Those outside
the unit circle, such as the sampling zeros of a mass, would let the input grow without bound. So
the states are split by an ordered Schur form and a Sylvester equation: those of zeros inside run
forwards, those of zeros outside run backwards, from a rest after the record, so that the drive
moves before the response has to (Devasia, Chen and Paden, *IEEE Transactions on Automatic Control*,
1996). The response then follows exactly if it rests for a while at the start of the record: a few
samples for sampling zeros.

If it moves earlier, the drive before the record is missing, and a mode rings. So the first samples
of the drive, as many as the preview and one for each state, are changed by the ``w`` of least ``|e
+ G w|^2 + (s g |w|)^2``: ``e`` is the error over the record, from rest, ``G w`` the response to the
change, ``g`` the static gain. A change without the penalty would grow with the zeros from sample to
sample; the penalty suppresses directions whose gain is less than the fraction ``s`` of the static
gain (regularisation: Tikhonov, *Soviet Mathematics Doklady*, 1963). The columns of ``G`` are one
pulse response, shifted: ``R = G' G`` has ``R[i+1, j+1] = R[i, j] - h[n-1-i] h[n-1-j]``.

The response k samples ahead enters with the k-th power of the inverse zeros. So a preview of
``log(1/tol) / log |zero|`` samples neglects a fraction ``tol``.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur, solve_sylvester

from .._jit import jit
from ._compiled_step import CompiledLaw
from ._protocol import as_signal
from ._root_inverse import InverseOperator
from ._state_space import state_space_run

_NEAR = 1e-9  # distance from the unit circle: closer zeros decay neither forwards nor backwards
_NOTHING = 1e-13  # rounding error, relative to the largest term
_SEEN = 0.1  # least gain of a change of the drive, relative to the static gain
_LONGEST = 256  # samples at the start that are changed, at most


@dataclass(frozen=True)
class InverseLinearOperator(InverseOperator):
    """Inverse of a linear operator, from its response to its drive; it needs a preview.

    Parameters
    ----------
    operator : Operator
        With ``discrete(dt)``: the matrices of :func:`state_space_run`, and ``intercept``.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> mode = SecondOrderModeOperator(300.0, 0.05)
    >>> time = 1e-3 * np.arange(400)
    >>> wanted = np.sin(20.0 * time) ** 2 * (time > 0.02)
    >>> drive, _ = mode.inverse().run(wanted, 1e-3)
    >>> bool(np.abs(mode.run(drive, 1e-3)[0] - wanted).max() < 1e-9)
    True
    """

    signal_linear = True
    causal = False

    def init(self, u0, initial_state="rest"):
        """Return None: a record is inverted as a whole."""
        return None

    def run(self, u, dt, state=None):
        """Return the drive that gives a response ``u`` (n_samples,) from rest to rest."""
        y = as_signal(np.asarray(u, dtype=float) - self.operator.intercept)
        direct, late, forth, back = self._parts(dt)
        held = np.append(y, np.full(late, y[-1]))
        p = _driven(*forth, held, shifted=True)
        drive = (direct * held + p + _driven(*back, held[::-1], shifted=False)[::-1])[late:]
        if len(back[1]) or late:
            rest = direct + _at_rest(*forth) + _at_rest(*back)
            drive[0] = rest * y[0]
            order = len(forth[1]) + len(back[1])
            self._begin(drive, y, dt, rest, self._length(back, 1e-9) + late + order)
        return drive, None

    def _begin(self, drive, y, dt, rest, samples):
        """Correct the first samples of a drive that starts at rest, for the response ``y``."""
        samples = min(samples, len(y) - 1, _LONGEST)
        if samples < 1 or rest == 0.0:
            return
        pulse = np.eye(1, len(y), k=1)[0]
        h, error = (
            self.operator.run(u, dt, self.operator.init(u[0]))[0] - self.operator.intercept
            for u in (pulse, drive)
        )
        h, error = h[1:], y[1:] - error[1:]
        n, r = len(h), np.zeros((samples, samples))
        for j in range(samples):
            r[0, j] = h[j:] @ h[: n - j]
        for i in range(1, samples):
            ends = h[n - samples + 1 : n - i + 1][::-1]
            r[i, i:] = r[i - 1, i - 1 : -1] - h[n - i] * ends
        r = np.triu(r) + np.triu(r, 1).T
        penalty = (_SEEN / rest) ** 2 * np.eye(samples)
        projection = np.array([h[: n - k] @ error[k:] for k in range(samples)])
        drive[1 : samples + 1] += np.linalg.solve(r + penalty, projection)

    def ahead(self, dt, u0, tol=1e-9):
        """Return a step with preview: its input is the response some samples later.

        The part that runs backwards becomes a sum over the previewed response, after which it rests
        (Zou and Devasia, *Journal of Dynamic Systems, Measurement, and Control*, 1999).
        """
        direct, late, (a, b, c), (back, given, read) = self._parts(dt)
        length = self._length((back, given, read), tol)
        weights = np.zeros(length + 1)
        for k in range(length):
            weights[k] = read @ given
            given = back @ given
        weights[-1] = _at_rest(back, given, read)
        weights[0] += direct
        return previewed(weights, (a, b, c), self.operator.intercept, u0), length + late

    def decay(self, dt):
        """Return the rate, per sample, at which the effect of the later response decays.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        float
            Infinite if the drive does not depend on later response.
        """
        *_, back = self._parts(dt)
        return _decay(back)

    def _length(self, back, tol):
        """Return the number of samples of preview that neglects the fraction ``tol``."""
        return math.ceil(-math.log(tol) / _decay(back)) if len(back[1]) else 0

    def _parts(self, dt):
        """Return a factor, samples of preview, and forward and backward parts, each (a, b, c).

        The drive is ``factor y[k] + p[k] + q[k]`` with ``p[k] = c x[k]``, ``x[k+1] = a x[k] +
        b y[k]``, and ``q[k] = c z[k]``, ``z[k] = a z[k+1] + b y[k]``, with the previewed y.
        """
        ad, b0, b1, c, d = self.operator.discrete(dt)
        b, c, d = b0 + ad @ b1, c, d + c @ b1  # of states that need one sample of the input
        late = 0
        while abs(d) <= _NOTHING * max(np.abs(c) @ np.abs(b), abs(d)):
            if late == len(b):
                raise ValueError("A linear operator whose response is constant has no inverse.")
            c, d, late = c @ ad, c @ b, late + 1
        return 1.0 / d, late, *_both_ways(ad - np.outer(b, c) / d, b / d, -c / d)


def previewed(weights, forth, intercept, u0):
    """Return the step of a sum over previewed responses plus a part that runs forwards.

    Parameters
    ----------
    weights : ndarray of shape (n_responses,)
        Of the responses minus the intercept, oldest first.
    forth : tuple of (a, b, c)
        The part driven by the oldest response, with ``x[k+1] = a x[k] + b y[k]``.
    intercept : float
    u0 : float
        Response at which the device has rested.

    Returns
    -------
    CompiledLaw
    """
    a, b, c = forth
    at_rest = np.linalg.solve(np.eye(len(b)) - a, b)
    by_change = np.cumsum(weights[:0:-1])[::-1]
    constants = weights.sum() + c @ at_rest, by_change, a, at_rest, c, intercept
    state = [0.0, *np.full(len(weights), u0 - intercept), *np.zeros(2 * len(b))]
    return CompiledLaw(preview_step, constants, state, possible=_in_ring)


@jit
def preview_step(u, c, s):
    """Return the drive some samples before the response ``u``.

    It is the drive at rest for the oldest response, plus the weighted changes of later responses,
    and of earlier ones through the part that runs forwards. (A drive is a small difference of large
    multiples of the response; the changes of the response are exact.) ``c`` is (inverse of the
    static gain, weights of the changes, oldest first, a, state at rest for a response of one, c of
    the part that runs forwards, intercept). ``s`` is the index of the oldest response, a ring of
    responses, the deviation of that part's state from rest, and workspace.
    """
    rest, by_change, a, at_rest, output, intercept = c
    length, n = by_change.size + 1, at_rest.size
    at = int(s[0])
    before = s[1 + at]
    s[1 + at] = u - intercept
    at = (at + 1) % length
    s[0] = at
    y, first = 0.0, s[1 + at]
    for i in range(n):
        value = at_rest[i] * (before - first)
        for j in range(n):
            value += a[i, j] * s[1 + length + j]
        s[1 + length + n + i] = value
        y += output[i] * value
    for i in range(n):
        s[1 + length + i] = s[1 + length + n + i]
    before = first
    for k in range(length - 1):
        after = s[1 + (at + k + 1) % length]
        y += by_change[k] * (after - before)
        before = after
    return rest * first + y


def _in_ring(s, c):
    """Whether the index in a state of :func:`preview_step` is valid: ``CompiledLaw.possible``."""
    return s[0] in range(len(c[1]) + 1)


def _both_ways(a, b, c):
    """Return the forward and backward parts of the bounded ``c x``, ``x[k+1] = a x[k] + b y``."""
    sizes = np.abs(np.linalg.eigvals(a))
    if np.any(np.abs(sizes - 1.0) < _NEAR):
        raise ValueError(
            "A zero on the unit circle, as of a response that ignores a constant drive or one "
            "frequency, has no stable inverse."
        )
    t, z, n = schur(a, sort="iuc") if len(b) else (a, a, 0)
    # x = z [p + s q, q]: with this s the equation of p is free of q, as that of q is of p
    s = solve_sylvester(t[:n, :n], -t[n:, n:], -t[:n, n:]) if 0 < n < len(b) else t[:n, n:]
    g, h = z.T @ b, c @ z
    back = np.linalg.inv(t[n:, n:])
    forth = t[:n, :n], g[:n] - s @ g[n:], h[:n]
    return forth, (back, -back @ g[n:], h[n:] + h[:n] @ s)


def _decay(part):
    """Return the rate of decay of a part, per sample; infinite if it has no states."""
    a, _, _ = part
    return -math.log(np.abs(np.linalg.eigvals(a)).max()) if len(a) else math.inf


def _at_rest(a, b, c):
    """Return the static gain of a part."""
    return float(c @ np.linalg.solve(np.eye(len(b)) - a, b)) if len(b) else 0.0


def _driven(a, b, c, y, shifted):
    """Return ``c x`` from rest, where ``b`` times the previous or the present ``y`` drives x."""
    rest = np.linalg.solve(np.eye(len(b)) - a, b) * y[0]
    before, now = (b, np.zeros_like(b)) if shifted else (np.zeros_like(b), b)
    system = (np.ascontiguousarray(part) for part in (a, before, now, c))
    return state_space_run(*system, 0.0, as_signal(y), rest, y[0])[0]
