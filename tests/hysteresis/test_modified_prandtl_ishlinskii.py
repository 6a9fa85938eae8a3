"""Plays, then dead zones: recovery, inverse, units."""

import numpy as np
import pytest

from skhyst.hysteresis import ModifiedPrandtlIshlinskii, PrandtlIshlinskii

R = np.array([0.0, 0.5, 1.0, 1.7, 2.5])


def drive(n=1500):
    time = np.arange(n) / n
    return 5.0 * np.sin(12 * np.pi * time) * (0.3 + 0.7 * np.abs(np.sin(5 * time)))


def plays(u, weights):
    state, y = np.zeros(R.size), []
    for value in u:
        state = np.maximum(value - R, np.minimum(value + R, state))
        y.append(weights @ state)
    return np.array(y)


class Plant:
    """Plays of random weights, then a curve of random slopes, two dead zones a side."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        self.u = drive()
        self.weights, self.intercept = rng.uniform(0.3, 1.0, 5), rng.uniform(-2, 2)
        z = plays(self.u, self.weights) + self.intercept
        self.levels = np.quantile(z, [0.2, 0.4, 0.6, 0.8])
        self.slopes = np.exp(rng.uniform(-1, 1, 4))
        knots = np.array([z.min() - 1.0, *self.levels, z.max() + 1.0])
        rises = np.diff(knots) * np.insert(self.slopes, 2, 1.0)
        values = np.append(0.0, np.cumsum(rises))
        values += self.levels[1] - values[2]  # the centre is left as it is
        self.y = np.interp(z, knots, values)
        self.noise = 0.005 * self.y.std() * rng.normal(size=z.size)
        self.X = self.u.reshape(-1, 1)

    def model(self):
        return ModifiedPrandtlIshlinskii(thresholds=R, dead_zone_thresholds=self.levels)


@pytest.mark.slow
def test_recovery_of_random_plants(assert_recovered):
    def plant(seed):
        p = Plant(seed)
        truth = np.concatenate([p.weights, [p.intercept], p.slopes])
        levels = {"dead_zone_thresholds": p.levels}
        return p.u, p.y, p.y + p.noise, np.sqrt(np.mean(p.noise**2)), truth, levels

    # the parameters of one plant are covered or missed together
    evaluations = assert_recovered(ModifiedPrandtlIshlinskii(thresholds=R), map(plant, range(60)))
    assert np.median(evaluations) < 40


def test_asymmetry_and_saturation_that_plays_alone_cannot_have():
    u = drive()
    rng = np.random.default_rng(1)
    z = plays(u, np.array([0.6, 0.3, 0.2, 0.2, 0.1]))
    y = 8.0 * np.tanh(z / 8.0) + 0.02 * z**2
    X, noisy = u.reshape(-1, 1), y + 0.005 * y.std() * rng.normal(size=y.size)
    plain = PrandtlIshlinskii().fit(X, noisy)
    models = [ModifiedPrandtlIshlinskii(n_dead_zones=n).fit(X, noisy) for n in (1, 3, 5)]
    errors = [np.sqrt(np.mean((model.predict(X) - y) ** 2)) for model in models]
    assert errors[1] < 0.1 * np.sqrt(np.mean((plain.predict(X) - y) ** 2))
    assert errors[2] < errors[1] < errors[0]
    for model in models:
        slopes = model.operator_.stages[1].slopes
        assert np.all(slopes >= 1e-3)
        response = model.predict(X).reshape(-1, 1)
        np.testing.assert_allclose(model.inverse_predict(response), u, atol=1e-10 * np.ptp(u))


@pytest.mark.parametrize(("drive_unit", "response_unit"), [(1e6, 1e-9), (1e-9, 1e12)])
def test_units(drive_unit, response_unit, assert_unit_free):
    plant, model = Plant(4), ModifiedPrandtlIshlinskii(6, n_dead_zones=2)
    assert_unit_free(model, plant.u, plant.y + plant.noise, drive_unit, response_unit, 1e-5)


def test_attributes():
    plant = Plant(5)
    model = plant.model().fit(plant.X, plant.y)
    np.testing.assert_allclose(model.weights_, plant.weights, rtol=1e-5)
    np.testing.assert_allclose(model.dead_zone_thresholds_, plant.levels)
    s = plant.slopes
    expected = [s[0] - s[1], s[1] - 1.0, s[2] - 1.0, s[3] - s[2]]
    np.testing.assert_allclose(model.dead_zone_weights_, expected, atol=1e-5)
    assert model.intercept_ == pytest.approx(plant.intercept, abs=1e-5)
    assert model.thresholds_.shape == (5,)


def test_held_parameters():
    plant = Plant(6)
    model = plant.model().set_params(fit_intercept=False).fit(plant.X, plant.y)
    assert model.intercept_ == 0.0
    assert not any("intercept" in name or "offset" in name for name in model.params_)
    free = plant.model().set_params(drive_offset="fit").fit(plant.X, plant.y + plant.noise)
    assert "plays__drive_offset" in free.params_


def test_falling_response_needs_free_weights():
    plant = Plant(7)
    model = plant.model().set_params(
        non_negative=False, dead_zone_thresholds="quantile", n_dead_zones=2
    )
    assert model.fit(plant.X, -plant.y).score(plant.X, -plant.y) > 0.999
