"""Creep in logarithmic time: the law, and its identification."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from skhyst.datasets import multisine, steps
from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import LogCreep, LogCreepOperator
from skhyst.records import stack_records


def law(time, creep, constant):
    return 1.0 + creep * np.log10(1.0 + np.maximum(time, 0.0) / constant)


@settings(deadline=None, max_examples=25)
@given(
    st.floats(0.0, 6.0),
    st.floats(0.0, 1.0),
    st.sampled_from([1e-6, 1.0, 1e5]),
)
def test_step_response_is_the_law(decades, share, unit):
    """For every time constant above the shortest and every time up to the longest."""
    shortest, longest = unit, unit * 10.0 ** max(decades, 1.0)
    constant = shortest * (longest / shortest) ** share
    operator = LogCreepOperator(1.0, constant, shortest=shortest, longest=longest, hold="zoh")
    for dt in np.geomspace(longest / 1e6, longest / 200, 3):
        u = np.r_[0.0, np.ones(200)]
        y = operator.run(u, dt)[0][1:] - 1.0
        expected = law(dt * np.arange(200), 1.0, constant) - 1.0
        np.testing.assert_allclose(y, expected, rtol=3e-4, atol=1e-12)


def test_ramp_response_is_the_superposition_of_steps():
    """First-order hold: the integral of the law over the changes of the drive."""
    operator = LogCreepOperator(0.2, 0.03, 1.5, 0.4, shortest=0.01, longest=10.0)
    dt, u = 0.05, np.array([0.3, 0.3, 1.0, -0.4, -0.4, 2.0])
    time = dt * np.arange(len(u))
    expected = np.full(len(u), 1.5 * u[0])
    for k in range(1, len(u)):
        for i in range(k):
            rate = (u[i + 1] - u[i]) / dt
            part, _ = quad(lambda s, k=k: law(time[k] - s, 0.2, 0.03), time[i], time[i + 1])
            expected[k] += 1.5 * rate * part
    np.testing.assert_allclose(operator.run(u, dt)[0] - 0.4, expected, rtol=1e-4)


def test_frequency_response_of_a_steady_multisine():
    operator = LogCreepOperator(0.3, 0.02, 1.7, shortest=0.01, longest=1.0)
    u = multisine(500, band=(2.0, 100.0), n_periods=200, random_state=0, dt=1e-3)["drive"]
    y = operator.run(u.to_numpy(), 1e-3)[0]
    lines = np.arange(1, 30)
    gain = np.fft.rfft(y[-500:])[lines] / np.fft.rfft(u[-500:])[lines]
    # between two samples the drive is a straight line, not a sine: a part (pi f dt)^2 / 3
    np.testing.assert_allclose(gain, operator.frequency_response(lines / 0.5), rtol=2e-3)


# ----------------------------------------------------------------------------------- identification


def recording(seed, *, creep=0.03, constant=0.4, noise=1e-4):
    """Return two records of steps, the response a superposition of the law."""
    rng = np.random.default_rng(seed)
    records = []
    for levels in ([0.0, 1.0, -1.0, 0.5], [2.0, -1.0, 1.0]):
        X = steps(levels, hold=[1.0] + [40.0] * (len(levels) - 1), dt=0.1)
        u, time = X["drive"].to_numpy(), X.index.get_level_values("time").to_numpy()
        y = np.full(len(u), 1.5 * u[0] + 0.2)
        for k in np.flatnonzero(np.diff(u)) + 1:
            y[k:] += 1.5 * (u[k] - u[k - 1]) * law(time[k:] - time[k], creep, constant)
        records.append((u, y + noise * rng.normal(size=len(y))))
    return stack_records(records, dt=0.1)


def test_parameters_and_their_standard_errors():
    truth = {"creep": 0.03, "time_constant": 0.4, "gain": 1.5, "intercept": 0.2}
    scores = []
    for seed in range(12):
        model = LogCreep(hold="zoh").fit(*recording(seed))
        assert model.identifiability_["undetermined"] == ()
        assert model.fit_error_ == pytest.approx(1e-4, rel=0.1)
        scores.append([(model.params_[n] - v) / model.params_std_[n] for n, v in truth.items()])
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.35)


def test_held_time_constant():
    X, y = recording(0, constant=0.1)
    model = LogCreep(0.1, hold="zoh").fit(X, y)
    assert set(model.params_) == {"creep", "gain", "intercept"}
    assert model.operator_.time_constant == 0.1
    assert model.params_["creep"] == pytest.approx(0.03, abs=4 * model.params_std_["creep"])


@pytest.mark.parametrize("constant", [1e-3, 1e-6])
def test_a_time_constant_below_the_interval(constant):
    """The sample at the step has the prompt response only, the next one most of the creep."""
    model = LogCreep(hold="zoh").fit(*recording(0, constant=constant))
    assert model.fit_error_ == pytest.approx(1e-4, rel=0.1)
    for name, value in {"creep": 0.03, "time_constant": constant, "gain": 1.5}.items():
        assert model.params_[name] == pytest.approx(value, abs=4 * model.params_std_[name])


def test_where_nothing_creeps_the_standard_errors_say_so():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model = LogCreep(hold="zoh").fit(*recording(0, creep=0.0))
    assert not model.params_std_["time_constant"] < model.params_["time_constant"]
    assert not model.params_std_["creep"] < model.params_["creep"]
    u = np.r_[0.0, np.ones(500)]
    np.testing.assert_allclose(model.operator_.run(u, 0.1)[0][1:], 1.7, atol=1e-4)


def test_a_longer_record_than_that_of_the_fit_keeps_the_law():
    operator = LogCreep(hold="zoh").fit(*recording(0, noise=0.0)).operator_
    expected = 1.5 * law(0.1 * np.arange(10_000), 0.03, 0.4) + 0.2
    y, _ = operator.run(np.r_[0.0, np.ones(10_000)], 0.1)
    np.testing.assert_allclose(y[1:], expected, rtol=1e-5)
