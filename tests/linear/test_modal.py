"""Modes shared by inputs and responses: recovery, exactness, errors, units."""

import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.signal import dlsim
from scipy.stats import ortho_group

from skhyst.exceptions import ConvergenceWarning
from skhyst.linear import ModalModel, SampledStateSpace

DT = 0.01
FREQUENCIES, DAMPINGS = np.array([4.0, 7.0, 9.0]), np.array([0.02, 0.01, 0.05])


def structure(n_outputs=3, n_inputs=2, seed=0):
    """Return a sampled system with three modes and one real pole, in scrambled coordinates."""
    rng = np.random.default_rng(seed)
    poles = 2.0 * np.pi * FREQUENCIES * (-DAMPINGS + 1j * np.sqrt(1.0 - DAMPINGS**2))
    a = np.zeros((7, 7))
    for k, z in enumerate(np.exp(poles * DT)):
        a[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[z.real, z.imag], [-z.imag, z.real]]
    a[6, 6] = 0.6
    turn = ortho_group.rvs(7, random_state=seed)
    b, c = rng.normal(size=(7, n_inputs)), rng.normal(size=(n_outputs, 7))
    return turn @ a @ turn.T, turn @ b, c @ turn.T, rng.normal(size=(n_outputs, n_inputs)), DT


def simulate(system, u, x0=None):
    return dlsim(system, u, x0=np.zeros(7) if x0 is None else x0)[1]


def noisy(n_samples=(500, 700), noise=0.01, seed=0, **options):
    """Return records that start in unknown states, as frames."""
    rng, system, frames, responses = np.random.default_rng(seed), structure(**options), [], []
    for k, n in enumerate(n_samples):
        u = rng.normal(size=(n, system[1].shape[1]))
        y = simulate(system, u, rng.normal(size=7))
        index = pd.MultiIndex.from_product([[k], DT * np.arange(n)], names=["record", "time"])
        frames.append(pd.DataFrame(u, index).add_prefix("u"))
        responses.append(pd.DataFrame(y + noise * y.std(axis=0) * rng.normal(size=y.shape), index))
    return pd.concat(frames), pd.concat(responses)


@pytest.mark.parametrize("n_outputs", [1, 2, 3])
def test_poles_and_response_of_exact_data(n_outputs):
    X, Y = noisy(noise=0.0, n_outputs=n_outputs)
    model = ModalModel(7).fit(X, Y)
    table = model.poles_table()
    modes = table[table.damping_ratio < 1.0]
    np.testing.assert_allclose(modes.frequency, FREQUENCIES, rtol=1e-6)
    np.testing.assert_allclose(modes.damping_ratio, DAMPINGS, rtol=1e-5)
    system = structure(n_outputs)
    u = np.random.default_rng(9).normal(size=(200, 2))
    model.set_params(initial_state="zero")
    np.testing.assert_allclose(
        model.predict(pd.DataFrame(u, DT * np.arange(200), X.columns)).reshape(200, -1)
        - model.operator_.intercept,
        simulate(system, u),
        atol=1e-5,
    )


def test_intervals_hold_the_truth():
    """Those of the modes, of the free run, and of a new sample."""
    rng, inside, of_run, of_sample = np.random.default_rng(9), [], [], []
    u = rng.normal(size=(150, 2))
    for seed in range(8):
        X, Y = noisy((400,), 0.02, seed)
        model = ModalModel(7, initial_state="zero").fit(X, Y + [5.0, 0.0, -200.0])
        modes = model.poles_table().query("damping_ratio < 1")
        inside += [*(np.abs(modes.frequency - FREQUENCIES) < 1.96 * modes.frequency_std)]
        inside += [*(np.abs(modes.damping_ratio - DAMPINGS) < 1.96 * modes.damping_ratio_std)]
        y, std = model.predict(pd.DataFrame(u, DT * np.arange(150), X.columns), return_std=True)
        error = y - simulate(structure(), u) - [5.0, 0.0, -200.0]
        of_run.append(np.abs(error) < 1.96 * np.sqrt(std**2 - model.noise_std_**2))
        noise = 0.02 * simulate(structure(), X.to_numpy()).std(axis=0)
        np.testing.assert_allclose(model.noise_std_, noise, rtol=0.15)
        of_sample.append(np.abs(error + noise * rng.normal(size=y.shape)) < 1.96 * std)
    assert len(inside) == 48
    assert np.mean(inside) >= 0.85
    assert 0.88 < np.mean(of_run) < 1.0
    assert 0.93 < np.mean(of_sample) < 0.97


