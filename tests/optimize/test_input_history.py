"""What came before a record: found where a record shows it, at rest where it does not."""

from dataclasses import replace

import numpy as np
import pytest

from skhyst.disturbance import OffsetOperator
from skhyst.hysteresis import (
    BoucWenOperator,
    PrandtlIshlinskiiOperator,
    RestoringForceOperator,
)
from skhyst.linear import (
    FirstOrderLagOperator,
    GainOperator,
    KelvinVoigtOperator,
    MultiInputTransferFunctionOperator,
    TransferFunctionOperator,
)
from skhyst.linear import SecondOrderModeOperator as Mode
from skhyst.operators import OnColumnOperator, Scaled, Series, SumOperator
from skhyst.optimize import (
    OperatorProblem,
    RecordData,
    ages,
    estimate_input_history,
    identify,
    input_history_of,
)
from skhyst.optimize._problem import path_of

DT, CUT, N = 0.02, 700, 600
PLAYS = PrandtlIshlinskiiOperator(np.array([0.0, 0.5, 1.0]), np.array([1.0, 0.5, 0.4]), 0.2)
DEVICES = {
    "plays": PLAYS,
    "bouc_wen": BoucWenOperator(0.4, 1.0, 0.3, 0.5),
    "lag": FirstOrderLagOperator(0.7),
    "creep": KelvinVoigtOperator(np.array([0.2, 0.3]), np.array([0.5, 4.0])),
    "mode": Mode(9.0, 0.05),
    "spring": RestoringForceOperator(9.0, 0.6, [0.3], [], 0.0, 0.5),
    "plays_and_mode": Series(("plays", "mode"), (PLAYS, Mode(9.0, 0.05))).normalized(),
}
_LAG = FirstOrderLagOperator(0.7)
_POLES = (np.array([0.5]), np.array([9.0]), np.array([0.1]))
DEVICES |= {
    "two_inputs": SumOperator(
        ("plays", "lag"), (OnColumnOperator(PLAYS, 0), OnColumnOperator(_LAG, 1))
    ),
    "scaled": Scaled(OnColumnOperator(PLAYS, 0), 1, sensitivity=0.2, lag=_LAG, reference=0.0),
    "transfer_function": MultiInputTransferFunctionOperator(
        *_POLES, np.array([[0.3], [0.0]]), np.array([1.0, -2.0]), np.array([0.03, 0.1])
    ),
}


def drive(seed, n=CUT + N):
    time, rng = np.arange(n) * DT, np.random.default_rng(seed)
    waves = [np.sin(rng.uniform(0.5, 4.0) * time + rng.uniform(0, 6)) for _ in range(4)]
    return np.sum(waves, axis=0)


def cut(device, seed, noise=0.0):
    """Return a record whose first part is not kept."""
    u = drive(seed)
    if device.reads_columns:
        u = np.stack([u, drive(seed + 100)], axis=1)
    y = device.run(u, DT)[0] + noise * np.random.default_rng([seed, 1]).normal(size=len(u))
    return RecordData(u[CUT:], y[CUT:], DT)


