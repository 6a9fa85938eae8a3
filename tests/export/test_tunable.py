"""Parameters that change at run time, and rest at another input, are those of the Python model."""

import re
import shutil

import numpy as np
import pytest
from c_programs import error_of
from operator_cases import DT, OPERATORS, make_drive

from skhyst.control import FeedforwardPI, InverseCompensator
from skhyst.export import to_c
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.linear import FirstOrderLagOperator, SecondOrderModeOperator
from skhyst.operators import Series, Stepper

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
STAGE = Series(
    ("plays", "mode"),
    (
        PrandtlIshlinskiiOperator([0.0, 0.21, 0.43], [1.0, 0.4, 0.3]),
        SecondOrderModeOperator(60.0, 0.2, gain=1.3, intercept=0.1),
    ),
)


def outputs_of(folder, name, which):
    """Return what the test program expects."""
    text = (folder / f"{name}_test.c").read_text()
    values = re.search(rf"{name}_{which}\[N_SAMPLES\] = {{\n([^}}]*)}}", text)[1]
    return np.array([float(x) for x in values.split(",")[:-1]])


@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_other_parameters_answer_as_a_model_that_has_them(tmp_path, dtype):
    tunable = ("weights", "mode__gain", "natural_frequency", "damping_ratio")
    u = make_drive().astype(dtype).astype(float)
    to_c(STAGE, tmp_path, "stage", dtype, dt=DT, drive=u, tunable=tunable)
    assert error_of(tmp_path, "stage") <= {"float64": 1e-12, "float32": 1e-5}[dtype]
    header = (tmp_path / "stage.h").read_text()
    assert "plays__weights[3]; /* response/drive: 0.5 to 1.5; 0.2 to 0.6; 0.15 to 0.45 */" in header
    assert "mode__natural_frequency; /* rad/s: 30 to 90 */" in header
    # of the test the parameters are at 0.7 and 0.3 of their ranges in turn
    plays = PrandtlIshlinskiiOperator([0.0, 0.21, 0.43], [1.2, 0.32, 0.36])
    mode = SecondOrderModeOperator(48.0, 0.24, gain=1.04, intercept=0.1)
    if header.index("natural_frequency") > header.index("mode__gain"):  # as they are named
        mode = SecondOrderModeOperator(72.0, 0.16, gain=1.04, intercept=0.1)
    other = Series(("plays", "mode"), (plays, mode))
    expected, _ = other.run(u, DT, other.init(0.0))
    found = outputs_of(tmp_path, "stage", "tuned_outputs")
    bar = {"float64": 1e-12, "float32": 1e-6}[dtype] * np.ptp(expected)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=bar)


def test_plays_of_weight_zero_are_left_out_unless_they_may_change(tmp_path):
    plays = PrandtlIshlinskiiOperator([0.0, 0.1, 0.2, 0.3], [1.0, 0.0, 0.5, 0.0])
    few = PrandtlIshlinskiiOperator([0.0, 0.2], [1.0, 0.5])
    u = make_drive()
    header, source, _ = to_c(plays, tmp_path, "plays", dt=DT, drive=u)
    assert "double s[2];" in header.read_text()
    assert error_of(tmp_path, "plays") <= 1e-12
    assert source.read_text() == to_c(few, tmp_path, "plays", dt=DT, drive=u)[1].read_text()
    header, *_ = to_c(plays, tmp_path, "plays", dt=DT, drive=u, tunable={"weights": (0.0, 1.0)})
    assert "double s[4];" in header.read_text()
    assert error_of(tmp_path, "plays") <= 1e-12
    stops = PrandtlIshlinskiiOperator([0.0, 0.1, 0.2], [0.0, 0.0, 0.0], intercept=0.5)
    assert Stepper(stops.compiled_step(DT, stops.init(0.3))).run(u).tolist() == [0.5] * len(u)
    to_c(stops, tmp_path, "plays", dt=DT, drive=u)
    assert error_of(tmp_path, "plays") == 0.0


