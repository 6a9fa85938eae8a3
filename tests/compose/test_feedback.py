"""A memoryless curve in the feedback around linear dynamics."""

import numpy as np
import pytest

from skhyst.compose import Feedback
from skhyst.exceptions import ConvergenceWarning, DivergenceWarning
from skhyst.hysteresis import RestoringForceOperator
from skhyst.linear import (
    Delay,
    FirstOrderLag,
    FirstOrderLagOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.operators import FEEDBACK_ARGUMENTS, FeedbackOperator
from skhyst.optimize import VariableProjection
from skhyst.static import (
    DeadZoneOperator,
    DeadZones,
    PolynomialCurveOperator,
    SmoothCurve,
    UnknownTermOperator,
)

DT = 0.01
NAMES = ("linear", "curve")
CUBIC = PolynomialCurveOperator(np.array([0.1, 0.3]), center=0.0, scale=2.0)
KNOTS = 30.0 * np.arange(-4.0, 5.0)  # q + 0.05 q q', which splines are exactly
PRODUCT = UnknownTermOperator(
    np.array([0.05]),
    np.outer(KNOTS, KNOTS).reshape(-1, 1),
    *(-90.0, 90.0),
    second="rate",
    second_low=-90.0,
    second_high=90.0,
    passed=1.0,
)
TRIED = VariableProjection()  # without the further starts of a fit that is not white


def drive(n, seed=0):
    time = DT * np.arange(n)
    waves = np.sin(np.outer(time, [1.3, 4.1, 9.7, 17.0, 29.0]) + np.arange(5.0) * (1 + seed))
    return 0.6 * waves.sum(axis=1)


def integrated(u, slope, order, fine=16):
    """Return the first state, from zero, by Runge-Kutta steps under straight lines of the drive."""
    h, x, found = DT / fine, np.zeros(order), np.empty(len(u))
    for k in range(len(u)):
        found[k] = x[0]
        if k + 1 == len(u):
            break
        for i in range(fine):
            v = [u[k] + (u[k + 1] - u[k]) * (i + part) / fine for part in (0.0, 0.5, 1.0)]
            a = slope(x, v[0])
            b = slope(x + 0.5 * h * a, v[1])
            c = slope(x + 0.5 * h * b, v[1])
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + slope(x + h * c, v[2]))
    return found


def error_of(n_substeps, u, expected, argument):
    linear = SecondOrderModeOperator(20.0, 0.2)
    own = {"n_substeps": n_substeps, "argument": argument}
    curve = PRODUCT if argument == "both" else CUBIC
    operator = FeedbackOperator(NAMES, (linear, curve), **own)
    return np.std(operator.run(u, DT, operator.init(u[0], "zero"))[0] - expected)


@pytest.mark.parametrize("argument", FEEDBACK_ARGUMENTS)
def test_the_scheme_is_of_second_order_and_that_of_an_own_integrator(argument):
    u = 0.4 * (drive(100) - drive(100)[0])
    curve = np.polynomial.Legendre([0.0, 2.0, 0.2, 0.6])  # scale P_1(z) is q itself

    def slope(x, v):
        force = {
            "displacement": curve(x[0] / 2.0),
            "velocity": x[0] + curve(x[1] / 2.0),
            "both": x[0] + 0.05 * x[0] * x[1],
        }[argument]
        return np.array([x[1], 400.0 * (v - force) - 8.0 * x[1]])

    expected = integrated(u, slope, 2)
    errors = [error_of(n, u, expected, argument) for n in (1, 2, 4)]
    assert errors[0] < 0.05 * np.std(expected)
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


def test_a_cubic_spring_is_that_of_the_restoring_force():
    u, a = drive(300), 0.4
    duffing = RestoringForceOperator(20.0, 0.3, [a], [], 0.0, 1.0, gain=1.7, n_substeps=64)
    # q + a q^3 = k s(p), p = k q, of unit slope in P_1: z^3 = (2 P_3 + 3 P_1) / 5
    scale, k = 3.0, 1.0 + 0.6 * a * 9.0
    linear = SecondOrderModeOperator(20.0 * np.sqrt(k), 0.3 / np.sqrt(k), 1.7 / k)
    curve = PolynomialCurveOperator(np.array([0.0, 0.4 * a * 9.0 / k]), 0.0, k * scale)
    operator = FeedbackOperator(NAMES, (linear, curve), n_substeps=64)
    y, _ = operator.run(u, DT)
    np.testing.assert_allclose(y, duffing.run(u, DT)[0], atol=1e-5 * np.ptp(y))
    stiff = 400.0 * (1.0 + 3.0 * a * 0.5**2)  # about the rest at q = 0.5
    poles = operator.poles_at(1.7 * 0.5)
    np.testing.assert_allclose(np.abs(poles) ** 2, stiff, rtol=1e-9)


def test_a_hardening_spring_is_identified_as_far_as_it_was_pulled():
    u = 4.5 * (drive(400) - drive(400)[0])

    def slope(x, v):
        return np.array([x[1], 400.0 * (v - x[0] - 0.5 * x[0] ** 3) - 4.0 * x[1]])

    y = integrated(u, slope, 2)
    model = Feedback(SecondOrderMode(), SmoothCurve(3), dt=DT, method=TRIED).fit(u[:, None], y)
    assert model.fit_error_ < 1e-3 * np.std(y)
    linear, reached = model.operator_.linear, np.linspace(y.min(), y.max(), 9)
    spring, _ = model.operator_.curve.run((reached - linear.intercept) / linear.gain, DT)
    expected = reached + 0.5 * reached**3
    np.testing.assert_allclose(spring, expected, atol=2e-3 * np.ptp(expected))


