"""Plants that judge the effect search: simulated recordings with one undeclared effect each.

Nothing here is shared with the package that is judged: operators, differential equations and
signals are written a second time, in the plainest way. The drive is piecewise linear between its
samples. Every plant is advanced on a grid that is `substeps` times finer than the sampling: plays
by their defining recursion, linear dynamics by classical Runge-Kutta steps, everything else by its
law. Inside this module time counts in sampling intervals and the hysteresis output peaks at one;
`Recording` carries seconds and the units of drive and response.

A signal path has these places, in this order::

    drive -> first -> plays -> middle -> dynamics -> (sampled) -> last -> + beside -> + noise

Every record starts as if the device had been loaded from zero to the first drive value for the
first time, and had then rested until every dynamic settled.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numba
import numpy as np
import pandas as pd

BASES = ("prandtl_ishlinskii", "cascade")
EFFECTS = (
    "asymmetry",
    "static_nonlinearity",
    "lag",
    "delay",
    "resonance",
    "creep",
    "drift",
    "offset",
    "output_saturation",
    "input_saturation",
    "periodic_disturbance",
)
N_TRAIN, N_TEST = 5, 3
SUBSTEPS = 32


@dataclass(frozen=True)
class Recording:
    """Records to fit on, records held out, and what made them.

    Attributes
    ----------
    X_train, X_test : DataFrame of shape (n_samples, 1)
        Column `drive`; MultiIndex with levels `record` and `time` (s, from 0 in each record).
    y_train, y_test : Series of shape (n_samples,)
        Measured response, with sensor noise.
    y_train_clean, y_test_clean : Series of shape (n_samples,)
        The same without the sensor noise.
    noise_std : float
        Standard deviation of the sensor noise, units of the response.
    sampling_interval : float
        Seconds.
    truth : dict
        Parameters of the plant in seconds, hertz and the units of drive and response.
    """

    X_train: pd.DataFrame
    y_train: pd.Series
    X_test: pd.DataFrame
    y_test: pd.Series
    y_train_clean: pd.Series
    y_test_clean: pd.Series
    noise_std: float
    sampling_interval: float
    truth: dict


# ------------------------------------------------------------------------------------- signals
# Each takes a number of samples and a generator, and returns a drive that peaks at one.


def _log_uniform(rng, low, high, size=None):
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


def _to_unit_peak(signal):
    return signal / np.abs(signal).max()


def triangles(n, rng):
    """Draw ramps between turning points of alternating sign and varying height, from zero."""
    half = 0.5 * _log_uniform(rng, 200, 900)
    count = int(n / (0.75 * half)) + 3
    times = np.concatenate([[0.0], np.cumsum(half * rng.uniform(0.8, 1.2, count))])
    signs = rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(count)
    heights = np.concatenate([[0.0], signs * rng.uniform(0.4, 1.0, count)])
    return _to_unit_peak(np.interp(np.arange(n), times, heights))


def swept_sine(n, rng):
    """Draw a sine whose frequency grows or falls exponentially, below every mode."""
    low, high = 1.0 / rng.uniform(1000, 2000), 1.0 / _log_uniform(rng, 70, 150)
    if rng.random() < 0.5:
        low, high = high, low
    growth = np.log(high / low)
    cycles = low * n / growth * np.expm1(growth * np.arange(n) / n)
    return _to_unit_peak(np.sin(2 * np.pi * cycles))


def steps(n, rng):
    """Draw random levels, each held for a while, joined by smooth edges of 4 to 20 samples."""
    rise = rng.uniform(4, 20)
    t = np.arange(n)
    signal = np.zeros(n)
    level, start = 0.0, rng.uniform(20, 100)
    while start < n:
        new = rng.uniform(-1, 1)
        while abs(new - level) < 0.4:
            new = rng.uniform(-1, 1)
        edge = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - start) / rise, 0, 1))
        signal += (new - level) * edge
        level, start = new, start + rise + _log_uniform(rng, 60, 700)
    return _to_unit_peak(signal)


def multisine(n, rng):
    """Draw a periodic sum of harmonics of falling amplitude and random phase."""
    period, cutoff = _log_uniform(rng, 600, 2000), 1.0 / _log_uniform(rng, 30, 90)
    harmonics = np.arange(1, max(3, int(cutoff * period)) + 1)
    amplitudes = rng.uniform(0.3, 1.0, harmonics.size) / harmonics
    phases = rng.uniform(0, 2 * np.pi, harmonics.size)
    angles = 2 * np.pi * np.outer(np.arange(n), harmonics) / period + phases
    return _to_unit_peak(np.sin(angles) @ amplitudes)


def band_limited_noise(n, rng):
    """Draw Gaussian noise whose spectrum falls with frequency and ends at a cutoff."""
    cutoff = 1.0 / _log_uniform(rng, 30, 90)
    size = 2 * n
    frequencies = np.fft.rfftfreq(size)
    shape = np.where(frequencies < cutoff, 1.0 / (1.0 + (frequencies * 400) ** 2), 0.0)
    shape[frequencies < 1 / 3000] = 0.0
    signal = np.fft.irfft(np.fft.rfft(rng.standard_normal(size)) * shape, size)[:n]
    return _to_unit_peak(signal - signal.mean())


SIGNALS = (triangles, swept_sine, steps, multisine, band_limited_noise)


def refine(drive, substeps):
    """Put `substeps` equal intervals between each two samples of a piecewise linear drive."""
    n = drive.size
    fine = np.interp(np.arange((n - 1) * substeps + 1) / substeps, np.arange(n), drive)
    fine[::substeps] = drive
    return fine


# ------------------------------------------------------------------------------------- physics


@numba.njit
def plays(drive, thresholds, weights):
    """Weighted sum of play operators in their virgin state, sample by sample."""
    out = np.zeros(drive.size)
    for r, w in zip(thresholds, weights):  # noqa: B905
        state = 0.0
        for i, u in enumerate(drive):
            state = max(u - r, min(u + r, state))
            out[i] += w * state
    return out


@numba.njit
def first_order(signal, step, tau):
    """Solve tau x' + x = u by Runge-Kutta steps; u is linear within a step, x starts settled."""
    out = np.empty(signal.size)
    x = signal[0]
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        u1 = 0.5 * (u0 + u2)
        k1 = (u0 - x) / tau
        k2 = (u1 - x - 0.5 * step * k1) / tau
        k3 = (u1 - x - 0.5 * step * k2) / tau
        k4 = (u2 - x - step * k3) / tau
        x += step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[i] = x
    return out


