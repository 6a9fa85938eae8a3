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
    lost_samples,
    reaction_p_value,
)

SIDE = 8
OFF = 2.0**45


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_rounding_leaves_something_beside_a_straight_line(unit):
    """It is no larger than that of a sum of so many: no ratio is infinite, or tells a loss."""
    rows = np.arange(50, 150)
    stretches = _Stretches(np.linspace(0.0, unit, 200), SIDE)
    assert (stretches.residual_around(rows) > 0.0).all()
    assert (stretches.residual_around(rows) < 1e-25).all()
    assert (stretches.ratio(rows, 0) >= 0.0).all()
    assert (stretches.ratio(rows, 0) < 2.0).all()


def test_stretches_have_no_offset():
    """Whole numbers keep all their digits beside a large one."""
    codes = np.random.default_rng(0).integers(0, 8, size=100).astype(float)
    plain, other = (
        _Stretches(own, SIDE).residual(np.array([50]), 2) for own in (codes, OFF + codes)
    )
    np.testing.assert_allclose(other, plain, rtol=1e-9)


@pytest.mark.parametrize("lost", [0, 1, 6])
def test_samples_on_one_cubic_leave_nothing(lost):
    """Of others least squares leave what the regression on a cubic of their times does."""
    time = np.delete(np.arange(80.0), 40 + np.arange(lost))
    stretches = _Stretches(time**3 - 40.0 * time**2, SIDE)
    row = np.array([40])
    assert stretches.residual(row, lost) < 1e-20
    noise = np.random.default_rng(lost).normal(size=80)
    near = np.arange(40 - SIDE, 40 + SIDE)
    rest = noise[near] - np.polynomial.Polynomial.fit(time[near], noise[near], 3)(time[near])
    assert _Stretches(noise, SIDE).residual(row, lost) == pytest.approx(
        rest @ rest / np.ptp(noise) ** 2
    )


def cut(row, lost, n):
    """Return a drive and a response that lose so many samples before a row of n that are left."""
    time = np.delete(np.arange(n + lost), row + np.arange(lost)) - row
    noise = 1e-3 * np.random.default_rng(n).normal(size=(2, n))
    u = np.sin(0.03 * time) + 0.3 * np.cos(0.02 * time) + noise[0]
    return u, 3.0 * u + noise[1]


def losses(u, y):
    return [(row, number) for rows, number in lost_samples(u, y) for row in rows]


@pytest.mark.parametrize("lost", [1, 2, 3, 8, 10])
@pytest.mark.parametrize(("row", "n"), [(32, 64), (32, 200), (101, 200), (168, 200)])
def test_a_loss_is_found_that_has_two_stretches_on_either_side(row, n, lost):
    """A stretch has 16 samples; its neighbours are what the misfit is compared with."""
    assert losses(*cut(row, lost, n)) == [(row, lost)]


@pytest.mark.parametrize(
    ("row", "n", "lost"),
    [(31, 200, 4), (169, 200, 4), (31, 63, 4), (10, 30, 4), (100, 200, 0), (100, 200, 16)],
)
def test_of_others_nothing_is_said(row, n, lost):
    assert losses(*cut(row, lost, n)) == []


def test_several_losses_are_told_one_by_one():
    time = np.delete(np.arange(700), [*range(100, 103), *range(310, 317), *range(520, 523)])
    u = np.sin(0.03 * (time - 100))  # twice a turn later it is as steep
    y = u + 1e-3 * np.random.default_rng(0).normal(size=len(u))
    (rows, first), (row, second) = lost_samples(u, y)
    assert (first, rows.tolist()) == (3, [100, 510])
    assert (second, row.tolist()) == (7, [307])


def test_both_channels_tell_of_a_loss():
    u, y = cut(100, 5, 200)
    rng = np.random.default_rng(0)
    whole = np.sin(0.03 * np.arange(200))
    assert losses(u, whole + 1e-3 * rng.normal(size=200)) == []  # a drive that jumps ahead
    assert losses(whole, y) == []
    assert losses(u, 1e3 * rng.normal(size=200)) == []  # a response of noise does not show it
    assert losses(u, np.zeros(200)) == losses(np.zeros(200), y) == []
    corner = np.abs(np.arange(200) - 100.5)
    assert losses(corner, 3.0 * corner + 1e-3 * rng.normal(size=200)) == []


def test_noise_is_no_loss():
    """At the level of one in a thousand records."""
    for seed in range(20):
        u, y = np.random.default_rng(seed).normal(size=(2, 200))
        assert losses(u, y) == losses(u, u) == []


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
    assert are_exchanged(answer, 5.0 - unit * command)
    assert not are_exchanged(answer[::-1], unit * command[::-1])  # it would lag
    assert not are_exchanged(command, unit * answer)
    assert not are_exchanged(answer, unit * (command + 0.01 * rng.normal(size=n)))
