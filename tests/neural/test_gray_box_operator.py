"""Laws of the gray-box network."""

import dataclasses
from itertools import combinations_with_replacement

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from skhyst.hysteresis import SystemLevelOperator
from skhyst.neural import GrayBoxOperator
from skhyst.neural._gray_box_operator import gray_box_run, gray_box_tangents

STATIC = SystemLevelOperator(1.1, 0.4, 0.7, 0.3)
DT = 0.01


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(0)
    return 0.5 + 0.2 * np.cumsum(rng.normal(size=400)) * np.hanning(400)


@pytest.mark.parametrize("dynamics", ["rate", "printed"])
@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_without_weights_it_is_the_static_model(drive, dynamics, initial_state):
    operator = GrayBoxOperator.at_rest(STATIC, degree=2, dynamics=dynamics)
    y, _ = operator.run(drive, DT, operator.init(drive[0], initial_state))
    expected, _ = STATIC.run(drive, DT, STATIC.init(drive[0], initial_state))
    np.testing.assert_allclose(y, expected, atol=1e-14)


def test_of_degree_one_it_is_hysteresis_and_a_second_order_mode(drive):
    """Weights from the discrete form of the mode by SciPy; the filter is SciPy's too."""
    omega, zeta = 40.0, 0.2
    numerator, (_, a1, a2), _ = cont2discrete(
        ([omega**2], [1.0, 2 * zeta * omega, omega**2]), DT, method="foh"
    )
    b0, b1, b2 = numerator.ravel()
    e = -a1 - a2
    operator = GrayBoxOperator(STATIC, np.array([b0 - 1.0 + e, -b2, e, a2]))
    assert operator.term_names() == ["dd(k)", "dd(k-1)", "e(k)", "dy(k-1)"]
    level = STATIC.run(drive, DT)[0]
    padded = np.r_[np.full(3000, level[0]), level]  # at rest before
    expected = lfilter([b0, b1, b2], [1.0, a1, a2], padded)[3000:]
    np.testing.assert_allclose(operator.run(drive, DT)[0], expected, atol=1e-11)
    poles = np.exp(DT * omega * (-zeta + 1j * np.sqrt(1 - zeta**2)))
    np.testing.assert_allclose(np.sort_complex(operator.poles()), [poles.conj(), poles], atol=1e-12)


def test_the_printed_form_is_equation_35(drive):
    rng = np.random.default_rng(1)
    pairs = list(combinations_with_replacement(range(4), 2))
    weights = np.r_[0.2, -0.1, 0.3, -0.2, 0.01 * rng.normal(size=len(pairs))]
    operator = GrayBoxOperator(STATIC, weights, degree=2, dynamics="printed")
    level = STATIC.run(drive, DT, STATIC.init(drive[0], "zero"))[0]
    u, y = np.r_[0.0, 0.0, drive], np.zeros(len(drive) + 2)
    for k in range(2, len(y)):
        x = [u[k - 1], u[k - 2], y[k - 1], y[k - 2]]
        y[k] = level[k - 2] + weights[:4] @ x
        y[k] += sum(w * x[i] * x[j] for w, (i, j) in zip(weights[4:], pairs, strict=True))
    found, _ = operator.run(drive, DT, operator.init(drive[0], "zero"))
    np.testing.assert_allclose(found, y[2:], atol=1e-12)


def test_products_of_rates_vanish_at_rest():
    """Held still, the response ends where the static model is, whatever the weights."""
    rng = np.random.default_rng(2)
    n = len(GrayBoxOperator.at_rest(STATIC, degree=2).weights)
    weights = np.r_[0.1, 0.2, 0.4, -0.2, 0.02 * rng.normal(size=n - 4)]
    operator = GrayBoxOperator(STATIC, weights, degree=2)
    drive = np.r_[np.linspace(0.0, 1.3, 30), np.linspace(1.3, 0.4, 20), np.full(200, 0.4)]
    y, level = operator.run(drive, DT)[0], STATIC.run(drive, DT)[0]
    assert np.abs(y - level).max() > 0.01
    np.testing.assert_allclose(y[-1], level[-1], atol=1e-12)


def test_regressors_explain_a_noise_free_run(drive):
    for dynamics, degree in (("rate", 2), ("printed", 2), ("rate", 1)):
        zero = GrayBoxOperator.at_rest(STATIC, degree=degree, dynamics=dynamics)
        weights = 0.05 * np.cos(np.arange(len(zero.weights)))
        operator = dataclasses.replace(zero, weights=weights)
        y, _ = operator.run(drive, DT)
        columns, rest = operator.regressors(drive, y, DT)
        np.testing.assert_allclose(columns @ weights, rest, atol=1e-12)


def test_what_diverges_is_no_number_nor_are_its_tangents(drive):
    operator = GrayBoxOperator(STATIC, np.array([0.0, 0.0, 0.0, -3.0]))
    assert np.abs(operator.poles()).max() > 1.0
    y, _ = operator.run(np.tile(drive, 5), DT)
    first = np.flatnonzero(np.isnan(y))[0]
    assert np.isnan(y[first:]).all()
    assert np.isfinite(y[:first]).all()
    _, dy = operator.linearize(drive, np.empty((len(drive), 0)), DT)
    assert np.isnan(dy).all()


def test_compiled_loops_equal_plain_ones():
    rng = np.random.default_rng(3)
    operator = GrayBoxOperator.at_rest(STATIC, degree=2)
    mix, terms = operator._mix, operator._terms
    weights = 0.1 * rng.normal(size=len(terms))
    level, w = rng.normal(size=30), rng.normal(size=32)
    runs = [np.zeros(32), np.zeros(32)]
    m = 2 + len(weights)
    dlevel, dw = rng.normal(size=(30, m)), rng.normal(size=(32, m))
    tangents = [np.zeros((32, m)), np.zeros((32, m))]
    for y, dy, pick in zip(
        runs, tangents, (lambda f: f, lambda f: getattr(f, "py_func", f)), strict=True
    ):
        pick(gray_box_run)(level, w, mix, terms, weights, y)
        good = pick(gray_box_tangents)(w, mix, terms, weights, y, dlevel, dw, dy)
        assert good == 30
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(tangents[0], tangents[1], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [("dynamics", "other"), ("degree", 3), ("input_lags", -1), ("weights", np.zeros(3))],
)
def test_errors(name, value):
    with pytest.raises(ValueError, match=f"The '{name}' parameter of GrayBoxOperator must"):
        GrayBoxOperator(**{"static": STATIC, "weights": np.zeros(4)} | {name: value})
