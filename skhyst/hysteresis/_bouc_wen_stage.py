r"""Mass, spring and damper with a Bouc-Wen force in the equation of motion.

In units of the drive, with level L and shape g,

    f' = rho q' - rho |f/L|^n (|q'| sgn f + g q').

Along the displacement D of a substep (see ``_oscillator``) with the sign s, ``w = s f / L`` is a
function of ``t = rho |D| / L``,

    dw/dt = 1 - c w,   c = (1 + g) sigma for w > 0, (1 - g) sigma for w < 0,   sigma = |w|^(n-1),

which is piecewise linear in w, with two pieces, while sigma is held: the final value of w and its
mean over D are known in closed form (:func:`branch`), for any sign of c. D is the root of an
increasing function, found by Newton's method (:func:`displacement`). Sigma is 1 for ``n = 1``.
Otherwise D is solved for twice, with sigma at the start of the substep, then with sigma at the mean
w found; sigma is limited to its value at the limit of w, so that w ends there for substeps of any
length. Final value and mean are those of one solution, which keeps the energy balance.
"""

import math
from dataclasses import dataclass
from itertools import product
from numbers import Real

import numpy as np

from .._jit import jit
from .._sklearn import Interval
from ..operators import parameter
from ._oscillator import (
    OWN,
    PARAMETERS,
    F,
    OscillatorModel,
    OscillatorOperator,
    begin_sample,
    decay,
    loops,
    mean_factor,
    move_tangents,
    oscillator,
    propagate,
    pull_tangents,
    scaled,
    solve_tangents,
)

_TINY = 1e-100  # smallest level: without hysteresis it may be 0
_STEEPEST = 600.0  # largest exponent of a growing force, far beyond the bound that ends a run
_LONGEST = 1e100  # largest displacement in units of the level
_FAR = 1e6  # largest force in units of the level
_SENSITIVE = 1e100  # largest tangent
_ITERATIONS = 60
_CLOSE = 1e-8  # relative Newton step; its square, the next error, is below rounding
# step of the first loading over its shortest decay length; least and most steps
_PART, _FEWEST, _MOST = 0.05, 32, 100_000
# slope of the force over the load at which the first loading has saturated, relative to the
# rounding of the force
_SETTLED = 1e-14
_RHO, _LEVEL, _SHAPE, _EXPONENT = range(OWN + 2, OWN + 6)  # columns of the derivatives


@jit
def piece(t, w, c):
    """Return the final w and its mean over the length t, and the quotients of ``a = c t``.

    The quotients are those of :func:`decay`, followed by ``a``, which is limited.
    """
    a = min(max(c * t, -_STEEPEST), _LONGEST)
    decayed, phi, psi, chi = decay(a)
    return w - decayed * w + t * phi, phi * w + t * psi, decayed, phi, psi, chi, a


@jit
def crossing(w, c):
    """Return the length t in which w rises from ``w < 0`` to 0; infinite if it never does."""
    z = -c * w
    none = int(z == 0.0)  # where the quotient is one
    return -w * (math.log1p(z) + none) / (z + none) if z > -1.0 else math.inf


@jit
def branch(t, w, below, above):
    """Return w after the length t, its mean over t, and the derivative of the mean by t.

    ``below`` and ``above`` are c for w below and above zero.
    """
    c = below if w < 0.0 else above
    if w < 0.0:
        first = crossing(w, below)
        if t > first:
            _, mean, _, _, _, _, _ = piece(first, w, below)
            end, rest, _, _, _, _, _ = piece(t - first, 0.0, above)
            mean = (first * mean + (t - first) * rest) / t
            return end, mean, (end - mean) / t
    end, mean, _, phi, psi, chi, a = piece(t, w, c)
    return end, mean, c * w * (psi - phi) + psi + a * (2.0 * chi - psi)


@jit
def piece_tangents(t, w, c):
    """Return the final w and its mean over the length t, and the derivatives by (t, w, c)."""
    end, mean, decayed, phi, psi, chi, a = piece(t, w, c)
    remaining = 1.0 - decayed
    by_end = remaining * (1.0 - c * w), remaining, t * (t * (psi - phi) - remaining * w)
    bend = 2.0 * chi - psi
    by_mean = c * w * (psi - phi) + psi + a * bend, phi, t * (w * (psi - phi) + t * bend)
    return end, mean, by_end, by_mean


