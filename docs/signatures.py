"""Draw how each effect shows in the residual.

`PYTHONPATH=benchmarks python docs/signatures.py FOLDER` draws all. Each picture is simulated: one
plant with the effect, the same plant without it as the declared model, with the gain and the offset
that fit best. The left panel shows the residual over time, the right one over the quantity that
distinguishes the effect from others. The build of the pages calls :func:`draw_signatures`.
"""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from plants.motion import stopped_mode

from skhyst.datasets.simulation import (
    clip,
    dead_band,
    dead_zones,
    first_order,
    kelvin_voigt,
    oscillate,
    plays,
    pure_delay,
    slew_limited,
)

__all__ = ["SIGNATURES", "draw_signatures", "draw_thumbnail"]

DT = 1e-3  # s
TIME = DT * np.arange(4000)
NOISE = 0.003  # of the response's range
MODE = {"frequency": 12.0, "damping": 0.3}
UP, DOWN, BOTH, GREY = "#d55e00", "#2a85c4", "#444c56", "#b4bac1"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "skhyst",  # the same picture each time
    "path.simplify_threshold": 0.5,
}


def triangles(peaks=(1.0, 0.75, 0.5, 0.3), cycle=1.0):
    """Return a drive that rises and falls, a cycle for each peak, over the same time."""
    corners = np.concatenate([[0.0]] + [[peak, -peak] for peak in peaks] + [[0.0]])
    at = np.concatenate([[0.0], 0.25 + 0.5 * np.arange(2 * len(peaks)), [len(peaks)]])
    return np.interp(TIME / cycle, at * TIME[-1] / cycle / len(peaks), corners)


def steps():
    """Return levels that are held for most of a second, with short ramps between."""
    levels, edges = [0.0, 1.0, -0.5, 0.5, -1.0], [0.0, 0.4, 1.4, 2.4, 3.2]
    at = np.concatenate([[edge, edge + 0.02] for edge in edges])[1:]
    return np.interp(TIME, at, np.repeat(levels, 2)[:-1])


def sweep():
    """Return a sine that grows faster, from 0.5 Hz to 20 Hz."""
    growth = np.log(40.0) / TIME[-1]
    return np.sin(2.0 * np.pi * 0.5 * np.expm1(growth * TIME) / growth)


def wander():
    """Return a further column of X, which has nothing to do with the drive."""
    return np.sin(2.0 * np.pi * 0.37 * TIME) + 0.5 * np.sin(2.0 * np.pi * 0.9 * TIME + 1.0)