def test_rest_at_another_input_is_that_of_the_model(tmp_path):
    u = make_drive()
    to_c(STAGE, tmp_path, "stage", dt=DT, u0=0.2, drive=u)
    assert error_of(tmp_path, "stage") <= 1e-12
    level = 0.61 * u.max() + 0.39 * u.min()
    expected, _ = STAGE.run(u, DT, STAGE.init(level))
    found = outputs_of(tmp_path, "stage", "rest_outputs")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("case", ["rate-dependent plays, thresholds", "friction stage"])
def test_a_rest_that_is_not_known_is_not_written(tmp_path, case):
    """One step at a high rate does not lead to it, and no affine state is at rest there."""
    header, *_ = to_c(OPERATORS[case], tmp_path, "own", dt=DT, drive=make_drive())
    assert "own_init_at(" not in header.read_text()


def test_a_compensator_begins_at_another_reference(tmp_path):
    u = make_drive()[:, None]
    y = OPERATORS["plays"].run(u[:, 0], DT)[0]
    compensator = InverseCompensator(PrandtlIshlinskii(thresholds=[0.0, 0.21, 0.43], dt=DT))
    compensator.fit(u, y)
    to_c(compensator, tmp_path, "inverse", drive=y, tunable={"intercept": (-1.0, 1.0)})
    assert error_of(tmp_path, "inverse") <= 1e-12
    header, *_ = to_c(compensator, tmp_path, "inverse", drive=y)
    assert "void inverse_init_at(inverse_state *state, double u);" in header.read_text()
    assert error_of(tmp_path, "inverse") <= 1e-12


def test_gains_of_a_controller_are_changed(tmp_path):
    rows = np.random.default_rng(0).normal(size=(100, 2))
    controller = FeedforwardPI(1.0, 40.0, notch=(20.0, 0.1))
    gains = {"kp": (0.5, 2.0), "ki": (0.0, 90.0)}
    header, *_ = to_c(controller, tmp_path, "loop", dt=DT, drive=rows, tunable=gains)
    assert "double kp; /* 0.5 to 2 */\n    double ki; /* 0 to 90 */" in header.read_text()
    assert error_of(tmp_path, "loop") <= 1e-12
    expected = FeedforwardPI(1.55, 27.0, notch=(20.0, 0.1)).stepper(DT).run(rows)
    found = outputs_of(tmp_path, "loop", "tuned_outputs")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.ptp(expected))


@pytest.mark.parametrize(
    ("tunable", "message"),
    [
        (["stiffness"], r"each of one of \['gain', 'intercept', 'time_constant'\]"),
        (["gain", "time_constant", "time"], "Got 'time' instead"),
        (["gain", "stage_order"], "Got 'stage_order' instead"),  # a number, but no parameter
        ({"gain": (2.0, 3.0)}, "'gain' a range around its value 1"),
        (["intercept"], r"'intercept' a range around its value 0 .* as .*: \(-0.5, 0.5\)"),
        ({"time_constant": (0.0, 1.0)}, "'time_constant' a range around its value 0.05"),
        ({"time_constant": (1e-6, 1.0)}, "smoothly within their ranges"),
    ],
)
def test_what_cannot_be_changed_is_refused(tmp_path, tunable, message):
    with pytest.raises(ValueError, match=message):
        to_c(FirstOrderLagOperator(0.05), tmp_path, "lag", dt=DT, tunable=tunable)


def test_what_only_the_start_depends_on_is_refused(tmp_path):
    with pytest.raises(ValueError, match="not only the state that it starts from"):
        to_c(OPERATORS["free mass"], tmp_path, "mass", dt=DT, tunable=["intercept"])


def test_the_model_of_what_is_tunable_is_known(tmp_path):
    lag = FirstOrderLagOperator(0.05)
    stepper = Stepper(lag.compiled_step(DT, lag.init(0.0)), DT)
    units = {"input_unit": 0.1, "output_unit": 0.1, "drive": [0.0, 1.0]}
    for model, dtype, more in ((stepper, "float64", {}), (lag, "int32", units)):
        with pytest.raises(ValueError, match="must be empty for 'int32'"):
            to_c(model, tmp_path, "lag", dtype, dt=DT, tunable=["gain"], **more)
