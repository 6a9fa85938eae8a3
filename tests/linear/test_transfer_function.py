"""Transfer functions: several inputs, frequency responses, orders, standard errors, conversion."""

import dataclasses
import sys

import numpy as np
import pandas as pd
import pytest
from scipy import signal
from scipy.linalg import block_diag

from skhyst.compose import Cascade, Sum
from skhyst.disturbance import Drift
from skhyst.exceptions import ConvergenceWarning, DivergenceWarning
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import (
    FirstOrderLagOperator,
    FrequencyResponse,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
    frequency_response,
)

DT = 0.01
LINES = np.linspace(0.1, 45.0, 150)


def plant(n_poles, seed):
    """Return a sum of modes as a state space: well apart, comparable gains."""
    rng = np.random.default_rng(seed)
    modes = []
    if n_poles % 2:
        rate = rng.uniform(3.0, 8.0)
        modes.append(([rng.uniform(0.5, 1.5) * rate], [1.0, rate]))
    for w in np.geomspace(20.0, 120.0, n_poles // 2) * rng.uniform(0.9, 1.1, n_poles // 2):
        zeta = rng.uniform(0.02, 0.2)
        modes.append(([rng.uniform(0.5, 1.5) * w**2], [1.0, 2.0 * zeta * w, w**2]))
    blocks = [signal.tf2ss(*mode) for mode in modes]
    a = block_diag(*(block[0] for block in blocks))
    b = np.concatenate([block[1] for block in blocks])
    c = np.concatenate([block[2] for block in blocks], axis=1)
    return signal.StateSpace(a, b, c, np.zeros((1, 1)))


def recording(system, seed, *, n=1200, noise=0.02):
    """Return drive and noisy response, from rest at the drive's first value, by scipy."""
    rng = np.random.default_rng(1000 + seed)
    u = rng.normal(size=(n, system.inputs))
    rest = np.linalg.solve(system.A, -system.B @ u[0])
    _, y, _ = signal.lsim(system, u, DT * np.arange(n), X0=rest)
    return u, y + noise * y.std() * rng.normal(size=n)


def response_of(system, seed, *, noise=0.02):
    rng = np.random.default_rng(2000 + seed)
    s = 2j * np.pi * LINES[:, None, None]
    x = np.linalg.solve(s * np.eye(len(system.A)) - system.A, system.B + 0.0 * s)
    g = (system.C @ x)[:, 0]
    std = noise * np.mean(np.abs(g)) * (0.5 + np.arange(len(LINES))[:, None] / len(LINES))
    std = np.broadcast_to(std, g.shape)
    error = rng.normal(size=g.shape) + 1j * rng.normal(size=g.shape)
    names = [f"u{i}" for i in range(g.shape[1])]
    return FrequencyResponse(LINES, g + std * error / np.sqrt(2.0), std, input_names=names)


def assert_poles(found, system, rtol):
    expected = np.sort_complex(np.linalg.eigvals(system.A).astype(complex))
    np.testing.assert_allclose(np.sort_complex(found), expected, rtol=rtol)


# ------------------------------------------------------------------------------------------ order


@pytest.mark.parametrize("n_poles", [1, 2, 3, 4, 5, 6])
def test_order_is_found_in_a_frequency_response(n_poles):
    model = TransferFunction("auto", n_zeros=None, max_poles=n_poles + 1, dt=DT)
    model.fit_frequency_response(response_of(plant(n_poles, 0), 0))
    assert model.n_states_ == n_poles
    # the residual is noise of the standard deviation that is given
    assert model.fit_error_ * np.sqrt(2.0) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("n_poles", [1, 3])
def test_order_is_found_in_a_record(n_poles):
    u, y = recording(plant(n_poles, 0), 0)
    model = TransferFunction("auto", n_zeros=None, max_poles=n_poles + 1, dt=DT).fit(u, y)
    assert model.n_states_ == n_poles
    assert_poles(model.poles_, plant(n_poles, 0), rtol=0.05)


def test_order_of_exact_data_and_of_given_zeros():
    u, y = recording(plant(2, 1), 1, noise=0.0, n=400)
    assert TransferFunction("auto", n_zeros=None, max_poles=4, dt=DT).fit(u, y).n_states_ == 2
    model = TransferFunction(3, n_zeros=None, dt=DT).fit(*recording(plant(3, 1), 1))
    assert len(model.zeros_) == 2
    with pytest.raises(ValueError, match="'n_zeros' parameter of TransferFunction"):
        TransferFunction("auto", n_zeros=4, max_poles=3).fit(u, y)


# --------------------------------------------------------------------------------- standard errors


def from_response(truth, seed):
    model = TransferFunction(3, n_zeros=2, dt=DT)
    return model.fit_frequency_response(response_of(truth, seed))


def from_record(truth, seed):
    u, y = recording(truth, seed, n=250, noise=0.1)
    return TransferFunction(3, n_zeros=2, dt=DT).fit(u, y)


@pytest.mark.slow
@pytest.mark.parametrize(("fit", "n_seeds"), [(from_response, 60), (from_record, 24)])
def test_coverage_of_intervals(fit, n_seeds):
    """Of 95 % intervals of frequency and damping, as many hold the truth."""
    truth, inside = plant(3, 5), []
    poles = np.linalg.eigvals(truth.A)
    pair, real = next(p for p in poles if p.imag > 0.0), next(p for p in poles if p.imag == 0.0)
    for seed in range(n_seeds):
        table = fit(truth, seed).poles_table()
        rings = table.damping_ratio < 1.0
        mode, lag = table[rings].iloc[0], table[~rings].iloc[0]
        for found, std, expected in (
            (mode.frequency, mode.frequency_std, abs(pair) / (2.0 * np.pi)),
            (mode.damping_ratio, mode.damping_ratio_std, -pair.real / abs(pair)),
            (lag.frequency, lag.frequency_std, -real.real / (2.0 * np.pi)),
        ):
            inside.append(abs(found - expected) < 1.96 * std)
    assert 0.9 <= np.mean(inside) <= 0.99


@pytest.mark.slow
def test_covariance_of_real_poles_by_simulation():
    """A damping ratio above one: two real poles, whose errors the delta method gives."""
    system = signal.ZerosPolesGain([], [-20.0, -90.0], 1800.0)
    g = signal.freqresp(system, 2.0 * np.pi * LINES)[1]
    std, rates, stds = np.full(len(LINES), 0.01), [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        error = rng.normal(size=len(g)) + 1j * rng.normal(size=len(g))
        model = TransferFunction(2, dt=DT)
        model.fit_frequency_response(FrequencyResponse(LINES, g + std * error / 2**0.5, std))
        rates.append(model.natural_frequencies_)
        stds.append(model.natural_frequencies_std_)
    np.testing.assert_allclose(np.std(rates, axis=0), np.mean(stds, axis=0), rtol=0.25)
    assert np.isnan(model.damping_ratios_std_).all()


# ---------------------------------------------------------------------------------- several inputs


def two_inputs():
    one = plant(3, 7)
    b = np.stack([one.B[:, 0], np.roll(one.B[:, 0], 1) * [1.0, 30.0, 0.3]], axis=1)
    return signal.StateSpace(one.A, b, one.C, np.zeros((1, 2)))


def test_two_inputs_share_the_poles():
    truth = two_inputs()
    u, y = recording(truth, 0, noise=1e-4)
    model = TransferFunction(3, n_zeros=2, inputs="all", dt=DT).fit(u, y + 5.0)
    assert model.n_states_ == 3
    assert_poles(model.poles_, truth, rtol=1e-3)
    fresh, expected = recording(truth, 1, noise=0.0)
    assert np.std(model.predict(fresh) - 5.0 - expected) < 1e-3 * expected.std()
    assert [len(zeros) for zeros in model.zeros_] == [2, 2]


def test_columns_are_chosen_by_name_and_units_do_not_matter():
    truth = two_inputs()
    u, y = recording(truth, 0, noise=0.01, n=500)
    frame = pd.DataFrame(
        {"load": np.zeros(len(y)), "a": u[:, 0], "b": u[:, 1]}, index=DT * np.arange(len(y))
    )
    named = TransferFunction(3, n_zeros=2, inputs=["a", "b"]).fit(frame, y)
    plain = TransferFunction(3, n_zeros=2, inputs="all", dt=DT).fit(u, y)
    np.testing.assert_array_equal(named.predict(frame), plain.predict(u))
    other = TransferFunction(3, n_zeros=2, inputs=[2, 1]).fit(frame * [1.0, 1e-9, 1e6], 1e-6 * y)
    np.testing.assert_allclose(
        other.predict(frame * [1.0, 1e-9, 1e6]), 1e-6 * plain.predict(u), atol=1e-10 * y.std()
    )
    drive = TransferFunction(3, n_zeros=2).fit(frame[["a", "b"]], y)
    alone = TransferFunction(3, n_zeros=2).fit(frame[["a"]], y)
    np.testing.assert_array_equal(drive.predict(frame[["a", "b"]]), alone.predict(frame[["a"]]))


def test_delays_of_two_inputs():
    truth, delays = two_inputs(), np.array([0.03, 0.05])
    u, _ = recording(truth, 3, n=800)
    smooth = signal.lfilter([0.2], [1.0, -0.8], u, axis=0)
    late = np.stack([np.r_[np.full(k, smooth[0, i]), smooth[:-k, i]] for i, k in enumerate([3, 5])])
    rest = np.linalg.solve(truth.A, -truth.B @ smooth[0])
    _, y, _ = signal.lsim(truth, late.T, DT * np.arange(800), X0=rest)
    known = TransferFunction(3, n_zeros=2, inputs="all", delay=delays, dt=DT).fit(smooth, y)
    assert known.fit_error_ < 1e-6 * y.std()
    assert "delays[0]" not in known.params_
    free = TransferFunction(3, n_zeros=2, inputs="all", delay="fit", dt=DT)
    free.fit_frequency_response(_delayed(response_of(truth, 0, noise=1e-6), delays))
    np.testing.assert_allclose(free.operator_.delays, delays, rtol=1e-3)


def _delayed(response, delays):
    shift = np.exp(-2j * np.pi * response.frequency[:, None] * delays)
    return dataclasses.replace(response, response=response.response * shift)


def test_several_inputs_come_first():
    u, y = recording(two_inputs(), 0, n=100)
    steps = [("plays", PrandtlIshlinskii(3)), ("dynamics", TransferFunction(inputs="all"))]
    with pytest.raises(ValueError, match="'dynamics' of Cascade reads columns of X"):
        Cascade(steps, dt=DT).fit(u, y)


def test_several_inputs_beside_a_drift():
    u, y = recording(two_inputs(), 0, noise=0.0)
    y += np.linspace(0.0, 0.1 * y.std(), len(y))
    steps = [("dynamics", TransferFunction(3, n_zeros=2, inputs="all")), ("drift", Drift(1))]
    model = Sum(steps, dt=DT).fit(u, y)
    assert np.std(model.predict(u) - y) < 0.03 * y.std()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"inputs": ["a"]}, r"at least one column of X .* Got \['a'\]"),
        ({"inputs": [2]}, r"Got \[2\] instead"),
        ({"inputs": [0, 0]}, "none twice"),
        ({"inputs": []}, "at least one column"),
        ({"inputs": "all", "delay": [0.1, 0.2, 0.3]}, "one for each of 2 input"),
    ],
)
def test_wrong_parameters(options, message):
    u, y = recording(two_inputs(), 0, n=100)
    with pytest.raises(ValueError, match=message):
        TransferFunction(dt=DT, **options).fit(u, y)


