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
from ._oscillator_loops import FREE, carry, move_linearly, oscillator

__all__ = [
    "decay",
    "friction_run",
    "friction_tangents",
]

_TINY = 1e-100  # level: without friction g = 0
_LARGEST = 1e100  # exponent
_SERIES = 0.1  # below, the quotients lose digits and the series is short
_C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10 = (1.0 / math.factorial(k) for k in range(3, 11))
_FS, _RATIO, _VS, _RHO, _BRISTLE = 2, 3, 4, 5, 6  # place among the parameters


@jit
def decay(a):
    """Return ``1 - exp(-a)``, phi, psi and ``chi = (1/2 - psi) / a``."""
    if abs(a) < _SERIES:
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
def way_derivatives(guess, reach, b, f, h, eta, law):
    """Return D and the derivatives around :func:`way`.

    These are those of F by (f, D, a, rho, eta), of the new f by (f, D, a, rho), and of the exponent
    a by (guess, Fs, c, vs, rho).
    """
    fs, ratio, vs, rho = law
    a, level, bell = exponent(guess, h, law)
    gone, phi, psi, chi = decay(a)
    left = 1.0 - gone
    force_f = phi - eta * gone / rho
    force_delta = rho * psi + eta * phi
    delta = (reach - b * force_f * f) / (1.0 + b * force_delta)
    force_a = (psi - phi - eta * left / rho) * f
    force_a += (rho * (2.0 * chi - psi) + eta * (psi - phi)) * delta
    force_rho = psi * delta + eta * gone / (rho * rho) * f
    force_eta = phi * delta - gone * f / rho
    new_a = rho * (psi - phi) * delta - left * f
    # at rest the mean of both directions
    sign = 0.0 if guess == 0.0 else (1.0 if guess > 0.0 else -1.0)
    x = guess / (h * vs)
    bump = 2.0 * fs * (1.0 - ratio) * bell * x
    a_level = -a / level
    return (
        delta,
        (force_f, force_delta, force_a, force_rho, force_eta),
        (left, rho * phi, new_a, phi * delta),
        (
            rho * sign / level - a_level * bump / (h * vs),
            a_level * (ratio + (1.0 - ratio) * bell),
            a_level * fs * (1.0 - bell),
            a_level * bump * x / vs,
            abs(guess) / level,
        ),
    )


@jit
def parameter_terms(one, b, b_w, b_zeta, f, w, h, eta, delta, force_by, a_by, guess_w, out):
    """Write the derivatives of D by the parameters, at the guess, to ``out`` (7,).

    ``one`` is the derivative of D by the way without friction, ``guess_w`` that of the guess by w.
    """
    force = force_by[0] * f + force_by[1] * delta
    pull = -one * b * force_by[2]
    out[0] = pull * a_by[0] * guess_w - one * (b_w * force - b * force_by[4] * eta / w)
    out[1] = -one * b_zeta * force
    out[_FS] = pull * a_by[1]
    out[_RATIO] = pull * a_by[2]
    out[_VS] = pull * a_by[3]
    out[_RHO] = pull * a_by[4] - one * b * force_by[3]
    out[_BRISTLE] = -one * b * force_by[4] * 2.0 / (w * h)


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
    b, bp = mode[2], mode[3]
    step = np.empty((3, FREE + 7))
    first, second = np.empty((2, 7))
    for k in range(u.size):
        u0 = before
        step[:] = 0.0
        step[0, 0] = step[1, 1] = step[2, 2] = 1.0
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = before + (u[k] - before) * stop
            reach, speed = oscillator(mode, q, p, u0, u1)
            # D by the way without friction, by p and by f, and by the parameters
            delta, force_by, _, a_by = way_derivatives(h * w * p, reach, b, f, h, eta, law)
            one = 1.0 / (1.0 + b * force_by[1])
            pull = -one * b * force_by[2] * a_by[0]
            by_reach, by_p, by_f = one, pull * h * w, -one * b * force_by[0]
            parameter_terms(
                one,
                b,
                mode_by[0, 2],
                mode_by[1, 2],
                f,
                w,
                h,
                eta,
                delta,
                force_by,
                a_by,
                h * p,
                first,
            )
            # the same with this D as the guess, on which only the exponent depends
            delta, force_by, new_by, a_by = way_derivatives(delta, reach, b, f, h, eta, law)
            one = 1.0 / (1.0 + b * force_by[1])
            pull = -one * b * force_by[2] * a_by[0]
            parameter_terms(
                one,
                b,
                mode_by[0, 2],
                mode_by[1, 2],
                f,
                w,
                h,
                eta,
                delta,
                force_by,
                a_by,
                0.0,
                second,
            )
            a_reach, a_p, a_f = a_by[0] * by_reach, a_by[0] * by_p, a_by[0] * by_f
            by_reach, by_p, by_f = one + pull * by_reach, pull * by_p, pull * by_f
            by_f -= one * b * force_by[0]
            force_reach = force_by[1] * by_reach + force_by[2] * a_reach
            force_p = force_by[1] * by_p + force_by[2] * a_p
            force_f = force_by[1] * by_f + force_by[2] * a_f + force_by[0]
            new_reach = new_by[1] * by_reach + new_by[2] * a_reach
            new_p = new_by[1] * by_p + new_by[2] * a_p
            new_f = new_by[1] * by_f + new_by[2] * a_f + new_by[0]
            back = -bp * force_reach
            by_state = (
                (1.0 - by_reach * b, by_reach * mode[0] + by_p, by_f),
                (-back * b - bp, mode[1] + back * mode[0] - bp * force_p, -bp * force_f),
                (-new_reach * b, new_reach * mode[0] + new_p, new_f),
            )
            push = (by_reach, back, new_reach)
            move_linearly(mode, mode_by, q, p, u0, u1, start, stop, by_state, push, step)
            force = force_by[0] * f + force_by[1] * delta
            for j in range(7):
                da = a_by[0] * first[j]
                if _FS <= j <= _RHO:
                    da += a_by[j - 1]
                ddelta = second[j] + pull * first[j]
                step[0, FREE + j] += ddelta
                step[1, FREE + j] -= bp * (force_by[1] * ddelta + force_by[2] * da)
                step[2, FREE + j] += new_by[1] * ddelta + new_by[2] * da
            step[1, FREE] -= mode_by[0, 3] * force - bp * force_by[4] * eta / w
            step[1, FREE + 1] -= mode_by[1, 3] * force
            step[1, FREE + _RHO] -= bp * force_by[3]
            step[1, FREE + _BRISTLE] -= bp * force_by[4] * 2.0 / (w * h)
            step[2, FREE + _RHO] += new_by[3]
            q += delta
            p = speed - bp * force
            f = new_by[0] * f + new_by[1] * delta
            u0 = u1
        carry(step, dbefore if k == 0 else du[k - 1], du[k], d)
        before = u[k]
        out[k] = q
        dout[k] = d[0]
