"""Loops around devices: what control theory says of them."""

import numpy as np
import pytest

from skhyst.control import FeedforwardPI, InverseCompensator, simulate_loop
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, GainOperator
from skhyst.operators import SeriesOperator, Stepper

DT, N = 1e-3, 1500
TIME = DT * np.arange(N)
PLAYS = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.4, 0.3, 0.2]))
STAGE = SeriesOperator(("plays", "lag"), (PLAYS, FirstOrderLagOperator(2e-3)))


def device(operator=STAGE):
    return Stepper(operator.lowered(DT, operator.init(0.0)))


def test_a_loop_around_a_gain_is_a_geometric_series():
    """y[k] = g ki dt (sum of errors before k), so that 1 - y[k + 1] = (1 - g ki dt) (1 - y[k])."""
    loop = simulate_loop(
        device(GainOperator(2.0)), FeedforwardPI(0.0, 50.0), np.r_[0.0, np.ones(60)], DT
    )
    expected = 1.0 - 0.9 ** np.r_[0, np.arange(60)]
    np.testing.assert_allclose(loop.response, expected, rtol=1e-12)


def test_integral_action_leaves_no_error_at_rest():
    loop = simulate_loop(device(), FeedforwardPI(0.1, 60.0), np.full(N, 3.0), DT)
    assert abs(loop.response[-1] - 3.0) < 1e-9


def test_feedforward_takes_away_what_feedback_is_late_for():
    """At most a fifth of the error of feedback alone."""
    u = 6.0 * np.sin(5.0 * TIME) * np.cos(17.0 * TIME)
    model = PrandtlIshlinskii(thresholds=np.arange(4.0), dt=DT)
    model.fit(u[:, None], PLAYS.run(u, DT)[0])
    compensator = InverseCompensator(model).fit(u[:, None], u)
    reference = 3.0 * np.sin(2 * np.pi * 5.0 * TIME)
    errors = []
    for own in (compensator, None):
        controller = FeedforwardPI(0.1, 60.0, compensator=own)
        loop = simulate_loop(device(), controller, reference, DT, noise=1e-3, random_state=0)
        errors.append(np.sqrt(np.mean((loop.response - reference) ** 2)))
    assert errors[0] < 0.2 * errors[1]


def test_the_integral_does_not_wind_up():
    """Behind a reference out of reach, the response is back as soon as the drive can bring it."""
    reference = np.where(TIME < 0.7, 9.0, 1.0)
    limited = FeedforwardPI(0.1, 60.0, drive_limits=(-3.0, 3.0))
    loop = simulate_loop(device(), limited, reference, DT)
    assert np.abs(loop.drive).max() <= 3.0
    settled = np.abs(loop.response - 1.0) < 0.02
    assert settled[TIME > 0.8].all()


def test_the_sensor_has_noise_and_steps_and_the_drive_is_late():
    reference = np.full(200, 0.5)
    loop = simulate_loop(
        device(GainOperator(1.0)),
        FeedforwardPI(1.0, 0.0),
        reference,
        DT,
        noise=0.1,
        resolution=0.05,
        delay=3,
        random_state=0,
    )
    steps = loop.reading / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(loop.response[3:], loop.drive[:-3])
    np.testing.assert_allclose(loop.drive, reference - loop.reading)
    again = simulate_loop(
        device(GainOperator(1.0)), FeedforwardPI(1.0, 0.0), reference, DT, noise=0.1, random_state=0
    )
    assert np.ptp(again.reading - again.response) > 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"reference": [0.0, np.nan]}, "finite"),
        ({"reference": []}, "finite"),
        ({"noise": -1.0}, "noise"),
        ({"delay": -1}, "delay"),
        ({"dt": 0.0}, "dt"),
    ],
)
def test_bad_options_are_refused(options, message):
    options = {"reference": [0.0, 1.0], "dt": DT} | options
    with pytest.raises(ValueError, match=message):
        simulate_loop(device(), FeedforwardPI(1.0, 1.0), **options)


def test_limits_must_be_in_their_order():
    with pytest.raises(ValueError, match="drive_limits"):
        simulate_loop(device(), FeedforwardPI(1.0, 1.0, drive_limits=(1.0, 0.0)), [0.0], DT)
