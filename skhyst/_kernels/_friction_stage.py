r"""Loops over a mass, spring and damper with LuGre friction.

In units of the drive the friction is ``F = f + (2 zeta_b / w) z'`` with ``f = rho z`` and

    z' = v (1 - sgn(v) f / g(v)),   g(v) = Fs (c + (1 - c) exp(-(v / vs)^2)).

Along the way D of a substep h (see ``_oscillator``) f decays towards ``sgn(D) g``: with the
exponent ``a = rho |D| / g``, ``E = exp(-a)``, ``phi = (1 - E) / a`` and ``psi = (1 - phi) / a``

    f1 = E f0 + rho phi D,   mean f = phi f0 + rho psi D,   mean z' = (f1 - f0) / (rho h),

which is linear in D while a is held. Twice in a row D is solved for: with the exponent of the speed
at the start of the substep, then with the exponent of the D found. That makes the second order;
any exponent keeps the energy balance, because f1 and the mean belong together.
"""

import math

import numpy as np

from .._jit import jit
from ._oscillator import FREE, apply_step, carry, oscillator, oscillator_tangents

__all__ = ["decay", "friction_run", "friction_tangents"]

_TINY = 1e-100  # level: without friction g = 0
_LARGEST = 1e100  # exponent
_SERIES = 0.1  # below, the quotients lose digits and the series is short
_C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = (1.0 / math.factorial(k) for k in range(3, 11))
_FS, _RATIO, _VS, _RHO, _BRISTLE = 2, 3, 4, 5, 6  # place among the parameters
_N_COLUMNS = FREE + 7


@jit
def decay(a):
    """Return ``1 - exp(-a)``, phi, psi and ``chi = (1/2 - psi) / a`` for ``a >= 0``."""
    if a < _SERIES:
        # sum of (-a)^k / (k + 3)!
        chi = _C3 - a * (_C4 - a * (_C5 - a * (_C6 - a * (_C7 - a * (_C8 - a * (_C9 - a * _C10))))))
        psi = 0.5 - a * chi
        phi = 1.0 - a * psi
        return a * phi, phi, psi, chi
    gone = 1.0 - math.exp(-a)
    phi = gone / a
    psi = (1.0 - phi) / a
    return gone, phi, psi, (0.5 - psi) / a


@jit
def exponent(guess, h, law):
    """Return the exponent a for the way ``guess``, the level g and the bell of the Stribeck law."""
    fs, ratio, vs, rho = law
    x = guess / (h * vs)
    bell = math.exp(-min(x * x, 700.0))
    level = max(fs * (ratio + (1.0 - ratio) * bell), _TINY)
    return min(rho * abs(guess) / level, _LARGEST), level, bell


@jit
def way(guess, reach, b, f, h, eta, law):
    """Return D where the exponent is that of ``guess``; the mean force F and f behind it.

    ``reach`` is the way without friction, b the factor of F in it, ``eta = 2 zeta_b / (w h)``,
    ``law`` the tuple (Fs, c, vs, rho).
    """
    rho = law[3]
    a, _, _ = exponent(guess, h, law)
    gone, phi, psi, _ = decay(a)
    by_f = phi - eta * gone / rho
    by_delta = rho * psi + eta * phi
    delta = (reach - b * by_f * f) / (1.0 + b * by_delta)
    return delta, by_f * f + by_delta * delta, f - gone * f + rho * phi * delta


@jit
def friction_run(mode, w, law, bristle, h, n_substeps, u, before, q, p, f, out):
    """Write q to ``out`` (n,) and return the last q, p and f."""
    eta = 2.0 * bristle / (w * h)
    for k in range(u.size):
        u0 = before
        for i in range(n_substeps):
            u1 = before + (u[k] - before) * ((i + 1) / n_substeps)
            reach, speed = oscillator(mode, q, p, u0, u1)
            delta, _, _ = way(h * w * p, reach, mode[2], f, h, eta, law)
            delta, force, f = way(delta, reach, mode[2], f, h, eta, law)
            q += delta
            p = speed - mode[3] * force
            u0 = u1
        before = u[k]
        out[k] = q
    return q, p, f