@numba.njit
def second_order(signal, step, frequency, damping):
    """Solve x'' + 2 z w x' + w^2 x = w^2 u, w = 2 pi frequency, in the same way."""
    w = 2.0 * np.pi * frequency
    a, b = w * w, 2.0 * damping * w
    out = np.empty(signal.size)
    x, v = signal[0], 0.0
    out[0] = x
    for i in range(1, signal.size):
        u0, u2 = signal[i - 1], signal[i]
        u1 = 0.5 * (u0 + u2)
        v1, f1 = v, a * (u0 - x) - b * v
        v2 = v + 0.5 * step * f1
        f2 = a * (u1 - x - 0.5 * step * v1) - b * v2
        v3 = v + 0.5 * step * f2
        f3 = a * (u1 - x - 0.5 * step * v2) - b * v3
        v4 = v + step * f3
        f4 = a * (u2 - x - step * v3) - b * v4
        x += step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        v += step / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4)
        out[i] = x
    return out


def kelvin_voigt(signal, step, taus, compliances):
    """Add a chain of Kelvin-Voigt units to the signal that loads them."""
    units = zip(taus, compliances, strict=True)
    return signal + sum(c * first_order(signal, step, tau) for tau, c in units)


def pure_delay(signal, step, delay):
    """Shift in time; before the start the signal stood at its first value."""
    t = step * np.arange(signal.size)
    return np.interp(t - delay, t, signal)


