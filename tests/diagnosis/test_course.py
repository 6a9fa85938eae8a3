"""An additive disturbance is distinguished from the course of the noise itself."""

import numpy as np
import pytest
import search_steps
from numpy.polynomial.legendre import legvander
from scipy.fft import idct

from skhyst.diagnosis import _course
from skhyst.diagnosis._course import course_p_value, course_p_values
from skhyst.disturbance import (
    Drift,
    DriftOperator,
    PeriodicDisturbance,
    SinusoidOperator,
)
from skhyst.linear import Gain, GainOperator, SecondOrderMode, SecondOrderModeOperator
from skhyst.optimize import RecordData

N = 800
TIME = np.linspace(-1.0, 1.0, N)


def noise(rng, exponent):
    """Return noise of unit variance whose power falls with this power of the frequency."""
    gains = np.append(0.0, np.arange(1.0, N + 1.0) ** (-0.5 * exponent))
    gains *= np.sqrt(2 * N / (2.0 * np.sum(gains[:-1] ** 2) + gains[-1] ** 2))
    return np.fft.irfft(np.fft.rfft(rng.standard_normal(2 * N)) * gains, 2 * N)[:N]


@pytest.mark.parametrize("exponent", [0.0, 1.0])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_noise_of_any_colour_is_no_drift(exponent, degree):
    rng, basis = np.random.default_rng(100), legvander(TIME, degree)
    own = np.arange(min(degree, 1), degree + 1)  # the constant of a drift could be an offset's
    found = [
        course_p_value([noise(rng, exponent) for _ in range(4)], [basis] * 4, own)
        for _ in range(40)
    ]
    assert np.mean(np.array(found) < 0.1) < 0.2
    assert min(found) > 1e-4
    assert any(0.25 < p < 0.5 for p in found)  # chance has no values of its own


@pytest.mark.parametrize("exponent", [0.0, 1.0])
def test_what_stands_out_of_the_spectrum_is_found(exponent):
    rng = np.random.default_rng(101)
    drift, line = legvander(TIME, 1), np.stack([np.cos(90.0 * TIME), np.sin(90.0 * TIME)], axis=1)
    for basis in (drift, line):
        courses = [noise(rng, exponent) + 20.0 * basis @ rng.standard_normal(2) for _ in range(4)]
        assert course_p_value(courses, [basis] * 4, np.arange(2)) < 1e-5


@pytest.mark.parametrize("size", [0.0, 1.0])
def test_noise_of_the_drive_that_a_mode_has_coloured_is_no_line(size):
    rng, time = np.random.default_rng(103), np.arange(N)
    mode = SecondOrderModeOperator(natural_frequency=0.4, damping_ratio=0.03)
    records = []
    for _ in range(3):
        u = 10.0 * np.sin(0.02 * time + rng.uniform(0.0, 6.0))
        line = size * np.sin(0.38 * time + rng.uniform(0.0, 6.0))
        y = mode.run(u, 1.0, mode.init(u[0]))[0] + line + 0.02 * rng.standard_normal(N)
        records.append(RecordData(u + 0.1 * rng.standard_normal(N), y, 1.0))
    tree = search_steps.tree_of(SecondOrderMode(), mode)
    rests = [r.y - y for r, y in zip(records, tree.respond(records), strict=True)]
    highest = np.argmax(sum(np.abs(np.fft.rfft(rest, 4 * N)) ** 2 for rest in rests))
    line = SinusoidOperator(np.zeros(2), np.array([highest / (4.0 * N)]))
    tree = search_steps.with_disturbance(tree, "periodic_disturbance", PeriodicDisturbance(), line)
    (p_value,) = course_p_values(tree, records).values()
    assert (p_value < 1e-4) == (size > 0.0)


def test_without_noise_everything_stands_out_and_nothing_is_nothing():
    basis = np.ones((N, 1))
    assert course_p_value([basis[:, 0], 2.0 * basis[:, 0]], [basis] * 2, [0]) < 1e-5
    assert course_p_value([np.zeros(N)] * 2, [basis] * 2, [0]) == 1.0


