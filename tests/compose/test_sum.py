"""Models in parallel, disturbances beside them."""

import numpy as np
import pytest
from sklearn.frozen import FrozenEstimator

from skhyst.compose import Cascade, Sum
from skhyst.disturbance import Drift, Offset, PeriodicDisturbance
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import Series
from skhyst.records import stack_records
from skhyst.static import Saturation, SaturationOperator

DT, N, NOISE = 0.01, 500, 0.01
TIME = DT * np.arange(N)
THRESHOLDS = (0.0, 0.3, 0.8)
HYSTERESIS = PrandtlIshlinskiiOperator(THRESHOLDS, [1.0, 0.4, 0.3])
MODES = SecondOrderModeOperator(60.0, 0.05), SecondOrderModeOperator(20.0, 0.1, 0.3)


def plays(**options):
    return PrandtlIshlinskii(thresholds=THRESHOLDS, **options)


def drive(seed):
    rng = np.random.default_rng(seed)
    frequencies = np.geomspace(0.3, 12.0, 6)
    waves = np.sin(2 * np.pi * np.outer(TIME, frequencies) + rng.uniform(0, 6, 6))
    return 1.5 * waves @ (1.0 / np.arange(1, 7))


def measure(*operators, additive=lambda i: 0.0):
    """Return three records of the sum of operators and of what stands beside it."""
    rng, records = np.random.default_rng(9), []
    for i in range(3):
        u = drive(i)
        y = sum(operator.run(u, DT)[0] for operator in operators)
        records.append((u, y + additive(i) + NOISE * rng.normal(size=N)))
    return stack_records(records, dt=DT)


def test_drift_and_offset_beside_hysteresis():
    z = 2 * TIME / TIME[-1] - 1
    coefficients = np.array([[1.0, 0.3, -0.2], [-2.0, 0.0, 0.1], [0.5, -0.4, 0.0]])
    X, y = measure(HYSTERESIS, additive=lambda i: np.polynomial.legendre.legval(z, coefficients[i]))
    model = Sum([("plays", plays(fit_intercept=False)), ("drift", Drift(2))]).fit(X, y)
    np.testing.assert_allclose(model.record_coefficients_, coefficients, atol=0.01)
    np.testing.assert_allclose(model.operators_["plays"].weights, [1.0, 0.4, 0.3], atol=0.01)
    np.testing.assert_allclose(
        model.operators_["drift"].coefficients, coefficients.mean(axis=0), atol=0.01
    )
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    # the free run of a record knows the mean of the records only
    error = y - model.predict(X)
    additive = coefficients - coefficients.mean(axis=0)
    expected = np.concatenate([np.polynomial.legendre.legval(z, c) for c in additive])
    assert np.sqrt(np.mean((error - expected) ** 2)) == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize("initial_state", ["rest", "zero", "estimate"])
def test_intercept_beside_an_offset_is_held(initial_state):
    X, y = measure(HYSTERESIS, additive=lambda i: [3.0, -1.0, 0.5][i])
    steps = [("plays", plays()), ("offset", Offset())]
    model = Sum(steps, initial_state=initial_state).fit(X, y)
    assert set(model.params_) == {f"plays__weights[{i}]" for i in range(3)}
    assert model.operators_["plays"].intercept == 0.0
    np.testing.assert_allclose(model.record_coefficients_[:, 0], [3.0, -1.0, 0.5], atol=0.005)


def test_intercept_before_a_limit_is_named():
    """Intercept, limit and offset can move together, but no model of them is without meaning."""
    shifted = PrandtlIshlinskiiOperator(THRESHOLDS, HYSTERESIS.weights, 0.4)
    limited = Series(("plays", "limit"), (shifted, SaturationOperator(upper=1.0)))
    X, y = measure(limited, additive=lambda i: 2.0 * i)
    chain = Cascade([("plays", plays()), ("limit", Saturation(sides="upper"))])
    model = Sum([("offset", Offset()), ("chain", chain)])
    with pytest.warns(ConvergenceWarning, match="chain__limit__upper, chain__plays__intercept"):
        model.fit(X, y)
    assert model.params_std_["chain__limit__upper"] == np.inf
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    # held, it leaves the limit's distance to be found
    chain.set_params(plays__fit_intercept=False)
    model.fit(X, y)
    assert model.params_["chain__limit__upper"] == pytest.approx(0.6, abs=0.01)


