import numpy as np
import pytest

from skhyst.hysteresis import Dahl, Duhem, DuhemOperator

U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800) + 0.3


@pytest.mark.parametrize("degree", [1, 2, 3, 5])
def test_all_parameters_come_back(degree):
    rng = np.random.default_rng(degree)
    curve, slope = rng.normal(size=(2, degree))
    middle, half = 0.5 * (U.max() + U.min()), 0.5 * np.ptp(U)
    shape = {"center": middle, "scale": half} if degree > 1 else {}
    plant = DuhemOperator(4.0, curve, slope, 0.7, **shape)
    y, _ = plant.run(U, 1.0)
    model = Duhem(degree).fit(U[:, None], y)
    np.testing.assert_allclose(model.predict(U[:, None]), y, atol=1e-5)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), atol=1e-3)


def test_degree_one_is_dahl_friction_with_a_spring():
    y, _ = DuhemOperator(2.0, [1.0, 0.3], [3.0, 0.5], center=0.3).run(U, 1.0)
    duhem = Duhem().fit(U[:, None], y)
    dahl = Dahl(fit_stiffness=True, fit_damping=False).fit(U[:, None], y)
    np.testing.assert_allclose(duhem.predict(U[:, None]), dahl.predict(U[:, None]), atol=1e-4)
    assert Duhem(2).fit(U[:, None], y).fit_error_ < 0.01 * duhem.fit_error_


def test_no_intercept():
    model = Duhem(fit_intercept=False).fit(U[:, None], U + 1.0)
    assert "intercept" not in model.params_
    assert model.operator_.intercept == 0.0


@pytest.mark.parametrize("degree", [0, 10, 1.5])
def test_wrong_degree(degree):
    with pytest.raises(ValueError, match="The 'degree' parameter of Duhem must be"):
        Duhem(degree).fit(U[:, None], U)
