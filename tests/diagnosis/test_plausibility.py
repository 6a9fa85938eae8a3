"""A name is refused where the data say that it is wrong, and stays where they leave it open."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import search_steps
from numpy.polynomial import Legendre, Polynomial
from scipy.stats import norm

from skhyst.compose import Sum
from skhyst.diagnosis import EFFECTS, EffectSearchCV
from skhyst.diagnosis._plausibility import has_its_name, is_plausible
from skhyst.disturbance import SinusoidOperator
from skhyst.hysteresis import (
    BacklashOperator,
    DahlOperator,
    LuGreOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    KelvinVoigt,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from skhyst.noise import largest_noise
from skhyst.operators import Stage, SumOperator
from skhyst.optimize import RecordData
from skhyst.records import near_period
from skhyst.static import (
    DeadBandOperator,
    DeadZoneOperator,
    PolynomialCurveOperator,
    SmoothCurve,
    SoftSaturationOperator,
)

MODE = SecondOrderModeOperator(30.0, 0.05)
(bends, bends_to_one_side, builds_up, has_no_peak, input_beyond_dead_zone, is_between_samples) = (
    EFFECTS[name].plausible
    for name in ("static_nonlinearity", "asymmetry", "hysteresis", "lag", "dead_zone", "timing")
)
(levels_off, rings, slides, stops, varies_in_rate, width_beyond_noise) = (
    EFFECTS[name].plausible
    for name in (
        *("output_saturation", "resonance", "friction"),
        *("end_stops", "rate_dependence", "backlash"),
    )
)


def candidate(tree, *effects):
    return search_steps.candidate(tree, effects=effects, cost=1.0, n_parameters=4)


@pytest.mark.parametrize(("damping", "changed"), [(0.05, False), (0.5, False), (3.0, True)])
def test_a_mode_in_the_place_of_another_is_no_further_mode(damping, changed):
    """An overdamped mode creeps: what was added is then the declared mode, not the missing one."""
    declared = search_steps.tree_of(SecondOrderMode(), MODE)
    bent = declared.with_stage(0, operator=replace(MODE, damping_ratio=damping))
    found = search_steps.with_stage(bent, "resonance", SecondOrderMode(), MODE)
    plausible = is_plausible(None, candidate(found, "resonance"), candidate(declared), [], 0.01)
    assert plausible != changed
    creep = KelvinVoigt(1), KelvinVoigtOperator(np.array([0.2]), np.array([1.0]))
    found = search_steps.with_stage(bent, "creep", *creep)
    assert is_plausible(None, candidate(found, "creep"), candidate(declared), [], 0.01)


def test_a_mode_behind_what_does_not_ring_is_a_further_mode():
    declared = search_steps.tree_of(
        KelvinVoigt(1), KelvinVoigtOperator(np.array([0.2]), np.array([1.0]))
    )
    found = search_steps.with_stage(declared, "resonance", SecondOrderMode(), MODE)
    assert is_plausible(None, candidate(found, "resonance"), candidate(declared), [], 0.01)


@pytest.mark.parametrize(
    ("drive", "told"),
    [
        (lambda t: np.sin(t), False),
        (lambda t: np.sin(t) + 0.1 * np.sin(3.0 * t + 1.0), False),  # two turns a period, too
        (lambda t: np.sin(t) + np.sin(2.7 * t), True),
        (lambda t: t * np.sin(t), True),
        (lambda t: (t > 3.0) + 0.0, True),
        (lambda t: np.clip(2.0 * np.sin(t), -1.0, 1.0), True),  # it rests
    ],
)
def test_one_loop_does_not_tell_dynamics_from_plays(drive, told):
    u = drive(np.arange(1000) * 0.03)
    records = [RecordData(u, u, 0.03)]
    plays = search_steps.tree_of(
        PrandtlIshlinskii(thresholds=[0.0, 0.3]), PrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.2])
    )
    lag = FirstOrderLag(), FirstOrderLagOperator(0.2)
    curve = SmoothCurve(3), PolynomialCurveOperator(np.zeros(1), center=0.0, scale=1.0)
    for declared in (plays, search_steps.tree_of(Gain(), GainOperator(1.0))):
        found = candidate(search_steps.with_stage(declared, "lag", *lag), "lag")
        as_named = is_plausible(None, found, candidate(declared), records, 0.01)
        assert as_named == (told or declared is not plays)
    found = candidate(
        search_steps.with_stage(plays, "static_nonlinearity", *curve), "static_nonlinearity"
    )
    assert is_plausible(None, found, candidate(plays), records, 0.01)


@pytest.mark.parametrize("unit", [1e-6, 1.0])
@pytest.mark.parametrize("alpha", [0.01, 0.2])
def test_a_margin_below_zero_is_refused_beyond_its_standard_error(alpha, unit):
    """Of a regression's slope; that of a function of it is its derivative times as large."""
    rng, n = np.random.default_rng(9000), 200
    u = rng.normal(size=n) + 3.0
    y = unit * (2.0 * u + 0.3 * rng.normal(size=n))
    records, model = [RecordData(u, y, 0.01)], Gain()
    fitted = search_steps.fitted(model, records)
    (gain, intercept) = np.polyfit(u, y, 1)
    rest = y - gain * u - intercept
    error = np.sqrt(rest @ rest / (n - 2) / np.sum((u - u.mean()) ** 2))
    tree = SimpleNamespace(  # an effect whose operator is the gain
        problem=fitted.problem,
        at=lambda problem, x: SimpleNamespace(
            part=lambda name: fitted.at(problem, x).operators[0], is_part=lambda name: False
        ),
        label=lambda name: name,
        disturbance_names=["own"],
    )
    margins = [
        lambda found, reach: found.gain / gain - 1.0 - reach / gain,
        lambda found, reach: 1.0 - found.gain / gain - reach / gain,
        lambda found, reach: np.log(found.gain / gain) - reach / gain,
        lambda found, reach: (found.gain / gain) ** 3 - 1.0 - 3.0 * reach / gain,
    ]
    for margin in margins:
        for part, stays in ((-1.0, True), (0.0, True), (0.98, True), (1.02, False)):
            reach = part * norm.isf(alpha) * error

            def named(operator, motion, seen, margin=margin, reach=reach):
                return margin(operator, reach) + (1e-9 if reach == 0.0 else 0.0)

            assert has_its_name("own", named, tree, records, alpha) == stays
    assert not has_its_name("own", lambda *_: -np.inf, tree, records, alpha)
    assert has_its_name("own", lambda *_: np.inf, tree, records, alpha)
    assert has_its_name("own", None, tree, records, alpha)


