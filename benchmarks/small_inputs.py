"""Small inputs of the effect search whose right answer is known, for `judge.py`.

Each device is a loop of its own, written from its equation, and shares no code with the models. A
seed draws the device and two records: one to search, one held out. Errors count over the standard
deviation of the noise.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pandas as pd

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain, SecondOrderMode

STEP = 1e-3  # s
SUBSTEPS = 40  # of the integration of a mass, a sample


class Small(NamedTuple):
    """A small input.

    Parameters
    ----------
    record : callable
        Of the generators of the device and of the record; returns X, y and the standard deviation
        of the noise.
    search : callable
        Returns the unfitted search.
    truth : str
        Effects that must be named, joined by "+", those that do as well by "|"; "none"; "unknown"
        where what is missing is no effect of the library.
    verdict : str
        Those that are right, by "|"; empty where the truth does not say.
    also : str
        Further effects whose names are right, or known already, by "|".
    """

    record: Callable
    search: Callable
    truth: str
    verdict: str = "noise"
    also: str = ""


def drive(rng, n, fastest=40.0):
    """Return a sum of sines with periods from ``fastest`` samples to a third of n, peak 1."""
    periods = np.exp(rng.uniform(np.log(fastest), np.log(n / 3), 8))
    phases = rng.uniform(0, 2 * np.pi, 8)
    u = np.sin(2 * np.pi * np.arange(n)[:, None] / periods + phases) @ rng.uniform(0.3, 1.0, 8)
    return u / np.abs(u).max()


def plays(u, thresholds, weights):
    """Return the weighted sum of plays, which rest at 0 before."""
    z, y = np.zeros(len(thresholds)), np.empty(len(u))
    for k, v in enumerate(u):
        z = np.minimum(np.maximum(z, v - thresholds), v + thresholds)
        y[k] = weights @ z
    return y


def stop(u, limit):
    """Return the response of an elastic, perfectly plastic element from rest at 0."""
    s, y = 0.0, np.zeros(len(u))
    for k in range(1, len(u)):
        s = min(max(s + u[k] - u[k - 1], -limit), limit)
        y[k] = s
    return y


def lag(u, tau):
    """Return the response of a first-order lag of ``tau`` samples, at rest at the first drive."""
    z, y, keep = u[0], np.empty(len(u)), np.exp(-1.0 / tau)
    for k, v in enumerate(u):
        z = keep * z + (1.0 - keep) * v
        y[k] = z
    return y


def mass(u, frequency, damping, cubic=0.0, dry=0.0):
    """Return the displacement of a mass that is driven through a spring, from rest.

    x'' = w^2 (u - x - cubic x^3 - dry sign(x')) - 2 damping w x'; the drive is a straight line
    between its samples, and dry friction holds the mass where it exceeds all other forces.
    """
    w, h = 2 * np.pi * frequency, STEP / SUBSTEPS
    fine = np.interp(np.arange(len(u) * SUBSTEPS) / SUBSTEPS, np.arange(len(u)), u)
    x, v, path = float(u[0]), 0.0, np.empty(len(fine))
    for _ in range(50):  # Newton's steps to where the springs balance
        x -= (x + cubic * x**3 - u[0]) / (1 + 3 * cubic * x**2)
    for k, f in enumerate(fine):
        path[k] = x
        free = v + h * (w * w * (f - x - cubic * x**3) - 2 * damping * w * v)
        v = np.sign(free) * max(abs(free) - h * dry * w * w, 0.0)
        x += h * v
    return path[::SUBSTEPS]


def _noisy(rng, X, y, share):
    std = share * np.ptp(y)
    return np.reshape(X, (len(y), -1)), y + std * rng.standard_normal(len(y)), std


def log_creep_step(device, rng):
    t = 0.2 * np.arange(1000)
    after = np.clip(t - 20, 0, None)
    u = (t > 20).astype(float)
    y = u + 0.2 * np.log1p(after / 0.5) + 1e-3 * rng.standard_normal(1000)
    return u[:, None], y, 1e-3


def gain_step(device, rng):
    n = 2000
    u = drive(rng, n)
    return _noisy(rng, u, np.where(np.arange(n) < n // 2, 1.0, 1.12) * u, 0.001)


def one_speed_damper(device, rng):
    """A steel damper driven at one speed: stops, |du| = 0.5 throughout."""
    amplitudes = (1, 2, 3, 4, 6, 8, 10, 12)
    peaks = np.cumsum([0] + [p for a in amplitudes for p in (a, -2 * a, 2 * a, -2 * a, a)])
    way = np.r_[0, np.cumsum(np.abs(np.diff(peaks)))]
    u = np.interp(np.arange(0, way[-1], 0.5), way, peaks)
    return u[:, None], 0.3 * u + 8 * stop(u, 1.5) + 0.1 * rng.standard_normal(len(u)), 0.1


def four_plays(device, rng, sign=1.0):
    thresholds, weights = np.sort(device.uniform(0.02, 0.5, 4)), device.uniform(0.2, 0.5, 4)
    u = drive(rng, 1600)
    return _noisy(rng, u, sign * (0.5 * u + plays(u, thresholds, weights)), 5e-4)


def falling_plays(device, rng):
    return four_plays(device, rng, -1.0)


def falling_creep(device, rng):
    thresholds, weights = np.array([0.05, 0.15, 0.3]), np.array([0.3, 0.2, 0.2])
    tau = device.uniform(100, 300)
    u = drive(rng, 3000)
    instant = 0.5 * u + plays(u, thresholds, weights)
    return _noisy(rng, u, -(instant + 0.2 * lag(u, tau)), 0.001)


def stop_beside_gain(device, rng):
    """A force over displacement that leads: a stop in parallel with a gain, growing sine."""
    n = 900
    t = np.arange(n)
    u = (0.2 + 2 * t / n) * np.sin(2 * np.pi * t / 90)
    return u[:, None], 0.1 * u + stop(u, 0.5) + 1e-3 * rng.standard_normal(n), 1e-3


def one_sine(n=1200, period=120.0):
    return np.sin(2 * np.pi * np.arange(n) / period)


def one_sine_late(device, rng):
    late = device.uniform(3.0, 9.0)
    y = np.sin(2 * np.pi * (np.arange(1200) - late) / 120.0)
    return _noisy(rng, one_sine(), y, 0.002)


def one_sine_play(device, rng):
    u = one_sine()
    return _noisy(
        rng, u, u + 0.5 * plays(u, np.array([device.uniform(0.2, 0.5)]), np.ones(1)), 0.002
    )


def ramp(device, rng):
    """A drift of 23 times the noise, added to three periods of a sine."""
    n, std = 1500, 0.002
    u = np.sin(2 * np.pi * 3 * np.arange(n) / n)
    additive = 23 * std * np.sqrt(12) * (np.arange(n) / n - 0.5)
    return u[:, None], u + additive + std * rng.standard_normal(n), std


def same_record_twice(device, rng):
    X, y, std = four_plays(device, rng)
    index = pd.MultiIndex.from_product([(0, 1), STEP * np.arange(len(y))], names=["record", "time"])
    return pd.DataFrame({"drive": np.tile(X[:, 0], 2)}, index), pd.Series(np.tile(y, 2), index), std


def lost_rows(device, rng):
    """Plays and a lag of 12 ms; one row in 270 is lost."""
    n = 4000
    u = drive(rng, n, 100.0)
    y = lag(0.5 * u + plays(u, np.array([0.1, 0.3]), np.array([0.3, 0.3])), 12.0)
    X, y, std = _noisy(rng, u, y, 0.001)
    kept = np.sort(rng.permutation(n)[: n - 15])
    index = pd.Index(STEP * kept, name="time")
    return pd.DataFrame({"drive": X[kept, 0]}, index), pd.Series(y[kept], index), std


def coil(device, rng):
    """The gain follows a current through the lag of a coil."""
    n = 2400
    u, current = drive(rng, n), np.repeat(rng.uniform(0, 1, 12), n // 12)
    y = (1.0 + 0.5 * lag(current, device.uniform(15, 40))) * u
    return _noisy(rng, np.column_stack([u, current]), y, 0.002)


def dry_mass(device, rng):
    u = drive(rng, 2000, 30.0)
    return _noisy(rng, u, mass(u, device.uniform(15, 25), 0.05, dry=0.1), 0.002)


def cubic_mass(device, rng):
    u = drive(rng, 2000, 30.0)
    return _noisy(rng, u, mass(u, device.uniform(15, 25), 0.1, cubic=0.3), 0.002)


def drive_times_rate(device, rng):
    u = drive(rng, 2000)
    return _noisy(rng, u, u + 4.0 * u * np.gradient(u), 0.001)


def _coloured(device, rng, colour):
    n, std = 2000, 0.01
    u, e = drive(rng, n), rng.standard_normal(n)
    if colour == "autoregressive":
        for k in range(1, n):
            e[k] = 0.9 * e[k - 1] + np.sqrt(1 - 0.9**2) * e[k]
    elif colour == "flicker":
        spectrum = np.fft.rfft(rng.standard_normal(2 * n))
        spectrum[1:] /= np.sqrt(np.arange(1, n + 1))
        spectrum[0] = 0.0
        e = np.fft.irfft(spectrum)[:n]
        e /= np.std(e)
    return u[:, None], u + std * e, std


def white_noise(device, rng):
    return _coloured(device, rng, "white")


def autoregressive_noise(device, rng):
    return _coloured(device, rng, "autoregressive")


def flicker_noise(device, rng):
    return _coloured(device, rng, "flicker")


def searched_with(declared, **options):
    """Return the search of a declared model, made when it is called."""
    return lambda: EffectSearchCV(declared(), random_state=0, **options)


def _plays(*arguments, **options):
    return lambda: PrandtlIshlinskii(*arguments, **options)


LEADING = "hysteresis"  # stops are plays of negative weight: where these are excluded, their name
LIKE_A_DELAY = "delay|timing|lag|resonance|creep|hysteresis|rate_dependence|backlash"  # of a sine
CASES = {
    "log_creep_step, offset alone": Small(
        log_creep_step,
        searched_with(lambda: Gain(dt=0.2), effects=["offset"]),
        "none",
        "unexplained|undetermined",
    ),
    "log_creep_step": Small(
        log_creep_step, searched_with(lambda: Gain(dt=0.2)), "creep", verdict="", also="drift|lag"
    ),
    "gain_step": Small(gain_step, searched_with(Gain), "unknown", "unexplained"),
    "one_speed_damper, 20 plays": Small(
        one_speed_damper, searched_with(_plays()), "none", also=LEADING
    ),
    "one_speed_damper, 60 plays": Small(
        one_speed_damper, searched_with(_plays(60)), "none", also=LEADING
    ),
    "one_speed_damper, 20 stops": Small(
        one_speed_damper, searched_with(_plays(form="stop")), "none"
    ),
    "one_speed_damper, gain": Small(one_speed_damper, searched_with(Gain), "hysteresis"),
    "four_plays, 8 plays": Small(four_plays, searched_with(_plays(8)), "none"),
    "four_plays, 20 plays": Small(four_plays, searched_with(_plays(20)), "none"),
    "four_plays, gain": Small(four_plays, searched_with(Gain), "hysteresis"),
    "falling_plays, 20 plays": Small(falling_plays, searched_with(_plays(20)), "none"),
    "falling_creep, 20 plays": Small(falling_creep, searched_with(_plays(20)), "creep"),
    "stop_beside_gain": Small(stop_beside_gain, searched_with(Gain), "hysteresis"),
    "one_sine_late": Small(one_sine_late, searched_with(Gain), LIKE_A_DELAY),
    "one_sine_play": Small(one_sine_play, searched_with(Gain), "hysteresis|backlash"),
    "ramp": Small(ramp, searched_with(Gain), "drift"),
    "same_record_twice": Small(
        same_record_twice, searched_with(_plays(20)), "none", "noise|undetermined"
    ),
    "lost_rows": Small(lost_rows, searched_with(_plays(20)), "lag"),
    "coil": Small(coil, searched_with(Gain), "auxiliary_input"),
    "dry_mass": Small(dry_mass, searched_with(lambda: SecondOrderMode(dt=STEP)), "friction"),
    "cubic_mass": Small(
        cubic_mass, searched_with(lambda: SecondOrderMode(dt=STEP)), "cubic_stiffness"
    ),
    "drive_times_rate": Small(drive_times_rate, searched_with(Gain), "unknown", "unexplained"),
    "white_noise": Small(white_noise, searched_with(Gain), "none"),
    "autoregressive_noise": Small(autoregressive_noise, searched_with(Gain), "none"),
    "flicker_noise": Small(flicker_noise, searched_with(Gain), "none", "noise|undetermined"),
}


def records(name, seed):
    """Return (X, y, noise) to search and held out."""
    case = CASES[name]
    return [
        case.record(np.random.default_rng(seed), np.random.default_rng([seed, i])) for i in (1, 2)
    ]