@jit
def branch_tangents(t, w, below, above):
    """Return w after the length t, its mean, and the derivatives by (t, w, below, above)."""
    if w < 0.0:
        first = crossing(w, below)
        if t > first:
            rest = t - first
            # dw/dt is 1 at w = 0, so the length to zero has minus the derivatives of w at ``first``
            _, mean, (_, zero_w, zero_c), (_, mean_w, mean_c) = piece_tangents(first, w, below)
            end, rest_mean, by_end, by_mean = piece_tangents(rest, 0.0, above)
            mean = (first * mean + rest * rest_mean) / t
            return (
                end,
                mean,
                (by_end[0], by_end[0] * zero_w, by_end[0] * zero_c, by_end[2]),
                (
                    (end - mean) / t,
                    (first * mean_w + end * zero_w) / t,
                    (first * mean_c + end * zero_c) / t,
                    rest * by_mean[2] / t,
                ),
            )
        end, mean, by_end, by_mean = piece_tangents(t, w, below)
        return end, mean, (*by_end, 0.0), (*by_mean, 0.0)
    end, mean, by_end, by_mean = piece_tangents(t, w, above)
    return (
        end,
        mean,
        (by_end[0], by_end[1], 0.0, by_end[2]),
        (by_mean[0], by_mean[1], 0.0, by_mean[2]),
    )


@jit
def sharpness(w, shape, exponent):
    """Return sigma and its derivatives by (w, shape, exponent)."""
    if exponent == 1.0:
        return 1.0, 0.0, 0.0, math.log(max(abs(w), _TINY)) if w != 0.0 else 0.0
    n, size = exponent, abs(w)
    if shape > -1.0:
        limit = (1.0 + shape) ** (-1.0 / n)
        if size > limit:
            sigma = limit ** (n - 1.0)
            return (
                sigma,
                0.0,
                -(1.0 - 1.0 / n) * sigma / (1.0 + shape),
                -sigma * math.log(1.0 + shape) / (n * n),
            )
    sigma = size ** (n - 1.0)
    by_w = by_exponent = 0.0
    if size > _TINY:
        by_w, by_exponent = (n - 1.0) * sigma / w, sigma * math.log(size)
    return sigma, by_w, 0.0, by_exponent


@jit
def displacement(free_d, b, w, rate, level, shape, sigma):
    """Return ``x = |D| >= 0`` that solves ``x + b level mean(w) = free_d``, final w and mean w.

    ``rate`` is rho / level.
    """
    below, above = (1.0 - shape) * sigma, (1.0 + shape) * sigma
    pull = b * level
    start = 1.0 - (below if w < 0.0 else above) * w
    x = max(free_d - pull * w, 0.0) / (1.0 + 0.5 * pull * rate * max(start, 0.0))
    end, mean = w, w
    for _ in range(_ITERATIONS):
        t = min(rate * x, _LONGEST)
        end, mean, slope = branch(t, w, below, above)
        step = (free_d - x - pull * mean) / (1.0 + pull * rate * max(slope, 0.0))
        # a backward step must not reach x = 0
        step = max(step, -0.9 * x)
        x += step
        if abs(step) <= _CLOSE * x:
            # the last, small step is linearised
            mean += slope * rate * step
            end += (1.0 - (below if end < 0.0 else above) * end) * rate * step
            break
    return x, end, mean


@jit(inline=True)
def bouc_wen(mode, law, h, q, p, f, u0, u1):
    """Return q, p and f after a substep.

    ``law`` is (rho, level, shape, exponent, bound); beyond the bound the simulation has diverged
    and all following values are NaN.
    """
    rho, level, shape, exponent, bound = law
    size = max(level, _TINY)
    rate = rho / size
    b = mode[2]
    free_d, free_p = oscillator(mode, q, p, u0, u1)
    side = 1.0 if free_d >= b * f else -1.0
    w = side * f / size
    sigma = 1.0
    if exponent != 1.0:
        sigma, _, _, _ = sharpness(w, shape, exponent)
        _, _, mean = displacement(side * free_d, b, w, rate, size, shape, sigma)
        sigma, _, _, _ = sharpness(mean, shape, exponent)
    x, end, mean = displacement(side * free_d, b, w, rate, size, shape, sigma)
    q += side * x
    f = side * size * end
    if not (abs(q) <= bound and abs(f) <= bound):
        return math.nan, math.nan, math.nan
    return q, free_p - mode[3] * side * size * mean, f


