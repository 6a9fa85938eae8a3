"""Tanks: their law against an independent integration, their balance, and what a fit finds."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from skhyst.fluid import TankChain, TankChainOperator
from skhyst.linear import FirstOrderLagOperator

DT = 2.0


def waves(n=400, seed=0):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(n)
    return 1.2 + sum(
        0.3 * np.sin(2 * np.pi * f * time + rng.uniform(0, 6)) for f in (0.0011, 0.0023, 0.0071)
    )


def plant(u, start, *, tau, p, offset=0.1, ceiling=np.inf, share=0.0):
    """Integrate two tanks without skhyst; the first may overflow into the second."""
    time = DT * np.arange(len(u))

    def flow(t, w):
        q = max(np.interp(t, time, u) - offset, 0.0)
        out = np.maximum(w, 0.0) ** p
        first, over = (q - out[0]) / tau[0], 0.0
        if w[0] >= ceiling and first > 0.0:
            first, over = 0.0, q - out[0]
        return [first, (out[0] + share * over - out[1]) / tau[1]]

    found = solve_ivp(
        flow, time[[0, -1]], start, t_eval=time, rtol=1e-7, atol=1e-9, max_step=DT / 2
    )
    return found.y[1]


@pytest.mark.parametrize("p", [0.5, 1.0, 1.7])
def test_law_by_independent_integration(p):
    u = waves()
    operator = TankChainOperator([40.0, 25.0], [p, p], drive_offset=0.1)
    expected = plant(u, operator.init(u[0])[:2], tau=(40.0, 25.0), p=np.array([p, p]))
    for n, most in {1: 2e-3, 8: 2e-4}.items():
        y, _ = dataclasses.replace(operator, n_substeps=n).run(u, DT)
        assert np.abs(y - expected).max() < most


def test_overflow_by_independent_integration():
    u = waves()
    operator = TankChainOperator(
        [40.0, 25.0], [0.5, 0.5], [1.4, 50.0], [0.6], drive_offset=0.1, n_substeps=16
    )
    options = {"tau": (40.0, 25.0), "p": 0.5, "ceiling": 1.4, "share": 0.6}
    expected = plant(u, operator.init(u[0])[:2], **options)
    y, _ = operator.run(u, DT)
    assert np.abs(y - expected).max() < 0.02 * np.ptp(expected)
    free = dataclasses.replace(operator, ceilings=None, shares=None).run(u, DT)[0]
    assert np.abs(free - expected).max() > 0.1 * np.ptp(expected)


def test_second_order_in_the_substep():
    u = waves()
    base = TankChainOperator([20.0, 12.0], [0.5, 0.6])
    fine = dataclasses.replace(base, n_substeps=256).run(u, DT)[0]
    errors = [
        np.abs(dataclasses.replace(base, n_substeps=n).run(u, DT)[0] - fine).max()
        for n in (2, 4, 8)
    ]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders.min() > 1.8


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_power_one_is_a_lag(hold):
    u = waves()
    tank = TankChainOperator([30.0], [1.0], drive_offset=-5.0, hold=hold, n_substeps=64)
    lag = FirstOrderLagOperator(30.0, hold=hold).run(u + 5.0, DT)[0]
    np.testing.assert_allclose(tank.run(u, DT)[0], lag, atol=1e-4)


def test_nothing_is_lost():
    rng = np.random.default_rng(1)
    u = np.maximum(rng.normal(0.6, 1.0, 300), 0.0)
    tank = TankChainOperator([7.0, 1e12], [0.5, 1.0], [0.9, 1e300], [1.0], hold="zoh")
    _, state = tank.run(u, DT, (0.4, 0.0, u[0]))
    # the second tank hardly empties: it holds all that has come in and is not in the first
    inflow = DT * (u[0] + u[:-1].sum())
    assert 7.0 * (state[0] - 0.4) + 1e12 * state[1] == pytest.approx(inflow, rel=1e-3)
    assert 0.0 <= state[0] <= 0.9


@pytest.mark.parametrize("size", [0.0, 1e-30, 1e30])
@pytest.mark.parametrize("p", [0.2, 5.0])
def test_finite_for_any_drive(size, p):
    u = size * np.array([0.0, 1.0, -1.0, 1.0, 0.0])
    operator = TankChainOperator([1e-3, 1e3], [p, 0.5], [2.0, 3.0], [0.5])
    y, dy = operator.sensitivities(u, np.empty((5, 0)), DT)
    assert np.isfinite(y).all()
    assert np.isfinite(dy).all()


def test_sizes_are_checked():
    with pytest.raises(ValueError, match="'shares' parameter of TankChainOperator must have 1"):
        TankChainOperator([1.0, 2.0], [0.5, 0.5], [1.0, 1.0], [0.1, 0.2])
    with pytest.raises(ValueError, match="'n_substeps'"):
        TankChainOperator([1.0], [0.5], n_substeps=0)


@pytest.mark.filterwarnings("ignore:The data do not determine")  # the second tank is never full
@pytest.mark.parametrize("unit", [1.0, 1e6])
def test_fit_finds_the_plant(unit):
    u = waves(600)
    clean = 3.0 + 2.0 * plant(
        u, [1.0, 1.0], tau=(40.0, 25.0), p=0.5, offset=0.3, ceiling=1.2, share=0.6
    )
    y = clean + 1e-3 * np.random.default_rng(0).normal(size=len(u))
    model = TankChain(overflow=True, initial_state="estimate", dt=DT).fit(
        unit * u.reshape(-1, 1), y / unit
    )
    assert model.fit_error_ * unit < 0.02 * np.ptp(clean)
    found = model.operator_
    assert found.drive_offset / unit == pytest.approx(0.3, abs=0.15)
    level = found.ceilings[0] * (found.scale / unit) ** 2  # of the unit flow
    assert level == pytest.approx(1.2, rel=0.2)
    assert 0.3 < found.shares[0] < 0.9


def test_another_scale_is_another_unit():
    """But for the level below which the outflow is laminar, far below these."""
    u = waves()
    ends = {"drive_offset": -20.0, "scale": 2.0, "gain": 2.0}
    tank = TankChainOperator([40.0, 25.0], [0.5, 0.7], [112.0, 30.0], [0.4], **ends)
    other = tank.with_scale(3.0)
    assert other.scale == 3.0
    found, expected = other.run(u, DT)[0], tank.run(u, DT)[0]
    assert np.ptp(expected) > 0.5
    np.testing.assert_allclose(found, expected, rtol=1e-6)
