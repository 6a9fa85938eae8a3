import numpy as np
import pytest

from skhyst.hysteresis._rate_dependent_prandtl_ishlinskii_loops import (
    rate_play_inverse,
    rate_play_run,
    rate_play_tangents,
)
from skhyst.operators import play_basis

RNG = np.random.default_rng(0)
N, K = 300, 6
U = np.cumsum(RNG.normal(size=N)) * 0.3
RATES = np.abs(np.diff(U, prepend=0.0))
THRESHOLDS = np.arange(K) * 0.4
GROWS = (THRESHOLDS > 0.0).astype(float)
WEIGHTS = RNG.random(K) + 0.1
RATE_WEIGHTS = 0.1 * RNG.random(K)
NONE = np.zeros(K)


def run(kernel, signal, growth, rate_weights, plays=None, rates=RATES):
    plays = np.zeros(K) if plays is None else plays
    out = np.empty(signal.size)
    kernel(signal, rates, THRESHOLDS, growth, WEIGHTS, rate_weights, plays, out)
    return out, plays


@pytest.mark.parametrize("kernel", [rate_play_run, rate_play_inverse])
def test_compiled_equals_python(kernel):
    compiled = run(kernel, U, 0.2 * GROWS, RATE_WEIGHTS)
    python = run(kernel.py_func, U, 0.2 * GROWS, RATE_WEIGHTS)
    for a, b in zip(compiled, python, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("m", [0, 3])
@pytest.mark.parametrize("rate_weights", [RATE_WEIGHTS, np.empty(0)])
def test_compiled_tangents_equal_python(m, rate_weights):
    rng = np.random.default_rng(1)
    du, drates = rng.normal(size=(2, N, m))
    found = []
    for kernel in (rate_play_tangents, rate_play_tangents.py_func):
        out, plays = np.full((N, m + K + rate_weights.size + 2), np.nan), np.zeros(K)
        kernel(U, du, RATES, drates, THRESHOLDS, GROWS, 0.2, WEIGHTS, rate_weights, plays, out)
        found.append((out, plays))
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


def test_without_rate_it_is_a_sum_of_plays():
    basis = np.empty((N, K))
    play_basis(U, THRESHOLDS, np.zeros(K), basis)
    out, plays = run(rate_play_run, U, NONE, NONE)
    np.testing.assert_allclose(out, basis @ WEIGHTS, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(plays, basis[-1])


def test_one_clip_is_exact_where_thresholds_are_straight_between_samples():
    fine = 64
    time = np.arange(N * fine) / fine
    u = np.interp(time, np.arange(-1, N), np.append(0.0, U))
    rates = np.interp(time, np.arange(-1, N), np.append(0.0, RATES))
    whole, _ = run(rate_play_run, U, 0.2 * GROWS, RATE_WEIGHTS)
    out, _ = run(rate_play_run, u, 0.2 * GROWS, RATE_WEIGHTS, rates=rates)
    np.testing.assert_allclose(out[::fine], whole, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("growth", [0.0, 0.3, 5.0])
@pytest.mark.parametrize("rate_weights", [NONE, RATE_WEIGHTS, -0.02 * WEIGHTS])
def test_inverse_at_known_rates(growth, rate_weights):
    y, plays = run(rate_play_run, U, growth * GROWS, rate_weights)
    u, again = run(rate_play_inverse, y, growth * GROWS, rate_weights)
    np.testing.assert_allclose(u, U, rtol=0, atol=1e-12 * np.ptp(U))
    np.testing.assert_allclose(again, plays, rtol=0, atol=1e-12 * np.ptp(U))
