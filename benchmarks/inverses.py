"""Undo every operator, and cascades near their resonance: `python benchmarks/inverses.py`.

Each operator answers a drive that begins and ends at rest and covers the range of its hysteresis or
curve. Its inverse finds a drive for that response, over the whole record and, where it can be
stepped, sample by sample from a preview. The figure is the largest error of the operator's response
to the drive that was found, over the range of the response. Cascades follow a sine at 0.7 of their
resonance.

What misses its bar: rate-dependent plays whose weights change, where motion turns. The rate has a
corner there, and so has the response as a function of the drive: near by there may be no drive for
a value. Sticking that the sampling interval does not resolve: a drive below the force of friction
moves nothing, and a mass that sticks within one interval answers drives with jumps.
"""

import sys
from pathlib import Path

import numpy as np

from skhyst.hysteresis import (
    BoucWenStageOperator,
    FrictionStageOperator,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import DelayOperator, KelvinVoigtOperator, SecondOrderModeOperator
from skhyst.operators import (
    InverseOperator,
    Series,
    Stepper,
    inverse_of,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "operators"))
from operator_cases import OPERATORS

ANALYTIC, ITERATIVE, CASCADE = 1e-12, 1e-8, 1e-4  # bars, of the range
STREAMED = 1e-9  # part of what comes later that a preview leaves out
DT, N = 1e-3, 1200  # s; samples
TIME = DT * np.arange(N)
LEVEL, SIZE = 0.1, 0.65  # of the drive, which covers what operators of the tests remember
RAMP = np.linspace(LEVEL - SIZE, LEVEL + SIZE, N)
FREQUENCY = 50.0  # Hz, of the cascades' mode
PLAYS = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.4, 0.3, 0.2]), 0.1, 0.05)
MODE = SecondOrderModeOperator(2.0 * np.pi * FREQUENCY, 0.03)
CREEP = KelvinVoigtOperator(np.array([0.1, 0.05]), np.array([0.02, 0.3]))
STAGES = 2.0 * np.pi * FREQUENCY, 0.1, 0.5
CASCADES = {
    "plays, mode": Series(("plays", "mode"), (PLAYS, MODE)),
    "mode, plays": Series(("mode", "plays"), (MODE, PLAYS)),
    "plays, mode, creep, delay": Series(
        ("plays", "mode", "creep", "delay"), (PLAYS, MODE, CREEP, DelayOperator(1.3e-3))
    ),
    "motion with Bouc-Wen hysteresis": BoucWenStageOperator(*STAGES, 1.0, 0.0, 1.5, gain=2.0),
    "motion with LuGre friction": FrictionStageOperator(*STAGES, 0.8, 30.0, 20.0, gain=2.0),
}


def window():
    """Return what rises from 0 to 1 and falls again, twice differentiable, (n_samples,)."""
    inside = np.clip(np.minimum(TIME - 0.1, 1.1 - TIME) / 0.2, 0.0, 1.0)
    return inside**3 * (10.0 - 15.0 * inside + 6.0 * inside**2)


def error(operator, drive, wanted):
    """Return the largest error of the response to a drive, over the range."""
    y, _ = operator.run(drive, DT, operator.init(drive[0]))
    return np.abs(y - wanted).max() / (np.ptp(wanted) or 1.0)


def formatted(value, bar):
    """Format an error and its limit."""
    return f"{value:8.1e} (at most {bar:.0e}: {'kept' if value <= bar else 'MISSED'})"


def line(name, operator, wanted, bar=None):
    """Print what the inverse reaches over the record and sample by sample."""
    try:
        inverse = inverse_of(operator)
        drive, _ = inverse.run(wanted, DT)
    except ValueError as reason:
        print(f"{name:45s} {reason}")
        return
    turns = np.ptp(np.sign(np.diff(operator.run(RAMP, DT)[0]))) == 2.0
    if isinstance(operator.init(0.0), tuple) and not operator.init(0.0) and turns:  # no memory
        print(f"{name:45s} is not monotone")
        return
    closed = inverse.signal_linear or not isinstance(inverse, InverseOperator)
    bar = bar or (ANALYTIC if closed else ITERATIVE)
    text = f"{name:45s} {formatted(error(operator, drive, wanted), bar)}"
    try:
        compiled_step, ahead = inverse.ahead(DT, wanted[0], min(bar, STREAMED))
    except NotImplementedError:
        print(f"{text}; not stepped", flush=True)
        return
    steps = Stepper(compiled_step).run(np.append(wanted, np.full(ahead, wanted[-1])))[ahead:]
    print(f"{text}; {ahead:4d} samples ahead {error(operator, steps, wanted):8.1e}", flush=True)


def main():
    both = 0.6 * np.sin(2.0 * np.pi * 3.0 * TIME) + 0.4 * np.sin(2.0 * np.pi * 7.3 * TIME)
    drive = LEVEL + SIZE * window() * both
    for name, operator in OPERATORS.items():
        if operator.is_disturbance:
            continue
        response, _ = operator.run(drive, DT, operator.init(drive[0]))
        line(name, operator, response)
    wanted = 4.0 * window() * np.sin(2.0 * np.pi * 0.7 * FREQUENCY * TIME)
    for name, operator in CASCADES.items():
        line(f"at 0.7 of the resonance: {name}", operator, wanted, CASCADE)


if __name__ == "__main__":
    main()
