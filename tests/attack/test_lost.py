"""Kind lost rows: a row that lies on a straight line between its neighbours may be missing."""

import numpy as np
import pandas as pd
import pytest

from skhyst.control import InverseCompensator
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.inspection import PredictionDisplay, compare_models
from skhyst.linear import Gain, ModalModel, frequency_response
from skhyst.metrics import loop_figures

DT, N, LOST = 0.01, 400, [57, 133, 134, 260, 351]
LEFT = np.delete(np.arange(N), LOST)


def without(signal):
    """Return a signal that is straight where rows will be lost."""
    return np.interp(np.arange(N), LEFT, signal[LEFT])


NOISE = np.random.default_rng(0).normal(size=N)
DRIVE = without(np.sin(2.0 * np.pi * DT * np.arange(N)) + 0.02 * NOISE)
RESPONSE = without(PrandtlIshlinskiiOperator([0.0, 0.4], [0.7, 0.3]).run(DRIVE, DT)[0])
TIME = pd.Index(DT * np.arange(N), name="time")
X, Y = pd.DataFrame({"u": DRIVE}, TIME), pd.Series(RESPONSE, TIME)


def displayed(X, y):
    display = PredictionDisplay.from_predictions(X, y, 0.5 * y, max_points=100)
    (prediction,) = display.predictions.values()
    return np.column_stack([display.running_time(), display.drive, display.response, prediction])


SHOWN = {
    "frequency response": lambda X, y: frequency_response(X, y).response,
    "loops": loop_figures,
    "modes": lambda X, y: ModalModel(2).fit(X, y).poles_table().select_dtypes("number"),
    "display": displayed,
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_recording_shows_the_same(name):
    whole, found = SHOWN[name](X, Y), SHOWN[name](X.iloc[LEFT], Y.iloc[LEFT])
    np.testing.assert_allclose(found, whole, rtol=1e-6, atol=1e-9)


def test_models_compare_as_without_the_rows():
    models = {"gain": Gain(), "plays": PrandtlIshlinskii(4)}
    found = compare_models(X.iloc[LEFT], Y.iloc[LEFT], models)
    whole = compare_models(X, Y, models)
    assert found.taken == whole.taken
    np.testing.assert_allclose(found.table["error"], whole.table["error"], rtol=0.02)


def test_drives_go_on():
    plays = PrandtlIshlinskii(4).fit(X, Y)
    compensator = InverseCompensator(plays, rate_limit=None).fit(X, Y)
    for drive in (plays.inverse_predict, compensator.predict):
        np.testing.assert_allclose(drive(0.5 * X.iloc[LEFT]), drive(0.5 * X)[LEFT], atol=1e-9)
