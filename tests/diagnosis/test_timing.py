"""What belongs to the instruments: clocks that differ, apart from a delay of the device."""

import numpy as np
import pandas as pd

from skhyst.diagnosis import EffectSearchCV
from skhyst.linear import FirstOrderLag

DT, N, FINE, NOISE, SKEW = 0.01, 800, 20, 2e-3, 8e-4


def recording(delay, skew, seed=0):
    """Step a lag on a fine grid; read it by a clock of its own."""
    Xs, ys = {}, {}
    for i in range(4):
        rng = np.random.default_rng([seed, i])
        time = np.arange(N * FINE + FINE) * DT / FINE
        u = sum(np.sin(rng.uniform(3.0, 40.0) * time + rng.uniform(0, 6)) for _ in range(5))
        u = np.interp(time, time[::FINE], u[::FINE])
        x, y = u[0], np.empty_like(u)
        for k, value in enumerate(u):
            x += (value - x) * DT / FINE / 0.05
            y[k] = x
        when = np.arange(N) * DT
        read = np.interp(when * (1.0 - skew) - delay, time, y)
        index = pd.Index(when, name="time")
        Xs[i] = pd.DataFrame({"u": u[: N * FINE : FINE]}, index)
        ys[i] = pd.Series(read + NOISE * rng.normal(size=N), index)
    return tuple(pd.concat(own, names=["record"]) for own in (Xs, ys))


def test_clocks_that_differ_are_told_with_their_skew():
    X, y = recording(0.0, SKEW)
    found = EffectSearchCV(FirstOrderLag(), random_state=0).fit(X, y)
    assert found.effects_ == ["timing"]
    skew, _, _ = found.evidence_["timing"].numbers["skew"]
    assert abs(skew - SKEW) < 0.05 * SKEW
    assert found.error_after_ < 1.1 * NOISE


def test_timing_does_not_take_over_the_delay_of_the_device():
    X, y = recording(0.043, SKEW)
    effects = ["delay", "timing", "drift", "resonance"]
    found = EffectSearchCV(FirstOrderLag(), effects=effects, random_state=0).fit(X, y)
    assert set(found.effects_) == {"delay", "timing"}
