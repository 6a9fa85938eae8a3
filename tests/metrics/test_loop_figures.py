"""Loop figures against closed forms: ellipse, plays, relay, Rayleigh's law; signs and errors."""

import numpy as np
import pandas as pd
import pytest

from skhyst.datasets.simulation import plays
from skhyst.metrics import loop_figures


def triangle(amplitude, n_cycles, n=400):
    """Return a drive that begins at its lowest value, whose turning points are samples."""
    phase = np.arange(n_cycles * n + 1) / n % 1.0
    return amplitude * (1.0 - 4.0 * np.abs(phase - 0.5))


def one(u, y, **options):
    (row,) = loop_figures(u, y, **options).to_dict("records")
    return row


@pytest.mark.parametrize("n", [50, 1000, 1001.7])
@pytest.mark.parametrize("lag", [0.3, -0.3])
def test_an_ellipse(n, lag):
    """Sine against lagging sine, however it is sampled: pi A B sin(lag), and its axes' sections."""
    phase = 2.0 * np.pi * np.arange(int(4 * n)) / n
    found = one(2.0 * np.sin(phase), 5.0 * np.sin(phase - lag))
    expected = {
        "area": 10.0 * np.pi * np.sin(lag),
        "coercivity": 2.0 * np.sin(lag),
        "remanence": 5.0 * np.sin(lag),
        "opening": 10.0 * np.sin(lag),
    }
    coarse = 8.0 * (2.0 * np.pi / n) ** 2 + 2e-4  # chords in place of arcs; a mean opening
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=coarse)
    assert found["period"] == pytest.approx(n, abs=0.5)
    assert abs(found["closure"]) < 0.1 * 40.0 / n


def test_a_sum_of_plays():
    """Each encloses ``4 r w (A - r)``; half the width at its middle is r, half the height w r."""
    u, r, w = triangle(2.0, 3), np.array([0.2, 0.5]), np.array([1.0, 3.0])
    for k in range(2):
        found = one(u, plays(u, 1.0, r[k : k + 1], w[k : k + 1]), skip=1)
        assert found["area"] == pytest.approx(4.0 * r[k] * w[k] * (2.0 - r[k]))
        assert found["coercivity"] == pytest.approx(r[k])
        assert found["remanence"] == pytest.approx(w[k] * r[k])
        assert found["opening"] == pytest.approx(2.0 * w[k] * r[k])
        assert found["closure"] == pytest.approx(0.0, abs=1e-12)
        assert found["area_std"] == pytest.approx(0.0, abs=1e-12)
    found = one(u, plays(u, 1.0, r, w), skip=1)
    assert found["area"] == pytest.approx(np.sum(4.0 * r * w * (2.0 - r)))
    assert found["remanence"] == pytest.approx(np.sum(w * r))


def test_a_relay():
    """Its remanence is the height, its coercivity the threshold, its area four times their product.

    Between two samples it jumps somewhere.
    """
    u, state, y = triangle(2.0, 3, 4000), -1.0, []
    for value in u:
        state = 1.0 if value > 0.7 else -1.0 if value < -0.7 else state
        y.append(3.0 * state)
    found = one(u, np.array(y), center="zero")
    step = 8.0 / 4000
    assert found["coercivity"] == pytest.approx(0.7, abs=step)
    assert found["remanence"] == 3.0
    assert found["area"] == pytest.approx(4.0 * 3.0 * 0.7, abs=12.0 * step)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_law_of_rayleigh(sign):
    """A Preisach model of constant density: the loss is 4/3 b A^3, the remanence b A^2 / 2.

    With the drive mirrored it goes clockwise.
    """
    a, b, amplitude = 1.5, 0.4, 2.0
    u = triangle(amplitude, 2, 4000)
    way = np.sign(np.gradient(u))
    y = (a + b * amplitude) * u - way * 0.5 * b * (amplitude**2 - u**2)
    found = one(u, sign * y)
    assert found["area"] == pytest.approx(sign * 4.0 / 3.0 * b * amplitude**3, rel=1e-5)
    assert found["remanence"] == pytest.approx(sign * 0.5 * b * amplitude**2, rel=1e-5)
    slope = a + b * amplitude
    coercivity = (-slope + np.sqrt(slope**2 + (b * amplitude) ** 2)) / b
    assert found["coercivity"] == pytest.approx(coercivity, rel=1e-5)


