"""Simulated plants of structures without a recording: `python benchmarks/new_structures.py`.

Of each structure, --runs plants with parameters at random are integrated without skhyst and fitted
as they are declared. Printed are the share of parameters within two standard errors of the true
value, and, of the first --searches plants, the share in which a search names what was left out.
--only names some of the structures.
"""

import argparse
import warnings

import numpy as np
from numba import njit
from scipy.signal import cont2discrete, lfilter

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import FreeMass
from skhyst.linear import TransferFunction

DT, N = 0.01, 2000
SUBSTEPS = 200
NOISE = 1e-3  # of the range of the response


def drive(rng, n=N):
    """Return a force of a few sinusoids, straight between samples."""
    time = DT * np.arange(n)
    frequencies = np.geomspace(0.1, 2.5, 5) * rng.uniform(0.8, 1.25, 5)
    return np.sin(2.0 * np.pi * np.outer(time, frequencies) + rng.uniform(0.0, 6.28, 5)).sum(axis=1)


def measured(rng, y):
    """Return a response with white noise."""
    return y + NOISE * np.ptp(y) * rng.normal(size=len(y))


@njit
def slide(u, mass, damping, friction, offset):
    """Return the displacement under Coulomb friction, by small steps implicit in the velocity."""
    h = DT / SUBSTEPS
    x, v, out = 0.0, 0.0, np.zeros(len(u))
    for k in range(1, len(u)):
        for i in range(SUBSTEPS):
            force = u[k - 1] + (u[k] - u[k - 1]) * (i + 0.5) / SUBSTEPS + offset
            free = v + h * (force - damping * v) / mass
            loss = h * friction / mass
            new = max(abs(free) - loss, 0.0) * (1.0 if free > 0.0 else -1.0)
            x, v = x + 0.5 * h * (v + new), new
        out[k] = x
    return out


def free_mass(rng):
    """Return force and response of a mass with friction and offset, the truth, and its model."""
    true = {
        "mass": float(np.exp(rng.uniform(-1.5, 0.5))),
        "damping": float(np.exp(rng.uniform(-1.0, 0.5))),
        "friction": float(rng.uniform(0.3, 1.2)),
        "force_offset": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.2)),
    }
    u = 1.5 * drive(rng)
    y = slide(u, *true.values())
    return u, measured(rng, y), true, FreeMass(True, dt=DT)


def integrator(rng):
    """Return a drive and the response of a mode before an integrator, the truth, and its model."""
    w, zeta = float(np.exp(rng.uniform(2.5, 4.0))), float(rng.uniform(0.05, 0.4))
    true = {"natural_frequencies[0]": w, "damping_ratios[0]": zeta, "gain": rng.uniform(0.5, 3.0)}
    u = rng.normal(size=N).cumsum() * np.hanning(N)
    poles = [1.0, 2.0 * zeta * w, w**2, 0.0]
    b, a, _ = cont2discrete(([true["gain"] * w**2], poles), DT, method="foh")
    y = lfilter(np.ravel(b), a, u)
    return u, measured(rng, y), true, TransferFunction(2, integrators=1, dt=DT)


def unstable(rng):
    """Return drive and response of an unstable plant in a loop, the truth, and its model."""
    fast, slow = float(rng.uniform(5.0, 20.0)), float(rng.uniform(2.0, 8.0))
    true = {"time_constants[0]": -1.0 / slow, "time_constants[1]": 1.0 / fast}
    true["gain"] = float(rng.uniform(0.5, 2.0))
    # -gain / (s / slow - 1) / (s / fast + 1), under a feedback of place and change
    num = [true["gain"]]
    den = np.polymul([-1.0 / slow, 1.0], [1.0 / fast, 1.0])
    b, a, _ = cont2discrete((num, den), DT, method="zoh")
    b, wanted = np.ravel(b), np.repeat(rng.normal(size=N // 10), 10)
    u, y, clean = np.zeros(N), np.zeros(N), np.zeros(N)
    for k in range(N):
        past = [(b[i] * u[k - i], -a[i] * clean[k - i]) for i in (1, 2) if k >= i]
        clean[k] = np.sum(past)
        y[k] = clean[k] + 0.01 * rng.normal()
        place, change = y[k], y[k] - (y[k - 1] if k else y[k])
        u[k] = wanted[k] + (2.5 * place + change * (0.15 / DT)) / true["gain"]
    model = TransferFunction(2, stable=False, hold="zoh", dt=DT)
    return u, y, true, model


# what a search is declared, and has to name
LEFT_OUT = {"free_mass": (FreeMass(fit_force_offset=False, dt=DT), {"friction", "offset"})}
STRUCTURES = {"free_mass": free_mass, "integrator": integrator, "unstable": unstable}


def study(name, runs, searches):
    """Return the numbers of parameters within two standard errors, of all, and of names found."""
    within = total = named = 0
    for seed in range(runs):
        u, y, true, model = STRUCTURES[name](np.random.default_rng(seed))
        model.fit(u[:, None], y)
        for key, value in true.items():
            within += abs(model.params_[key] - value) < 2.0 * model.params_std_[key]
            total += 1
        if name in LEFT_OUT and seed < searches:
            declared, effects = LEFT_OUT[name]
            search = EffectSearchCV(declared, cv=3, random_state=0).fit(u[:, None], y)
            named += len(effects & set(search.effects_)) / len(effects)
            print(name, seed, search.effects_, search.verdict_, flush=True)
    return within, total, named


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default=",".join(STRUCTURES))
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--searches", type=int, default=20)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for name in options.only.split(","):
        within, total, named = study(name, options.runs, options.searches)
        print(f"{name}: {within} of {total} parameters within two standard errors", end="")
        searches = min(options.runs, options.searches)
        print(f", {100 * named / searches:.0f} % named" if name in LEFT_OUT and searches else "")


if __name__ == "__main__":
    main()
