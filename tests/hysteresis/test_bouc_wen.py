"""Bouc-Wen identified from data of plants that are integrated here."""

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import BoucWen, BoucWenOperator

N = 1000
N_PLANTS = 20
NOISE = 0.005


def simulate(u, k, alpha, beta, gamma, n, n_steps=30):
    """Integrate the law for many plants at once, Runge-Kutta along straight lines; (N, plants)."""

    def rate(g, du):
        size = np.abs(g)
        return du * alpha - size ** (n - 1) * (beta * np.abs(du) * g + gamma * du * size)

    y, g, last = [], np.zeros_like(k), np.zeros_like(k)
    for value in u:
        du = (value - last) / n_steps
        for _ in range(n_steps):
            k1 = rate(g, du)
            k2 = rate(g + 0.5 * k1, du)
            k3 = rate(g + 0.5 * k2, du)
            g = g + (k1 + 2 * k2 + 2 * k3 + rate(g + k3, du)) / 6
        last = value
        y.append(k * value + g)
    return np.array(y)


@pytest.fixture(scope="module")
def plants():
    """Drives and responses without noise, both (N, N_PLANTS), and the parameters."""
    rng = np.random.default_rng(7)
    time = np.arange(N)[:, None] / N
    phase = rng.uniform(0, 6.28, N_PLANTS)
    u = np.sin(2 * np.pi * 4 * time) * (0.3 + 0.7 * time) + 0.25 * np.sin(
        2 * np.pi * 15 * time + phase
    )
    # an arbitrary unit for each
    drive_unit, unit = 10.0 ** rng.uniform(-6, 3, (2, N_PLANTS))
    sign = rng.choice([-1.0, 1.0], N_PLANTS)
    n = rng.uniform(1.0, 3.0, N_PLANTS)
    limit = rng.uniform(0.08, 0.5, N_PLANTS)
    ratio = rng.uniform(0.1, 2.0, N_PLANTS)
    k = rng.uniform(0.3, 1.5, N_PLANTS)
    alpha = sign * rng.uniform(0.5, 2.0, N_PLANTS)
    beta = 0.5 * (1 + ratio) * limit**-n * np.abs(alpha) ** (1 - n)
    gamma = 0.5 * (1 - ratio) * limit**-n * np.abs(alpha) ** (1 - n) * sign
    y = simulate(u, k, alpha, beta, gamma, n)
    truth = {
        "gain": k * unit / drive_unit,
        "alpha": alpha * unit / drive_unit,
        "limit": limit * drive_unit,
        "ratio": ratio,
        "exponent": n,
        "intercept": 0.0 * k,
    }
    return u * drive_unit, y * unit, truth


@pytest.fixture(scope="module")
def fits(plants):
    """Three draws of the noise for each plant: (plant, floor, model)."""
    drives, clean, _ = plants
    rng = np.random.default_rng(11)
    found = []
    for i in np.repeat(np.arange(N_PLANTS), 3):
        noise = NOISE * clean[:, i].std() * rng.normal(size=N)
        model = BoucWen("fit").fit(drives[:, [i]], clean[:, i] + noise)
        found.append((i, np.sqrt(np.mean(noise**2)), model))
    return found


def test_every_plant_is_found_to_the_noise(fits):
    assert max(model.fit_error_ / floor for _, floor, model in fits) < 1.02


def test_few_evaluations(fits):
    assert np.median([model.n_evaluations_ for *_, model in fits]) <= 12
    assert max(model.n_evaluations_ for *_, model in fits) <= 30


def test_standard_errors_are_true(fits, plants):
    truth = plants[2]
    inside = [
        abs(value - truth[name][i]) < 1.96 * model.params_std_[name]
        for i, _, model in fits
        for name, value in model.params_.items()
    ]
    assert 0.90 <= np.mean(inside) <= 0.99


def test_coefficients_of_the_law(fits):
    for _, _, model in fits[:5]:
        law = BoucWenOperator.from_coefficients(
            model.alpha_, model.beta_, model.gamma_, model.exponent_
        )
        assert law.limit == pytest.approx(model.params_["limit"], rel=1e-9)
        assert law.ratio == pytest.approx(model.params_["ratio"], rel=1e-9)
        assert model.alpha_ == model.params_["alpha"]
        assert model.intercept_ == model.params_["intercept"]