def test_a_play_is_compared_with_the_largest_of_the_noise():
    """That is sqrt(2 log(n)) standard deviations, both over their ranges; the quietest counts."""
    rng = np.random.default_rng(9402)
    smooth = np.sin(np.linspace(0.0, 20.0, 2000))
    records = []
    for noise in (0.02, 0.01, 0.05):
        u = 4.0 + 3.0 * smooth + noise * rng.normal(size=2000)
        records.append(RecordData(u, u, 0.01))
    largest = min(np.sqrt(2.0 * np.log(2000)) * largest_noise(r.u) for r in records)
    part = largest / np.ptp(np.concatenate([r.u for r in records]))
    assert part == pytest.approx(0.01 * 3.9 / 6.2, rel=0.1)
    motion = 7.0 * smooth
    for times, wide in ((0.98, False), (1.02, True)):
        operator = BacklashOperator(times * part * np.ptp(motion), stage_order=0)
        assert (width_beyond_noise(operator, motion, records) > 0.0) == wide


@pytest.mark.parametrize("dt", [1e-3, 1.0, 20.0])
@pytest.mark.parametrize(("longer", "varies"), [(4, False), (6, False), (8, True)])
def test_rates_differ_by_more_than_a_twentieth_and_a_sample_at_each_end(dt, longer, varies):
    def triangle(half):
        return np.interp(np.arange(6 * half + 1), half * np.arange(7), [0.0, 1.0] * 3 + [0.0])

    drives = triangle(100), triangle(100 + longer)
    records = [RecordData(u, u, dt) for u in drives]
    assert (varies_in_rate(None, None, records) > 0.0) == varies
    flat = RecordData(np.zeros(50), np.zeros(50), dt)
    assert (varies_in_rate(None, None, [flat, *records]) > 0.0) == varies
    assert varies_in_rate(None, None, [flat]) < 0.0