def dead_zones(signal, step, side, thresholds, weights):
    """Add one-sided dead zones, all on the positive (`side` 1) or the negative side (-1)."""
    terms = zip(thresholds, weights, strict=True)
    return signal + side * sum(w * np.maximum(side * signal - r, 0.0) for r, w in terms)


def clip(signal, step, low, high):
    return np.clip(signal, low, high)


def bend_tanh(signal, step, scale, bend):
    return scale / bend * np.tanh(bend * signal / scale)


def bend_cubic(signal, step, scale, bend):
    return signal * (1.0 + bend * (signal / scale) ** 2)


def bend_exponential(signal, step, scale, bend):
    return scale / bend * np.expm1(bend * signal / scale)


Stage = Callable[[np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class Plant:
    """A signal path from drive to clean response (see the head of the module).

    Each stage is called with a signal and the time between its samples, in sampling intervals.
    """

    thresholds: np.ndarray
    weights: np.ndarray
    first: tuple[Stage, ...] = ()
    middle: tuple[Stage, ...] = ()
    dynamics: tuple[Stage, ...] = ()
    last: tuple[Stage, ...] = ()

    def respond(self, drive, substeps=SUBSTEPS):
        """Return the response at the samples of one record's drive, without what is beside."""
        step = 1.0 / substeps
        signal = refine(drive, substeps)
        for stage in self.first:
            signal = stage(signal, step)
        signal = plays(signal, self.thresholds, self.weights)
        for stage in self.middle + self.dynamics:
            signal = stage(signal, step)
        signal = signal[::substeps]
        for stage in self.last:
            signal = stage(signal, 1.0)
        return signal

    def insert(self, place, stage):
        """Return the plant with one more stage at the end of a place."""
        return replace(self, **{place: (*getattr(self, place), stage)})


# ------------------------------------------------------------------------------------- effects


@dataclass(frozen=True)
class Setting:
    """What an effect has to know of the plant that it enters; the response here peaks near one."""

    drive: tuple[float, float]  # lowest and highest drive of the records to fit on
    response: tuple[float, float]  # the same of the response without the effect
    settled: tuple[float, float]  # the same of the plays alone, without a mode's overshoot
    lengths: tuple[int, ...]  # samples of each record, held-out records last
    mode: float  # frequency of the plant's own mode, in cycles a sample; 0 without one
    dt: float  # sampling interval, s
    unit: float  # response units per one


@dataclass(frozen=True)
class Effect:
    """A stage and its place, or a signal beside the plant for each record; and its parameters."""

    truth: dict
    place: str = ""
    stage: Stage | None = None
    beside: list = field(default_factory=list)


def asymmetry(rng, setting):
    count, side = rng.integers(2, 5), rng.choice([-1, 1])
    thresholds = np.sort(rng.uniform(0.0, 0.5, count))
    weights = rng.uniform(0.5, 1.5, count)
    bend = rng.choice([-1, 1]) * rng.uniform(0.15, 0.35)  # share of the peak on that side
    weights *= bend / np.sum(weights * (1.0 - thresholds))  # above -0.7 in all: monotone
    stage = partial(dead_zones, side=side, thresholds=thresholds, weights=weights)
    truth = {"side": side, "thresholds": setting.unit * thresholds, "weights": weights}
    return Effect(truth, "middle", stage)


def static_nonlinearity(rng, setting):
    scale = np.abs(setting.response).max()
    law = (bend_tanh, bend_cubic, bend_exponential)[rng.integers(3)]
    share = rng.uniform(0.18, 0.3)  # departure from the tangent at zero, at the peak
    if law is bend_tanh:
        bend = np.sqrt(3 * share) * (1 + 0.6 * share)  # tanh(b) / b = 1 - share, to a percent
    elif law is bend_cubic:
        bend = share if rng.random() < 0.5 else -min(share, 0.22)  # monotone to 1.2 of the peak
    else:
        bend = rng.choice([-1, 1]) * 2 * share
    truth = {"law": law.__name__, "bend": bend, "scale": setting.unit * scale}
    return Effect(truth, "last", partial(law, scale=scale, bend=bend))


def lag(rng, setting):
    tau = rng.uniform(3, 30)
    if setting.mode:  # a much slower lag would leave nothing of the mode to see
        tau = max(3.0, rng.uniform(0.8, 3.0) / (2 * np.pi * setting.mode))
    return Effect({"tau": tau * setting.dt}, "dynamics", partial(first_order, tau=tau))


def delay(rng, setting):
    shift = rng.uniform(2, 15)
    return Effect({"delay": shift * setting.dt}, "dynamics", partial(pure_delay, delay=shift))


def resonance(rng, setting):
    frequency, damping = 1.0 / _log_uniform(rng, 14, 50), _log_uniform(rng, 0.01, 0.15)
    while setting.mode and 1 / 1.5 < frequency / setting.mode < 1.5:
        frequency = 1.0 / _log_uniform(rng, 14, 50)
    truth = {"frequency": frequency / setting.dt, "damping": damping}
    stage = partial(second_order, frequency=frequency, damping=damping)
    return Effect(truth, "dynamics", stage)


def creep(rng, setting):
    longest = np.mean(setting.lengths)
    share = rng.uniform(0.15, 0.3)  # of the settled response
    count = rng.integers(0, 4)
    if count:
        # One unit in each equal part of the logarithm of time; a lone slow one would hardly show.
        edges = np.geomspace(30, longest / 4 if count == 1 else longest, count + 1)
        taus = _log_uniform(rng, edges[:-1], edges[1:])
        compliances = rng.uniform(0.5, 1.5, count)
    else:
        taus = np.geomspace(30, longest, 25)  # a flat spectrum: creep by the logarithm of time
        compliances = np.ones(taus.size)
    compliances *= share / (1.0 - share) / compliances.sum()
    truth = {
        "law": "kelvin_voigt" if count else "logarithmic",
        "taus": taus * setting.dt,
        "compliances": compliances,
    }
    stage = partial(kelvin_voigt, taus=taus, compliances=compliances)
    return Effect(truth, "dynamics", stage)


def _clipping_levels(rng, low, high):
    sides = rng.integers(3)  # high, low, both
    top = high * rng.uniform(0.7, 0.85) if sides != 1 else np.inf
    bottom = low * rng.uniform(0.7, 0.85) if sides != 0 else -np.inf
    return bottom, top


def output_saturation(rng, setting):
    low, high = _clipping_levels(rng, *setting.settled)
    truth = {"low": setting.unit * low, "high": setting.unit * high}
    return Effect(truth, "last", partial(clip, low=low, high=high))


def input_saturation(rng, setting):
    low, high = _clipping_levels(rng, *setting.drive)
    return Effect({"low": low, "high": high}, "first", partial(clip, low=low, high=high))


def drift(rng, setting):
    law = ("linear", "exponential", "sine")[rng.integers(3)]
    spans = rng.uniform(0.04, 0.2, len(setting.lengths)) * np.ptp(setting.response)
    beside = []
    for n, span in zip(setting.lengths, spans, strict=True):
        s = np.arange(n) / n
        if law == "linear":
            curve = s
        elif law == "exponential":
            curve = -np.exp(-s / rng.uniform(0.1, 0.5))
        else:
            curve = np.sin(2 * np.pi * (rng.uniform(0.4, 1.0) * s + rng.random()))
        beside.append(rng.choice([-1, 1]) * span * (curve - curve[0]) / np.ptp(curve))
    return Effect({"law": law, "spans": setting.unit * spans}, beside=beside)


def offset(rng, setting):
    count = len(setting.lengths)
    values = rng.choice([-1, 1], count) * rng.uniform(0.02, 0.1, count)
    while np.ptp(np.sign(values[:N_TRAIN])) == 0:  # equal offsets are one offset, of the model
        values *= rng.choice([-1, 1], count)
    values *= np.ptp(setting.response)
    beside = [np.full(n, value) for n, value in zip(setting.lengths, values, strict=True)]
    return Effect({"values": setting.unit * values}, beside=beside)


def periodic_disturbance(rng, setting):
    count = rng.integers(1, 3)
    frequencies = _log_uniform(rng, 1 / 250, 1 / 8, count)
    while count == 2 and 1 / 1.3 < frequencies[0] / frequencies[1] < 1.3:
        frequencies = _log_uniform(rng, 1 / 250, 1 / 8, count)
    amplitudes = rng.uniform(0.015, 0.05, count) * np.ptp(setting.response)
    shape = (len(setting.lengths), count)
    locked = rng.random() < 0.5  # to the start of every record; else each starts at random
    phases = rng.uniform(0, 2 * np.pi, (1, count) if locked else shape)
    beside = [
        np.sin(2 * np.pi * np.outer(np.arange(n), frequencies) + phase) @ amplitudes
        for n, phase in zip(setting.lengths, np.broadcast_to(phases, shape), strict=True)
    ]
    truth = {
        "frequencies": frequencies / setting.dt,
        "amplitudes": setting.unit * amplitudes,
        "locked": locked,
    }
    return Effect(truth, beside=beside)


# ----------------------------------------------------------------------------------- recordings


def _draw_drives(rng, n_samples, scale):
    """Draw one record of each kind to fit on, and three others, of unequal lengths."""
    shares = rng.uniform(0.85, 1.15, N_TRAIN)
    ends = np.round(n_samples * np.cumsum(shares) / shares.sum()).astype(int)
    lengths = np.diff(ends, prepend=0)
    lengths = np.append(lengths, rng.permutation(lengths)[:N_TEST])
    kinds = [*rng.permutation(len(SIGNALS)), *rng.permutation(len(SIGNALS))[:N_TEST]]
    amplitudes = rng.uniform(0.6, 1.0, N_TRAIN + N_TEST)
    amplitudes[rng.integers(N_TRAIN)] = 1.0
    amplitudes[N_TRAIN:] *= 0.96
    room = (1.0 - amplitudes) * (rng.random(amplitudes.size) < 0.5)
    offsets = room * rng.uniform(-1, 1, amplitudes.size)
    drives = [
        scale * (a * SIGNALS[kind](n, rng) + b)
        for kind, n, a, b in zip(kinds, lengths, amplitudes, offsets, strict=True)
    ]
    return drives, [SIGNALS[kind].__name__ for kind in kinds]


def _draw_base(rng, drives, scale):
    """Draw the plays; the output over the given drives peaks at one."""
    count = rng.integers(8, 16)
    widest = rng.uniform(0.8, 1.0) * scale  # 0.4 to 0.5 of the full range
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(0.01, 1.0, count)) * widest])
    weights = rng.uniform(0.4, 1.6, count) * np.exp(-thresholds[1:] / (0.5 * widest))
    hysteretic = rng.uniform(0.3, 0.6)
    weights *= hysteretic / weights.sum()
    weights = np.concatenate([[1.0 - hysteretic], weights])
    peak = max(np.abs(plays(drive, thresholds, weights)).max() for drive in drives)
    return Plant(thresholds, weights / peak)


