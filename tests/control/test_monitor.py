"""The monitor: how often it is wrong, how soon it is right, and what it names."""

import copy
import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter, sawtooth
from scipy.stats import chi2, kstest

from skhyst.compose import Cascade
from skhyst.control import Monitor, Observer
from skhyst.control._local_tests import LocalTests, statistics
from skhyst.control._monitor import _Columns
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import Series

DT, PERIOD, NOISE = 1e-3, 200, 0.02
WEIGHTS, FREQUENCY, DAMPING = np.array([1.0, 0.4, 0.3]), 2.0 * np.pi * 60.0, 0.03


def drive(n, rng):
    """Return triangles of 5 Hz whose amplitude changes."""
    periods = np.arange(n) / PERIOD
    sizes = rng.uniform(2.0, 6.0, int(periods[-1]) + 2)
    wave = sawtooth(2.0 * np.pi * (periods + 0.25), 0.5)
    return np.interp(periods, np.arange(len(sizes)), sizes) * wave


def respond(u, weights=WEIGHTS, frequency=FREQUENCY, damping=DAMPING):
    plays = PrandtlIshlinskiiOperator(np.arange(3.0), np.asarray(weights))
    stages = plays, SecondOrderModeOperator(frequency, damping)
    return Series(("plays", "mode"), stages).run(u, DT)[0]


def service(n, rng, start=0, **changed):
    """Return the drive and the reading of a device that is another one from a sample on."""
    u = drive(n, rng)
    noise = NOISE * rng.normal(size=n)
    return u, np.r_[respond(u)[:start], respond(u, **changed)[start:]] + noise


@pytest.fixture(scope="module")
def monitor():
    u, y = service(20000, np.random.default_rng(0))
    steps = [
        ("plays", PrandtlIshlinskii(thresholds=np.arange(3.0))),
        ("mode", SecondOrderMode()),
    ]
    return Monitor(Observer(Cascade(steps, dt=DT)), false_alarms=1e-4).fit(u[:, None], y)


def test_false_alarms(monitor):
    """A hundred are expected, and fewer only where several lengths tell at once."""
    u, y = service(1_000_000, np.random.default_rng(1))
    assert 50 <= monitor.alarms(u[:, None], y).sum() <= 200


def test_the_statistic_is_chi_square_whatever_the_directions():
    """Two of three sensitivities are the same: two degrees of freedom are seen."""
    rng = np.random.default_rng(0)
    psi = rng.normal(size=(2000, 50, 3))
    psi[:, :, 2] = psi[:, :, 1]
    psi = psi @ rng.normal(size=(3, 3))
    noise = rng.normal(size=(2000, 50))
    scores = np.einsum("kip,ki->kp", psi, noise)
    statistic, rank = statistics(scores, psi.swapaxes(1, 2) @ psi)
    assert (rank == 2).all()
    assert kstest(statistic, "chi2", args=(2,)).pvalue > 1e-3


def test_what_the_fit_does_not_know_is_no_change():
    """A device is anywhere within the uncertainty of the fit: the level is as it was."""
    rng = np.random.default_rng(1)
    n, level = 4000, 0.05
    fit = rng.normal(size=(8, 25, 2))
    known = fit.swapaxes(1, 2) @ fit
    tests = LocalTests(np.zeros((8, 2)), known, 10**8, level / 25.0, 25)
    tests.limits = np.array([[np.inf, chi2.isf(level, 1), chi2.isf(level, 2)]])
    factor = np.linalg.cholesky(np.linalg.inv(known.sum(axis=0)))
    found = 0
    for _ in range(n):
        psi = rng.normal(size=(200, 2))
        e = psi @ factor @ rng.normal(size=2) + rng.normal(size=200)
        found += tests.decide((psi.T @ e)[None], (psi.T @ psi)[None])[0]
    assert abs(found / n - level) < 4.0 * np.sqrt(level / n)


