"""The hyperbolic tangent model: its laws, and its identification with the tables of the paper."""

import warnings

import numpy as np
import pandas as pd
import pytest

from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import TanhHysteresis, TanhHysteresisOperator

OPERATOR = TanhHysteresisOperator(k0=0.12, alpha=-4e-5, beta=0.4, gamma=0.3, intercept=0.2)


def loop(frequency, n=2000):
    """Two periods of a sine; the rate has settled in the second."""
    u = 20.0 * np.sin(2 * np.pi * np.arange(2 * n) / n)
    y, _ = OPERATOR.run(u, 1.0 / (frequency * n))
    return u[n:], y[n:]


def area(u, y):
    return 0.5 * np.sum(u * np.roll(y, -1) - np.roll(u, -1) * y)


def test_area_is_in_proportion_to_the_frequency():
    """The loop closes through the rate alone: integral of alpha u' du = alpha w pi A^2."""
    for frequency in (1e-3, 1.0, 40.0):
        expected = 4e-5 * (2 * np.pi * frequency) * np.pi * 20.0**2
        assert area(*loop(frequency)) == pytest.approx(expected, rel=1e-4)


def test_slow_drive_has_no_memory():
    u, y = loop(1e-9)
    np.testing.assert_allclose(y, 0.2 + 0.12 * u + 0.4 * np.tanh(0.3 * u), atol=1e-9)


def test_memory_is_one_sample():
    _, state = OPERATOR.run([7.0, -3.0, 2.0], 0.01)
    assert state == (0.0, 2.0)
    assert OPERATOR.run([], 0.01, state)[1] == state


def test_first_rate_depends_on_the_initial_state():
    rest = OPERATOR.run([5.0], 1e-4, OPERATOR.init(5.0, "rest"))[0]
    zero = OPERATOR.run([5.0], 1e-4, OPERATOR.init(5.0, "zero"))[0]
    np.testing.assert_allclose(zero - rest, -4e-5 * 5.0 / 1e-4)


def test_step_has_no_derivative_by_its_steepness():
    u = np.array([0.0, 1e-3, 2.0, -5.0])
    operator = TanhHysteresisOperator(0.3, 0.0, 0.7, 5e5)
    _, dy = operator.linearize(u, np.empty((4, 0)), 0.01)
    np.testing.assert_array_equal(dy[:, 2], np.sign(u))
    np.testing.assert_array_equal(dy[:, 3], 0.0)


DT = 0.000128  # s, of the paper
TABLES = {
    20: [
        (10, 0.1276, -4.5e-05, 0.1228, 47918),
        (20, 0.1260, -6.1e-05, 0.1285, 41276),
        (30, 0.1253, -3.0e-06, 0.1363, 49162),
        (40, 0.1201, -1.4e-04, 0.1734, 44419),
        (50, 0.1238, -1.2e-05, 0.1475, 16536),
        (60, 0.1238, -7.0e-06, 0.1431, 29944),
        (70, 0.1227, -3.9e-05, 0.1387, 47111),
        (80, 0.1203, -5.9e-05, 0.1623, 36141),
    ],
    40: [
        (10, 0.1517, -0.00017, 0.3121, 113971),
        (20, 0.1487, -0.00016, 0.3454, 976595),
        (30, 0.1482, -0.00006, 0.3349, 499290),
        (40, 0.1461, -0.00009, 0.3857, 500032),
        (50, 0.1447, -0.00009, 0.4017, 54236),
        (60, 0.1424, -0.00010, 0.4234, 888161),
        (70, 0.1397, -0.00010, 0.4828, 988761),
        (80, 0.1451, -0.00003, 0.4004, 187906),
    ],
    60: [
        (10, 0.1693, -0.00025, 0.5189, 401360),
        (20, 0.1647, -0.00025, 0.6521, 863764),
        (30, 0.1644, -0.00014, 0.6248, 1650301),
        (40, 0.1647, -0.00005, 0.6187, 1709695),
        (50, 0.1629, -0.00007, 0.6436, 1697321),
        (60, 0.1628, -0.00005, 0.6682, 1350147),
        (70, 0.1539, -0.00013, 0.9466, 1116387),
        (80, 0.1600, -0.00007, 0.7258, 836609),
    ],
}


def paper_drive(voltage, frequency, periods=5):
    """Equation (4), from 0 to ``voltage``; return the drive and its derivative."""
    time = DT * np.arange(int(periods / (frequency * DT)))
    phase = 2 * np.pi * frequency * time - np.pi / 2
    amplitude = voltage / 2
    rate = amplitude * 2 * np.pi * frequency * np.cos(phase)
    return amplitude * np.sin(phase) + amplitude, rate


def response(u, rate, k0, alpha, beta, gamma):
    return k0 * u + alpha * rate + beta * np.tanh(gamma * u)


def backward(u, dt=DT):
    return np.diff(u, prepend=u[0]) / dt


def saturated(gamma, u):
    """Whether the tangent is 0 or 1, to the last bit, in all samples."""
    return np.isin(np.tanh(gamma * u[np.abs(u) > 1e-9]), 1.0).all()


