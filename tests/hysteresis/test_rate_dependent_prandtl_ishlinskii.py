"""Plays that follow the rate of the drive: definition, loops, inverse, recovery of plants."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.hysteresis import (
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    RateDependentPrandtlIshlinskii,
    RateDependentPrandtlIshlinskiiOperator,
)
from skhyst.hysteresis import _rate_dependent_prandtl_ishlinskii as rate_dependent
from skhyst.operators import check_operator

DT = 1e-3
R, W, S = np.array([0.0, 0.4, 0.9, 1.6]), np.array([1.0, 0.5, 0.4, 0.3]), np.array([3, -2, 1, 2])
LAWS = {
    "threshold": {"dilation": 4e-3},
    "proportional": {"stretch": 5e-3},
    "slope": {"rate_weights": 1e-3 * S},
}
MEMORY = 8 * DT
VARIANTS = pytest.mark.parametrize("variant", LAWS)
SMOOTHINGS = pytest.mark.parametrize("smoothing", ["none", "speed", "velocity"])
EACH_ONCE = pytest.mark.parametrize(  # for what takes long
    ("variant", "smoothing"), list(zip(LAWS, ("velocity", "none", "speed"), strict=True))
)
signals = arrays(float, st.integers(2, 80), elements=st.floats(-5, 5))


def make(variant, smoothing="none"):
    memory = 0.0 if smoothing == "none" else MEMORY
    return RateDependentPrandtlIshlinskiiOperator(
        R, W, intercept=0.3, time_constant=memory, smoothing=smoothing, **LAWS[variant]
    )


def low_pass(signal, dt, memory):
    """The response of a low-pass to what is constant on the way to each sample, as a sum."""
    ago = dt * (np.arange(signal.size)[:, None] - np.arange(signal.size))
    part = np.exp(-np.maximum(ago, 0.0) / memory) - np.exp(-np.maximum(ago + dt, 0.0) / memory)
    return (part * (ago >= 0.0)) @ signal


def paces(u, dt, smoothing, memory):
    velocities = np.diff(u, prepend=u[0]) / dt
    if smoothing == "velocity":
        return np.abs(low_pass(velocities, dt, memory))
    speeds = np.abs(velocities)
    return speeds if smoothing == "none" else low_pass(speeds, dt, memory)


def by_definition(
    u,
    dt,
    weights,
    rate_weights=0.0,
    intercept=0.0,
    dilation=0.0,
    stretch=0.0,
    smoothing="none",
    memory=MEMORY,
):
    """The plays' differential inclusion, in fine steps, the threshold moving along."""
    plays, last, slack, y = np.zeros(R.size), u[0], R, []
    for value, rate in zip(u, paces(u, dt, smoothing, memory), strict=True):
        goal = (R * (1.0 + stretch * rate) + dilation * rate) * (R > 0.0)
        for part in np.linspace(0.0, 1.0, 5):
            v, r = last + part * (value - last), slack + part * (goal - slack)
            plays = np.maximum(v - r, np.minimum(v + r, plays))
        last, slack = value, goal
        y.append(intercept + (weights + rate_weights * rate) @ plays)
    return np.array(y)


# Operator


@VARIANTS
@SMOOTHINGS
@settings(deadline=None, max_examples=20)
@given(u=signals, speed=st.floats(1e-3, 1e2))
def test_follows_its_definition(variant, smoothing, u, speed):
    expected = by_definition(u, DT / speed, W, intercept=0.3, smoothing=smoothing, **LAWS[variant])
    found, _ = make(variant, smoothing).run(u, DT / speed)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * (1 + np.abs(expected).max()))


@VARIANTS
@SMOOTHINGS
@settings(deadline=None, max_examples=10)
@given(u=signals)
def test_without_rate_it_is_the_plain_model(variant, smoothing, u):
    """Infinitely slow, or with nothing that follows the rate."""
    expected, _ = PrandtlIshlinskiiOperator(R, W, 0.3).run(u, 1.0)
    operator = make(variant, smoothing)
    np.testing.assert_allclose(operator.run(u, 1e12)[0], expected, rtol=0, atol=1e-10)
    plain = replace(operator, rate_weights=(), dilation=0.0, stretch=0.0)
    np.testing.assert_allclose(plain.run(u, DT)[0], expected, rtol=0, atol=1e-12)
    names = [name for name, _ in plain.entries()]
    assert names[5:] == ([] if smoothing == "none" else ["time_constant"])


