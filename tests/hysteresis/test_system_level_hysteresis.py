"""Identification of the system-level model, with the values of the paper."""

import warnings

import numpy as np
import pandas as pd
import pytest

from skhyst.hysteresis import SystemLevelHysteresis, SystemLevelOperator

PAPER = {"delta_d": 0.4783, "gamma": -370.47, "v_c": 24629.0}  # identified there
H_S = 1967.0
DT = 5e-4


def paper_drive():
    """0.5 Hz, 100 V from peak to peak, never negative; two periods."""
    time = DT * np.arange(int(4.0 / DT))
    return 50.0 - 50.0 * np.cos(2 * np.pi * 0.5 * time)


def printed_response(u, delta_d, gamma, v_c, h_s):
    """Equation (22), the turning points of this drive known."""
    shift = np.where(np.arange(u.size) * DT % 2.0 < 1.0 + DT / 2, 0.0, 100.0)
    rate = np.diff(u, prepend=u[0]) / DT
    return delta_d * (1.0 - gamma * np.exp(-np.abs(u - shift) / v_c)) * u + h_s * rate


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_published_values_as_printed(noise):
    """The initial slope, the ratio of gamma and V_c, and h_s come back to the printed digits."""
    u = paper_drive()
    clean = printed_response(u, **PAPER, h_s=H_S)
    y = clean + noise * clean.std() * np.random.default_rng(0).normal(size=u.size)
    model = SystemLevelHysteresis("printed", dt=DT).fit(u[:, None], y)
    truth = SystemLevelOperator.from_paper(**PAPER, h_s=H_S, variant="printed")
    tolerance = 1e-5 if noise else 1e-7
    assert model.params_["slope"] == pytest.approx(0.4783 * 371.47, rel=10 * tolerance)
    assert model.params_["rate_gain"] == pytest.approx(H_S, rel=10 * tolerance)
    for name in ("slope", "curvature", "decay", "rate_gain"):
        error = abs(model.params_[name] - getattr(truth, name))
        assert not error > 4 * model.params_std_[name] + 1e-4 * abs(getattr(truth, name))
    if not noise:
        ratio = model.params_["curvature"] / 0.4783
        assert ratio == pytest.approx(-370.47 / 24629.0, rel=1e-4)


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_published_values_in_the_integral(noise):
    """With noise only the ratio of gamma and V_c is seen, and the standard error of 1 / V_c."""
    u = paper_drive()
    truth = SystemLevelOperator.from_paper(**PAPER)
    clean, _ = truth.run(u, DT)
    y = clean + noise * clean.std() * np.random.default_rng(0).normal(size=u.size)
    model = SystemLevelHysteresis(dt=DT).fit(u[:, None], y)
    assert model.params_["slope"] == pytest.approx(truth.slope, rel=1e-4)
    if noise:
        assert model.params_["curvature"] == pytest.approx(truth.curvature, rel=0.05)
        assert not model.params_std_["decay"] < 3 * truth.decay
    else:
        assert model.params_["curvature"] == pytest.approx(truth.curvature, rel=1e-4)
        assert model.params_["decay"] == pytest.approx(truth.decay, rel=1e-2)


# ------------------------------------------------------------------------------------- recovery


def quadrature(u, slope, curvature, decay, parts=40):
    """Integrate (15) by the midpoint rule between samples, from zero."""
    path = np.concatenate([[0.0], u])
    fractions = (np.arange(parts) + 0.5) / parts
    points = path[:-1, None] + np.diff(path)[:, None] * fractions
    turning, direction, y, total = 0.0, 0.0, [], 0.0
    for k, step in enumerate(np.diff(path)):
        if np.sign(step) not in (0.0, direction):
            turning, direction = path[k], np.sign(step)
        growth = (1.0 - np.exp(-decay * np.abs(points[k] - turning))) / decay
        total += step * np.mean(slope + curvature * growth)
        y.append(total)
    return np.array(y)