def test_a_line_that_some_record_tells_from_the_drive_is_its_own():
    """Of several lines each one has to be."""
    n, period, dt = 1000, 100, 0.01
    u = np.sin(2.0 * np.pi * np.arange(n) / period)
    periodic = RecordData(u, u, dt)
    rough = RecordData(np.random.default_rng(0).normal(size=n), u, dt)
    harmonic, between = 7.0 / (period * dt), 9.45 / (period * dt)

    def own(frequencies, *records):
        operator = SinusoidOperator(np.zeros(2 * len(frequencies)), np.array(frequencies))
        return EFFECTS["periodic_disturbance"].plausible(operator, np.array([]), records) > 0.0

    assert not own([harmonic], periodic)
    assert own([between], periodic)
    assert not own([harmonic, between], periodic)
    assert not own([between, harmonic], periodic, periodic)
    assert own([harmonic], periodic, rough)
    assert own([harmonic, between], rough, periodic)
    assert not own([between, between + 0.9 / (n * dt)], rough)  # they are not told apart
    assert own([between, between + 1.1 / (n * dt)], rough)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_margins_of_friction_are_ways_over_the_motion(unit):
    """It slides within a twentieth of the motion; what a sample's motion passes is not resolved."""
    motion = unit * np.r_[np.linspace(-2.0, 3.0, 101), 3.0, np.linspace(3.0, 1.0, 41)]

    def names(way):
        operator = LuGreOperator(way * 5.0 * unit, 1.0, 0.5, 1.0)
        assert operator.presliding_displacement == way * 5.0 * unit
        return slides(operator, motion, []) > 0.0, builds_up(operator, motion, []) > 0.0

    assert names(0.0099) == names(0.049) == (True, False)
    assert names(0.051) == (False, True)
    assert slides(GainOperator(), motion, []) == np.inf
    assert builds_up(GainOperator(), motion, []) == np.inf


@pytest.mark.parametrize(
    ("spring", "force", "dissipates"),
    [
        (1.0, 0.5, True),
        (-1.0, -0.5, True),
        (1.0, -0.5, False),
        (-1.0, 0.5, False),
        (0.1, -2.0, True),
    ],
)
def test_a_friction_does_not_supply_energy(spring, force, dissipates):
    """The sign of both is that of the sensor; a force far larger than the spring has none."""
    motion = np.sin(np.arange(300) / 20.0)
    parts = Stage("spring", GainOperator(spring)), Stage("friction", DahlOperator(0.02, force))
    both = SumOperator.of_parts(parts, Sum([]))
    assert (slides(both, motion, []) > 0.0) == dissipates
    assert (builds_up(both, motion, []) > 0.0) != dissipates


def test_a_curve_that_does_not_level_off_bends():
    motion = np.linspace(-1.0, 1.0, 50)
    for level in (1.05, 1.5, 4.0):
        knee = SoftSaturationOperator(level, 2.0, 0.1)
        assert bends(knee, motion, []) == -levels_off(knee, motion, [])
    assert bends(GainOperator(), motion, []) == levels_off(GainOperator(), motion, []) == np.inf


@pytest.mark.parametrize(
    ("turns", "is_curve"),
    [([-2.0], True), ([0.3], True), ([-0.2, 0.5], False), ([-0.2, 2.0, 0.5], False)],
)
def test_a_smooth_curve_turns_once_at_the_most(turns, is_curve):
    """Over its input, from 3 to 7, which these are parts of."""
    curve = Legendre.cast(Polynomial.fromroots(turns).integ())
    coefficients = curve.coef[2:] / curve.coef[1]  # its straight part has the slope one
    operator = PolynomialCurveOperator(coefficients, center=5.0, scale=2.0)
    assert (bends(operator, None, []) > 0.0) == is_curve


@pytest.mark.parametrize(("ratio", "peaks"), [(0.70, True), (0.71, False)])
def test_a_mode_has_a_peak_below_the_root_of_a_half(ratio, peaks):
    """And is one that the samples resolve up to the end of its half-power band."""
    mode = SecondOrderModeOperator(30.0, ratio)
    record = RecordData(np.zeros(500), np.zeros(500), 1e-3)
    assert (rings(mode, None, [record]) > 0.0) == peaks
    assert (has_no_peak(mode, None, [record]) > 0.0) == (not peaks)
    assert has_no_peak(GainOperator(), None, [record]) == np.inf
    assert rings(GainOperator(), None, [record]) == -np.inf
    for natural_frequency, bounded in ((150.0, True), (170.0, False)):  # 3141.6 rad/s are sampled
        mode = SecondOrderModeOperator(natural_frequency, 10.0)  # its faster pole at 19.95 times it
        assert np.isfinite(rings(mode, None, [record])) == bounded
    slow = RecordData(np.zeros(9), np.zeros(9), 1.0)
    for times, resolved in ((0.99, True), (1.01, False)):
        mode = SecondOrderModeOperator(times * np.pi / 1e-3 / 1.2, 0.2)
        assert (rings(mode, None, [slow, record]) > 0.0) == resolved