# ------------------------------------------------------------------------------ frequency response


@pytest.mark.parametrize("scale", [1.0, 1e9])
def test_exact_frequency_response_is_recovered(scale):
    truth = plant(5, 0)
    response = response_of(truth, 0, noise=0.0)
    response = dataclasses.replace(response, response=scale * response.response, std=None)
    model = TransferFunction(5, n_zeros=4, dt=DT).fit_frequency_response(response)
    assert_poles(model.poles_, truth, rtol=1e-6)
    static = float((truth.C @ np.linalg.solve(-truth.A, truth.B))[0, 0])
    assert model.params_["gain"] == pytest.approx(scale * static, rel=1e-6)
    again = model.predict(np.ones((4, 1)))
    np.testing.assert_allclose(again, scale * static, rtol=1e-6)


def test_delay_of_a_frequency_response():
    response = _delayed(response_of(plant(4, 2), 0, noise=0.01), 0.21)
    fitted = TransferFunction(4, n_zeros=2, delay="fit", dt=DT).fit_frequency_response(response)
    assert fitted.params_["delay__delay"] == pytest.approx(
        0.21, abs=5.0 * fitted.params_std_["delay__delay"]
    )
    assert fitted.params_std_["delay__delay"] < 1e-4
    known = TransferFunction(4, n_zeros=2, delay=0.21, dt=DT).fit_frequency_response(response)
    assert "delay__delay" not in known.params_
    np.testing.assert_allclose(known.poles_, fitted.poles_, rtol=0.01)
    with pytest.raises(ValueError, match="delay"):
        known.to_scipy()


