"""Models whose weights lie on a grid over the half plane: plants are found, by relays and ramps."""

import dataclasses

import numpy as np
import pytest

from skhyst.compose import Cascade
from skhyst.hysteresis import (
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    Preisach,
    PreisachOperator,
)
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator

LEVELS = np.linspace(-1.0, 1.0, 6)
MODELS = pytest.mark.parametrize("model", [Preisach, KrasnoselskiiPokrovskii])


def excursions(rng, n_turns=110, n_steps=10):
    """Reversal curves of all sizes: every cell is switched alone now and then."""
    ends = np.r_[0.0, 1.0, -1.0, rng.uniform(-1.0, 1.0, n_turns)]
    ends[5::8], ends[6::8] = 1.0, -1.0
    time = np.arange(0, n_steps * (ends.size - 1) + 1) / n_steps
    return np.interp(time, np.arange(ends.size), ends)


def plant(model, seed, low=0.5):
    """Return drive, response, noise and parameters."""
    rng = np.random.default_rng(seed)
    u = excursions(rng, n_steps=10 if model is Preisach else 14)
    weights, intercept = rng.uniform(low, 1.5, 15), 3.0
    kind = PreisachOperator if model is Preisach else KrasnoselskiiPokrovskiiOperator
    operator = kind(LEVELS, weights, intercept=intercept)
    if model is Preisach:
        operator = dataclasses.replace(operator, reversible=rng.uniform(0.5, 1.5, 5))
    y, _ = operator.run(u, 1.0)
    return u, y, 0.005 * np.ptp(y), operator.pack()


@MODELS
def test_recovery_and_standard_errors(model, assert_recovered):
    def noisy(seed):
        u, y, noise, truth = plant(model, seed)
        error = noise * np.random.default_rng(100 + seed).normal(size=y.size)
        return u, y, y + error, noise, truth

    assert assert_recovered(model(n_levels=6, smoothness=0.0), map(noisy, range(20))) == [1] * 20


@MODELS
def test_free_weights_and_no_intercept(model):
    u, y, _, truth = plant(model, 2, low=-1.0)
    options = {"smoothness": 0.0, "fit_intercept": False}
    free = model(6, non_negative=False, **options).fit(u[:, None], y - 3.0)
    np.testing.assert_allclose(free.weights_, truth[:15], atol=1e-6)
    assert "intercept" not in free.params_
    assert free.intercept_ == 0.0
    bounded = model(6, **options).fit(u[:, None], y - 3.0)
    assert bounded.fit_error_ > 10 * free.fit_error_
    assert bounded.weights_.min() == 0.0
    at_bound = np.flatnonzero(bounded.weights_ == 0.0)
    assert np.isnan([bounded.params_std_[f"weights[{k}]"] for k in at_bound]).all()


@MODELS
def test_in_a_cascade(model):
    u, y, _, truth = plant(model, 4)
    lagged = FirstOrderLagOperator(3.0).run(y, 1.0)[0]
    cascade = Cascade([("relays", model(6)), ("lag", FirstOrderLag())]).fit(u[:, None], lagged)
    assert cascade.operators_["lag"].time_constant == pytest.approx(3.0, rel=1e-4)
    assert cascade.fit_error_ < 2e-3 * np.ptp(lagged)
    np.testing.assert_allclose(cascade.operators_["relays"].weights, truth[:15], rtol=1e-2)


@MODELS
@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("levels", ["grid", "response"])
def test_units(model, scale, levels, assert_unit_free):
    u, y, noise, _ = plant(model, 5)
    y = y + noise * np.random.default_rng(0).normal(size=y.size)
    # samples on the edge of a bin may fall to either side
    assert_unit_free(model(6, levels=levels), u, y, scale, 1.0 / scale)


def test_default_smoothness_costs_little():
    u, y, noise, _ = plant(Preisach, 3)
    noisy = y + noise * np.random.default_rng(7).normal(size=y.size)
    model = Preisach(n_levels=6).fit(u[:, None], noisy)
    assert np.std(model.predict(u[:, None]) - y) < 0.5 * noise


def test_density():
    u, y, _, truth = plant(Preisach, 0)
    model = Preisach(6, smoothness=0.0).fit(u[:, None], y)
    np.testing.assert_allclose(model.levels_, LEVELS, atol=1e-12)
    width = LEVELS[1] - LEVELS[0]
    assert model.density_.shape == (5, 5)
    assert not np.triu(model.density_, 1).any()
    assert model.density_[3, 1] == pytest.approx(truth[7] / width**2, rel=0.02)
    assert model.density_[2, 2] == pytest.approx(2 * truth[5] / width**2, rel=0.02)


def test_without_reversible_part():
    u, y, _, _ = plant(Preisach, 2)
    plain = Preisach(6, reversible=False).fit(u[:, None], y)
    assert plain.reversible_.size == 0
    assert plain.fit_error_ > 5 * Preisach(6).fit(u[:, None], y).fit_error_
