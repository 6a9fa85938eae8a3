"""Twenty simulated plants of each structure: `python benchmarks/new_structures.py`.

    python benchmarks/new_structures.py [--only feedback,no_rest] [--plants 20] [--searches]

The plants are drawn, integrated by steps of their own, and read with white noise of 1 % of the
range. Each line is a structure: how many of the intervals of 1.96 standard errors hold the true
value, over all plants and parameters, and the limits of 90 to 99 %; the parameter whose intervals
hold least often; and the seconds of a fit. With --searches, in place of these: how many searches
around a model without the effect name it (bar 90 %), and what else they claim.
"""

import argparse
import time
import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass
from functools import partial

import numpy as np
from numba import njit
from scipy.optimize import root
from scipy.signal import cont2discrete, lfilter
from sklearn.base import clone

from skhyst.compose import Cascade, Feedback, ModalFeedback, Modulated, Sum
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


def _read(u, y, rng):
    """Return a column of drives, and responses with noise."""
    return u[:, None], y + LEVEL * np.ptp(y) * rng.normal(size=len(y))


def curved_spring(rng):
    """Draw a mass on a spring with a square and a cube."""
    w, zeta = rng.uniform(12.0, 35.0), rng.uniform(0.1, 0.5)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    cube = rng.uniform(0.1, 1.0)
    spring = np.polynomial.Polynomial([0.0, 1.0, rng.uniform(-0.5, 0.5) * cube, cube])
    u = multisine(rng, N)
    x = on_a_spring(u, w, zeta, lambda x: ((spring.coef[3] * x + spring.coef[2]) * x + 1.0) * x)

    def true(model):
        # in the coordinate p of the model: x = a p + b, such that its curve has unit slope
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
        return {
            "linear__natural_frequency": w / np.sqrt(a),
            "linear__damping_ratio": zeta * np.sqrt(a),
            "linear__gain": a * gain,
            "linear__intercept": gain * b + intercept,
            "curve__coefficients[0]": square,
            "curve__coefficients[1]": cube,
        }

    model = Feedback(SecondOrderMode(), SmoothCurve(3), dt=DT)
    return *_read(u, gain * x + intercept, rng), model, true


def spring_with_a_stop(rng):
    """Draw a mass on a spring that a second one joins."""
    w, zeta = rng.uniform(12.0, 35.0), rng.uniform(0.1, 0.5)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    stiffness, at = rng.uniform(0.5, 4.0), rng.uniform(0.2, 0.6)
    u = multisine(rng, N)
    x = on_a_spring(u, w, zeta, lambda x: x + stiffness * max(x - at, 0.0))
    model = Feedback(SecondOrderMode(), DeadZones(1, sides="upper"), dt=DT)
    return (
        *_read(u, gain * x + intercept, rng),
        model,
        {
            "linear__natural_frequency": w,
            "linear__damping_ratio": zeta,
            "linear__gain": gain,
            "linear__intercept": intercept,
            "curve__weights[0]": stiffness,
            "curve__thresholds[0]": at,
        },
    )


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


def between(make_curve, rng):
    """Draw a curve between two filters."""
    lags = rng.random(2) < 0.5
    first, second = (_LowPass(rng, bool(with_lag)) for with_lag in lags)
    middle, curve, true = make_curve(rng)
    gain, intercept = rng.uniform(0.5, 3.0), rng.normal()
    u = multisine(rng, N)
    y = gain * between_filters(u, first, curve, second) + intercept
    steps = [("first", TransferFunction(first.order)), ("curve", middle)]
    steps.append(("second", TransferFunction(second.order)))
    known = {f"curve__{key}": value for key, value in true.items()}
    known |= first.true("first") | second.true("second")
    known |= {"second__gain": gain, "second__intercept": intercept}
    return *_read(u, y, rng), Cascade(steps, dt=DT), known


