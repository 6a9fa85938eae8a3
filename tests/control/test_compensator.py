"""The response to the drive that a compensator finds is the reference."""

import dataclasses
import re

import numpy as np
import pandas as pd
import pytest
from operator_cases import OPERATORS, make_drive
from scipy.linalg import toeplitz
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from skhyst.compose import Cascade, OnColumn, Sum
from skhyst.control import FeedforwardPI, InverseCompensator, simulate_loop
from skhyst.control._drive_limits import DriveLimits
from skhyst.disturbance import Offset
from skhyst.exceptions import ReachWarning, RecordError
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    BoucWenStageOperator,
    DahlOperator,
    FrictionStageOperator,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    RateDependentPrandtlIshlinskiiOperator,
    TanhHysteresisOperator,
)
from skhyst.linear import (
    DelayOperator,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from skhyst.operators import (
    FrozenOperator,
    RootInverseOperator,
    Series,
    Stepper,
    SumOperator,
    add_disturbances,
)
from skhyst.records import stack_records
from skhyst.static import SaturationOperator, SoftSaturation

DT, N = 1e-3, 1200
TIME = DT * np.arange(N)
PLAYS = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.4, 0.3, 0.2]), 0.1, 0.05)
FREQUENCY = 50.0  # Hz
MODE = SecondOrderModeOperator(2.0 * np.pi * FREQUENCY, 0.03)
WIRES = BoucWenStageOperator(2.0 * np.pi * FREQUENCY, 0.1, 0.5, 1.0, 0.0, 1.5, gain=2.0)
FRICTION = FrictionStageOperator(2.0 * np.pi * FREQUENCY, 0.1, 0.5, 0.8, 30.0, 20.0, gain=2.0)


class Known(PrandtlIshlinskii):
    """A model whose operator is known, at drives of any size and rate."""

    def __init__(self, operator):
        self.operator = operator

    def fit(self, X, y):
        self._read_records(X, y)
        self.operator_ = self.operator
        self.drive_range_, self.drive_rate_ = (-np.inf, np.inf), np.inf
        return self

    dt, initial_state, _parameter_constraints = DT, "rest", {}


def compensator(operator, **options):
    model = Known(operator).fit(np.zeros((4, 1)), np.arange(4.0))
    return InverseCompensator(model, **options).fit(np.zeros((4, 1)), np.arange(4.0))


def smooth(frequency, size=4.0):
    """Return a reference that begins and ends at rest."""
    window = np.clip(np.minimum(TIME - 0.05, 1.1 - TIME) / 0.1, 0.0, 1.0)
    return size * np.sin(2 * np.pi * frequency * TIME) * window**2 * (3.0 - 2.0 * window)


@pytest.mark.parametrize("frequency", [1.0, 10.0, 0.7 * FREQUENCY])
@pytest.mark.parametrize("reverse", [False, True])
def test_the_response_of_a_cascade_is_the_reference(frequency, reverse):
    device = Series(("plays", "mode"), (PLAYS, MODE))
    if reverse:
        device = Series(("mode", "plays"), (MODE, PLAYS))
    reference = smooth(frequency)
    drive, residual = compensator(device).predict(reference[:, None], return_residual=True)
    y, _ = device.run(drive, DT)
    assert np.abs(y - reference).max() < 1e-8 * np.ptp(reference)
    np.testing.assert_allclose(residual, y - reference, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("stage", "frequency"), [(WIRES, 5.0), (FRICTION, 0.7 * FREQUENCY)])
def test_motion_with_hysteresis_inside_is_found(stage, frequency):
    reference = smooth(frequency)
    _, left = compensator(stage, max_iter=0).predict(reference[:, None], return_residual=True)
    assert np.abs(left).max() < 1e-8 * np.ptp(reference)


def test_what_sticks_too_stiffly_for_the_interval_comes_closer():
    stage = dataclasses.replace(FRICTION, bristle_stiffness=1000.0)
    reference = smooth(5.0)
    _, left = compensator(stage).predict(reference[:, None], return_residual=True)
    alone, _ = stage.run(stage.linear_mode().inverse().run(reference, DT)[0], DT)
    assert np.abs(left).max() < 0.05 * np.abs(alone - reference).max()