def test_the_identity_in_the_feedback_leaves_the_dynamics_alone():
    linear = TransferFunctionOperator(
        np.array([0.05]), np.array([30.0]), np.array([0.2]), np.array([0.3, 0.1, 0.2]), 1.4, 0.2
    )
    curve = PolynomialCurveOperator(np.zeros(2), center=0.0, scale=1.0)
    for initial_state in ("rest", "zero"):
        operator = FeedbackOperator(NAMES, (linear, curve), n_substeps=3)
        u = drive(100) + 0.3
        found = operator.run(u, DT, operator.init(u[0], initial_state))[0]
        expected = linear.run(u, DT, linear.init(u[0], initial_state))[0]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_lag_with_a_stop_in_its_feedback_is_identified():
    plant = FeedbackOperator(
        NAMES,
        (FirstOrderLagOperator(0.08, 1.3, 0.1), DeadZoneOperator([3.0], [0.7], [1])),
        n_substeps=8,
    )
    u = drive(800)
    y = plant.run(u, DT)[0] + 1e-3 * np.random.default_rng(0).normal(size=800)
    model = Feedback(FirstOrderLag(), DeadZones(1, sides="upper"), dt=DT, method=TRIED)
    model.fit(u[:, None], y)
    assert model.fit_error_ < 1.05e-3
    expected = {"linear__time_constant": 0.08, "linear__gain": 1.3, "curve__weights[0]": 3.0}
    for name, value in expected.items():
        assert abs(model.params_[name] - value) < 4.0 * model.params_std_[name]


def test_a_hold_of_the_drive_is_that_of_the_linear_part():
    u = drive(300)
    linear = SecondOrderModeOperator(20.0, 0.2, hold="zoh")
    fine = FeedbackOperator(NAMES, (SecondOrderModeOperator(20.0, 0.2), CUBIC), n_substeps=1)
    grid = np.arange(0.0, 299.0, 0.01)
    held = u[np.floor(grid + 1e-9).astype(int)]
    expected = fine.run(held, DT / 100.0)[0][::100]
    operator = FeedbackOperator(NAMES, (linear, CUBIC), n_substeps=8)
    np.testing.assert_allclose(operator.run(u, DT)[0][:299], expected, atol=0.02)
    model = Feedback(SecondOrderMode(hold="auto"), SmoothCurve(3), n_substeps=2, dt=DT)
    model.set_params(method=TRIED).fit(u[:, None], operator.run(u, DT)[0])
    assert model.operator_.hold == "zoh"


def test_a_rest_that_is_not_stable_is_told():
    # about q = 0 the spring pushes away: two rests at the sides
    bistable = PolynomialCurveOperator(np.array([0.0, 0.9]), center=0.0, scale=1.5)
    linear = SecondOrderModeOperator(20.0, 0.2)
    plant = FeedbackOperator(NAMES, (linear, bistable), n_substeps=4)
    assert plant.poles_at(0.0).real.max() > 0.0 > plant.poles_at(1.5).real.max()
    u = 0.8 * drive(300)
    y = plant.run(u, DT)[0]
    model = Feedback(SecondOrderMode(), SmoothCurve(3), n_substeps=4, dt=DT, method=TRIED)
    with pytest.warns(ConvergenceWarning, match="not stable at rest at a response of"):
        model.fit_from(plant, u[:, None], y)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ExtrapolationWarning")
def test_a_run_that_diverges_says_so():
    linear = SecondOrderModeOperator(20.0, 0.2)
    softening = PolynomialCurveOperator(np.array([0.0, -0.3]), center=0.0, scale=1.0)
    plant = FeedbackOperator(NAMES, (linear, softening), n_substeps=4)
    u = 0.1 * drive(400)
    model = Feedback(SecondOrderMode(), SmoothCurve(3), n_substeps=4, dt=DT, method=TRIED)
    model.fit_from(plant, u[:, None], plant.run(u, DT)[0])
    with pytest.warns(DivergenceWarning):
        y = model.predict(np.tile(5.0 + 0.0 * u, 50)[:, None])
    assert np.isfinite(y).all()


def test_what_is_no_such_model_is_refused():
    X, y = drive(50)[:, None], drive(50)
    for model, name in (
        (Feedback(Delay(), SmoothCurve()), "linear"),
        (Feedback(TransferFunction(2, delay=0.02), SmoothCurve()), "linear"),
        (Feedback(TransferFunction(1, integrators=1), SmoothCurve()), "linear"),
        (Feedback(FirstOrderLag(), FirstOrderLag()), "curve"),
    ):
        with pytest.raises(TypeError, match=f"The '{name}' parameter of Feedback must be"):
            model.fit(X, y)
    with pytest.raises(ValueError, match="'stages' parameter of FeedbackOperator"):
        FeedbackOperator(NAMES, (CUBIC, CUBIC))
    with pytest.raises(ValueError, match="'n_substeps' parameter of FeedbackOperator"):
        FeedbackOperator(NAMES, (FirstOrderLagOperator(1.0), CUBIC), n_substeps=0)


def test_it_stands_in_a_series_and_comes_back_from_its_tree():
    u = drive(200)
    model = Feedback(SecondOrderMode(), SmoothCurve(3), n_substeps=2, dt=DT, method=TRIED)
    model.fit(
        u[:, None],
        FeedbackOperator(NAMES, (SecondOrderModeOperator(20.0, 0.2), CUBIC), n_substeps=2).run(
            u, DT
        )[0],
    )
    again = model.tree(model.operator_).estimator()
    assert repr(again) == repr(model)
    assert set(model.params_) == {
        *(f"linear__{name}" for name in ("natural_frequency", "damping_ratio", "gain")),
        *("linear__intercept", "curve__coefficients[0]", "curve__coefficients[1]"),
    }