@pytest.mark.parametrize(("periods", "repeats"), [(1.9, False), (2.1, True)])
def test_a_mode_repeats_in_the_longest_record(periods, repeats):
    """A slower one is as good as a drift."""
    short, long = (RecordData(np.zeros(n), np.zeros(n), 1e-3) for n in (50, 500))
    mode = SecondOrderModeOperator(2.0 * np.pi * periods / 0.5, 0.05)
    assert (rings(mode, None, [long, short]) > 0.0) == repeats


@pytest.mark.parametrize(
    ("n_steps", "ratio", "shows"),
    [(1, 0.2, True), (1, 0.3, False), (3, 0.3, True), (3, 0.6, True), (2, 0.6, False)],
)
@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_mode_with_zeros_shows_as_many_half_periods_as_it_has_parameters(
    n_steps, ratio, shows, apart, noise
):
    """After all steps together: of ln(20) / (pi ratio) each, until a twentieth is left."""
    rng = np.random.default_rng(0)
    frequency, none = np.array([20.0]), np.empty(0)
    mode = TransferFunctionOperator(none, frequency, np.array([ratio]), np.array([0.5, 3.0]))
    drives = [np.repeat(np.arange(2.0), 400)] * n_steps
    drives = drives if apart else [np.repeat(np.arange(1.0 + n_steps), 400)]
    drives = [u + noise * rng.standard_normal(len(u)) for u in drives]  # as it was measured
    assert (rings(mode, None, [RecordData(u, u, 0.01) for u in drives]) > 0.0) == shows
    noisy = rng.standard_normal(400)  # as it was given
    assert rings(mode, None, [RecordData(noisy, noisy, 0.01)]) > 0.0


@pytest.mark.parametrize(
    ("center", "stays"), [(0.0, True), (0.9, True), (1.6, False), (-2.6, False)]
)
def test_a_dead_zone_has_a_response_on_both_sides(center, stays):
    drive = np.linspace(-2.0, 2.0, 401)
    operator = DeadBandOperator(half_width=0.4, center=center)
    assert (input_beyond_dead_zone(operator, operator.run(drive, 0.1)[0], []) > 0.0) == stays


@pytest.mark.parametrize(
    ("thresholds", "side", "weights", "stays"),
    [
        ([0.5], [1], [0.1], True),
        ([0.5], [1], [-0.5], True),
        ([0.95], [1], [0.1], False),  # 3 % of the motion
        ([-0.95], [-1], [0.1], False),
        ([0.95], [-1], [0.1], False),  # the piece behind it is that without it
        ([0.5, 1.2], [1, 1], [0.1, 0.1], True),  # one that is never reached
        ([-0.7, 0.3, 0.93], [-1, 1, 1], [0.1, 0.1, 0.1], False),
        ([-0.5, 0.4], [-1, 1], [0.3, 0.3], False),  # bent alike on both sides
        ([-0.5, 0.4], [-1, 1], [-0.3, 0.3], True),
    ],
)
def test_an_asymmetry_is_seen_behind_its_kinks_and_bends_to_one_side(
    thresholds, side, weights, stays
):
    zones = DeadZoneOperator(*map(np.array, (weights, thresholds, side)))
    motion = zones.run(np.linspace(-1.0, 1.0, 50), 0.1)[0]
    for unit in (1e-9, 1.0, 1e6):
        own = replace(zones, thresholds=unit * zones.thresholds)
        assert (bends_to_one_side(own, unit * motion, []) >= 0.0) == stays


