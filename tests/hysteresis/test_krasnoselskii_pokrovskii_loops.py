import numpy as np
import pytest

from skhyst.hysteresis import _krasnoselskii_pokrovskii as kernels

LEVELS = np.array([-1.0, -0.2, 0.3, 0.7, 1.4])
N_KERNELS = 10


def drive(n=200):
    return 1.2 * np.random.default_rng(0).normal(size=n)


def by_hand(u, kernels_before):
    i, j = np.tril_indices(LEVELS.size - 1)
    z, rows = kernels_before.copy(), []
    for value in u:
        ramps = np.clip(2 * (value - LEVELS[:-1]) / np.diff(LEVELS) - 1, -1, 1)
        z = np.maximum(ramps[i], np.minimum(ramps[j], z))
        rows.append(z)
    return np.array(rows)


@pytest.mark.parametrize("plain", [False, True])
def test_kernels_by_hand(plain, monkeypatch):
    if plain:
        for name in ("fill_ramps", "move", "ramp_run", "ramp_basis", "ramp_tangents"):
            monkeypatch.setattr(kernels, name, getattr(kernels, name).py_func)
    u, before = drive(), np.random.default_rng(1).uniform(-1, 1, N_KERNELS)
    expected = by_hand(u, before)
    rows, state = np.empty((u.size, N_KERNELS)), before.copy()
    kernels.ramp_basis(u, LEVELS, state, rows)
    np.testing.assert_allclose(rows, expected, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(state, rows[-1])
    weights, y, state = np.random.default_rng(2).random(N_KERNELS), np.empty(u.size), before.copy()
    kernels.ramp_run(u, LEVELS, weights, state, y)
    np.testing.assert_allclose(y, expected @ weights, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(state, rows[-1])
    du, out, state = (
        np.random.default_rng(3).normal(size=(u.size, 2)),
        np.empty((u.size, 2)),
        before,
    )
    kernels.ramp_tangents(u, du, LEVELS, weights, state.copy(), out)
    h = 1e-6
    for t in range(2):
        moved = by_hand(u + h * du[:, t], before) - by_hand(u - h * du[:, t], before)
        np.testing.assert_allclose(out[:, t], moved @ weights / (2 * h), rtol=0, atol=1e-7)