@VARIANTS
@pytest.mark.parametrize("smoothing", ["speed", "velocity"])
def test_a_low_pass_that_forgets_at_once_is_none(variant, smoothing):
    u = np.cumsum(np.random.default_rng(0).normal(size=300))
    fast = replace(make(variant, smoothing), time_constant=DT / 50)
    np.testing.assert_allclose(fast.run(u, DT)[0], make(variant).run(u, DT)[0], rtol=1e-12)


@VARIANTS
@SMOOTHINGS
def test_derivatives_and_pieces(variant, smoothing):
    u = np.cumsum(np.random.default_rng(1).normal(size=300))
    check_operator(make(variant, smoothing), u, 20 * DT)


@VARIANTS
@SMOOTHINGS
def test_plain_python_agrees_with_what_is_compiled(variant, smoothing, monkeypatch):
    u = np.cumsum(np.random.default_rng(2).normal(size=150))
    operator, du = make(variant, smoothing), np.ones((u.size, 1))

    def all_of_it():
        y, dy = operator.sensitivities(u, du, DT)
        rates, _ = operator.paces(np.diff(u, prepend=u[0]) / DT, DT)
        return y, dy, operator.drive_at_rates(y, rates)

    compiled = all_of_it()
    for name in ("rate_play_run", "rate_play_tangents", "rate_play_inverse"):
        monkeypatch.setattr(rate_dependent, name, getattr(rate_dependent, name).py_func)
    for one, other in zip(compiled, all_of_it(), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-11, atol=1e-11)


@VARIANTS
@SMOOTHINGS
def test_thresholds_stay_above_zero_and_in_their_order(variant, smoothing):
    """Seen in the first loading from rest, along which all plays that move have one slope."""
    operator = replace(make(variant, smoothing), weights=[0.0, 0.0, 0.0, 1.0], rate_weights=())
    slacks = []
    for k in range(1, R.size):
        alone = replace(operator, weights=np.eye(R.size)[k], intercept=0.0)
        u = 400.0 * np.linspace(0.0, 1.0, 30) ** 2
        slacks.append((u - alone.run(u, 20 * DT)[0])[-1])
    assert slacks[0] > 0.0
    assert np.all(np.diff(slacks) > 0.0)


def triangle(rate, periods=3, n=4000):
    """A triangular wave between -4 and 4 whose rate has one size."""
    time = np.arange(periods * n + 1) / n
    return 4.0 - 8.0 * np.abs(2.0 * (time % 1.0) - 1.0), 16.0 / rate / n


@pytest.mark.parametrize("rate", [0.5, 20.0, 80.0])
def test_width_of_a_loop_grows_with_the_rate(rate):
    operator = RateDependentPrandtlIshlinskiiOperator([0.0, 0.4], [0.0, 1.0], dilation=4e-3)
    u, dt = triangle(rate)
    y, _ = operator.run(u, dt)
    rows = slice(-4000, None)
    up = np.interp(0.0, y[rows][:2000], u[rows][:2000])
    down = np.interp(0.0, y[rows][:1999:-1], u[rows][:1999:-1])
    assert up - down == pytest.approx(2.0 * (0.4 + 4e-3 * rate), rel=1e-9)


@settings(deadline=None, max_examples=40)
@given(u=signals, speed=st.floats(1e-2, 1e3))
def test_dissipation(u, speed):
    """Whatever the rate, a play moves only against its slack: ``(u - F) dF`` is not negative."""
    operator = RateDependentPrandtlIshlinskiiOperator([0.4], [1.0], dilation=4e-3)
    play, _ = operator.run(u, DT / speed)
    assert np.all((u[1:] - play[1:]) * np.diff(play) >= -1e-12)