bouc_wen_run, *_BOUC_WEN_STEPS = loops(bouc_wen)


@jit
def sharpness_tangents(w, side, shape, exponent, level, by, dsigma):
    """Return sigma and write its derivatives; ``by[1]`` are those of the force ``side w level``."""
    sigma, by_w, by_shape, by_exponent = sharpness(w, shape, exponent)
    weight = side * by_w / level
    for j in range(dsigma.size):
        dsigma[j] = weight * by[1, j]
    dsigma[_LEVEL] -= by_w * w / level
    dsigma[_SHAPE] += by_shape
    dsigma[_EXPONENT] += by_exponent
    return sigma


@jit
def displacement_tangents(x, side, b, w, rho, level, shape, sigma, dsigma, by):
    """Write the derivatives of D, of the mean force and of the new force to ``by``.

    ``x``, ``w`` and ``sigma`` are as in :func:`displacement`, ``side`` is the sign of D.
    """
    t = min(rho / level * x, _LONGEST)
    below, above = (1.0 - shape) * sigma, (1.0 + shape) * sigma
    end, mean, by_end, by_mean = branch_tangents(t, w, below, above)
    force_tangents(side, level * mean, x, t, w, rho, level, shape, sigma, by_mean, dsigma, by[1])
    solve_tangents(b, by_mean[0] * rho, side * level * mean, by)
    force_tangents(side, level * end, x, t, w, rho, level, shape, sigma, by_end, dsigma, by[2])
    for j in range(by.shape[1]):
        by[2, j] += by_end[0] * rho * by[0, j]


@jit
def force_tangents(side, force, x, t, w, rho, level, shape, sigma, by_branch, dsigma, by):
    """Write the derivatives of ``side force``, after a given displacement, to a row ``by``.

    ``by_branch`` are the derivatives of ``force / level``, a result of :func:`branch`.
    """
    by_t, by_w, by_behind, by_ahead = by_branch
    by_sigma = side * level * ((1.0 - shape) * by_behind + (1.0 + shape) * by_ahead)
    for j in range(by.size):
        by[j] = by_sigma * dsigma[j]
    by[F] += by_w
    by[_RHO] += side * by_t * x
    by[_LEVEL] += side * (force / level - by_t * t - by_w * w)
    by[_SHAPE] += side * level * sigma * (by_ahead - by_behind)


@jit
def bouc_wen_tangents(
    mode, mode_by, law, h, n_substeps, u, du, factor, dfactor, before, dbefore, q, p, f, d,
    out, dout,
):  # fmt: skip
    """Write q and its tangents, the parameters being w, zeta, rho, level, shape and exponent."""
    rho, level, shape, exponent, bound = law
    size = max(level, _TINY)
    rate = rho / size
    step = np.empty((3, PARAMETERS + 6))
    by = np.zeros((3, OWN + 6))
    dsigma = np.zeros(OWN + 6)
    for k in range(u.size):
        u0 = before
        first = begin_sample(d, du.shape[1], step)
        for i in range(n_substeps):
            start, stop = i / n_substeps, (i + 1) / n_substeps
            u1 = before + (u[k] - before) * stop
            loaded = scaled(mode, mean_factor(factor[k], factor[k + 1], start, stop), q, p)
            b, bp = loaded[2], loaded[3]
            free_d, free_p = oscillator(loaded, q, p, u0, u1)
            side = 1.0 if free_d >= b * f else -1.0
            w = side * f / size
            sigma = 1.0
            if exponent != 1.0:
                # predictor: sigma at the start, where the force f is the only variable
                for j in range(by.shape[1]):
                    by[1, j] = 1.0 if j == F else 0.0
                sigma = sharpness_tangents(w, side, shape, exponent, size, by, dsigma)
                x, _, mean = displacement(side * free_d, b, w, rate, size, shape, sigma)
                displacement_tangents(x, side, b, w, rho, size, shape, sigma, dsigma, by)
                sigma = sharpness_tangents(mean, side, shape, exponent, size, by, dsigma)
            x, end, mean = displacement(side * free_d, b, w, rate, size, shape, sigma)
            if exponent == 1.0:  # sigma is 1, but its derivative by the exponent is not zero
                dsigma[_EXPONENT] = sharpness(mean, shape, exponent)[3]
            displacement_tangents(x, side, b, w, rho, size, shape, sigma, dsigma, by)
            force = side * size * mean
            pull_tangents(loaded[3], force, by)
            move_tangents(loaded, mode_by, by, q, p, u0, u1, start, stop, step, first)
            q += side * x
            p = free_p - bp * force
            f = side * size * end
            u0 = u1
        if not (abs(q) <= bound and abs(f) <= bound):
            out[k:] = np.nan
            dout[k:] = np.nan
            return
        propagate(step, k, du, dfactor, dbefore, d, dout)
        before = u[k]
        out[k] = q
        largest = 0.0
        for i in range(3):
            for j in range(d.shape[1]):
                largest = max(largest, abs(d[i, j]))
        if not largest <= _SENSITIVE:
            # chaotic motion: the sums of squares of its tangents would overflow
            dout[k + 1 :] = np.nan
            later = u[k + 1 :], factor[k + 1 :], before
            bouc_wen_run(mode, law, h, n_substeps, *later, q, p, f, out[k + 1 :])
            return


