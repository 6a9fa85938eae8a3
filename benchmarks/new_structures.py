"""Twenty simulated plants of each structure: `python benchmarks/new_structures.py`.

    python benchmarks/new_structures.py [--only feedback,no_rest] [--plants 20]

The plants are drawn, integrated by Runge-Kutta steps of their own, and read with white noise of
1 % of the range. Each line is a structure: how many of the intervals of 1.96 standard errors hold
the true value, over all plants and parameters, and the limits of 90 to 99 %; the parameter whose
intervals hold least often; and the seconds of a fit.
"""

import argparse
import time
import warnings
from collections import defaultdict
from functools import partial

import numpy as np
from numba import njit
from scipy.optimize import root
from scipy.signal import cont2discrete, lfilter
from sklearn.base import clone

from skhyst.compose import Cascade, Feedback, Modulated, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import (
    CoulombFriction,
    FreeMass,
    FrictionStage,
    LuGre,
    PrandtlIshlinskii,
)
from skhyst.linear import (
    DynamicStiffness,
    FirstOrderLag,
    Gain,
    SecondOrderMode,
    TransferFunction,
)
from skhyst.static import DeadBand, DeadZones, Saturation, SmoothCurve

BAR = 0.90, 0.99
LEVEL = 0.01  # of the range
DT = 0.01  # s
N = 1500
FINE = 16  # steps of an integrator per sampling interval
SLIDING = 100  # the same under Coulomb friction


def multisine(rng, n):
    """Return twelve sines of one to seventy periods in the record, from a rest at zero."""
    periods = rng.permutation(np.arange(1, 71))[:12]
    phases = rng.uniform(0.0, 2.0 * np.pi, (12, 1))
    waves = np.sin(2.0 * np.pi * np.outer(periods, np.arange(n) / n) + phases)
    return 0.4 * waves.sum(axis=0) * np.minimum(np.arange(n) / 50.0, 1.0)


def on_a_spring(u, w, zeta, spring):
    """Return the displacement of a mass on a spring, ``x'' / w^2 + 2 zeta x' / w + s(x) = u``."""

    def slope(x, v, drive):
        return v, w * w * (drive - spring(x)) - 2.0 * zeta * w * v

    h, x, v, found = DT / FINE, 0.0, 0.0, np.empty(len(u))
    for k in range(len(u)):
        found[k] = x
        change = (u[min(k + 1, len(u) - 1)] - u[k]) / FINE
        for i in range(FINE):
            drive = u[k] + i * change
            a = slope(x, v, drive)
            b = slope(x + 0.5 * h * a[0], v + 0.5 * h * a[1], drive + 0.5 * change)
            c = slope(x + 0.5 * h * b[0], v + 0.5 * h * b[1], drive + 0.5 * change)
            d = slope(x + h * c[0], v + h * c[1], drive + change)
            x += h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
            v += h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
    return found


def _fit(model, u, displacement, gain, intercept, rng):
    y = gain * displacement + intercept
    return model.fit(u[:, None], y + LEVEL * np.ptp(y) * rng.normal(size=len(y)))


def curved_spring(rng):
    """Return a fit of a mass on a spring with a square and a cube, and the true values."""
    w, zeta = rng.uniform(12.0, 35.0), rng.uniform(0.1, 0.5)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    cube = rng.uniform(0.1, 1.0)
    spring = np.polynomial.Polynomial([0.0, 1.0, rng.uniform(-0.5, 0.5) * cube, cube])
    u = multisine(rng, N)
    x = on_a_spring(u, w, zeta, lambda x: ((spring.coef[3] * x + spring.coef[2]) * x + 1.0) * x)
    model = _fit(Feedback(SecondOrderMode(), SmoothCurve(3), dt=DT), u, x, gain, intercept, rng)
    # the same in the coordinate p of the model: x = a p + b, such that its curve has unit slope
    linear, curve = model.operator_.linear, model.operator_.curve
    around = np.polynomial.Polynomial([curve.center, curve.scale])

    def legendre(values):
        a, b = values
        return spring(a * around + b).convert(kind=np.polynomial.Legendre).coef

    a, b = root(
        lambda values: legendre(values)[:2] - around.coef,
        (linear.gain / gain, (linear.intercept - intercept) / gain),
    ).x
    square, cube = legendre((a, b))[2:] / curve.scale
    return model, {
        "linear__natural_frequency": w / np.sqrt(a),
        "linear__damping_ratio": zeta * np.sqrt(a),
        "linear__gain": a * gain,
        "linear__intercept": gain * b + intercept,
        "curve__coefficients[0]": square,
        "curve__coefficients[1]": cube,
    }