def errors(device, record, before):
    """Return the errors of a record from rest, and with what came before it."""
    found = []
    for u, skip in ((record.u, 0), (np.concatenate([path_of(before), record.u]), 2 ** len(before))):
        y = device.run(u, DT, device.init(u[0]))[0][skip // 2 :]
        found.append(np.sqrt(np.mean((y - record.y) ** 2)) / np.ptp(record.y))
    return found


@pytest.mark.parametrize("name", DEVICES)
def test_a_record_tells_how_it_began(name):
    device = DEVICES[name]
    records = [cut(device, seed) for seed in range(3)]
    input_history, runs = input_history_of(device, (), records)
    # up to 256 samples before: half of a record, or less
    assert input_history.shape == (3, 9, *records[0].u.shape[1:])
    assert runs > 0
    for record, before in zip(records, input_history, strict=True):
        rest, known = errors(device, record, before)
        assert known < max(0.1 * rest, 2e-3)


@pytest.mark.parametrize("name", [*DEVICES, "bandlimited", "integrator"])
def test_a_history_is_part_of_the_drive(name):
    """Of its rest only a part is simulated, without a difference; an integrator has none."""
    more = {
        "bandlimited": replace(DEVICES["spring"], hold="bandlimited"),
        "integrator": TransferFunctionOperator([], [9.0], [0.1], [2.0], integrators=1),
    }
    device = (DEVICES | more)[name]
    u = drive(0, N)
    before = np.full(9, u[0])
    before[:5] = u[:5] + 1.0
    if device.reads_columns:
        u, before = np.stack([u, u[::-1]], axis=1), np.stack([before, before[::-1]], axis=1)
    path, y = path_of(before), np.sin(np.arange(N))
    scored = (len(path), len(path) + N)
    whole = np.concatenate([path, u]), np.concatenate([np.zeros(len(path)), y])
    records = RecordData(u, y, DT, before=before), RecordData(*whole, DT, segments=(scored,))
    problems = [OperatorProblem(device, [record]) for record in records]
    own, expected = (problem.evaluate(problem.x0)[0] for problem in problems)
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(own, expected, rtol=0.0, atol=1e-10 * np.outer(size, size).max())
    outputs = [
        problem.simulate(device, record) for problem, record in zip(problems, records, strict=True)
    ]
    np.testing.assert_allclose(outputs[0], outputs[1][len(path) :], rtol=1e-9, atol=1e-10)


def test_what_begins_at_rest_stays_there():
    u = drive(0)
    noise = 1e-3 * np.random.default_rng(0).normal(size=len(u))
    record = RecordData(u, PLAYS.run(u, DT)[0] + noise, DT)
    input_history, _ = input_history_of(PLAYS, (), [record])
    np.testing.assert_allclose(input_history, u[0], atol=0.05)


def test_of_what_has_faded_nothing_is_sought():
    """The last value changes a spring's drive from 2.6 s before on, which is 14 decay times."""
    device = DEVICES["spring"]
    record = cut(device, 0, noise=1e-3)
    input_history, _ = input_history_of(device, (), [record])
    moved = input_history[0] != record.u[0]
    assert moved.any()
    assert not moved[-1]


def test_a_linear_device_is_run_once():
    record = cut(DEVICES["mode"], 0)
    input_history, runs = input_history_of(DEVICES["mode"], (), [record])
    assert runs == 1
    assert errors(DEVICES["mode"], record, input_history[0])[1] < 1e-3


def test_a_linear_device_may_begin_beyond_the_reach_of_the_drive():
    u = drive(0, N)
    y = _LAG.run(u, DT, _LAG.init(100.0))[0]  # the drive is within 4
    input_history, _ = input_history_of(_LAG, (), [RecordData(u, y, DT)])
    assert errors(_LAG, RecordData(u, y, DT), input_history[0])[1] < 1e-3


def test_a_device_without_memory_tells_nothing():
    record = cut(GainOperator(2.0), 0, noise=0.1)
    input_history, _ = input_history_of(GainOperator(2.0), (), [record])
    np.testing.assert_allclose(input_history, record.u[0], atol=1e-6)


def test_parameters_are_identified_with_it():
    records = [cut(PLAYS, seed, noise=1e-3) for seed in range(3)]
    start = PLAYS.unpack(np.zeros(5))
    plain = identify([(start, ())], records, fixed=("drive_offset",))
    result, before = estimate_input_history(plain.operator, (), records, fixed=("drive_offset",))
    assert result.error < 1.1e-3 < plain.error
    assert result.n_evaluations > 50
    np.testing.assert_allclose(result.operator.weights, PLAYS.weights, rtol=0.01)
    assert max(errors(PLAYS, r, b)[1] for r, b in zip(records, before, strict=True)) < 1e-3


def test_units_change_nothing():
    record = cut(PLAYS, 1, noise=1e-3)
    tiny = PrandtlIshlinskiiOperator(1e-9 * PLAYS.thresholds, 1e-6 * PLAYS.weights, 2e-16)
    other = RecordData(1e-9 * record.u, 1e-15 * record.y, DT)
    first, _ = input_history_of(PLAYS, (), [record])
    second, _ = input_history_of(tiny, (), [other])
    reached = errors(PLAYS, record, first[0])[1], errors(tiny, other, second[0])[1]
    np.testing.assert_allclose(*reached, rtol=0.01)


def test_what_stands_beside_is_no_history():
    """A record's own constant is taken out before it is asked how the record began."""
    record = cut(PLAYS, 2)
    shifted = RecordData(record.u, record.y + 5.0, DT)
    additive = (OffsetOperator(np.zeros(1)),)
    for own in (record, shifted):
        input_history, _ = input_history_of(PLAYS, additive, [own])
        assert errors(PLAYS, record, input_history[0])[1] < 1e-3


def test_samples_that_do_not_count_tell_nothing():
    record = cut(DEVICES["lag"], 3)
    y, weights = record.y.copy(), np.ones(N)
    y[5:20], weights[5:20] = 1e3, 0.0
    first, _ = input_history_of(DEVICES["lag"], (), [RecordData(record.u, y, DT, weights=weights)])
    assert errors(DEVICES["lag"], record, first[0])[1] < 1e-3


@pytest.mark.parametrize("name", DEVICES)
def test_the_derivatives_are_those_of_the_output(name):
    device, step = DEVICES[name], 1e-6
    record = cut(device, 0)
    changes = np.array([0.3, -0.6, 0.9, -1.2, 1.5, -1.8])
    if device.reads_columns:
        changes = np.stack([changes, 0.5 * changes[::-1]], axis=1)
    before = record.u[0] + changes
    problem = OperatorProblem(device, [replace(record, before=before)])

    def output(values):
        return problem.simulate(device, replace(record, before=values))

    moves = step * np.eye(before.size).reshape(-1, *before.shape)
    ends = [[output(before + way) for way in (move, -move)] for move in moves]
    expected = np.stack([(a - b) / (2.0 * step) for a, b in ends], axis=1)
    found = problem.history_sensitivities(device, problem.records[0])
    np.testing.assert_allclose(found, expected, atol=1e-6 * max(np.abs(expected).max(), 1.0))
    assert np.abs(expected).max() > 1e-3


def test_the_path_is_straight_between_its_values():
    assert ages([1.0, 2.0, 4.0]).tolist() == [1, 2, 4]
    assert path_of([1.0, 2.0, 4.0]).tolist() == [4.0, 3.0, 2.0, 1.0]
    assert path_of(0.5).tolist() == [0.5]


def test_records_may_differ_in_length():
    """The values reach up to half of the longest, which is beyond the shortest."""
    whole = cut(PLAYS, 1)
    short = RecordData(whole.u[:40], whole.y[:40], DT)
    input_history, _ = input_history_of(PLAYS, (), [whole, short])
    for record, before in zip([whole, short], input_history, strict=True):
        assert errors(PLAYS, record, before)[1] < 2e-3


def test_fewer_samples_than_values_tell_the_start():
    """One sample of a lag is its state; the other record asks for nine values before each."""
    device = DEVICES["lag"]
    whole, other = (cut(device, seed) for seed in (1, 2))
    known = replace(other, weights=(np.arange(N) < 1).astype(float))
    _, before = input_history_of(device, (), [whole, known])[0]
    rest, told = errors(device, other, before)
    assert told < 0.2 * rest
