import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.operators import play_basis, play_tangents, stop_basis

drives = arrays(float, st.integers(1, 60), elements=st.floats(-1e3, 1e3))
thresholds = arrays(float, st.integers(1, 9), elements=st.floats(0, 500)).map(np.sort)
# Multiples of an eighth: sums are exact, so a play touches the end of its slack or does not.
eighths = st.integers(-80, 80).map(lambda i: i / 8)
exact_drives = arrays(float, st.integers(1, 60), elements=eighths)
exact_thresholds = arrays(float, st.integers(1, 9), elements=eighths.map(abs)).map(np.sort)


def basis(kernel, u, r, plays=None):
    plays = np.zeros(r.size) if plays is None else plays
    out = np.full((u.size, r.size), np.nan)
    kernel(u, r, plays, out)
    return out, plays


@settings(deadline=None, max_examples=50)
@given(drives, thresholds)
def test_play_follows_its_definition(u, r):
    out, plays = basis(play_basis, u, r)
    before = np.vstack((np.zeros(r.size), out[:-1]))
    expected = np.maximum(u[:, None] - r, np.minimum(u[:, None] + r, before))
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(plays, out[-1])


@settings(deadline=None, max_examples=50)
@given(drives, thresholds)
def test_play_and_stop_add_up_to_the_drive(u, r):
    play, play_state = basis(play_basis, u, r)
    stop, stop_state = basis(stop_basis, u, r)
    np.testing.assert_allclose(play + stop, np.repeat(u[:, None], r.size, 1), rtol=0, atol=1e-12)
    assert np.all(np.abs(stop) <= r + 1e-12)
    np.testing.assert_array_equal(play_state, stop_state)


@pytest.mark.parametrize("kernel", [play_basis, stop_basis])
@pytest.mark.parametrize("cut", [1, 37, 99])
def test_a_drive_can_be_cut_anywhere(kernel, cut):
    u = np.random.default_rng(0).standard_normal(100)
    r = np.linspace(0.0, 2.0, 7)
    whole, _ = basis(kernel, u, r)
    first, plays = basis(kernel, u[:cut], r)
    second, _ = basis(kernel, u[cut:], r, plays)
    np.testing.assert_array_equal(np.vstack((first, second)), whole)


@pytest.mark.parametrize("kernel", [play_basis, stop_basis])
@pytest.mark.parametrize("n_plays", [1, 3, 8, 33])
def test_compiled_equals_python(kernel, n_plays):
    u = np.random.default_rng(1).standard_normal(200)
    r = np.linspace(0.0, 2.0, n_plays)
    for compiled, python in zip(basis(kernel, u, r), basis(kernel.py_func, u, r), strict=True):
        np.testing.assert_array_equal(compiled, python)


@pytest.mark.parametrize("m", [0, 1, 4])
def test_compiled_tangents_equal_python(m):
    rng = np.random.default_rng(2)
    u, du = rng.standard_normal(300), rng.standard_normal((300, m))
    r, w = np.linspace(0.0, 2.0, 11), rng.random(11)
    cumulative = np.append(0.0, np.cumsum(w))
    results = []
    for kernel in (play_tangents, play_tangents.py_func):
        out, plays = np.full((300, m + 13), np.nan), np.zeros(11)
        kernel(u, du, r, cumulative, plays, out)
        results.append((out, plays))
    for compiled, python in zip(*results, strict=True):
        np.testing.assert_array_equal(compiled, python)


@settings(deadline=None, max_examples=100)
@given(exact_drives, exact_thresholds, st.integers(0, 2**32 - 1))
def test_tangents_are_the_weighted_sum_over_all_plays(u, r, seed):
    rng = np.random.default_rng(seed)
    du, w = rng.standard_normal((u.size, 3)), rng.standard_normal(r.size)
    out = np.empty((u.size, 3 + r.size + 2))
    play_tangents(u, du, r, np.append(0.0, np.cumsum(w)), np.zeros(r.size), out)
    plays, _ = basis(play_basis, u, r)
    np.testing.assert_array_equal(out[:, 3:-2], plays)
    # One tangent a play: that of the drive where the play touches an end of its slack.
    touches = (plays == u[:, None] - r) | (plays == u[:, None] + r)
    tangent, offset = np.zeros((r.size, 3)), np.zeros(r.size)
    for k in range(u.size):
        tangent[touches[k]] = du[k]
        offset[touches[k]] = -1.0
        np.testing.assert_allclose(out[k, :3], w @ tangent, atol=1e-12)
        np.testing.assert_allclose(out[k, -1], w @ offset, atol=1e-12)
        assert out[k, -2] == 1.0