def spring_with_a_stop(rng):
    """Return a fit of a mass on a spring that a second one joins, and the true values."""
    w, zeta = rng.uniform(12.0, 35.0), rng.uniform(0.1, 0.5)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    stiffness, at = rng.uniform(0.5, 4.0), rng.uniform(0.2, 0.6)
    u = multisine(rng, N)
    x = on_a_spring(u, w, zeta, lambda x: x + stiffness * max(x - at, 0.0))
    model = Feedback(SecondOrderMode(), DeadZones(1, sides="upper"), dt=DT)
    return _fit(model, u, x, gain, intercept, rng), {
        "linear__natural_frequency": w,
        "linear__damping_ratio": zeta,
        "linear__gain": gain,
        "linear__intercept": intercept,
        "curve__weights[0]": stiffness,
        "curve__thresholds[0]": at,
    }


def feedback(n_plants):
    """Yield rows of static feedback around a mode: a curved spring, and one with a stop."""
    for name, plant in (("curved spring", curved_spring), ("with a stop", spring_with_a_stop)):
        yield _row(f"feedback, {name}", plant, n_plants)


class _LowPass:
    """A low-pass of unit gain: a pair of poles, behind a lag or not."""

    def __init__(self, rng, with_lag):
        self.tau = rng.uniform(0.03, 0.2) if with_lag else None
        self.w, self.zeta = rng.uniform(12.0, 40.0), rng.uniform(0.2, 0.6)
        self.order = 2 + with_lag

    def slopes(self, state, u):
        x, v, *lag = state
        drive = lag[0] if lag else u
        rates = [v, self.w**2 * (drive - x) - 2.0 * self.zeta * self.w * v]
        return rates + [(u - own) / self.tau for own in lag]

    def true(self, name):
        lag = {} if self.tau is None else {f"{name}__time_constants[0]": self.tau}
        pair = {"natural_frequencies": self.w, "damping_ratios": self.zeta}
        return lag | {f"{name}__{key}[0]": value for key, value in pair.items()}


def between_filters(u, first, curve, second):
    """Return what passes a filter, a curve of its output and another filter, from rest at zero."""

    def slope(state, drive):
        n = first.order
        return np.array(first.slopes(state[:n], drive) + second.slopes(state[n:], curve(state[0])))

    h, state, found = DT / FINE, np.zeros(first.order + second.order), np.empty(len(u))
    for k in range(len(u)):
        found[k] = state[first.order]
        change = (u[min(k + 1, len(u) - 1)] - u[k]) / FINE
        for i in range(FINE):
            drive = u[k] + i * change
            a = slope(state, drive)
            b = slope(state + 0.5 * h * a, drive + 0.5 * change)
            c = slope(state + 0.5 * h * b, drive + 0.5 * change)
            d = slope(state + h * c, drive + change)
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    return found


def _dead_zone(rng):
    half_width = rng.uniform(0.15, 0.5)
    true = {"half_width": half_width, "center": 0.0}
    return DeadBand(), lambda v: v - min(max(v, -half_width), half_width), true


def _clipping(rng):
    low, high = rng.uniform(-0.9, -0.4), rng.uniform(0.4, 0.9)
    return Saturation(), lambda v: min(max(v, low), high), {"lower": low, "upper": high}


def _drawn(rng, make_curve):
    """Return drive and response of a curve between filters, its model, filters, and true values."""
    lags = rng.random(2) < 0.5
    first, second = (_LowPass(rng, bool(with_lag)) for with_lag in lags)
    model, curve, true = make_curve(rng)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    u = multisine(rng, N)
    y = gain * between_filters(u, first, curve, second) + intercept
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    known = {f"curve__{key}": value for key, value in true.items()}
    known |= first.true("first") | second.true("second")
    known |= {"second__gain": gain, "second__intercept": intercept}
    return u[:, None], y, model, (first, second), known


