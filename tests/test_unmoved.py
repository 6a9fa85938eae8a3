"""Recordings that a model cannot have learned from are told for what they are."""

import numpy as np
import pandas as pd
import pytest

from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import Backlash, PrandtlIshlinskii, Preisach
from skhyst.linear import Delay, FirstOrderLag, Gain, TimeShift, TransferFunction
from skhyst.records import data_quality, record_slices
from skhyst.static import SmoothCurve

N = 200
RISE = 1.0 - np.exp(-np.arange(N) / 20.0)
WAVE = 2.0 * np.sin(np.arange(N) / 15.0)
NOISE = 0.01 * np.random.default_rng(0).normal(size=N)
MODELS = [
    Backlash(),
    Cascade([("plays", PrandtlIshlinskii()), ("lag", FirstOrderLag())]),
    FirstOrderLag(),
    PrandtlIshlinskii(),
    Preisach(),
    SmoothCurve(),
]


def name_of(model):
    return type(model).__name__


@pytest.mark.parametrize("model", MODELS, ids=name_of)
@pytest.mark.filterwarnings("ignore:The data do not determine", "ignore:No weight of")
def test_a_drive_that_does_not_move_is_said_to_be_so(model):
    with pytest.warns(ConvergenceWarning, match="The drive does not move: it is 2 in every sample"):
        model.fit(np.full((N, 1), 2.0), RISE + NOISE)


def test_a_step_at_the_first_sample_moves():
    """Said to start from zero, it gives what the step response gives (warnings are errors)."""
    model = TransferFunction(1, initial_state="zero").fit(np.ones((N, 1)), 10.0 * RISE)
    assert model.params_["gain"] == pytest.approx(10.0)
    assert model.params_["time_constants[0]"] == pytest.approx(20.0)
    assert model.params_["intercept"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("model", [Backlash(), SmoothCurve()], ids=name_of)
@pytest.mark.filterwarnings("ignore:The data do not determine")
def test_what_cannot_fall_asks_for_the_other_sign(model):
    with pytest.warns(ConvergenceWarning, match="turn the sign"):
        model.fit(WAVE[:, None], NOISE - WAVE)


@pytest.mark.parametrize("model", [Backlash(), Delay(), SmoothCurve(), TimeShift()], ids=name_of)
@pytest.mark.parametrize(("gain", "constant"), [(1e6, 0.0), (1.0, 1e3), (1e-3, 0.0)])
@pytest.mark.filterwarnings("ignore:The data do not determine", "ignore:The fit of")
def test_what_has_no_gain_or_constant_asks_for_one(model, gain, constant):
    """A `Gain` has both; with it nothing warns, which would be an error."""
    y = gain * (NOISE + WAVE) + constant
    with pytest.warns(ConvergenceWarning, match="add a Gain to it"):
        model.fit(WAVE[:, None], y)
    whole = Cascade([("gain", Gain()), ("model", model)]).fit(WAVE[:, None], y)
    assert whole.fit_error_ == pytest.approx(gain * NOISE.std(), rel=0.1)


@pytest.mark.parametrize("model", [Preisach(), FirstOrderLag()], ids=name_of)
def test_what_can_fall_does(model):
    assert model.fit(WAVE[:, None], NOISE - WAVE).score(WAVE[:, None], NOISE - WAVE) > 0.99


def test_a_response_of_its_own_is_not_said_to_fall():
    """A warning would be an error."""
    SmoothCurve().fit(WAVE[:, None], np.cos(np.arange(N) / 4.0))


@pytest.mark.parametrize(
    ("X", "fault"),
    [
        (np.full((N, 1), 2.0), "constant_drive"),
        (np.column_stack([WAVE, WAVE]), "same_signal"),
        (np.column_stack([WAVE, RISE]), None),
    ],
)
def test_data_quality_knows_what_the_overview_knows(X, fault):
    table = data_quality(X, RISE + NOISE, record_slices(X))
    assert table["fault"].tolist() == ([] if fault is None else [fault])


def test_a_search_says_that_the_drive_does_not_move():
    X = pd.DataFrame({"drive": np.full(N, 2.0)}, 0.01 * np.arange(N))
    search = EffectSearchCV(FirstOrderLag(), effects=["lag"], random_state=0)
    search.fit(X, pd.Series(RISE + NOISE, X.index))
    assert any("does not move" in text for text in search.warnings_)
    assert search.data_quality_["fault"].tolist() == ["constant_drive"]