def test_what_is_cut_by_limits_is_told():
    found = compensator(PLAYS, drive_limits=(-1.0, 1.0))
    with pytest.warns(ReachWarning, match="cut [1-9].* % of the samples"):
        drive = found.predict(smooth(2.0)[:, None])
    assert np.abs(drive).max() <= 1.0


def test_what_is_out_of_reach_is_named_with_its_value():
    device = Series(("plays", "amplifier"), (PLAYS, SaturationOperator(upper=2.0)))
    with pytest.warns(ReachWarning, match=r"stage 'amplifier' cannot reach the required (3\.9|4)"):
        compensator(device, max_iter=0).predict(smooth(2.0)[:, None])


# ------------------------------------------------------- drives that a device could not bear

U = np.sin(20.0 * TIME) + 0.3 * np.sin(2.0 * np.pi * 50.0 * TIME**2)  # of a recording
NONE = {"drive_limits": None, "rate_limit": None}


def fitted_mode(damping_ratio, **options):
    """Return the compensator of a mode that was fitted to a record with noise, and the mode."""
    mode = SecondOrderModeOperator(2.0 * np.pi * 60.0, damping_ratio)
    y = mode.run(U, DT)[0] + 1e-3 * np.random.default_rng(0).normal(size=N)
    return InverseCompensator(SecondOrderMode(dt=DT), **options).fit(U[:, None], y), mode


def bounded(operator, reference, rest=60):
    """Return the drive of least size that follows a reference between two rests, by its matrix."""
    wanted = np.concatenate([np.full(rest, reference[0]), reference, np.full(rest, reference[-1])])
    pulse = operator.run(np.eye(1, len(wanted), k=1)[0], DT)[0][1:]
    found = np.linalg.lstsq(toeplitz(pulse, np.zeros(len(pulse))), wanted[1:], rcond=1e-9)[0]
    return found[rest - 1 : rest - 1 + len(reference)]


