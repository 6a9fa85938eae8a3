"""Linear operators: exact between samples, whatever the interval."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lsim

from skhyst.linear import (
    DelayOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    GainOperator,
    KelvinVoigtOperator,
    LinearOperator,
    MultiInputTransferFunctionOperator,
    SecondOrderModeOperator,
    TimeShift,
    TimeShiftOperator,
    TransferFunctionOperator,
)
from skhyst.operators import parameter

DT = 0.01
LAG = FirstOrderLagOperator(0.03, gain=1.4, intercept=-0.2)
OPERATORS = {
    "lag": LAG,
    "fast lag": FirstOrderLagOperator(1e-3),
    "mode": SecondOrderModeOperator(90.0, 0.15, gain=0.8, intercept=0.1),
    "overdamped mode": SecondOrderModeOperator(90.0, 4.0),
    "stiff mode": SecondOrderModeOperator(5e4, 1e-3),
    "creep": KelvinVoigtOperator(np.array([0.2, 0.1]), np.array([0.02, 30.0]), 1.5, 0.3),
    "transfer function": TransferFunctionOperator(
        np.array([0.02]), np.array([70.0, 200.0]), np.array([0.3, 0.02]), np.array([0.2, -0.1, 0.3])
    ),
}


@pytest.fixture(params=OPERATORS)
def operator(request):
    return OPERATORS[request.param]


@pytest.fixture(params=["foh", "zoh"])
def held(operator, request):
    return dataclasses.replace(operator, hold=request.param)


@pytest.fixture
def u():
    return 0.7 + np.cumsum(np.random.default_rng(0).normal(size=80)) / 5


def test_agrees_with_scipy(held, u):
    a, b, c, d = held.state_space()
    system = (a, b[:, None], c[None, :], np.array([[d]]))
    rest = np.linalg.solve(a, -b * u[0])
    time = DT * np.arange(len(u))
    _, expected, _ = lsim(system, u, time, X0=rest, interp=held.hold == "foh")
    y, _ = held.run(u, DT)
    np.testing.assert_allclose(y - held.intercept, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("time_constant", [1e-4, 2e-3, 1e-2, 0.3, 1e4])
@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_derivatives_of_lags_and_creep_however_fast(time_constant, hold, u):
    """In closed form, which is a series where the time constant is longer than the interval."""
    times = time_constant * np.array([1.0, 3.0])
    for operator in (
        FirstOrderLagOperator(time_constant, 1.4, hold=hold),
        KelvinVoigtOperator(np.array([0.2, 0.1]), times, hold=hold),
    ):
        _, dy = operator.sensitivities(u, np.empty((u.size, 0)), DT)
        values = operator.pack()
        for i, step in enumerate(1e-4 * np.maximum(np.abs(values), 1e-9 + (values == 0.0))):
            ends = values + step * np.array([[-1.0], [1.0]]) * np.eye(len(values))[i]
            low, high = (operator.unpack(end).run(u, DT)[0] for end in ends)
            expected = (high - low) / (2.0 * step)
            scale = np.abs(expected).max() + 1e-9 / step
            np.testing.assert_allclose(dy[:, i], expected, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("factor", [2, 7])
def test_finer_sampling_of_the_same_drive_changes_nothing(held, u, factor):
    """Both holds are exact: a straight line or a constant, cut up, is the same drive."""
    n = factor * (len(u) - 1) + 1
    if held.hold == "foh":
        fine = np.interp(np.arange(n) / factor, np.arange(len(u)), u)
    else:
        # u[k] acts from sample k on, so it is there at all fine samples before sample k + 1
        fine = np.repeat(u, factor)[:n]
    y, _ = held.run(fine, DT / factor)
    expected, _ = held.run(u, DT)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(y[::factor], expected, rtol=0, atol=1e-9 * scale)


def test_static_gain_and_rest(operator):
    gain = float(np.real(operator.frequency_response(0.0)))
    y, _ = operator.run(np.full(5, 2.0), DT)
    np.testing.assert_allclose(y, 2.0 * gain + operator.intercept, rtol=1e-12)


def test_transfer_functions_by_their_formulas():
    f = np.geomspace(0.01, 1e3, 30)
    s = 2j * np.pi * f
    np.testing.assert_allclose(LAG.frequency_response(f), 1.4 / (0.03 * s + 1), rtol=1e-12)
    np.testing.assert_allclose(
        OPERATORS["mode"].frequency_response(f),
        0.8 / (s**2 / 90.0**2 + 2 * 0.15 * s / 90.0 + 1),
        rtol=1e-10,
    )
    np.testing.assert_allclose(
        OPERATORS["creep"].frequency_response(f),
        1.5 * (1 + 0.2 / (0.02 * s + 1) + 0.1 / (30.0 * s + 1)),
        rtol=1e-12,
    )


def test_poles():
    np.testing.assert_allclose(LAG.poles(), [-1 / 0.03])
    found = np.sort_complex(OPERATORS["mode"].poles())
    imaginary = 90.0 * np.sqrt(1 - 0.15**2)
    np.testing.assert_allclose(found, -13.5 + 1j * np.array([-imaginary, imaginary]))
    assert (OPERATORS["transfer function"].poles().real < 0).all()


def test_one_operator_serves_several_intervals(operator, u):
    fresh = dataclasses.replace(operator)
    first = operator.run(u, 0.01)[0]
    other = operator.run(u, 0.02)[0]
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(operator.run(u, 0.01)[0], first)
    np.testing.assert_array_equal(fresh.run(u, 0.02)[0], other)


def test_what_is_remembered_is_not_pickled(operator, u):
    size = len(pickle.dumps(operator))
    for dt in (0.01, 0.02, 0.03):
        operator.run(u, dt)
        operator.sensitivities(u, np.empty((len(u), 0)), dt)
    assert len(pickle.dumps(operator)) == size


@pytest.mark.parametrize("n_second", [2, 14])
def test_long_records_run_in_blocks_as_sample_by_sample(n_second):
    """Ringing, slow and fast poles together: the shortest way changes rounding only."""
    operator = TransferFunctionOperator(
        np.array([1e-3 * DT, 300.0]),
        20.0 * 1.3 ** np.arange(n_second),
        np.geomspace(1e-4, 3.0, n_second),
        np.array([0.3, -0.2, 0.1]),
    )
    u = np.cumsum(np.random.default_rng(1).normal(size=2007))
    # short parts run sample by sample
    state, parts = operator.init(u[0]), []
    for part in np.split(u, [1, 500, 1000, 1300, 1800]):
        piece, state = operator.run(part, DT, state)
        parts.append(piece)
    expected, (last, _) = np.concatenate(parts), state
    y, (x, previous) = operator.run(u, DT)
    assert previous == u[-1]
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    np.testing.assert_allclose(x, last, rtol=0, atol=1e-11 * np.abs(last).max())
    u[1205] = 1e9
    np.testing.assert_array_equal(operator.run(u, DT)[0][:1205], y[:1205])


def test_a_drive_that_overflows_does_not_reach_the_past():
    operator = OPERATORS["transfer function"]
    u = np.random.default_rng(1).normal(size=1000)
    expected = operator.run(u, DT)[0]
    u[790] = np.inf
    np.testing.assert_allclose(operator.run(u, DT)[0][:790], expected[:790], rtol=1e-9, atol=1e-12)


def test_without_states_it_is_a_gain(u):
    operator = KelvinVoigtOperator(np.empty(0), np.empty(0), 1.5, 0.3)
    y, dy = operator.sensitivities(u, u[:, None], DT)
    np.testing.assert_allclose(operator.run(u, DT)[0], 1.5 * u + 0.3)
    np.testing.assert_allclose(y, 1.5 * u + 0.3)
    np.testing.assert_allclose(dy, np.stack([1.5 * u, u, np.ones_like(u)], axis=1))


@dataclasses.dataclass(frozen=True)
class IntegralLag(LinearOperator):
    """A lag whose state is the integral of the drive, so that its rest moves with the parameter."""

    time_constant: float = parameter(log=True, lower=0.0)
    hold: str = "foh"

    def with_poles(self, rates, pairs):
        return dataclasses.replace(self, time_constant=1.0 / rates[0])

    def _matrices(self, p):
        return np.array([[-1.0 / p[0]]]), np.array([1.0 + 0.0 * p[0]]), 1.0 / p[:1], 0.0 * p[0]


def test_rest_moves_with_the_parameters(u):
    own, upstream = IntegralLag(0.03), np.ones((len(u), 1))
    plain = FirstOrderLagOperator(0.03)
    y, dy = own.sensitivities(u, upstream, DT)
    expected, tangents = plain.sensitivities(u, upstream, DT)
    np.testing.assert_allclose(y, expected, rtol=1e-12)
    np.testing.assert_allclose(dy, tangents[:, :2], rtol=1e-9, atol=1e-9)


def transfer(constants, frequencies, dampings, numerator=(), **options):
    parts = map(np.array, (constants, frequencies, dampings, numerator))
    return TransferFunctionOperator(*parts, **options)


@pytest.mark.parametrize(
    ("operator", "count"),
    [
        (SecondOrderModeOperator(90.0, 0.70), 1),
        (SecondOrderModeOperator(90.0, 0.71), 0),
        (transfer([0.1], [3.0, 5.0, 7.0], [0.1, 0.9, 0.2], [1.0]), 2),
        (
            MultiInputTransferFunctionOperator(
                np.empty(0), np.array([3.0]), np.array([0.1]), np.zeros((2, 0)), np.ones(2)
            ),
            1,
        ),
    ],
)
def test_pairs_that_ring_overshoot(operator, count):
    assert operator.n_ringing() == count


@pytest.mark.parametrize(
    "operator",
    [LAG, SecondOrderModeOperator(5.0, 1.7), transfer([0.3, 0.02], [4.0, 9.0], [1.0, 2.5])],
)
def test_lags_in_a_row_have_the_poles(operator):
    rates = np.sort(operator.lag_rates())
    np.testing.assert_allclose(np.poly(-rates), np.poly(operator.poles()).real, rtol=1e-9)


def test_what_is_no_row_of_lags_has_no_rates():
    # below critical damping but without a peak, a pair counts as two equal lags
    assert SecondOrderModeOperator(5.0, 0.8).lag_rates() == [5.0, 5.0]
    assert SecondOrderModeOperator(5.0, 0.7).lag_rates() == []
    assert transfer([0.1], [3.0, 5.0], [1.1, 0.1]).lag_rates() == []
    assert transfer([0.1], [], [], [0.2]).lag_rates() == []


def test_a_transfer_function_with_one_pair_and_no_zeros_is_a_mode():
    mode = dataclasses.replace(OPERATORS["mode"], hold="zoh")
    assert mode.linear_mode() is mode
    assert transfer([], [90.0], [0.15], gain=0.8, intercept=0.1, hold="zoh").linear_mode() == mode
    for other in (transfer([], [90.0], [0.15], [0.2]), transfer([0.1], [90.0], [0.15])):
        assert other.linear_mode() is None


def test_what_has_no_poles_says_so():
    for operator in (GainOperator(), DelayOperator(0.1)):
        assert operator.n_poles == (0, 0)


# ------------------------------------------------------------------------------------------ delay

WALK = 0.4 + np.cumsum(np.random.default_rng(0).normal(size=50))


@settings(deadline=None, max_examples=30)
@given(delay=st.floats(0.0, 0.2), coefficients=st.lists(st.floats(-1, 1), min_size=4, max_size=4))
def test_shifts_are_exact_for_polynomials_of_third_degree(delay, coefficients):
    time, law = DT * np.arange(60), np.polynomial.Polynomial(coefficients)
    for operator in (DelayOperator(delay), TimeShiftOperator(delay), TimeShiftOperator(-delay)):
        y, _ = operator.run(law(time), DT)
        inner = slice(int(0.2 / DT) + 3, -int(0.2 / DT) - 3)
        np.testing.assert_allclose(y[inner], law(time - operator.pack()[0])[inner], atol=1e-9)


@pytest.mark.parametrize("kind", [DelayOperator, TimeShiftOperator])
def test_shifts_are_of_fourth_order(kind):
    errors = []
    for dt in (0.02, 0.01):
        time = dt * np.arange(round(3.0 / dt))
        y, _ = kind(1.5 * 0.01).run(np.sin(2 * np.pi * time), dt)
        errors.append(np.abs(y - np.sin(2 * np.pi * (time - 0.015)))[10:].max())
    assert errors[0] > 10.0 * errors[1]


@settings(deadline=None, max_examples=30)
@given(delay=st.floats(0.0, 0.7), initial_state=st.sampled_from(["rest", "zero"]))
def test_a_delay_shows_what_was_before_the_record(delay, initial_state):
    operator = DelayOperator(delay)
    before = WALK[0] if initial_state == "rest" else 0.0
    y, _ = operator.run(WALK, DT, operator.init(WALK[0], initial_state))
    earlier = int(delay / DT) - 2  # none of the four samples is of the record
    np.testing.assert_allclose(y[: max(earlier, 0)], before, atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(shift=st.floats(-0.3, 0.3))
def test_a_shift_back_and_forth_changes_nothing(shift):
    u = np.sin(2 * np.pi * DT * np.arange(300))
    there, _ = TimeShiftOperator(shift).run(u, DT)
    back, _ = TimeShiftOperator(-shift).run(there, DT)
    inner = slice(int(0.3 / DT) + 4, -int(0.3 / DT) - 4)
    np.testing.assert_allclose(back[inner], u[inner], atol=1e-4)


@pytest.mark.parametrize("count", [-80, -3, 0, 2])
def test_a_shift_by_whole_samples_is_exact_in_both_directions(count):
    y, _ = TimeShiftOperator(count * 0.25).run(WALK, 0.25)
    at = np.clip(np.arange(len(WALK)) - count, 0, len(WALK) - 1)
    np.testing.assert_array_equal(y, WALK[at])


@settings(deadline=None, max_examples=30)
@given(shift=st.floats(-0.8, 0.8))
def test_a_straight_drive_is_read_between_its_samples_exactly(shift):
    time = 0.25 * np.arange(len(WALK))
    y, _ = TimeShiftOperator(shift, between="line").run(WALK, 0.25)
    np.testing.assert_allclose(y, np.interp(time - shift, time, WALK), rtol=0.0, atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(shift=st.floats(-0.05, 0.05), skew=st.floats(-1e-2, 1e-2))
def test_clocks_that_differ_read_later_and_later(shift, skew):
    time = DT * np.arange(300)
    y, _ = TimeShiftOperator(shift, skew).run(np.sin(2 * np.pi * time), DT)
    inner = slice(12, -12)
    expected = np.sin(2 * np.pi * (time - shift - skew * time))
    np.testing.assert_allclose(y[inner], expected[inner], atol=1e-4)


@pytest.mark.filterwarnings("ignore:The records do not begin at rest")  # they do
def test_the_skew_of_clocks_is_identified():
    time = DT * np.arange(2000)
    drive, y = (np.sin(2 * np.pi * t) + np.sin(5.1 * t) for t in (time, 0.9994 * time - 0.003))
    model = TimeShift(fit_skew=True, dt=DT).fit(drive[:, None], y)
    assert model.operator_.skew == pytest.approx(6e-4, rel=1e-2)
    assert model.operator_.shift == pytest.approx(0.003, rel=2e-2)
    assert TimeShift(dt=DT).fit(drive[:, None], y).operator_.skew == 0.0


@pytest.mark.parametrize("count", [0, 1, 7, 49, 50, 80])
def test_whole_samples_are_an_exact_shift(count):
    y, _ = DelayOperator(count * 0.25).run(WALK, 0.25)
    np.testing.assert_array_equal(y, np.r_[np.full(count, WALK[0]), WALK][: len(WALK)])


def test_state_holds_no_more_than_the_delay():
    _, state = DelayOperator(0.035).run(np.tile(WALK, 100), DT)
    assert np.size(state) <= 5


def test_what_has_no_state_of_rest_begins_at_zero():
    """Two integrators: a fit may come by a mode of no frequency."""
    nowhere = TransferFunctionOperator(np.empty(0), np.zeros(1), np.array([0.3]), np.array([2.0]))
    np.testing.assert_array_equal(nowhere.run(np.ones(5), DT)[0], 0.0)


def test_clocks_go_on_where_a_record_is_cut():
    u, shift = np.random.default_rng(0).normal(size=60), TimeShiftOperator(0.05, skew=0.02)
    whole, _ = shift.run(u, 0.01)
    state, parts = None, []
    for part in (u[:20], u[20:33], u[33:]):
        y, state = shift.run(part, 0.01, state)
        parts.append(y)
    np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-12)


def test_a_slow_lag_that_begins_far_off_is_found():
    """From rest the fit is another lag, which no history before the record mends."""
    time = 5e-3 * np.arange(300)
    u = 20.0 * np.sin(9.0 * time + 6.0 * time**2) + 8.0 * np.sin(14.0 * time + 1.0)
    operator = FirstOrderLagOperator(1.0)
    y = operator.run(u, 5e-3, operator.init(200.0))[0]
    y = y + 0.1 * np.random.default_rng(0).normal(size=300)
    model = FirstOrderLag(dt=5e-3, initial_state="estimate").fit(u[:, None], y)
    assert model.params_["time_constant"] == pytest.approx(1.0, rel=0.02)
    assert model.fit_error_ < 0.12
