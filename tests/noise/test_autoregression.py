"""Filters that make noise white."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from skhyst.noise import autoregression, whitening_filter
from skhyst.noise._autoregression import _candidates


def test_octaves_are_the_least_squares_of_equal_coefficients():
    covariance = 0.9 ** np.arange(100) + 0.2 * np.cos(0.1 * np.arange(100))
    edges = [0, 1, 2, 4, 8, 16, 32, 64]
    *of_octaves, _ = _candidates(covariance, 0)
    assert [count for *_, count in of_octaves] == [3, 4, 5, 6, 7]
    for weights, left, count in of_octaves:
        n = edges[count]
        same = np.repeat(np.eye(count), np.diff(edges[: count + 1]), axis=0)
        inner, right = toeplitz(covariance[:n]), covariance[1 : n + 1]
        own = np.linalg.solve(same.T @ inner @ same, same.T @ right)
        np.testing.assert_allclose(weights, same @ own, rtol=1e-6, atol=1e-9)
        assert left == pytest.approx(covariance[0] - weights @ right)


def test_an_autoregression_is_found_with_its_innovations():
    phi = np.array([1.2, -0.7])
    covariance = np.linalg.solve(
        [[1.0, -phi[0], -phi[1]], [-phi[0], 1.0 - phi[1], 0.0], [-phi[1], -phi[0], 1.0]],
        [1.0, 0.0, 0.0],
    ).tolist()
    for _ in range(40):
        covariance.append(phi[0] * covariance[-1] + phi[1] * covariance[-2])
    weights, power = autoregression(np.array(covariance), 1000)
    np.testing.assert_allclose(weights, [1.0, *-phi], atol=1e-9)
    assert power == pytest.approx(1.0)


def test_flicker_noise_is_followed_over_decades():
    """Its spectrum by few coefficients, where a short memory ends in a plateau."""
    n = 4096
    frequency = np.fft.rfftfreq(2 * n)
    power = np.append(0.0, 1.0 / frequency[1:])
    covariance = np.fft.irfft(power)[: n // 4]
    weights, left = autoregression(covariance, n)
    at = np.geomspace(4.0 / n, 0.4, 20)
    response = np.exp(-2j * np.pi * np.outer(at, np.arange(len(weights)))) @ weights
    decades = np.log10(left / np.abs(response) ** 2 * at)
    assert np.ptp(decades) < 0.35  # while the power falls by 2.6


def test_whitening_finds_the_filter():
    noise = lfilter([1.0], [1.0, -1.2, 0.5], np.random.default_rng(0).normal(size=(3, 5000)))
    np.testing.assert_allclose(whitening_filter(list(noise)), [1.0, -1.2, 0.5], atol=0.03)
    assert len(whitening_filter([np.random.default_rng(0).normal(size=5000)])) == 1
