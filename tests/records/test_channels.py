"""What drive and response say of each other: a theorem each, on signals made for it."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import f as fisher
from scipy.stats import kstest

from skhyst.noise import white_noise_floor
from skhyst.records._channels import (
    _innovations,
    _is_followed,
    _p_value,
    _predicted,
    _Stretches,
    are_exchanged,
    reaction_p_value,
)

SIDE = 8


def test_rounding_leaves_something_beside_a_straight_line():
    rows = np.arange(50, 150)
    assert (_Stretches(np.linspace(0.0, 1.0, 200), SIDE).residual_around(rows) > 0.0).all()


@pytest.mark.parametrize("lost", [0, 1, 5, 2 * SIDE])
@pytest.mark.parametrize("way", [1, -1])
def test_stretches_beside_a_row_do_not_see_across_it(lost, way):
    """One side is rough: what is left across the row is far more than beside it."""
    noise = np.random.default_rng(lost).normal(size=200)
    noise[100:] *= 1e4
    stretches = _Stretches(noise[::way], SIDE)
    assert stretches.ratio(np.array([100]), lost) > 1e4


def test_noise_of_the_response_hides_whether_it_follows():
    """A slow device is told from the noise on its drive, unless its own noise is in the way."""
    n = 1000
    smooth = np.sin(0.065 * np.arange(n)) + 0.5 * np.sin(0.15 * np.arange(n))
    slow = lfilter([0.05], [1.0, -0.95], smooth)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        u = smooth + 0.01 * rng.normal(size=n)
        floor = white_noise_floor(u)
        assert floor > 0.0
        assert not _is_followed(u, slow, floor)
        assert _is_followed(u, slow + 0.1 * rng.normal(size=n), floor)
        assert _is_followed(u, lfilter([0.05], [1.0, -0.95], u), floor)


def test_innovations_of_a_signal_have_no_offset():
    """Whole numbers keep all their digits beside a large one."""
    codes = np.random.default_rng(0).integers(0, 8, size=300).astype(float)
    plain, past = _innovations(codes, 6)
    np.testing.assert_allclose(_innovations(2.0**45 + codes, 6)[0], plain, atol=1e-6)
    np.testing.assert_allclose(past.T @ past, np.eye(7), atol=1e-12)
    np.testing.assert_allclose(past.T @ plain, 0.0, atol=1e-12)
    np.testing.assert_allclose(past @ (past.T @ codes[2:-4]), codes[2:-4], atol=1e-9)


def test_no_sample_dominates_innovations():
    """None is further off than three standard deviations of normal noise with that median."""
    noise = np.random.default_rng(0).laplace(size=2000)
    found, _ = _innovations(noise, 3)
    deviation = np.median(np.abs(found)) / 0.67449
    assert np.abs(found).max() == pytest.approx(3.0 * deviation, rel=0.1)


@pytest.mark.parametrize("used", [1, 7])
def test_columns_that_explain_nothing_have_the_p_value_of_an_f_test(used):
    """From the sums of squares of regressions with and without the columns."""
    rng = np.random.default_rng(used)
    columns, target = rng.normal(size=(60, 4)) + 3.0, rng.normal(size=60)
    target += 0.4 * columns[:, 1]
    target -= target.mean()
    basis = np.c_[np.ones(60), columns]
    without = target @ target
    left = target - basis @ np.linalg.lstsq(basis, target, rcond=None)[0]
    freedom = 60 - 4 - used
    ratio = (without - left @ left) / 4 / (left @ left / freedom)
    assert _p_value(target, columns, used) == pytest.approx(fisher.sf(ratio, 4, freedom))


@pytest.mark.parametrize("test", [reaction_p_value, _predicted])
def test_p_values_of_channels_without_relation_are_uniform(test):
    chances = []
    for seed in range(200):
        u, y = np.random.default_rng(seed).normal(size=(2, 150))
        chances.append(test(u, y))
    assert kstest(chances, "uniform").pvalue > 0.05
    past = np.random.default_rng(0).normal(size=400)
    follows = np.r_[0.0, past[:-1]] + np.random.default_rng(1).normal(size=400)
    assert test(follows, past) < 1e-6  # the first is driven by the past of the second
    assert test(past, follows) > 1e-3


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_a_reaction_has_no_unit(unit):
    rng = np.random.default_rng(0)
    noise = rng.normal(size=500)
    drive = rng.normal(size=500) + np.r_[0.0, 0.3 * noise[:-1]]
    p_value = reaction_p_value(drive, noise)
    assert 0.0 < p_value < 0.01
    assert reaction_p_value(unit * drive, noise) == pytest.approx(p_value, rel=1e-6)
    assert reaction_p_value(drive, unit * noise) == pytest.approx(p_value, rel=1e-6)


@pytest.mark.parametrize(
    ("n", "moves"), [(40, (True, True)), (500, (False, True)), (500, (True, False))]
)
def test_what_shows_nothing_of_a_reaction_is_no_evidence(n, moves):
    drive, noise = np.random.default_rng(0).normal(size=(2, n)) * np.array(moves)[:, None]
    assert reaction_p_value(drive, noise) == 1.0


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_a_response_with_noise_is_no_command(unit):
    """A smooth signal that leads a noisy one is the drive, whatever the columns are called."""
    rng, n = np.random.default_rng(0), 1000
    command = np.sin(0.065 * np.arange(n)) + 0.5 * np.sin(0.15 * np.arange(n))
    answer = lfilter([0.05], [1.0, -0.95], command) + 0.01 * rng.normal(size=n)
    assert are_exchanged(answer, unit * command)
    assert not are_exchanged(command, unit * answer)
    assert not are_exchanged(answer, unit * (command + 0.01 * rng.normal(size=n)))