@jit
def slope_at(f, rho, level, shape, exponent, by):
    """Return ``df/dq`` of a first loading and write its derivatives to ``by`` (5,).

    These are by f, rho, level, shape and exponent.
    """
    w = f / level
    if w <= 0.0:
        by[:] = 0.0
        by[1] = 1.0
        return rho
    log = math.log(w)
    power = math.exp(min(exponent * log, _STEEPEST))
    by[0] = -rho * (1.0 + shape) * exponent * power / f
    by[1] = 1.0 - (1.0 + shape) * power
    by[2] = -by[0] * w
    by[3] = -rho * power
    by[4] = -rho * (1.0 + shape) * power * log
    return rho * by[1]


@jit
def first_loading(load, rho, level, shape, exponent, by):
    """Return the force f at rest under ``load = q + f`` and write its derivatives to ``by`` (5,).

    These are by the load and by rho, level, shape and exponent. The load is the integration
    variable, since ``df/dload = k / (1 + k)`` with ``k = df/dq`` is bounded.
    """
    by[:] = 0.0
    if not (rho > 0.0 and level > 0.0):
        return 0.0
    if not load > 0.0:
        by[0] = rho / (1.0 + rho)
        return 0.0
    # the rate of decay is highest at the largest f
    largest = load
    if shape > -1.0:
        largest = min(load, level * (1.0 + shape) ** (-1.0 / exponent))
    slopes, rates = np.empty((2, 5))
    k = slope_at(largest, rho, level, shape, exponent, slopes)
    steep = load * abs(slopes[0]) / (1.0 + max(k, 0.0))
    n = int(min(max(steep / _PART, _FEWEST), _MOST))
    h = load / n
    settled = _SETTLED * max(1.0, rho * exponent)
    f = 0.0
    weights = (0.0, 0.5, 0.5, 1.0)
    values, change = np.zeros((2, 5))
    for _ in range(n):
        total, last = 0.0, 0.0
        change[:] = 0.0
        rates[:] = 0.0
        for stage in range(4):
            part = weights[stage] * h
            k = slope_at(f + part * last, rho, level, shape, exponent, slopes)
            last = k / (1.0 + k)
            # derivative of k / (1 + k): through f, and at constant f
            inner = 1.0 / ((1.0 + k) * (1.0 + k))
            weight = (1.0 if stage == 0 or stage == 3 else 2.0) / 6.0
            total += weight * last
            for j in range(1, 5):
                rates[j] = inner * (slopes[j] + slopes[0] * (values[j] + part * rates[j]))
                change[j] += weight * rates[j]
        f += h * total
        for j in range(1, 5):
            values[j] += h * change[j]
        if total < settled:
            break
    k = slope_at(f, rho, level, shape, exponent, slopes)
    by[0] = k / (1.0 + k)
    for j in range(1, 5):
        by[j] = values[j]
    return f


