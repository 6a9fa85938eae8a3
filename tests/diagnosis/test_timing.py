"""What belongs to the instruments: clocks that differ, apart from a delay of the device."""

import numpy as np
import pandas as pd
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag

DT, N, FINE, NOISE, SKEW = 0.01, 800, 20, 2e-3, 8e-4
THRESHOLDS, WEIGHTS = [0.0, 0.5, 1.2], [1.0, 0.5, 0.4]


def recording(delay, skew, seed=0):
    """Step a lag on a fine grid; read it by a clock of its own."""
    Xs, ys = {}, {}
    for i in range(3):
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


@pytest.mark.slow
def test_clocks_that_differ_are_told_with_their_skew():
    X, y = recording(0.0, SKEW)
    effects = ["timing", "delay", "drift", "resonance"]
    found = EffectSearchCV(FirstOrderLag(), effects=effects, cv=2, random_state=0).fit(X, y)
    assert found.effects_ == ["timing"]
    skew, _, _ = found.evidence_["timing"].numbers["skew"]
    assert abs(skew - SKEW) < 0.05 * SKEW
    assert found.error_after_ < 1.1 * NOISE


@pytest.mark.slow
def test_timing_does_not_take_over_the_delay_of_the_device():
    X, y = recording(0.043, SKEW)
    effects = ["delay", "timing", "drift", "resonance"]
    found = EffectSearchCV(FirstOrderLag(), effects=effects, cv=2, random_state=0).fit(X, y)
    assert set(found.effects_) == {"delay", "timing"}


@pytest.mark.slow
def test_a_response_that_is_early_makes_no_lag_of_its_corners():
    """A hysteresis under a drive that is straight from sample to sample turns at the samples."""
    X, _ = recording(0.0, 0.0)
    ys = []
    for i, u in X["u"].groupby(level="record"):
        fine = np.interp(np.arange(N * FINE) / FINE, np.arange(N), u.to_numpy())
        y = np.zeros(len(fine))
        for threshold, weight in zip(THRESHOLDS, WEIGHTS, strict=True):
            play = 0.0
            for k, value in enumerate(fine.tolist()):
                play = min(max(play, value - threshold), value + threshold)
                y[k] += weight * play
        early = y[np.minimum(np.arange(N) * FINE + 9, len(y) - 1)]
        noise = 0.1 * NOISE * np.random.default_rng([7, i]).normal(size=N)
        ys.append(pd.Series(early + noise, u.index))
    effects = ["timing", "lag", "creep", "resonance", "rate_dependence"]
    declared = PrandtlIshlinskii(thresholds=THRESHOLDS)
    found, alone = (
        EffectSearchCV(declared, effects=names, cv=2, random_state=0).fit(X, pd.concat(ys))
        for names in (effects, ["timing"])
    )
    # the corners are no effect of the list: others may stand in for them, provisionally
    assert found.effects_[0] == "timing"
    assert not {"lag", "creep", "resonance"} & set(found.effects_)
    assert found.history_["provisional"].all()
    # plays that begin to move between two samples are no straight line there
    assert alone.evidence_["timing"].numbers["shift"][0] == pytest.approx(-0.45 * DT, rel=0.05)
