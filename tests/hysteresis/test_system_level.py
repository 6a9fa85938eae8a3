"""The system-level model: its laws, and its identification with the values of the paper."""

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.hysteresis import SystemLevelHysteresis, SystemLevelOperator
from skhyst.hysteresis._system_level import saturation_terms

OPERATOR = SystemLevelOperator(slope=0.9, curvature=0.3, decay=0.8, intercept=0.2)
PRINTED = dataclasses.replace(OPERATOR, variant="printed", rate_gain=0.02)
SIGNALS = st.lists(st.floats(-5, 5).map(lambda v: round(v, 3)), min_size=2, max_size=20)


hypothesis = settings(deadline=None, max_examples=30)


def integral(u, slope, curvature, decay):
    """Integrate (15) by quadrature from zero, the turning points found by hand."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    turning, direction, total, found = 0.0, 0.0, 0.0, []
    for a, b in pairwise([0.0, *u]):
        if np.sign(b - a) not in (0.0, direction):
            turning, direction = a, np.sign(b - a)
        points = a + (b - a) * 0.5 * (nodes + 1.0)
        growth = -np.expm1(-decay * np.abs(points - turning)) / decay
        total += (b - a) * 0.5 * weights @ (slope + curvature * growth)
        found.append(total)
    return np.array(found)


def printed(u, slope, curvature, decay, rate_gain, dt):
    """Equations (21) and (22), from zero."""
    y, turning, direction = [], 0.0, 0.0
    for a, b in pairwise([0.0, *u]):
        if (b - a) * direction < 0.0:
            turning = a
        direction = np.sign(b - a) or direction
        y.append((slope + curvature * -np.expm1(-decay * abs(b - turning)) / decay) * b)
    return np.array(y) + rate_gain * np.diff(u, prepend=u[0]) / dt


@hypothesis
@given(SIGNALS)
def test_rate_independence(values):
    u, n = np.array(values), 7
    y, state = OPERATOR.run(u, 1.0)
    fine = np.interp(np.arange(n * (len(u) - 1) + 1) / n, np.arange(len(u)), u)
    fine[::n] = u  # a sample beyond the end, by rounding, would be a turning point
    found, last = OPERATOR.run(fine, 1e-3)
    np.testing.assert_allclose(found[::n], y, atol=1e-11)
    np.testing.assert_allclose(last, state, atol=1e-11)


@hypothesis
@given(SIGNALS)
def test_laws_by_hand(values):
    expected = 0.2 + integral(values, 0.9, 0.3, 0.8)
    np.testing.assert_allclose(OPERATOR.run(values, 1.0)[0], expected, atol=1e-9)
    expected = 0.2 + printed(values, 0.9, 0.3, 0.8, 0.02, dt=0.1)
    np.testing.assert_allclose(PRINTED.run(values, 0.1)[0], expected, atol=1e-9)


@hypothesis
@given(SIGNALS)
def test_odd_symmetry(values):
    odd = dataclasses.replace(OPERATOR, intercept=0.0)
    u = np.array(values)
    np.testing.assert_array_equal(odd.run(-u, 1.0)[0], -odd.run(u, 1.0)[0])


@hypothesis
@given(SIGNALS, st.floats(0.1, 3.0))
def test_every_loop_closes_at_once(values, swing):
    u = np.array([*values, values[-1] + 4.0, values[-1], values[-1] + swing, values[-1]])
    y, _ = OPERATOR.run(u, 1.0)
    assert y[-1] == pytest.approx(y[-3], abs=1e-10)


@hypothesis
@given(SIGNALS, SIGNALS)
def test_congruency(first, second):
    """Loops of equal swing have one shape, whatever came before and wherever they are."""
    loop = np.concatenate([np.linspace(0, 1, 9), np.linspace(1, 0, 9), np.linspace(0, 1, 9)])
    shapes = []
    for past in (first, second):
        u = np.concatenate([past, [past[-1] + 6.0], past[-1] + loop])
        y, _ = OPERATOR.run(u, 1.0)
        shapes.append(y[-18:] - 0.9 * u[-18:])
    np.testing.assert_allclose(np.diff(shapes[0]), np.diff(shapes[1]), atol=1e-10)


def area(operator, swing):
    n = 4000
    u = np.concatenate([np.linspace(0, swing, n), np.linspace(swing, 0, n)[1:]])
    y, _ = operator.run(np.concatenate([u, u[1:]]), 1.0)
    y = y[-len(u) :]
    return 0.5 * np.sum((u[1:] + u[:-1]) * np.diff(y))


@pytest.mark.parametrize("swing", [0.3, 1.0, 5.0])
def test_area_of_the_rayleigh_law(swing):
    """Without decay the loops are parabolas of area curvature swing^3 / 6."""
    rayleigh = dataclasses.replace(OPERATOR, decay=0.0)
    assert area(rayleigh, swing) == pytest.approx(0.3 * swing**3 / 6.0, rel=1e-5)
    assert 0.0 < area(OPERATOR, swing) < area(rayleigh, swing)


def test_wide_swings_have_the_limiting_slope():
    y, _ = OPERATOR.run([0.0, 40.0, 50.0], 1.0)
    assert (y[2] - y[1]) / 10.0 == pytest.approx(0.9 + 0.3 / 0.8)


def test_state_is_last_turning_point():
    _, state = OPERATOR.run([0.0, 2.0, 1.0, 1.5, 1.2, 1.2], 1.0)
    turning, base, last, direction = state
    assert (turning, last, direction) == (1.5, 1.2, -1.0)
    assert base == pytest.approx(OPERATOR.run([0.0, 2.0, 1.0, 1.5], 1.0)[0][-1] - 0.2)


def test_parameters_of_the_paper():
    """(16) in the integral: its slope; (21) with the rate term of (22): its first loading."""
    operator = SystemLevelOperator.from_paper(0.4, -3.0, 2.5, d_o=0.3)
    u = np.linspace(0.0, 6.0, 20001)
    slopes = np.gradient(operator.run(u, 1.0)[0], u)
    law = 0.4 * (1.0 + 3.0 * np.exp(-u / 2.5))
    np.testing.assert_allclose(slopes[1:-1], 0.3 + law[1:-1], atol=1e-6)
    operator = SystemLevelOperator.from_paper(0.4, -3.0, 2.5, d_o=0.3, h_s=0.02, variant="printed")
    expected = 0.3 + law * u + 0.02 * np.diff(u, prepend=u[0]) / 0.1
    np.testing.assert_allclose(operator.run(u, 0.1)[0], expected, rtol=1e-12)


def test_printed_form_jumps_where_the_drive_turns():
    u = np.array([0.0, 3.0, 3.0 - 1e-9])
    smooth, _ = OPERATOR.run(u, 1.0)
    printed, _ = dataclasses.replace(PRINTED, rate_gain=0.0).run(u, 1.0)
    assert abs(smooth[2] - smooth[1]) < 1e-8
    assert abs(printed[2] - printed[1]) > 0.5


@pytest.mark.parametrize(
    ("field", "value"), [("variant", "other"), ("decay", -0.1), ("rate_gain", 0.1)]
)
def test_wrong_fields(field, value):
    with pytest.raises(ValueError, match=f"The '{field}' parameter of SystemLevelOperator"):
        dataclasses.replace(OPERATOR, **{field: value})


@pytest.mark.parametrize("x", [0.0, 1e-300, 1e-8, 1e-3, 0.1, 0.4999999, 0.5, 0.7, 2.0, 10.0, 40.0])
def test_terms_are_integrals(x):
    """E = int exp(-x t) dt, H = int (1 - t) exp(-x t) dt over [0, 1], and their derivatives."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t = 0.5 * (nodes + 1.0)
    f = np.exp(-x * t)
    expected = [0.5 * weights @ g for g in (f, -t * f, (1.0 - t) * f, -t * (1.0 - t) * f)]
    np.testing.assert_allclose(saturation_terms(x), expected, rtol=3e-13)


