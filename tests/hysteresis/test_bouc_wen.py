"""Bouc-Wen: exact integration, the theorems of the law, and plants identified from data."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp
from scipy.special import hyp2f1

from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import BoucWen, BoucWenOperator
from skhyst.hysteresis._bouc_wen import runge_kutta
from skhyst.operators import check_operator

signals = arrays(float, st.integers(2, 40), elements=st.floats(-100, 100, width=32))


@st.composite
def operators(draw, asymmetric=True):
    return BoucWenOperator(
        gain=draw(st.floats(-2, 2)),
        alpha=draw(st.floats(-3, 3)),
        limit=10.0 ** draw(st.floats(-1, 2)),
        ratio=draw(st.floats(0, 5)),
        exponent=draw(st.floats(0.6, 8)),
        asymmetry=draw(st.floats(-0.9, 0.9)) if asymmetric else 0.0,
    )


def hysteretic_part(operator, u, state=(0.0, 0.0)):
    only = dataclasses.replace(operator, gain=0.0, alpha=1.0, intercept=0.0)
    return only.run(u, 1.0, state)[0]


def rate(z, direction, operator):
    """The law: dz over the way that the drive goes."""
    power = operator.limit**-operator.exponent
    beta, gamma = 0.5 * (1 + operator.ratio) * power, 0.5 * (1 - operator.ratio) * power
    phi = 0.5 * operator.asymmetry * power
    shape = gamma + beta * np.sign(direction * z) + phi * (np.sign(direction) + np.sign(z))
    return direction * (1.0 - np.abs(z) ** operator.exponent * shape)


def integrate(operator, u, n_steps):
    """The classical method, along each straight line between samples."""
    z, last, found = 0.0, 0.0, []
    for v in u:
        h, sign = (v - last) / n_steps, np.sign(v - last)
        for _ in range(n_steps):
            k1 = abs(h) * rate(z, sign, operator)
            k2 = abs(h) * rate(z + 0.5 * k1, sign, operator)
            k3 = abs(h) * rate(z + 0.5 * k2, sign, operator)
            z += (k1 + 2 * k2 + 2 * k3 + abs(h) * rate(z + k3, sign, operator)) / 6
        last = v
        found.append(z)
    return np.array(found)


# ------------------------------------------------------------------------- exact integration


@pytest.mark.parametrize("ratio", [0.0, 0.4, 1.0, 6.0])
def test_exponent_1_is_the_exponential_function(ratio):
    limit = 0.7
    operator = BoucWenOperator(0.0, 1.0, limit, ratio)
    way = np.linspace(0.0, 6.0, 200)
    np.testing.assert_allclose(
        hysteretic_part(operator, way), limit * -np.expm1(-way / limit), rtol=1e-13, atol=1e-15
    )
    back = np.linspace(0.0, 6.0, 300)
    if ratio:
        to_zero = limit * np.log1p(ratio) / ratio
        undone = -limit * np.expm1(ratio * (to_zero - back) / limit) / ratio
    else:
        to_zero, undone = limit, back - limit
    expected = np.where(back < to_zero, undone, -limit * np.expm1((to_zero - back) / limit))
    found = hysteretic_part(operator, -back, (limit, 0.0))
    np.testing.assert_allclose(found, -expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("ratio", [0.3, 1.0, 6.0])
def test_exponent_2_is_tanh_and_tan(ratio):
    limit = 0.7
    operator = BoucWenOperator(0.0, 1.0, limit, ratio, 2.0)
    way = np.linspace(0.0, 6.0, 200)
    np.testing.assert_allclose(
        hysteretic_part(operator, way), limit * np.tanh(way / limit), rtol=1e-12, atol=1e-13
    )
    root = np.sqrt(ratio)
    to_zero = limit * np.arctan(root) / root
    back = np.linspace(0.0, 6.0, 300)
    undone = -limit * np.tan(root * (to_zero - np.minimum(back, to_zero)) / limit) / root
    expected = np.where(back < to_zero, undone, limit * np.tanh((back - to_zero) / limit))
    found = hysteretic_part(operator, -back, (limit, 0.0))
    np.testing.assert_allclose(found, -expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("exponent", [0.5, 0.8, 1.2, 1.5, 3.3, 10.0, 20.0])
def test_any_exponent_is_a_hypergeometric_function(exponent):
    """The way from zero to w is ``w 2F1(1, 1/n; 1 + 1/n; -rho w^n)``."""
    w = np.concatenate([np.geomspace(1e-9, 0.4, 40), np.linspace(0.41, 0.99, 60)])
    a = 1.0 / exponent
    tolerance = 5e-12 if exponent >= 1.0 else 1e-9
    way = w * hyp2f1(1.0, a, 1.0 + a, w**exponent)
    for ratio in (0.0, 0.5, 2.0):
        operator = BoucWenOperator(0.0, 1.0, 1.0, ratio, exponent)
        np.testing.assert_allclose(hysteretic_part(operator, way), w, atol=tolerance, rtol=0)
        left = w * hyp2f1(1.0, a, 1.0 + a, -ratio * w**exponent)
        back = hyp2f1(1.0, a, 1.0 + a, -ratio) - left[::-1]
        found = hysteretic_part(operator, -back, (1.0, 0.0))
        np.testing.assert_allclose(found[::-1], w, atol=tolerance, rtol=0)


@pytest.mark.parametrize(("exponent", "ratio"), [(1.0, 0.6), (1.7, 0.0), (0.6, 2.0), (6.0, 1.0)])
def test_every_branch_begins_where_the_last_one_ended(exponent, ratio):
    operator = BoucWenOperator(0.0, 1.0, 0.7, ratio, exponent, 0.2)
    above, below = 0.7 * 1.2 ** (-1.0 / exponent), 0.7 * 0.8 ** (-1.0 / exponent)
    inside = above - np.geomspace(1e-14, 0.1, 40)
    for z in [*np.linspace(-below, above - 1e-3, 301), *inside, -1e-9, 1e-9, 0.0]:
        for way in (1e-200, -1e-200):
            assert hysteretic_part(operator, [way], (z, 0.0)) == pytest.approx(z, abs=2e-15)
    assert hysteretic_part(operator, [1e-3], (9.0, 0.0)) == pytest.approx(above, rel=1e-12)
    assert hysteretic_part(operator, [-1e-3], (-9.0, 0.0)) == pytest.approx(-below, rel=1e-12)


def test_not_a_number_does_no_harm():
    operator = BoucWenOperator(0.3, -1.2, 0.7, 0.5, 1.3)
    assert operator.run([0.1, 0.3, -0.2], 1.0, (np.nan, 0.0))[0].shape == (3,)
    assert np.isnan(operator.run(np.full(3, np.nan), 1.0)[0]).all()


@pytest.mark.parametrize("alpha", [1.3, -1.3])
@pytest.mark.parametrize(("beta", "gamma", "exponent"), [(0.9, 0.4, 1.0), (0.6, -0.2, 1.6)])
def test_the_law_as_printed(alpha, beta, gamma, exponent):
    """Integrated over time, with g itself."""
    operator = BoucWenOperator.from_coefficients(alpha, beta, gamma, exponent, gain=0.2)

    def law(time, g):
        speed = np.cos(time) + 1.2 * np.cos(3.0 * time)
        size = np.abs(g)
        return speed * alpha - size ** (exponent - 1) * (
            beta * np.abs(speed) * g + gamma * speed * size
        )

    time = np.linspace(0.0, 12.0, 4001)
    u = np.sin(time) + 0.4 * np.sin(3.0 * time)
    g = solve_ivp(law, (0, 12), [0.0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y[0]
    np.testing.assert_allclose(operator.run(u, 1.0)[0], 0.2 * u + g, atol=2e-5)
    assert operator.coefficients() == pytest.approx((alpha, beta, gamma), rel=1e-12)


def test_asymmetric_law():
    rng = np.random.default_rng(2)
    u = np.cumsum(rng.normal(size=40))
    for asymmetry in (-0.6, 0.3):
        operator = BoucWenOperator(0.0, 1.0, 1.4, 0.7, 1.8, asymmetry)
        expected = integrate(operator, u, 400)
        np.testing.assert_allclose(hysteretic_part(operator, u), expected, atol=1e-5)


# ---------------------------------------------------------------------------------- theorems


@settings(deadline=None, max_examples=40)
@given(operators(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(operator, u, seed):
    """Repeated samples, and samples on the way from one to the next, change nothing."""
    time = np.arange(u.size, dtype=float)
    extra = np.random.default_rng(seed).random(3 * u.size) * (u.size - 1)
    warped = np.sort(np.concatenate((time, time, extra)))
    slow = hysteretic_part(operator, np.interp(warped, time, u))
    np.testing.assert_allclose(
        slow[np.searchsorted(warped, time)],
        hysteretic_part(operator, u),
        rtol=0,
        atol=1e-8 * operator.limit + 1e-12,
    )


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_limit_cycle_bound(operator, u):
    """``|z| <= (1 / (beta + gamma +- 2 phi))^(1/n)``, however far the drive goes."""
    z = hysteretic_part(operator, np.concatenate([u, 1e6 * u]))
    power = operator.limit**-operator.exponent
    above = (power * (1.0 + operator.asymmetry)) ** (-1.0 / operator.exponent)
    below = (power * (1.0 - operator.asymmetry)) ** (-1.0 / operator.exponent)
    assert z.max() <= above * (1 + 1e-13)
    assert z.min() >= -below * (1 + 1e-13)


@settings(deadline=None, max_examples=40)
@given(operators(), signals)
def test_dissipation(operator, u):
    """The work done on the device is never less than the energy ``z^2 / 2`` that it stores."""
    steps = np.arange(200 * (u.size - 1) + 1) / 200
    fine = np.interp(steps, np.arange(u.size), u)
    z = hysteretic_part(operator, fine)
    work = np.cumsum(0.5 * (z[1:] + z[:-1]) * np.diff(fine))
    spare = work - 0.5 * (z[1:] ** 2 - z[0] ** 2)
    # the trapezoidal rule is off by the curvature, at each step
    step = np.abs(np.diff(fine)).max()
    error = step * operator.limit * (1 + operator.ratio) * (1 - abs(operator.asymmetry)) ** -2
    assert np.all(spare >= -error - 1e-9)


@settings(deadline=None, max_examples=30)
@given(operators(), signals)
def test_odd_symmetry_turns_the_asymmetry_around(operator, u):
    turned = dataclasses.replace(operator, asymmetry=-operator.asymmetry)
    scale = operator.limit * 10.0
    np.testing.assert_allclose(
        hysteretic_part(turned, -u), -hysteretic_part(operator, u), rtol=0, atol=1e-12 * scale
    )


@settings(deadline=None, max_examples=30)
@given(operators(asymmetric=False), signals)
def test_asymmetric_law_becomes_the_symmetric_one(operator, u):
    near = dataclasses.replace(operator, asymmetry=1e-13)
    np.testing.assert_allclose(
        hysteretic_part(near, u), hysteretic_part(operator, u), rtol=0, atol=1e-9 * operator.limit
    )


@settings(deadline=None, max_examples=30)
@given(operators(), signals, st.floats(-12, 12))
def test_unit_of_the_drive(operator, u, decades):
    unit = 10.0**decades
    other = dataclasses.replace(operator, limit=operator.limit * unit)
    np.testing.assert_allclose(
        hysteretic_part(other, unit * u) / unit,
        hysteretic_part(operator, u),
        rtol=0,
        atol=1e-8 * operator.limit,
    )


@given(operators())
def test_way_before_sliding(operator):
    """On it the hysteretic part would reach its limit if it kept its first slope."""
    operator = dataclasses.replace(operator, asymmetry=0.0)
    way = operator.presliding_displacement
    z = hysteretic_part(operator, np.array([1e-9 * way, 1e9 * way]))
    assert z[1] == pytest.approx(z[0] / (1e-9 * way) * way, rel=1e-4)


def test_any_history_is_forgotten_at_the_limit():
    operator = BoucWenOperator(0.3, 1.0, 0.5, 0.7, 1.4)
    tail = np.array([9.0, -3.0, 0.4])
    first = operator.run(np.append([0.2, -0.7, 0.1], tail), 1.0)[0][-3:]
    second = operator.run(np.append([-5.0, 4.0, 3.9], tail), 1.0)[0][-3:]
    np.testing.assert_allclose(first, second, atol=1e-9)


# ---------------------------------------------------------------------------------- tangents


@settings(deadline=None, max_examples=25)
@given(operators(), st.integers(0, 1000))
def test_run_in_pieces_and_tangents(operator, seed):
    u = np.cumsum(np.random.default_rng(seed).normal(size=50))
    # the ratio of the steeper side, from which on the derivatives lose digits
    ratio = max(operator.ratio, 0.01) * (1.0 - abs(operator.asymmetry))
    operator = dataclasses.replace(operator, limit=1.0, ratio=ratio)
    check_operator(operator, u, 1.0)
    at_bound, additive = (
        dataclasses.replace(operator, ratio=ratio).sensitivities(u, u[:, None], 1.0)[1]
        for ratio in (0.0, 1e-9)
    )
    scale = max(np.abs(additive).max(), 1.0)
    np.testing.assert_allclose(at_bound, additive, rtol=0, atol=1e-6 * scale)


# -------------------------------------------------------------------------------- parameters


@pytest.mark.parametrize(
    ("alpha", "beta", "gamma"), [(1.0, 0.3, 0.4), (1.0, 0.3, -0.3), (-1.0, 0.3, 0.3), (1.0, 0, 0)]
)
def test_laws_that_are_not_bounded_or_do_not_dissipate(alpha, beta, gamma):
    with pytest.raises(ValueError, match="from_coefficients needs 'beta' > 0"):
        BoucWenOperator.from_coefficients(alpha, beta, gamma)


def test_no_hysteretic_part_has_no_coefficients():
    alpha, beta, gamma = BoucWenOperator(1.0, 0.0, 2.0, exponent=1.5).coefficients()
    assert (alpha, beta, gamma) == (0.0, np.inf, 0.0)
    assert BoucWenOperator(1.0, 1e-90, 1e-90, exponent=4.0).coefficients()[1] == np.inf


# -------------------------------------------------------------------------------------- estimator

NOISE = 0.005


def plant(seed, n=1000):
    """Return drive, clean and noisy response, noise and parameters, in arbitrary units."""
    rng, time = np.random.default_rng(seed), np.arange(n) / n
    u = np.sin(2 * np.pi * 4 * time) * (0.3 + 0.7 * time)
    u += 0.25 * np.sin(2 * np.pi * 15 * time + rng.uniform(0, 6.28))
    drive_unit, unit = 10.0 ** rng.uniform([-6, -6], 3)
    sizes = rng.uniform([0.3, 0.5, 0.08, 0.1, 1.0], [1.5, 2.0, 0.5, 2.0, 3.0])
    sizes[1] *= rng.choice([-1.0, 1.0])
    sizes *= [unit / drive_unit, unit / drive_unit, drive_unit, 1.0, 1.0]
    u *= drive_unit
    clean = BoucWenOperator(*sizes).run(u, 1.0)[0]
    error = NOISE * clean.std() * rng.normal(size=n)
    return u, clean, clean + error, np.sqrt(np.mean(error**2)), [*sizes, 0.0]


@pytest.mark.slow
def test_plants_are_found_to_the_noise_in_few_evaluations(assert_recovered):
    evaluations = assert_recovered(BoucWen("fit"), map(plant, range(60)))
    assert np.median(evaluations) <= 12
    assert max(evaluations) <= 30


def test_coefficients_of_the_law():
    u, _, y, _, _ = plant(0)
    model = BoucWen("fit").fit(u[:, None], y)
    coefficients = model.alpha_, model.beta_, model.gamma_, model.exponent_
    law = BoucWenOperator.from_coefficients(*coefficients)
    assert law.limit == pytest.approx(model.params_["limit"], rel=1e-9)
    assert law.ratio == pytest.approx(model.params_["ratio"], rel=1e-9)
    assert model.alpha_ == model.params_["alpha"]
    assert model.intercept_ == model.params_["intercept"]


def drive(n=800):
    time = np.arange(n) / n
    return np.sin(2 * np.pi * 3 * time) * (0.4 + 0.6 * time)


def test_exponent_is_held_unless_fitted():
    u = drive()
    y = BoucWenOperator(0.4, 1.0, 0.3, 0.5, 2.0).run(u, 1.0)[0]
    held = BoucWen(exponent=2.0, fit_intercept=False).fit(u[:, None], y)
    assert set(held.params_) == {"gain", "alpha", "limit", "ratio"}
    assert held.exponent_ == 2.0
    assert held.params_["ratio"] == pytest.approx(0.5, rel=1e-6)
    wrong = BoucWen().fit(u[:, None], y)
    assert wrong.exponent_ == 1.0
    assert wrong.fit_error_ > 1e3 * held.fit_error_


def test_asymmetry():
    u, rng = drive(), np.random.default_rng(0)
    y = BoucWenOperator(0.4, -1.0, 0.3, 0.5, 1.3, 0.4, 2.0).run(u, 1.0)[0]
    y += NOISE * y.std() * rng.normal(size=len(y))
    model = BoucWen("fit", asymmetry=True).fit(u[:, None], y)
    assert abs(model.params_["asymmetry"] - 0.4) < 4 * model.params_std_["asymmetry"] < 0.4
    assert model.fit_error_ < 0.5 * BoucWen("fit").fit(u[:, None], y).fit_error_


def test_unknown_history():
    truth = BoucWenOperator(0.4, 1.0, 0.3, 0.5)
    u = drive() - 0.2
    y = truth.run(u, 1.0, truth.init(0.6))[0]
    y += 1e-3 * np.random.default_rng(0).normal(size=len(y))
    known = BoucWen(initial_state="estimate").fit(u[:, None], y)
    with pytest.warns(ConvergenceWarning, match="with initial_state='estimate' the error is"):
        at_rest = BoucWen().fit(u[:, None], y)
    assert known.fit_error_ < 0.3 * at_rest.fit_error_
    assert known.initial_drive_.max() > 0.4


@pytest.mark.parametrize("h", [2e-2, -2e-2])
@pytest.mark.parametrize(("z", "bound"), [(0.0, 1e-7), (0.3, 1e-10), (-0.4, 1e-10)])
def test_a_step_of_the_integrated_form_follows_the_differential_equation(z, bound, h):
    """Of fourth order but at zero, where the law is not smooth."""
    share = 0.2 if z * h < 0.0 else 0.7  # of unloading, of loading
    errors = []
    for size in (h, 0.5 * h):
        exact = solve_ivp(
            lambda x, state: [1.0 - share * abs(state[0] / 1.5) ** 1.6],
            *((0.0, size), [z]),
            **{"rtol": 1e-13, "atol": 1e-16, "max_step": 0.02 * abs(size)},
        )
        errors.append(abs(runge_kutta(z, size, 1.6, share, 1.0 / 1.5) - exact.y[0, -1]))
    assert errors[0] < bound
    assert errors[1] < errors[0] / (20.0 if z else 4.0)