def test_limits_share_the_rate():
    """Each length has the same part of the hits a sample."""
    information = np.tile(np.eye(2), (8, 1, 1))
    scores = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] * 2)
    limits = LocalTests(scores, information, 10**8, 1e-3, 10).limits
    lengths = 10 * 2 ** np.arange(4)
    np.testing.assert_allclose(np.exp(-limits[:, 2] / 2.0) / lengths, 1e-3 / 4.0, rtol=1e-5)
    # sums that vary nine times as much as noise does ask for as much more
    wide = LocalTests(3.0 * scores, information, 10**8, 1e-3, 10).limits
    assert wide[0, 2] > 4.0 * limits[0, 2]


def test_colour_that_the_fit_has_left_is_no_change():
    rng = np.random.default_rng(2)

    def recorded(n):
        u = drive(n, rng)
        noise = lfilter([1.0], [1.0, -0.9], NOISE * rng.normal(size=n))
        return u[:, None], FirstOrderLagOperator(0.05).run(u, DT)[0] + noise

    white = {"disturbance": None, "process_std": 0.0}
    observer = Observer(FirstOrderLag(dt=DT), **white)
    monitor = Monitor(observer, false_alarms=1e-3).fit(*recorded(20000))
    assert monitor.whitening_[1] == pytest.approx(-0.9, abs=0.02)
    assert 50 <= monitor.alarms(*recorded(100_000)).sum() <= 200


def stretches(rng, n=60, size=40, p=3):
    """Return sensitivities of stretches of samples (n, size, p) that are unlike each other."""
    return rng.normal(size=(n, size, p)) @ rng.normal(size=(n, p, p))


def test_the_energy_of_a_misfit_grows_no_faster_than_the_length():
    """Cauchy and Schwarz: T of a sum is at most the sum of T, with equality where all are alike."""
    rng = np.random.default_rng(0)
    psi = stretches(rng)
    scores, information = rng.normal(size=(60, 3)), psi.swapaxes(1, 2) @ psi
    whole, _ = statistics(scores.sum(axis=0)[None], information.sum(axis=0)[None])
    assert whole[0] <= statistics(scores, information)[0].sum()
    alike, _ = statistics(5.0 * scores[:1], 5.0 * information[:1])
    assert alike[0] == pytest.approx(5.0 * statistics(scores[:1], information[:1])[0][0])


def test_sums_of_the_fit_are_those_of_parts_held_out():
    """T with the covariance that the fit leaves is that of a part under the fit of the others."""
    rng = np.random.default_rng(1)
    psi = stretches(rng, n=4)
    e = rng.normal(size=(4, 40))
    fit = np.linalg.lstsq(psi.reshape(-1, 3), e.ravel(), rcond=None)[0]
    scores = np.einsum("kip,ki->kp", psi, e - psi @ fit)
    information = psi.swapaxes(1, 2) @ psi
    rest = np.linalg.lstsq(psi[1:].reshape(-1, 3), e[1:].ravel(), rcond=None)[0]
    score = psi[0].T @ (e[0] - psi[0] @ rest)
    own = information[0]
    covariance = own + own @ np.linalg.solve(information[1:].sum(axis=0), own)
    expected = score @ np.linalg.solve(covariance, score)
    left = own - own @ np.linalg.solve(information.sum(axis=0), own)
    assert statistics(scores[:1], left[None])[0][0] == pytest.approx(expected)


