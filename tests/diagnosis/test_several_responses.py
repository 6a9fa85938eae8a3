"""Several responses to one drive: each is searched, and what they share is reported."""

import numpy as np
import pandas as pd
import pytest

from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._outputs import shared_claims
from skhyst.linear import Gain, SecondOrderModeOperator

DT, N = 0.005, 500


def recording():
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=N)) / 5
    mode, _ = SecondOrderModeOperator(60.0, 0.1).run(u, DT)
    index = pd.Index(DT * np.arange(N), name="time")
    noise = 0.02 * rng.normal(size=(N, 2))
    responses = np.column_stack([mode, -2.0 * mode]) + noise
    return pd.DataFrame({"u": u}, index), pd.DataFrame(responses, index, columns=["front", "rear"])


def test_each_response_is_searched_and_they_share_the_mode():
    X, Y = recording()
    options = {"effects": ["resonance"], "cv": 2, "max_effects": 1, "random_state": 0}
    search = EffectSearchCV(Gain(), **options).fit(X, Y)
    assert list(search.searches_) == ["front", "rear"]
    assert search.effects_ == search.searches_["rear"].effects_ == ["resonance"]
    row = search.shared_.set_index("number").loc["natural frequency"]
    assert row["responses"] == ["front", "rear"]
    assert row["value"] == pytest.approx(60.0 / (2.0 * np.pi), rel=0.01)
    assert row["p_value"] > 0.01
    np.testing.assert_array_equal(search.predict(X)[:, 1], search.searches_["rear"].predict(X))
    _, std = search.predict(X, return_std=True)
    own = search.searches_["rear"].predict(X, return_std=True)[1]
    np.testing.assert_array_equal(std[:, 1], own)
    assert search.score(X, Y) > 0.98
    with pytest.raises(ValueError, match="report each: take that of one of 'searches_'"):
        search.report()


class Found:
    def __init__(self, *numbers):
        names = dict(zip(("frequency", "level"), numbers, strict=False))
        self.effects_, self.evidence_ = ["resonance"], {"resonance": self}
        self.numbers = {name: (*value, "Hz") for name, value in names.items()}


def test_numbers_that_differ_are_not_one():
    found = {"a": Found((10.0, 0.1), (1.0, 0.1)), "b": Found((10.1, 0.1), (2.0, 0.1))}
    shared = shared_claims(found).set_index("number")
    assert shared.loc["frequency", "value"] == pytest.approx(10.05)
    assert shared.loc["frequency", "std"] == pytest.approx(0.1 / np.sqrt(2.0))
    assert shared.loc["frequency", "p_value"] == pytest.approx(0.4795, abs=1e-4)
    assert shared.loc["level", "p_value"] < 1e-6
