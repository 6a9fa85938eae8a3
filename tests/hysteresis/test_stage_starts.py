"""Starting values of the stages: few, and one of them nearly right, one nearly linear."""

import numpy as np
import pytest

from skhyst.hysteresis import (
    BoucWenStage,
    BoucWenStageOperator,
    FrictionStage,
    FrictionStageOperator,
    RestoringForce,
    RestoringForceOperator,
)
from skhyst.linear import SecondOrderModeOperator
from skhyst.optimize import RecordData

DT, N = 1e-3, 4000
W, ZETA = 150.0, 0.1
CASES = {
    "friction": (FrictionStageOperator(W, ZETA, 0.2, 0.7, 20.0, 10.0, 0.05), FrictionStage()),
    "Bouc-Wen": (BoucWenStageOperator(W, ZETA, 1.0, 0.1, 0.3), BoucWenStage()),
    "bilinear": (
        RestoringForceOperator(W, ZETA, [], [], 2.0, 0.1),
        RestoringForce(1, damping_degree=1),
    ),
    "Duffing": (
        RestoringForceOperator(W, ZETA, [1.5], [], 0.0, 0.0, 0.1),
        RestoringForce(3, damping_degree=1, fit_hysteresis=False),
    ),
    "Duffing, degree 5": (
        RestoringForceOperator(W, ZETA, [0.5, 1.0], [0.5], 0.0, 0.0),
        RestoringForce(5, damping_degree=3, fit_hysteresis=False),
    ),
}


def records(operator, n_records, n):
    rng = np.random.default_rng(0)
    time, found = DT * np.arange(n), []
    for amplitude in np.linspace(0.4, 1.0, n_records):
        u = sum(
            np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.28))
            for f in np.geomspace(0.5, 40, 16)
        )
        u -= u[0]
        u *= amplitude / np.abs(u).max()
        y, _ = operator.run(u, DT)
        found.append(RecordData(u, 2.0 * y + 0.3 + 0.002 * rng.normal(size=n), DT))
    return found


def errors(operators, data):
    """Return the root mean squares of the free runs, parts of the response's deviation."""
    found = []
    for operator in operators:
        rest = np.concatenate([operator.run(r.u, r.dt)[0] - r.y for r in data])
        found.append(np.std(rest) / np.std(np.concatenate([r.y for r in data])))
    return np.array(found)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("n", [N, 25_000])
def test_starts(case, n):
    """Also where only a part of the records is looked at."""
    plant, model = CASES[case]
    data = records(plant, 2, n)
    starts = model.starting_values(data)
    assert 1 < len(starts) <= 12
    assert all(disturbances == () for _, disturbances in starts)
    operators = [operator for operator, _ in starts]
    found = errors(operators, data)
    linear = min(
        errors(
            [SecondOrderModeOperator(o.natural_frequency, o.damping_ratio, o.gain, o.intercept)],
            data,
        )[0]
        for o in operators
    )
    assert found.min() < 0.7 * linear
    # one of them hardly differs from its linear part
    gaps = [
        np.std(
            o.run(r.u, DT)[0]
            - SecondOrderModeOperator(*o.pack()[:2], o.gain, o.intercept).run(r.u, DT)[0]
        )
        for o in operators
        for r in data[-1:]
    ]
    assert min(gaps) < 0.05 * np.std(data[-1].y)