@pytest.mark.parametrize("rate_weights", [(), 0.1 * W, -0.02 * W])
@pytest.mark.parametrize(("dilation", "stretch"), [(0, 0), (0.3, 0), (5, 0), (0, 0.3), (0, 5)])
@SMOOTHINGS
def test_inverse_at_known_rates(dilation, stretch, rate_weights, smoothing):
    memory = 0.0 if smoothing == "none" else 3.0
    operator = RateDependentPrandtlIshlinskiiOperator(
        R, W, rate_weights, 0.3, dilation, stretch, memory, smoothing
    )
    u = np.cumsum(np.random.default_rng(0).normal(size=600)) * 0.3 + 0.3
    y, _ = operator.run(u, 1.0)
    rates, tolerance = paces(u, 1.0, smoothing, memory), 1e-12 * np.ptp(u)
    np.testing.assert_allclose(operator.drive_at_rates(y, rates), u, rtol=0, atol=tolerance)
    _, (plays, *_) = operator.run(u[:200], 1.0)
    rest = operator.drive_at_rates(y[200:], rates[200:], plays)
    np.testing.assert_allclose(rest, u[200:], rtol=0, atol=tolerance)


@EACH_ONCE
def test_inverse_without_the_rates(variant, smoothing):
    """What is left is a small part of what the inverse of the plain model leaves."""
    operator, initial_state = make(variant, smoothing), "zero" if smoothing == "speed" else "rest"
    time = DT * np.arange(3000)
    u = 4.0 * np.sin(2 * np.pi * 1.5 * time) * np.cos(0.8 * time)
    y, _ = operator.run(u, DT, operator.init(u[0], initial_state))
    errors = []
    for drive in (
        operator.inverse().run(y, DT, initial_state)[0],
        operator.drive_at_rates(y, np.zeros(y.size)),
    ):
        back, _ = operator.run(drive, DT, operator.init(drive[0], initial_state))
        errors.append(np.sqrt(np.mean((back - y) ** 2)))
    assert errors[0] < 0.1 * errors[1]
    assert errors[0] < 1e-3 * np.ptp(y)


def test_inverse_is_exact_where_steps_of_time_are_long():
    operator = make("threshold")
    u = np.cumsum(np.random.default_rng(3).normal(size=300))
    y, _ = operator.run(u, 0.2)
    np.testing.assert_allclose(operator.inverse().run(y, 0.2)[0], u, atol=1e-6 * np.ptp(u))


@pytest.mark.parametrize(
    ("thresholds", "weights", "rate_weights", "rate"),
    [
        ([0.1, 1.0], [1.0, 1.0], (), 0.0),
        ([0.0, 1.0], [0.0, 1.0], (), 0.0),
        ([0.0, 1.0], [1.0, 1.0], [-0.1, 0.0], 11.0),
    ],
)
def test_no_inverse(thresholds, weights, rate_weights, rate):
    operator = RateDependentPrandtlIshlinskiiOperator(thresholds, weights, rate_weights)
    with pytest.raises(ValueError, match="strictly monotone"):
        operator.drive_at_rates(np.zeros(3), np.full(3, rate))


@pytest.mark.parametrize("drive_unit", [1e-9, 1e9])
@pytest.mark.parametrize("time_unit", [1e-6, 1e6])
@VARIANTS
@SMOOTHINGS
def test_units_of_the_operator(variant, smoothing, drive_unit, time_unit):
    operator = make(variant, smoothing)
    other = RateDependentPrandtlIshlinskiiOperator(
        R * drive_unit,
        W / drive_unit,
        operator.rate_weights * time_unit / drive_unit**2,
        0.3,
        operator.dilation * time_unit,
        operator.stretch * time_unit / drive_unit,
        operator.time_constant * time_unit,
        smoothing,
    )
    u = np.cumsum(np.random.default_rng(4).normal(size=300)) * 0.1
    expected, _ = operator.run(u, DT)
    found, _ = other.run(u * drive_unit, DT * time_unit)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.ptp(expected))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("stretch", {"stretch": 0.1, "dilation": 0.1}),
        ("time_constant", {"smoothing": "speed"}),
        ("time_constant", {"smoothing": "velocity", "time_constant": -1.0}),
    ],
)
def test_laws_that_exclude_each_other(name, values):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of RateDependent"):
        RateDependentPrandtlIshlinskiiOperator(R, W, **values)


# Estimator


