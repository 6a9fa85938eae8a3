"""Records that are sampled at different intervals, in one search."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV
from skhyst.disturbance import PeriodicDisturbance
from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag
from skhyst.model_selection import BlockedTimeSeriesSplit
from skhyst.neural import GrayBoxHysteresis
from skhyst.preprocessing import LaggedFeatures, PlayOperators
from skhyst.records import stack_records

FINE, DT, N = 2.5e-4, 0.005, 3000  # of the integration, of the sampling, samples of the shortest
OMEGA, ZETA, TAU, NOISE = 40.0, 0.1, 0.05, 4e-3
THRESHOLDS = [0.0, 0.3, 0.7]


def plant(u, kind):
    """Integrate plays, and what follows them, on a fine grid by Heun's method."""
    v = np.zeros_like(u)
    for r, weight in zip(THRESHOLDS, (0.5, 0.3, 0.2), strict=True):
        z = 0.0
        for k, value in enumerate(u.tolist()):
            z = min(max(z, value - r), value + r)
            v[k] += weight * z
    if kind == "nothing":
        return v
    x, w = v[0], 0.0
    y = np.empty_like(v)
    for k, value in enumerate(v.tolist()):
        if kind == "lag":
            slope = (value - x) / TAU
            x += 0.5 * FINE * (slope + (value - x - FINE * slope) / TAU)
        else:
            force = OMEGA**2 * (value - x) - 2.0 * ZETA * OMEGA * w
            other = OMEGA**2 * (value - x - FINE * w) - 2.0 * ZETA * OMEGA * (w + FINE * force)
            x, w = x + FINE * (w + 0.5 * FINE * force), w + 0.5 * FINE * (force + other)
        y[k] = x
    return y


@cache
def recording(kind, every, seed=0):
    """Return records of one plant, of which every 1st, 2nd, ... sample is read."""
    pairs, rng = [], np.random.default_rng(seed)
    ratio = round(DT / FINE)
    for step in every:
        time = FINE * np.arange(N * ratio // 4)
        u = sum(np.sin(rng.uniform(2, 25) * time + rng.uniform(0, 6)) for _ in range(5))
        u = u * np.minimum(2.0 * time, 1.0)
        rows = slice(0, None, step * ratio)
        y = plant(u, kind)[rows]
        index = pd.Index(time[rows], name="time")
        y = y + NOISE * rng.normal(size=len(y))
        pairs.append((pd.DataFrame({"drive": u[rows]}, index), pd.Series(y, index)))
    return stack_records(pairs)


MIXED = (1, 2, 1, 2, 2)
EFFECTS = ["lag", "resonance", "delay", "timing"]


def search(kind, every, **options):
    options = {"effects": EFFECTS, "cv": 2, "random_state": 0} | options
    return EffectSearchCV(PrandtlIshlinskii(thresholds=THRESHOLDS), **options).fit(
        *recording(kind, every)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "truth", "options"),
    [
        (
            "resonance",
            {"natural frequency": (OMEGA / (2 * np.pi), "Hz"), "damping ratio": (ZETA, "")},
            {},
        ),
        (
            "lag",
            {"time constant": (TAU, "s")},
            {  # a splitter cuts records of both intervals
                "cv": BlockedTimeSeriesSplit(3, staggered=True),
                "effects": ["lag", "delay", "offset"],
            },
        ),
    ],
)
def test_the_effect_and_its_numbers_are_those_of_the_plant(kind, truth, options):
    mixed = search(kind, MIXED, **options)
    assert mixed.effects_ == [kind]
    assert sorted({record.dt for record in mixed.records_}) == [DT, 2 * DT]
    for name, (value, unit) in truth.items():
        number, std, own = mixed.evidence_[kind].numbers[name]
        assert own == unit
        assert abs(number - value) < max(4.0 * std, 0.02 * value)
    assert mixed.error_after_ == pytest.approx(NOISE, rel=0.15)
    assert mixed.verdict_ == "noise"
    X, y = recording(kind, MIXED, seed=1)
    assert NOISE < mixed.held_out_error(X, y) < 1.5 * NOISE
    assert mixed.predict(X).shape == (len(X),)
    data = mixed.report().to_dict()
    assert [row["interval"] for row in data["data"]["records"]] == [step * DT for step in MIXED]
    assert set(data["spectra"]["interval"]) == {DT, 2 * DT}
    # white noise: per root Hz, that of twice the interval is larger by the root of two
    level = {
        dt: np.median([a for a, own in zip(*rows, strict=True) if own == dt])
        for rows in [(data["spectra"]["after"], data["spectra"]["interval"])]
        for dt in (DT, 2 * DT)
    }
    assert level[2 * DT] / level[DT] == pytest.approx(np.sqrt(2.0), rel=0.2)
    assert f"one every {DT:.5f} s and {2 * DT:.4f} s" in mixed.report().to_markdown()
    assert "<svg" in mixed.report().to_html()


@pytest.mark.slow
def test_where_nothing_is_missing_nothing_is_claimed():
    found = search("nothing", MIXED, effects="all")
    assert found.effects_ == []
    assert found.verdict_ == "noise"


def test_a_line_is_found_whatever_record_comes_first():
    rng, line = np.random.default_rng(0), 17.3
    for every in (MIXED, MIXED[::-1]):
        pairs = []
        for step in every:
            time = step * DT * np.arange(N // step // 4)
            y = np.sin(2 * np.pi * line * time + rng.uniform(0, 6)) + 0.1 * rng.normal(
                size=len(time)
            )
            index = pd.Index(time, name="time")
            pairs.append((pd.DataFrame({"drive": 0.0 * time}, index), pd.Series(y, index)))
        model = PeriodicDisturbance().fit(*stack_records(pairs))
        found = model.operator_.stages[1].frequencies[0]
        assert found == pytest.approx(line, abs=0.01)


@pytest.mark.parametrize(
    "model",
    [
        GrayBoxHysteresis(),
        Cascade([("gray_box", GrayBoxHysteresis()), ("lag", FirstOrderLag())]),
        NARXRegressor(Ridge()),
        make_pipeline(LaggedFeatures(3), Ridge()),
    ],
    ids=["gray box", "in a cascade", "autoregressive", "lags in a pipeline"],
)
def test_a_declared_model_that_counts_samples_is_refused(model):
    X, y = recording("nothing", MIXED[:2])
    with pytest.raises(RecordError, match="same sampling interval"):
        EffectSearchCV(model, effects=["lag"]).fit(X, y)
    with pytest.raises(RecordError, match="same sampling interval"):
        model.fit(X, y)


@pytest.mark.slow
def test_a_regressor_without_time_is_a_black_box_as_ever():
    X, y = recording("lag", MIXED)
    model = make_pipeline(PlayOperators(thresholds=THRESHOLDS), Ridge())
    found = EffectSearchCV(model, effects=["lag", "delay"], cv=2, random_state=0).fit(X, y)
    assert found.effects_ == ["lag"]
    assert found.predict(X).shape == y.shape