def _all_poles(model):
    """Return one linear model of the poles of both filters."""
    steps = dict(model.steps)
    return TransferFunction(steps["first"].n_poles + steps["second"].n_poles, dt=DT)


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
    """Draw a mass without a spring with friction and an offset."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "friction": float(rng.uniform(0.3, 1.2)),
        "force_offset": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2)),
    }
    u = 4.0 * multisine(rng, N)
    return *_read(u, slide(u, *true.values(), np.ones(N)), rng), FreeMass(True, dt=DT), true


def mass_along_the_way(rng):
    """Draw a mass whose friction changes along the way."""
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
    model = FreeMass(True, friction_gradient=True, fit_force_offset=False, dt=DT)
    return *_read(u, y, rng), model, partial(_relative_to_its_center, true)


def _relative_to_its_center(true, model):
    """Return the values with friction and its gradient at the center of the model."""
    factor = 1.0 + true["friction_gradient"] * model.operator_.friction_center
    grows = {"friction", "static_level", "bristle_stiffness"} & true.keys()
    gradient = {"friction_gradient": true["friction_gradient"] / factor}
    return true | {name: true[name] * factor for name in grows} | gradient


@njit
def bounce(u, mass, damping, stiffness, stop_damping, lower, upper):
    """Return the displacement of a mass between two stops, implicit in the velocity."""
    h = DT / SLIDING
    x, v, found = 0.0, 0.0, np.zeros(len(u))
    for k in range(1, len(u)):
        for i in range(SLIDING):
            depth = max(x - upper, 0.0) + min(x - lower, 0.0)
            resistance = damping + stop_damping * (depth != 0.0)
            force = u[k - 1] + (u[k] - u[k - 1]) * (i + 0.5) / SLIDING - stiffness * depth
            new = (v + h * force / mass) / (1.0 + h * resistance / mass)
            x, v = x + 0.5 * h * (v + new), new
        found[k] = x
    return found


def mass_between_stops(rng):
    """Draw a mass that bounces between two stops, three tenths of its free way apart each."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "stop_stiffness": float(np.exp(rng.uniform(3.0, 6.0))),
    }
    mass, damping, stiffness = true.values()
    true["stop_damping"] = float(rng.uniform(0.05, 0.3) * 2.0 * np.sqrt(stiffness * mass))
    u = 4.0 * multisine(rng, N)
    free = bounce(u, mass, damping, 0.0, 0.0, 0.0, 0.0)
    true |= {"lower": 0.3 * float(free.min()), "upper": 0.3 * float(free.max())}
    stops = {"lower_stop": True, "upper_stop": True, "fit_stop_damping": True}
    model = FreeMass(**stops, fit_force_offset=False, dt=DT)
    return *_read(u, bounce(u, *true.values()), rng), model, true


def mode_and_integrator(rng):
    """Draw a mode before an integrator."""
    w, zeta = float(np.exp(rng.uniform(2.5, 4.0))), float(rng.uniform(0.05, 0.4))
    gain, u = float(rng.uniform(0.5, 3.0)), multisine(rng, N)
    poles = [1.0, 2.0 * zeta * w, w**2, 0.0]
    b, a, _ = cont2discrete(([gain * w**2], poles), DT, method="foh")
    y = lfilter(np.ravel(b), a, u)
    model = TransferFunction(2, integrators=1, dt=DT)
    true = {"natural_frequencies[0]": w, "damping_ratios[0]": zeta, "gain": gain}
    return *_read(u, y, rng), model, true


def in_a_loop(rng):
    """Draw an unstable plant that a feedback keeps in bounds."""
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
    return u[:, None], y, TransferFunction(2, stable=False, hold="zoh", dt=DT), true


def _wave(rng, periods):
    """Return a function of the fraction of the record: sines of periods in it, and their slope."""
    phases, sizes = rng.uniform(0.0, 2.0 * np.pi, len(periods)), rng.uniform(0.5, 1.0, len(periods))
    rates = 2.0 * np.pi * np.array(periods)

    def value(t, order=0):
        angle = np.multiply.outer(t, rates) + phases + 0.5 * np.pi * order
        return (np.sin(angle) * sizes * rates**order).sum(axis=-1)

    return value


