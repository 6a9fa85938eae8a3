"""A name is refused where the data say that it is wrong, and stays where they leave it open."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from skhyst.diagnosis import EFFECTS, EffectSearchCV
from skhyst.diagnosis._candidates import Candidate, refitted
from skhyst.diagnosis._edits import Insert
from skhyst.diagnosis._periods import near_period
from skhyst.diagnosis._plausibility import goes_on, is_plausible, varies_in_rate
from skhyst.diagnosis._tree import Tree
from skhyst.disturbance import SinusoidOperator
from skhyst.hysteresis import BacklashOperator, PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    KelvinVoigt,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.optimize import RecordData
from skhyst.static import DeadBandOperator

MODE = SecondOrderModeOperator(30.0, 0.05)


def candidate(tree, *effects):
    return Candidate(effects, tree, 1.0, 1.0, 4, np.empty(0))


@pytest.mark.parametrize(("damping", "changed"), [(0.05, False), (0.5, False), (3.0, True)])
def test_a_mode_in_the_place_of_another_is_no_further_mode(damping, changed):
    """An overdamped mode creeps: what was added is then the declared mode, not the missing one."""
    declared = Tree.of(SecondOrderMode(), MODE)
    bent = declared.with_stage(0, operator=replace(MODE, damping_ratio=damping))
    found = bent.edited("resonance", Insert(SecondOrderMode(), MODE))
    plausible = is_plausible(None, candidate(found, "resonance"), candidate(declared), [], 0.01)
    assert plausible != changed
    creep = Insert(KelvinVoigt(1), KelvinVoigtOperator(np.array([0.2]), np.array([1.0])))
    found = bent.edited("creep", creep)
    assert is_plausible(None, candidate(found, "creep"), candidate(declared), [], 0.01)


def test_a_mode_behind_what_does_not_ring_is_a_further_mode():
    declared = Tree.of(KelvinVoigt(1), KelvinVoigtOperator(np.array([0.2]), np.array([1.0])))
    found = declared.edited("resonance", Insert(SecondOrderMode(), MODE))
    assert is_plausible(None, candidate(found, "resonance"), candidate(declared), [], 0.01)


def test_a_margin_below_zero_is_refused_beyond_its_standard_error():
    rng = np.random.default_rng(9000)
    dt, tau, noise = 0.01, 0.05, 0.05
    segments = tuple(pairwise(range(0, 2001, 250)))
    records, estimates = [], []
    for seed in range(20):
        u = np.cumsum(rng.standard_normal(2000)) / 10.0
        y = FirstOrderLagOperator(tau).run(u, dt)[0] + noise * rng.standard_normal(2000)
        records = [RecordData(u, y, dt, segments=segments)]
        declared = Tree.of(Gain(dt=dt), GainOperator(1.0))
        tree = declared.edited("lag", Insert(FirstOrderLag(dt=dt), FirstOrderLagOperator(tau)))
        fitted = refitted(candidate(tree, "lag"), tree, records)
        found = fitted.structure.part("lag").time_constant
        estimates.append(found)

        def stays(distance, found=found, fitted=fitted, declared=declared, records=records):
            def margin(operator, motion, seen):
                return operator.time_constant - found - distance

            return is_plausible(margin, fitted, candidate(declared), records, 0.01)

        assert stays(-1.0)  # above zero
        assert stays(0.0)
        low, high = 0.0, 1.0  # where the name begins to be refused: 2.33 standard errors
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if stays(middle) else (low, middle)
        if seed == 0:
            reach = low
    # the standard error is that of repeated estimates, of which twenty are known to a sixth
    assert reach == pytest.approx(2.33 * np.std(estimates, ddof=1), rel=0.5)


@pytest.mark.parametrize(
    ("center", "stays"), [(0.0, True), (0.9, True), (1.6, False), (-2.6, False)]
)
def test_a_dead_zone_has_a_response_on_both_sides(center, stays):
    drive = np.linspace(-2.0, 2.0, 401)
    operator = DeadBandOperator(half_width=0.4, center=center)
    assert (goes_on(operator, operator.run(drive, 0.1)[0], []) > 0.0) == stays


@pytest.mark.parametrize(
    ("compliance", "time_constant", "stays"),
    [(0.2, 1.0, True), (10.0, 1.0, True), (30.0, 1.0, False), (300.0, 1000.0, True)],
)
def test_creep_has_a_prompt_response(compliance, time_constant, stays):
    """Without one it is a lag; what a record is too short for does not count."""
    operator = KelvinVoigtOperator(np.array([compliance]), np.array([time_constant]))
    records = [RecordData(np.zeros(1001), np.zeros(1001), 0.01)]
    assert (EFFECTS["creep"].plausible(operator, np.zeros(1001), records) > 0.0) == stays


@pytest.mark.parametrize(("half_gap", "stays"), [(0.02, False), (0.2, True)])
@pytest.mark.parametrize("units", [1.0, 1e-9])
def test_a_play_is_wider_than_what_may_be_noise_on_the_drive(half_gap, stays, units):
    """The noise goes to 3.6 standard deviations of 0.01; on a smooth drive any play shows."""
    smooth = np.sin(np.linspace(0.0, 20.0, 3000))
    noisy = smooth + 0.01 * np.random.default_rng(9401).standard_normal(3000)
    for drive, wide in ((noisy, stays), (smooth, True)):
        records = [RecordData(drive, drive, 0.01)]
        margin = EFFECTS["backlash"].plausible
        operator = BacklashOperator(half_gap * units, stage_order=0)
        assert (margin(operator, units * smooth, records) > 0.0) == wide


@pytest.mark.parametrize("period", [40.5, 48.37, 71.23, 250.0 / 3.0, 400.0])
def test_a_period_is_known_between_the_samples(period):
    """So a harmonic of the drive, however high, is no line of its own."""
    turns = 2.0 * np.pi * np.arange(6000) / period
    drive = np.sin(turns) + 0.3 * np.sin(3.0 * turns + 1.0)
    assert near_period(drive) == pytest.approx(period, rel=1e-5)
    records = [RecordData(drive, drive, 1e-3)]
    harmonics = SinusoidOperator(np.zeros(4), np.array([12.0, 14.0]) / (1e-3 * period))
    margin = EFFECTS["periodic_disturbance"].plausible
    assert margin(harmonics, np.array([]), records) < 0.0
    beside = replace(harmonics, frequencies=harmonics.frequencies + 2.0 / 6.0)  # turns a record
    assert margin(beside, np.array([]), records) > 0.0


def test_rate_dependence_needs_more_than_one_rate():
    """At one frequency, whatever the amplitude, rate and amplitude are one."""

    def told(*drives, dt=1.0):
        return varies_in_rate(None, None, [RecordData(u, u, dt) for u in drives]) > 0.0

    t = np.arange(2000.0)
    sine = np.sin(2 * np.pi * t / 97.3)
    assert not told(sine)
    assert not told(sine * np.exp(-t / 600.0), 3.0 * sine)
    assert not told(sine[:60])
    assert told(sine, np.sin(2 * np.pi * t / 140.0))
    assert told(np.sin(2 * np.pi * (t / 200.0) ** 1.5))
    assert told(np.cumsum(np.random.default_rng(0).normal(size=2000)))


@pytest.mark.slow
def test_a_hum_in_a_loop_and_a_half_is_named():
    """However few the turns of the drive: its lines are told from it by what stands beside."""
    time = np.arange(1500) * 1e-3
    drive = -5.0 * np.cos(3.0 * np.pi * time / time[-1])
    model = PrandtlIshlinskiiOperator(np.linspace(0.0, 4.0, 20), np.full(20, 0.05))
    rng = np.random.default_rng(0)
    hum = 0.02 * np.sin(2.0 * np.pi * 50.0 * time)
    response = model.run(drive, 1e-3)[0] + hum + 0.005 * rng.standard_normal(time.size)
    search = EffectSearchCV(
        PrandtlIshlinskii(20, dt=1e-3),
        effects=["resonance", "periodic_disturbance", "initial_state"],
        random_state=0,
    )
    search.fit(drive[:, None], response)
    assert search.effects_ == ["periodic_disturbance"]


@pytest.mark.parametrize("turns", [2, 3, 5, 20])
def test_a_line_is_its_own_where_most_of_it_does_not_return_with_the_turns(turns):
    """In the mean of all turns nothing is left half way between harmonics; near one, most is."""
    period, n = 100, 100 * turns
    drive = np.sin(2.0 * np.pi * np.arange(n) / period)
    assert near_period(drive) == pytest.approx(period, rel=1e-3)
    time = np.arange(n)
    for beside in np.linspace(0.02, 0.98, 12) / turns:
        frequency = (7.0 + beside) / period
        line = np.exp(2j * np.pi * frequency * time)
        returning = np.mean(np.abs(line.reshape(turns, period).mean(axis=0)) ** 2)
        operator = SinusoidOperator(np.zeros(2), np.array([frequency]))
        margin = EFFECTS["periodic_disturbance"].plausible
        own = margin(operator, np.array([]), [RecordData(drive, drive, 1.0)]) > 0.0
        assert own == (returning < 0.5)
