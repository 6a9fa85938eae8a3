"""A smooth function that is learned: what it is, and what it leaves to others."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from skhyst.compose import Cascade
from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
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
    for derivative in (False, True):
        expected = BSpline(knots, np.eye(8), 3)(v, nu=int(derivative))
        np.testing.assert_allclose(operator.functions(v, derivative), expected, atol=1e-12)


@pytest.mark.parametrize("argument", ["input", "rate", "play"])
def test_finds_the_function(argument):
    model = UnknownTerm(argument, half_gap=0.3, dt=0.01)
    alone = UnknownTermOperator(np.zeros(4), np.eye(4), 0.0, 1.0, argument, 0.3)
    a, _ = alone.arguments(U, 0.01)
    a = a / np.abs(a).max()
    truth = np.exp(a) * np.sin(2.0 * a)
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
    u, law = np.array([np.nan, 0.0]), model.operator_.compiled_step(0.01, ())
    for y in (model.operator_.run(u, 0.01)[0], law.streaming(law.state.copy())(u)):
        np.testing.assert_array_equal(np.isnan(y), [True, False])


def test_argument_that_does_not_move():
    model = UnknownTerm("play", half_gap=10.0, dt=0.01).fit(U[:, None], np.full(N, 2.0))
    np.testing.assert_allclose(model.predict(U[:, None]), 2.0)
