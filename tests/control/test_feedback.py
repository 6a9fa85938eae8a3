"""Controllers: what their laws say, and what a notch and damping do to poles."""

import math

import numpy as np
import pytest
from scipy.signal import freqz, lfilter, sosfilt

from skhyst.control import (
    FeedforwardPI,
    IntegralResonantControl,
    InverseCompensator,
    simulate_loop,
)
from skhyst.datasets import inchworm_motor_stepper
from skhyst.linear import Gain, GainOperator, SecondOrderMode, SecondOrderModeOperator
from skhyst.operators import Stepper

DT = 1e-3
ROWS = np.random.default_rng(0).normal(size=(300, 3))
DAMPING = IntegralResonantControl((60.0, 0.4), damping_ratio=0.3)


class Ahead:
    """A compensator that knows the device to be a gain of one half."""

    def drive_for(self, reference, dt):
        return 2.0 * reference


def sections(controller, dt=DT):
    """Return notch and damping of a controller, as SciPy has them."""
    constants = controller.stepper(dt).compiled_step.constants
    return [np.array([[*section[:3], 1.0, *section[3:]]]) for section in constants[4:6]]


@pytest.mark.parametrize("compensator", [None, Ahead()])
def test_the_step_is_the_sum_of_filters_by_scipy(compensator):
    controller = FeedforwardPI(
        0.7, 30.0, compensator=compensator, notch=(80.0, 0.05), damping=DAMPING
    )
    notch, damping = sections(controller)
    reference, reading, ahead = ROWS.T
    error = reference - reading
    expected = sosfilt(notch, 0.7 * error + 30.0 * DT * np.cumsum(error))
    expected += sosfilt(damping, reading if compensator is None else -error)
    expected += 0.0 if compensator is None else ahead
    stepper = controller.stepper(DT)
    again = stepper.copy()
    drive = [stepper.step(row) for row in ROWS]
    np.testing.assert_allclose(drive, expected, rtol=0.0, atol=1e-12 * np.ptp(expected))
    np.testing.assert_array_equal(again.run(ROWS), drive)


def test_the_derivative_is_filtered_and_the_reference_weighted():
    kd, lag = 0.02, 4e-3
    reference, reading, _ = ROWS.T
    controller = FeedforwardPI(0.7, 30.0, kd=kd, filter_time=lag, setpoint_weight=0.4)
    expected = 0.7 * (0.4 * reference - reading) + 30.0 * DT * np.cumsum(reference - reading)
    before = np.append(reading[0], reading[:-1])  # the first reading is no jump
    expected -= lfilter([kd / (lag + DT)], [1.0, -lag / (lag + DT)], reading - before)
    drive = controller.stepper(DT).run(ROWS[:, :2])
    np.testing.assert_allclose(drive, expected, rtol=0.0, atol=1e-12 * np.ptp(expected))
    assert FeedforwardPI(2.0, 0.0, kd=0.5)._filter_time() == 0.025
    with pytest.raises(ValueError, match=r"'filter_time' .* must be given"):
        FeedforwardPI(0.0, 1.0, kd=0.5).stepper(DT)


def test_the_drive_changes_no_faster_than_its_limit():
    """From its rest on, in both directions; the integral part does not run away meanwhile."""
    for compensator, rows in ((None, ROWS[:, :2]), (Ahead(), ROWS)):
        controller = FeedforwardPI(
            3.0, 30.0, compensator=compensator, rate_limit=50.0, drive_limits=(-1.0, 1.0)
        )
        u0 = 0.3
        drive = controller.stepper(DT, u0=u0).run(rows)
        rest = u0 if compensator is None else u0 + rows[0, 2]
        change = np.abs(np.diff(np.append(min(max(rest, -1.0), 1.0), drive)))
        assert change[1:].max() == pytest.approx(50.0 * DT)
        assert compensator is not None or change[0] <= 50.0 * DT * (1.0 + 1e-12)
        assert np.abs(drive).max() <= 1.0


