"""Twenty simulated plants of each structure: `python benchmarks/new_structures.py`.

    python benchmarks/new_structures.py [--only feedback,no_rest] [--plants 20]

The plants are drawn, integrated by Runge-Kutta steps of their own, and read with white noise of
1 % of the range. Each line is a structure: how many of the intervals of 1.96 standard errors hold
the true value, over all plants and parameters, beside the bar of 90 to 99 %; the parameter whose
intervals hold least often; and the seconds of a fit.
"""

import argparse
import time
import warnings
from collections import defaultdict

import numpy as np
from numba import njit
from scipy.optimize import root
from scipy.signal import cont2discrete, lfilter

from skhyst.compose import Cascade, Feedback
from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import FreeMass
from skhyst.linear import SecondOrderMode, TransferFunction
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
def slide(u, mass, damping, friction, offset):
    """Return the displacement of a mass under Coulomb friction, implicit in the velocity."""
    h = DT / SLIDING
    x, v, found = 0.0, 0.0, np.zeros(len(u))
    for k in range(1, len(u)):
        for i in range(SLIDING):
            force = u[k - 1] + (u[k] - u[k - 1]) * (i + 0.5) / SLIDING + offset
            free = v + h * (force - damping * v) / mass
            new = np.sign(free) * max(abs(free) - h * friction / mass, 0.0)
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
    return _fit(FreeMass(True, dt=DT), u, slide(u, *true.values()), 1.0, 0.0, rng), true


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
    yield _row("mode and integrator", mode_and_integrator, n_plants)
    yield _row("unstable, in a loop", in_a_loop, n_plants)


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
