import numpy as np
import pytest

from skhyst.hysteresis import Dahl, DahlOperator

DT = 0.01
U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800)


@pytest.mark.parametrize("exponent", [0.6, 1.0, 1.8])
def test_all_parameters_come_back(exponent):
    plant = DahlOperator(0.12, -3.0, stiffness=1.5, damping=0.2, intercept=7.0, exponent=exponent)
    y, _ = plant.run(U, DT)
    model = Dahl(exponent, fit_stiffness=True, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-4)
    np.testing.assert_allclose(model.predict(U[:, None]), y, atol=1e-5)


def test_what_is_not_fitted_stands_at_zero():
    y, _ = DahlOperator(0.12, 3.0, stiffness=1.5, damping=0.2, intercept=7.0).run(U, DT)
    model = Dahl(fit_damping=False, fit_intercept=False, dt=DT).fit(U[:, None], y)
    assert set(model.params_) == {"presliding_displacement", "coulomb_force"}
    operator = model.operator_
    assert (operator.stiffness, operator.damping, operator.intercept) == (0.0, 0.0, 0.0)


def test_first_loading_before_the_record_is_estimated():
    y, _ = DahlOperator(0.12, 3.0).run(np.r_[0.9, U], DT)
    known = {"fit_damping": False, "dt": DT}
    rest = Dahl(**known).fit(U[:, None], y[1:])
    estimated = Dahl(initial_state="estimate", **known).fit(U[:, None], y[1:])
    assert estimated.fit_error_ < 0.1 * rest.fit_error_


@pytest.mark.parametrize("exponent", [0.0, -1.0, "1"])
def test_wrong_exponent(exponent):
    with pytest.raises(ValueError, match="The 'exponent' parameter of Dahl must be"):
        Dahl(exponent).fit(U[:, None], U)
