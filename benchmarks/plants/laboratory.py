"""How laboratories record: each condition changes what the bench of `recording` takes for granted.

There the drive is a straight line between its samples, the response is read at the same instants
with white noise, and five records begin at rest. In here a condition says how a plant is driven,
read and cut. Plants are computed on the fine grid, which is then sampled late, early or by another
clock, so nothing is interpolated but between steps of a thirty-second of a sample. Time counts in
samples.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from skhyst.datasets.simulation import first_order, refine

from . import further_forms, other_laws
from .effects import SUBSTEPS, WEAKENED
from .recording import (
    BASES,
    EFFECTS,
    MATRIX,
    change,
    draw_plant,
    effect_pairs,
    put_in,
    recorded,
    respond,
)
from .signals import N_TRAIN, draw_noise, log_uniform

PER_RECORD = {"amplitude_dependence", "offset"}  # seen where records differ
SLOW = {"creep", "drift"}  # seen where records are long
BESIDE = {"drift", "periodic_disturbance", "auxiliary_input"}
LOOP = 0.5  # gain of the feedback: its fixed point is approached by that factor a round
SLOWNESS = 300.0  # of its low-pass, samples: no mode gets through
ROUNDS = 20
SMALLER, SHOWING = 0.1, 2.5  # effect of an unequal pair: over the larger one; at least, over noise
NEAR = 1.2  # ratio to that, up to which it is what was asked for
TRIALS = 12  # of its strength


@dataclass(frozen=True)
class Condition:
    """How a plant is driven and read.

    Attributes
    ----------
    hold : {"line", "step"}
        What the drive does between its samples.
    late : float
        By which the response is read behind the drive, samples; negative where it is ahead.
    skew : float
        How much faster the clock of the response runs.
    cut : float
        Part of each record, from its start, that is not kept.
    colour : dict
        Law of the noise, see `draw_noise`.
    line : float
        Amplitude of a mains line, in standard deviations of the noise.
    outliers : float
        Part of the readings that are off by 10 to 30 standard deviations.
    levels : int
        Of the response's range, that an analog-to-digital converter tells apart; 0 for all.
    drive_noise : float
        Standard deviation of the noise on the drive that is recorded, over its range.
    feedback : bool
        Whether the drive follows from a reference and from the response as it is read.
    n_samples : int
        To fit on, together.
    records : int
        To fit on.
    period : float
        Of a sine that takes the place of every drive; 0 for none.
    """

    hold: str = "line"
    late: float = 0.0
    skew: float = 0.0
    cut: float = 0.0
    colour: dict | None = None
    line: float = 0.0
    outliers: float = 0.0
    levels: int = 0
    drive_noise: float = 0.0
    feedback: bool = False
    n_samples: int = 6000
    records: int = N_TRAIN
    period: float = 0.0


@dataclass(frozen=True)
class Habit:
    """A condition that is drawn, and what follows for those who judge.

    Attributes
    ----------
    draw : callable
        Maps a generator to a condition.
    hides : set of str
        Effects that it leaves no trace of.
    makes : set of str
        Names that are true of the condition itself.
    laws : dict of str to callable
        The only effects of these plants, and their laws, where they are others.
    matrix : dict of str to tuple of str
        Which of them a plant can have, by what is declared.
    unequal : bool
        Whether plants have two effects, of which the last is far smaller.
    """

    draw: Callable
    hides: set = frozenset()
    makes: set = frozenset()
    laws: dict = field(default_factory=dict)
    matrix: dict = field(default_factory=lambda: MATRIX)
    unequal: bool = False

    def possible(self, declared):
        """Return what a plant can hide, in an order of its own: tuples of names."""
        if self.unequal:
            pairs = [p for pair in effect_pairs(declared) for p in (pair, pair[::-1])]
            return [pair for pair in pairs if pair[1] in WEAKENED]
        seen = set(self.matrix[declared]) - self.hides
        return [(name,) for name in sorted(seen & set(self.laws) if self.laws else seen)]


def _of_either_sign(rng, low, high):
    return rng.choice([-1.0, 1.0]) * rng.uniform(low, high)


HABITS = {
    "bench": Habit(lambda rng: Condition()),
    "single_record": Habit(lambda rng: Condition(records=1), PER_RECORD),
    "short_record": Habit(
        lambda rng: Condition(records=1, n_samples=int(rng.choice([500, 1000]))), PER_RECORD | SLOW
    ),
    "single_sine": Habit(
        lambda rng: Condition(records=1, n_samples=3000, period=log_uniform(rng, 100, 600)),
        set(EFFECTS) - BESIDE,
    ),
    "mid_loop": Habit(lambda rng: Condition(cut=rng.uniform(0.1, 0.4)), makes={"initial_state"}),
    "autoregressive": Habit(
        lambda rng: Condition(
            colour={"law": "autoregressive", "coefficient": rng.uniform(0.5, 0.95)}
        )
    ),
    "flicker": Habit(lambda rng: Condition(colour={"law": "flicker"})),
    "mains": Habit(
        lambda rng: Condition(line=rng.uniform(0.5, 3.0)), makes={"periodic_disturbance"}
    ),
    "outliers": Habit(lambda rng: Condition(outliers=log_uniform(rng, 1e-3, 1e-2))),
    "quantised": Habit(lambda rng: Condition(levels=410)),  # twelve bits, a tenth of the range
    "late": Habit(lambda rng: Condition(late=rng.uniform(0.2, 0.9)), makes={"timing"}),
    "early": Habit(lambda rng: Condition(late=-rng.uniform(0.2, 0.9)), makes={"timing"}),
    "skewed_clocks": Habit(
        lambda rng: Condition(skew=_of_either_sign(rng, 3e-4, 1e-3)), makes={"timing"}
    ),
    "held_drive": Habit(lambda rng: Condition(hold="step"), makes={"timing"}),
    "closed_loop": Habit(lambda rng: Condition(feedback=True)),
    "noisy_drive": Habit(lambda rng: Condition(drive_noise=rng.uniform(0.002, 0.01))),
    "other_laws": Habit(lambda rng: Condition(), laws=other_laws.LAWS),
    "unequal_pair": Habit(lambda rng: Condition(), unequal=True),
    "further_forms": Habit(
        lambda rng: Condition(), laws=further_forms.LAWS, matrix=further_forms.MATRIX
    ),
}


def read(plant, drive, condition):
    """Return the response of a plant as it is read, without noise."""
    fine = refine(drive, SUBSTEPS)
    if condition.hold == "step":
        fine = np.repeat(drive, SUBSTEPS)[: fine.size]
    response = plant.send(fine, 1.0 / SUBSTEPS, *plant.places)
    when = np.arange(drive.size) * (1.0 + condition.skew) - condition.late
    return np.interp(when * SUBSTEPS, np.arange(response.size), response)


def measured(rng, clean, noise_std, condition):
    """Return a response with the noise and the faults of a sensor."""
    n = clean.size
    noise = draw_noise(rng, n, **(condition.colour or {"law": "white"}))
    phase, frequency = rng.uniform(0, 2 * np.pi), 1.0 / rng.uniform(8, 40)
    noise += condition.line * np.sin(2 * np.pi * frequency * np.arange(n) + phase)
    off = rng.random(n) < condition.outliers
    noise += off * rng.choice([-1.0, 1.0], n) * rng.uniform(10.0, 30.0, n)
    y = clean + noise_std * noise
    if condition.levels:
        step = np.ptp(clean) / condition.levels
        y = step * np.round(y / step)
    return y


def record_in(habit, effect, declared, seed, *, noise=0.002, drive=None):
    """Draw a plant, and record it as a laboratory does.

    Parameters
    ----------
    habit : str
        Of `HABITS`.
    effect, declared, seed, noise
        As of `make_recording`.
    drive : ndarray of shape (n_samples,), optional
        In place of that of the first held-out record; effects depend on its length alone.

    Returns
    -------
    Recording
        Held-out records are read as those to fit on are.
    """
    names = () if effect == "none" else (effect,) if isinstance(effect, str) else tuple(effect)
    kind, number = BASES.index(declared), list(HABITS).index(habit)
    rng = np.random.default_rng([seed, kind, 6, number])
    condition = HABITS[habit].draw(rng)
    longer = N_TRAIN / condition.records / (1.0 - condition.cut)
    plant, setting, signals, column = draw_plant(
        seed,
        kind,
        int(longer * condition.n_samples),
        SUBSTEPS,
        False,
        not PER_RECORD.isdisjoint(names),
    )
    if condition.period:
        sine = [np.sin(2 * np.pi * np.arange(u.size) / condition.period) for u in setting.drives]
        tops = [np.abs(u).max() for u in setting.drives]
        setting = replace(setting, drives=tuple(a * u for a, u in zip(tops, sine, strict=True)))
    if drive is not None:
        setting = _with_drive(setting, np.resize(setting.drives[N_TRAIN], len(drive)))
    put = partial(put_in, names=names, plant=plant, setting=setting, laws=HABITS[habit].laws)
    if HABITS[habit].unequal and len(names) > 1:
        found = _unequal(rng, put, noise)
    else:
        found = put(rng)[0]
    if condition.feedback:
        setting = _closed(seed, plant, found, setting, noise, condition)
    if drive is not None:  # of which effects, when they are drawn, know the length alone
        setting = _with_drive(setting, drive)
    here = partial(read, condition=condition)
    clean = respond(plant, found, setting, here)
    kept = _kept(setting, condition)
    noise_std = noise * np.ptp(np.concatenate([clean[i] for i in kept]))
    sizes = {}
    for name, one in zip(names, found, strict=True):
        without = respond(plant, [other for other in found if other is not one], setting, here)
        parts = [[part[i] for i in kept] for part in (clean, without)]
        sizes[name] = change(*parts) / noise_std
        column = one.column if one.column[0] else column
    records = _measured(seed, clean, noise_std, setting, column, condition)
    truth = {
        "effect": effect,
        "declared": declared,
        "seed": seed,
        "condition": condition,
        "parameters": [one.truth for one in found],
        "effect_over_noise": sizes,
        "signals": signals,
        "column": column[0],
    }
    fitted = [records[i] for i in kept]
    return recorded(fitted, records[N_TRAIN:], setting, noise_std, truth)


def _with_drive(setting, drive):
    """Return the setting with another drive in the first held-out record."""
    drives, lengths = list(setting.drives), list(setting.lengths)
    drives[N_TRAIN], lengths[N_TRAIN] = drive, len(drive)
    return replace(setting, drives=tuple(drives), lengths=tuple(lengths))


def _unequal(rng, put, noise):
    """Draw two effects, the last so weak that it changes a tenth of what the first does.

    Where that would be lost in the noise, it is stronger.
    """
    plant, setting = put.keywords["plant"], put.keywords["setting"]
    low, high, strength = 0.0, np.inf, 1.0
    for _ in range(TRIALS):
        found, clean = put(deepcopy(rng), last=strength)
        least = SHOWING * noise * np.ptp(np.concatenate(clean[:N_TRAIN]))
        large, small = (change(clean, respond(plant, [one], setting)) for one in found[::-1])
        ratio = small / max(SMALLER * large, least)
        if 1.0 / NEAR < ratio < NEAR or (ratio < 1.0 and high == np.inf):  # none is made stronger
            break
        low, high = (low, strength) if ratio > 1.0 else (strength, high)
        strength /= ratio  # as most are in proportion
        if not low < strength < high:
            strength = np.sqrt(low * high) if low else 0.5 * high
    return found


def _kept(setting, condition):
    """Return which records are there to fit on: those that go furthest."""
    tops = [np.abs(drive).max() for drive in setting.drives[:N_TRAIN]]
    return sorted(np.argsort(tops)[-condition.records :])


def _closed(seed, plant, found, setting, noise, condition):
    """Return the setting with drives that follow from the response as it is read.

    u = r + g L (r - y) with the reference r and a low-pass L, from round to round.
    """
    references, here = setting.drives, partial(read, condition=condition)
    scale = max(np.abs(r).max() for r in references)
    clean = respond(plant, found, setting, here)
    noise_std = noise * np.ptp(np.concatenate(clean[:N_TRAIN]))
    for _ in range(ROUNDS):
        drives = []
        for i, (r, y) in enumerate(zip(references, clean, strict=True)):
            y = measured(np.random.default_rng([seed, 7, i]), y, noise_std, condition)
            drives.append(r + LOOP * first_order(r - scale * y, 1.0, SLOWNESS))
        setting = replace(setting, drives=tuple(drives))
        clean = respond(plant, found, setting, here)
    return setting


def _measured(seed, clean, noise_std, setting, column, condition):
    """Return (drive, column or None, measured, clean) of each record, without what is cut off."""
    records = []
    for i, (u, c, y) in enumerate(zip(setting.drives, column[1], clean, strict=True)):
        unit = setting.unit
        seen = unit * measured(np.random.default_rng([seed, 7, i]), y, noise_std, condition)
        rng = np.random.default_rng([seed, 8, i])
        u = u + condition.drive_noise * np.ptp(u) * rng.standard_normal(u.size)
        rows = slice(int(condition.cut * u.size), None)
        records.append(
            (u[rows], None if c is None else c[rows], seen[rows], setting.unit * y[rows])
        )
    return records