@jit
def way_tangents(guess, dguess, reach, dreach, mode, mode_by, f, step, h, w, eta, law, ddelta):
    """Return D and the derivatives of F and f; write the tangents of D to ``ddelta`` (n_columns,).

    ``dguess`` holds the tangents of the guess and then those of the exponent. The derivatives are
    those of F by f, D, a, rho and eta, and those of the new f by f, D, a and rho.
    """
    fs, ratio, vs, rho = law
    b = mode[2]
    a, level, bell = exponent(guess, h, law)
    gone, phi, psi, chi = decay(a)
    left = 1.0 - gone
    force_f = phi - eta * gone / rho
    force_delta = rho * psi + eta * phi
    one = 1.0 / (1.0 + b * force_delta)
    delta = (reach - b * force_f * f) * one
    force = force_f * f + force_delta * delta
    force_a = (psi - phi - eta * left / rho) * f
    force_a += (rho * (2.0 * chi - psi) + eta * (psi - phi)) * delta
    force_rho = psi * delta + eta * gone / (rho * rho) * f
    force_eta = phi * delta - gone * f / rho
    hidden_a = rho * (psi - phi) * delta - left * f
    # the exponent by the guess and by the parameters; at rest the mean of both directions
    sign = 0.0 if guess == 0.0 else (1.0 if guess > 0.0 else -1.0)
    x = guess / (h * vs)
    bump = 2.0 * fs * (1.0 - ratio) * bell * x
    a_level = -a / level
    a_guess = rho * sign / level - a_level * bump / (h * vs)
    for j in range(_N_COLUMNS):
        dguess[j] *= a_guess
    dguess[FREE + _FS] += a_level * (ratio + (1.0 - ratio) * bell)
    dguess[FREE + _RATIO] += a_level * fs * (1.0 - bell)
    dguess[FREE + _VS] += a_level * bump * x / vs
    dguess[FREE + _RHO] += abs(guess) / level
    for j in range(_N_COLUMNS):
        ddelta[j] = one * (dreach[j] - b * (force_f * step[2, j] + force_a * dguess[j]))
    ddelta[FREE] -= one * (mode_by[0, 2] * force - b * force_eta * eta / w)
    ddelta[FREE + 1] -= one * mode_by[1, 2] * force
    ddelta[FREE + _RHO] -= one * b * force_rho
    ddelta[FREE + _BRISTLE] -= one * b * force_eta * 2.0 / (w * h)
    return (
        delta,
        (force_f, force_delta, force_a, force_rho, force_eta),
        (left, rho * phi, hidden_a, phi * delta),
    )


@jit
def friction_tangents(
    mode, mode_by, w, law, bristle, h, n_substeps, u, du, before, dbefore, q, p, f, d, out, dout
):
    """Write q (n,) and its tangents (n, m + 7).

    The columns are those of ``du`` (n, m), then the derivatives by w, zeta, Fs, c, vs, rho and
    zeta_b. ``dbefore`` (m,) and ``d`` (3, m + 7) are the tangents of the drive and of the state
    before the first sample.
    """
    eta = 2.0 * bristle / (w * h)
    eta_bristle = 2.0 / (w * h)
    step = np.empty((3, _N_COLUMNS))
    dreach, dspeed, dguess, ddelta, dforce, dhidden = np.empty((6, _N_COLUMNS))
    for k in range(u.size):
        u0 = before
        step[:] = 0.0
        step[0, 0] = step[1, 1] = step[2, 2] = 1.0
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = before + (u[k] - before) * stop
            reach, speed = oscillator(mode, q, p, u0, u1)
            oscillator_tangents(mode, mode_by, q, p, u0, u1, start, stop, step, dreach, dspeed)
            guess = h * w * p
            for j in range(_N_COLUMNS):
                dguess[j] = h * w * step[1, j]
            dguess[FREE] += h * p
            guess, _, _ = way_tangents(
                guess, dguess, reach, dreach, mode, mode_by, f, step, h, w, eta, law, ddelta
            )
            for j in range(_N_COLUMNS):
                dguess[j] = ddelta[j]
            delta, by, hidden_by = way_tangents(
                guess, dguess, reach, dreach, mode, mode_by, f, step, h, w, eta, law, ddelta
            )
            for j in range(_N_COLUMNS):
                dforce[j] = by[0] * step[2, j] + by[1] * ddelta[j] + by[2] * dguess[j]
                dhidden[j] = hidden_by[0] * step[2, j] + hidden_by[1] * ddelta[j]
                dhidden[j] += hidden_by[2] * dguess[j]
            dforce[FREE] -= by[4] * eta / w
            dforce[FREE + _RHO] += by[3]
            dforce[FREE + _BRISTLE] += by[4] * eta_bristle
            dhidden[FREE + _RHO] += hidden_by[3]
            force = by[0] * f + by[1] * delta
            f = hidden_by[0] * f + hidden_by[1] * delta
            apply_step(dspeed, dforce, ddelta, dhidden, mode[3], force, mode_by, step)
            q += delta
            p = speed - mode[3] * force
            u0 = u1
        carry(step, dbefore if k == 0 else du[k - 1], du[k], d)
        before = u[k]
        out[k] = q
        dout[k] = d[0]
