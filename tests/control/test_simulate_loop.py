"""Loops around devices: what control theory says of them."""

import numpy as np
import pytest

from skhyst.control import FeedforwardPI, InverseCompensator, simulate_loop
from skhyst.exceptions import DivergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, GainOperator
from skhyst.operators import Series, Stepper

DT, N = 1e-3, 1500
TIME = DT * np.arange(N)
PLAYS = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.4, 0.3, 0.2]))
STAGE = Series(("plays", "lag"), (PLAYS, FirstOrderLagOperator(2e-3)))


def device(operator=STAGE):
    return Stepper(operator.compiled_step(DT, operator.init(0.0)))


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


def test_a_loop_that_diverges_ends_where_it_leaves_the_numbers():
    """With the gain -3 a sample an error is 3**k, which no number holds from k = 647 on."""
    reference = np.r_[0.0, np.ones(999)]
    with pytest.warns(DivergenceWarning, match=r"at 0\.648 s, sample 648, "):
        loop = simulate_loop(device(GainOperator(1.0)), FeedforwardPI(3.0, 0.0), reference, DT)
    assert {len(part) for part in loop} == {648}
    np.testing.assert_allclose(loop.response[1:], 0.75 - 0.75 * (-3.0) ** np.arange(647), rtol=1e-9)
    np.testing.assert_allclose(loop.time, DT * np.arange(648), rtol=1e-15)


class Answering:
    """A device and a controller that answers what it is told, by the number of the sample."""

    def __init__(self, *answers):
        self.answers, self.k = answers, -1

    def step(self, u):
        assert np.isfinite(u)
        self.k += 1
        return self.answers[self.k]

    def controlling(self, reference, dt, u0):
        def control(k, reading):
            assert np.isfinite(reading)
            return self.answers[k]

        return control


@pytest.mark.parametrize("broken", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("delay", [0, 1])
def test_nobody_is_fed_what_is_no_number(broken, delay):
    """Whoever of the two has made it: the loop ends before the other takes it."""
    whole = Answering(1.0, 2.0, 3.0, 4.0)
    for k in range(3):
        answers = [1.0, 2.0, 3.0, 4.0]
        answers[k] = broken
        for parts in ((whole, Answering(*answers)), (Answering(*answers), whole)):
            whole.k = -1
            with pytest.warns(DivergenceWarning, match=rf"at {k * DT:g} s, sample {k}, "):
                loop = simulate_loop(*parts, np.zeros(4), DT, delay=delay, resolution=1e-3)
            assert {len(part) for part in loop} == {k}
            assert np.isfinite(loop).all()


def test_a_reading_beyond_the_numbers_ends_a_loop():
    """Its noise is 1.76, 0.40, 0.98 and 2.24 times 7e307, on a response of 1e308."""
    at_rest, options = Answering(*[0.0] * 4), {"reference": np.zeros(4), "dt": DT}
    with pytest.warns(DivergenceWarning, match=r"at 0\.003 s, sample 3, "):
        loop = simulate_loop(
            Answering(*[1e308] * 4), at_rest, noise=7e307, random_state=0, **options
        )
    assert np.isfinite(loop).all()
    fine = simulate_loop(Answering(*[1e300] * 4), at_rest, resolution=1e-20, **options)
    np.testing.assert_array_equal(fine.reading, [0.0, 1e300, 1e300, 1e300])


def test_limits_must_be_in_their_order():
    with pytest.raises(ValueError, match="drive_limits"):
        simulate_loop(device(), FeedforwardPI(1.0, 1.0, drive_limits=(1.0, 0.0)), [0.0], DT)


def test_a_stepper_runs_at_its_interval():
    own = Stepper(STAGE.compiled_step(DT, STAGE.init(0.0)), DT)
    simulate_loop(own, FeedforwardPI(0.1, 0.0), np.zeros(3), DT)
    with pytest.raises(ValueError, match=r"'dt' .* must be that of the device, 0\.001 s"):
        simulate_loop(own, FeedforwardPI(0.1, 0.0), np.zeros(3), 2.0 * DT)


def test_a_status_of_bits_is_none_of_a_stepper():
    """As that of a program on an emulated controller."""

    class Device:
        status = 16

        def step(self, drive):
            return 0.5 * drive

    loop = simulate_loop(Device(), FeedforwardPI(0.1, 1.0), np.ones(5), 1e-3)
    assert len(loop.response) == 5
