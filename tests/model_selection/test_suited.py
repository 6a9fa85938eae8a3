"""Which folds suit which records."""

import numpy as np
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.linear import Gain
from skhyst.model_selection import BlockedTimeSeriesSplit, suited_cv
from skhyst.records import record_slices, stack_records

WAVE = np.sin(np.linspace(0.0, 60.0, 400))[:, None]


def suited(*records):
    X = stack_records(list(records))
    return suited_cv(record_slices(X), X)


def test_records_of_like_range_are_held_out_whole():
    assert suited(WAVE) == suited(WAVE, -WAVE, 0.5 * WAVE) == 5


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_of_records_that_go_beyond_each_other_a_part_is_held_out(size):
    for records in ((WAVE, 2.0 * WAVE), (WAVE, WAVE + 0.5, WAVE + 1.0)):
        found = suited(*(size * u for u in records))
        assert isinstance(found, BlockedTimeSeriesSplit)
        assert found.staggered


def test_a_search_extrapolates_less_with_them():
    rng = np.random.default_rng(0)
    X = stack_records([level * WAVE for level in (1.0, 2.0, 4.0)])
    u = np.ravel(X)
    y = u + np.maximum(u, 0.0) ** 2 + 0.01 * rng.standard_normal(len(u))
    found = {
        cv: EffectSearchCV(Gain(), cv=cv, effects=["static_nonlinearity"], random_state=0).fit(X, y)
        for cv in (5, "auto")
    }
    assert found[5].extrapolated_ > 0.05 > found["auto"].extrapolated_
    assert found["auto"].error_after_ < found[5].error_after_
    with pytest.raises(ValueError, match="an int, a splitter or an iterable"):
        EffectSearchCV(Gain(), cv="records").fit(X, y)
