"""The Jiles-Atherton model: its laws, and its identification from simulated and measured loops."""

import dataclasses
from itertools import groupby

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import SHARED
from scipy.integrate import solve_ivp
from scipy.io import loadmat
from scipy.optimize import brentq

from skhyst.hysteresis import JilesAtherton, JilesAthertonOperator
from skhyst.hysteresis._jiles_atherton import langevin
from skhyst.operators import check_operator

OPERATOR = JilesAthertonOperator(1.0, 1.0, 1.3, 0.6, 0.2, max_step=0.02)
SIGNALS = st.lists(st.floats(-8, 8).map(lambda v: round(v, 3)), min_size=1, max_size=8)
PLANTS = st.builds(
    JilesAthertonOperator,
    st.just(1.0),
    st.floats(0.1, 5.0),
    st.floats(0.05, 5.0),
    st.floats(0.0, 0.95),
    st.floats(0.0, 1.0),
)


def anhysteretic(field, shape, coupling):
    """Solve m = L((field + alpha Ms m) / shape)."""

    def gap(m):
        x = field / shape + 3.0 * coupling * m
        return (1.0 / np.tanh(x) - 1.0 / x if abs(x) > 1e-4 else x / 3.0) - m

    return brentq(gap, -1.0, 1.0, xtol=1e-15)


def textbook(operator, fields, rtol=1e-12):
    """Integrate the printed equation along straight branches, tightly, for m = M / Ms."""
    a, k, c = operator.shape, operator.pinning, operator.reversibility
    alpha = 3.0 * a * operator.coupling  # times Ms

    def slope(h, m, direction):
        x = (h + alpha * m[0]) / a
        if abs(x) < 1e-3:
            curve, steep = x / 3.0 - x**3 / 45.0, (1.0 / 3.0 - x**2 / 15.0) / a
        else:
            curve, steep = 1.0 / np.tanh(x) - 1.0 / x, (1.0 / x**2 - 1.0 / np.sinh(x) ** 2) / a
        gap = curve - m[0]
        loss = gap / (k * direction - alpha * gap) if gap * direction > 0.0 else 0.0
        return [(loss + c * steep) / (1.0 - c * alpha * steep)]

    fields = np.asarray(fields, dtype=float)
    directions, found, m, last = np.sign(np.diff(fields, prepend=0.0)), [], 0.0, 0.0
    for direction, samples in groupby(range(fields.size), directions.__getitem__):
        branch = fields[list(samples)]
        if direction == 0.0:
            found += [m] * branch.size
            continue
        options = {"args": (direction,), "rtol": rtol, "atol": 1e-2 * rtol, "max_step": 2.0 * k}
        found += list(
            solve_ivp(slope, (last, branch[-1]), [m], "DOP853", t_eval=branch, **options).y[0]
        )
        m, last = found[-1], branch[-1]
    return np.array(found)


def order(operator, path, steps):
    """Regress the error at the end of a path on the length of the step."""
    exact = textbook(operator, path)[-1]
    errors = [
        abs(dataclasses.replace(operator, max_step=h).run(path, 1.0)[0][-1] - exact) for h in steps
    ]
    return np.polyfit(np.log(steps), np.log(errors), 1)[0], errors[-1]


def test_order_four_on_a_first_magnetisation():
    slope, smallest = order(OPERATOR, [2.0], 2.0 / np.array([4, 8, 16, 32, 64]))
    assert slope == pytest.approx(4.0, abs=0.3)
    assert smallest < 1e-8


def test_order_two_at_least_where_the_irreversible_part_sets_in():
    slope, smallest = order(OPERATOR, [4.0, -4.0], 8.0 / np.array([16, 32, 64, 128, 256, 512]))
    assert slope > 1.9
    assert smallest < 1e-5


@settings(deadline=None, max_examples=15)
@given(SIGNALS)
def test_textbook_equation(values):
    y, _ = dataclasses.replace(OPERATOR, max_step=0.005).run(values, 1.0)
    np.testing.assert_allclose(y, textbook(OPERATOR, values), atol=1e-5)