@pytest.mark.parametrize("compensator", [None, Ahead()])
def test_another_drive_is_taken_over_without_a_bump(compensator):
    """While another drives, the controller would go on from there by what it integrates."""
    ahead = [] if compensator is None else [0.5]
    controller = FeedforwardPI(1.5, 30.0, compensator=compensator, tracking_time=DT)
    stepper = controller.stepper(DT)
    assert len(stepper.inputs) == 3 + len(ahead)
    for _ in range(5):
        drive = stepper.step((0.3, 0.1, *ahead, 2.0))
    assert drive == pytest.approx(2.0 + 30.0 * 0.2 * DT, abs=1e-12)
    slow = FeedforwardPI(1.5, 0.0, tracking_time=0.1).stepper(DT)
    drives = [slow.step((0.0, 0.0, 1.0)) for _ in range(200)]
    np.testing.assert_allclose(drives, 1.0 - 0.99 ** np.arange(1, 201), atol=1e-12)
    with pytest.raises(ValueError, match=r"'tracking_time' .* at least the sampling interval"):
        FeedforwardPI(1.0, 1.0, tracking_time=0.5 * DT).stepper(DT)
    own = FeedforwardPI(1.5, 30.0, compensator=compensator)
    device = [Stepper(GainOperator(0.5).compiled_step(DT, ())) for _ in range(2)]
    loops = [
        simulate_loop(d, c, np.ones(50), DT) for d, c in zip(device, (own, controller), strict=True)
    ]
    np.testing.assert_allclose(loops[0].drive, loops[1].drive, rtol=0.0, atol=1e-12)


def test_the_reference_is_led_from_the_first_reading():
    controller = FeedforwardPI(1.0, 0.0, start_time=10 * DT)
    rows = np.stack([np.full(20, 3.0), np.full(20, 1.0)], axis=1)
    expected = 2.0 * np.minimum(np.arange(1, 21) / 10.0, 1.0)
    np.testing.assert_allclose(controller.stepper(DT).run(rows), expected, atol=1e-12)


def test_a_start_takes_as_long_as_the_range_of_the_fit_at_its_rate():
    u = np.arange(0.0, 5.0, 0.5)
    model = Gain(dt=DT).fit(u[:, None], 2.0 * u)
    compensator = InverseCompensator(model).fit(u[:, None], 2.0 * u)
    controller = FeedforwardPI(1.0, 0.0, compensator=compensator)
    assert controller._start_time() == pytest.approx(9 * DT)
    drive = controller.stepper(DT).run([(3.0, 1.0, 2.0)] * 20)
    assert np.diff(drive).max() <= compensator.rate_limit_ * DT * (1.0 + 1e-12)


@pytest.mark.parametrize("notch", [None, (80.0, 0.05)])
@pytest.mark.parametrize("damping", [None, DAMPING])
def test_at_rest_the_drive_stays(notch, damping):
    more = {"setpoint_weight": 0.3, "kd": 0.01, "start_time": 0.02, "rate_limit": 0.1}
    controller = FeedforwardPI(0.7, 30.0, notch=notch, damping=damping, **more)
    stepper = controller.stepper(DT, reference=1.5, u0=-0.4)
    np.testing.assert_allclose(stepper.run(np.full((50, 2), 1.5)), -0.4, rtol=0.0, atol=1e-13)


def test_feedforward_alone_where_the_device_is_known():
    """Damping adds nothing to it, and the reading is compared with the reference of its instant."""
    gain = GainOperator(0.5)
    reference = np.cumsum(ROWS[:, 0])
    controller = FeedforwardPI(0.7, 30.0, compensator=Ahead(), damping=DAMPING)
    loop = simulate_loop(Stepper(gain.compiled_step(DT, gain.init(0.0))), controller, reference, DT)
    np.testing.assert_allclose(loop.response, reference, rtol=0.0, atol=1e-13 * np.ptp(reference))


@pytest.mark.parametrize("compensator", [None, Ahead()])
def test_a_loop_is_closed_without_a_bump(compensator):
    """Around a device at rest, under a drive that feed-forward has wrong."""
    gain = GainOperator(0.5, 0.3)
    device = Stepper(gain.compiled_step(DT, gain.init(0.0)))
    controller = FeedforwardPI(0.1, 30.0, compensator=compensator, damping=DAMPING)
    loop = simulate_loop(device, controller, np.full(50, 1.0), DT, u0=1.4)
    np.testing.assert_allclose(loop.drive, 1.4, rtol=0.0, atol=1e-13)


def test_the_notch_takes_a_mode_away():
    """A mode behind it has the response of a critically damped one, at its frequency exactly."""
    notch, _ = sections(FeedforwardPI(1.0, 0.0, notch=(80.0, 0.05)))
    _, h = freqz(notch[0, :3], notch[0, 3:], worN=[0.0, 80.0, 499.999], fs=1.0 / DT)
    np.testing.assert_allclose(np.abs(h), [1.0, 0.05, 1.0], rtol=1e-4)
    assert abs(np.angle(h[1])) < 1e-9


