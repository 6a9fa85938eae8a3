"""Largest drives that fitted models ask for: `python benchmarks/drives.py`.

    python benchmarks/drives.py [--models 500] [--seed 0]

Models of ten kinds are fitted to noisy records of plants that are drawn, and asked for the drive
under which the response is a reference within its range: smooth ones that rest at their ends, and
ones that move at once, until the last sample. Counted are drives that leave what the fit has seen,
with the limits of the compensator as they are by default, and, without limits, drives larger than
three times the largest that the plant needs: its own parameters, inverted over the record with a
rest before and behind it. Beside it is what the response of the plant misses of the references
(root mean square over their range, median and worst), what of that was reported, and the worst
that was not.
"""

import argparse
import time
import warnings

import numpy as np

from skhyst.compose import Cascade
from skhyst.control import InverseCompensator
from skhyst.exceptions import ConvergenceWarning, ReachWarning
from skhyst.hysteresis import (
    BoucWenStage,
    BoucWenStageOperator,
    FrictionStage,
    FrictionStageOperator,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    Delay,
    DelayOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    KelvinVoigt,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.operators import Series, inverse_of
from skhyst.static import SoftSaturation, SoftSaturationOperator

DT, N = 1e-3, 800  # s; samples of a record
SHORT, REST = 300, 100  # samples of a reference, and of what the plant is given around it
NOISE = 0.01  # of the response's standard deviation, at the most
BAR = 3.0  # times what the plant needs
ROUNDING = 1e-9  # of the range of the drive


def plays(rng):
    """Return plays whose gain is about one."""
    thresholds = np.concatenate([[0.0], np.sort(rng.uniform(0.2, 2.5, 3))])
    return PrandtlIshlinskiiOperator(thresholds, np.array([0.7, *rng.uniform(0.02, 0.2, 3)]))


def mode(rng):
    """Return a mode of low damping."""
    return SecondOrderModeOperator(2 * np.pi * rng.uniform(20.0, 90.0), rng.uniform(0.01, 0.05))


def transfer_function(rng):
    """Return a mode with a zero, half of them one that makes it begin the wrong way."""
    zero = rng.choice([-1.0, 1.0]) * rng.uniform(2e-3, 8e-3)
    w, damping = rng.uniform(200.0, 500.0), rng.uniform(0.05, 0.3)
    return TransferFunctionOperator(
        np.empty(0), np.array([w]), np.array([damping]), np.array([zero])
    )


def series(*makers):
    """Return a maker of cascades."""
    names = tuple("abc"[: len(makers)])
    return lambda rng: Series(names, tuple(make(rng) for make in makers))


def stages(*models):
    """Return a cascade of models."""
    return Cascade(list(zip("abc", models, strict=False)), dt=DT)


def delay(rng):
    return DelayOperator(DT * rng.uniform(0.0, 6.0))


def lag(rng):
    return FirstOrderLagOperator(rng.uniform(2e-3, 2e-2))


def creep(rng):
    return KelvinVoigtOperator(rng.uniform(0.02, 0.1, 1), rng.uniform(0.05, 0.2, 1))


def limit(rng):
    return SoftSaturationOperator(rng.uniform(6.0, 9.0), rng.uniform(2.0, 6.0))


def motion(rng):
    return 2 * np.pi * rng.uniform(20.0, 70.0), rng.uniform(0.03, 0.2), rng.uniform(0.2, 0.6)


def wires(rng):
    return BoucWenStageOperator(*motion(rng), rng.uniform(0.8, 2.0), 0.0, rng.uniform(1.0, 2.0))


def friction(rng):
    return FrictionStageOperator(*motion(rng), rng.uniform(0.4, 1.0), 30.0, 20.0)


KINDS = {
    "plays": (plays, PrandtlIshlinskii(8, dt=DT)),
    "plays, modified": (series(plays, limit), ModifiedPrandtlIshlinskii(8, dt=DT)),
    "plays, saturation": (series(plays, limit), stages(PrandtlIshlinskii(5), SoftSaturation())),
    "mode": (mode, SecondOrderMode(dt=DT)),
    "transfer function": (transfer_function, TransferFunction(2, n_zeros=1, dt=DT)),
    "plays, mode": (series(plays, mode), stages(PrandtlIshlinskii(5), SecondOrderMode())),
    "plays, creep, mode": (
        series(plays, creep, mode),
        stages(PrandtlIshlinskii(5), KelvinVoigt(1), SecondOrderMode()),
    ),
    "lag, delay": (series(lag, delay), stages(FirstOrderLag(), Delay())),
    "motion, Bouc-Wen": (wires, BoucWenStage(dt=DT)),
    "motion, friction": (friction, FrictionStage(dt=DT)),
}


def waves(rng, n, highest, several):
    """Return a sum of sines (n,) of amplitude one at the most, from zero."""
    t = DT * np.arange(n)
    f = rng.uniform(1.0, highest, several)
    own = np.sin(2 * np.pi * f * t[:, None]) @ rng.uniform(0.3, 1.0, several)
    return own / np.abs(own).max()


def record(plant, rng):
    """Return a drive (N,) and the response with noise."""
    u = rng.uniform(5.0, 8.0) * waves(rng, N, 60.0, 6)
    y, _ = plant.run(u, DT, plant.init(u[0]))
    return u, y + rng.uniform(0.1, 1.0) * NOISE * np.std(y) * rng.normal(size=N)


def reference(rng, size, rests):
    """Return a reference (SHORT,) that begins at zero, with a rest at both ends or without."""
    own = size * rng.uniform(0.2, 0.6) * waves(rng, SHORT, 12.0, 2)
    if not rests:
        return own
    inside = np.clip(np.minimum(np.arange(SHORT) - 40, SHORT - 40 - np.arange(SHORT)) / 60, 0, 1)
    return own * inside**3 * (10.0 - 15.0 * inside + 6.0 * inside**2)


def needed(plant, wanted):
    """Return the largest drive by which the plant follows, from a rest to a rest."""
    ends = np.full(REST, wanted[0]), np.full(REST, wanted[-1])
    drive, _ = inverse_of(plant).run(np.concatenate([ends[0], wanted, ends[1]]), DT)
    return np.abs(drive).max()


def beyond(drive, u):
    """Whether a drive leaves the range or the rate of a recorded one."""
    room = ROUNDING * np.ptp(u)
    slow = np.abs(np.diff(drive)).max() <= np.abs(np.diff(u)).max() + room
    return not (u.min() - room <= drive.min() and drive.max() <= u.max() + room and slow)


def counted(kind, rng):
    """Return counts, drives over what is needed, errors and which of them were reported."""
    make, model = KINDS[kind]
    plant = make(rng)
    u, y = record(plant, rng)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        limited = InverseCompensator(model).fit(u[:, None], y)
    free = InverseCompensator(limited.model_, drive_limits=None, rate_limit=None)
    free.fit(u[:, None], y)
    rows = []
    for rests in (True, False):
        wanted = reference(rng, np.abs(y).max(), rests)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ReachWarning)
            drive = limited.predict(wanted[:, None])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ReachWarning)
            larger = np.abs(free.predict(wanted[:, None])).max() / needed(plant, wanted)
        left = plant.run(drive, DT, plant.init(drive[0]))[0] - wanted
        error = np.sqrt(np.mean(left**2)) / np.ptp(wanted)
        rows.append((rests, beyond(drive, u), larger, error, bool(caught)))
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    seeds = np.random.SeedSequence(options.seed).spawn(len(KINDS))
    left, large, start = 0, 0, time.perf_counter()
    for (kind, _), seed in zip(KINDS.items(), seeds, strict=True):
        rng = np.random.default_rng(seed)
        rows = [row for _ in range(-(-options.models // len(KINDS))) for row in counted(kind, rng)]
        for wanted in (True, False):
            _, out, larger, error, told = map(
                np.array, zip(*(r for r in rows if r[0] == wanted), strict=True)
            )
            left, large = left + out.sum(), large + np.sum(larger > BAR)
            print(
                f"{kind:20s} {'rests' if wanted else 'moves at once':13s}: {out.sum()} beyond the "
                f"fit; largest drive over what is needed {np.median(larger):.2f}, at most "
                f"{larger.max():.2f}; error {100 * np.median(error):.2f} %, at most "
                f"{100 * error.max():.1f} %; reported {100 * np.mean(told):.0f} %, of the others "
                f"at most {100 * error[~told].max(initial=0.0):.1f} %",
                flush=True,
            )
    for count, what in (
        (left, "beyond the limits of the fit"),
        (large, f"beyond {BAR:g} times what is needed, without limits"),
    ):
        print(f"drives {what}: {count} (0: {'MISSED' if count else 'kept'})")
    print(f"{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
