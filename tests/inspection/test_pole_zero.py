"""Poles and zeros: what is stored, and that it is drawn where it belongs."""

import numpy as np
import pytest
from matplotlib import pyplot
from scipy.signal import ZerosPolesGain
from scipy.stats import chi2

from skhyst.inspection import PoleZeroDisplay
from skhyst.linear import FirstOrderLag, TransferFunction


@pytest.fixture(scope="module")
def model():
    system = ZerosPolesGain([-30.0], [-20.0, -3.0 + 60.0j, -3.0 - 60.0j], 100.0)
    truth = TransferFunction.from_system(system, dt=0.01)
    rng = np.random.default_rng(0)
    u = rng.normal(size=(400, 1))
    y = truth.predict(u)
    return TransferFunction(3, n_zeros=1, dt=0.01).fit(u, y + 0.05 * y.std() * rng.normal(size=400))


def marks(ax, marker):
    lines = [line for line in ax.lines if line.get_marker() == marker and len(line.get_xdata())]
    return np.concatenate([line.get_xdata() + 1j * line.get_ydata() for line in lines])


def test_poles_and_zeros_stand_where_they_are(model):
    display = PoleZeroDisplay.from_estimator(model)
    upper = model.poles_[model.poles_.imag >= 0.0] / (2.0 * np.pi)
    np.testing.assert_allclose(marks(display.ax_, "x"), upper)
    np.testing.assert_allclose(marks(display.ax_, "o"), model.zeros_ / (2.0 * np.pi))
    assert display.figure_ is display.ax_.figure


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_ellipses_have_their_level(model, level):
    ax = PoleZeroDisplay.from_estimator(model).plot(level=level).ax_
    which = np.argmax(model.poles_.imag)
    pole, covariance = model.poles_[which], model.poles_covariance_[which]
    edge = next(
        line
        for line in ax.lines
        if len(line.get_xdata()) > 100
        and np.mean(line.get_ydata()[:-1]) == pytest.approx(pole.imag / (2.0 * np.pi))
    )
    offset = 2.0 * np.pi * np.stack([edge.get_xdata(), edge.get_ydata()])
    offset -= np.array([[pole.real], [pole.imag]])
    distance = np.sum(offset * np.linalg.solve(covariance, offset), axis=0)
    np.testing.assert_allclose(distance, chi2.ppf(level, 2), rtol=1e-6)


def test_rays_have_one_damping_ratio(model):
    ax = PoleZeroDisplay.from_estimator(model).ax_
    rays = [line for line in ax.lines if line.get_linestyle() == ":"]
    assert rays
    labels = [float(text.get_text().removeprefix("ζ ")) for text in ax.texts]
    for ray, zeta in zip(rays, labels, strict=True):
        s = (ray.get_xdata() + 1j * ray.get_ydata())[1:]
        np.testing.assert_allclose(-s.real / np.abs(s), zeta)


def test_several_models_inputs_and_scales(model):
    system = ZerosPolesGain([], [-2000.0, -1.0 + 60.0j, -1.0 - 60.0j], 1.0)
    other = TransferFunction.from_system(system, dt=0.01)
    display = PoleZeroDisplay.from_estimator({"fitted": model, "known": other})
    texts = [text.get_text() for text in display.ax_.get_legend().get_texts()]
    assert texts == ["fitted", "known", "poles", "zeros"]
    assert display.ax_.get_xscale() == "symlog"
    assert display.plot(real_scale="linear").ax_.get_xscale() == "linear"
    near = display.plot(max_frequency=12.0).ax_
    assert np.abs(marks(near, "x")).max() < 12.0
    _, ax = pyplot.subplots()
    assert display.plot(ax).ax_ is ax


def test_refusals(model):
    lag = FirstOrderLag(dt=0.01).fit(np.arange(50.0)[:, None] % 7, np.arange(50.0) % 5)
    with pytest.raises(TypeError, match="needs models with poles"):
        PoleZeroDisplay.from_estimator(lag)
    with pytest.raises(ValueError, match="'real_scale' parameter"):
        PoleZeroDisplay.from_estimator(model, real_scale="log")
