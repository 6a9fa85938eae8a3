"""Operators of inputs with several columns are those of one signal, column by column."""

import numpy as np
import pytest

from skhyst.compose import ColumnOperator, ModulatedOperator, ScheduledOperator
from skhyst.hysteresis import PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, GainOperator
from skhyst.operators import SumOperator, check_operator

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


def test_derivatives_and_pieces(operator, u):
    check_operator(operator, u, DT)


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