def test_misfit_is_found_where_drives_are_alike():
    """Parameters that differ between two kinds of blocks, which come in turn, by 2 d."""
    rng = np.random.default_rng(2)
    information = np.tile(50.0 * np.eye(3), (200, 1, 1))
    noise = np.sqrt(50.0) * rng.normal(size=(200, 3))
    kinds = np.tile([1.0, -1.0], 100)
    scores = noise + 50.0 * 0.07 * kinds[:, None] * [1.0, 0.0, 0.0]
    scores -= scores.mean(axis=0)
    sort = [np.argsort(kinds, kind="stable")]
    wide = LocalTests(scores, information, 10**8, 1e-3, 10, sort)
    # beside the other half, from which it differs by 2 d, half of the blocks has the energy of
    # 50 (2 d)^2 / 2 a block
    assert 0.9 < wide.misfit / (50.0 * 2.0 * 0.07**2) < 3.0
    # one kind makes up for the other where they come in turn
    assert LocalTests(scores, information, 10**8, 1e-3, 10).misfit == 0.0
    assert LocalTests(noise - noise.mean(axis=0), information, 10**8, 1e-3, 10, sort).misfit == 0.0


RADII, SIZES = np.array([0.3, 0.8, 1.5, 2.5, 4.0]), np.array([0.06, 0.05, 0.05, 0.04, 0.03])
TIMES = 1e-3 * np.arange(8000)


def other(u, seed, gain=1.0):
    """Return the reading of a device of plays at thresholds that its model does not have."""
    states, y = np.zeros(5), np.empty(len(u))
    for k, value in enumerate(u):
        states = np.minimum(np.maximum(states, value - RADII), value + RADII)
        y[k] = 0.9 * value + states @ SIZES
    return gain * y + 2e-3 * np.random.default_rng(seed).normal(size=len(u))


@pytest.fixture(scope="module")
def inexact():
    u = 5.0 * np.sin(2.0 * np.pi * TIMES) * np.exp(-0.2 * TIMES)
    y = other(u, 0)
    model = PrandtlIshlinskii(20, dt=1e-3).fit(u[:, None], y)
    return Monitor(Observer(model), false_alarms=1e-6).fit(u[:, None], y), u, y


def test_a_model_that_is_close_and_not_exact_keeps_the_promise(inexact):
    monitor, u, y = inexact
    assert monitor.misfit_ > 0.0
    assert not monitor.alarms(u[:, None], y).any()
    for size in (1.0, 3.0, 4.9):
        v = size * np.sin(1.4 * np.pi * TIMES) * np.sin(4.6 * np.pi * TIMES)
        for seed in (1, 2):
            found, judged = monitor.alarms(v[:, None], other(v, seed), return_judged=True)
            assert not found.any()
            assert judged.any()
            assert judged.all() or size > 1.0  # 4.9 and 3 are faster than the drive of the fit


def test_of_a_model_that_is_not_exact_a_change_beyond_the_misfit_is_found(inexact):
    """And named, though the random walk has followed it up to the alarm."""
    monitor, u, _ = inexact
    assert np.argmax(monitor.alarms(u[:, None], other(u, 5, gain=1.01))) >= 256
    assert monitor.suspect_[0] == "gain"
    assert "offset" not in monitor.suspect_


def test_an_exact_model_has_no_misfit(monitor):
    assert monitor.misfit_ == 0.0


@pytest.mark.parametrize(("size", "start"), [(0.1, 4 * PERIOD), (-0.5, 4 * PERIOD + 33)])
def test_an_offset_is_a_suspect_of_its_own(monitor, size, start):
    u, y = service(14 * PERIOD, np.random.default_rng(8))
    y[start:] += size
    assert monitor.alarms(u[:, None], y).any()
    assert monitor.suspect_ == ("offset",)


def test_what_no_change_explains_is_another(monitor):
    """A sensor that hangs is neither an offset nor a gain."""
    u, y = service(14 * PERIOD, np.random.default_rng(8))
    y[4 * PERIOD :] = y[4 * PERIOD]
    with pytest.warns(ConvergenceWarning, match="same device"):
        assert monitor.alarms(u[:, None], y).any()
    assert monitor.suspect_ == ("other",)