def test_periodic_records_in_steady_state():
    rng, system, rows = np.random.default_rng(0), structure(), []
    for _ in range(3):
        u = np.tile(rng.normal(size=(400, 2)), (12, 1))
        rows.append((u[-1200:], simulate(system, u)[-1200:]))
    index = pd.MultiIndex.from_product([range(3), DT * np.arange(1200)], names=["record", "time"])
    X = pd.DataFrame(np.concatenate([u for u, _ in rows]), index).add_prefix("u")
    Y = np.concatenate([y for _, y in rows]) + [5.0, 0.0, -2.0]
    model = ModalModel(7, transient_periods=0).fit(X, Y)
    modes = model.poles_table().query("damping_ratio < 1")
    # four thousandths of a period of the slowest ringing are left in the steady state
    np.testing.assert_allclose(modes.frequency, FREQUENCIES, rtol=1e-4)
    # a period is the lead-in from rest; what rings on of it falls by exp(-2 pi 4 0.02 4)
    late = np.arange(3600) % 1200 >= 800
    assert np.max(np.abs(model.predict(X) - Y)[late]) < 0.1 * Y.std()


def test_units_and_order_of_columns():
    X, Y = noisy((300,), 0.01)
    plain = ModalModel(7).fit(X, Y).predict(X)
    other = ModalModel(7).fit(X * [1e-9, 1e4], Y * [1e6, 1.0, -1e-8])
    expected = plain * [1e6, 1.0, -1e-8]
    error = (other.predict(X * [1e-9, 1e4]) - expected) / expected.std(axis=0)
    np.testing.assert_allclose(error, 0.0, atol=1e-4)
    turned = ModalModel(7).fit(X[["u1", "u0"]], Y.iloc[:, ::-1])
    np.testing.assert_allclose(turned.predict(X[["u1", "u0"]])[:, ::-1], plain, atol=1e-3)


def test_one_response_and_pickle():
    X, Y = noisy((300,), 0.01)
    model = ModalModel(7).fit(X, Y[0])
    assert model.predict(X).shape == (300,)
    assert model.n_states_ == len(model.poles_) == 7
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).predict(X), model.predict(X))
    before = X.copy()
    model.fit(X, Y)
    pd.testing.assert_frame_equal(X, before)


def test_refusals():
    X, Y = noisy((300,), 0.01)
    model = ModalModel(7, dt=DT).fit(X.to_numpy(), Y.to_numpy())
    with pytest.raises(ValueError, match=r"that of the fit, 0\.01 s"):
        model.set_params(dt=2.0 * DT).predict(X.to_numpy())
    with pytest.raises(ValueError, match="at least 3 samples"):
        ModalModel(1).fit(np.ones((2, 1)), np.ones(2))
    with (
        pytest.warns(ConvergenceWarning, match="has not converged in 'max_evaluations' = 60"),
        pytest.warns(ConvergenceWarning, match="do not determine ModalModel"),
    ):
        ModalModel(9).fit(X[:16], Y[:16])


def test_sampled_state_space_agrees_with_scipy():
    rng = np.random.default_rng(1)
    a, b = 0.2 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    c, d = rng.normal(size=(2, 3)), rng.normal(size=(2, 2))
    u = rng.normal(size=(30, 2))
    system = SampledStateSpace(a, b, c, d, DT, np.array([0.5, 0.0]))
    zero = system.init(u[0], "zero")
    expected = dlsim((a, b, c, d, DT), u)[1]
    np.testing.assert_allclose(system.run(u, DT, zero)[0] - system.intercept, expected)
    y, state = system.run(np.tile(u[:1], (5, 1)), DT)
    static = system.frequency_response(np.zeros(1))[0].real @ u[0] + system.intercept
    np.testing.assert_allclose(y, np.tile(static, (5, 1)))
    np.testing.assert_allclose(system.step(state, u[0], DT)[1], static)
    with pytest.raises(ValueError, match=r"sampled every 0\.01 s"):
        system.run(u, 2.0 * DT)