def by_record(values):
    """Return a value for each of four records, one after the other."""
    return np.repeat(values, TIME.size // len(values))


def read_early(drive):
    """Return a response that an instrument gives ahead of the drive."""
    return np.interp(TIME + 0.003, TIME, drive)


LOOP = partial(plays, step=DT, thresholds=[0.0, 0.1, 0.25, 0.45], weights=[0.55, 0.2, 0.15, 0.1])
MOVES = partial(oscillate, step=DT, **MODE)


def started_elsewhere(drive):
    """Return the loop of a device that has come from far above."""
    before = np.concatenate([np.linspace(0.0, 1.6, 200), np.linspace(1.6, drive[0], 200)])
    return LOOP(np.concatenate([before, drive]))[before.size :]


@dataclass(frozen=True)
class Signature:
    """How an effect shows.

    Parameters
    ----------
    drive : ndarray
    plant, declared : callable
        The response to the drive with the effect, and without it.
    over : str
        What the right panel is drawn over, a key of `AXES`.
    fitted : bool, default=True
        Whether the declared model has the best gain and offset.
    """

    drive: np.ndarray
    plant: object
    declared: object = LOOP
    over: str = "drive"
    fitted: bool = True

    def responses(self):
        """Return the response, and that of the declared model."""
        y, model = self.plant(self.drive), self.declared(self.drive)
        y = y + NOISE * np.ptp(y) * np.random.default_rng(0).normal(size=y.size)
        if self.fitted:
            known = np.column_stack((model, np.ones_like(model)))
            model = known @ np.linalg.lstsq(known, y, rcond=None)[0]
        return y, model


SLOW, WIDE, JUMPS, SWEEP = triangles(), triangles((1.0, 1.0, 1.0, 1.0)), steps(), sweep()
SINE = np.sin(2.0 * np.pi * 0.75 * TIME)
GROWING = triangles((0.25, 0.5, 0.75, 1.0))
SPEEDS = np.sin(2.0 * np.pi * np.where(TIME < 2.0, 0.5 * TIME, 4.0 * (TIME - 2.0)))
SIGNATURES = {
    "input_saturation": Signature(SLOW, lambda u: LOOP(clip(u, DT, -0.7, 0.6)), fitted=False),
    "dead_zone": Signature(SLOW, lambda u: LOOP(dead_band(u, DT, 0.0, 0.12))),
    "backlash": Signature(SLOW, partial(plays, step=DT, thresholds=[0.1], weights=[1.0]), np.copy),
    "slew_limit": Signature(JUMPS, lambda u: LOOP(slew_limited(u, DT, 12.0)), over="time"),
    "delay": Signature(
        SWEEP, lambda u: pure_delay(u, DT, 0.02), np.copy, "frequency", fitted=False
    ),
    "timing": Signature(SWEEP, read_early, np.copy, "rate", fitted=False),
    "initial_state": Signature(SLOW, started_elsewhere, fitted=False),
    "hysteresis": Signature(SLOW, LOOP, np.copy),
    "rate_dependence": Signature(SPEEDS, partial(LOOP, stretch=0.06)),
    "asymmetry": Signature(SLOW, lambda u: dead_zones(LOOP(u), DT, 1, [0.1, 0.4], [0.25, 0.3])),
    "lag": Signature(SWEEP, lambda u: first_order(u, DT, 0.02), np.copy, "frequency", fitted=False),
    "resonance": Signature(
        SWEEP, lambda u: oscillate(u, DT, 8.0, 0.1), np.copy, "frequency", fitted=False
    ),
    "creep": Signature(
        JUMPS, lambda u: kelvin_voigt(LOOP(u), DT, [0.05, 0.2, 0.8], [0.06] * 3), over="log_time"
    ),
    "friction": Signature(
        SINE, partial(MOVES, friction=0.15, presliding=0.01), MOVES, "velocity", fitted=False
    ),
    "cubic_stiffness": Signature(SLOW, partial(MOVES, cubic=0.4), MOVES, "response"),
    "end_stops": Signature(
        SLOW, lambda u: stopped_mode(u, DT, 12.0, 0.3, 0.6, 8.0), MOVES, "response", fitted=False
    ),
    "static_nonlinearity": Signature(SLOW, lambda u: np.tanh(1.1 * LOOP(u)), over="prediction"),
    "output_saturation": Signature(
        SLOW, lambda u: clip(LOOP(u), DT, -0.5, 0.65), over="prediction", fitted=False
    ),
    "rectification": Signature(
        SLOW, lambda u: np.abs(LOOP(u) + 0.5) - 0.5, over="prediction", fitted=False
    ),
    "amplitude_dependence": Signature(
        GROWING, lambda u: (1.0 + 0.5 * by_record([0.25, 0.5, 0.75, 1.0])) * LOOP(u)
    ),
    "auxiliary_input": Signature(
        WIDE, lambda u: LOOP(u) + 0.08 * wander(), over="column", fitted=False
    ),
    "offset": Signature(SLOW, lambda u: LOOP(u) + by_record([0.1, -0.06, 0.04, -0.12])),
    "drift": Signature(WIDE, lambda u: LOOP(u) + 0.15 * -np.expm1(-TIME / 1.5)),
    "periodic_disturbance": Signature(
        WIDE, lambda u: LOOP(u) + 0.04 * np.sin(2.0 * np.pi * 9.0 * TIME), over="spectrum"
    ),
}
AXES = {
    "drive": "drive",
    "rate": "rate of the drive (1/s)",
    "velocity": "velocity (1/s)",
    "response": "response",
    "prediction": "prediction",
    "column": "further column of X",
    "log_time": "time since the last step (s)",
    "time": "time about one step (s)",
    "frequency": "frequency (Hz)",
    "spectrum": "frequency (Hz)",
}


def _legend_above(axes, **options):
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 0.98), "borderaxespad": 0.2}
    axes.legend(frameon=False, fontsize=7, ncols=2, **place, **options)