def test_an_offset_of_a_device_that_the_model_is_close_to(inexact):
    monitor, u, _ = inexact
    y = other(u, 3)
    y[4000:] += 0.05
    assert monitor.alarms(u[:, None], y).any()
    assert monitor.suspect_ == ("offset",)


@pytest.mark.parametrize("drives", ["larger", "faster"])
def test_what_the_fit_has_not_seen_is_not_judged(monitor, drives):
    """A device that has changed a lot, where its drive is beyond that of the fit."""
    u, y = service(4 * PERIOD, np.random.default_rng(9))
    n = len(u) // 64 * 64
    found, judged = monitor.alarms(u[:, None], y, return_judged=True)
    assert not found.any()
    np.testing.assert_array_equal(judged, np.arange(len(u)) < n)
    beyond = 3.0 * u if drives == "larger" else np.tile(u[::4], 4)[: len(u)]
    limit = {"larger": np.abs(beyond), "faster": np.abs(np.diff(beyond, prepend=0.0))}[drives]
    own = {"larger": np.abs(u), "faster": np.abs(np.diff(u, prepend=0.0))}[drives]
    changed = respond(beyond, weights=1.5 * WEIGHTS)
    found, judged = monitor.alarms(beyond[:, None], changed, return_judged=True)
    is_beyond = (limit[:n] > 1.5 * own.max()).reshape(-1, 64).any(axis=1)
    assert is_beyond.any()
    assert not judged[:n].reshape(-1, 64)[is_beyond].any()
    assert not found[~judged].any()
    monitor.reset()
    for k in range(64 * 4):
        monitor.update(beyond[k], changed[k])
        if k % 64 == 63:
            assert monitor.judged == judged[k]


def test_beyond_the_drives_of_the_fit_there_is_no_suspicion(monitor):
    u = np.full(640, 20.0)
    found, judged = monitor.alarms(u[:, None], np.arange(640.0), return_judged=True)
    assert not found.any()
    assert not judged.any()
    assert monitor.suspect_ == ()


def test_sensitivities_are_tangents(monitor):
    """Of an observer without noise of its own, the innovations are what the free run leaves."""
    u, y = service(2000, np.random.default_rng(3))
    model = monitor.observer_.model_
    plain = Observer(model, disturbance=None, process_std=0.0)
    own = Monitor(plain).fit(u[:, None], y)
    own.whitening_ = np.ones(1)
    found = _Columns(own, DT, u[0]).run(np.column_stack([u, y]))
    np.testing.assert_allclose(found[:, 0], y - model.predict(u[:, None]), atol=1e-12)
    _, tangents = model.operator_.sensitivities(u, np.empty((len(u), 0)), DT)
    names = [name for name, _ in model.operator_.entries()]
    expected = tangents[:, [names.index(name) for name in own.parameters_]]
    error = np.abs(found[:, 1:] - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert error.max() < 1e-4


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"weights": 0.98 * WEIGHTS}, "gain"),
        ({"weights": WEIGHTS * [1.03, 1.0, 1.0]}, "plays__weights[0]"),
        ({"weights": WEIGHTS * [1.0, 1.0, 1.1]}, "plays__weights[2]"),
        ({"frequency": 1.01 * FREQUENCY}, "mode__natural_frequency"),
        ({"damping": 1.2 * DAMPING}, "mode__damping_ratio"),
    ],
)
def test_a_change_is_found_and_named(monitor, changed, name):
    u, y = service(14 * PERIOD, np.random.default_rng(4), 4 * PERIOD, **changed)
    found = np.flatnonzero(monitor.alarms(u[:, None], y))
    assert found[0] >= 4 * PERIOD
    assert monitor.suspect_[0] == name