@jit
def follow(q, level, shape, exponent, out):
    """Write the force for a prescribed displacement ``q`` (n,), rho = 1, to ``out`` (n,).

    For a law without a limit it is NaN from where it exceeds 1e6 times the level.
    """
    f, before = 0.0, q[0] if q.size else 0.0
    for k in range(q.size):
        change = q[k] - before
        if change != 0.0:
            side = 1.0 if change > 0.0 else -1.0
            w, t = side * f / level, abs(change) / level
            sigma, _, _, _ = sharpness(w, shape, exponent)
            if exponent != 1.0:
                _, mean, _ = branch(t, w, (1.0 - shape) * sigma, (1.0 + shape) * sigma)
                sigma, _, _, _ = sharpness(mean, shape, exponent)
            w, _, _ = branch(t, w, (1.0 - shape) * sigma, (1.0 + shape) * sigma)
            f = side * level * w
        if not abs(f) <= _FAR * level:
            out[k:] = np.nan
            return
        before = q[k]
        out[k] = f


_LARGEST = 1e12  # bound of displacement and force, relative to drive and level: diverged


@dataclass(frozen=True)
class BoucWenStageOperator(
    OscillatorOperator, loops=(bouc_wen_run, *_BOUC_WEN_STEPS, bouc_wen_tangents)
):
    r"""Mass, spring and damper with a Bouc-Wen force, driven by a force or a voltage.

    The equations of :class:`BoucWenStage` divided by ``b``: displacement ``q`` and forces are in
    units of the drive, and ``u`` moves the stage without hysteretic force by ``q = u`` at rest.

    Parameters
    ----------
    hysteresis_stiffness : float
        :math:`\rho = \alpha / k`: slope of the hysteretic force at ``f = 0``, relative to the
        spring.
    level : float
        :math:`L = (\alpha/\beta)^{1/n} / |b|`, units of the drive: force at which the beta term of
        the law equals its alpha term. For ``g > -1`` the largest force is ``L (1 + g)^(-1/n)``.
    shape : float, default=0.0
        :math:`g = \gamma / \beta`. From -1 to 1 the loading branch approaches a limit and the
        unloading branch is steeper. Below -1 the loading branch becomes steeper too and has no
        limit; above 1 the unloading branch is flatter than a first loading.
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition.

    Notes
    -----
    State and substeps are those of :class:`OscillatorOperator`. For ``n = 1`` the law is passive,
    since :math:`\beta > 0`; for other exponents, with ``|f|^(n-1)`` held over a substep, it is
    passive for ``|g| <= 1``. If the law has no limit (``g < -1``) a large motion can diverge; all
    following values are then NaN.

    References
    ----------
    Classes of the law by the signs of its coefficients: Ikhouane and Rodellar, *Systems with
    Hysteresis*, 2007.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWenStageOperator
    >>> stage = BoucWenStageOperator(50.0, 0.5, 4.0, 0.2)
    >>> drive = np.interp(np.arange(4000) * 1e-2, [0.0, 20.0, 40.0], [0.0, 1.0, 0.0])
    >>> y, _ = stage.run(drive, 1e-2)
    >>> print(f"{y.max():.2f} {y[-1]:.2f}")
    0.80 0.20
    """

    natural_frequency: float = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratio: float = parameter(log=True, lower=0.0)
    hysteresis_stiffness: float = parameter(log=True, lower=0.0)
    level: float = parameter(log=True, lower=0.0, unit="drive")
    # beyond these bounds the beta term is negligible relative to the gamma term
    shape: float = parameter(default=0.0, lower=-20.0, upper=20.0)
    exponent: float = parameter(default=1.0, log=True, lower=1.0, upper=20.0)
    gain: float = parameter(default=1.0, linear=True, unit="response/drive")
    intercept: float = parameter(default=0.0, linear=True, gauge=0.0, unit="response")
    n_substeps: int = 8
    hold: str = "foh"

    def physical(self, mass=1.0):
        """Return the quantities of the equation of motion for a known mass.

        Those of :meth:`OscillatorOperator.physical`, ``alpha`` (force/displacement), ``beta`` and
        ``gamma`` (``force^(1-n)/displacement``; NaN or infinite beyond the range of floating
        point).
        """
        p = super().physical(mass)
        alpha, force = self.hysteresis_stiffness * p["stiffness"], abs(p["drive_gain"]) * self.level
        with np.errstate(all="ignore"):
            beta = np.float64(alpha) * np.float64(force) ** -self.exponent
            gamma = self.shape * beta
        return p | {"alpha": alpha, "beta": float(beta), "gamma": float(gamma)}

    def characteristics(self, seen):
        bounded = self.shape > -1.0
        factor = (1.0 + self.shape) ** (-1.0 / self.exponent) if bounded else 1.0
        return self._force_characteristics(self.level * factor)

    def _parameters_under_feedback(self, s, shift):
        return {"hysteresis_stiffness": self.hysteresis_stiffness / s}

    def _rest(self, u0):
        by_law, sign = np.empty(5), math.copysign(1.0, u0)
        force = first_loading(abs(u0), *self._law(0.0)[:4], by_law)
        by = np.zeros((2, 1 + self.n_parameters - 2))
        by[1, 0] = by_law[0]
        by[1, 3:] = sign * by_law[1:]
        by[0] = -by[1]
        by[0, 0] += 1.0
        return u0 - sign * force, sign * force, by

    def _law(self, largest):
        parameters = self.hysteresis_stiffness, self.level, self.shape, self.exponent
        return tuple(map(float, (*parameters, _LARGEST * (largest + self.level))))


