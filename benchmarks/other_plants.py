"""The effect search on plants of another making than those of the studies.

Run from the root of the project::

    python benchmarks/other_plants.py [--plants 60] [--first-seed 0] [--jobs 1] [--without contest]

Plants are plays at thresholds of their own (two to seven, drawn), stepped here sample by sample,
behind which lie dynamics that are integrated by Runge-Kutta with twenty steps a sample. Half hide
nothing, half one effect. Drives are multisines, chirps, staircases and filtered noise, in one to
four records; the noise is white or of first order; 8 or 20 plays are declared. Twenty new records
of the same kind of drive say what the error on a new record is.

Printed is a line a plant, and: claims where nothing is missing, names where something is, verdicts
of noise with more than 1.3 times the true noise left, floor and ceiling that hold the noise, and
errors that understate the error on new records by more than a fifth. With ``--without`` a stage of
the search is left out: what it is there for.
"""

import argparse

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._contest import Contest
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.records import stack_records

DT, N, SUBSTEPS, NEW = 1e-3, 1200, 20, 20
EFFECTS = ("lag", "resonance", "creep", "output_saturation", "static_nonlinearity")
ALSO = {  # what does the same in short recordings, or is the same law
    "lag": ("creep", "delay", "timing"),
    "resonance": ("lag", "timing"),
    "creep": ("lag", "drift"),
    "output_saturation": ("static_nonlinearity", "asymmetry", "input_saturation"),
    "static_nonlinearity": ("asymmetry", "output_saturation"),
}


LEFT_OUT = {  # what stands in the place of a stage of the search
    "resolution": ("raised", lambda self, base: (base, [])),
    "paths": ("_few", lambda self, found, claims: sorted(found, key=lambda c: c.error)[:1]),
    "pairs": ("_pairs", lambda self, base, singles: []),
    "prune": ("prune", lambda self, base: base),
    "contest": ("named", lambda self, base: (base, {})),
}