def test_terms_of_a_far_distance():
    e, de, h, dh = saturation_terms(1e6)
    np.testing.assert_allclose([e, de, h, dh], [1e-6, -1e-12, 1e-6, -1e-12], rtol=1e-5)
    assert all(map(math.isfinite, saturation_terms(1e300)))


PAPER = {"delta_d": 0.4783, "gamma": -370.47, "v_c": 24629.0}  # identified there
H_S, DT = 1967.0, 5e-4


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("variant", ["integral", "printed"])
def test_published_values(variant, noise):
    """0.5 Hz, 100 V from peak to peak, never negative: two periods.

    With noise the integral shows only the ratio of gamma and V_c, and the standard error of 1 / V_c
    says so.
    """
    u = 50.0 - 50.0 * np.cos(np.pi * DT * np.arange(int(4.0 / DT)))
    h_s = H_S if variant == "printed" else 0.0
    truth = SystemLevelOperator.from_paper(**PAPER, h_s=h_s, variant=variant)
    law = truth.slope, truth.curvature, truth.decay
    clean = printed(u, *law, H_S, DT) if variant == "printed" else integral(u, *law)
    y = clean + noise * clean.std() * np.random.default_rng(0).normal(size=u.size)
    found = SystemLevelHysteresis(variant, dt=DT).fit(u[:, None], y)
    values, stds = found.params_, found.params_std_
    if variant == "printed":
        assert values["slope"] == pytest.approx(truth.slope, rel=1e-4 if noise else 1e-6)
        assert values["rate_gain"] == pytest.approx(H_S, rel=1e-4 if noise else 1e-6)
        for name in ("slope", "curvature", "decay", "rate_gain"):
            expected = getattr(truth, name)
            assert not abs(values[name] - expected) > 4 * stds[name] + 1e-4 * abs(expected)
    else:
        assert values["slope"] == pytest.approx(truth.slope, rel=1e-4)
    if not noise:
        assert values["curvature"] == pytest.approx(truth.curvature, rel=1e-4)
    elif variant == "integral":
        assert values["curvature"] == pytest.approx(truth.curvature, rel=0.05)
        assert not stds["decay"] < 3 * truth.decay
    if not noise and variant == "integral":
        assert values["decay"] == pytest.approx(truth.decay, rel=1e-2)


