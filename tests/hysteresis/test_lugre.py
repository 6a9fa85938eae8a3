import numpy as np
import pytest

from skhyst.hysteresis import LuGre, LuGreOperator

DT = 0.005
T = DT * np.arange(3000)
U = np.sin(T) + 0.3 * np.sin(4.4 * T) + 0.03 * np.sin(13.0 * T)
PLANT = LuGreOperator(0.05, 0.5, 0.6, 8.0, 0.4, stiffness=2.0, damping=0.3, intercept=1.0)


def test_all_parameters_come_back():
    y, _ = PLANT.run(U, DT)
    model = LuGre(fit_stiffness=True, dt=DT).fit(U[:, None], y)
    np.testing.assert_allclose(model.operator_.pack(), PLANT.pack(), rtol=1e-5)
    assert model.operator_.bristle_stiffness == pytest.approx(160.0, rel=1e-5)
    assert model.operator_.coulomb_force == pytest.approx(4.8, rel=1e-5)


def test_without_stribeck_effect():
    y, _ = LuGreOperator(0.05, 1.0, 1.0, 8.0, 0.4, damping=0.3).run(U, DT)
    model = LuGre(stribeck=False, fit_bristle_damping=False, dt=DT).fit(U[:, None], y)
    assert set(model.params_) == {
        "presliding_displacement",
        "static_force",
        "damping",
        "intercept",
    }
    assert model.operator_.coulomb_ratio == 1.0
    assert model.operator_.bristle_damping == 0.0


def test_no_stribeck_effect_is_a_ratio_at_its_bound():
    y, _ = LuGreOperator(0.05, 1.0, 1.0, 8.0, 0.4, damping=0.3).run(U, DT)
    y += 0.02 * np.random.default_rng(0).normal(size=len(y))
    model = LuGre(stribeck=False, dt=DT).fit(U[:, None], y)
    freer = LuGre(dt=DT)
    freer.fit(U[:, None], y)
    assert freer.operator_.coulomb_ratio > 0.98
    assert freer.fit_error_ == pytest.approx(model.fit_error_, rel=1e-3)