def test_estimated_response_leads_to_the_free_run():
    u, y = recording(plant(4, 3), 0, n=8000)
    frame = pd.DataFrame(
        {"volt": signal.lfilter([0.3], [1.0, -0.7], u[:, 0])}, DT * np.arange(8000)
    )
    rest = np.zeros(4)
    _, y, _ = signal.lsim(plant(4, 3), frame.to_numpy(), frame.index, X0=rest)
    response = frequency_response(frame, y, segment_length=1000).restrict(high=20.0)
    model = TransferFunction(4, n_zeros=2).fit_frequency_response(response)
    assert model.score(frame, y) > 0.99
    np.testing.assert_array_equal(model.predict(frame.assign(more=1.0)), model.predict(frame))
    other = model.set_params(dt=DT).fit(u, y)  # and the other way again
    assert other.predict(u).shape == (8000,)


def test_unstable_poles_are_kept_on_request():
    truth = signal.ZerosPolesGain([], [3.0, -20.0], 100.0)
    g = signal.freqresp(truth, 2.0 * np.pi * LINES)[1]
    response = FrequencyResponse(LINES, g)
    model = TransferFunction(2, stable=False, dt=DT).fit_frequency_response(response)
    np.testing.assert_allclose(np.sort(model.poles_.real), [-20.0, 3.0], rtol=1e-6)
    assert model.damping_ratios_.tolist() == [-1.0, 1.0]
    with pytest.warns(DivergenceWarning, match="unstable"):
        model.predict(np.ones((5, 1)))
    pair = signal.ZerosPolesGain([], [1.0 + 60.0j, 1.0 - 60.0j], 3600.0)
    response = FrequencyResponse(LINES, signal.freqresp(pair, 2.0 * np.pi * LINES)[1])
    free = TransferFunction(2, stable=False, dt=DT).fit_frequency_response(response)
    np.testing.assert_allclose(free.poles_.real, 1.0, rtol=1e-6)
    assert TransferFunction(2, dt=DT).fit_frequency_response(response).poles_.real.max() < 0.0


