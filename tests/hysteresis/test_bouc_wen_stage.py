import numpy as np
import pandas as pd
import pytest

from skhyst.hysteresis import BoucWenStage, BoucWenStageOperator

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
PLANT = BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, 0.4, 1.0, 3.0, 0.5, n_substeps=5)


@pytest.mark.parametrize(("shape", "exponent"), [(0.4, 1.0), (-1.2, 1.0), (0.4, 2.0)])
def test_all_parameters_come_back_and_the_mass_scales_them(shape, exponent):
    plant = BoucWenStageOperator(20.0, 0.3, 4.0, 0.3, shape, exponent, 3.0, 0.5, n_substeps=5)
    y, _ = plant.run(U, DT)
    model = BoucWenStage(fit_exponent=exponent > 1.0, n_substeps=5, mass=2.0, dt=DT)
    model.fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), plant.pack(), rtol=1e-4)
    assert model.physical_ == pytest.approx(plant.physical(2.0), rel=1e-3)


@pytest.mark.parametrize(("drive", "response", "time"), [(1e3, 1e-9, 1.0), (1e-6, 1e6, 1e-4)])
def test_units(drive, response, time):
    y, _ = PLANT.run(U, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(y))
    plain = BoucWenStage(dt=DT).fit(U[:, None], y)
    other = BoucWenStage(dt=time * DT).fit(drive * U[:, None], response * y)
    np.testing.assert_allclose(
        other.predict(drive * U[:, None]) / response, plain.predict(U[:, None]), atol=1e-4
    )
    assert other.operator_.level / drive == pytest.approx(plain.operator_.level, rel=1e-3)


def test_several_records_and_zero_state():
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(750)], names=["record", "time"])
    X = pd.DataFrame({"drive": U}, index)
    y = np.concatenate(
        [PLANT.run(part, DT, PLANT.init(part[0], "zero"))[0] for part in np.split(U, 2)]
    )
    model = BoucWenStage(n_substeps=5, initial_state="zero").fit(X, y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-4)


@pytest.mark.parametrize(("name", "value"), [("exponent", 0.5), ("fit_exponent", 2), ("mass", 0.0)])
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of BoucWenStage"):
        BoucWenStage(**{name: value}).fit(U[:, None], U)
