"""Operators of inputs with several columns are those of one signal, column by column."""

import numpy as np
import pytest

from skhyst.compose import ColumnOperator, ModulatedOperator, ScheduledOperator
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, GainOperator
from skhyst.operators import SumOperator

DT, N = 0.01, 80
LAG = FirstOrderLagOperator(0.05, gain=1.2)
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [0.6, 0.4])
OPERATORS = {
    "column": ColumnOperator(LAG, 1),
    "modulated": ModulatedOperator(ColumnOperator(PLAYS, 0), 2, 0.4, 0.3),
    "modulated twice": ModulatedOperator(
        ModulatedOperator(ColumnOperator(PLAYS, 0), 2, 0.4, 0.3), 1, -0.1, 0.2
    ),
    "sum": SumOperator(
        ("model", "load"),
        (
            ModulatedOperator(ColumnOperator(LAG, 0), -1, 0.1, -0.2),
            ColumnOperator(GainOperator(0.7), 1),
        ),
    ),
}


@pytest.fixture(params=OPERATORS)
def operator(request):
    return OPERATORS[request.param]


@pytest.fixture
def u():
    return np.cumsum(np.random.default_rng(0).normal(size=(N, 3)), axis=0) / 5


def test_a_column_drives_the_operator(u):
    expected, _ = LAG.run(u[:, 1], DT, LAG.init(u[0, 1]))
    found = ColumnOperator(LAG, 1)
    np.testing.assert_array_equal(found.run(u, DT, found.init(u[0]))[0], expected)


def test_modulation_scales_the_output(u):
    expected = PLAYS.run(u[:, 0], DT)[0] * (1.0 + 0.3 * (u[:, 2] - 0.4))
    found = OPERATORS["modulated"]
    np.testing.assert_allclose(found.run(u, DT, found.init(u[0]))[0], expected, rtol=1e-14)


def test_cut_and_stepped(operator, u):
    whole, _ = operator.run(u, DT, operator.init(u[0]))
    first, state = operator.run(u[:31], DT, operator.init(u[0]))
    rest, _ = operator.run(u[31:], DT, state)
    np.testing.assert_allclose(np.concatenate([first, rest]), whole, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_tangents_are_differences(operator, u, initial_state):
    y, dy = operator.linearize(u, np.empty((N, 0)), DT, initial_state)
    np.testing.assert_allclose(y, operator.run(u, DT, operator.init(u[0], initial_state))[0])
    x = operator.pack()
    assert dy.shape == (N, x.size)
    for i, value in enumerate(x):
        h = 1e-6 * max(abs(value), 1.0)
        sides = []
        for sign in (1.0, -1.0):
            moved = operator.unpack(x + sign * h * (np.arange(x.size) == i))
            sides.append(moved.run(u, DT, moved.init(u[0], initial_state))[0])
        np.testing.assert_allclose(dy[:, i], (sides[0] - sides[1]) / (2 * h), atol=1e-7)


def test_a_scheduled_operator_within_takes_the_number_of_the_record(u):
    scheduled = ScheduledOperator.constant(LAG, (1, 0, 0), 1.0, 3.0)
    x = scheduled.pack()
    x[:2] = 0.05, 0.15
    inside = SumOperator(
        ("model", "load"),
        (ColumnOperator(scheduled.unpack(x), 0), ColumnOperator(GainOperator(0.0), 1)),
    )
    own = inside.at(2.0)
    expected = FirstOrderLagOperator(0.1, gain=1.2).run(u[:, 0], DT)[0]
    np.testing.assert_allclose(own.run(u, DT, own.init(u[0]))[0], expected, rtol=1e-12)