def test_the_covariance_of_unstable_poles_mirrors_that_of_stable_ones():
    frequency = np.linspace(0.1, 1.0, 60)  # one side of the resonance: both parts are correlated
    s, rng = 2j * np.pi * frequency, np.random.default_rng(0)
    g = 40.0 / (s * s + 4.0 * s + 40.0) + 0.05 * np.exp(2j * np.pi * rng.uniform(size=60))
    stable, unstable = (
        TransferFunction(2, n_zeros=0, stable=False).fit_frequency_response(
            FrequencyResponse(frequency, values, np.full(60, 0.05))
        )
        for values in (g, g.conj())
    )
    np.testing.assert_allclose(np.sort(unstable.poles_), np.sort(-stable.poles_), rtol=1e-6)
    upper, mirrored = (m.poles_covariance_[np.argmax(m.poles_.imag)] for m in (stable, unstable))
    np.testing.assert_allclose(mirrored, upper * [[1.0, -1.0], [-1.0, 1.0]], rtol=1e-4)


def test_wrong_frequency_responses():
    two = response_of(two_inputs(), 0)
    with pytest.raises(ValueError, match="'inputs' parameter of TransferFunction must be 'all'"):
        TransferFunction(3).fit_frequency_response(two)
    few = FrequencyResponse(np.array([1.0, 2.0]), np.array([1.0, 1.0j]))
    with pytest.raises(ValueError, match="lines above zero"):
        TransferFunction(8).fit_frequency_response(few)
    model = TransferFunction(3, n_zeros=2, inputs="all").fit_frequency_response(two)
    with pytest.raises(ValueError, match=r"must have the 2 input\(s\)"):
        model.predict(np.ones((5, 1)))