def loaded_joint(rng):
    """Draw the friction force of a joint, which grows with a load.

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


def loaded_mass(rng):
    """Draw a mass whose friction grows with a load."""
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


def loaded_stage(rng):
    """Draw a mass on a spring whose friction grows with a load."""
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
    """Draw a mass on a spring whose friction changes along the way."""
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
    true |= {"friction_gradient": gradient, "gain": gain, "intercept": offset}
    return *_read(u, gain * x + offset, rng), stage, partial(_relative_to_its_center, true)


def by_state(rng, with_lag=False):
    """Draw plays whose thresholds a temperature sets, in front of a lag or not."""
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


def coil(rng):
    """Draw a gain that the current of a coil sets, of which the voltage is recorded."""
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


def of_velocity(rng):
    """Draw a viscous force and LuGre friction, whose drive is the velocity."""
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


def modes_with_loops(rng):
    """Draw a mode and a lag of two inputs and responses, with two saturating loops."""
    size, angle = rng.uniform(0.75, 0.95), rng.uniform(0.2, 1.2)
    a, turn = np.zeros((3, 3)), size * np.exp(1j * angle)
    a[:2, :2], a[2, 2] = [[turn.real, turn.imag], [-turn.imag, turn.real]], rng.uniform(0.3, 0.9)
    b, c, d = 0.5 * rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), 0.1 * rng.normal(size=(2, 2))
    f, g, bias = rng.normal(size=(2, 3)), 0.3 * rng.normal(size=(2, 2)), rng.uniform(-0.7, 0.7, 2)
    e, offset = 0.1 * rng.normal(size=(3, 2)), rng.normal(size=2)
    u, x, y = rng.normal(size=(N, 2)), np.zeros(3), np.empty((N, 2))
    u = 0.5 * (u + np.roll(u, 1, axis=0))
    u[0] = 0.0
    for k in range(N):
        y[k] = c @ x + d @ u[k] + offset
        x = a @ x + b @ u[k] + e @ (np.tanh(f @ x + g @ u[k] + bias) - np.tanh(bias))
    y += LEVEL * np.ptp(y, axis=0) * rng.normal(size=y.shape)
    true = {f"d[{i},{j}]": d[i, j] for i in range(2) for j in range(2)}
    true |= {f"intercept[{i}]": offset[i] for i in range(2)}
    return u, y, ModalFeedback(3, n_loops=2, dt=DT), true


@dataclass(frozen=True)
class Structure:
    """How plants are drawn, and what a search is given and should name.

    ``draw`` is a function of a random generator, to X, y, the model that is fitted, and its true
    parameters, or a function of the fitted model to these. ``declared`` is the model without the
    effect, or a function of the model with it; any of ``effects`` names the effect. ``others`` are
    names of what else the plants have and the declared model has not.
    """

    draw: object
    declared: object = None
    effects: tuple = ()
    others: tuple = ()


STRUCTURES = {
    "feedback": {
        "curved spring": Structure(
            curved_spring,
            SecondOrderMode(dt=DT),
            ("cubic_stiffness", "static_nonlinearity"),
        ),
        "spring with a stop": Structure(
            spring_with_a_stop, SecondOrderMode(dt=DT), ("end_stops", "cubic_stiffness")
        ),
    },
    "wiener_hammerstein": {
        "dead zone between filters": Structure(
            partial(between, _dead_zone), _all_poles, ("dead_zone",)
        ),
        "clipping between filters": Structure(
            partial(between, _clipping), _all_poles, ("static_nonlinearity",)
        ),
    },
    "no_rest": {
        "mass without a spring, friction": Structure(
            sliding_mass, FreeMass(fit_force_offset=False, dt=DT), ("friction",), ("offset",)
        ),
        "mass, friction along the way": Structure(
            mass_along_the_way, FreeMass(fit_force_offset=False, dt=DT), ("friction",)
        ),
        "stage, friction along the way": Structure(
            stage_along_the_way, SecondOrderMode(dt=DT), ("friction",)
        ),
        "mass between stops": Structure(
            mass_between_stops, FreeMass(fit_force_offset=False, dt=DT), ("end_stops",)
        ),
        "mode and integrator": Structure(mode_and_integrator),
        "unstable, in a loop": Structure(in_a_loop),
    },
    "columns": {
        "friction of a load": Structure(loaded_joint, CoulombFriction(dt=DT), ("friction",)),
        "friction of a load, in motion": Structure(
            loaded_mass, FreeMass(fit_force_offset=False, dt=DT), ("friction",)
        ),
        "friction of a load, on a spring": Structure(
            loaded_stage, SecondOrderMode(dt=DT), ("friction",)
        ),
        "width of a temperature": Structure(
            by_state, PrandtlIshlinskii(8, dt=DT), ("auxiliary_input",)
        ),
        "width before a lag": Structure(partial(by_state, with_lag=True)),
        "gain of a coil": Structure(coil, Gain(dt=DT), ("auxiliary_input",)),
    },
    "several_responses": {"modes with loops": Structure(modes_with_loops)},
    "velocity": {
        # called hysteresis while it builds up, and friction for its fall with the speed
        "friction of a velocity": Structure(
            of_velocity,
            DynamicStiffness(drive="velocity", fit_mass=False, dt=DT),
            ("friction", "hysteresis"),
        ),
    },
}


def fitted(structure, seeds):
    """Return how often intervals hold the truth, and the parameter where they do least often."""
    held = defaultdict(list)
    for seed in seeds:
        X, y, model, true = structure.draw(np.random.default_rng(seed))
        model.fit(X, y)
        for key, value in (true(model) if callable(true) else true).items():
            held[key].append(abs(model.params_[key] - value) <= 1.96 * model.params_std_[key])
    share = np.mean([np.mean(own) for own in held.values()])
    worst = min(held, key=lambda key: np.mean(held[key]))
    return f"{share:.3f}", f"{worst} {np.mean(held[worst]):.2f}"


def searched(structure, seeds):
    """Return how often a search names the effect, and what else it claims."""
    named, others = 0, Counter()
    for seed in seeds:
        X, y, model, _ = structure.draw(np.random.default_rng(seed))
        declared = structure.declared
        declared = declared(model) if callable(declared) else clone(declared)
        found = set(EffectSearchCV(declared, random_state=0).fit(X, y).effects_)
        named += not found.isdisjoint(structure.effects)
        others.update(found.difference(structure.effects, structure.others))
    told = ", ".join(f"{name} {count}" for name, count in others.most_common())
    return f"{named / len(seeds):.3f}", told


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default=",".join(STRUCTURES))
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--searches", action="store_true")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.plants)
    if options.searches:
        print(f"structure | named, bar {BAR[0]:.2f} | other claims | seconds of a search")
    else:
        print(f"structure | held, bar {BAR[0]:.2f} to {BAR[1]:.2f} | held least often | seconds")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        for group in options.only.split(","):
            for name, structure in STRUCTURES[group].items():
                if options.searches and structure.declared is None:
                    continue
                start = time.process_time()
                row = (searched if options.searches else fitted)(structure, seeds)
                seconds = (time.process_time() - start) / len(seeds)
                print(" | ".join((name, *row, f"{seconds:.1f}")), flush=True)


if __name__ == "__main__":
    main()
