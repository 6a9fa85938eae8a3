"""Kind label: what could as well be exchanged is in one order, and units follow from the data."""

import numpy as np
import pytest

from skhyst.compose import Cascade, Sum
from skhyst.disturbance import PeriodicDisturbance
from skhyst.fluid import TankChain, TankChainOperator
from skhyst.linear import (
    KelvinVoigt,
    KelvinVoigtOperator,
    MultiInputTransferFunctionOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)

DT = 0.005
MODES = ((60.0, 0.05), (150.0, 0.02))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("order", [MODES, MODES[::-1]])
def test_modes_by_frequency(seed, order):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=600)
    first, second = (SecondOrderModeOperator(*mode) for mode in order)
    both = TransferFunctionOperator(np.empty(0), *np.array(order).T, np.empty(0))
    steps = [("a", SecondOrderMode()), ("b", SecondOrderMode())]
    for model, y in (
        (TransferFunction(4, n_zeros=0, dt=DT), both.run(u, DT)[0]),
        (Cascade(steps, dt=DT), second.run(first.run(u, DT)[0], DT)[0]),
        (Sum(steps, dt=DT), first.run(u, DT)[0] + second.run(u, DT)[0]),
    ):
        noise = 0.01 * y.std() * rng.normal(size=600)
        model.fit(u[:, None], y + noise)
        found = [value for key, value in model.params_.items() if "natural_frequenc" in key]
        np.testing.assert_allclose(found, [60.0, 150.0], rtol=0.02)
        assert model.fit_error_ <= np.sqrt(np.mean(noise**2))


@pytest.mark.parametrize("strong", [50.0, 17.0])
def test_lines_by_frequency(strong):
    """Whichever is the stronger one."""
    time = DT * np.arange(600)
    y = sum((3.0 if f == strong else 1.0) * np.sin(2.0 * np.pi * f * time) for f in (17.0, 50.0))
    model = PeriodicDisturbance(2, dt=DT).fit(np.zeros((600, 1)), y)
    found = [model.params_[key] for key in sorted(model.params_) if "frequencies" in key]
    np.testing.assert_allclose(found, [17.0, 50.0], rtol=1e-6)


def test_the_order_of_modes_changes_no_response():
    poles = np.array([0.1]), np.array([150.0, 60.0]), np.array([0.1, 0.05])
    single = TransferFunctionOperator(*poles, np.array([0.3, -0.1, 0.2]), 2.0)
    numerators = np.array([[0.3, 0.1], [0.2, -0.2]])
    several = MultiInputTransferFunctionOperator(*poles, numerators, np.array([1.0, 2.0]))
    frequency = np.geomspace(0.1, 100.0, 40)
    for operator in (single, several):
        ordered = operator.in_order()
        np.testing.assert_array_equal(ordered.natural_frequencies, [60.0, 150.0])
        np.testing.assert_array_equal(ordered.damping_ratios, [0.05, 0.1])
        expected = operator.frequency_response(frequency)
        np.testing.assert_allclose(ordered.frequency_response(frequency), expected, rtol=1e-9)
        assert ordered.in_order() is ordered


def test_creep_by_time_constant():
    units = KelvinVoigtOperator(np.array([0.2, 0.3]), np.array([0.5, 0.05]))
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 10), 100)
    y, _ = units.run(u, 0.01)
    model = KelvinVoigt(2, dt=0.01).fit(u[:, None], y)
    np.testing.assert_allclose(model.operator_.time_constants, [0.05, 0.5], rtol=1e-6)
    np.testing.assert_allclose(units.in_order().run(u, 0.01)[0], y, atol=1e-12)


def test_tanks_are_in_the_scale_of_the_drive():
    """The same tanks in other units of the scale: the fit gives the constants of its own."""
    rng = np.random.default_rng(0)
    u = 2.0 + np.convolve(rng.uniform(-1.0, 1.0, 900), np.ones(20) / 5.0, mode="same")
    scale = u.mean() - u.min()
    offset = u.min() - 0.5 * scale  # no tank runs empty
    for factor in (1.0, 4.0):  # sqrt(w) outflows: a scale f times larger, constants f times longer
        taus = factor * np.array([3.0, 8.0])
        plant = TankChainOperator(
            taus, [0.5, 0.5], drive_offset=offset, gain=factor**2, scale=factor * scale
        )
        y, _ = plant.run(u, 1.0)
        model = TankChain(dt=1.0).fit(u[:, None], y)
        assert model.operator_.scale == pytest.approx(scale)
        found = model.operator_.time_constants
        np.testing.assert_allclose(np.sort(found), [3.0, 8.0], rtol=0.02)
