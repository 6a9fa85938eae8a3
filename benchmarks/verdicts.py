"""Count the verdicts on residuals of known origin: noise, or noise and structure of known size.

    python benchmarks/verdicts.py [--runs 6] [--first 100000] [--periods 2 8]

A plant is a curve of its drive. Declared is that curve with a gain and a constant, fitted to the
response, so that nothing but noise is left, or one thing that is missing: creep, a play, heat,
ageing, a curve, a gain that steps, an input that was not recorded. What the fit leaves of it is 1.5
to 30 times the noise, log-uniform; drives are multisines, triangles of several heights, filtered
noise and staircases, of 2 to 8 periods; ``--periods 8 80`` are drives that are fast for the noise.
The verdict is `skhyst.diagnosis`'s, before any search.
Seeds from 0 on were for settling its figures, those from 100,000 on are for what is reported.
"""

import argparse
import time
from collections import Counter

import numpy as np
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

from skhyst.diagnosis._criterion import Criterion
from skhyst.diagnosis._verdict import judge_residual
from skhyst.hysteresis import BacklashOperator
from skhyst.optimize import RecordData

N = 1500
PERIODS = 2.0, 8.0
CRITERION = Criterion(alpha=0.01, min_improvement=0.05)


def drive(rng, periods=PERIODS):
    """Draw a drive between about -1 and 1, of a number of periods between two."""
    periods, t = rng.uniform(*periods), np.arange(N) / N
    kind = rng.integers(4)
    if kind == 0:
        parts = [np.sin(2 * np.pi * (periods * k * t + rng.random())) / k for k in (1, 1.618, 2.3)]
        return sum(parts) / 2.0
    if kind == 1:
        turns = np.resize([1.0, -1.0], int(2 * periods) + 2) * rng.uniform(0.3, 1.0)
        turns *= rng.uniform(0.4, 1.0, len(turns))
        return np.interp(2 * periods * t, np.arange(len(turns)), turns)
    if kind == 2:
        width = int(N / periods / 2)
        found = np.convolve(rng.standard_normal(N + width), np.hanning(width + 1), mode="valid")
        return found / np.abs(found).max()
    return np.repeat(rng.uniform(-1.0, 1.0, int(4 * periods)), -(-N // int(4 * periods)))[:N]


def noise(law, rng):
    """Draw noise of unit variance."""
    white = rng.standard_normal(3 * N)
    if law == "white":
        return white[:N]
    if law == "1/f":
        power = np.append(0.0, np.arange(1.0, 1.5 * N + 1.0) ** -0.5)
        found = np.fft.irfft(np.fft.rfft(white) * power)[:N]
        return found / found.std()
    a = float(law.split()[-1])
    return lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], white)[-N:]


def missing(kind, u, rng, periods):
    """Return what the declared model lacks, of any size."""
    n = np.arange(N)
    if kind == "creep":
        poles = np.exp(-1.0 / (N * np.array([0.01, 0.04, 0.2]) * rng.uniform(0.5, 2.0)))
        return sum(lfilter([1.0 - a], [1.0, -a], u - u[0]) for a in poles) + 0.0 * n
    if kind == "play":
        return BacklashOperator(rng.uniform(0.1, 0.4)).run(u, 1.0)[0]
    if kind == "heat":
        a = np.exp(-1.0 / (N * rng.uniform(0.05, 0.3)))
        return lfilter([1.0 - a], [1.0, -a], u**2) * rng.choice([1.0, -1.0])
    if kind == "ageing":
        return u * np.expm1(-n / N * rng.uniform(0.3, 3.0))
    if kind == "curve":
        return u ** rng.integers(2, 4) + 0.3 * np.tanh(4.0 * u)
    if kind == "gain step":
        return u * (n > N * rng.uniform(0.3, 0.7))
    if kind == "hidden input":
        return np.sin(2 * np.pi * (rng.uniform(1.5, 12.0) * n / N + rng.random()))
    return drive(rng, periods)  # a hidden drive


NULLS = ("white", "AR 0.5", "AR 0.9", "1/f")
KINDS = ("creep", "play", "heat", "ageing", "curve", "gain step", "hidden input", "hidden drive")


def judged(name, seed, periods=PERIODS):
    """Return the judgement of a run, and the true noise."""
    rng = np.random.default_rng([seed, (*NULLS, *KINDS).index(name)])
    u = drive(rng, periods)
    size, plant = 10.0 ** rng.uniform(-3.0, -1.0), u + 0.3 * np.tanh(2.0 * u)
    columns = np.stack([plant, np.ones(N)], axis=1)

    def left(y):
        return y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]

    own = size * noise(name if name in NULLS else "white", rng)
    y = plant + own
    if name in KINDS:
        lacking = left(missing(name, u, rng, periods))
        y = y + lacking / lacking.std() * size * np.exp(rng.uniform(np.log(1.5), np.log(30.0)))
    r = left(y)
    found = judge_residual([RecordData(u, y, 1.0)], [r], [y - r], rng, CRITERION)
    return found, own.std()


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=6, help="of each kind")
    parser.add_argument("--first", type=int, default=100_000, help="seed")
    parser.add_argument("--periods", type=float, nargs=2, default=PERIODS, help="of a drive")
    parser.add_argument("--only", nargs="*", default=[*NULLS, *KINDS])
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    begin = time.process_time()
    print(f"{'left is':14s} noise  unexplained  undetermined  floor/true  ceiling/true  between")
    with threadpool_limits(limits=1):
        for name in options.only:
            runs = [judged(name, options.first + k, options.periods) for k in range(options.runs)]
            count = Counter(found.verdict for found, _ in runs)
            floor = np.array([found.floor / true for found, true in runs])
            ceiling = np.array([found.ceiling / true for found, true in runs])
            between = np.mean((floor <= 1.05) & (ceiling >= 0.95))  # of what the fit takes
            shares = [count[v] / len(runs) for v in ("noise", "unexplained", "undetermined")]
            print(
                f"{name:14s} {shares[0]:5.2f}  {shares[1]:11.2f}  {shares[2]:12.2f}  "
                f"{np.median(floor):10.2f}  {np.median(ceiling):12.2f}  {between:7.2f}"
            )
            if options.verbose:
                for k, (f, true) in enumerate(runs):
                    print(
                        "   ",
                        k,
                        f.verdict,
                        f"{f.floor / true:.2f} {f.ceiling / true:.2f}",
                        f"p {f.p_value:.2g} share {f.share:.2f}",
                        f.reason,
                    )
    print(f"{time.process_time() - begin:.0f} s of CPU")


if __name__ == "__main__":
    main()