def curve_between_filters(make_curve):
    """Return what fits a curve between two filters that are drawn."""

    def plant(rng):
        X, y, model, filters, true = _drawn(rng, make_curve)
        first, second = (TransferFunction(own.order) for own in filters)
        steps = [("first", first), ("curve", model), ("second", second)]
        return Cascade(steps, dt=DT).fit(X, y), true

    return plant


def wiener_hammerstein(n_plants):
    """Yield rows of a dead zone and of clipping between two filters, and what searches name."""
    for name, make_curve in (("dead_zone", _dead_zone), ("static_nonlinearity", _clipping)):
        yield _row(f"between filters, {name}", curve_between_filters(make_curve), n_plants)


def wiener_hammerstein_searched(n_plants):
    """Yield rows of how often a search around one transfer function names what is in between."""
    for name, make_curve in (("dead_zone", _dead_zone), ("static_nonlinearity", _clipping)):
        named, claimed, start = 0, 0, time.perf_counter()
        for seed in range(n_plants):
            X, y, _, filters, _ = _drawn(np.random.default_rng(seed), make_curve)
            linear = TransferFunction(sum(own.order for own in filters), dt=DT)
            found = EffectSearchCV(linear, random_state=0).fit(X, y).effects_
            named, claimed = named + (name in found), claimed + len(found)
        seconds = (time.perf_counter() - start) / n_plants
        told = f"{claimed - named} others"
        yield f"searched, {name}", f"{named / n_plants:.3f} named", told, f"{seconds:.1f}"


@njit
def slide(u, mass, damping, friction, offset, load, gradient=0.0):
    """Return the displacement of a mass under Coulomb friction, implicit in the velocity.

    The friction is multiplied by the load, and by one and a gradient times the displacement.
    """
    h = DT / SLIDING
    x, v, found = 0.0, 0.0, np.zeros(len(u))
    for k in range(1, len(u)):
        for i in range(SLIDING):
            force = u[k - 1] + (u[k] - u[k - 1]) * (i + 0.5) / SLIDING + offset
            level = friction * (load[k - 1] + (load[k] - load[k - 1]) * (i + 0.5) / SLIDING)
            level *= max(1.0 + gradient * x, 0.0)
            free = v + h * (force - damping * v) / mass
            new = np.sign(free) * max(abs(free) - h * level / mass, 0.0)
            x, v = x + 0.5 * h * (v + new), new
        found[k] = x
    return found


def sliding_mass(rng):
    """Return a fit of a mass without a spring with friction and an offset, and the true values."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "friction": float(rng.uniform(0.3, 1.2)),
        "force_offset": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2)),
    }
    u = 4.0 * multisine(rng, N)
    y = slide(u, *true.values(), np.ones(N))
    return _fit(FreeMass(True, dt=DT), u, y, 1.0, 0.0, rng), true


def along_the_way(rng):
    """Return a fit of a mass whose friction changes along the way, and the true values."""
    X, y, true = _tight_at_one_end(rng)
    model = FreeMass(True, friction_gradient=True, fit_force_offset=False, dt=DT).fit(X, y)
    level = 1.0 + true["friction_gradient"] * model.operator_.friction_center
    true["friction"] *= level
    true["friction_gradient"] /= level
    return model, true


def _tight_at_one_end(rng):
    """Return drive and response of a mass whose friction changes along the way, and its values."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "friction": float(rng.uniform(0.4, 1.0)),
    }
    u = 4.0 * multisine(rng, N)
    reach = np.abs(slide(u, *true.values(), 0.0, np.ones(N))).max()
    true["friction_gradient"] = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8) / reach)
    *own, gradient = true.values()
    y = slide(u, *own, 0.0, np.ones(N), gradient)
    return u[:, None], y + LEVEL * np.ptp(y) * rng.normal(size=N), true


def mode_and_integrator(rng):
    """Return a fit of a mode before an integrator, and the true values."""
    w, zeta = float(np.exp(rng.uniform(2.5, 4.0))), float(rng.uniform(0.05, 0.4))
    gain, u = float(rng.uniform(0.5, 3.0)), multisine(rng, N)
    poles = [1.0, 2.0 * zeta * w, w**2, 0.0]
    b, a, _ = cont2discrete(([gain * w**2], poles), DT, method="foh")
    y = lfilter(np.ravel(b), a, u)
    model = _fit(TransferFunction(2, integrators=1, dt=DT), u, y, 1.0, 0.0, rng)
    return model, {"natural_frequencies[0]": w, "damping_ratios[0]": zeta, "gain": gain}