@pytest.mark.parametrize(("voltage", "row"), [(v, i) for v in TABLES for i in range(8)])
def test_tables_of_the_paper(voltage, row):
    """Every k0 and alpha is recovered; gamma where a sample lies within the bend, if any does."""
    frequency, *values = TABLES[voltage][row]
    u, _ = paper_drive(voltage, frequency)
    y = response(u, backward(u), *values)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = TanhHysteresis(dt=DT).fit(u[:, None], y)
    assert model.params_["k0"] == pytest.approx(values[0], abs=1e-7)
    assert model.params_["alpha"] == pytest.approx(values[1], rel=1e-4)
    assert model.params_["beta"] == pytest.approx(values[2], abs=1e-6)
    np.testing.assert_allclose(model.predict(u[:, None]), y, atol=1e-6)
    if saturated(values[3], u):
        assert model.identifiability_["undetermined"] == ("gamma",)


@pytest.mark.parametrize("noise", [0.0, 0.005])
@pytest.mark.parametrize("voltage", TABLES)
def test_gamma_is_not_determined_where_the_drive_is_never_within_the_bend(voltage, noise):
    frequency, *values = TABLES[voltage][1]
    u, _ = paper_drive(voltage, frequency)
    u[1:] = np.maximum(u[1:], 0.001 * voltage)
    assert saturated(values[3], u)
    clean = response(u, backward(u), *values)
    y = clean + noise * np.std(clean) * np.random.default_rng(voltage).normal(size=u.size)
    with pytest.warns(ConvergenceWarning, match="gamma"):
        model = TanhHysteresis(dt=DT).fit(u[:, None], y)
    assert model.identifiability_["undetermined"] == ("gamma",)
    assert np.isinf(model.params_std_["gamma"])
    for name, value in zip(("k0", "alpha", "beta"), values, strict=False):
        assert abs(model.params_[name] - value) <= 3.5 * model.params_std_[name] + 1e-9
    error = np.sqrt(np.mean((model.predict(u[:, None]) - clean) ** 2))
    assert error <= 3 * noise * np.std(clean) * np.sqrt(3 / u.size) + 1e-9


def test_exact_derivative_instead_of_the_backward_difference():
    """The drive turns slowly: half a sample of delay does not show in the printed digits."""
    frequency, *values = TABLES[20][0]
    u, rate = paper_drive(20, frequency)
    model = TanhHysteresis(dt=DT).fit(u[:, None], response(u, rate, *values))
    assert f"{model.params_['k0']:.4f}" == "0.1276"
    assert f"{model.params_['alpha']:.1e}" == "-4.5e-05"


def test_intercept_and_height_of_a_step_cannot_be_told_apart():
    u, _ = paper_drive(20, 10)
    u += 1.0
    y = 0.3 + response(u, backward(u), *TABLES[20][0][1:])
    with pytest.warns(ConvergenceWarning):
        model = TanhHysteresis(fit_intercept=True, dt=DT).fit(u[:, None], y)
    assert set(model.identifiability_["undetermined"]) == {"beta", "gamma", "intercept"}
    np.testing.assert_allclose(model.predict(u[:, None]), y, atol=1e-6)


def test_voltage_dependence_of_the_paper():
    """Means over frequency, then a line over the voltage: k0(E) = 0.105 + 9.787e-4 E (Table 7)."""
    means = [np.mean([row[1] for row in rows]) for rows in TABLES.values()]
    slope, constant = np.polyfit(list(TABLES), means, 1)
    assert slope == pytest.approx(9.787e-4, abs=5e-7)
    assert constant == pytest.approx(0.105, abs=5e-4)


def plant(seed, n=1500, dt=1e-3):
    """Return drive, clean response, noisy response and true parameters."""
    rng = np.random.default_rng(seed)
    amplitude = 10.0 ** rng.uniform(-6, 4)
    size = 10.0 ** rng.uniform(-6, 4)
    time = dt * np.arange(n)
    waves = np.sin(2 * np.pi * np.outer(time, rng.uniform(0.5, 8.0, 3)) + rng.uniform(0, 6, 3))
    u = amplitude * (waves.sum(axis=1) / 3 + rng.uniform(-0.2, 0.2))
    values = (
        size / amplitude * rng.uniform(0.3, 2.0),
        size / amplitude * rng.uniform(-0.02, 0.02),
        size * rng.uniform(0.5, 1.5) * rng.choice([-1, 1]),
        10.0 ** rng.uniform(0.3, 1.3) / amplitude,
    )
    clean = response(u, backward(u, dt), *values)
    noise = 0.005 * np.std(clean)
    names = ("k0", "alpha", "beta", "gamma")
    truth = dict(zip(names, values, strict=True))
    return u, clean, clean + noise * rng.normal(size=n), noise, truth


@pytest.mark.slow
def test_recovery_and_standard_errors(assert_recovered):
    assert_recovered(TanhHysteresis(dt=1e-3), map(plant, range(20)))


def test_units():
    u, _, y, _, _ = plant(3)
    reference = TanhHysteresis(dt=1e-3).fit(u[:, None], y)
    other = TanhHysteresis(dt=1e-3).fit(1e9 * u[:, None], -1e-7 * y)
    np.testing.assert_allclose(
        other.predict(1e9 * u[:, None]), -1e-7 * reference.predict(u[:, None]), rtol=1e-5, atol=0
    )


def test_records():
    u, _, y, _, truth = plant(4)
    index = pd.MultiIndex.from_product([range(3), 1e-3 * np.arange(500)], names=["record", "time"])
    X = pd.DataFrame({"drive": u}, index)
    y = pd.Series(y, index)
    model = TanhHysteresis().fit(X, y)
    assert model.params_["gamma"] == pytest.approx(truth["gamma"], rel=0.1)
