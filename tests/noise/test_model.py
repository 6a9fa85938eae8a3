"""What a sensor's noise is like."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from skhyst.noise import NoiseModel, fit_noise
from skhyst.noise._model import quantisation_step

N = 2000


def first_order(coefficient, rng, n=N):
    """Return a first-order process of unit variance."""
    innovations = rng.standard_normal(n + 200) * np.sqrt(1.0 - coefficient**2)
    return lfilter([1.0], [1.0, -coefficient], innovations)[200:]


def flicker(exponent, rng, n=N):
    """Return noise whose power falls with the frequency, of about unit variance."""
    gains = np.append(0.0, np.arange(1.0, 2 * n + 1) ** (-0.5 * exponent))
    noise = np.fft.irfft(np.fft.rfft(rng.standard_normal(4 * n)) * gains)
    return noise[:n] / noise.std()


def test_white_noise_is_white():
    laws = [
        fit_noise([np.random.default_rng([4100, k]).standard_normal(500)]).law for k in range(100)
    ]
    assert laws.count("white") >= 97  # two more parameters have to pay


@pytest.mark.parametrize("coefficient", [0.5, 0.9, 0.97])
def test_a_first_order_process_is_found(coefficient):
    rng = np.random.default_rng(4101)
    found = fit_noise([first_order(coefficient, rng) for _ in range(4)])
    assert found.law == "autoregressive"
    assert found.coefficient == pytest.approx(coefficient, abs=0.03)
    assert found.standard_deviation == pytest.approx(1.0, rel=0.15)
    assert found.share > 0.95


@pytest.mark.parametrize("exponent", [0.7, 1.0, 1.5])
def test_a_power_law_is_found(exponent):
    rng = np.random.default_rng(4102)
    found = fit_noise([flicker(exponent, rng) for _ in range(4)])
    assert found.law == "power_law"
    assert found.coefficient == pytest.approx(exponent, abs=0.1)


def test_pairs_of_readings_tell_the_size():
    assert fit_noise([np.array([5.0, 3.0])] * 50).standard_deviation == pytest.approx(1.0)


def test_white_noise_is_distinguished_from_a_colour_above_it():
    rng = np.random.default_rng(4103)
    series = [first_order(0.95, rng) + 0.5 * rng.standard_normal(N) for _ in range(4)]
    found = fit_noise(series)
    assert found.share == pytest.approx(0.8, abs=0.06)
    assert found.coefficient == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("coefficient", [0.5, 0.9])
def test_innovations_are_what_the_past_does_not_predict(coefficient):
    """Of a first-order process these are known: white, of the variance 1 - a^2."""
    rng = np.random.default_rng(4104)
    series = [first_order(coefficient, rng) for _ in range(4)]
    model = NoiseModel("autoregressive", 1.0, coefficient, 1.0)
    new = np.concatenate([own[5:] for own in model.innovations(series)])
    assert np.var(new) == pytest.approx(1.0 - coefficient**2, rel=0.05)
    assert abs(np.corrcoef(new[1:], new[:-1])[0, 1]) < 0.03
    own = series[0]
    np.testing.assert_allclose(
        model.innovations([own])[0][300:], (own[1:] - coefficient * own[:-1])[299:], atol=1e-3
    )


@pytest.mark.parametrize("share", [0.3, 0.8])
@pytest.mark.parametrize("coefficient", [0.5, 0.95])
def test_white_noise_beside_a_first_order_process_is_forecast_as_by_a_kalman_filter(
    coefficient, share
):
    """A step weighs what was k samples ago by g a (a (1 - g))^(k - 1), g the filter's gain."""
    model = NoiseModel("autoregressive", 1.0, coefficient, share)
    driven, white = share * (1.0 - coefficient**2), 1.0 - share
    ahead = share
    for _ in range(1000):
        ahead = coefficient**2 * ahead * white / (ahead + white) + driven
    gain = ahead / (ahead + white)
    weights = gain * coefficient * (coefficient * (1.0 - gain)) ** np.arange(100)
    impulse = np.r_[1.0, np.zeros(99)]
    (found,) = model.innovations([impulse])
    np.testing.assert_allclose(found, np.r_[1.0, -weights[:-1]], atol=1e-6)


