"""Vector fitting finds the poles of rational data exactly."""

import numpy as np
import pytest
from scipy.signal import lfilter

from skhyst.optimize import (
    RationalBlock,
    modal_start,
    rational_residues,
    record_poles,
    vector_fit,
    warp,
)


def rational(s, poles, residues, d=0.0):
    """Return ``sum r / (s - p) + d`` with the conjugates of complex terms."""
    total = np.full(len(s), d, dtype=complex)
    for p, r in zip(poles, residues, strict=True):
        total += r / (s - p)
        if np.imag(p):
            total += np.conj(r) / (s - np.conj(p))
    return total


def all_of(poles):
    poles = np.asarray(poles, dtype=complex)
    return np.sort_complex(np.r_[poles, poles[poles.imag > 0].conj()])


POLES = {
    1: [-3.0],
    2: [-1.0 + 40.0j],
    3: [-0.2, -1.0 + 40.0j],
    5: [-900.0, -0.5 + 9.0j, -1.0 + 40.0j],
    6: [-0.1, -700.0, -0.5 + 9.0j, -0.6 + 9.5j],
}


@pytest.mark.parametrize("n", POLES)
@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_poles_of_exact_data(n, unit):
    rng = np.random.default_rng(n)
    s = 1j * np.geomspace(0.02, 3000.0, 120)
    blocks = []
    for _ in range(3):
        scale = np.abs(np.asarray(POLES[n]))
        residues = scale * (rng.normal(size=len(scale)) + 1j * rng.normal(size=len(scale)))
        residues = np.where(np.imag(POLES[n]) == 0.0, residues.real, residues)
        g = rational(s, POLES[n], residues, 0.3)
        blocks.append(RationalBlock(g, np.ones((len(s), 1)), np.ones(len(s))))
    poles, cost = vector_fit(unit * s, blocks, n)
    np.testing.assert_allclose(np.sort_complex(poles) / unit, all_of(POLES[n]), rtol=1e-6)
    assert cost < 1e-12 * sum(np.sum(np.abs(block.target) ** 2) for block in blocks)


def test_residues_are_those_of_weighted_least_squares():
    rng = np.random.default_rng(0)
    s = 1j * np.geomspace(0.1, 300.0, 60)
    poles = np.array([-3.0 + 0.0j, -1.0 + 40.0j, -1.0 - 40.0j])
    target = rational(s, poles[:2], [2.0, 1.0 - 3.0j], 0.3)
    target += 0.1 * (rng.normal(size=60) + 1j * rng.normal(size=60))
    weight = rng.uniform(0.1, 2.0, 60)
    _, cost = rational_residues(s, [RationalBlock(target, np.ones((60, 1)), weight)], poles)
    # complex residues of conjugate poles are two real unknowns
    pair = 1.0 / (s - poles[1]), 1.0 / (s - poles[2])
    columns = np.stack([1.0 / (s - poles[0]), sum(pair), 1j * (pair[0] - pair[1]), s**0], axis=1)
    rows, right = weight[:, None] * columns, weight * target
    rows, right = np.r_[rows.real, rows.imag], np.r_[right.real, right.imag]
    assert cost == pytest.approx(np.linalg.lstsq(rows, right, rcond=None)[1][0])


def test_unstable_poles_are_kept_or_mirrored():
    s = 1j * np.linspace(0.1, 30.0, 100)
    block = RationalBlock(rational(s, [0.5 + 9.0j], [2.0]), np.ones((100, 1)), np.ones(100))
    free, _ = vector_fit(s, [block], 2, stable=False)
    np.testing.assert_allclose(np.sort_complex(free), all_of([0.5 + 9.0j]), rtol=1e-8)
    assert vector_fit(s, [block], 2)[0].real.max() < 0.0


@pytest.mark.parametrize("n_samples", [(60,), (41, 80)])
def test_poles_of_short_records_that_do_not_start_at_rest(n_samples):
    """What the ends of a record leave is part of the equations."""
    dt, z = 0.1, np.array([0.9 * np.exp(0.7j), 0.9 * np.exp(-0.7j), 0.5])
    a = np.poly(z).real
    records = []
    for k, n in enumerate(n_samples):
        rng = np.random.default_rng(k)
        u = rng.normal(size=(n, 2))
        y = lfilter([0.3, 0.2, -0.1], a, u[:, 0], zi=rng.normal(size=3))[0]
        records.append((u, y + lfilter([1.0, 0.5], a, u[:, 1]), dt))
    found = record_poles(records, 3)
    np.testing.assert_allclose(
        np.sort_complex(found), np.sort_complex(np.log(z.astype(complex)) / dt), rtol=1e-7
    )
    assert record_poles([(u[:6], y[:6], dt) for u, y, dt in records], 3) is None


def test_warp_is_the_logarithm_of_tustins_map():
    s = np.array([-0.3 + 2.0j, -5.0, -0.3 - 2.0j])
    z = np.exp(0.1 * s)
    np.testing.assert_allclose(warp(2.0 / 0.1 * (z - 1.0) / (z + 1.0), 0.1), s, rtol=1e-12)
    assert warp(-1e4, 0.1).real < 0.0  # beyond what the sampling resolves


def test_modal_start_is_exact_where_residues_have_rank_one():
    rng = np.random.default_rng(0)
    poles = np.array([-1.0 + 20.0j, -1.0 - 20.0j, -2.0 + 50.0j, -2.0 - 50.0j, -3.0, -70.0])
    residues = np.empty((6, 3, 2))
    for k in (0, 2):
        r = np.outer(
            rng.normal(size=3) + 1j * rng.normal(size=3),
            rng.normal(size=2) + 1j * rng.normal(size=2),
        )
        residues[k], residues[k + 1] = r.real, r.imag
    for k in (4, 5):
        residues[k] = np.outer(rng.normal(size=3), rng.normal(size=2))
    for own in (residues, residues.transpose(0, 2, 1)):
        (tau, w, zeta), b = modal_start(poles, own, 6)
        assert b.shape == (6, own.shape[2])
        assert len(tau) == 0
        np.testing.assert_allclose(np.sort(w), np.sort([abs(20j - 1), abs(50j - 2), 210**0.5]))
        np.testing.assert_allclose(np.sort(w * zeta), [1.0, 2.0, 36.5])