# --------------------------------------------------------------------------------------- conversion


def test_from_system_to_scipy_and_control():
    truth = plant(3, 0)
    model = TransferFunction.from_system(truth, dt=DT)
    u, y = recording(truth, 0, noise=0.0, n=200)
    np.testing.assert_allclose(model.predict(u), y, atol=1e-8 * y.std())
    assert_poles(np.linalg.eigvals(model.to_scipy().A), truth, rtol=1e-8)
    assert model.n_zeros == len(model.zeros_) == 2
    both = TransferFunction.from_system(two_inputs(), dt=DT, hold="foh")
    u, y = recording(two_inputs(), 0, noise=0.0, n=200)
    np.testing.assert_allclose(both.predict(u), y, atol=1e-7 * y.std())


def test_python_control():
    control = pytest.importorskip("control")
    model = TransferFunction.from_system(control.tf([2.0, 1.0], [1.0, 3.0, 2.0]), dt=DT)
    system = model.to_control()
    np.testing.assert_allclose(np.sort(system.poles().real), [-2.0, -1.0], rtol=1e-9)
    assert complex(system(1.0)) == pytest.approx(0.5)


SAMPLED = signal.lti([3.0, 40.0], [1.0, 8.0, 900.0])  # a zero and a mode, of 4.7 Hz


def sampled(dt, hold):
    """Return its samples under a hold, as polynomials without leading zeros."""
    num, den, _ = signal.cont2discrete((SAMPLED.num, SAMPLED.den), dt, method=hold)
    return num.ravel()[1 if hold == "zoh" else 0 :], den


@pytest.mark.parametrize("delay", [0, 1, 7])
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_from_a_system_in_discrete_time(hold, delay):
    """What SciPy has sampled, with zeros before its pulse, is what it was sampled from."""
    num, den = sampled(DT, hold)
    system = signal.dlti(num, [*den, *np.zeros(delay)], dt=DT)
    model = TransferFunction.from_system(system, hold=hold, initial_state="zero")
    assert model.dt == DT
    np.testing.assert_allclose(np.sort_complex(model.poles_), np.sort_complex(SAMPLED.poles))
    assert np.ravel(model.delay) == pytest.approx(delay * DT, abs=1e-15)
    assert model.params_.get("delay__delay", 0.0) == pytest.approx(delay * DT)
    u = np.append(0.0, np.random.default_rng(0).normal(size=99))
    _, expected = signal.dlsim(system, u)
    np.testing.assert_allclose(model.predict(u[:, None]), expected[:, 0], atol=1e-9)
    omega = np.array([5.0, 30.0])
    rational, _ = model._rational()
    np.testing.assert_allclose(
        rational.frequency_response(omega / (2.0 * np.pi)), signal.freqresp(SAMPLED, omega)[1]
    )