def test_a_constant_is_an_offset_and_no_drift():
    rng = np.random.default_rng(102)
    model, time = Gain(), 0.01 * np.arange(N)
    tree = search_steps.with_disturbance(
        search_steps.tree_of(model, GainOperator(1.0)),
        "drift",
        Drift(1),
        DriftOperator(np.zeros(2), 0.01 * N),
    )
    for slope, is_drift in ((0.0, False), (1.0, True)):
        records = []
        for _ in range(4):
            u = rng.standard_normal(N)
            y = u + rng.normal() + slope * rng.normal() * time + 0.05 * rng.standard_normal(N)
            records.append(RecordData(u, y, 0.01))
        (p_value,) = course_p_values(tree, records).values()
        assert (p_value < 1e-4) == is_drift


def cosines(*numbers, n=1000):
    """Return columns of the discrete cosine transform: each is all that its frequency has."""
    return idct(np.eye(n)[:, list(numbers)], axis=0, norm="ortho")


def test_frequencies_within_a_decade_tell_the_spectrum():
    """Of columns from 20 to 50 those from 2 to 500; what others have makes no difference."""
    basis, own = cosines(20, 50), np.arange(2)
    rest = np.random.default_rng(0).normal(size=1000)
    p_value = course_p_value([rest], [basis], own)
    for number, counts in ((1, False), (3, True), (30, True), (490, True), (510, False)):
        (line,) = cosines(number).T
        changed = course_p_value([rest + 30.0 * line], [basis], own)
        assert (changed != pytest.approx(p_value, rel=1e-9)) == counts, number


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_a_course_has_no_unit(unit):
    rng = np.random.default_rng(1)
    courses = [rng.normal(size=500) + 3.0 * cosines(20, n=500)[:, 0] for _ in range(2)]
    bases, own = [cosines(20, n=500)] * 2, np.arange(1)
    echoes = [[np.convolve(rng.normal(size=500), np.ones(9), "same") for _ in range(2)]] * 20
    p_value = course_p_value(courses, bases, own, echoes)
    assert 1e-9 < p_value < 0.5
    scaled = [[unit * part for part in echo] for echo in echoes]
    found = course_p_value([unit * course for course in courses], bases, own, scaled)
    assert found == pytest.approx(p_value, rel=1e-3)
    silent = [[0.0 * part for part in echo] for echo in echoes]
    assert course_p_value(courses, bases, own, silent) == course_p_value(courses, bases, own)


def test_noise_that_the_plant_makes_of_the_drive_is_no_line():
    """A band, as a mode makes of white noise, is distinguished from a line by its echo."""
    rng = np.random.default_rng(2)
    band = (np.abs(np.arange(1000) - 50.0) < 6.0) * 20.0

    def rung():
        return idct(band * rng.normal(size=1000), norm="ortho")

    typical = cosines(*np.flatnonzero(band)) @ rng.choice([-20.0, 20.0], np.count_nonzero(band))
    courses = [rng.normal(size=1000) + typical]
    bases, own = [cosines(50)], np.arange(1)
    assert course_p_value(courses, bases, own) < 0.01
    assert course_p_value(courses, bases, own, [[rung()] for _ in range(100)]) > 0.1


def test_each_frequency_that_was_sought_counts_with_half_of_the_samples(monkeypatch):
    """Of the longest record; the constant of a drift was not sought, and could be an offset's."""
    seen = []

    def p_value(rests, bases, own, echoes):
        seen.append((bases[0].shape[1], own.tolist()))
        return 1e-6

    monkeypatch.setattr(_course, "course_p_value", p_value)
    rng = np.random.default_rng(0)
    records = [RecordData(u, u, 0.01) for u in (rng.normal(size=n) for n in (200, 500, 100))]
    tree = search_steps.tree_of(Gain(), GainOperator(1.0))
    one = SinusoidOperator(np.zeros(2), np.array([3.0]))
    tree = search_steps.with_disturbance(tree, "periodic_disturbance", PeriodicDisturbance(), one)
    tree = search_steps.with_disturbance(tree, "drift", Drift(2), DriftOperator(np.zeros(3), 1.0))
    found = course_p_values(tree, records)
    assert found == {"periodic_disturbance": pytest.approx(250.0 * 1e-6), "drift": 1e-6}
    assert seen == [(5, [0, 1]), (5, [1, 2])]
