"""Kind restart: a fit ends at the noise, wherever its first starts lead, or says that it may not.

The truths are those of `benchmarks/optima.py` at which the first starts end in a local optimum.
"""

from dataclasses import replace

import numpy as np
import optima
import pytest
from scipy.signal import lsim
from sklearn.exceptions import ConvergenceWarning

from skhyst.compose import Cascade, Sum
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    KelvinVoigt,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
)
from skhyst.optimize import VariableProjection
from skhyst.static import SmoothCurve

FOUND = [
    *(("Dahl, lag", seed) for seed in (1, 13, 63)),
    ("backlash, mode", 43),
    *(("Bouc-Wen, mode", seed) for seed in (8, 20, 33, 94)),
    ("curve, 2 poles", 18),
    *(("3 poles, fold", seed) for seed in (0, 1, 2)),
    *(("mode, soft limit", seed) for seed in (8, 62)),
    ("mode, mode", 78),
    ("lag, backlash", optima.REPORTING + 97),
    ("TransferFunction, 4 poles", 16),
    ("TimeShift", 19),
]


@pytest.mark.parametrize(("name", "seed"), FOUND)
def test_fits_end_at_the_noise(name, seed):
    row = optima.trial(name, seed)
    assert row["ratio"] < 1.02
    assert not row["warned"]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 50.0])
def test_a_cascade_fits_no_worse_than_its_parts(scale):
    """Whatever the unit of the response, in which a curve alone would be of no use."""
    rng = np.random.default_rng(0)
    u, time = np.repeat(rng.uniform(-1.0, 1.0, 50), 20), 0.01 * np.arange(1000)
    bent = u + 0.5 * u**3 - 0.3 * u**2
    gain = scale, [1.0 / 25.0**2, 0.4 / 25.0, 1.0]
    y = scale * bent[0] + lsim(gain, bent - bent[0], time)[1]
    y += 0.01 * y.std() * rng.normal(size=1000)
    parts = [SmoothCurve(3), TransferFunction(2)]
    whole = Cascade([("curve", parts[0]), ("poles", parts[1])], dt=0.01).fit(u[:, None], y)
    assert whole.fit_error_ < 0.011 * y.std()
    alone = parts[1].set_params(dt=0.01).fit(u[:, None], y)
    assert whole.fit_error_ < alone.fit_error_


@pytest.mark.parametrize("order", [1, -1])
def test_a_sum_fits_in_either_order_of_its_steps(order):
    """Each explains part of what the other does: a lag and Bouc-Wen have a gain each."""
    rng = np.random.default_rng(3)
    u = np.sin(2.0 * np.pi * np.cumsum(np.linspace(0.002, 0.12, 1500)))
    u += 0.01 * rng.normal(size=1500).cumsum()
    operators = FirstOrderLagOperator(0.02), BoucWenOperator(0.4, 1.0, 0.3, 0.5)
    y = sum(own.run(u, 1e-3)[0] for own in operators) + 1e-3 * rng.normal(size=1500)
    steps = [("lag", FirstOrderLag()), ("hysteresis", BoucWen())][::order]
    model = Sum(steps, dt=1e-3).fit(u[:, None], y)
    assert model.fit_error_ < 1.03e-3
    assert model.params_["lag__time_constant"] == pytest.approx(0.02, rel=0.01)


@pytest.mark.filterwarnings("ignore:The data do not determine")  # the poles of an integrator
def test_a_sum_fits_no_worse_than_a_part_that_comes_last():
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 60), 50)
    y = lsim([4.0, [0.1, 1.0, 0.0]], u, 0.01 * np.arange(3000), interp=False)[1]
    steps = [("gain", Gain()), ("poles", TransferFunction(2, hold="zoh"))]
    model = Sum(steps, dt=0.01, initial_state="zero").fit(u[:, None], y)
    assert model.fit_error_ < 1e-5 * y.std()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The data do not determine")  # plays that hardly move
def test_a_cascade_fits_no_worse_than_without_a_step_also_where_weights_are_left_open():
    rng, t = np.random.default_rng(17), 1e-3 * np.arange(700)
    u = np.sin(2 * np.pi * rng.uniform(1.0, 60.0, 6) * t[:, None]) @ rng.uniform(0.3, 1.0, 6)
    u *= 6.0 / np.abs(u).max()
    v = PrandtlIshlinskiiOperator([0.0, 0.5, 1.2], [0.7, 0.2, 0.1]).run(u, 1e-3)[0]
    w = KelvinVoigtOperator([0.09], [0.066]).run(v, 1e-3)[0]
    y = SecondOrderModeOperator(206.0, 0.04).run(w, 1e-3)[0]
    y += 0.01 * y.std() * rng.standard_normal(len(t))
    plays, mode = ("plays", PrandtlIshlinskii(5)), ("mode", SecondOrderMode())
    less = Cascade([plays, mode], dt=1e-3).fit(u[:, None], y)
    model = Cascade([plays, ("creep", KelvinVoigt(1)), mode], dt=1e-3).fit(u[:, None], y)
    assert model.fit_error_ < less.fit_error_


def test_a_white_residual_asks_for_no_further_start():
    """The evaluations are those of identification alone."""
    rng = np.random.default_rng(3)
    u = rng.normal(size=600)
    y = lsim([1.0, [0.05, 1.0]], u - u[0], 0.01 * np.arange(600))[1] + u[0]
    y += 0.01 * rng.normal(size=600)
    model = FirstOrderLag(dt=0.01)
    records = model._read_records(u[:, None], y)
    assert model.identify(records).n_evaluations == model.fit(u[:, None], y).n_evaluations_


def test_what_a_user_has_chosen_is_kept_to():
    """No further starts are made beside a method of the user's own."""
    rng = np.random.default_rng(4)
    u = rng.normal(size=300)
    y = np.convolve(u, 0.8 ** np.arange(300))[:300] + np.abs(u)
    model = FirstOrderLag(dt=0.01, method=VariableProjection(max_evaluations=50))
    records = model._read_records(u[:, None], y)
    assert model.identify(records).n_evaluations == model.fit(u[:, None], y).n_evaluations_


def test_optima_that_disagree_are_told():
    rng = np.random.default_rng(3)
    u = rng.normal(size=200)
    model = FirstOrderLag(dt=0.01)
    records = model._read_records(u[:, None], np.convolve(u, 0.8 ** np.arange(200))[:200])
    result = model.identify(records)
    assert not list(model.fit_warnings(result, records))
    with pytest.warns(ConvergenceWarning, match="further starts lead to others"):
        model.finish(replace(result, is_local=True), records)