def test_inputs_with_delays_of_their_own():
    """A state space of two inputs with a chain of two samples before the first, and back."""
    plain = TransferFunction.from_system(two_inputs(), dt=DT, hold="zoh")
    late = TransferFunction.from_system(two_inputs(), dt=DT, hold="zoh", delay=[2 * DT, 0.0])
    u = np.random.default_rng(0).normal(size=(60, 2))
    u[:3] = 0.0
    shifted = np.column_stack([np.append([0.0, 0.0], u[:-2, 0]), u[:, 1]])
    np.testing.assert_allclose(late.predict(u), plain.predict(shifted), atol=1e-10)
    system = plain.to_scipy()
    a, b, c, d, _ = signal.cont2discrete((system.A, system.B, system.C, system.D), DT)
    chain = np.zeros((2, 2)), np.array([[0.0, 1.0]])
    chain[0][1, 0] = 1.0
    n = len(a)
    a = np.block([[a, b[:, :1] @ chain[1]], [np.zeros((2, n)), chain[0]]])
    b = np.vstack([np.column_stack([np.zeros(n), b[:, 1]]), [[1.0, 0.0], [0.0, 0.0]]])
    c = np.concatenate([c, d[:, :1] @ chain[1]], axis=1)
    d = d * [[0.0, 1.0]]
    again = TransferFunction.from_system(signal.dlti(a, b, c, d, dt=DT), hold="zoh")
    np.testing.assert_allclose(again.delay, [2 * DT, 0.0])
    np.testing.assert_allclose(again.predict(u), late.predict(u), atol=1e-9)


def test_resampled_is_exact():
    """A system sampled coarsely answers at a finer interval as the fine one does, if held."""
    system = signal.dlti(*sampled(4 * DT, "zoh"), dt=4 * DT)
    coarse = TransferFunction.from_system(system, hold="zoh")
    u = np.repeat(np.random.default_rng(0).normal(size=25), 4)
    fine = coarse.resampled(DT)
    assert (fine.dt, coarse.dt) == (DT, 4 * DT)
    y = fine.predict(u[:, None])
    np.testing.assert_allclose(y[::4], coarse.predict(u[::4, None]), atol=1e-10)
    assert fine.stepper(u0=u[0]).dt == DT
    np.testing.assert_allclose(fine.stepper(u0=u[0]).run(u), y, atol=1e-12)
    _, expected, _ = signal.lsim(SAMPLED, u - u[0], DT * np.arange(100), interp=False)
    at_rest = u[0] * SAMPLED.num[-1] / SAMPLED.den[-1]
    np.testing.assert_allclose(y, expected + at_rest, atol=1e-9)
    with pytest.raises(ValueError, match=r"'dt' parameter of TransferFunction\.resampled"):
        coarse.resampled(0.0)


def test_delays_in_continuous_time():
    pytest.importorskip("control")
    model = TransferFunction.from_system(SAMPLED, delay=0.02, dt=DT)
    with pytest.raises(ValueError, match=r"to_control\(pade=3\)"):
        model.to_control()
    omega = np.array([1.0, 20.0, 60.0])
    found = model.to_control(pade=4)(1j * omega)
    expected = np.exp(-0.02j * omega) * signal.freqresp(SAMPLED, omega)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    both = TransferFunction.from_system(two_inputs(), delay=[0.02, 0.0], dt=DT)
    plain = TransferFunction.from_system(two_inputs(), dt=DT).to_control()(20.0j)
    found = both.to_control(pade=4)(20.0j)
    np.testing.assert_allclose(found, plain * [[np.exp(-0.4j), 1.0]], rtol=1e-5)
    with pytest.raises(ValueError, match="'pade' parameter"):
        model.to_control(pade=0)


def test_discrete_systems_that_sample_none_are_refused():
    for den, why in (([1.0, 0.5], "negative real pole"), ([1.0, -0.5, 0.0], "z = 0")):
        with pytest.raises(ValueError, match=why):
            TransferFunction.from_system(signal.dlti([1.0, 0.3, 0.2][: len(den)], den, dt=DT))
    control = pytest.importorskip("control")
    with pytest.raises(ValueError, match="dt = True"):
        TransferFunction.from_system(control.tf([1.0], [1.0, -0.5], True))
    with pytest.raises(ValueError, match="'delay' parameter of"):
        TransferFunction.from_system(SAMPLED, delay="fit")


def test_message_without_python_control(monkeypatch):
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ImportError, match=r"skhyst\[control\]"):
        TransferFunction.from_system(plant(2, 0)).to_control()