class Plant:
    """Random plays under a sweep."""

    def __init__(self, seed, variant, smoothing="none", n=2500):
        rng = np.random.default_rng(seed)
        time = DT * np.arange(n)
        sweep = np.sin(2 * np.pi * rng.uniform(0.5, 2.0) * time * (1.0 + 1.5 * time))
        self.u = 4.0 * sweep * (0.5 + 0.5 * np.cos(0.7 * time) ** 2)
        weights, intercept = rng.uniform(0.3, 1.0, 4), rng.uniform(-2, 2)
        dilation, slopes = rng.uniform(2e-3, 8e-3), rng.uniform(-2e-3, 2e-3, 4)
        law = {
            "threshold": {"dilation": dilation},
            "proportional": {"stretch": 0.4 * dilation},
            "slope": {"rate_weights": slopes},
        }.get(variant, {})
        self.y = by_definition(
            self.u, DT, weights, intercept=intercept, smoothing=smoothing, memory=0.05, **law
        )
        rates = law.pop("rate_weights", [])
        memory = [] if smoothing == "none" else [0.05]
        self.truth = np.concatenate(
            [weights, rates, [intercept], *map(np.atleast_1d, law.values()), memory]
        )
        self.noise = 0.005 * self.y.std() * rng.normal(size=n)
        self.X = self.u.reshape(-1, 1)


@pytest.mark.slow
@EACH_ONCE
def test_recovery_of_random_plants(variant, smoothing, assert_recovered):
    def plant(seed):
        p = Plant(seed, variant, smoothing, n=1500)
        return p.u, p.y, p.y + p.noise, np.sqrt(np.mean(p.noise**2)), p.truth

    model = RateDependentPrandtlIshlinskii(
        thresholds=R, variant=variant, smoothing=smoothing, dt=DT
    )
    # a low-pass and few plants would not tell a coverage of 0.9 from one of 0.95
    plants = map(plant, range(20 if smoothing == "none" else 40))
    most = 40 if smoothing == "none" else 120  # it starts from four time constants
    assert np.median(assert_recovered(model, plants)) < most


@EACH_ONCE
def test_better_than_the_plain_model(variant, smoothing):
    plant = Plant(0, variant, smoothing)
    noisy = plant.y + plant.noise
    plain = PrandtlIshlinskii().fit(plant.X, noisy)
    model = RateDependentPrandtlIshlinskii(
        thresholds=R, variant=variant, smoothing=smoothing, dt=DT
    )
    model.fit(plant.X, noisy)
    errors = [np.sqrt(np.mean((m.predict(plant.X) - plant.y) ** 2)) for m in (model, plain)]
    assert errors[0] < 0.1 * errors[1]


def test_records_are_inverted_one_by_one():
    plant = Plant(2, "threshold")
    model = RateDependentPrandtlIshlinskii(thresholds=R, dt=DT)
    model.fit(pd.DataFrame({"y": plant.u}), plant.y)
    one = model.inverse_predict(pd.DataFrame({"y": plant.y[:600]}))
    index = pd.MultiIndex.from_product([["a", "b"], DT * np.arange(600)], names=["record", "time"])
    frame = pd.DataFrame({"y": np.tile(plant.y[:600], 2)}, index)
    np.testing.assert_allclose(model.inverse_predict(frame), np.tile(one, 2), atol=1e-9)


def test_data_without_rate_dependence():
    plant = Plant(3, "neither")
    noisy = plant.y + plant.noise
    plain = PrandtlIshlinskii(thresholds=R).fit(plant.X, noisy)
    model = RateDependentPrandtlIshlinskii(thresholds=R, dt=DT).fit(plant.X, noisy)
    fastest = np.abs(np.diff(plant.u)).max() / DT
    assert model.dilation_ * fastest < 0.02
    assert model.fit_error_ <= 1.001 * plain.fit_error_


@EACH_ONCE
def test_units_of_the_model(variant, smoothing, assert_unit_free):
    plant, (drive, response, time) = Plant(4, variant, smoothing), (1e6, 1e-9, 1e3)
    model = RateDependentPrandtlIshlinskii(
        thresholds=R, variant=variant, smoothing=smoothing, dt=DT
    )
    noisy, units = plant.y + plant.noise, {"dt": DT * time, "thresholds": drive * R}
    assert_unit_free(model, plant.u, noisy, drive, response, 1e-5, **units)