def test_a_fitted_mode_declares_notch_and_damping():
    u = ROWS.ravel()
    y, _ = SecondOrderModeOperator(500.0, 0.03, gain=0.2).run(u, DT)
    model = SecondOrderMode(dt=DT).fit(u[:, None], y)
    found = sections(FeedforwardPI(1.0, 0.0, notch=model, damping=IntegralResonantControl(model)))
    frequency = 500.0 / (2.0 * math.pi)
    own = IntegralResonantControl((frequency, 0.2))
    told = sections(FeedforwardPI(1.0, 0.0, notch=(frequency, 0.03), damping=own))
    np.testing.assert_allclose(found, told, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("damping_ratio", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("gain", [0.3, -2.0])
def test_a_damped_mode_has_the_damping_that_is_asked_for(damping_ratio, gain):
    """Poles of the mode and its controller, sampled so fast that it makes no difference."""
    w, dt = 900.0, 1e-7
    control = IntegralResonantControl((w / (2.0 * math.pi), gain), damping_ratio=damping_ratio)
    b0, _, _, a1, _ = control.section(dt)
    rate = -math.log(-a1) / dt
    k = b0 / (1.0 + a1) * rate
    # (s^2 + w^2) (s + K) = g w^2 k, with K and k read off the section
    poles = np.roots([1.0, rate, w * w, rate * w * w - gain * w * w * k])
    pair = poles[np.argsort(np.abs(poles.imag))[-2:]]
    assert (poles.real < 0.0).all()
    np.testing.assert_allclose(-pair.real / np.abs(pair), damping_ratio, rtol=1e-5)
    # and no other rate gives more
    for other in (0.9 * rate, 1.1 * rate):
        roots = np.roots([1.0, other, w * w, other * (w * w - gain * w * w * k / rate)])
        pair = roots[np.argsort(np.abs(roots.imag))[-2:]]
        assert (-pair.real / np.abs(pair)).max() < damping_ratio


def test_damping_stops_the_ringing_of_the_simulated_motor():
    """A step of the reference rings without it; the motor shares nothing with the controller."""
    damping = IntegralResonantControl((138.8, 0.2657 / 2.312))  # um/V
    reference = np.r_[0.0, np.full(1500, 0.2)]
    left = {}
    for name, own in {"damped": damping, "alone": None}.items():
        controller = FeedforwardPI(3.5, 400.0, damping=own)
        loop = simulate_loop(inchworm_motor_stepper(), controller, reference, 1e-4)
        left[name] = np.abs(loop.response[-300:] - 0.2).max()
    assert left["damped"] < 1e-4 < 0.05 < left["alone"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kp": np.nan}, "'kp' parameter of FeedforwardPI"),
        ({"notch": (500.0, 0.1)}, "below half the sampling rate, 500 Hz"),
        ({"notch": (50.0, -0.1)}, "'notch' parameter"),
        ({"damping": IntegralResonantControl((600.0, 1.0))}, "'mode' parameter"),
        ({"damping": IntegralResonantControl((60.0, 0.0))}, "'mode' parameter"),
        ({"damping": IntegralResonantControl((60.0, 1.0), damping_ratio=0.0)}, "'damping_ratio'"),
    ],
)
def test_bad_parameters_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        FeedforwardPI(**{"kp": 1.0, "ki": 1.0} | options).stepper(DT)


@pytest.mark.parametrize("row", [(1.0, np.nan), (1.0,), 1.0])
def test_a_wrong_row_leaves_the_controller_as_it_is(row):
    stepper = FeedforwardPI(0.7, 30.0).stepper(DT)
    before = stepper.state
    wanted = "must be finite" if np.size(row) == 2 else "must be a row of 2 numbers"
    with pytest.raises(ValueError, match=wanted):
        stepper.step(row)
    np.testing.assert_array_equal(stepper.state, before)


@pytest.mark.parametrize("row", [(1e308, -1e308), (-1.7e308, 1.7e308)])
@pytest.mark.parametrize("compensator", [None, Ahead()])
def test_a_reading_beyond_floating_point_holds_the_drive(compensator, row):
    """And the next readings are controlled again."""
    controller = FeedforwardPI(
        *(0.7, 30.0),
        kd=0.02,
        compensator=compensator,
        notch=(80.0, 0.05),
        damping=DAMPING,
        drive_limits=(-5.0, 5.0),
        start_time=0.01,
    )
    stepper, n = controller.stepper(DT), 3 if compensator else 2
    for at in (0, 40):  # during the start, too
        held = stepper.run(ROWS[:at, :n])[-1] if at else stepper.state[6]
        assert stepper.step([*row, 0.0][:n]) == held
        assert stepper.status == {"overrange"}
    drive = stepper.run(ROWS[:, :n])
    assert np.abs(drive).max() <= 5.0
    assert np.ptp(drive) > 1.0
    begun = FeedforwardPI(*(0.7, 30.0), compensator=compensator, drive_limits=(-5.0, 5.0))
    stepper = begun.stepper(DT, u0=-2.0)
    rest = (0.0, 0.0, 3.0)[:n]
    first = stepper.step([*row, 3.0][:n])  # the drive of rest, from which it goes on
    assert (first, stepper.step(rest)) == ((1.0, 1.0) if compensator else (-2.0, -2.0))


@pytest.mark.parametrize("compensator", [None, Ahead()])
@pytest.mark.parametrize(
    "options",
    [
        {"setpoint_weight": 0.0},
        {"notch": (100.0, 0.02)},
        {"damping": DAMPING},
        {"tracking_time": DT},
        {
            **{"kd": 0.01, "setpoint_weight": 0.5, "notch": (80.0, 0.05), "damping": DAMPING},
            **{"start_time": 0.02, "tracking_time": 0.01, "rate_limit": 0.1},
        },
    ],
)
def test_at_rest_a_restart_is_no_bump(compensator, options):
    n, rest = (3, 0.9) if compensator else (2, -0.4)
    for ki in (0.0, 30.0):
        controller = FeedforwardPI(2.0, ki, compensator=compensator, **options)
        stepper = controller.stepper(DT, reference=1.5, u0=-0.4)
        row = np.array([*(1.5, 1.5, 1.3)[:n], *[rest] * ("tracking_time" in options)])
        beyond = np.array([*(1e308, -1e308, 1.3)[:n], *row[n:]])
        drive = [
            stepper.step(u) for u in (row, row, beyond, *[row] * 5, beyond, beyond, *[row] * 9)
        ]
        np.testing.assert_allclose(drive, rest, rtol=0.0, atol=1e-12)
        assert stepper.status == {"overrange"}


def test_a_wrong_reading_at_a_restart_does_not_stay():
    options = {"setpoint_weight": 0.5, "start_time": 0.02, "drive_limits": (-5.0, 5.0)}
    stepper = FeedforwardPI(0.5, 30.0, **options).stepper(DT, reference=1.5, u0=-0.4)
    drive = [stepper.step(u) for u in [(1e308, -1e308), (1.5, 1.5e308), *[(1.5, 1.5)] * 30]]
    assert drive[0] == pytest.approx(-0.4)
    assert drive[-1] == pytest.approx(-0.4)


@pytest.mark.parametrize("compensator", [None, Ahead()])
@pytest.mark.parametrize("tracking_time", [None, DT, 0.01])
def test_whatever_comes_in_limits_and_rate_hold(compensator, tracking_time):
    """From the acting drive where it can be one, else from the last output."""
    rng, change = np.random.default_rng(3), 0.005
    controller = FeedforwardPI(
        *(0.5, 20.0),
        **{"compensator": compensator, "tracking_time": tracking_time, "damping": DAMPING},
        **{"notch": (80.0, 0.05), "kd": 1e-3, "setpoint_weight": 0.5, "start_time": 0.02},
        **{"drive_limits": (-1.0, 1.0), "rate_limit": change / DT},
    )
    stepper = controller.stepper(DT)
    n, acts = len(stepper.inputs), tracking_time is not None
    huge = [1e308, -1.7e308, 1e200, -1e20, 50.0, np.nan, np.inf]
    rows = np.where(
        rng.random((600, n)) < 0.1, rng.choice(huge, (600, n)), rng.normal(size=(600, n))
    )
    rows[0] = 0.0
    last = stepper.step(rows[0])
    for row in rows[1:]:
        if not np.isfinite(row).all():
            with pytest.raises(ValueError, match="must be finite"):
                stepper.step(row)
            continue
        can_act = acts and abs(row[-1]) <= 1.0
        drive = stepper.step(row)
        assert abs(drive) <= 1.0
        assert abs(drive - (row[-1] if can_act else last)) <= change * (1.0 + 1e-12)
        assert ("extrapolated" in stepper.status) == (acts and not can_act)
        last = drive


def test_a_drive_that_has_acted_beyond_the_limits_is_not_held():
    """Nor does the integral part follow it beyond them."""
    controller = FeedforwardPI(1.0, 40.0, drive_limits=(-5.0, 5.0), tracking_time=2.0 * DT)
    stepper = controller.stepper(DT)
    assert stepper.step((1e308, -1e308, 1e6)) == 0.0  # their difference is beyond numbers
    assert stepper.status == {"extrapolated", "overrange"}
    other = controller.stepper(DT)
    assert other.step((0.0, 0.0, 1e6)) == other.step((0.0, 0.0, 2.5)) == 2.5