def integrated(seed):
    """Return a held drive, and the response of 4 / (s (0.1 s + 1)) from zero by scipy."""
    u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 60), 50)
    *system, _ = signal.cont2discrete(signal.tf2ss([4.0], [0.1, 1.0, 0.0]), DT)
    return u[:, None], signal.dlsim((*system, DT), u)[1][:, 0]


NO_REST = "no state of rest"


def test_an_integrator_that_is_said_to_rest_says_that_it_cannot():
    X, y = integrated(0)
    with pytest.warns(ConvergenceWarning, match=f"{NO_REST}.*initial_state='zero' the error is"):
        model = TransferFunction(2, hold="zoh", dt=DT).fit(X, y)
    assert not model.has_rest_
    with pytest.warns(ConvergenceWarning, match=NO_REST):
        model.predict(integrated(1)[0])


@pytest.mark.filterwarnings("ignore:A straight line")
def test_an_integrator_that_is_not_there_leaves_a_time_constant_open():
    """It may be a million times the record or more: the response is the same."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1.0, 1.0, 40), 50)
    y = FirstOrderLagOperator(0.1, gain=2.0).run(u, DT)[0] + 0.01 * rng.normal(size=2000)
    with pytest.warns(ConvergenceWarning, match="do not determine .*: time_constants"):
        model = TransferFunction(1, integrators=2, dt=DT).fit(u[:, None], y)
    assert model.identifiability_["undetermined"] == ("time_constants[0]",)
    assert model.params_std_["time_constants[0]"] == np.inf


@pytest.mark.parametrize("initial_state", ["zero", "estimate"])
@pytest.mark.filterwarnings("ignore:The data do not determine")
def test_an_integrator_is_found_from_zero(initial_state):
    X, y = integrated(0)
    model = TransferFunction(2, hold="zoh", dt=DT, initial_state=initial_state)
    if initial_state == "zero":
        model.fit(X, y)
    else:
        with pytest.warns(ConvergenceWarning, match=NO_REST):
            model.fit(X, y)
    assert model.score(X, y) == pytest.approx(1.0, abs=1e-9)
    X, y = integrated(1)
    assert model.score(X, y) == pytest.approx(1.0, abs=1e-9)
    known = np.where(np.arange(2000) < 100, y[1000:], np.nan)
    late = model.predict(X[1000:], known)
    assert np.std(late - y[1000:]) < 0.02 * np.std(y[1000:])


def test_what_rests_keeps_its_rest():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1.0, 1.0, 20), 20)
    slow = SecondOrderModeOperator(60.0, 0.05) | FirstOrderLagOperator(30.0)
    y = slow.run(u, DT)[0] + 1e-4 * rng.normal(size=400)
    model = TransferFunction(3, dt=DT).fit(u[:, None], y)
    assert model.has_rest_


@pytest.mark.parametrize("n_zeros", [0, 2, 3])
def test_the_divisions_are_all_ways_to_write_the_operator_as_two_in_series(n_zeros):
    parts = np.array([0.5]), np.array([20.0, 50.0]), np.array([0.1, 0.2])
    numerator = np.array([0.3, -0.2, 0.1])[:n_zeros]
    whole = TransferFunctionOperator(*parts, numerator, 2.0, 0.3)
    frequency = np.geomspace(0.01, 100.0, 30)
    divisions = whole.divisions()
    for first, second in divisions:
        np.testing.assert_allclose(
            first.frequency_response(frequency) * second.frequency_response(frequency),
            whole.frequency_response(frequency),
            rtol=1e-9,
        )
        assert (first.gain, second.gain, second.intercept) == (1.0, 2.0, 0.3)
        assert all(0 < len(p.poles()) >= len(p.numerator) for p in (first, second))
    found = {tuple(np.sort_complex(first.poles()).round(6)) for first, _ in divisions}
    assert len(found) == 2**3 - 2  # a real pole and two pairs, neither part without
    if not n_zeros:
        assert len(divisions) == len(found)


def test_many_real_poles_make_a_limited_number_of_divisions():
    many = TransferFunctionOperator(
        np.geomspace(0.01, 1.0, 10), np.empty(0), np.empty(0), np.empty(0)
    )
    divisions = many.divisions()
    assert len(divisions) == 2**8 - 2
