"""Numbers behind the pictures: nothing is lost on the way to the page."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst._envelope import envelope
from skhyst.inspection import binned_statistics, branch, spectrum
from skhyst.inspection._plot_data import (
    cycle_length,
    finite_runs,
    log_average,
    loop_spans,
)


@given(st.integers(2, 5000), st.integers(1, 60), st.integers(0, 2**31))
@settings(deadline=None, max_examples=60)
def test_outline_keeps_the_extremes_of_every_stretch(n_samples, n_bins, seed):
    values = np.random.default_rng(seed).normal(size=n_samples)
    rows = envelope(values, n_bins)
    assert np.all(np.diff(rows) > 0)
    assert len(rows) <= 2 * n_bins + 2
    edges = np.linspace(0, n_samples, n_bins + 1).astype(int)
    for start, stop in pairwise(edges):
        if stop > start:
            shown = values[rows[(rows >= start) & (rows < stop)]]
            assert shown.max() == values[start:stop].max()
            assert shown.min() == values[start:stop].min()


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("cycles", [3, 40])
def test_noise_makes_no_cycles(cycles, noise):
    phase = np.linspace(0, 2 * np.pi * cycles, 8000)
    drive = np.sin(phase) + noise * np.random.default_rng(0).normal(size=phase.size)
    assert cycle_length(drive) == pytest.approx(8000 / cycles, rel=0.2)
    rising = np.cos(phase)
    clear = np.abs(rising) > 0.3
    assert np.mean(branch(drive)[clear] == np.sign(rising[clear])) > 0.99


def test_constant_drive_is_one_cycle():
    assert cycle_length(np.full(100, 3.0)) == 100.0
    assert branch(np.full(1, 3.0)).shape == (1,)


@given(st.lists(st.integers(2, 3000), min_size=1, max_size=30), st.integers(1, 12))
@settings(deadline=None, max_examples=40)
def test_loops_come_whole_and_from_within_the_records(lengths, max_cycles):
    stops = np.cumsum(lengths)
    spans = [slice(int(b - n), int(b)) for n, b in zip(lengths, stops, strict=True)]
    drive = np.sin(np.arange(stops[-1]) * 0.3)
    chosen = loop_spans(drive, spans, max_cycles)
    assert 1 <= len(chosen) <= max(max_cycles, len(spans))
    for rows, _ in chosen:
        assert rows.stop - rows.start >= 1
        assert any(s.start <= rows.start and rows.stop <= s.stop for s in spans)


def test_the_largest_loop_is_drawn():
    time = np.linspace(0, 200, 40_000)
    drive = np.sin(2 * np.pi * time) * np.exp(-(((time - 130) / 30) ** 2))
    [(rows, cycles)] = loop_spans(drive, [slice(0, 40_000)], 5)
    assert np.argmax(np.abs(drive)) in range(rows.start, rows.stop)
    assert cycles == pytest.approx(5)


def test_few_cycles_are_drawn_whole():
    drive = np.sin(np.linspace(0, 12, 500))
    assert loop_spans(drive, [slice(0, 200), slice(200, 500)], 10)[1][0] == slice(200, 500)


def test_area_under_the_density_is_the_variance():
    rng = np.random.default_rng(3)
    values = rng.normal(scale=2.0, size=30_000)
    values[9000:9100] = np.nan
    frequency, density = spectrum(values, [slice(0, 8000), slice(8000, 30_000)], 0.01)
    assert frequency[-1] == pytest.approx(50.0)
    assert np.trapezoid(density**2, frequency) == pytest.approx(4.0, rel=0.1)
    frequency, density = log_average(frequency, density)
    assert np.trapezoid(density**2, frequency) == pytest.approx(4.0, rel=0.1)


def test_what_rings_in_the_shortest_record_is_seen():
    ends = np.cumsum([0, 745, 769, 788, 839, 859]).tolist()
    values = np.zeros(ends[-1])
    values[:745] = np.sin(2 * np.pi * 100.0 * 1e-3 * np.arange(745))
    frequency, density = spectrum(values, [slice(*pair) for pair in pairwise(ends)], 1e-3)
    assert frequency[np.argmax(density)] == pytest.approx(100.0, rel=0.05)
    assert np.trapezoid(density**2, frequency) == pytest.approx(np.var(values), rel=0.2)


def test_too_little_for_a_spectrum():
    frequency, density = spectrum(np.full(100, np.nan), [slice(0, 100)], 1.0)
    assert frequency.size == density.size == 0
    assert log_average(frequency, density)[0].size == 0


def test_runs_end_at_records_and_gaps():
    values = np.array([1.0, 1, np.nan, 1, 1, 1, np.nan])
    found = finite_runs(values, [slice(0, 4), slice(4, 7)])
    assert found == [slice(0, 2), slice(3, 4), slice(4, 6)]


def test_bins_carry_mean_and_scatter():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 50_000)
    center, mean, std = binned_statistics(x, 3.0 * x + 0.1 * rng.normal(size=x.size))
    np.testing.assert_allclose(mean, 3.0 * center, atol=0.02)
    np.testing.assert_allclose(std, np.hypot(0.1, 3.0 * 0.05 / np.sqrt(12)), rtol=0.15)
    assert binned_statistics(np.array([np.nan]), np.array([1.0]))[0].size == 0
