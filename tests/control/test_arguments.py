"""What drives hardware refuses, by its name, an argument that is none, and samples not finite."""

import warnings

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Corrected, Modulated, ScheduledParameters
from skhyst.control import (
    FeedforwardPI,
    IntegralResonantControl,
    InverseCompensator,
    Observer,
    simulate_loop,
)
from skhyst.exceptions import ConvergenceWarning
from skhyst.export import to_c
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    ModalModel,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.neural import SCNRegressor
from skhyst.operators import Stepper

DT = 1e-3
U = np.random.default_rng(0).normal(size=(300, 2))
Y = SecondOrderModeOperator(500.0, 0.03, gain=0.2).run(U[:, 0], DT)[0]
NO_INTERVAL = (np.nan, np.inf, 0.0, -1.0, "1", [DT], 1j, 1e-300)
NOT_FINITE = (np.nan, -np.inf, "1", None, 1j, [0.0, [1.0]])


def device():
    return Stepper(GainOperator(1.0).compiled_step(DT, ()))


@pytest.fixture(scope="module")
def models():
    one, two, noise = U[:, :1], U, 1e-3 * U[:, 1]
    mode = SecondOrderMode(dt=DT).fit(one, Y)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of one amplitude
        scheduled = ScheduledParameters(Gain(), dt=DT).fit(one, Y)
    return {
        "SecondOrderMode": mode,
        "Modulated": Modulated(Gain(), 1, dt=DT).fit(two, Y),
        "ScheduledParameters": scheduled,
        "Corrected": Corrected(Ridge(), FirstOrderLag(), max_iter=0, dt=DT).fit(two, Y),
        "NARXRegressor": NARXRegressor(dt=DT).fit(two, Y),
        "ModalModel": ModalModel(1, dt=DT).fit(two, Y),
        "SCNRegressor": SCNRegressor(3, random_state=0).fit(two, Y),
        "Observer": Observer(mode).fit(one, Y + noise),
        "InverseCompensator": InverseCompensator(mode).fit(one, Y),
    }


def assert_named(call, name, values, /, **others):
    """Each value is refused by the name of the parameter, with what was got."""
    for value in values:
        with pytest.raises(ValueError, match=rf"The '{name}' parameter of \w+.* must be .*Got "):
            call(**{name: value}, **others)


MODELS = ("SecondOrderMode", "Modulated", "ScheduledParameters", "Corrected", "NARXRegressor")
MODELS += ("ModalModel", "SCNRegressor", "Observer", "InverseCompensator")


@pytest.mark.parametrize("name", MODELS)
def test_models_are_stepped_from_what_is_a_device_at_rest(models, name):
    model = models[name]
    options = {"schedule": 1.0} if name == "ScheduledParameters" else {}
    assert_named(model.stepper, "dt", NO_INTERVAL, **options)
    if name == "InverseCompensator":
        assert_named(model.stepper, "reference", [*NOT_FINITE, [0.0, 1.0]])
        assert_named(model.stepper, "preview", [np.nan, 1.5, -1, "1"])
        assert_named(model.preview, "dt", NO_INTERVAL)
        return
    assert_named(model.stepper, "u0", NOT_FINITE, **options)
    assert_named(model.stepper, "u0", [[0.0, np.nan], [], ["0", "1"], np.zeros(9)], **options)
    if name != "Observer":
        assert_named(
            model.stepper, "initial_state", ["estimate", "at rest", 0.0, np.nan], **options
        )
    if name == "ScheduledParameters":
        assert_named(model.stepper, "schedule", NOT_FINITE[:3])


def test_drives_are_asked_for_with_an_interval_and_numbers(models):
    compensator, reference = models["InverseCompensator"], np.zeros(5)
    assert_named(compensator.drive_for, "dt", [*NO_INTERVAL, None], reference=reference)
    broken = [*NOT_FINITE, [0.0, np.inf], [], [[0.0]], ["0"], 1.0]
    assert_named(compensator.drive_for, "reference", broken, dt=DT)


