"""The size of noise on what is smooth, from differences of neighbours."""

import numpy as np
import pytest
from scipy.signal import lfilter

from skhyst.noise import difference_noise, largest_noise, white_noise_floor
from skhyst.noise._differences import _without_edges

N = 4000


def white(seed, n=N):
    return 0.1 * np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize("size", [0.0, 1.0, 100.0])
def test_white_noise_shows_its_size_on_what_is_smooth(size):
    smooth = size * np.sin(2.0 * np.pi * np.arange(N) / 400.0)
    found = [difference_noise([white(seed) + smooth]) for seed in range(20)]
    # fourth differences of white noise vary by 1.6 / sqrt(n); the least of three is a little less
    np.testing.assert_allclose(found, 0.1, rtol=0.09)
    assert np.mean(found) == pytest.approx(0.1, rel=0.03)


def test_a_misfit_of_ten_times_the_noise_does_not_matter():
    n = np.arange(N)
    misfits = [np.sin(n / 40.0), np.log1p(n / 50.0), np.abs(np.sin(n / 100.0)), n > 1500]
    for seed, misfit in enumerate(misfits):
        left = white(seed) + misfit / np.std(misfit)
        assert difference_noise([left]) == pytest.approx(0.1, rel=0.05)


def test_edges_do_not_count():
    edges = 50.0 * np.cumsum(np.arange(N) % 200 == 0)
    assert difference_noise([white(0) + edges]) == pytest.approx(0.1, rel=0.06)


@pytest.mark.parametrize("coefficient", [0.5, 0.9])
def test_of_a_first_order_process_it_is_what_its_spectrum_gives(coefficient):
    """The mean of S (2 sin(pi f))^(2p) over binom(2p, p), which falls with the order p."""
    noise = np.random.default_rng(1).standard_normal(50 * N) * np.sqrt(1.0 - coefficient**2)
    noise = lfilter([1.0], [1.0, -coefficient], noise)
    correlation = coefficient ** np.arange(5)
    weights = np.array([70.0, -112.0, 56.0, -16.0, 2.0])
    assert difference_noise([noise]) == pytest.approx(
        np.sqrt(weights @ correlation / 70.0), rel=0.01
    )


def test_a_gap_is_not_seen():
    own = white(2)
    own[1000:1010] = np.nan
    own[1010:] += 100.0
    assert difference_noise([own]) == pytest.approx(0.1, rel=0.06)
    assert np.isnan(difference_noise([np.array([1.0, np.nan, 2.0])]))


def test_units_do_not_matter():
    assert difference_noise([4.0 * white(3)]) == pytest.approx(4.0 * difference_noise([white(3)]))


@pytest.mark.parametrize("period", [60, 188, 400, 3000])
@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_smooth_signal_has_no_noise(period, unit):
    smooth = unit * np.sin(2.0 * np.pi * np.arange(2000) / period + 0.1)
    assert white_noise_floor(smooth) == 0.0
    noisy = smooth + unit * white(4, 2000)
    for noise in (white_noise_floor, largest_noise):
        assert noise(noisy) == pytest.approx(0.1 * unit, rel=0.15)
        assert noise(10.0 * smooth + unit * white(4, 2000)) == pytest.approx(0.1 * unit, rel=0.15)


def test_eighty_samples_tell_of_noise():
    floors = [white_noise_floor(white(seed, 80)) for seed in range(20)]
    assert np.count_nonzero(floors) > 10
    assert [white_noise_floor(white(seed, 79)) for seed in range(20)] == [0.0] * 20
    assert white_noise_floor(np.zeros(80)) == 0.0


def test_noise_whose_neighbours_resemble_each_other_is_not_white():
    """Differences of means of two neighbours shrink by 4 % at the tenth order: 4,000 show it."""
    floors = [white_noise_floor(np.convolve(white(seed, N + 1), [1, 1])) for seed in range(20)]
    assert np.count_nonzero(floors) <= 8  # 1 % beyond the limit, which scatters by 0.9 %
    assert all(white_noise_floor(white(seed)) > 0.0 for seed in range(10))


@pytest.mark.parametrize(("height", "inside"), [(2.6, True), (2.7, False)])
def test_an_edge_is_what_normal_noise_exceeds_less_than_once_in_as_many(height, inside):
    """Of 99 ones and one x, (99 + x^2) / 100 times 2.576^2 is 2.65^2 at x = 2.65."""
    values = np.append(np.resize([1.0, -1.0], 99), height)
    right = np.sqrt((99.0 + height**2) / 100.0) if inside else 1.0
    assert _without_edges(values) == pytest.approx(right)
