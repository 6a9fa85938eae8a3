"""What a search finds depends neither on the units, nor on the order of records, nor on chance."""

import itertools
import json
from functools import cache

import numpy as np
import pandas as pd
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import SecondOrderMode

LABELS = [4, 0, 5, 2, 1, 3, 6]
SAMPLES = 150  # a record
CLOSE = 1e-6


def made_records(kind):
    """Return records of an undeclared effect: drives (V), responses (m), interval (s)."""
    rng = np.random.default_rng(31)
    dt, records = 0.01, {}
    for label in LABELS:
        n = SAMPLES + 7 * label
        t = dt * np.arange(n)
        w = rng.uniform(2.0, 25.0, 4)
        u = np.sin(np.outer(t, w) + rng.uniform(0.0, 6.0, 4)) @ (8.0 / np.sqrt(w))
        if kind == "lag":
            v = u + 0.5 * play(u, 2.0)
            y, gone = [v[0]], np.exp(-dt / 0.02)
            for a, b in itertools.pairwise(v):
                y.append(gone * y[-1] + (1.0 - gone) * 0.5 * (a + b))
            y = np.array(y)
        else:
            y = softened_mode(u, dt)
        y = 1e-6 * (y + 0.002 * np.ptp(y) * rng.standard_normal(n))
        records[label] = (u, y)
    return records, dt


def play(u, r):
    found, held = [], max(min(0.0, u[0] + r), u[0] - r)
    for v in u:
        held = max(min(held, v + r), v - r)
        found.append(held)
    return np.array(found)


def softened_mode(u, dt, w=30.0, damping=0.2, cubic=0.03, fine=20):
    """Integrate ``x'' + 2 d w x' + w^2 (x + c x^3) = w^2 u`` from rest."""
    x, v, h = u[0], 0.0, dt / fine
    for _ in range(50):
        x -= (x + cubic * x**3 - u[0]) / (1.0 + 3.0 * cubic * x**2)
    found = [x]
    for a, b in itertools.pairwise(u):
        for k in range(fine):
            drive = a + (b - a) * (k + 0.5) / fine
            v += h * (w * w * (drive - x - cubic * x**3) - 2.0 * damping * w * v)
            x += h * v
        found.append(x)
    return np.array(found)


def framed(records, dt, order, *, volts=1.0, meters=1.0, seconds=1.0):
    labels = np.repeat(order, [len(records[i][0]) for i in order])
    times = np.concatenate([seconds * dt * np.arange(len(records[i][0])) for i in order])
    index = pd.MultiIndex.from_arrays([labels, times], names=["record", "time"])
    X = pd.DataFrame({"drive": volts * np.concatenate([records[i][0] for i in order])}, index)
    return X, pd.Series(meters * np.concatenate([records[i][1] for i in order]), index)


@cache
def search(kind, order=tuple(LABELS), **units):
    records, dt = made_records(kind)
    X, y = framed(records, dt, list(order), **units)
    return searching(kind).fit(X, y)


def searching(kind):
    if kind == "lag":
        declared, effects = PrandtlIshlinskii(6), "all"
    else:
        declared, effects = SecondOrderMode(), ["cubic_stiffness", "lag", "delay", "offset"]
    return EffectSearchCV(declared, effects=effects, max_effects=1, cv=3, random_state=0)


def assert_same(other, first, meters=1.0):
    assert other.effects_ == first.effects_
    assert other.dropped_ == first.dropped_
    assert other.verdict_ == first.verdict_
    assert list(other.history_["ambiguous_with"]) == list(first.history_["ambiguous_with"])
    for name in ("error_before_", "error_after_", "noise_floor_"):
        assert getattr(other, name) == pytest.approx(meters * getattr(first, name), rel=CLOSE)
    tables = [s.ranking_.set_index(["round", "effect"]).sort_index() for s in (other, first)]
    assert list(tables[0].index) == list(tables[1].index)
    for column, unit in (("error_before", meters), ("error_after", meters)):
        a, b = tables[0][column], unit * tables[1][column]
        np.testing.assert_allclose(a, b, rtol=100 * CLOSE, err_msg=column)


KINDS = ["lag", "cubic_stiffness"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_effect_is_found(kind):
    found = search(kind)
    assert found.effects_[:1] == [kind]
    assert found.error_after_ < 0.5 * found.error_before_


@pytest.mark.parametrize("kind", KINDS)
def test_units_change_no_name_and_no_relative_error(kind):
    other = search(kind, volts=1e3, meters=1e6, seconds=1e3)
    assert_same(other, search(kind), meters=1e6)


@pytest.mark.parametrize("kind", KINDS)
def test_the_order_of_records_changes_nothing(kind):
    order = tuple(np.random.default_rng(5).permutation(LABELS).tolist())
    other, first = search(kind, order), search(kind)
    assert_same(other, first)
    labels = [s.label for s in other.records_]
    for s in first.records_:
        own = other.records_[labels.index(s.label)]
        scale = first.error_after_
        np.testing.assert_allclose(
            other.residual_after_[own.rows], first.residual_after_[s.rows], atol=1e-4 * scale
        )


def without_times(value):
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if "seconds" not in k}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def test_the_same_seed_gives_the_same_report():
    first = search("lag")
    records, dt = made_records("lag")
    again = searching("lag").fit(*framed(records, dt, LABELS))
    reports = [json.loads(s.report().to_json()) for s in (first, again)]
    assert without_times(reports[0]) == without_times(reports[1])