def drive(n=800):
    time = np.arange(n) / n
    return np.sin(2 * np.pi * 3 * time) * (0.4 + 0.6 * time)


def test_exponent_is_held_unless_fitted():
    u = drive()
    y = BoucWenOperator(0.4, 1.0, 0.3, 0.5, 2.0).run(u, 1.0)[0]
    held = BoucWen(exponent=2.0, fit_intercept=False).fit(u[:, None], y)
    assert set(held.params_) == {"gain", "alpha", "limit", "ratio"}
    assert held.exponent_ == 2.0
    assert held.params_["ratio"] == pytest.approx(0.5, rel=1e-6)
    wrong = BoucWen().fit(u[:, None], y)
    assert wrong.exponent_ == 1.0
    assert wrong.fit_error_ > 1e3 * held.fit_error_


def test_asymmetry():
    u, rng = drive(), np.random.default_rng(0)
    y = BoucWenOperator(0.4, -1.0, 0.3, 0.5, 1.3, 0.4, 2.0).run(u, 1.0)[0]
    y += NOISE * y.std() * rng.normal(size=len(y))
    model = BoucWen("fit", asymmetry=True).fit(u[:, None], y)
    assert abs(model.params_["asymmetry"] - 0.4) < 4 * model.params_std_["asymmetry"] < 0.4
    assert model.fit_error_ < 0.5 * BoucWen("fit").fit(u[:, None], y).fit_error_


@pytest.mark.parametrize(("drive_unit", "unit"), [(1e-9, 1e6), (1e4, -1e-8)])
def test_units(drive_unit, unit):
    u, rng = drive(), np.random.default_rng(0)
    y = BoucWenOperator(0.4, 1.0, 0.3, 0.5, 1.3, 0.0, 2.0).run(u, 1.0)[0]
    y += 0.01 * rng.normal(size=len(y))
    model = BoucWen("fit").fit(u[:, None], y)
    other = clone(model).fit(drive_unit * u[:, None], unit * y)
    assert other.params_["limit"] == pytest.approx(drive_unit * model.params_["limit"], rel=1e-4)
    assert other.params_["exponent"] == pytest.approx(model.params_["exponent"], rel=1e-4)
    assert other.alpha_ == pytest.approx(unit / drive_unit * model.alpha_, rel=1e-4)


def test_several_records():
    truth = BoucWenOperator(0.4, 1.0, 0.3, 0.5, 1.0, 0.0, 0.2)
    signals = [drive(300), 0.5 + 0.4 * drive(200), -drive(250)]
    index = pd.MultiIndex.from_tuples(
        [(name, 0.1 * k) for name, u in zip("abc", signals, strict=True) for k in range(len(u))],
        names=["record", "time"],
    )
    X = pd.DataFrame({"drive": np.concatenate(signals)}, index)
    y = pd.Series(np.concatenate([truth.run(u, 0.1)[0] for u in signals]), index)
    model = BoucWen().fit(X, y)
    assert len(model.records_) == 3
    np.testing.assert_allclose(model.predict(X), y, atol=1e-7)


def test_unknown_history():
    truth = BoucWenOperator(0.4, 1.0, 0.3, 0.5)
    u = drive() - 0.2
    y = truth.run(u, 1.0, truth.init(0.6))[0]
    y += 1e-3 * np.random.default_rng(0).normal(size=len(y))
    known = BoucWen(initial_state="estimate").fit(u[:, None], y)
    assert known.fit_error_ < 0.3 * BoucWen().fit(u[:, None], y).fit_error_
    assert known.initial_drive_[0] > 0.4


def test_parameters_that_do_not_matter_are_named():
    u = drive()
    with pytest.warns(ConvergenceWarning, match="do not determine"):
        model = BoucWen("fit").fit(np.ones((50, 1)), np.ones(50))
    assert model.identifiability_["undetermined"]
    assert np.isfinite(model.predict(u[:, None])).all()


@pytest.mark.parametrize(
    ("name", "value"), [("exponent", 0.1), ("exponent", "free"), ("asymmetry", 2)]
)
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of BoucWen"):
        BoucWen(**{name: value}).fit(drive()[:, None], drive())