def test_the_center_of_a_loop_that_is_not_about_zero():
    u = triangle(1.0, 2) + 10.0
    y = plays(u, 1.0, [0.25], [2.0]) - 100.0
    found = one(u, y, skip=1)
    assert found["coercivity"] == pytest.approx(0.25)
    assert found["remanence"] == pytest.approx(0.5)
    found = one(u, y, skip=1, center="zero")
    assert np.isnan([found["coercivity"], found["remanence"]]).all()


def test_cycles_of_different_amplitude_and_period_are_loops_of_their_own():
    """The last cycle before a larger one ends where the drive passes its beginning."""
    u = np.concatenate([triangle(1.0, 3), triangle(1.0, 2, 200)[1:], triangle(2.0, 2)])
    found = loop_figures(u, plays(u, 1.0, [0.2], [1.0]))
    assert found["n_cycles"].tolist() == [3, 2, 2]
    np.testing.assert_allclose(found["high"], [1.0, 1.0, 2.0])
    np.testing.assert_allclose(found["period"], [400.0, 200.0, 400.0])
    np.testing.assert_allclose(found["area"][1:], [0.64, 1.44])
    assert found.index.tolist() == [(0, 0), (0, 1), (0, 2)]
    smaller = np.concatenate([triangle(2.0, 2), triangle(1.0, 2)[1:]])
    found = loop_figures(smaller, plays(smaller, 1.0, [0.2], [1.0]))
    assert found["n_cycles"].tolist() == [2, 1]  # the first one begins from a larger loop


def test_standard_errors_are_those_of_repeated_cycles():
    """Of 400 cycles with known scatter of the remanence: within 4 standard errors of it."""
    rng = np.random.default_rng(0)
    n_cycles, n = 400, 40
    u = triangle(1.0, n_cycles, n)
    height = np.repeat(rng.normal(2.0, 0.3, n_cycles), n)
    y = np.append(-np.sign(np.gradient(u))[:-1] * height, 0.0)
    found = one(u, y)
    assert found["n_cycles"] == n_cycles
    assert found["remanence"] == pytest.approx(2.0, abs=4.0 * 0.3 / 20.0)
    assert found["remanence_std"] == pytest.approx(0.3 / 20.0, rel=0.15)
    assert np.isnan(one(u[: n + 1], y[: n + 1])["remanence_std"])


def test_noise_makes_no_turning_points():
    rng = np.random.default_rng(0)
    u = triangle(1.0, 20)
    y = plays(u, 1.0, [0.2], [1.0]) + rng.normal(0.0, 0.01, len(u))
    found = one(u + rng.normal(0.0, 0.005, len(u)), y, skip=1)
    assert found["n_cycles"] == 19
    for name, value in (("area", 0.64), ("remanence", 0.2), ("coercivity", 0.2)):
        assert found[name] == pytest.approx(value, abs=4.0 * found[f"{name}_std"] + 0.005)


def test_records_without_closed_loops_say_so():
    index = pd.MultiIndex.from_product([["up", "loop", "decay"], 0.1 * np.arange(801)])
    index.names = ["record", "time"]
    decay = triangle(1.0, 2) * np.linspace(1.0, 0.0, 801)
    u = np.concatenate([np.linspace(0.0, 1.0, 801), triangle(1.0, 2), decay])
    X = pd.DataFrame({"u": u, "other": 0.0}, index)
    found = loop_figures(X, pd.Series(2.0 * u, index))
    assert found["n_cycles"].to_dict() == {("up", 0): 0, ("loop", 0): 2, ("decay", 0): 0}
    assert found.loc["up", "area":"closure_std"].isna().all(axis=None)
    np.testing.assert_allclose(found.loc[("loop", 0), ["area", "coercivity"]], 0.0, atol=1e-12)
    assert found.loc[("loop", 0), "period"] == pytest.approx(40.0)


@pytest.mark.parametrize("drive", [np.ones(60), np.repeat([0.0, 1.0, 0.0, 1.0, 0.0, 1.0], 10)])
def test_a_drive_that_rests_or_jumps_has_no_loop(drive):
    (found,) = loop_figures(drive, np.arange(60.0))["n_cycles"]
    assert found == 0


@pytest.mark.parametrize(("name", "value"), [("center", "top"), ("tolerance", 0.0), ("skip", -1)])
def test_wrong_parameters(name, value):
    with pytest.raises(ValueError, match=f"'{name}' parameter of loop_figures"):
        loop_figures(triangle(1.0, 1), triangle(1.0, 1), **{name: value})
