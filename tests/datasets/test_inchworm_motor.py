"""The simulated inchworm motor: its equations, its walk, and what identification finds in it."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lsim

from skhyst.compose import Cascade
from skhyst.datasets import decaying_sine, make_inchworm_motor, swept_sine, walking_drive
from skhyst.exceptions import RecordError
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import TransferFunction
from skhyst.records import stack_records

DT = 1e-4
LAWS = ("bouc_wen", "prandtl_ishlinskii")
C1 = 0.2657 / 2.312e6 * 1e6  # um/V
SILENT = {"noise": 0.0, "resolution": 0.0}


def sweep(duration, high):
    return swept_sine(0.1, high, duration=duration, amplitude=5.0, dt=DT)["drive"].to_numpy()


def decaying(n=8001):
    return decaying_sine()["drive"].to_numpy()[:n]


def test_without_hysteresis_it_is_the_printed_transfer_function():
    u = sweep(0.5, 500.0)
    _, y, truth = make_inchworm_motor(u, hysteresis=None, substeps=3, **SILENT)
    denominator = [3.04, 58.0, 2.312e6]
    _, expected, _ = lsim(([58.0 * C1, 2.312e6 * C1], denominator), u, DT * np.arange(u.size))
    assert np.allclose(y, expected, rtol=0, atol=1e-9)
    assert np.array_equal(y, truth.response)
    # (15), as rounded in print
    _, printed, _ = lsim(([6.664e-6, 0.2657], denominator), u, DT * np.arange(u.size))
    assert np.allclose(y, 1e6 * printed, rtol=0, atol=1e-3 * np.ptp(y))
    assert truth.parameters["frequency"] == pytest.approx(138.8, abs=0.05)
    assert 2 * truth.parameters["damping_ratio"] * 2.312e6 == pytest.approx(
        58.0 * 2 * np.pi * truth.parameters["frequency"]
    )


@pytest.mark.parametrize("law", LAWS)
def test_the_hysteresis_is_that_of_the_figures(law):
    """+-0.4 um less the loop at 3.5 V; open by 15 to 20 % of the stroke; independent of rate."""
    loops = {}
    for frequency in (0.5, 2.0):
        time = DT * np.arange(round(2.0 / frequency / DT) + 1)
        u = 3.5 * np.sin(2 * np.pi * frequency * time)
        _, y, truth = make_inchworm_motor(u, hysteresis=law, **SILENT)
        loops[frequency] = truth.signals["hysteresis"].to_numpy()
        second = slice(time.size // 2, None)
        stroke = np.ptp(y.iloc[second])
        opening = np.ptp(y.to_numpy()[second][np.abs(u[second]) < 0.02]) / stroke
        assert 0.6 < stroke < 0.8
        assert 0.15 < opening < 0.20
    assert np.allclose(loops[0.5][::4], loops[2.0], atol=1e-3 * C1)


@pytest.mark.parametrize("law", LAWS)
def test_finer_steps_converge(law):
    drive, options = decaying(4001)[::10], {"dt": 10 * DT, "hysteresis": law, **SILENT}
    *runs, fine = (make_inchworm_motor(drive, substeps=n, **options)[1] for n in (4, 16, 200))
    errors = [np.abs(run - fine).max() for run in runs]
    assert errors[1] < 2e-4 * np.ptp(fine)
    assert errors[0] > 4.0 * errors[1]


def test_the_seed_fixes_everything():
    effects = ["offset", "periodic_disturbance", "auxiliary_input"]
    runs = [make_inchworm_motor(decaying(500), effects=effects, random_state=s) for s in (1, 1, 2)]
    pd.testing.assert_series_equal(runs[0][1], runs[1][1])
    pd.testing.assert_frame_equal(runs[0][0], runs[1][0])
    assert not np.allclose(runs[0][1], runs[2][1], atol=1e-3)
    silent = make_inchworm_motor(decaying(500), effects=effects, random_state=1, **SILENT)
    assert np.array_equal(silent[1], runs[0][2].response)


def test_noise_and_resolution_are_as_declared():
    X, y, truth = make_inchworm_motor(noise=5e-4, resolution=1e-3, random_state=0)
    assert len(X) == 35_001
    assert X["drive"].max() == pytest.approx(3.5 * np.exp(-0.05), rel=1e-3)
    assert np.std(y - truth.response) == pytest.approx(truth.noise_std, rel=0.03)
    assert np.allclose(y / 1e-3, np.round(y / 1e-3), atol=1e-9)


def test_records_are_simulated_one_by_one_and_keep_their_index():
    first, second = decaying(300), 1.0 + decaying(400)
    X = stack_records({"a": first, "b": second}, dt=DT)
    found, y, _ = make_inchworm_motor(X, **SILENT)
    assert found.index.equals(X.index)
    alone = [make_inchworm_motor(u, **SILENT)[1] for u in (first, second)]
    assert np.array_equal(y, np.concatenate(alone))
    # from rest: nothing moves while the drive stands
    still = make_inchworm_motor(np.full(200, -2.0), **SILENT)[1]
    assert np.ptp(still) < 1e-12
    assert y.index.equals(X.index)
    uneven = pd.DataFrame({"drive": np.zeros(4)}, pd.Index([0.0, 1.0, 2.1, 9.0], name="time"))
    with pytest.raises(RecordError):
        make_inchworm_motor(uneven)
    # an array, a list and a frame without times are one record
    for drive in (first, first[:, None], list(first), pd.DataFrame({"voltage": first})):
        X, y, _ = make_inchworm_motor(drive, **SILENT)
        assert list(X.index.names) == ["record", "time"]
        assert np.array_equal(y, alone[0])


@pytest.mark.parametrize("waveform", ["sine", "trapezoid"])
@pytest.mark.parametrize("direction", [1, -1])
def test_it_walks_two_strokes_a_period(direction, waveform):
    drive = walking_drive(20, direction=direction, waveform=waveform, frequency=5.0)
    assert drive.shape[1] == 4
    _, y, truth = make_inchworm_motor(drive, hysteresis=None, **SILENT)
    foot = truth.signals["actuator"].to_numpy()
    assert foot[-1] - foot[0] == pytest.approx(direction * 20 * 2 * 5.0 * C1, rel=1e-3)
    assert abs(y.iloc[-1] - foot[-1]) < 0.05 * C1 * 5.0
    assert set(truth.signals["contact"]) == {1, 2}
    # hysteresis costs travel, in every step as much
    _, y, truth = make_inchworm_motor(drive, **SILENT)
    foot = direction * truth.signals["actuator"].to_numpy()
    steps = np.diff(foot[:: len(foot) // 20])[2:]
    assert np.ptp(steps) < 0.01 * steps.mean()
    assert 0.5 * 10.0 * C1 < steps.mean() < 10.0 * C1


def test_pairs_that_move_alike_do_not_walk():
    """With equal voltages on both pairs, as (1) is printed, the runner stays within a stroke."""
    drive = walking_drive(20)
    drive["drive_2"] = drive["drive"]
    _, y, _ = make_inchworm_motor(drive, **SILENT)
    assert y.abs().max() < 1.05 * 5.0 * C1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"drive": np.zeros((5, 2))}, r"'drive' .* one column or four. Got \(5, 2\)"),
        ({"drive": [1.0]}, "'drive' .* at least two rows"),
        ({"drive": [0.0, np.nan]}, "'drive' .* finite. Got 'NaN or infinity'"),
        ({"hysteresis": "duhem"}, "'hysteresis' .* 'bouc_wen', .* Got 'duhem'"),
        ({"noise": -1.0}, "'noise' .* not negative. Got -1.0"),
        ({"substeps": 0}, "'substeps' .* whole number of at least 1. Got 0"),
        ({"dt": 0.0}, "'dt' .* number, positive. Got 0.0"),
        ({"effects": "magic"}, "'effects' parameter of make_inchworm_motor .* Got 'magic'"),
        ({"drive": walking_drive(1), "effects": "cubic_stiffness"}, "must not hold cubic_stiff"),
    ],
)
def test_wrong_parameters_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        make_inchworm_motor(**options)


@pytest.mark.parametrize(
    "options",
    [{"n_steps": 0}, {"amplitude": -1.0}, {"frequency": 1e4}, {"direction": 0}, {"waveform": "x"}],
)
def test_wrong_walks_are_refused(options):
    with pytest.raises(ValueError, match=f"'{next(iter(options))}' parameter of walking_drive"):
        walking_drive(**options)


def test_the_first_mode_is_found_through_the_hysteresis():
    """138.8 Hz within 0.5 %, with the hysteresis identified jointly and with it compensated."""
    frequency = np.sqrt(2.312e6 / 3.04) / (2 * np.pi)
    slow = make_inchworm_motor(decaying(8001)[::4], dt=4 * DT, random_state=0)
    plays = PrandtlIshlinskii(20).fit(slow[0], slow[1])
    reference = pd.DataFrame({"drive": sweep(1.0, 400.0)})
    drive = plays.inverse_predict(plays.params_["intercept"] + C1 * reference)
    X, y, _ = make_inchworm_motor(drive, random_state=1)
    X["drive"] = reference["drive"].to_numpy()
    compensated = TransferFunction(2).fit(X, y).operator_
    X, y, _ = make_inchworm_motor(reference, random_state=1)
    model = Cascade([("plays", PrandtlIshlinskii(8)), ("mode", TransferFunction(2))]).fit(X, y)
    for mode in (compensated, model.operator_.stages[1]):
        pole = mode.poles()[0]
        assert abs(pole) / (2 * np.pi) == pytest.approx(frequency, rel=5e-3)