@pytest.mark.parametrize(
    ("compliance", "time_constant", "stays"),
    [(0.2, 1.0, True), (10.0, 1.0, True), (30.0, 1.0, False), (300.0, 1000.0, True)],
)
def test_creep_has_a_prompt_response(compliance, time_constant, stays):
    """Without one it is a lag; what a record is too short for does not count."""
    operator = KelvinVoigtOperator(np.array([compliance]), np.array([time_constant]))
    records = [RecordData(np.zeros(1001), np.zeros(1001), 0.01)]
    assert (EFFECTS["creep"].plausible(operator, np.zeros(1001), records) > 0.0) == stays
    beside = FirstOrderLagOperator(1e-2 * compliance)  # of what is prompt
    assert (EFFECTS["creep"].plausible(beside, np.zeros(1001), records) > 0.0) == (
        beside.time_constant > 0.01
    )


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
    additive = replace(harmonics, frequencies=harmonics.frequencies + 2.0 / 6.0)  # turns a record
    assert margin(additive, np.array([]), records) > 0.0


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
    """However few the turns of the drive, if its frequency is none of their harmonics."""
    time = np.arange(750) * 2e-3
    drive = -5.0 * np.cos(3.0 * np.pi * time / time[-1])
    model = PrandtlIshlinskiiOperator(np.linspace(0.0, 4.0, 10), np.full(10, 0.1))
    rng = np.random.default_rng(0)
    hum = 0.02 * np.sin(2.0 * np.pi * 50.0 * time)
    response = model.run(drive, 2e-3)[0] + hum + 0.005 * rng.standard_normal(time.size)
    search = EffectSearchCV(
        PrandtlIshlinskii(10, dt=2e-3),
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
    for additive in np.linspace(0.02, 0.98, 12) / turns:
        frequency = (7.0 + additive) / period
        line = np.exp(2j * np.pi * frequency * time)
        returning = np.mean(np.abs(line.reshape(turns, period).mean(axis=0)) ** 2)
        operator = SinusoidOperator(np.zeros(2), np.array([frequency]))
        margin = EFFECTS["periodic_disturbance"].plausible
        own = margin(operator, np.array([]), [RecordData(drive, drive, 1.0)]) > 0.0
        assert own == (returning < 0.5)


@pytest.mark.parametrize(("times", "later"), [(0.98, False), (1.02, True)])
def test_a_delay_is_longer_than_the_shortest_interval(times, later):
    """A shift of the clocks is shorter, or it is a delay."""
    records = [RecordData(np.zeros(9), np.zeros(9), dt) for dt in (0.02, 0.01, 0.05)]
    margin = EFFECTS["delay"].plausible
    assert (margin(SimpleNamespace(delay=0.01 * times), None, records) > 0.0) == later
    shift = SimpleNamespace(shift=0.01 * times)
    assert (is_between_samples(shift, None, records) > 0.0) == (not later)
    early = SimpleNamespace(shift=-9.0)  # no device answers before it is driven
    assert is_between_samples(early, None, records) > 0.0
    assert is_between_samples(SimpleNamespace(), None, records) == np.inf


@pytest.mark.parametrize("unit", [1e-6, 1e6])
@pytest.mark.parametrize(("end", "both"), [(0.04, False), (0.06, True)])
def test_a_dead_zone_is_left_at_both_ends_by_a_twentieth_of_the_motion(unit, end, both):
    motion = unit * np.array([-end, 0.0, 1.0 - end, 0.3])
    assert (input_beyond_dead_zone(None, motion, []) > 0.0) == both
    assert input_beyond_dead_zone(None, motion[motion != 0.0], []) < 0.0  # no sample is in the band
    assert (input_beyond_dead_zone(None, -motion, []) > 0.0) == both


@pytest.mark.parametrize("frequency", [0.3, 300.0])
@pytest.mark.parametrize(
    ("peak", "shows"), [(1.04, False), (1.06, True), (0.96, False), (0.94, True)]
)
def test_a_mode_with_zeros_shows_a_peak_or_a_notch(frequency, peak, shows):
    """By a twentieth beyond the gains at rest and far above; zeros near the poles cancel them."""

    def response(hertz):
        s = 2j * np.pi * hertz / frequency
        return (1.0 + 0.6 * peak * s + s**2) / (1.0 + 0.6 * s + s**2)

    known = {"damping_ratio": 0.3, "natural_frequency": frequency, "frequency_response": response}
    drive = np.arange(9) % 2.0  # at every sample
    records = [RecordData(drive, drive, dt) for dt in (1e-3, 10.0)]
    assert (rings(SimpleNamespace(**known, numerator=np.ones(2)), None, records) > 0.0) == shows
    assert rings(SimpleNamespace(**known), None, records) > 0.0  # without zeros it is a peak
    low = {**known, "frequency_response": lambda f: (1.0 + 9.0 * (f == 0.0)) * response(f)}
    assert rings(SimpleNamespace(**low, numerator=np.ones(2)), None, records) < 0.0 or peak < 1.0


@pytest.mark.parametrize(
    ("lower", "upper", "plausible"),
    [(-0.5, 3.0, True), (-3.0, 0.5, True), (-3.0, 3.0, False), (-0.99, -0.95, False)],
)
@pytest.mark.parametrize("sprung", [True, False])
def test_one_stop_is_enough(lower, upper, plausible, sprung):
    """Between the stops it is free for a twentieth of its way; without a spring all are stiff."""
    operator = SimpleNamespace(
        stop_stiffness=5.0 if sprung else 0.1,
        lower=lower,
        upper=upper,
        gain=3.0,
        intercept=-7.0,
        linear_mode=lambda: True if sprung else None,
    )
    motion = np.linspace(-1.0, 1.0, 50)
    motion = 3.0 * motion - 7.0 if sprung else motion
    assert (stops(operator, motion, []) > 0.0) == plausible