def test_a_gap_ends_what_the_past_tells():
    """Behind it the innovations are those of a record of its own."""
    own = first_order(0.9, np.random.default_rng(4107))
    gap = np.where((np.arange(N) >= 700) & (np.arange(N) < 703), np.nan, own)
    model = NoiseModel("autoregressive", 1.0, 0.9, 1.0)
    (found,) = model.innovations([gap])
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(gap))
    parts = model.innovations([own[:700], own[703:]])
    np.testing.assert_array_equal(found[np.isfinite(found)], np.concatenate(parts))


@settings(max_examples=10, deadline=None)
@given(exponent=st.integers(-30, 30), offset=st.floats(-10, 10))
def test_units_and_offsets_do_not_matter(exponent, offset):
    rng, scale = np.random.default_rng(4105), 2.0**exponent
    own = first_order(0.8, rng, 500)
    own[::50] += 9.0
    plain, other = fit_noise([own]), fit_noise([scale * (own + offset)])
    assert other.law == plain.law
    assert other.coefficient == pytest.approx(plain.coefficient, rel=1e-3)
    assert other.standard_deviation == pytest.approx(scale * plain.standard_deviation)
    assert other.outliers == plain.outliers > 0.0
    exact = replace(plain, standard_deviation=scale * plain.standard_deviation)
    assert fit_noise([scale * own]) == exact  # a power of two rounds nothing


def test_outliers_are_counted():
    rng = np.random.default_rng(4106)
    noise = rng.standard_normal(N)
    assert fit_noise([noise]).outliers == 0.0
    noise[::100] += 12.0
    assert fit_noise([noise]).outliers == pytest.approx(0.01, abs=1e-3)


@settings(max_examples=20, deadline=None)
@given(step=st.floats(1e-9, 1e9), offset=st.integers(-1000, 1000))
def test_the_step_of_a_converter_is_found(step, offset):
    rng = np.random.default_rng(4107)
    codes = np.round(20.0 * np.sin(np.linspace(0.0, 30.0, N)) + rng.standard_normal(N)) + offset
    assert quantisation_step([step * codes]) == pytest.approx(step, rel=1e-6)
    assert quantisation_step([step * (codes + 0.3 * rng.random(N))]) == 0.0
    uneven = np.array([0.0, 1.0, 2.37, 3.1])  # levels that come again, of no converter
    assert quantisation_step([step * rng.choice(uneven, N)]) == 0.0


def test_nothing_has_no_law():
    assert fit_noise([np.zeros(50)]).standard_deviation == 0.0
    assert fit_noise([]).law == "white"


def test_it_is_put_into_words():
    model = NoiseModel("power_law", 0.2, 1.1, 0.7, 0.01, 0.05)
    for part in ("1.10", "0.2", "30 %", "1.00 % outliers", "steps of 0.05"):
        assert part in str(model)


@pytest.mark.parametrize("coefficient", [0.5, 0.9, 0.95])
def test_the_correlation_of_a_first_order_process_falls_to_1_over_e(coefficient):
    model = NoiseModel("autoregressive", 1.0, coefficient, 0.7)
    expected = np.ceil(-1.0 / np.log(coefficient))  # of the coloured part
    assert model.correlation_length(20_000) == expected
    assert NoiseModel("white", 1.0).correlation_length(100) == 0


def test_the_correlation_of_a_random_walk_grows_with_the_record():
    """About its mean it is that of a Brownian bridge on a circle, 1 - 6 x (1 - x), at 2 n."""
    model = NoiseModel("power_law", 1.0, 2.0, 1.0)
    x = 0.5 * (1.0 - np.sqrt(1.0 - 4.0 / 6.0 * (1.0 - 1.0 / np.e)))
    for n in (1000, 4000):
        assert model.correlation_length(n) == pytest.approx(2.0 * n * x, rel=0.01)
