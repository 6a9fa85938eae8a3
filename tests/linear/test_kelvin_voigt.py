"""Which records determine the gain at rest of a chain of relaxing units."""

import numpy as np
import pytest

from skhyst.datasets import multisine, sine, steps
from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import FirstOrderLagOperator, KelvinVoigt, KelvinVoigtOperator
from skhyst.operators import SumOperator
from skhyst.optimize import RecordData, identify

GAIN, COMPLIANCES, CONSTANTS = 1.3, (0.1, 0.15), (0.01, 30.0)
STATIC = GAIN * (1.0 + sum(COMPLIANCES))


def periodic(X, n_periods, noise=1e-3):
    """Return the steady response of the chain, from its complex gain at the lines of a period."""
    u = X["drive"].to_numpy()
    dt = float(np.diff(X.index.get_level_values("time")[:2])[0])
    period = u[: len(u) // n_periods]
    s = 2j * np.pi * np.fft.rfftfreq(len(period), dt)
    gain = GAIN * (
        1 + sum(c / (tau * s + 1) for c, tau in zip(COMPLIANCES, CONSTANTS, strict=True))
    )
    y = np.tile(np.fft.irfft(gain * np.fft.rfft(period), len(period)), n_periods)
    return y + noise * np.random.default_rng(0).normal(size=len(y))


def stepped(X, noise, seed=0):
    """Return the response to steps from rest, by superposition of the chain's step response."""
    u, time = X["drive"].to_numpy(), X.index.get_level_values("time").to_numpy()
    y = np.full(len(u), STATIC * u[0])
    for k in np.flatnonzero(np.diff(u)):
        t = time[k + 1 :] - time[k + 1]
        parts = zip(COMPLIANCES, CONSTANTS, strict=True)
        response = GAIN * (1 + sum(c * (1 - np.exp(-t / tau)) for c, tau in parts))
        y[k + 1 :] += (u[k + 1] - u[k]) * response
    return y + noise * np.random.default_rng(seed).normal(size=len(y))


@pytest.mark.parametrize("initial_state", ["rest", "estimate"])
@pytest.mark.parametrize("n_units", [1, 2])
@pytest.mark.parametrize("name", ["sine", "multisine"])
def test_steady_periodic_records_leave_the_static_gain_free(name, n_units, initial_state):
    if name == "sine":
        X, n_periods = sine(1.0, 20.0, n_cycles=20, dt=1e-3, offset=0.5), 20
    else:
        X = multisine(1000, band=(10.0, 100.0), n_periods=3, offset=0.5, dt=1e-3, random_state=0)
        n_periods = 3
    y = periodic(X, n_periods)
    model = KelvinVoigt(n_units, initial_state=initial_state)
    with pytest.warns(ConvergenceWarning) as caught:
        model.fit(X, y)
    assert any("static gain of KelvinVoigt" in str(w.message) for w in caught)
    assert "static_gain" in model.identifiability_["undetermined"]
    assert model.static_gain_std_ > 0.01 * abs(model.static_gain_)


def test_a_record_with_rests_determines_the_static_gain():
    X = steps([0.0, 1.0, -1.0, 0.5], hold=[1.0, 60.0, 60.0, 60.0], dt=0.02)
    deviations, errors = [], []
    for seed in range(8):
        model = KelvinVoigt(2, hold="zoh").fit(X, stepped(X, 1e-3, seed))
        assert model.identifiability_["undetermined"] == ()
        deviations.append(model.static_gain_ - STATIC)
        errors.append(model.static_gain_std_)
    # the standard error allows for a unit that was not there, so it is on the safe side
    assert max(errors) < 0.01 * STATIC
    assert np.sqrt(np.mean(np.square(deviations))) < np.median(errors)


def test_a_start_from_zero_is_known():
    """A single step out of zero tells the static gain, if the state is said to be zero."""
    u = np.ones((3000, 1))
    time = 0.05 * np.arange(3000)
    y = 1.0 + 0.3 * (1 - np.exp(-time / 10.0))
    y = y + 1e-4 * np.random.default_rng(0).normal(size=3000)
    options = {"dt": 0.05, "hold": "zoh", "fit_intercept": False}
    model = KelvinVoigt(1, initial_state="zero", **options).fit(u, y)
    assert model.static_gain_ == pytest.approx(1.3, abs=3.0 * model.static_gain_std_)
    assert "static_gain" not in model.identifiability_["undetermined"]
    with pytest.warns(ConvergenceWarning):
        model = KelvinVoigt(1, **options).fit(u, y)
    assert model.static_gain_std_ == np.inf


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_the_standard_error_of_the_static_gain_is_that_beside_a_slow_unit():
    """Fitted together, the chain and the unit have a covariance, and the gain a gradient."""
    dt, n, rng = 0.02, 600, np.random.default_rng(0)
    u = np.repeat(rng.normal(size=10), 60)
    truth = KelvinVoigtOperator(np.array([1.5]), np.array([0.5]), 2.0)
    y = truth.run(u, dt, truth.init(0.0, "zero"))[0] + 0.01 * rng.normal(size=n)
    model = KelvinVoigt(1, fit_intercept=False, initial_state="zero", dt=dt)
    found = model.fit(u.reshape(-1, 1), y).operator_
    both = SumOperator(("chain", "slow"), (found, FirstOrderLagOperator(10 * n * dt, gain=0.0)))
    held = {"chain__intercept", "slow__intercept", "slow__time_constant"}
    result = identify([both], [RecordData(u, y, dt)], fixed=held, initial_state="zero")
    by = {"chain__compliances[0]": found.gain, "slow__gain": 1.0}
    by["chain__gain"] = 1.0 + found.compliances[0]
    gradient = np.array([by.get(name, 0.0) for name in result.params])
    expected = np.sqrt(gradient @ result.covariance @ gradient)
    assert model.static_gain_std_ * np.sqrt(n / (n - 4)) == pytest.approx(expected, rel=3e-3)


def test_a_gain_that_is_not_fitted_is_one():
    X = steps([0.0, 1.0, -1.0], hold=20.0, dt=0.02)
    model = KelvinVoigt(2, hold="zoh", fit_gain=False).fit(X, stepped(X, 0.0) / GAIN)
    assert model.operator_.gain == 1.0
    np.testing.assert_allclose(np.sort(model.operator_.compliances), COMPLIANCES, rtol=1e-4)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_do_not_matter(scale):
    X = multisine(1000, band=(10.0, 100.0), n_periods=3, dt=1e-3, random_state=0)
    y = periodic(X, 3)
    errors = []
    for factor in (1.0, scale):
        with pytest.warns(ConvergenceWarning):
            model = KelvinVoigt(1, initial_state="estimate").fit(factor * X, y)
        assert "static_gain" in model.identifiability_["undetermined"]
        errors.append(model.static_gain_std_ / abs(model.static_gain_))
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.02)
