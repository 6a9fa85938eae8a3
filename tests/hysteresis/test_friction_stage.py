import numpy as np
import pandas as pd
import pytest

from skhyst.hysteresis import FrictionStage, FrictionStageOperator

DT = 0.01
TIME = DT * np.arange(1500)
U = np.sin(0.7 * TIME) + 0.8 * np.sin(2.9 * TIME) + 0.3 * np.sin(11.0 * TIME)
PLANT = FrictionStageOperator(20.0, 0.5, 0.4, 0.7, 1.5, 10.0, 0.1, 3.0, 0.5, n_substeps=7)


def test_all_parameters_come_back_and_the_mass_scales_them():
    y, _ = PLANT.run(U, DT)
    model = FrictionStage(n_substeps=7, mass=2.0, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-5)
    assert model.operator_.n_substeps == 7
    assert model.physical_ == pytest.approx(PLANT.physical(2.0), rel=1e-5)


def test_without_stribeck_effect():
    plant = FrictionStageOperator(20.0, 0.5, 0.4, 1.0, 1.5, 10.0, 0.0, 3.0, n_substeps=7)
    y, _ = plant.run(U, DT)
    model = FrictionStage(
        False, fit_bristle_damping=False, fit_intercept=False, n_substeps=7, dt=DT
    )
    model.fit(U[:, None], y)
    assert list(model.params_) == [
        "natural_frequency",
        "damping_ratio",
        "static_level",
        "bristle_stiffness",
        "gain",
    ]
    found = model.operator_
    assert (found.coulomb_ratio, found.bristle_damping, found.intercept) == (1.0, 0.0, 0.0)
    assert found.static_level == pytest.approx(0.4, rel=1e-5)


@pytest.mark.parametrize(("drive", "response", "time"), [(1e3, 1e-9, 1.0), (1e-6, 1e6, 1e-4)])
def test_units(drive, response, time):
    y, _ = PLANT.run(U, DT)
    y = y + 0.01 * np.random.default_rng(0).normal(size=len(y))
    options = {"fit_bristle_damping": False}
    plain = FrictionStage(dt=DT, **options).fit(U[:, None], y)
    other = FrictionStage(dt=time * DT, **options).fit(drive * U[:, None], response * y)
    np.testing.assert_allclose(
        other.predict(drive * U[:, None]) / response, plain.predict(U[:, None]), atol=1e-4
    )
    assert other.operator_.static_level / drive == pytest.approx(
        plain.operator_.static_level, rel=1e-3
    )


def test_several_records_and_zero_state():
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(750)], names=["record", "time"])
    X = pd.DataFrame({"drive": U}, index)
    y = np.concatenate(
        [PLANT.run(part, DT, PLANT.init(part[0], "zero"))[0] for part in np.split(U, 2)]
    )
    model = FrictionStage(n_substeps=7, initial_state="zero").fit(X, y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-4)


def test_records_too_short_for_a_balance_of_forces():
    y, _ = PLANT.run(U[:60], DT)
    model = FrictionStage(False, fit_bristle_damping=False, dt=DT).fit(U[:60, None], y)
    assert model.score(U[:60, None], y) > 0.99


@pytest.mark.parametrize(
    ("name", "value"), [("mass", 0.0), ("n_substeps", 0), ("stribeck", 2), ("fit_intercept", "no")]
)
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of FrictionStage"):
        FrictionStage(**{name: value}).fit(U[:, None], U)