@pytest.mark.parametrize("damping_ratio", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_a_reference_that_moves_at_its_ends_asks_for_no_more_than_it_needs(damping_ratio, phase):
    """The direction that the response does not show stays out, whatever the limits are."""
    reference = np.sin(40.0 * np.pi * DT * np.arange(300) + phase)
    found, mode = fitted_mode(damping_ratio, **NONE)
    with pytest.warns(ReachWarning, match="of the drive are beyond the range of the fit"):
        drive = found.predict(reference[:, None])
    needed = bounded(mode, reference)
    np.testing.assert_allclose(drive[-20:], needed[-20:], atol=0.05)
    assert np.abs(drive).max() < 1.5 * np.abs(needed).max()
    error = mode.run(drive, DT, mode.init(drive[0]))[0] - reference
    assert np.abs(error).max() < 0.1 * np.ptp(reference)
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.ptp(reference)


def test_a_mode_driven_to_the_end_of_a_record():
    """The last drive stops the mass: 1.6 times what holds the reference at its largest."""
    reference = np.sin(40.0 * np.pi * DT * np.arange(400))
    found, mode = fitted_mode(0.05, **NONE)
    with pytest.warns(ReachWarning):
        last = found.predict(reference[:, None])[-1]
    assert last == pytest.approx(bounded(mode, reference)[-1], rel=0.02)
    assert abs(last) == pytest.approx(1.6, abs=0.05)
    limited, _ = fitted_mode(0.05)
    with pytest.warns(ReachWarning, match=r"cut \d.* % of the samples: .* per s"):
        drive = limited.predict(reference[:, None])
    assert U.min() <= drive.min() <= drive.max() <= U.max()
    assert np.abs(np.diff(drive)).max() <= np.abs(np.diff(U)).max() * (1.0 + 1e-9)


@pytest.mark.parametrize("damping_ratio", [0.01, 0.05])
def test_trials_on_the_device_ask_for_no_more_either(damping_ratio):
    reference = np.sin(40.0 * np.pi * DT * np.arange(300) + 1.0)
    found, mode = fitted_mode(damping_ratio, **NONE)
    device, drives = dataclasses.replace(mode, damping_ratio=1.3 * damping_ratio), []
    noise = np.random.default_rng(1)

    def measure(drive):
        drives.append(drive)
        return device.run(drive, DT, device.init(drive[0]))[0] + 1e-4 * noise.normal(size=300)

    with pytest.warns(ReachWarning):
        found.refine(reference[:, None], measure, 12)
    assert np.all(np.diff(found.errors_) < 0.0)
    assert (
        max(np.abs(drive).max() for drive in drives) < 3.0 * np.abs(bounded(mode, reference)).max()
    )


def test_three_times_the_reference_is_cut_and_told():
    u = 5.0 * np.sin(7.0 * TIME) * TIME / TIME[-1]
    y, _ = PLAYS.run(u, DT)
    model = PrandtlIshlinskii(thresholds=np.arange(4.0), drive_offset=0.05, dt=DT)
    found = InverseCompensator(model).fit(u[:, None], y)
    assert (found.drive_limits_, found.rate_limit_) == ((u.min(), u.max()), found.drive_rate_)
    np.testing.assert_allclose(found.predict(y[:, None]), u, atol=1e-6)  # as recorded: nothing
    with pytest.warns(ReachWarning) as told:
        drive, residual = found.predict(3.0 * y[:, None], return_residual=True)
    (message,) = [str(one.message) for one in told]
    share, missed = re.search(r"cut (\S+) % of .* miss .* by up to (\S+) \(", message).groups()
    assert 0.0 < float(share) < 100.0
    assert float(missed) == pytest.approx(np.abs(residual).max(), rel=1e-3)
    assert (drive.min(), drive.max()) == (u.min(), u.max())
    wide = clone(found).set_params(limit_margin=0.5).fit(u[:, None], y)
    span = np.ptp(u)
    assert wide.drive_limits_ == pytest.approx((u.min() - 0.5 * span, u.max() + 0.5 * span))
    assert wide.rate_limit_ == pytest.approx(1.5 * found.drive_rate_)
    free = clone(found).set_params(**NONE).fit(u[:, None], y)
    with pytest.warns(ReachWarning, match="of the drive are beyond the range of the fit"):
        drive = free.predict(3.0 * y[:, None])
    np.testing.assert_allclose(PLAYS.run(drive, DT)[0], 3.0 * y, atol=1e-5)


@pytest.mark.parametrize(
    "model",
    [
        ModifiedPrandtlIshlinskii(8, dt=DT),
        Cascade([("plays", PrandtlIshlinskii(5)), ("knee", SoftSaturation(sides="upper"))], dt=DT),
    ],
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ShortRecordWarning")  # the clipping is slow
def test_a_stage_that_was_clipped_is_driven_no_further(model):
    """Recorded at 5 to 75 V, clipped at 6.5 um, asked for 14 um."""
    u = 40.0 + 35.0 * np.sin(4.0 * np.pi * TIME) * TIME / TIME[-1]
    clipped = np.minimum(0.1 * PLAYS.run(u, DT)[0] / 1.9, 6.5)
    found = InverseCompensator(model).fit(u[:, None], clipped)
    with pytest.warns(ReachWarning, match=r"will miss the reference by up to \d"):
        drive = found.predict(7.0 + 7.0 * np.sin(4.0 * np.pi * TIME[:, None]))
    assert u.min() <= drive.min() <= drive.max() <= u.max()


def test_a_mass_with_friction_is_not_thrown_about():
    """A reference that jumps asks for hundreds of volts up and down; recorded were 12, slowly."""
    u = 12.0 * np.sin(6.0 * np.pi * TIME) * np.cos(1.4 * np.pi * TIME)
    model = Known(FRICTION).fit(u[:, None], FRICTION.run(u, DT)[0])
    model.drive_range_, model.drive_rate_ = (u.min(), u.max()), np.abs(np.diff(u)).max() / DT
    found = InverseCompensator(model).fit(u[:, None], u)
    with pytest.warns(ReachWarning, match=r"cut .* miss the reference"):
        drive = found.predict(8.0 * (TIME[:300, None] > 0.1))
    assert np.abs(drive).max() <= 12.0
    assert np.abs(np.diff(drive)).max() <= np.abs(np.diff(u)).max() * (1.0 + 1e-9)


def test_a_start_that_is_missed_is_reported():
    """A response that begins the wrong way for 50 ms cannot follow what moves at once."""
    slow = TransferFunctionOperator(
        np.empty(0), np.array([300.0]), np.array([0.1]), np.array([-0.05])
    )
    with pytest.warns(ReachWarning, match=r"will miss the reference by up to (\S+) \(\d"):
        found = compensator(slow).predict(100.0 * np.sin(100.0 * TIME[:300, None]))
    assert np.abs(found).max() < 300.0


def test_a_model_that_does_not_know_its_drive_is_told():
    found = compensator(PLAYS)
    del found.model_.drive_range_, found.model_.drive_rate_
    older = InverseCompensator(found.model_).fit(np.zeros((4, 1)), np.arange(4.0))
    for use in (lambda: older.predict(smooth(2.0)[:, None]), lambda: older.stepper(DT)):
        with pytest.warns(ReachWarning, match="saved by an earlier version, without it"):
            use()
    older.set_params(drive_limits=(-9.0, 9.0), rate_limit=None).predict(smooth(2.0)[:, None])


@pytest.mark.parametrize(
    "options",
    [
        {"drive_limits": (-np.inf, np.inf), "rate_limit": 1e9},
        {"drive_limits": (-np.inf, 2.0), "rate_limit": 1e9},
        {"drive_limits": (-1000.0, 1000.0), "rate_limit": 1e9},
        {"limit_margin": 1e308},
    ],
)
def test_what_leaves_the_fit_is_told_whatever_the_limits(options):
    u = np.tile([-1.0, 1.0], 25)[:, None]
    found = InverseCompensator(Gain(dt=0.1).fit(u, 3.0 * u[:, 0]), **options).fit(u, u[:, 0])
    with pytest.warns(ReachWarning, match=r"fit \(-1 to 1, 20 per s\): from -2 to 1, up to 30 "):
        drive = found.predict([[3.0], [-6.0]])
    np.testing.assert_allclose(drive, [1.0, -2.0])


def test_a_bandwidth_that_no_filter_can_have_is_refused():
    with pytest.raises(ValueError, match="The 'bandwidth' parameter of InverseCompensator must be"):
        compensator(PLAYS, bandwidth=1e-9).predict(smooth(2.0)[:, None])


def test_a_learned_inverse_is_limited_too():
    u = np.tile([-1.0, 1.0], 25)[:, None]
    found = InverseCompensator(LinearRegression(), method="learned").fit(u, 3.0 * u[:, 0])
    with pytest.warns(ReachWarning, match="cut 50 % of the samples: -1 to 1, 2 per s"):
        drive = found.predict([[0.3], [0.3], [12.0], [12.0]])
    np.testing.assert_allclose(drive, [0.1, 0.1, 1.0, 1.0])


def test_the_rate_holds_at_any_interval():
    found = compensator(PLAYS, rate_limit=20.0)
    with pytest.warns(ReachWarning, match="of the samples: 20 per s"):
        drive = found.drive_for(smooth(2.0)[::2], 2.0 * DT)
    assert np.abs(np.diff(drive)).max() <= 20.0 * 2.0 * DT * (1.0 + 1e-12)


def test_the_nearest_drive_that_keeps_a_rate():
    """No other that begins there is nearer, by the largest difference."""
    rng = np.random.default_rng(0)
    k = np.arange(40)
    for change in (0.1, 0.5, 2.0):
        u = rng.normal(size=40)
        slower = DriveLimits(rate=change / DT).applied(u, DT)
        apart = np.abs(u - u[:, None]) - change * np.abs(k - k[:, None])
        distance = max(0.5 * apart.max(), apart[0].max(), 0.0)
        assert np.abs(slower - u).max() == pytest.approx(distance, rel=1e-12)
        assert np.abs(np.diff(slower)).max() <= change * (1.0 + 1e-12)
        assert slower[0] == u[0]


def test_iterations_on_the_device_never_make_it_worse():
    """The device is not the model; its sensor has noise."""
    noise, rng = 2e-3, np.random.default_rng(0)
    other = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.1, 0.3, 0.4, 0.2]))
    device = Series(("plays", "mode"), (other, SecondOrderModeOperator(2 * np.pi * 50.3, 0.032)))
    found = compensator(Series(("plays", "mode"), (PLAYS, MODE)), bandwidth=60.0)
    reference = smooth(8.0)
    drive = found.refine(
        reference[:, None], lambda u: device.run(u, DT)[0] + noise * rng.normal(size=N)
    )
    assert np.all(np.diff(found.errors_) < 0.0)
    left = device.run(drive, DT)[0] - reference
    assert np.sqrt(np.mean(left**2)) < 2.0 * noise
    assert found.errors_[0] > 50.0 * noise


