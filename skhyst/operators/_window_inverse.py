r"""The inverse of a mass with hysteresis: the drive from a window of the future response.

The drive is a straight line between samples. The zeros of a mass sampled in this way are those of
``z^2 + 4 z + 1``, -0.27 and -3.73 (Åström, Hagander and Sternby, *Automatica*, 1984): a drive found
sample by sample would grow by the factor 3.73 per sample. The same holds with hysteresis in the
equation of motion, but then the states cannot be split by eigenvalues. So at each sample the drives
of a window are solved for together, such that the response is met at all of its samples but the
first; the equation of that one is replaced by a straight drive at the end of the window. The first
drive is kept, and the window moves on by one sample. The error due to the end of the window decays
towards its beginning by the same factor 3.73 per sample (Devasia, Chen and Paden, *IEEE
Transactions on Automatic Control*, 1996; for windows Zou and Devasia, *Journal of Dynamic Systems,
Measurement, and Control*, 1999). The previous window has met the response at the first sample.

Newton's method solves for the drives, starting from those of the previous window. Derivatives are
finite differences. A response does not depend on later drives, so the matrix is lower triangular
with one diagonal above, which is eliminated from the end to the beginning: the direction in which
errors decay.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from .._jit import bind, jit
from ._compiled_step import CompiledLaw
from ._protocol import as_signal
from ._root_inverse import InverseOperator, RootInverseOperator

_ENOUGH = 1e-11  # error, relative to the largest response so far
_DIFFERENCE = 1e-7  # step of a difference, relative to the drive for the largest response
_TRIALS, _HALVES = 12, 10  # iterations of Newton's method; halvings of a step
_LONGEST = 64  # samples of a window: a zero at 4/3 reduces the error of its end to 1e-8


def step(u, c, s):
    """Placeholder of the inverted operator's step, which ``bind`` puts in its place."""
    raise NotImplementedError


def window_errors(c, u, r, e, x, z, first):
    """Write the errors of the response ``r`` (p,) to ``e`` (p,); return the largest.

    The drives ``u`` (p,) are applied from the sample ``first`` on. ``x`` are the states (n,) before
    and after each sample, of which those up to ``first`` are given; ``z`` is workspace for one.
    ``e[i]`` is the error at sample ``i + 1``, the last one that of a straight drive at the end.
    """
    p, n = u.size, z.size
    worst = 0.0
    for j in range(n):
        z[j] = x[first * n + j]
    for i in range(first, p):
        y = step(u[i], c, z)
        for j in range(n):
            x[(i + 1) * n + j] = z[j]
        if i > 0:
            e[i - 1] = r[i] - y
            size = abs(e[i - 1])
            worst = max(worst, size if size < math.inf else math.inf)  # NaN counts as infinite
    e[p - 1] = 2.0 * u[p - 2] - u[p - 1] - u[p - 3]
    return worst


@jit
def copy_values(values, to):
    """Copy values to the beginning of an array."""
    for i in range(values.size):
        to[i] = values[i]
    return 0.0


@jit
def solve(m, e, d):
    """Solve ``m d = e`` for ``m`` (p * p,), with one diagonal above the main one; both change."""
    p = d.size
    for k in range(p - 1, 0, -1):
        above, row = (k - 1) * p, k * p
        if abs(m[above + k]) > abs(m[row + k]):
            for j in range(k + 1):
                kept = m[above + j]
                m[above + j] = m[row + j]
                m[row + j] = kept
            kept = e[k - 1]
            e[k - 1] = e[k]
            e[k] = kept
        share = m[above + k] / m[row + k]
        for j in range(k):
            m[above + j] -= share * m[row + j]
        e[k - 1] -= share * e[k]
    for i in range(p):
        value = e[i]
        for j in range(i):
            value -= m[i * p + j] * d[j]
        d[i] = value / m[i * p + i]
    return 0.0


