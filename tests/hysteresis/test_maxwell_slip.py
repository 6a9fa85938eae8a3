import numpy as np
import pytest

from skhyst.hysteresis import MaxwellSlip, MaxwellSlipOperator
from skhyst.operators import play_thresholds

DT = 0.01
U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800)


def test_all_parameters_come_back():
    r = [0.1, 0.3, 0.6]
    plant = MaxwellSlipOperator(r, [3.0, 1.0, 0.5], stiffness=0.4, damping=0.2, intercept=7.0)
    y, _ = plant.run(U, DT)
    model = MaxwellSlip(thresholds=r, fit_stiffness=True, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-6)
    np.testing.assert_allclose(model.saturation_forces_, [0.3, 0.3, 0.3], rtol=1e-6)
    np.testing.assert_allclose(model.weights_, [3.0, 1.0, 0.5], rtol=1e-6)
    assert model.intercept_ == pytest.approx(7.0)
    assert model.n_evaluations_ <= 2


@pytest.mark.parametrize("spacing", ["grid", "quantile"])
def test_thresholds_are_those_of_plays_less_the_zero(spacing):
    model = MaxwellSlip(6, thresholds=spacing).fit(U[:, None], U)
    np.testing.assert_array_equal(model.thresholds_, play_thresholds(U, 7, spacing)[1:])


def test_sign_of_the_weights():
    y, _ = MaxwellSlipOperator([0.1, 0.3], [3.0, -1.0]).run(U, DT)
    bounded = MaxwellSlip(thresholds=[0.1, 0.3], dt=DT).fit(U[:, None], y)
    free = MaxwellSlip(thresholds=[0.1, 0.3], non_negative=False, dt=DT).fit(U[:, None], y)
    assert bounded.weights_.min() == 0.0
    np.testing.assert_allclose(free.weights_, [3.0, -1.0], rtol=1e-6)


def test_approximates_smooth_friction():
    y = 2.0 * np.tanh(5.0 * U)
    errors = [MaxwellSlip(n, dt=DT).fit(U[:, None], y).fit_error_ for n in (1, 4, 16)]
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize("thresholds", [[0.0, 1.0], [2.0, 1.0]])
def test_wrong_thresholds(thresholds):
    with pytest.raises(ValueError, match="The 'thresholds' parameter of MaxwellSlip"):
        MaxwellSlip(thresholds=thresholds).fit(U[:, None], U)