def in_a_loop(rng):
    """Return a fit of an unstable plant that a feedback keeps in bounds, and the true values."""
    fast, slow = float(rng.uniform(5.0, 20.0)), float(rng.uniform(2.0, 8.0))
    true = {"time_constants[0]": -1.0 / slow, "time_constants[1]": 1.0 / fast}
    true["gain"] = float(rng.uniform(0.5, 2.0))
    den = np.polymul([-1.0 / slow, 1.0], [1.0 / fast, 1.0])
    b, a, _ = cont2discrete(([true["gain"]], den), DT, method="zoh")
    b, wanted = np.ravel(b), np.repeat(rng.normal(size=N // 10), 10)
    u, y, clean = np.zeros(N), np.zeros(N), np.zeros(N)
    for k in range(N):
        clean[k] = sum(b[i] * u[k - i] - a[i] * clean[k - i] for i in (1, 2) if k >= i)
        y[k] = clean[k] + LEVEL * rng.normal()
        change = y[k] - (y[k - 1] if k else y[k])
        u[k] = wanted[k] + (2.5 * y[k] + 0.15 * change / DT) / true["gain"]
    model = TransferFunction(2, stable=False, hold="zoh", dt=DT)
    return model.fit(u[:, None], y), true


def no_rest(n_plants):
    """Yield rows of plants without a rest: a mass without a spring, an integrator, unstable."""
    yield _row("mass without a spring, friction", sliding_mass, n_plants)
    yield _row("mass, friction along the way", along_the_way, n_plants)
    yield _row("stage, friction along the way", stage_along_the_way, n_plants)
    yield _row("mode and integrator", mode_and_integrator, n_plants)
    yield _row("unstable, in a loop", in_a_loop, n_plants)


def _wave(rng, periods):
    """Return a function of the fraction of the record: sines of periods in it, and their slope."""
    phases, sizes = rng.uniform(0.0, 2.0 * np.pi, len(periods)), rng.uniform(0.5, 1.0, len(periods))
    rates = 2.0 * np.pi * np.array(periods)

    def value(t, order=0):
        angle = np.multiply.outer(t, rates) + phases + 0.5 * np.pi * order
        return (np.sin(angle) * sizes * rates**order).sum(axis=-1)

    return value


def _joint(rng):
    """Return motion and load, the friction force of a joint, its parameters, and its model.

    As an integrating converter does, the sensor reads means over the sampling interval.
    """
    true = {
        "transition_velocity": rng.uniform(0.15, 0.4),
        "coulomb_force": rng.uniform(0.5, 2.0),
        "sensitivity": rng.uniform(0.2, 1.0),
        "damping": rng.uniform(0.05, 0.3),
        "intercept": rng.normal(),
    }
    v_0, level, growth, damping, offset = true.values()
    motion, load = _wave(rng, [3, 5, 8]), _wave(rng, [2, 7])
    t = np.arange(-FINE + 1, N * FINE - FINE + 1) / (N * FINE)
    speed = motion(t, 1) / (N * DT)
    y = level * (1.0 + growth * np.abs(load(t))) * np.tanh(speed / v_0) + damping * speed + offset
    y, t = y.reshape(N, FINE).mean(axis=1), np.arange(N) / N
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    model = Modulated(
        CoulombFriction(), 1, scales=["coulomb_force"], magnitude=True, reference=0.0, dt=DT
    )
    return np.column_stack([motion(t), load(t)]), y, model, true


def _carriage(rng):
    """Return force and load, the displacement of a mass whose friction grows with the load, ..."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "friction": float(rng.uniform(0.3, 0.8)),
        "sensitivity": float(rng.uniform(0.2, 1.0)),
    }
    mass, damping, level, growth = true.values()
    u, load = 4.0 * multisine(rng, N), 1.0 + _wave(rng, [2, 7])(np.arange(N) / N)
    y = slide(u, mass, damping, level, 0.0, 1.0 + growth * np.abs(load))
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    mass = FreeMass(True, fit_force_offset=False)
    own = {"scales": ["friction"], "magnitude": True, "reference": 0.0}
    return np.column_stack([u, load]), y, Modulated(mass, 1, **own, dt=DT), true


@njit
def slide_on_a_spring(u, load, w, zeta, level, stiffness, gradient=0.0):
    """Return the displacement of a mass on a spring under LuGre friction times a factor.

    ``x'' / w^2 + 2 zeta x' / w + x + load (1 + gradient x) f = u`` and
    ``f' = stiffness x' (1 - sgn(x') f / level)`` by Runge-Kutta steps, from rest at zero.
    """
    h = DT / SLIDING
    x, v, f, found = 0.0, 0.0, 0.0, np.zeros(len(u))
    a, total = np.zeros(3), np.zeros(3)
    for k in range(1, len(u)):
        for i in range(SLIDING):
            total[:], a[:] = 0.0, 0.0
            for part, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                at = (i + part) / SLIDING
                drive = u[k - 1] + (u[k] - u[k - 1]) * at
                factor = load[k - 1] + (load[k] - load[k - 1]) * at
                x1, v1, f1 = x + part * h * a[0], v + part * h * a[1], f + part * h * a[2]
                force = drive - x1 - factor * max(1.0 + gradient * x1, 0.0) * f1
                a[0], a[1] = v1, w * w * force - 2.0 * zeta * w * v1
                a[2] = stiffness * (v1 - abs(v1) * f1 / level)
                total += weight * a
            x, v, f = x + h / 6.0 * total[0], v + h / 6.0 * total[1], f + h / 6.0 * total[2]
        found[k] = x
    return found


def _loaded_stage(rng):
    """Return force and load, the displacement of a stage whose friction grows with the load, ..."""
    true = {
        "natural_frequency": float(rng.uniform(12.0, 35.0)),
        "damping_ratio": float(rng.uniform(0.1, 0.5)),
        "static_level": float(rng.uniform(0.1, 0.3)),
        "bristle_stiffness": float(rng.uniform(5.0, 20.0)),
        "sensitivity": float(rng.uniform(0.2, 1.0)),
        "gain": float(rng.uniform(0.5, 3.0)),
        "intercept": float(rng.normal()),
    }
    w, zeta, level, stiffness, growth, gain, offset = true.values()
    u, load = multisine(rng, N), 1.0 + _wave(rng, [2, 7])(np.arange(N) / N)
    x = slide_on_a_spring(u, 1.0 + growth * np.abs(load), w, zeta, level, stiffness)
    y = gain * x + offset
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    stage = FrictionStage(False, fit_bristle_damping=False)
    own = {"scales": ["friction"], "magnitude": True, "reference": 0.0}
    return np.column_stack([u, load]), y, Modulated(stage, 1, **own, dt=DT), true


def stage_along_the_way(rng):
    """Return a fit of a stage whose friction changes along the way, and the true values."""
    true = {
        "natural_frequency": float(rng.uniform(12.0, 35.0)),
        "damping_ratio": float(rng.uniform(0.1, 0.5)),
        "static_level": float(rng.uniform(0.1, 0.3)),
        "bristle_stiffness": float(rng.uniform(5.0, 20.0)),
    }
    u, gain, offset = multisine(rng, N), float(rng.uniform(0.5, 3.0)), float(rng.normal())
    gradient = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.5))
    x = slide_on_a_spring(u, np.ones(N), *true.values(), gradient)
    stage = FrictionStage(False, fit_bristle_damping=False, friction_gradient=True, dt=DT)
    model = _fit(stage, u, x, gain, offset, rng)
    factor = 1.0 + gradient * model.operator_.friction_center
    true["static_level"] *= factor
    true["bristle_stiffness"] *= factor
    return model, true | {"friction_gradient": gradient / factor, "gain": gain, "intercept": offset}


def _by_state(rng, with_lag=False):
    """Return a drive and a temperature, what plays whose thresholds it sets respond, and so on."""
    motion, slow = _wave(rng, [11, 19, 31]), _wave(rng, [1, 3])
    t = np.arange(N * FINE) / (N * FINE)
    drive, warm = motion(t), 20.0 + 3.0 * slow(t)
    thresholds, weights = np.array([0.0, 0.2, 0.5, 1.0]), rng.uniform(0.3, 1.0, 4)
    growth, curvature = rng.uniform(0.03, 0.08), rng.uniform(-0.003, 0.003)
    plays, response, tau = np.zeros(4), np.empty(len(t)), rng.uniform(0.03, 0.1)
    for k, (u, x) in enumerate(zip(drive, warm - 20.0, strict=True)):
        slack = thresholds * (1.0 + growth * x + curvature * x * x)
        plays = np.clip(plays, u - slack, u + slack)
        response[k] = weights @ plays
    X, y = np.column_stack([drive, warm])[::FINE], response
    model = Modulated(
        PrandtlIshlinskii(thresholds=thresholds),
        1,
        scales="thresholds",
        degree=2,
        reference=20.0,
        dt=None if with_lag else DT,
    )
    true = {f"weights[{i}]": weight for i, weight in enumerate(weights)}
    true |= {"sensitivity": growth, "curvature[0]": curvature}
    if with_lag:
        y, fade = np.empty(len(t)), np.exp(-DT / FINE / tau)
        y[0] = response[0]
        for k in range(1, len(t)):
            middle = 0.5 * (response[k - 1] + response[k])
            y[k] = middle + (y[k - 1] - middle) * fade
        model = Cascade([("plays", model), ("lag", FirstOrderLag())], dt=DT)
        true = {f"plays__{key}": value for key, value in true.items()}
        true["lag__time_constant"] = tau
    y = y[::FINE] + LEVEL * np.ptp(y) * rng.normal(size=N)
    return X, y, model, true


def _coil(rng):
    """Return a drive and the voltage of a coil whose current sets the gain, and so on."""
    drive = _wave(rng, [11, 19, 31])(np.arange(N) / N)
    voltage = np.interp(np.arange(N), np.arange(0, N + 50, 50), rng.uniform(1, 3, N // 50 + 1))
    true = {
        "gain": rng.uniform(0.5, 2.0),
        "intercept": rng.normal(),
        "sensitivity": rng.uniform(0.15, 0.4),
        "lag_time_constant": rng.uniform(0.2, 1.0),
    }
    gain, offset, growth, tau = true.values()
    current, now = np.empty(N), voltage[0]
    for k in range(N):
        current[k] = now
        for i in range(FINE):  # by the midpoint rule
            at = np.interp(k + np.array([i, i + 0.5]) / FINE, np.arange(N), voltage)
            middle = now + 0.5 * DT / FINE * (at[0] - now) / tau
            now += DT / FINE * (at[1] - middle) / tau
    y = (gain * drive + offset) * (1.0 + growth * (current - 2.0))
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    model = Modulated(Gain(), 1, lag=True, reference=2.0, dt=DT)
    return np.column_stack([drive, voltage]), y, model, true


BY_COLUMNS = {
    "friction of a load": _joint,
    "friction of a load, in motion": _carriage,
    "friction of a load, on a spring": _loaded_stage,
    "width of a temperature": _by_state,
    "width before a lag": partial(_by_state, with_lag=True),
    "gain of a coil": _coil,
}


def velocity(n_plants):
    """Yield a row of friction with presliding whose drive is the velocity."""

    def plant(rng):
        X, y, model, true = _of_velocity(rng)
        return model.fit(X, y), true

    yield _row("friction of a velocity", plant, n_plants)


def velocity_searched(n_plants):
    """Yield a row of how often a search around a viscous force names what is added to it.

    Which may be called hysteresis while it builds up, and friction for its fall with the speed.
    """
    viscous = DynamicStiffness(drive="velocity", fit_mass=False, dt=DT)
    named, others, start = 0, 0, time.perf_counter()
    for seed in range(n_plants):
        X, y, *_ = _of_velocity(np.random.default_rng(seed))
        found = EffectSearchCV(clone(viscous), random_state=0).fit(X, y).effects_
        other = {*found} - {"friction", "hysteresis"}
        named, others = named + (len(other) < len(found)), others + len(other)
    seconds = (time.perf_counter() - start) / n_plants
    told = f"{others} others"
    yield (
        "searched, friction of a velocity",
        f"{named / n_plants:.3f} named",
        told,
        f"{seconds:.1f}",
    )


def columns(n_plants):
    """Yield rows of parameters that a further column sets."""
    for name, drawn in BY_COLUMNS.items():

        def plant(rng, drawn=drawn):
            X, y, model, true = drawn(rng)
            return model.fit(X, y), true

        yield _row(name, plant, n_plants)


def columns_searched(n_plants):
    """Yield rows of how often a search around the model without the column names the effect."""
    declared = {
        "friction of a load": (CoulombFriction(dt=DT), "friction"),
        "friction of a load, in motion": (FreeMass(fit_force_offset=False, dt=DT), "friction"),
        "friction of a load, on a spring": (SecondOrderMode(dt=DT), "friction"),
        "width of a temperature": (PrandtlIshlinskii(8, dt=DT), "auxiliary_input"),
        "gain of a coil": (Gain(dt=DT), "auxiliary_input"),
    }
    for name, (model, effect) in declared.items():
        named, claimed, start = 0, 0, time.perf_counter()
        for seed in range(n_plants):
            X, y, *_ = BY_COLUMNS[name](np.random.default_rng(seed))
            found = EffectSearchCV(clone(model), random_state=0).fit(X, y).effects_
            named, claimed = named + (effect in found), claimed + len(found)
        seconds = (time.perf_counter() - start) / n_plants
        told = f"{claimed - named} others"
        yield f"searched, {name}", f"{named / n_plants:.3f} named", told, f"{seconds:.1f}"


@njit
def presliding(v, length, stribeck, ratio):
    """Return the LuGre force of a velocity, from zero, relative to that of slow sliding.

    ``v`` are the velocities at FINE times the sampling rate, which are constant in between.
    """
    h, z, found = DT / FINE, 0.0, np.zeros(len(v))
    for k in range(len(v)):
        found[k] = z
        level = ratio + (1.0 - ratio) * np.exp(-((v[k] / stribeck) ** 2))
        end = np.sign(v[k]) * level
        z = end + (z - end) * np.exp(-abs(v[k]) * h / (length * level))
    return found


def _of_velocity(rng):
    """Return a velocity, a viscous force and LuGre friction, their parameters, and the model."""
    true = {
        "friction__friction__presliding_displacement": rng.uniform(0.03, 0.1),
        "friction__friction__stribeck_velocity": rng.uniform(0.3, 0.8),
        "friction__friction__coulomb_ratio": rng.uniform(0.4, 0.8),
        "friction__friction__static_force": rng.uniform(1.0, 3.0),
        "viscous__damping": rng.uniform(0.1, 0.5),
        "viscous__intercept": rng.normal(),
    }
    length, stribeck, ratio, level, damping, offset = true.values()
    wave, t = _wave(rng, [3, 8, 17]), np.arange(N * FINE) / (N * FINE)
    middle = 0.7 * wave(t + 0.5 / (N * FINE))
    force = level * presliding(middle, length, stribeck, ratio)[::FINE]
    v = 0.7 * wave(t[::FINE])
    y = force + damping * v + offset
    y += LEVEL * np.ptp(y) * rng.normal(size=N)
    friction = LuGre(fit_bristle_damping=False, fit_damping=False, fit_intercept=False)
    steps = [("displacement", TransferFunction(0, integrators=1)), ("friction", friction)]
    viscous = DynamicStiffness(drive="velocity", fit_mass=False)
    model = Sum([("viscous", viscous), ("friction", Cascade(steps))], dt=DT)
    return v[:, None], y, model, true


def _row(name, plant, n_plants):
    held, start = defaultdict(list), time.perf_counter()
    for seed in range(n_plants):
        model, true = plant(np.random.default_rng(seed))
        for key, value in true.items():
            held[key].append(abs(model.params_[key] - value) <= 1.96 * model.params_std_[key])
    share = np.mean([np.mean(own) for own in held.values()])
    worst = min(held, key=lambda key: np.mean(held[key]))
    seconds = (time.perf_counter() - start) / n_plants
    return name, f"{share:.3f}", f"{worst} {np.mean(held[worst]):.2f}", f"{seconds:.1f}"


STRUCTURES = {
    "feedback": feedback,
    "wiener_hammerstein": wiener_hammerstein,
    "wiener_hammerstein_searched": wiener_hammerstein_searched,
    "no_rest": no_rest,
    "columns": columns,
    "columns_searched": columns_searched,
    "velocity": velocity,
    "velocity_searched": velocity_searched,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default=",".join(STRUCTURES))
    parser.add_argument("--plants", type=int, default=20)
    options = parser.parse_args()
    print(f"structure | held, bar {BAR[0]:.2f} to {BAR[1]:.2f} | held least often | seconds")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for name in options.only.split(","):
            for row in STRUCTURES[name](options.plants):
                print(" | ".join(row), flush=True)


if __name__ == "__main__":
    main()
