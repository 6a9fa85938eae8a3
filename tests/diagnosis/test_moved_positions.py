"""Terms that a search has moved count as found, and those that the data do not ask for go."""

import numpy as np
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.linear import Gain
from skhyst.static import SmoothCurve


@pytest.fixture(scope="module")
def recording():
    """One play of 0.22 behind a gain of 1.8, read with white noise."""
    t = np.arange(400)
    u = np.sin(2 * np.pi * t / 57) * (0.4 + 0.6 * t / 400)
    y = PrandtlIshlinskiiOperator([0.11], [1.8]).run(u, 1.0)[0]
    return u[:, None], y + 0.01 * np.random.default_rng(0).standard_normal(len(u))


def test_a_single_play_is_named_backlash(recording):
    search = EffectSearchCV(Gain(), effects=["backlash", "hysteresis"]).fit(*recording)
    assert search.effects_ == ["backlash"]
    assert search.history_.ambiguous_with[0] == ("hysteresis",)


def test_the_error_of_a_loop_counts_its_moved_threshold(recording):
    search = EffectSearchCV(Gain(), effects=["hysteresis"]).fit(*recording)
    numbers = search.evidence_["hysteresis"].numbers
    gap, error, unit = numbers["threshold"]
    assert abs(gap - 0.11) < 3.0 * error
    assert unit == "drive"
    # a loop of one play is as wide as twice its threshold
    width, error_of_width, _ = numbers["loop width over the range"]
    np.testing.assert_allclose(error_of_width / width, error / gap, rtol=0.3)


def test_of_a_curve_whose_terms_are_all_needless_few_are_left():
    """One is left at least: that none predicts best had kept all of them."""
    rng = np.random.default_rng(2)
    phases, time = rng.uniform(0.0, 6.0, 3), np.linspace(0.0, 2.0 * np.pi, 258, endpoint=False)
    u = sum(np.sin(f * time + p) for f, p in zip((3, 7, 12), phases, strict=True))
    y = u + 0.05 * rng.standard_normal(len(u))
    search = EffectSearchCV(SmoothCurve(30), effects=["offset"]).fit(u[:, None], y)
    assert search.error_before_ > 1.0
    assert search.error_after_ < 1.05 * 0.05
    assert 0.9 * 0.05 < search.noise_floor_ < 1.1 * 0.05