def test_an_inverse_can_be_learned():
    y = np.random.default_rng(0).normal(size=(50, 1))
    found = InverseCompensator(LinearRegression(), method="learned").fit(3.0 * y + 1.0, y[:, 0])
    np.testing.assert_allclose(found.predict([[1.5]]), [5.5])
    refused = (
        lambda X: found.predict(X, return_residual=True),
        lambda X: found.refine(X, np.ravel),
    )
    for method in refused:
        with pytest.raises(ValueError, match="learned inverse"):
            method([[2.0]])
    with pytest.raises(NotImplementedError, match="learned inverse"):
        found.stepper(DT)


@pytest.mark.parametrize("answer", [lambda u: np.full(N, np.nan), lambda u: u[:-1]])
def test_a_device_that_fails_is_told(answer):
    with pytest.raises(ValueError, match="1200 finite numbers"):
        compensator(PLAYS).refine(smooth(2.0)[:, None], answer)


def test_a_model_is_fitted_where_it_is_not():
    u = 4.0 * np.sin(5.0 * TIME) * np.cos(17.0 * TIME)
    y, _ = PLAYS.run(u, DT)
    X = pd.DataFrame({"drive": u}, pd.Index(TIME, name="time"))
    model = PrandtlIshlinskii(thresholds=np.arange(4.0), drive_offset=0.05)
    found = InverseCompensator(model).fit(X, pd.Series(y, X.index))
    assert not hasattr(model, "operator_")
    np.testing.assert_allclose(found.predict(X.assign(drive=y)), u, atol=1e-6)
    again = InverseCompensator(found.model_).fit(X, y)
    assert again.model_ is found.model_
    assert clone(again).model is not found.model_