def window_step(y, c, s):
    """Return the drive at the beginning of the window whose last response is ``y``.

    ``c`` is (weights of the equation at the end of the drives, drive for a response of 1 at rest,
    *constants of the step). ``s`` is the largest response so far, drives, responses, errors and
    states of the window, and workspace.
    """
    # the state is one array: these are views of its parts
    p = c[0].size
    n = (s.size - 1 - 6 * p - p * p) // (2 * p + 3)
    u, r, e = s[1 : 1 + p], s[1 + p : 1 + 2 * p], s[1 + 2 * p : 1 + 3 * p]
    trial, trial_errors, d = (
        s[1 + 3 * p : 1 + 4 * p],
        s[1 + 4 * p : 1 + 5 * p],
        s[1 + 5 * p : 1 + 6 * p],
    )
    at = 1 + 6 * p
    x, trial_states = s[at : at + (p + 1) * n], s[at + (p + 1) * n : at + 2 * (p + 1) * n]
    z, m = s[at + 2 * (p + 1) * n : at + (2 * p + 3) * n], s[at + (2 * p + 3) * n :]
    # move the window on by one sample, its new drive a straight continuation
    for i in range(p - 1):
        u[i] = u[i + 1]
        r[i] = r[i + 1]
    u[p - 1] = 2.0 * u[p - 2] - u[p - 3]
    r[p - 1] = y
    for j in range(n):
        x[j] = x[n + j]
    s[0] = max(s[0], abs(y))
    h = _DIFFERENCE * c[1] * s[0]
    worst = step(c[2:], u, r, e, x, z, 0)
    for _newton in range(_TRIALS):
        if worst <= _ENOUGH * s[0] or h == 0.0:
            break
        # Jacobian by differences, one drive at a time: only samples from it on change
        for i in range(p * p):
            m[i] = 0.0
        for j in range(p):
            m[p * p - p + j] = c[0][j]
        for j in range(p):
            for i in range(n):
                trial_states[j * n + i] = x[j * n + i]
            before = u[j]
            u[j] = before + h
            step(c[2:], u, r, trial_errors, trial_states, z, j)
            u[j] = before
            for i in range(max(j - 1, 0), p - 1):
                m[i * p + j] = (e[i] - trial_errors[i]) / h
        copy_values(e, trial_errors)
        solve(m, trial_errors, d)
        fraction, trial_worst = 1.0, worst
        for _half in range(_HALVES):
            for i in range(p):
                trial[i] = u[i] + fraction * d[i]
            copy_values(x[:n], trial_states)
            trial_worst = step(c[2:], trial, r, trial_errors, trial_states, z, 0)
            if trial_worst < worst:
                break
            fraction = 0.5 * fraction
        if not trial_worst < worst:
            break
        worst = trial_worst
        copy_values(trial, u)
        copy_values(trial_errors, e)
        copy_values(trial_states, x)
    return u[0]


@dataclass(frozen=True)
class WindowInverseOperator(InverseOperator):
    """The inverse of a mass with a hysteretic force; it needs a preview.

    Parameters
    ----------
    operator : Operator
        With ``linear_mode()``, ``fastest_rate()`` and a single compiled step.

    Notes
    -----
    The response is met to about 1e-9 of its magnitude where presliding motion is resolved by the
    sampling: ``dt fastest_rate() < 3``. Above that, zeros approach the unit circle, and the error
    due to the end of a window hardly decays. The response should rest at the start of a record for
    some samples. A sample takes a fraction of a millisecond.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import FrictionStageOperator
    >>> stage = FrictionStageOperator(300.0, 0.2, 0.5, 0.8, 30.0, 20.0)
    >>> time = 1e-3 * np.arange(300)
    >>> wanted = np.sin(40.0 * time) ** 2 * (time > 0.02)
    >>> drive, _ = stage.inverse().run(wanted, 1e-3)
    >>> bool(np.abs(stage.run(drive, 1e-3)[0] - wanted).max() < 1e-7)
    True
    """

    causal = False

    def init(self, u0, initial_state="rest"):
        """Return None: a record is inverted as a whole."""
        return None

    def run(self, u, dt, state=None):
        """Return the drive that gives a response ``u`` (n_samples,) from rest, and None."""
        y = as_signal(u)
        compiled_step, ahead = self.ahead(dt, y[0])
        y = np.append(y, np.full(ahead, y[-1]))
        s = compiled_step.state.copy()
        p = ahead + 1
        s[2 + p : 1 + 2 * p] = y[:ahead]
        return compiled_step.streaming(s)(y[ahead:]), None

    def ahead(self, dt, u0, tol=1e-9):
        """Return a step with preview: its input is the response some samples later."""
        mode, fastest = self.operator.linear_mode(), self.operator.fastest_rate()
        damping = mode.damping_ratio * mode.natural_frequency / fastest
        stiff = replace(mode, natural_frequency=fastest, damping_ratio=damping)
        rate = min(one.inverse().decay(dt) for one in (mode, stiff))
        p = min(max(math.ceil(-math.log(tol) / rate), 3), _LONGEST) + 1
        drive, _, inner = RootInverseOperator(self.operator).init(u0)
        forward = self.operator.compiled_step(dt, inner)
        n = len(forward.state)
        s = np.zeros(1 + 6 * p + p * p + (2 * p + 3) * n)
        s[0] = abs(u0)
        s[1 : 1 + p], s[1 + p : 1 + 2 * p] = drive, u0
        first = 1 + 6 * p + n
        s[first : first + n] = forward.state
        law = bind(window_step, bind(window_errors, forward.step, allocates=False), allocates=False)
        bend = np.append(np.zeros(p - 3), [1.0, -2.0, 1.0])
        constants = bend, 1.0 / abs(mode.gain), *forward.constants
        kind = type(self.operator).__name__
        name = f"the inverse of {kind}, whose derivatives are differences"
        return CompiledLaw(law, constants, s, double_only=name), p - 1