@pytest.mark.parametrize("compensator", [None, "InverseCompensator"])
def test_controllers_are_stepped_from_what_is_one(models, compensator):
    own = models.get(compensator)
    stepper = FeedforwardPI(1.0, 1.0, compensator=own).stepper
    assert_named(stepper, "dt", [*NO_INTERVAL, None])
    for name in ("reference", "u0"):
        assert_named(stepper, name, NOT_FINITE, dt=DT)
    controlling = FeedforwardPI(1.0, 1.0, compensator=own).controlling
    assert_named(controlling, "dt", [*NO_INTERVAL, None], reference=np.zeros(3))
    assert_named(controlling, "reference", [*NOT_FINITE, [0.0, np.nan], [], 1.0], dt=DT)
    assert_named(controlling, "u0", [np.nan, np.inf, "1"], dt=DT, reference=np.zeros(3))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("kp", NOT_FINITE),
        ("ki", NOT_FINITE),
        ("compensator", [3.0, "inverse"]),
        ("damping", [3.0, (60.0, 0.1)]),
        ("notch", [np.nan, (np.nan, 0.1), (60.0, np.nan), (60.0, np.inf), 60.0, "60", ("60", "1")]),
        ("notch", [(0.0, 0.1), (-60.0, 0.1), (500.0, 0.1), (60.0, -0.1), (60.0, 0.1, 1.0)]),
        ("drive_limits", [(np.nan, 1.0), (0.0, np.nan), (1.0, 1.0), (1.0, 0.0), 1.0, "01", (1.0,)]),
        ("drive_limits", [(0.0, 1.0, 2.0), ("0", "1"), (None, 1.0)]),
    ],
)
def test_constants_of_controllers_are_numbers(name, values):
    for value in values:
        controller = FeedforwardPI(**{"kp": 1.0, "ki": 1.0} | {name: value})
        with pytest.raises(ValueError, match=f"The '{name}' parameter of FeedforwardPI must"):
            controller.stepper(DT)


def test_damping_is_of_a_mode():
    section = IntegralResonantControl((60.0, 0.4)).section
    assert_named(section, "dt", [*NO_INTERVAL, None])
    for mode in (np.nan, (np.nan, 1.0), (60.0, np.inf), (60.0, 0.0), (500.0, 1.0), 60.0, "60"):
        with pytest.raises(ValueError, match="The 'mode' parameter of IntegralResonantControl"):
            IntegralResonantControl(mode).section(DT)
    for ratio in (*NOT_FINITE, 0.0, -0.1):
        with pytest.raises(ValueError, match="The 'damping_ratio' parameter of Integral"):
            IntegralResonantControl((60.0, 0.4), damping_ratio=ratio).section(DT)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("device", [None, 1.0, np.sin]),
        ("controller", [None, 1.0, np.sin]),
        ("reference", [*NOT_FINITE, [0.0, np.nan], [], [[0.0]], ["0"], 1.0]),
        ("dt", [*NO_INTERVAL, None]),
        ("u0", [np.nan, np.inf, "1", [0.0]]),
        ("noise", [*NOT_FINITE, np.inf, -1.0]),
        ("resolution", [*NOT_FINITE, np.inf, -1.0]),
        ("delay", [np.nan, np.inf, 1.5, 1.0, -1, "1", None]),
        ("random_state", [1.5, -1, "seed"]),
    ],
)
def test_loops_are_closed_around_what_is_one(name, values):
    whole = {"device": device(), "controller": FeedforwardPI(1.0, 1.0)}
    whole |= {"reference": [0.0, 1.0], "dt": DT}
    assert_named(simulate_loop, name, values, **{k: v for k, v in whole.items() if k != name})


def test_what_is_written_as_c_has_an_interval(tmp_path, models):
    for model in (models["SecondOrderMode"], GainOperator(1.0), device(), device().compiled_step):
        assert_named(to_c, "dt", NO_INTERVAL, model=model, folder=tmp_path, name="m")
    for model in (models["SecondOrderMode"], FirstOrderLagOperator(0.1)):
        broken = {"model": model, "folder": tmp_path, "name": "m", "dt": DT}
        assert_named(to_c, "u0", [np.nan, np.inf, "1"], **broken)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="'dt' parameter of Stepper"):
        Stepper(device().compiled_step, np.nan)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, "x", None, [1.0, 2.0, [3.0]]])
def test_a_sample_that_is_none_changes_nothing(models, value):
    """Of a model, an observer and a controller: what is next is as if it had not been."""
    controller = FeedforwardPI(1.0, 40.0, notch=(80.0, 0.05), drive_limits=(-1.0, 1.0))
    mode, observer = models["SecondOrderMode"], models["Observer"]
    for stepper, rows in (
        (mode.stepper(), U[:, 0]),
        (observer.stepper(), U),
        (controller.stepper(DT), U),
    ):
        stepper.run(rows[:50])
        before, other = stepper.state, stepper.copy()
        broken = value if rows.ndim == 1 else [0.1, value]
        with pytest.raises(ValueError, match=r"must be (finite|one number|a row|a sequence)"):
            stepper.step(broken)
        with pytest.raises(ValueError, match=r"must be (finite|one number|a row|a sequence)"):
            stepper.run([rows[0], rows[1], broken])
        np.testing.assert_array_equal(stepper.state, before)
        np.testing.assert_array_equal(stepper.run(rows[50:]), other.run(rows[50:]))
