"""What a search finds depends neither on the units, nor on the order of records, nor on threads."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from plants import make_recording

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import SecondOrderMode

CLOSE = 1e-6
FEW = ["cubic_stiffness", "lag", "delay", "offset", "output_saturation"]
KINDS = {  # the effect that is not declared: declared model, effects tried
    "lag": ("prandtl_ishlinskii", PrandtlIshlinskii(6), FEW),
    "output_saturation": ("prandtl_ishlinskii", PrandtlIshlinskii(6), FEW),
    "cubic_stiffness": ("second_order", SecondOrderMode(), FEW),
}

SOME = [
    pytest.param(kind, marks=() if kind == "output_saturation" else pytest.mark.slow)
    for kind in KINDS
]


@cache
def recording(kind):
    """Return the drive and the response of records of different lengths."""
    made = make_recording(kind, KINDS[kind][0], 31, n_samples=1000)
    label = made.X_train.index.get_level_values("record")
    kept = made.X_train.groupby(level="record").cumcount() < 200 - 7 * label
    return made.X_train[kept], made.y_train[kept]


@cache
def found(kind):
    return search(kind, *recording(kind))


def search(kind, X, y, **options):
    _, declared, effects = KINDS[kind]
    options = {"effects": effects, "max_effects": 1, "cv": 3, "random_state": 0} | options
    return EffectSearchCV(declared, **options).fit(X, y)


def assert_same(other, first, unit=1.0):
    for name in ("effects_", "dropped_", "verdict_"):
        assert getattr(other, name) == getattr(first, name)
    assert list(other.history_["ambiguous_with"]) == list(first.history_["ambiguous_with"])
    for name in ("error_before_", "error_after_", "noise_floor_"):
        assert getattr(other, name) == pytest.approx(unit * getattr(first, name), rel=CLOSE)
    own, table = (s.ranking_.set_index(["round", "effect"]).sort_index() for s in (other, first))
    assert list(own.index) == list(table.index)
    for column in ("error_before", "error_after"):
        np.testing.assert_allclose(own[column], unit * table[column], rtol=100 * CLOSE)
    np.testing.assert_allclose(own["screen"], table["screen"], atol=100 * CLOSE)
    # of a tail the exponent is as exact as the law of the noise
    logarithms = [np.log(np.maximum(t["p_value"], np.finfo(float).tiny)) for t in (own, table)]
    np.testing.assert_allclose(*logarithms, rtol=1e-3, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SOME)
def test_the_effect_is_found(kind):
    assert found(kind).effects_[:1] == [kind]
    assert found(kind).error_after_ < 0.5 * found(kind).error_before_


@pytest.mark.parametrize("kind", SOME)
def test_units_and_the_order_of_records_change_no_name_and_no_relative_error(kind):
    """Both at once: what changes with one of them changes with both."""
    first, unit = found(kind), 1e-6
    X, y = (pd.concat([own.loc[[k]] for k in (3, 0, 4, 2, 1)]) for own in recording(kind))
    X.index = y.index = X.index.set_levels(X.index.levels[1] * 1e3, level="time")
    other = search(kind, 1e3 * X, unit * y)
    assert_same(other, first, unit)
    pairs = zip(*(sorted(s.records_, key=lambda r: r.label) for s in (other, first)), strict=True)
    for own, s in pairs:
        residuals = other.residual_after_[own.rows] / unit, first.residual_after_[s.rows]
        np.testing.assert_allclose(*residuals, atol=1e-4 * first.error_after_)


@pytest.mark.slow
def test_processes_and_repetition_change_nothing_and_data_are_left_as_they_were():
    X, y = (signal.copy() for signal in recording("output_saturation"))
    first, other = found("output_saturation"), search("output_saturation", X, y, n_jobs=2)
    pd.testing.assert_frame_equal(other.ranking_, first.ranking_)
    assert other.noise_floor_ == first.noise_floor_
    np.testing.assert_array_equal(other.residual_after_, first.residual_after_)
    pd.testing.assert_frame_equal(X, recording("output_saturation")[0])
    pd.testing.assert_series_equal(y, recording("output_saturation")[1])


def test_a_shift_of_the_response_is_the_declared_models_intercept():
    X, y = recording("lag")
    other = search("lag", X, y + 3.0 * np.ptp(y), effects=["lag", "offset"])
    assert other.effects_ == found("lag").effects_
    assert other.error_after_ == pytest.approx(found("lag").error_after_, rel=1e-3)