@settings(deadline=None, max_examples=15)
@given(SIGNALS)
def test_rate_independence(values):
    """Samples on the way change the steps, not the curve; the interval does not count at all."""
    fractions = np.linspace(0.0, 1.0, 6)[1:]
    path = np.concatenate([[0.0], values])
    way = (path[:-1, None] + np.diff(path)[:, None] * fractions).ravel()
    y, _ = OPERATOR.run(values, 1.0)
    np.testing.assert_array_equal(OPERATOR.run(values, 1e-6)[0], y)
    np.testing.assert_allclose(OPERATOR.run(way, 1.0)[0][4::5], y, atol=2e-4)
    np.testing.assert_array_equal(OPERATOR.run(np.repeat(values, 3), 1.0)[0], np.repeat(y, 3))


@settings(deadline=None, max_examples=15)
@given(SIGNALS, PLANTS)
def test_odd_symmetry(values, operator):
    u = np.array(values)
    np.testing.assert_array_equal(operator.run(-u, 1.0)[0], -operator.run(u, 1.0)[0])


@settings(deadline=None, max_examples=15)
@given(SIGNALS, PLANTS, st.floats(0.01, 100.0))
def test_bounds(values, operator, max_step):
    """Finite and within saturation for any step, and never moving against the drive."""
    operator = dataclasses.replace(operator, max_step=max_step)
    y, _ = operator.run(values, 1.0)
    assert (np.abs(y) <= 1.0).all()
    moves, steps = np.diff(y, prepend=0.0), np.diff(values, prepend=0.0)
    assert (moves * np.sign(steps) >= -1e-12).all()
    assert np.isfinite(
        operator.sensitivities(np.array(values), np.ones((len(values), 1)), 1.0)[1]
    ).all()


def test_saturation():
    fields = np.array([50.0, 200.0, 1000.0])
    y, _ = OPERATOR.run(fields, 1.0)
    expected = [anhysteretic(field, 1.0, 0.6) for field in fields]
    np.testing.assert_allclose(y, expected, atol=1e-3)
    assert 0.998 < y[-1] < 1.0
    remanence = [OPERATOR.run([field, 0.0], 1.0)[0][-1] for field in (50.0, 100.0, 150.0)]
    assert abs(remanence[2] - remanence[1]) < abs(remanence[1] - remanence[0]) < 1e-3


@pytest.mark.parametrize("coupling", [0.0, 0.5, 0.9])
def test_little_pinning_leaves_the_anhysteretic_curve(coupling):
    path = np.array([0.5, 2.0, 4.0, 1.0, -0.5, -3.0, 0.2, 2.0])
    expected = np.array([anhysteretic(field, 1.0, coupling) for field in path])
    errors = []
    for pinning in (0.02, 0.01):
        operator = JilesAthertonOperator(
            1.0, 1.0, pinning, coupling, 0.2, max_step=0.2 * pinning * (1 - coupling)
        )
        errors.append(np.abs(operator.run(path, 1.0)[0] - expected).max())
    assert errors[1] < 0.6 * errors[0] < 0.1


@pytest.mark.parametrize("coupling", [0.0, 0.5, 0.9])
def test_reversible_magnetisation_is_the_anhysteretic_curve(coupling):
    path = np.array([0.5, 2.0, 4.0, 1.0, -0.5, -3.0, 0.2, 2.0])
    expected = [anhysteretic(field, 1.0, coupling) for field in path]
    operator = JilesAthertonOperator(1.0, 1.0, 1.3, coupling, 1.0, max_step=0.01)
    np.testing.assert_allclose(operator.run(path, 1.0)[0], expected, atol=2e-5)