def test_it_streams_what_it_predicts():
    device = Series(("plays", "zones"), (PLAYS, SaturationOperator(-9.0, 9.0)))
    reference = smooth(3.0)
    found = compensator(device)
    stepper = found.stepper(DT, reference[0])
    assert isinstance(stepper, Stepper)
    steps = np.array([stepper.step(value) for value in reference])
    np.testing.assert_allclose(steps, found.predict(reference[:, None]), atol=1e-9)
    assert found.preview(DT) == 0


DEVICES = {
    "plays and a mode": Series(("plays", "mode"), (PLAYS, MODE)),
    "a delay within": Series(("plays", "delay", "mode"), (PLAYS, DelayOperator(0.0073), MODE)),
    "it begins the wrong way": TransferFunctionOperator(
        np.empty(0), np.array([300.0]), np.array([0.1]), np.array([-0.01])
    ),
    "a zero-order hold": dataclasses.replace(MODE, damping_ratio=0.4, hold="zoh"),
    "a lag": FirstOrderLagOperator(0.01),
    "friction": FRICTION,
    "the rate lowers the response": TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.1),
}


@pytest.mark.parametrize("name", DEVICES)
def test_it_streams_what_it_predicts_from_a_preview(name):
    reference = smooth(7.0) + 1.5
    found = compensator(DEVICES[name], max_iter=0)
    whole = found.predict(reference[:, None])
    ahead = found.preview(DT)
    drive = found.stepper(DT, reference[0]).run(reference)[ahead:]
    middle = slice(100, N - 2 * ahead)
    error = np.abs(drive[middle] - whole[: N - ahead][middle]).max()
    assert error < 1e-8 * np.ptp(whole)