def _smooth(signal, width=21):
    return np.convolve(np.pad(signal, width // 2, mode="edge"), np.ones(width) / width, "valid")


def _draw_over_quantity(axes, signature, y, model):
    """Draw the residual by the direction of the drive, as the displays of skhyst do."""
    quantities = {
        "drive": signature.drive,
        "rate": np.gradient(signature.drive, DT),
        "velocity": np.gradient(_smooth(y), DT),
        "response": y,
        "prediction": model,
        "column": wander(),
    }
    over, rising = quantities[signature.over], np.gradient(signature.drive) > 0.0
    for part, color, name in ((rising, UP, "drive rises"), (~rising, DOWN, "drive falls")):
        options = {"ms": 2, "color": color, "label": name, "rasterized": True}
        axes.plot(over[part][::2], (y - model)[part][::2], ".", **options)
    _legend_above(axes, markerscale=4, handletextpad=0.1)


def _draw_over_step(axes, signature, y, model):
    start = int(1.4 / DT)  # of the second step
    part = slice(start + 20, start + 900)
    axes.plot(TIME[part] - TIME[start], (y - model)[part], color=BOTH, lw=1)
    if signature.over == "log_time":
        axes.set_xscale("log")
    else:
        axes.set_xlim(-0.05, 0.3)
        axes.plot(TIME[: start + 300] - TIME[start], (y - model)[: start + 300], color=BOTH, lw=1)


def _draw_over_frequency(axes, signature, y, model):
    """Draw the response over that of the declared model: its gain, and its phase in turns."""
    window = np.hanning(y.size)
    spectra = [np.fft.rfft(window * (signal - signal.mean())) for signal in (y, model)]
    frequency = np.fft.rfftfreq(y.size, DT)
    cross, power = (
        _smooth(product, 3) for product in (spectra[0] * spectra[1].conj(), np.abs(spectra[1]) ** 2)
    )
    seen = (frequency > 0.7) & (frequency < 18.0)
    ratio = (cross / power)[seen]
    axes.plot(frequency[seen], np.abs(ratio), color=BOTH, lw=1.2, label="gain")
    turns = np.unwrap(np.angle(ratio)) / (2.0 * np.pi)
    axes.plot(frequency[seen], turns, color=UP, lw=1.2, label="phase (turns)")
    _legend_above(axes)


def _draw_spectrum(axes, signature, y, model):
    window, frequency = np.hanning(y.size), np.fft.rfftfreq(y.size, DT)
    for signal, color, name in ((signature.drive, GREY, "drive"), (y - model, BOTH, "residual")):
        size = np.abs(np.fft.rfft(window * signal)) * 4.0 / y.size
        axes.semilogy(frequency, np.maximum(size, 1e-5), color=color, lw=1, label=name)
    axes.set(xlim=(0.0, 20.0), ylim=(1e-4, 2.0))
    _legend_above(axes)


_DRAW = {
    "time": _draw_over_step,
    "log_time": _draw_over_step,
    "frequency": _draw_over_frequency,
    "spectrum": _draw_spectrum,
}


def draw_signature(signature, path):
    """Draw one picture into a file."""
    y, model = signature.responses()
    figure, (left, right) = plt.subplots(1, 2, figsize=(5.6, 1.9), layout="constrained")
    scale = 1.1 * np.abs(y - model).max()
    left.plot(TIME[::4], scale * signature.drive[::4], color=GREY, lw=0.8, label="drive (scaled)")
    left.plot(TIME[::4], (y - model)[::4], color=BOTH, lw=0.9, label="residual")
    _legend_above(left)
    left.set(xlabel="time (s)", ylabel="residual")
    _DRAW.get(signature.over, _draw_over_quantity)(right, signature, y, model)
    right.set_xlabel(AXES[signature.over])
    figure.savefig(path, dpi=200, metadata={"Date": None})
    plt.close(figure)


def draw_signatures(folder):
    """Draw the pictures of all effects.

    Parameters
    ----------
    folder : path-like
        Where they are written, as svg files named as the effects; it is made where it is not there.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        for name, signature in SIGNATURES.items():
            draw_signature(signature, folder / f"{name}.svg")


def draw_thumbnail(path):
    """Draw a loop, which stands for an example that was not run, into a file."""
    figure, axes = plt.subplots(figsize=(4.0, 2.8), layout="constrained")
    axes.plot(SLOW, LOOP(SLOW), color=DOWN, lw=2)
    axes.set_axis_off()
    axes.set_title("not run in this build", color=BOTH, fontsize=13)
    figure.savefig(path, dpi=100)
    plt.close(figure)


if __name__ == "__main__":
    draw_signatures(sys.argv[1])