@settings(deadline=None, max_examples=15)
@given(PLANTS, st.floats(0.3, 10.0))
def test_loops_dissipate(operator, amplitude):
    """The work of the drive over a steady loop, the integral of H dB, is not negative."""
    n = 400
    u = amplitude * np.sin(2 * np.pi * np.arange(4 * n + 1) / n)
    operator = dataclasses.replace(operator, gain=0.3, max_step=0.01)
    y, _ = operator.run(u, 1.0)
    u, y = u[-n - 1 :], y[-n - 1 :]
    work = 0.5 * np.sum((u[1:] + u[:-1]) * np.diff(y))
    assert work > -1e-4 * amplitude
    if operator.reversibility < 0.8 and operator.pinning > 0.3:
        assert work > 0.0


def test_units():
    """A response in other units scales; a drive in other units scales all lengths."""
    u = np.random.default_rng(0).normal(size=50).cumsum()
    y, _ = dataclasses.replace(OPERATOR, gain=0.1).run(u, 1.0)
    scaled = JilesAthertonOperator(1e-3, 1e6, 1.3e6, 0.6, 0.2, 1e-10, max_step=2e4)
    np.testing.assert_allclose(scaled.run(1e6 * u, 1.0)[0], 1e-3 * y, rtol=1e-9)


def test_default_step_is_kept_by_copies():
    operator = JilesAthertonOperator(1.0, 2.0, 3.0, 0.5, 0.2)
    assert operator.max_step == pytest.approx(0.2)
    assert operator.unpack(1.5 * operator.pack()).max_step == operator.max_step


def test_an_absurd_drive_comes_to_an_end():
    operator = dataclasses.replace(OPERATOR, max_step=1e-300)
    assert abs(operator.run([1e300], 1.0)[0][0]) <= 1.0


NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
SMALL = [1e-300, 1e-12, 1e-5, 1e-2, 0.3, 0.4999, 0.5001, 0.8]


@pytest.mark.parametrize("x", [*SMALL, 2.0, 7.0, 30.0])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_langevin_is_the_mean_of_a_dipole(x, sign):
    """L, L' and L'' are mean, variance and third moment of cos(angle) with weight exp(x cos)."""
    density = WEIGHTS * np.exp(x * (NODES - 1.0))
    density /= density.sum()
    mean = density @ NODES
    moments = [sign * mean, density @ (NODES - mean) ** 2, sign * density @ (NODES - mean) ** 3]
    np.testing.assert_allclose(langevin(sign * x), moments, rtol=1e-12, atol=2e-15)


def test_langevin_near_zero_and_far_away():
    assert langevin(0.0) == (0.0, 1 / 3, 0.0)
    value, slope, bend = langevin(1e-160)
    np.testing.assert_allclose([value, slope, bend], [1e-160 / 3, 1 / 3, -2e-160 / 15], rtol=1e-12)
    np.testing.assert_allclose(langevin(1e4), [1.0 - 1e-4, 1e-8, -2e-12], rtol=1e-12)
    np.testing.assert_allclose(langevin(-1e4), [1e-4 - 1.0, 1e-8, 2e-12], rtol=1e-12)
    assert np.isfinite(langevin(1e200)).all()


@pytest.mark.parametrize("seed", range(8))
def test_tangents(seed):
    rng = np.random.default_rng(seed)
    lengths, parts = rng.uniform([0.2, 0.1], 3.0), rng.uniform([0.02, 0.05], [0.9, 0.95])
    operator = JilesAthertonOperator(1.0, *lengths, *parts, gain=0.1)
    check_operator(operator, np.cumsum(rng.normal(size=60)), 1.0)


