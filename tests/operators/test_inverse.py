"""An operator behind its inverse is the identity."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from operator_cases import DT, OPERATORS

from skhyst.hysteresis import FrictionStageOperator
from skhyst.linear import (
    GainOperator,
    SecondOrderModeOperator,
    TimeShiftOperator,
    TransferFunctionOperator,
)
from skhyst.operators import RootInverseOperator, Series, Stepper, SumOperator, inverse_of
from skhyst.operators._root_inverse import _plain
from skhyst.operators._window_inverse import solve

TIME = DT * np.arange(300)
WINDOW = np.clip(np.minimum(TIME - 0.5, 2.5 - TIME) / 0.5, 0.0, 1.0)
REFERENCE = 0.1 + 0.2 * np.sin(9.0 * TIME) * WINDOW**2 * (3.0 - 2.0 * WINDOW)
OUT_OF_REACH = {  # of every drive, or of every one that a device could follow
    "no spring left",
    "delay beyond",
    "tanks",
    "offset",
    "drift",
    "sinusoid",
    "stage",
    "free mass",
    "integrator",
    "restoring",
    "stop",
    "fold",
    "empty",
    "series",
    "slew limit, always",
    "soft saturation, upper",
    "system level, as printed",
    "gray box, products",
    "band-limited",
    "feedback",
    "term of the rate",
    "since a turn",
    "unknown surface",
}
INVERTIBLE = [name for name in OPERATORS if not any(part in name for part in OUT_OF_REACH)]
INVERTIBLE += ["plays, stop form", "series of linear ones", "series of sums", "sum of series"]


@pytest.mark.parametrize("name", INVERTIBLE)
def test_the_output_behind_the_inverse_is_the_input(name):
    operator = OPERATORS[name]
    drive, _ = inverse_of(operator).run(REFERENCE, DT)
    y, _ = operator.run(drive, DT, operator.init(drive[0]))
    np.testing.assert_allclose(y, REFERENCE, rtol=0.0, atol=1e-9 * np.ptp(REFERENCE))


@pytest.mark.parametrize("name", [n for n in OPERATORS if "band-limited" in n or "feedback" in n])
def test_what_has_no_inverse_is_refused_in_words(name):
    with pytest.raises(ValueError, match="has no inverse"):
        inverse_of(OPERATORS[name])


@pytest.mark.parametrize("name", ["Bouc-Wen", "tanh", "creep, logarithmic", "sum"])
def test_a_root_goes_on_where_it_stopped(name):
    inverse = RootInverseOperator(OPERATORS[name])
    whole, _ = inverse.run(REFERENCE, DT)
    first, state = inverse.run(REFERENCE[:130], DT)
    rest, _ = inverse.run(REFERENCE[130:], DT, state)
    np.testing.assert_allclose(np.concatenate([first, rest]), whole, rtol=0.0, atol=1e-12)
    assert inverse.inverse() is OPERATORS[name]


@settings(deadline=None, max_examples=20)
@given(
    frequency=st.floats(20.0, 300.0),
    damping=st.floats(1e-3, 5.0),
    zero=st.floats(-0.1, 0.1).filter(lambda value: abs(value) > 1e-2),
)
def test_zeros_on_either_side_are_inverted(frequency, damping, zero):
    """A zero in the right half plane makes the response begin the wrong way."""
    operator = TransferFunctionOperator(
        np.empty(0), np.array([frequency]), np.array([damping]), np.array([zero])
    )
    drive, _ = operator.inverse().run(REFERENCE, DT)
    y, _ = operator.run(drive, DT)
    # the drive comes before the response by some time constants of the zero
    late = TIME > 0.5
    np.testing.assert_allclose(y[late], REFERENCE[late], rtol=0.0, atol=2e-2 * np.ptp(REFERENCE))


def test_modes_side_by_side_are_one_system():
    modes = SecondOrderModeOperator(90.0, 0.1), SecondOrderModeOperator(40.0, 0.3, 0.5, 0.1)
    both = SumOperator(("a", "b"), modes)
    drive, _ = both.inverse().run(REFERENCE, DT)
    np.testing.assert_allclose(both.run(drive, DT)[0], REFERENCE, rtol=0.0, atol=1e-11)
    # no such system where a part of a part has a memory
    plays = SumOperator(("plays", "gain"), (OPERATORS["backlash"], GainOperator(2.0)))
    nested = SumOperator(("a", "b"), (plays, GainOperator(1.0)))
    drive, _ = nested.inverse().run(REFERENCE, DT)
    np.testing.assert_allclose(nested.run(drive, DT)[0], REFERENCE, rtol=0.0, atol=1e-9)


def test_forces_within_the_motion_are_undone():
    operator, dt = OPERATORS["upper end stop"], 0.1 * DT
    drive, _ = operator.inverse().run(3.0 * REFERENCE, dt)
    y, _ = operator.run(drive, dt, operator.init(drive[0]))
    np.testing.assert_allclose(y, 3.0 * REFERENCE, rtol=0.0, atol=1e-8 * np.ptp(REFERENCE))
    alone, _ = operator.run(operator.linear_mode().inverse().run(3.0 * REFERENCE, dt)[0], dt)
    assert np.abs(alone - 3.0 * REFERENCE).max() > 0.1 * np.ptp(REFERENCE)


@pytest.mark.parametrize("dt", [1e-4, 1e-3, 0.1])
def test_a_response_that_falls_with_the_rate_is_undone(dt):
    """Backwards in time where the interval is short, else by roots."""
    operator, wanted = OPERATORS["tanh"], 3.0 * REFERENCE
    drive, _ = operator.inverse().run(wanted, dt)
    y, _ = operator.run(drive, dt, operator.init(drive[0]))
    # the drive has moved before a record that rests for a short time begins
    np.testing.assert_allclose(y[1:], wanted[1:], rtol=0.0, atol=1e-11 * np.ptp(wanted))


@pytest.mark.parametrize("shift", [-0.0263, -0.0563, 0.0137, 0.0537])
@pytest.mark.parametrize("between", ["curve", "line"])
def test_a_shift_is_stepped_from_a_preview(shift, between):
    operator = TimeShiftOperator(shift, between=between)
    whole, _ = operator.run(REFERENCE, DT)
    compiled_step, ahead = operator.ahead(DT, REFERENCE[0])
    assert ahead <= max(np.ceil(-shift / DT) + 2, 0)
    steps = Stepper(compiled_step).run(REFERENCE)
    # behind the end of a record its last value stands, which a stream has not seen
    np.testing.assert_allclose(steps[ahead:], whole[: len(whole) - ahead], atol=1e-14)


@pytest.mark.parametrize("between", ["curve", "line"])
def test_half_a_sample_is_undone_as_far_as_the_response_tells(between):
    """What alternates from sample to sample is lost on the way: noise of it must not grow."""
    operator = TimeShiftOperator(1.5 * DT, between=between)
    y, _ = operator.run(REFERENCE, DT, operator.init(REFERENCE[0]))
    back, _ = operator.inverse().run(y, DT)
    np.testing.assert_allclose(operator.run(back, DT)[0], y, rtol=0.0, atol=1e-12 * np.ptp(y))
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(y))
    assert np.abs(operator.inverse().run(y + noise, DT)[0] - back).max() < 0.1


@pytest.mark.parametrize("shift", [-0.0263, 0.0012, 0.0155, 0.0537])
@pytest.mark.parametrize("between", ["curve", "line"])
def test_the_inverse_of_a_shift_is_stepped_as_over_a_record(shift, between):
    operator = TimeShiftOperator(shift, between=between)
    inverse = operator.inverse()
    whole, _ = inverse.run(REFERENCE, DT)
    compiled_step, ahead = inverse.ahead(DT, REFERENCE[0], 1e-10)
    steps = Stepper(compiled_step).run(REFERENCE)[ahead:]
    near_half = shift == 0.0155  # 1.55 samples: the opposite shift is stepped
    bar = 1e-2 if near_half else 1e-9
    np.testing.assert_allclose(steps, whole[: len(steps)], rtol=0.0, atol=bar * np.ptp(whole))


def test_clocks_that_differ_need_the_whole_record():
    clocks = OPERATORS["clocks that differ"]
    for operator in (clocks, clocks.inverse()):
        with pytest.raises(NotImplementedError, match="looks ahead"):
            operator.ahead(DT, 0.0)


def test_a_series_of_inverses_is_stepped_from_the_sum_of_their_previews():
    stages = OPERATORS["plays"], OPERATORS["mode"], OPERATORS["delay of several samples"]
    inverse = Series(("plays", "mode", "delay"), stages).inverse()
    whole, _ = inverse.run(REFERENCE, DT)
    compiled_step, ahead = inverse.ahead(DT, REFERENCE[0], 1e-12)
    assert ahead == sum(stage.inverse().ahead(DT, 0.0, 1e-12)[1] for stage in stages)
    steps = Stepper(compiled_step).run(REFERENCE)[ahead:]
    np.testing.assert_allclose(steps[:-ahead], whole[: -2 * ahead], atol=1e-9 * np.ptp(whole))


@pytest.mark.parametrize("limits", [(-0.1, 0.1), (0.15, 0.2)])
def test_a_root_stays_within_limits(limits):
    operator = OPERATORS["Dahl friction"]
    drive, _ = RootInverseOperator(operator, *limits).run(10.0 * REFERENCE, DT)
    assert limits[0] <= drive.min() < drive.max() <= limits[1]


def test_what_no_input_gives_leaves_the_drive_where_it_was():
    drive, _ = inverse_of(OPERATORS["upper limit"]).run([0.1, 0.3, 9.0, 0.2], DT)
    np.testing.assert_allclose(drive, [0.1, 0.3, 0.3, 0.2])


@pytest.mark.parametrize("name", ["tanks", "offset"])
def test_what_does_not_follow_at_once_is_refused(name):
    with pytest.raises(ValueError, match="does not follow its input at once"):
        inverse_of(OPERATORS[name])


@pytest.mark.parametrize("zeros", [[0.0], [0.3, 0.0]])
def test_a_response_without_a_static_gain_is_refused(zeros):
    washout = TransferFunctionOperator(
        np.array([0.05, 0.01]), np.empty(0), np.empty(0), np.array(zeros), 0.0
    )
    with pytest.raises(ValueError, match=r"no stable inverse|no inverse"):
        washout.inverse().run(REFERENCE, DT)


def test_a_gain_of_zero_has_no_inverse():
    with pytest.raises(ValueError, match=r"'gain' .* must not be 0"):
        GainOperator(0.0).inverse()
    with pytest.raises(ValueError, match="has no inverse"):
        FrictionStageOperator(90.0, 0.1, 0.3, 0.8, 3.0, 8.0, gain=0.0).inverse().run(REFERENCE, DT)
    with pytest.raises(ValueError, match="sum without terms"):
        OPERATORS["empty sum"].inverse()


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("damping_ratio", [0.01, 0.5])
def test_a_response_that_moves_at_once_is_missed_the_least(damping_ratio, hold):
    """Of all changes of the first drives none has a smaller error, with its penalty."""
    operator = SecondOrderModeOperator(300.0, damping_ratio, 1.7, 0.4, hold=hold)
    wanted = 2.0 + np.sin(60.0 * 1e-3 * np.arange(200))
    drive, _ = operator.inverse().run(wanted, 1e-3)
    rests = np.concatenate([np.full(80, 2.0), wanted])  # stable inversion with room to begin
    free = operator.inverse().run(rests, 1e-3)[0][80:]
    assert drive[0] == pytest.approx((2.0 - 0.4) / 1.7)
    ahead = operator.inverse().ahead(1e-3, 2.0)[1] + 2  # and one for each state
    np.testing.assert_allclose(drive[ahead + 1 :], free[ahead + 1 :], atol=1e-8)

    def cost(u):
        error = operator.run(u, 1e-3, operator.init(u[0]))[0] - wanted
        return np.sum(error**2) + (0.1 * 1.7) ** 2 * np.sum((u - free)[1:] ** 2)

    least, rng = cost(drive), np.random.default_rng(0)
    for size in (1e-3, 1e-2, 1e-1):
        change = np.zeros(200)
        change[1 : ahead + 1] = size * rng.normal(size=ahead)
        assert least < cost(drive + change)
        assert least < cost(drive - change)
    assert np.abs(drive).max() < 2.0 * np.abs(free).max()


@pytest.mark.parametrize(("limits", "most"), [((-3.0, 2.0), 71), ((-np.inf, np.inf), 225)])
@pytest.mark.parametrize(
    "law",
    [
        lambda u: np.sign(u - 0.1234),
        lambda u: u**9,
        lambda u: np.cbrt(u),
        lambda u: np.arctan(1e6 * (u - 0.3)),
        lambda u: np.floor(40.0 * u),
        lambda u: -(max(u, 0.0) ** 3) - 1e-9 * u,
    ],
)
def test_a_root_takes_a_bounded_number_of_steps_whatever_the_law(law, limits, most):
    """Jumps, flat parts and steep ends, where interpolation is of no use."""
    n_steps = 0

    def step(u, c, s):
        nonlocal n_steps
        n_steps += 1
        return law(u)

    sign = 1.0 if law(1.0) > law(-1.0) else -1.0
    constants = RootInverseOperator(GainOperator(), *limits)._constants(sign)
    state = np.array([0.0, 1.0, 0.0])
    rng = np.random.default_rng(0)
    far = [] if np.isfinite(limits[0]) else [1e20, 0.7, 0.2, -1e30, 1e-3]
    for wanted in [*rng.uniform(-1.9, 1.9, 60), *([0.7] * 60), -1.3, 1.3, 1e-3, 1.9, *far]:
        n_steps, y, before = 0, law(wanted), state[0]
        u = _plain(step)(y, constants, state)
        assert n_steps <= most
        digit = 2.0**-51 * max(abs(u), min(abs(u - before), 9.0))  # also after a far input
        assert sign * law(u - digit) <= sign * y <= sign * law(u + digit)


@given(st.integers(2, 7), st.integers(0, 99))
def test_equations_of_a_window_are_solved(p, seed):
    """With one diagonal above the main one, and small entries on it, so that rows change places."""
    rng = np.random.default_rng(seed)
    m, e = np.tril(rng.normal(size=(p, p)), 1), rng.normal(size=p)
    m[np.diag_indices(p)] *= 1e-3
    found = np.empty(p)
    solve(m.ravel().copy(), e.copy(), found)
    np.testing.assert_allclose(m @ found, e, atol=1e-9 * np.abs(found).max())