HYSTERESES = tuple(OPERATORS[name] for name in ("Duhem", "slip elements", "Bouc-Wen"))
AT_ONCE = {
    "sum of hystereses": SumOperator(("a", "b", "c"), HYSTERESES),
    "series of sums of hystereses": Series(
        ("first", "second"),
        (SumOperator(("a", "b"), (PLAYS, HYSTERESES[1])), SumOperator(("a",), HYSTERESES[:1])),
    ),
    "slip elements, held": FrozenOperator(HYSTERESES[1]),
    "slip elements before a mode": Series(("slip", "mode"), (HYSTERESES[1], MODE)),
}
for name, operator in OPERATORS.items():
    if operator.at_once and operator.causal and "delay" not in name:  # a record's ends tell it
        AT_ONCE[name] = operator
REFUSED = {  # what no drive can give, or what is known of a whole record alone
    **dict.fromkeys(("offset", "drift", "sinusoid", "empty sum"), "has no inverse|of nothing"),
    "plays, stop form, no spring left": "with a first threshold of 0",
    **{name: "an inverse from a rest" for name in AT_ONCE if "integrator" in name},
    **{name: "looks ahead" for name in AT_ONCE if name.startswith("rate-dependent")},
}


@pytest.mark.parametrize("name", AT_ONCE)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ReachWarning")  # an end of the reach
def test_what_follows_at_once_is_streamed_as_it_is_predicted(name):
    if name in REFUSED:
        with pytest.raises((ValueError, NotImplementedError), match=REFUSED[name]):
            compensator(AT_ONCE[name], max_iter=0).stepper(DT)
        return
    found = compensator(AT_ONCE[name], max_iter=0)
    u = make_drive()
    reference = AT_ONCE[name].run(u, DT, AT_ONCE[name].init(u[0]))[0]
    rest = found.preview(DT)  # the drive moves before the response, and at its end before that
    reference = np.pad(reference, (rest, 2 * rest), mode="edge")
    stepper = found.stepper(DT, reference[0])
    begin, other, ahead = stepper.state, stepper.copy(), found.preview(DT)
    drive = stepper.run(reference)
    np.testing.assert_array_equal([other.step(value) for value in reference], drive)
    np.testing.assert_array_equal(other.state, stepper.state)
    other.state = begin
    np.testing.assert_array_equal(other.run(reference), drive)
    elsewhere = found.stepper(DT, reference[rest + 20])  # the state is all that is remembered
    elsewhere.state = begin
    np.testing.assert_array_equal(elsewhere.run(reference), drive)
    whole = found.predict(reference[:, None])[: len(drive) - ahead]
    until = rest + len(u) - ahead
    allowed = 1e-8 * np.ptp(whole)
    np.testing.assert_allclose(drive[ahead:][:until], whole[:until], rtol=0.0, atol=allowed)


@pytest.mark.parametrize("preview", [0, 3])
def test_disturbances_that_are_known_are_taken_out_of_the_stream(preview):
    """Offset and drift of the record, at the sample whose drive it is."""
    additive = OPERATORS["offset"], OPERATORS["drift"]
    device = add_disturbances(GainOperator(2.0), additive)
    reference = smooth(3.0)
    known = sum(own.run(reference, DT)[0] for own in additive)
    drive = compensator(device).stepper(DT, reference[0], preview).run(reference)[preview:]
    expected = (0.5 * (reference - known))[: N - preview]
    np.testing.assert_allclose(drive, expected, rtol=0.0, atol=1e-12)


def test_the_error_falls_exponentially_with_the_preview():
    """Each sample of it by the zero near -3.73 of a mass that is pushed along straight lines."""
    reference = smooth(0.7 * FREQUENCY)
    found = compensator(MODE)
    whole, errors = found.predict(reference[:, None]), []
    for ahead in (4, 8):
        drive = found.stepper(DT, preview=ahead).run(reference)[ahead:]
        errors.append(np.abs(drive - whole[:-ahead]).max())
    # per decade of the error that is left: seven samples for four decades, at least
    assert errors[1] < errors[0] * 3.73**-3
    drive = found.stepper(DT, preview=200).run(reference)[200:]
    np.testing.assert_allclose(drive[:-200], whole[:-400], atol=1e-9 * np.ptp(whole))
    with pytest.raises(ValueError, match=r"'preview' .* must be at least \d samples"):
        compensator(DEVICES["a delay within"]).stepper(DT, preview=2)


