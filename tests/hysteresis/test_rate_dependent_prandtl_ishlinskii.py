"""Plays that follow the rate of the drive: recovery, inverse, what the rate does."""

import pickle

import numpy as np
import pytest

from skhyst.hysteresis import PrandtlIshlinskii, RateDependentPrandtlIshlinskii

DT = 1e-3
R = np.array([0.0, 0.4, 0.9, 1.6])
VARIANTS = pytest.mark.parametrize("variant", ["threshold", "slope"])


class Plant:
    """Random plays; the differential inclusion in fine steps, the threshold moving along."""

    def __init__(self, seed, variant, n=2500):
        rng = np.random.default_rng(seed)
        time = DT * np.arange(n)
        sweep = np.sin(2 * np.pi * rng.uniform(0.5, 2.0) * time * (1.0 + 1.5 * time))
        self.u = 4.0 * sweep * (0.5 + 0.5 * np.cos(0.7 * time) ** 2)
        self.weights, self.intercept = rng.uniform(0.3, 1.0, 4), rng.uniform(-2, 2)
        self.dilation = rng.uniform(2e-3, 8e-3) * (variant == "threshold")
        self.rate_weights = rng.uniform(-2e-3, 2e-3, 4) * (variant == "slope")
        state, last, slack, y = np.zeros(4), self.u[0], R, []
        for value in self.u:
            rate = abs(value - last) / DT
            goal = R + self.dilation * rate * (R > 0)
            for part in (0.25, 0.5, 0.75, 1.0):
                v, r = last + part * (value - last), slack + part * (goal - slack)
                state = np.maximum(v - r, np.minimum(v + r, state))
            last, slack = value, goal
            y.append((self.weights + self.rate_weights * rate) @ state)
        self.y = np.array(y) + self.intercept
        self.noise = 0.005 * self.y.std() * rng.normal(size=n)
        self.X = self.u.reshape(-1, 1)


@VARIANTS
def test_recovery_of_random_plants(variant):
    covered, evaluations = [], []
    for seed in range(20):
        plant = Plant(seed, variant)
        model = RateDependentPrandtlIshlinskii(thresholds=R, variant=variant, dt=DT)
        model.fit(plant.X, plant.y + plant.noise)
        assert model.fit_error_ < 1.02 * np.sqrt(np.mean(plant.noise**2))
        rates = plant.rate_weights if variant == "slope" else []
        last = [plant.dilation] if variant == "threshold" else []
        truth = np.concatenate([plant.weights, rates, [plant.intercept], last])
        found, std = (np.array(list(p.values())) for p in (model.params_, model.params_std_))
        covered += list(np.abs(found - truth) < 1.96 * std)
        evaluations.append(model.n_evaluations_)
    assert 0.9 <= np.mean(covered) <= 0.99
    assert np.median(evaluations) < 40


@VARIANTS
def test_better_than_the_plain_model(variant):
    plant = Plant(0, variant)
    noisy = plant.y + plant.noise
    plain = PrandtlIshlinskii().fit(plant.X, noisy)
    model = RateDependentPrandtlIshlinskii(variant=variant, dt=DT).fit(plant.X, noisy)
    errors = [np.sqrt(np.mean((m.predict(plant.X) - plant.y) ** 2)) for m in (model, plain)]
    assert errors[0] < 0.1 * errors[1]


@VARIANTS
def test_inverse_after_pickling(variant):
    plant = Plant(1, variant)
    model = RateDependentPrandtlIshlinskii(thresholds=R, variant=variant, dt=DT)
    model.fit(plant.X, plant.y + plant.noise)
    model = pickle.loads(pickle.dumps(model))
    wanted = model.predict(plant.X)
    again = model.predict(model.inverse_predict(wanted.reshape(-1, 1)).reshape(-1, 1))
    assert np.sqrt(np.mean((again - wanted) ** 2)) < 1e-3 * np.ptp(wanted)


def test_records_are_inverted_one_by_one():
    plant = Plant(2, "threshold")
    model = RateDependentPrandtlIshlinskii(thresholds=R, dt=DT).fit(plant.X, plant.y)
    one = model.inverse_predict(plant.y[:600].reshape(-1, 1))
    pd = pytest.importorskip("pandas")
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(600)], names=["record", "time"])
    frame = pd.DataFrame({"y": np.tile(plant.y[:600], 2)}, index)
    model = RateDependentPrandtlIshlinskii(thresholds=R, dt=DT).fit(
        pd.DataFrame({"y": plant.u}), plant.y
    )
    np.testing.assert_allclose(model.inverse_predict(frame), np.tile(one, 2), atol=1e-9)


def test_data_without_rate_dependence():
    plant = Plant(3, "neither")
    noisy = plant.y + plant.noise
    plain = PrandtlIshlinskii(thresholds=R).fit(plant.X, noisy)
    model = RateDependentPrandtlIshlinskii(thresholds=R, dt=DT).fit(plant.X, noisy)
    fastest = np.abs(np.diff(plant.u)).max() / DT
    assert model.dilation_ * fastest < 0.02
    assert model.fit_error_ <= 1.001 * plain.fit_error_


@VARIANTS
def test_units(variant):
    plant = Plant(4, variant)
    noisy = plant.y + plant.noise
    model = RateDependentPrandtlIshlinskii(6, variant=variant, dt=DT).fit(plant.X, noisy)
    expected = model.predict(plant.X)
    for drive_unit, response_unit, time_unit in ((1e6, 1e-9, 1e3), (1e-9, 1e9, 1e-6)):
        other = RateDependentPrandtlIshlinskii(6, variant=variant, dt=DT * time_unit)
        other.fit(plant.X * drive_unit, noisy * response_unit)
        found = other.predict(plant.X * drive_unit) / response_unit
        np.testing.assert_allclose(found, expected, atol=1e-5 * np.ptp(expected))


def test_attributes():
    plant = Plant(5, "slope")
    model = RateDependentPrandtlIshlinskii(thresholds=R, variant="slope", dt=DT)
    model.fit(plant.X, plant.y)
    np.testing.assert_allclose(model.weights_, plant.weights, atol=1e-9)
    np.testing.assert_allclose(model.rate_weights_, plant.rate_weights, atol=1e-11)
    assert model.dilation_ == 0.0
    assert model.intercept_ == pytest.approx(plant.intercept)
    held = RateDependentPrandtlIshlinskii(thresholds=R, fit_intercept=False, dt=DT)
    assert held.fit(plant.X, plant.y).intercept_ == 0.0


def test_wrong_variant():
    with pytest.raises(ValueError, match="'variant' parameter of"):
        RateDependentPrandtlIshlinskii(variant="speed").fit(np.zeros((5, 1)), np.zeros(5))