# starting values: presliding displacement as fraction of the response's half range; gamma / beta;
# exponent if it is fitted
_DISPLACEMENTS = (0.05, 0.15, 0.5, 1.5, 5.0)
_SHAPES = (-1.3, -0.4, 0.5)
_EXPONENTS = (1.2, 2.5)


class BoucWenStage(OscillatorModel):
    r"""Mass, spring and damper with a Bouc-Wen force: hysteresis with a smooth transition.

    .. math::

        m \ddot x + d \dot x + k x + z = b u, \qquad y = x + c

        \dot z = \alpha \dot x - \beta |\dot x| |z|^{n-1} z - \gamma \dot x |z|^n

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since the response to a drive does not determine the mass; the hysteretic force is then
    in units of the drive.

    Parameters
    ----------
    exponent : float, default=1.0
        ``n`` from 1 to 20, sharpness of the transition. Not used if ``fit_exponent`` is True.
    fit_exponent : bool, default=False
        Whether ``n`` is fitted.

    Attributes
    ----------
    operator_ : BoucWenStageOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``hysteresis_stiffness`` (relative to the
        spring), ``level`` (units of the drive), ``shape`` (:math:`\gamma / \beta`), ``exponent``,
        ``gain``, ``intercept``.

    See Also
    --------
    BoucWen : The hysteresis alone, without mass.
    RestoringForce : Polynomial spring and damper, and a bilinear hysteretic force.

    Notes
    -----
    Starting values are found as for :class:`FrictionStage`. Records should contain motions both
    small and large relative to the presliding displacement; a nearly linear hysteretic force cannot
    be distinguished from the spring, as standard errors and ``identifiability_`` then report.
    Unlike that of :class:`BoucWen`, the law may lack a limit (:math:`\gamma < -\beta`), since the
    spring limits the motion.

    References
    ----------
    Bouc, *Fourth Conference on Nonlinear Oscillations*, 1967. Wen, *Journal of the Engineering
    Mechanics Division*, 1976. Noël and Schoukens, *Workshop on Nonlinear System Identification
    Benchmarks*, 2016.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import BoucWenStage, BoucWenStageOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = BoucWenStageOperator(20.0, 0.5, 5.0, 0.3, 0.4, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = BoucWenStage(dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.level:.2f} {model.operator_.hysteresis_stiffness:.1f}")
    0.30 5.0
    """

    operator_class = BoucWenStageOperator
    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "exponent": [Interval(Real, 1.0, 20.0, closed="both")],
        "fit_exponent": ["boolean"],
    }

    def __init__(
        self,
        exponent=1.0,
        *,
        fit_exponent=False,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.exponent = exponent
        self.fit_exponent = fit_exponent
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.hold = hold

    def _laws(self, length, speed):
        exponents = _EXPONENTS if self.fit_exponent else (float(self.exponent),)
        return [
            [(part * length, shape, exponent) for part in _DISPLACEMENTS]
            for shape, exponent in product(_SHAPES, exponents)
        ]

    def _forces(self, law, y, dt, length):
        force = np.empty_like(y)
        follow(np.ascontiguousarray(y), *law, force)
        return force[:, None]

    def _own_parameters(self, law, gain, stiffness, level, swing):
        _, shape, exponent = law
        parameters = {"hysteresis_stiffness": stiffness, "level": level}
        return parameters | {"shape": shape, "exponent": exponent}