def plant(seed, variant, n=900, dt=1e-3):
    rng = np.random.default_rng(seed)
    amplitude, size = 10.0 ** rng.uniform(-6, 4, 2)
    time = dt * np.arange(n)
    u = (
        0.5
        * amplitude
        * (1.2 - np.cos(2 * np.pi * 5 * time))
        * np.interp(time, [0.0, 0.3, 0.3001, 0.6, 0.6001, 0.9], [1.0, 1.0, 0.7, 0.7, 0.4, 0.4])
    )
    truth = {
        "slope": size / amplitude * rng.uniform(0.5, 1.0),
        "curvature": size / amplitude**2 * rng.uniform(1.0, 3.0) * rng.choice([-1, 1]),
        "decay": rng.uniform(1.5, 6.0) / amplitude,
    }
    if variant == "integral":
        clean = quadrature(u, **truth)
    else:
        truth["rate_gain"] = size / amplitude * rng.uniform(-0.005, 0.005)
        clean = printed_plant(u, dt, **truth)
    truth["intercept"] = size * rng.uniform(-1, 1)
    clean = clean + truth["intercept"]
    noise = 0.005 * clean.std()
    return u, clean, clean + noise * rng.normal(size=n), noise, truth


def printed_plant(u, dt, slope, curvature, decay, rate_gain):
    """Equations (21) and (22) with the turning points from the signs of the differences."""
    step = np.diff(u, prepend=0.0)
    y, shift, direction, last = [], 0.0, 0.0, 0.0
    for value, change in zip(u, step, strict=True):
        if change * direction < 0.0:
            shift = last
        direction = np.sign(change) or direction
        y.append((slope + curvature * -np.expm1(-decay * abs(value - shift)) / decay) * value)
        last = value
    return np.array(y) + rate_gain * np.diff(u, prepend=u[0]) / dt


@pytest.mark.parametrize("variant", ["integral", "printed"])
def test_recovery_and_standard_errors(variant):
    covered, excess = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(20):
            u, clean, y, noise, truth = plant(seed, variant)
            model = SystemLevelHysteresis(variant, dt=1e-3).fit(u[:, None], y)
            rms = np.sqrt(noise**2 + np.mean((model.predict(u[:, None]) - clean) ** 2))
            excess.append(rms / noise)
            covered += [
                abs(model.params_[name] - value) < 1.96 * model.params_std_[name]
                for name, value in truth.items()
            ]
    assert max(excess) < 1.02
    assert 0.90 <= np.mean(covered) <= 0.99


def test_units():
    u, _, y, _, _ = plant(3, "integral")
    reference = SystemLevelHysteresis(dt=1e-3).fit(u[:, None], y)
    other = SystemLevelHysteresis(dt=1e-3).fit(1e9 * u[:, None], -1e-7 * y)
    expected = -1e-7 * reference.predict(u[:, None])
    np.testing.assert_allclose(
        other.predict(1e9 * u[:, None]), expected, rtol=0, atol=1e-4 * np.ptp(expected)
    )


def test_records_with_their_own_past():
    """Each record is a first loading from zero, wherever it starts."""
    operator = SystemLevelOperator(1.0, 0.5, 0.7)
    rng = np.random.default_rng(0)
    index = pd.MultiIndex.from_product([range(3), DT * np.arange(200)], names=["record", "time"])
    drives = [np.cumsum(0.2 * rng.normal(size=200)) + start for start in (0.0, 2.0, -1.0)]
    y = np.concatenate([operator.run(u, DT)[0] for u in drives])
    X = pd.DataFrame({"drive": np.concatenate(drives)}, index)
    model = SystemLevelHysteresis().fit(X, pd.Series(y, index))
    assert model.params_["decay"] == pytest.approx(0.7, rel=1e-4)


def test_wrong_variant():
    with pytest.raises(ValueError, match="The 'variant' parameter of SystemLevelHysteresis"):
        SystemLevelHysteresis("other").fit(np.ones((5, 1)), np.ones(5))