def _frames(records, first_label, dt):
    """Stack (drive, measured, clean) records under a (record, time) index."""
    labels = np.repeat(np.arange(len(records)) + first_label, [r[0].size for r in records])
    times = np.concatenate([dt * np.arange(r[0].size) for r in records])
    index = pd.MultiIndex.from_arrays([labels, times], names=["record", "time"])
    drive, measured, clean = (np.concatenate(parts) for parts in zip(*records, strict=True))
    X = pd.DataFrame({"drive": drive}, index=index)
    y = pd.Series(measured, index=index, name="response")
    return X, y, pd.Series(clean, index=index, name="response")


def make_recording(effect, declared, seed, *, noise=0.002, n_samples=20000, substeps=SUBSTEPS):
    """Draw a plant with one undeclared effect and record it.

    Parameters
    ----------
    effect : str
        One of `EFFECTS`, or "none".
    declared : {"prandtl_ishlinskii", "cascade"}
        What the plant is but for the effect: plays alone, or plays and a second-order mode.
    seed : int
        Non-negative. The same seed gives the same plant, drives and records for every effect.
    noise : float, default 0.002
        Standard deviation of the sensor noise over the range of the clean response.
    n_samples : int, default 20000
        Samples to fit on, in five records; the three held-out records are as long as three of them.
    substeps : int, default 32
        Integration steps a sample.

    Returns
    -------
    Recording
    """
    kind = BASES.index(declared)
    chosen = 0 if effect == "none" else 1 + EFFECTS.index(effect)
    rng = np.random.default_rng([seed, kind, 1])
    dt = 1.0 / np.round(_log_uniform(rng, 100, 10_000))
    scale, unit = _log_uniform(rng, 1, 150), _log_uniform(rng, 1e-6, 1e3)
    drives, signals = _draw_drives(rng, n_samples, scale)
    plant = base = _draw_base(rng, drives[:N_TRAIN], scale)
    mode = {}
    if declared == "cascade":
        frequency, damping = 1.0 / _log_uniform(rng, 14, 50), _log_uniform(rng, 0.02, 0.25)
        mode = {"frequency": frequency, "damping": damping}
        plant = plant.insert("dynamics", partial(second_order, **mode))
    unaffected = [plant.respond(drive, substeps) for drive in drives]
    clean, found = unaffected, Effect({})
    rng = np.random.default_rng([seed, kind, 2, chosen])
    if chosen:
        fitted = np.concatenate(unaffected[:N_TRAIN])
        driven = np.concatenate(drives[:N_TRAIN])
        settled = np.concatenate([base.respond(drive, 1) for drive in drives[:N_TRAIN]])
        setting = Setting(
            drive=(driven.min(), driven.max()),
            response=(fitted.min(), fitted.max()),
            settled=(settled.min(), settled.max()),
            lengths=tuple(drive.size for drive in drives),
            mode=mode.get("frequency", 0.0),
            dt=dt,
            unit=unit,
        )
        found = LAWS[effect](rng, setting)
        if found.stage is not None:
            plant = plant.insert(found.place, found.stage)
            clean = [plant.respond(drive, substeps) for drive in drives]
        else:
            clean = [y + beside for y, beside in zip(unaffected, found.beside, strict=True)]
    noise_std = noise * np.ptp(np.concatenate(clean[:N_TRAIN]))
    rng = np.random.default_rng([seed, kind, 3, chosen])
    records = [
        (u, unit * (y + noise_std * rng.standard_normal(y.size)), unit * y)
        for u, y in zip(drives, clean, strict=True)
    ]
    X_train, y_train, y_train_clean = _frames(records[:N_TRAIN], 0, dt)
    X_test, y_test, y_test_clean = _frames(records[N_TRAIN:], N_TRAIN, dt)
    if mode:
        mode = {**mode, "frequency": mode["frequency"] / dt}
    truth = {
        "effect": effect,
        "declared": declared,
        "seed": seed,
        "parameters": found.truth,
        "signals": signals,
        "thresholds": plant.thresholds,
        "weights": unit * plant.weights,
        "mode": mode,
    }
    return Recording(
        X_train=X_train,
        y_train=y_train,
        X_test=X_test,
        y_test=y_test,
        y_train_clean=y_train_clean,
        y_test_clean=y_test_clean,
        noise_std=unit * noise_std,
        sampling_interval=dt,
        truth=truth,
    )


LAWS = {
    law.__name__: law
    for law in (
        asymmetry,
        static_nonlinearity,
        lag,
        delay,
        resonance,
        creep,
        drift,
        offset,
        output_saturation,
        input_saturation,
        periodic_disturbance,
    )
}