def drive(rng, kind, amplitude):
    """Return a drive of this amplitude."""
    t = DT * np.arange(N)
    if kind == "multisine":
        phases, tones = rng.uniform(0.0, 2.0 * np.pi, 12), np.arange(1, 13) * rng.uniform(1.0, 3.0)
        u = np.sin(2.0 * np.pi * np.outer(t, tones) + phases).sum(axis=1)
    elif kind == "chirp":
        u = np.sin(2.0 * np.pi * (1.0 + rng.uniform(10.0, 30.0) * t) * t) * (1.2 - t / t[-1])
    elif kind == "staircase":
        u = np.repeat(rng.uniform(-1.0, 1.0, N // 60), 60)[:N]
        u = np.convolve(u, np.ones(12) / 12.0)[:N]
    else:
        u, rho = rng.standard_normal(N), 0.97
        for k in range(1, N):
            u[k] += rho * u[k - 1]
    return amplitude * u / np.abs(u).max()


def integrated(rhs, size, v):
    """Return the states under straight lines between the samples of v."""
    x, found = np.zeros(size), np.empty((len(v), size))
    h = DT / SUBSTEPS
    found[0] = x
    for k in range(1, len(v)):
        for j in range(SUBSTEPS):
            a, b = ((1.0 - s) * v[k - 1] + s * v[k] for s in (j / SUBSTEPS, (j + 1) / SUBSTEPS))
            mid = 0.5 * (a + b)
            k1 = rhs(x, a)
            k2 = rhs(x + 0.5 * h * k1, mid)
            k3 = rhs(x + 0.5 * h * k2, mid)
            k4 = rhs(x + h * k3, b)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        found[k] = x
    return found


class Plant:
    """One plant, which hides an effect or nothing."""

    def __init__(self, rng, effect):
        count = rng.integers(2, 8)
        self.thresholds = np.sort(rng.uniform(0.02, 0.8, count))
        self.weights = rng.uniform(0.1, 0.6, count)
        self.gain, self.effect = rng.uniform(0.3, 1.0), effect
        self.a, self.b = rng.uniform(0.0, 1.0, 2)

    def respond(self, u):
        """Return the response, from rest at the first sample, which is led to from zero."""
        path = np.concatenate([np.linspace(0.0, u[0], 400), np.full(600, u[0]), u])
        z, v = np.zeros(len(self.weights)), np.empty(len(path))
        for k, value in enumerate(path):
            z = np.clip(z, value - self.thresholds, value + self.thresholds)
            v[k] = self.gain * value + self.weights @ z
        return self._behind(v)[1000:]

    def _behind(self, v):
        a, b = self.a, self.b
        if self.effect == "lag":
            tau = 2e-3 * 10.0**a
            return integrated(lambda x, w: (w - x) / tau, 1, v)[:, 0]
        if self.effect == "resonance":
            w0, zeta = 2.0 * np.pi * (30.0 + 90.0 * a), 0.02 + 0.2 * b
            rhs = lambda x, w: np.array([x[1], w0**2 * (w - x[0]) - 2.0 * zeta * w0 * x[1]])  # noqa: E731
            return integrated(rhs, 2, v)[:, 0]
        if self.effect == "creep":
            tau = 0.03 * 10.0**a
            return v + (0.05 + 0.2 * b) * integrated(lambda x, w: (w - x) / tau, 1, v)[:, 0]
        if self.effect == "output_saturation":
            level = (0.45 + 0.35 * a) * (self.gain + self.weights.sum()) * 0.7
            return np.minimum(v, level)
        if self.effect == "static_nonlinearity":
            size = self.gain + self.weights.sum()
            return v + size * (0.1 + 0.2 * a) * (v / size) ** 2 + size * 0.2 * b * (v / size) ** 3
        return v


def recorded(plant, rng, kind, count, noise, colour):
    """Return X, y of so many records, the first of which goes furthest."""
    amplitudes = [1.0, *rng.uniform(0.6, 1.0, count - 1)]
    drives = [drive(rng, kind, amplitude) for amplitude in amplitudes]
    parts = []
    for u in drives:
        e = rng.standard_normal(N)
        if colour:
            for k in range(1, N):
                e[k] = colour * e[k - 1] + np.sqrt(1.0 - colour**2) * e[k]
        parts.append(plant.respond(u) + noise * e)
    time = pd.Index(DT * np.arange(N), name="time")
    return stack_records([pd.DataFrame({"u": u}, time) for u in drives]), np.concatenate(parts)


def case(seed, hides, without=None):
    """Search one plant; return its row."""
    if without is not None:
        setattr(Contest, *LEFT_OUT[without])
    rng = np.random.default_rng([seed, int(hides)])
    effect = EFFECTS[seed % len(EFFECTS)] if hides else "nothing"
    plant = Plant(rng, effect)
    kind = ("multisine", "chirp", "staircase", "noise")[seed % 4]
    count, colour = 1 + seed % 4, (0.0, 0.0, 0.8)[seed % 3]
    declared = PrandtlIshlinskii((8, 20)[seed // 2 % 2])
    noise = 10.0 ** rng.uniform(-3.0, -2.0) * (plant.gain + plant.weights.sum())
    X, y = recorded(plant, rng, kind, count, noise, colour)
    search = EffectSearchCV(declared, random_state=0).fit(X, y)
    new = search.held_out_error(*recorded(plant, rng, kind, NEW, noise, colour))
    ambiguous = [other for names in search.history_["ambiguous_with"] for other in names]
    return {
        "seed": seed,
        "effect": effect,
        "drive": f"{kind} x {count}",
        "claimed": "+".join(search.effects_),
        "named": effect in (*search.effects_, *ambiguous),
        "wrong": any(n != effect and n not in ALSO.get(effect, ()) for n in search.effects_),
        "verdict": search.verdict_,
        "left": new / noise,
        "before": search.error_before_ / noise,
        "after": search.error_after_ / noise,
        "floor": search.noise_floor_ / noise,
        "ceiling": search.noise_ceiling_ / noise,
        "seconds": sum(search.seconds_.values()),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=60, help="of each half")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--without", choices=LEFT_OUT, help="a stage of the search")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.plants)
    jobs = [
        delayed(case)(seed, hides, options.without) for seed in seeds for hides in (False, True)
    ]
    rows = []
    for row in Parallel(n_jobs=options.jobs, return_as="generator")(jobs):
        rows.append(row)
        said = [f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()]
        print("  ".join(said), flush=True)
    table = pd.DataFrame(rows)
    none, some = table[table["effect"] == "nothing"], table[table["effect"] != "nothing"]
    hold = (table["floor"] <= 1.05) & (table["ceiling"] >= 0.95)
    too_much = (table["verdict"] == "noise") & (table["left"] > 1.3)
    under = table["left"] > 1.2 * table["after"]
    print(f"claims where nothing is missing: {(none['claimed'] != '').sum()} of {len(none)}")
    print(
        f"named, or told as ambiguous: {some['named'].sum()}; wrong: {some['wrong'].sum()}", end=""
    )
    print(f" of {len(some)}")
    print(f"verdict noise with more than 1.3 times the noise: {too_much.sum()} of {len(table)}")
    print(f"floor and ceiling hold the noise: {hold.sum()} of {len(table)}")
    print(f"error understated by more than a fifth: {under.sum()} of {len(table)}")
    print(f"verdict where nothing is missing: {none['verdict'].value_counts().to_dict()}")


if __name__ == "__main__":
    main()