def plant(seed, variant, n=900, dt=1e-3):
    rng = np.random.default_rng(seed)
    amplitude, size = 10.0 ** rng.uniform(-6, 4, 2)
    time = dt * np.arange(n)
    envelope = np.interp(time, [0.0, 0.3, 0.3001, 0.6, 0.6001, 0.9], [1.0, 1.0, 0.7, 0.7, 0.4, 0.4])
    u = 0.5 * amplitude * (1.2 - np.cos(2 * np.pi * 5 * time)) * envelope
    truth = {
        "slope": size / amplitude * rng.uniform(0.5, 1.0),
        "curvature": size / amplitude**2 * rng.uniform(1.0, 3.0) * rng.choice([-1, 1]),
        "decay": rng.uniform(1.5, 6.0) / amplitude,
    }
    if variant == "integral":
        clean = integral(u, **truth)
    else:
        truth["rate_gain"] = size / amplitude * rng.uniform(-0.005, 0.005)
        clean = printed(u, **truth, dt=dt)
    truth["intercept"] = size * rng.uniform(-1, 1)
    clean = clean + truth["intercept"]
    noise = 0.005 * clean.std()
    return u, clean, clean + noise * rng.normal(size=n), noise, truth


@pytest.mark.slow
@pytest.mark.parametrize("variant", ["integral", "printed"])
def test_recovery_and_standard_errors(variant, assert_recovered):
    plants = (plant(seed, variant) for seed in range(20))
    assert_recovered(SystemLevelHysteresis(variant, dt=1e-3), plants)


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