def test_an_inverse_that_is_not_stable_is_named():
    """Where the rate lowers the response, what comes later determines the drive."""
    parts = TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3), GainOperator(0.2)
    device = SumOperator(("tanh", "gain"), parts)
    with pytest.warns(
        ReachWarning, match=r"stage 'SumOperator' cannot reach the required .* is not stable"
    ):
        compensator(device, max_iter=0).predict(smooth(2.0)[:, None])


def test_what_needs_a_whole_record_is_not_stepped():
    plays = RateDependentPrandtlIshlinskiiOperator(np.arange(3.0), np.ones(3), (), 0.01)
    with pytest.raises(NotImplementedError, match="looks ahead"):
        compensator(plays).stepper(DT)


def test_disturbances_that_are_known_are_taken_out():
    X = np.sin(5.0 * TIME)[:, None]
    model = Sum([("gain", Gain(fit_intercept=False)), ("offset", Offset())], dt=DT)
    found = InverseCompensator(model).fit(X, 2.0 * X[:, 0] + 0.5)
    np.testing.assert_allclose(found.predict(2.0 * X + 0.5), X[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": LinearRegression()}, "method='learned'"),
        ({"model": OnColumn(Gain(), 1)}, "one input"),
        ({"model": Gain(), "drive_limits": (1.0, -1.0)}, "lower one first"),
        ({"model": Gain(), "bandwidth": -1.0}, "bandwidth"),
    ],
)
def test_bad_options_are_refused(options, message):
    X = np.random.default_rng(0).normal(size=(30, 2))
    with pytest.raises((TypeError, ValueError), match=message):
        InverseCompensator(**options).fit(X, X[:, 0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_broken_references_are_refused(bad):
    reference, found = smooth(2.0), compensator(MODE)
    reference[40] = bad
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        found.predict(reference[:, None])
    with pytest.raises(ValueError, match=r"'reference' .* must be a finite number"):
        found.stepper(DT, bad)
    stepper = found.stepper(DT)
    before = stepper.state
    with pytest.raises(ValueError, match="finite"):
        stepper.step(bad)
    np.testing.assert_array_equal(stepper.state, before)


@pytest.mark.parametrize("bad", [-1, 2.5])
def test_a_preview_is_a_number_of_samples(bad):
    with pytest.raises(ValueError, match=r"'preview' .* number of samples"):
        compensator(MODE).stepper(DT, preview=bad)


def test_a_response_that_ignores_a_constant_drive_is_refused():
    washout = TransferFunctionOperator(
        np.array([0.05, 0.01]), np.empty(0), np.empty(0), np.array([0.3]), gain=0.0
    )
    with pytest.raises(ValueError, match="no stable inverse"):
        compensator(washout).predict(smooth(2.0)[:, None])
    with pytest.raises(ValueError, match="no stable inverse"):
        compensator(washout).stepper(DT)


def test_records_of_any_interval_are_inverted_at_their_own():
    index = pd.MultiIndex.from_tuples(
        [(k, i * dt) for k, dt in enumerate((1e-3, 4e-3)) for i in range(300)],
        names=["record", "time"],
    )
    X = pd.DataFrame({"drive": np.tile(smooth(8.0)[::4], 2)}, index)
    model = Known(Series(("plays", "mode"), (PLAYS, MODE))).fit(X, X["drive"])
    found = InverseCompensator(model).fit(X, X["drive"])
    assert np.abs(found.predict(X, return_residual=True)[1]).max() < 1e-8


@pytest.mark.parametrize("rest", [250, 330, 1200, 5000])
def test_an_inverse_by_roots_follows_after_a_rest_however_long(rest):
    friction = DahlOperator(0.1, 0.8, stiffness=0.3)
    y = np.append(np.zeros(rest), np.linspace(0.0, 0.4, 50))
    drive, _ = RootInverseOperator(friction, -5.0, 5.0).run(y, DT)
    np.testing.assert_allclose(friction.run(drive, DT)[0], y, atol=1e-12)


def test_a_stepper_reports_limits_at_which_a_root_stops():
    t = DT * np.arange(1500)
    u = 3.0 * np.sin(20.0 * t) * np.exp(-t)
    y, _ = BoucWenOperator(0.8, 1.5, 0.4, 0.6).run(u, DT)
    stepper = InverseCompensator(BoucWen(dt=DT)).fit(u[:, None], y).stepper()
    asked = 10.0 * np.sin(3.0 * t[:700])  # far beyond, then back within
    drives, flagged = zip(*((stepper.step(r), bool(stepper.status)) for r in asked), strict=True)
    at_limit = (np.array(drives) <= u.min()) | (np.array(drives) >= u.max())
    assert at_limit.mean() > 0.5
    assert (np.array(flagged) >= at_limit).all()


@pytest.mark.parametrize(
    "changed",
    [
        {"drive_limits": (5.0, -5.0)},
        {"drive_limits": (np.nan, 1.0)},
        {"drive_limits": 7},
        {"drive_limits": "none"},
        {"rate_limit": np.nan},
        {"rate_limit": -1},
    ],
)
def test_limits_that_are_set_after_the_fit_are_checked(changed):
    found = compensator(PLAYS).set_params(**changed)
    for use in (lambda: found.predict(smooth(2.0)[:, None]), found.stepper):
        with pytest.raises(ValueError, match=next(iter(changed))):
            use()


def test_a_miss_counts_in_its_own_record():
    """Beside a larger record, and whatever the unit of a constant reference is."""
    found = compensator(GainOperator(1e-6), drive_limits=(-3.0, 3.0), rate_limit=None)
    small, large = np.array([0.0, 1e-8, 0.0]), np.array([0.0, 3e-6, 0.0])
    X, _ = stack_records([(large, large), (small, small)], dt=DT)
    residual = np.r_[np.zeros(3), 0.0, 1e-8, 0.0]
    assert found.largest_miss(X.set_axis([0], axis=1), residual) == (1.0, 1e-8, 1)
    constant = np.full((5, 1), 1e-5)
    with pytest.warns(ReachWarning, match="70 % of its range"):
        found.predict(constant)


def test_refine_says_that_the_device_misses():
    found, reference = compensator(PLAYS), smooth(2.0)[:, None]
    with pytest.warns(ReachWarning, match="the device misses the reference"):
        found.refine(reference, np.zeros_like, n_trials=2)
    with pytest.raises(ValueError, match="n_trials"):
        found.refine(reference, np.zeros_like, n_trials=1.5)


def test_feedback_keeps_to_the_limits_of_its_compensator():
    found = compensator(GainOperator(1.0), drive_limits=(-2.0, 2.0), rate_limit=None)
    device = FirstOrderLagOperator(0.05)
    with pytest.warns(ReachWarning):
        loop = simulate_loop(
            Stepper(device.compiled_step(DT, device.init(0.0))),
            FeedforwardPI(5.0, 400.0, compensator=found),
            np.full(300, 10.0),
            DT,
            u0=0.0,
        )
    assert loop.drive.max() == 2.0


def test_a_single_value_and_a_rest_within_the_limits():
    """A value is held; a message says which samples the rate cuts to a rest, and why."""
    found = compensator(FirstOrderLagOperator(0.05), rate_limit=1.0, drive_limits=None)
    np.testing.assert_allclose(found.drive_for([3.0], DT), [3.0])
    with pytest.warns(ReachWarning, match="than at rest, where it stays.*cut 9.* per s"):
        drive = found.predict(np.sin(2.0 * np.arange(200.0))[:, None])
    assert np.ptp(drive) == 0.0


def test_a_model_fitted_without_a_time_has_no_drive_per_second():
    """Its rate is per sample: at another interval it would be exceeded."""
    u = np.tile([-1.0, 1.0], 25)[:, None]
    found = InverseCompensator(Gain().fit(u, 3.0 * u[:, 0])).fit(u, u[:, 0])
    for own in (found, InverseCompensator(Gain(), method="learned").fit(u, 3.0 * u[:, 0])):
        with pytest.raises(RecordError, match="was fitted without a time"):
            own.drive_for([0.0, 1.0, 2.0], 10.0)
    np.testing.assert_allclose(found.predict([[3.0], [1.0]]), [1.0, 1.0 / 3.0])
