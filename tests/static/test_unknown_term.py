"""A smooth function that is learned: what it is, and what it leaves to others."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from skhyst.compose import Cascade
from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.operators import inverse_of
from skhyst.optimize import RecordData
from skhyst.static import UnknownTerm, UnknownTermOperator, smooth

N = 1500
RNG = np.random.default_rng(3)
U = np.sin(np.cumsum(RNG.uniform(0.0, 0.2, N)))


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_functions_are_cubic_b_splines():
    knots = np.arange(-3.0, 9.0)  # five intervals from 0 to 5, and three to either side
    operator = UnknownTermOperator(np.zeros(8), np.eye(8), 0.0, 5.0)
    v = np.linspace(0.0, 4.999, 40)
    splines = BSpline(knots, np.eye(8), 3)
    np.testing.assert_allclose(operator.functions(v), splines(v), atol=1e-12)
    for k in range(8):
        own = replace(operator, weights=np.eye(8)[k])
        np.testing.assert_allclose(own.slopes(v)[:, 0], splines(v, nu=1)[:, k], atol=1e-12)


@pytest.mark.parametrize(
    ("argument", "second", "linear_in"),
    [
        ("input", None, None),
        ("rate", None, None),
        ("play", None, None),
        ("turn", None, None),
        ("input", "rate", None),
        ("input", "play", "argument"),
        ("input", "rate", "second"),
    ],
)
def test_finds_the_function(argument, second, linear_in):
    model = UnknownTerm(argument, second=second, half_gap=0.3, linear_in=linear_in, dt=0.01)
    alone = model.flexible([_record(U, U)])
    a = alone.arguments(U, 0.01)[0].reshape(N, -1)
    a = a / np.abs(a).max(axis=0)
    factors = [np.exp(a[:, 0]), np.sin(2.0 * a[:, -1])]
    if linear_in is not None:
        at = int(linear_in == "second")
        factors[at] = a[:, at]
    truth = factors[0] * factors[1]
    y = truth + 0.1 * RNG.normal(size=N)
    model.fit(U[:, None], y)
    # least squares of q functions has a variance of q / n of the noise's
    q = model.operator_.effective_number
    assert q >= 3
    assert rms(model.predict(U[:, None]) - truth) < 2.0 * 0.1 * np.sqrt(q / N)


def test_noise_has_no_function_but_a_straight_line():
    counts = []
    for seed in range(20):
        y = np.random.default_rng(seed).normal(size=N)
        counts.append(UnknownTerm(dt=0.01).fit(U[:, None], y).operator_.effective_number)
    # a constant and a slope are not penalised; maximum likelihood rarely has more for noise
    assert 2.0 <= np.median(counts) < 2.5


def test_samples_far_away_do_not_undo_the_smoothness():
    # next to a gap are splines that hardly any sample sees, far rougher than all others; what is
    # straight goes on across the gap
    y, counts = np.random.default_rng(0).normal(size=N), []
    for far in np.linspace(1.5, 4.0, 12):
        model = UnknownTerm(dt=0.01).fit(np.append(U[:-1], far)[:, None], y)
        counts.append(model.operator_.effective_number)
    assert min(counts) > 2.0 - 1e-6
    assert max(counts) < 6.0


def test_leaves_to_the_parameters_what_they_can_do():
    operator = UnknownTerm().flexible([_record(U, U)])
    own = operator.functions(U)
    y = U**3
    columns = np.c_[own, U, np.ones(N), -y]
    found = smooth(operator, columns.T @ columns, slice(0, own.shape[1]), N)
    functions = found.functions(U)
    # next to nothing of any of them is what a gain and an intercept do
    line = np.linalg.qr(np.c_[U, np.ones(N)])[0]
    fitted = line @ (line.T @ functions)
    assert np.all(rms(functions - fitted) > 0.05 * rms(functions))
    left = np.linalg.lstsq(np.c_[functions, U, np.ones(N)], y, rcond=None)[0]
    assert rms(np.c_[functions, U, np.ones(N)] @ left - y) < 1e-3


def _record(u, y):
    return RecordData(u, y, 0.01)


def test_is_a_part_of_a_joint_fit():
    lag = FirstOrderLagOperator(0.05, gain=3.0)
    y = lag.run(U + 0.5 * np.abs(U) ** 1.5, 0.01)[0] + 0.01 * RNG.normal(size=N)
    model = Cascade([("curve", UnknownTerm(passes=True)), ("lag", FirstOrderLag())], dt=0.01)
    with pytest.warns(ConvergenceWarning, match="gain"):  # which the curve has, too
        model.fit(U[:, None], y)
    assert rms(model.predict(U[:, None]) - y) < 0.011
    assert model.operators_["lag"].time_constant == pytest.approx(0.05, rel=0.02)


def test_is_constant_beyond_its_range():
    model = UnknownTerm(dt=0.01).fit(U[:, None], U**2)
    ends = model.operator_.run(np.array([U.min(), U.min() - 9.0, U.max(), U.max() + 9.0]), 0.01)[0]
    np.testing.assert_allclose(ends[::2], ends[1::2])
    fading = UnknownTerm(fade=0.5, dt=0.01).fit(U[:, None], U**2).operator_
    within, beyond = fading.run(np.array([U.max(), U.max() + 0.5 * np.ptp(U)]), 0.01)[0]
    assert beyond == pytest.approx(within / np.e)
    u, law = np.array([np.nan, 0.0]), model.operator_.compiled_step(0.01, ())
    for y in (model.operator_.run(u, 0.01)[0], law.streaming(law.state.copy())(u)):
        np.testing.assert_array_equal(np.isnan(y), [True, False])


def test_argument_that_does_not_move():
    model = UnknownTerm("play", half_gap=10.0, dt=0.01).fit(U[:, None], np.full(N, 2.0))
    np.testing.assert_allclose(model.predict(U[:, None]), 2.0)


def test_time_since_a_turn():
    term = UnknownTermOperator(np.ones(1), np.ones((4, 1)), 0.0, 0.04, argument="turn")
    u = np.array([0.0, 1.0, 2.0, 1.0, 1.0, 0.0, -1.0, -2.0, -3.0, 1.0])
    # none was seen before, so that it is as long ago as can be; a rest is no turn
    expected = [0.04, 0.04, 0.04, 0.0, 0.01, 0.02, 0.03, 0.04, 0.04, 0.0]
    np.testing.assert_allclose(term.arguments(u, 0.01)[0], expected)


@pytest.mark.parametrize("second", ["play", "rate"])
def test_inverse_where_the_output_is_monotone(second):
    table = 1.5 + np.sin(0.7 * np.arange(7.0))
    basis = np.outer(table, np.arange(7.0) if second == "rate" else table).reshape(-1, 1)
    own = {"second": second, "half_gap": 0.2, "passed": 1.0}
    ends = {"second_low": -5.0, "second_high": 5.0}
    operator = UnknownTermOperator(np.array([0.02]), basis, -1.0, 1.0, **own, **ends)
    assert operator.at_once
    u = 0.9 * np.sin(np.arange(200) / 9.0)
    drive, _ = inverse_of(operator).run(u, 0.01)
    np.testing.assert_allclose(operator.run(drive, 0.01)[0], u, atol=1e-9)
    assert not replace(operator, weights=np.array([-9.0])).at_once
