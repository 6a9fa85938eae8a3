"""Models whose weights lie on a grid over the half plane: plants are found, by relays and ramps."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone

from skhyst.compose import Cascade
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import (
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    PrandtlIshlinskii,
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


@pytest.mark.slow
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


def test_smoothness_fills_what_a_major_loop_leaves_open():
    """Minor loops are predicted from a major loop only as well as the penalty guesses."""
    operator = PreisachOperator(np.linspace(-1, 1, 16), np.full(120, 1 / 120), np.full(15, 1 / 30))
    major = np.cos(np.linspace(0, 4 * np.pi, 800))
    minor = 0.6 * np.cos(np.linspace(0, 4 * np.pi, 800))
    y = operator.run(major, 1.0)[0]
    smooth = Preisach(16).fit(major[:, None], y)
    expected = operator.run(minor, 1.0)[0]
    assert np.std(smooth.predict(minor[:, None]) - expected) < 0.02 * np.ptp(expected)


def test_an_even_density_costs_no_roughness():
    u = excursions(np.random.default_rng(0))
    even = np.ones((5, 5)) - 0.5 * np.eye(5)
    y = PreisachOperator(LEVELS, even[np.tril_indices(5)], np.full(5, 0.7)).run(u, 1.0)[0]
    model = Preisach(6, smoothness=10.0).fit(u[:, None], y)
    np.testing.assert_allclose(model.weights_, even[np.tril_indices(5)], rtol=1e-6)
    np.testing.assert_allclose(model.reversible_, 0.7, rtol=1e-6)


def test_cells_that_were_never_switched():
    u = np.sin(np.linspace(0, 30, 900)) * 0.5
    model = Preisach(levels=np.linspace(-1, 1, 9))
    with pytest.warns(ConvergenceWarning, match="do not determine"):
        model.fit(u[:, None], u)
    undetermined = set(model.identifiability_["undetermined"])
    i, j = np.tril_indices(8)
    still = (i >= 6) | (j <= 1)
    assert undetermined == {f"weights[{k}]" for k in np.flatnonzero(still)} | {
        f"reversible[{k}]" for k in (0, 1, 6, 7)
    }
    assert all(np.isinf(model.params_std_[name]) for name in undetermined)
    assert np.std(model.predict(u[:, None]) - u) < 1e-2
    with pytest.warns(ConvergenceWarning):
        hard = clone(model).set_params(smoothness=0.0).fit(u[:, None], u)
    np.testing.assert_array_equal(hard.weights_[still], 0.0)
    assert np.std(hard.predict(u[:, None]) - u) < 1e-6


def test_levels_follow_the_response():
    u = np.sin(np.linspace(0, 40, 4000))
    y = np.tanh(20 * u) + 0.01 * np.random.default_rng(0).normal(size=u.size)
    even = Preisach(10).fit(u[:, None], y)
    dense = Preisach(10, levels="response").fit(u[:, None], y)
    assert np.count_nonzero(np.abs(dense.levels_) < 0.2) >= 4
    assert dense.levels_[[0, -1]] == pytest.approx([u.min(), u.max()])
    assert np.diff(dense.levels_).max() < 0.5
    assert dense.fit_error_ < 0.5 * even.fit_error_


@pytest.mark.filterwarnings("ignore:No one set of parameters of PrandtlIshlinskii")
def test_amplitude_that_was_not_in_the_fit():
    """What plays cannot do: loops of an asymmetric density, at an amplitude in between."""
    levels = np.linspace(-1, 1, 25)
    i, j = np.tril_indices(24)
    middle = 0.5 * (levels[1:] + levels[:-1])
    density = np.exp(-((middle[i] - 0.25) ** 2 + (middle[j] + 0.1) ** 2) / 0.1)
    device = PreisachOperator(levels, density / density.sum(), np.full(24, 0.01))
    loop = np.cos(np.linspace(0, 4 * np.pi, 500))
    amplitudes = [1.0, 0.7, 0.45, 0.25]
    X = pd.DataFrame({"drive": np.concatenate([a * loop for a in amplitudes])})
    X.index = pd.MultiIndex.from_product([amplitudes, np.arange(500.0)], names=["record", "time"])
    y = np.concatenate([device.run(a * loop, 1.0)[0] for a in amplitudes])
    unseen = X[:500] * 0.57
    expected = device.run(unseen["drive"], 1.0)[0]
    errors = {
        model: np.std(model.fit(X, y).predict(unseen) - expected) / np.ptp(expected)
        for model in (Preisach(20), PrandtlIshlinskii(40))
    }
    relays, plays = errors.values()
    assert relays < 0.01
    assert plays > 5 * relays


def test_history_before_the_record():
    """Before the record the device had been at the lowest level; the weights stay smooth."""
    device = PreisachOperator(np.linspace(-1, 1, 11), np.full(55, 0.02), np.full(10, 0.01))
    u = excursions(np.random.default_rng(2))
    y = device.run(np.r_[-1.0, u], 1.0)[0][1:]
    with pytest.warns(ConvergenceWarning, match="do not begin at rest"):
        rest = Preisach(11).fit(u[:, None], y)
    model = Preisach(11, initial_state="estimate").fit(u[:, None], y)
    assert model.initial_drive_.min() < -0.9
    assert model.fit_error_ < 0.3 * rest.fit_error_
    assert model.fit_error_ < 1e-3 * np.ptp(y)


def test_many_cells():
    """1,225 cells of 50 levels from 3,000 samples: seconds, not minutes."""
    u = excursions(np.random.default_rng(0), n_turns=300, n_steps=10)
    y = np.tanh(u + 0.2 * np.random.default_rng(1).normal(size=u.size) * 0.01)
    model = Preisach(50, smoothness=1e-3).fit(u[:, None], y)
    assert model.weights_.size == 1225
    assert model.fit_error_ < 0.02