def plant(seed, n=1200):
    """Loops of three amplitudes; return field, clean and noisy response, noise and parameters."""
    rng = np.random.default_rng(seed)
    a = 10.0 ** rng.uniform(-5, 5)
    k = a * 10.0 ** rng.uniform(-0.3, 0.4)
    coupling, c = rng.uniform(0.2, 0.75), rng.uniform(0.05, 0.4)
    ms = a * 10.0 ** rng.uniform(1.5, 2.0)
    scale = 10.0 ** rng.uniform(-6, 6)
    time = 3.0 * np.arange(n) / n
    fields = 8.0 * (a + k) * np.sin(2 * np.pi * time) * np.array([0.2, 0.5, 1.0])[time.astype(int)]
    m = textbook(JilesAthertonOperator(1.0, a, k, coupling, c), fields, rtol=1e-9)
    clean = scale * (ms * m + fields)
    truth = {
        "saturation": scale * ms,
        "shape": a,
        "pinning": k,
        "coupling": coupling,
        "reversibility": c,
        "gain": scale,
        "intercept": scale * ms * rng.uniform(-0.2, 0.2),
    }
    clean += truth["intercept"]
    noise = 0.005 * clean.std()
    return fields, clean, clean + noise * rng.normal(size=n), noise, truth


@pytest.mark.slow
def test_recovery_and_standard_errors(assert_recovered):
    assert_recovered(JilesAtherton(), map(plant, range(30)))


def test_exact_recovery_with_a_known_gain():
    u, clean, _, _, truth = plant(0)
    model = JilesAtherton(truth["gain"]).fit(u[:, None], clean)
    assert "gain" not in model.params_
    assert model.operator_.gain == truth["gain"]
    for name in ("saturation", "shape", "pinning", "coupling"):
        assert model.params_[name] == pytest.approx(truth[name], rel=2e-3)


def test_steps_become_shorter_where_the_model_needs_it():
    """A wide soft tail and a narrow loop: the coercive field alone does not set the step."""
    truth = JilesAthertonOperator(1.0, 1.0, 4.0, 0.93, 0.1, max_step=0.01)
    u = 60.0 * np.sin(2 * np.pi * np.arange(1500) / 500) * np.linspace(0.1, 1.0, 1500)
    y, _ = truth.run(u, 1.0)
    model = JilesAtherton().fit(u[:, None], y)
    length = min(model.operator_.shape, model.operator_.pinning * (1 - model.operator_.coupling))
    assert model.operator_.max_step <= 0.2 * length
    assert model.fit_error_ < 2e-3


def test_units_of_the_data(assert_unit_free):
    u, _, y, _, _ = plant(3)
    assert_unit_free(JilesAtherton(), u, y, 1e-9, 1e7)


def measured(folder, name):
    loops = SHARED / "bh_loops" / folder
    fields = loadmat(loops / f"H_{name}.mat")["HmeasT"]
    return fields, loadmat(loops / f"B_{name}.mat")["BmeasT"]


def twice(fields, flux, columns):
    """Stack loops, each run through twice: the first turn leads in."""
    n = 2 * len(fields)
    index = pd.MultiIndex.from_product([columns, np.arange(n)], names=["record", "time"])
    drive = np.concatenate([np.tile(fields[:, i], 2) for i in columns])
    return (
        pd.DataFrame({"H": drive}, index),
        pd.Series(np.concatenate([np.tile(flux[:, i], 2) for i in columns]), index),
    )


@pytest.mark.slow
@pytest.mark.needs_recordings("bh_loops")
@pytest.mark.parametrize(
    ("folder", "name", "held_out", "limit"),
    [
        ("1_isotropic", "MnZn_ferrite", 2, 0.015),
        ("1_isotropic", "MnZn_ferrite", 3, 0.025),
        ("10_APPA", "M130_27s", 2, 0.05),
    ],
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # loops do
def test_measured_loops_of_an_amplitude_not_seen(folder, name, held_out, limit):
    """Root mean square error over range, smaller and larger amplitudes being known."""
    fields, flux = measured(folder, name)
    seen = [i for i in range(fields.shape[1]) if i != held_out]
    model = JilesAtherton().fit(*twice(fields, flux, seen))
    X, y = twice(fields, flux, [held_out])
    error = (model.predict(X) - y)[len(fields) :]
    assert np.sqrt(np.mean(error**2)) < limit * np.ptp(y)