def test_what_looks_alike_is_told_together():
    """Under a slow drive a lag and a damped mode are both a delay."""
    rng = np.random.default_rng(5)

    def respond(u, time_constant=2e-3):
        stages = FirstOrderLagOperator(time_constant), SecondOrderModeOperator(1000.0, 0.5)
        y, _ = Series(("lag", "mode"), stages).run(u, DT)
        return y + 5e-3 * rng.normal(size=len(u))

    u = rng.normal(size=20000)
    model = Cascade([("lag", FirstOrderLag()), ("mode", SecondOrderMode())], dt=DT)
    monitor = Monitor(Observer(model)).fit(u[:, None], respond(u))
    u = 3.0 * np.sin(4.0 * np.pi * DT * np.arange(4000)) ** 2
    monitor.alarms(u[:, None], respond(u, 2.1e-3))
    assert {"lag__time_constant", "mode__damping_ratio"} <= set(monitor.suspect_)


@pytest.mark.parametrize(("changed", "alarm"), [({}, False), ({"frequency": 0.9}, True)])
def test_lost_rows_are_no_change(monitor, changed, alarm):
    changed = {name: factor * FREQUENCY for name, factor in changed.items()}
    u, y = service(4000, np.random.default_rng(7), start=1000, **changed)
    kept = np.ones(4000, dtype=bool)
    kept[np.random.default_rng(8).choice(np.arange(1, 3999), 100, replace=False)] = False
    kept[monitor.block - 1 :: monitor.block][2:6] = False  # an alarm comes at the next row
    index = pd.Index(DT * np.arange(4000), name="time")
    X, y = pd.DataFrame(u, index)[kept], pd.Series(y, index)[kept]
    alarms, judged = monitor.alarms(X, y, return_judged=True)
    assert alarms.shape == judged.shape == (kept.sum(),)
    assert judged.any()
    assert not alarms[:900].any()
    assert alarms.any() == alarm


def test_samples_one_by_one(monitor):
    u, y = service(1500, np.random.default_rng(6), 700, frequency=1.02 * FREQUENCY)
    expected = monitor.alarms(u[:, None], y)
    suspect = monitor.suspect_
    assert suspect
    monitor.reset()
    assert monitor.suspect_ == ()
    found = []
    for k, row in enumerate(zip(u, y, strict=True)):
        monitor.update(*row)
        found.append(monitor.drift_detected)
        if k == 710:  # in the middle of a block
            copies = [pickle.loads(pickle.dumps(monitor)), copy.copy(monitor)]
            copies.append(copy.copy(copies[-1]))
    np.testing.assert_array_equal(found, expected)
    for copied in copies:
        for k in range(711, len(u)):
            copied.update(u[k], y[k])
            assert copied.drift_detected == expected[k]
    assert copies[0].suspect_ == suspect
    assert monitor.suspect_ == suspect
    again = pickle.loads(pickle.dumps(monitor))
    assert again.suspect_ == suspect
    np.testing.assert_array_equal(again.alarms(u[:, None], y), expected)


def test_what_is_refused_changes_nothing(monitor):
    u, y = service(130, np.random.default_rng(7))
    expected = monitor.alarms(u[:, None], y)
    monitor.reset()
    for k in range(130):
        for row in ((np.nan, y[k]), (u[k], np.inf), ([u[k], 0.0], y[k])):
            with pytest.raises(ValueError, match="must be 2 finite numbers"):
                monitor.update(*row)
        monitor.update(u[k], y[k])
        assert monitor.drift_detected == expected[k]


def test_parameters_to_watch(monitor):
    u, y = service(20000, np.random.default_rng(0))
    names = ["mode__natural_frequency", "mode__damping_ratio"]
    some = Monitor(monitor.observer_, parameters=names).fit(u[:, None], y)
    assert some.parameters_ == names
    with pytest.raises(ValueError, match=r"'parameters' parameter of Monitor .* Got \['gain'\]"):
        Monitor(monitor.observer_, parameters=["gain"]).fit(u[:, None], y)
    with pytest.raises(ValueError, match="sensitive to no parameter"):
        Monitor(monitor.observer_, parameters=names).fit(0.0 * u[:, None], y)