def test_constant_of_drift_and_offset_is_one():
    X, y = measure(HYSTERESIS, additive=lambda i: i + TIME)
    model = Sum([("plays", plays()), ("offset", Offset()), ("drift", Drift(1))]).fit(X, y)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    np.testing.assert_allclose(model.record_coefficients_[:, 2], 0.5 * TIME[-1], atol=0.01)


def test_line_beside_a_lag():
    lag = FirstOrderLagOperator(0.05, gain=2.0)
    X, y = measure(lag, additive=lambda i: 0.2 * np.sin(2 * np.pi * 17.3 * TIME + i))
    model = Sum([("lag", FirstOrderLag()), ("line", PeriodicDisturbance())]).fit(X, y)
    assert model.operators_["line"].frequencies[0] == pytest.approx(17.3, abs=0.005)
    assert model.params_["lag__time_constant"] == pytest.approx(0.05, rel=0.02)
    amplitudes = np.linalg.norm(model.record_coefficients_, axis=1)
    np.testing.assert_allclose(amplitudes, 0.2, atol=0.005)


def test_two_modes():
    X, y = measure(*MODES)
    steps = [("first", SecondOrderMode()), ("second", SecondOrderMode())]
    model = Sum(steps).fit(X, y)
    found = sorted(operator.natural_frequency for operator in model.operators_.values())
    assert found == pytest.approx([20.0, 60.0], rel=0.02)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    assert sum("intercept" in name for name in model.params_) == 1


def test_free_run_is_the_sum_of_the_parts():
    X, y = measure(HYSTERESIS, additive=lambda i: i * TIME)
    model = Sum([("plays", plays()), ("drift", Drift(1))]).fit(X, y)
    u = X.loc[0, "drive"].to_numpy()
    parts = [operator.run(u, DT)[0] for operator in model.operators_.values()]
    np.testing.assert_allclose(model.predict(X.loc[[0]]), np.sum(parts, axis=0), rtol=1e-12)


def test_cascade_as_a_branch():
    plant = Series(("plays", "lag"), (HYSTERESIS, FirstOrderLagOperator(0.05)))
    X, y = measure(plant, additive=lambda i: i * TIME)
    chain = Cascade([("plays", plays()), ("lag", FirstOrderLag())])
    model = Sum([("chain", chain), ("drift", Drift(1))]).fit(X, y)
    assert model.params_["chain__lag__time_constant"] == pytest.approx(0.05, rel=0.03)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    assert set(model.operators_) == {"chain", "drift"}


def test_a_held_branch_stays():
    known = SecondOrderMode().fit(*measure(MODES[0]))
    X, y = measure(*MODES, additive=float)
    held = ("first", FrozenEstimator(known))
    steps = [("offset", Offset()), ("second", SecondOrderMode()), held]
    model = Sum(steps).fit(X, y)
    assert model.operators_["first"] is known.operator_
    names = ("natural_frequency", "damping_ratio", "gain")
    assert set(model.params_) == {f"second__{name}" for name in names}
    assert model.params_["second__gain"] == pytest.approx(0.3, rel=0.02)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)


def test_disturbances_alone():
    X, y = measure(additive=lambda i: 1.0 + np.sin(2 * np.pi * 11.0 * TIME))
    model = Sum([("offset", Offset()), ("line", PeriodicDisturbance())]).fit(X, y)
    assert model.fit_error_ == pytest.approx(NOISE, rel=0.06)
    np.testing.assert_allclose(model.predict(X), y, atol=5 * NOISE)
    assert set(model.operators_) == {"offset", "line"}
