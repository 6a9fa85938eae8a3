"""What every operator must do, whatever it is."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.compose import ColumnOperator, ModulatedOperator, ScheduledOperator
from skhyst.discovery import all_operators
from skhyst.disturbance import DriftOperator, OffsetOperator, SinusoidOperator
from skhyst.fluid import TankChainOperator
from skhyst.hysteresis import (
    BacklashOperator,
    BoucWenOperator,
    BoucWenStageOperator,
    CoulombFrictionOperator,
    DahlOperator,
    DuhemOperator,
    FrictionStageOperator,
    JilesAthertonOperator,
    KrasnoselskiiPokrovskiiOperator,
    LuGreOperator,
    MaxwellSlipOperator,
    PrandtlIshlinskiiOperator,
    PreisachOperator,
    RateDependentPrandtlIshlinskiiOperator,
    RestoringForceOperator,
    SlewLimitOperator,
    SystemLevelOperator,
    TanhHysteresisOperator,
)
from skhyst.linear import (
    DelayOperator,
    DynamicStiffnessOperator,
    FirstOrderLagOperator,
    GainOperator,
    KelvinVoigtOperator,
    LogCreepOperator,
    MultiInputTransferFunctionOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from skhyst.neural import GrayBoxOperator
from skhyst.operators import FrozenOperator, SeriesOperator, SumOperator
from skhyst.static import (
    DeadBandOperator,
    DeadZoneOperator,
    MonotoneDeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
    SoftSaturationOperator,
    StaticOperator,
)

DT = 0.01
N = 60


def make_operators():
    lag = FirstOrderLagOperator(0.03, gain=1.4, intercept=-0.2)
    mode = SecondOrderModeOperator(90.0, 0.15, gain=0.8, intercept=0.1)
    plays = PrandtlIshlinskiiOperator(
        np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), 0.05, 0.031
    )
    transfer = TransferFunctionOperator(
        np.array([0.02]), np.array([70.0]), np.array([0.3]), np.array([0.2, -0.1]), 1.3, 0.4
    )
    creep = KelvinVoigtOperator(np.array([0.2, 0.1]), np.array([0.02, 0.3]), 1.5, 0.3)
    drift = DriftOperator(np.array([0.3, -0.5, 0.2]), 0.4)
    zones = DeadZoneOperator(np.array([0.4, -0.2]), np.array([0.313, -0.207]), np.array([1, -1]))
    return {
        "lag": lag,
        "lag, zero-order hold": dataclasses.replace(lag, hold="zoh"),
        "mode": mode,
        "mode, overdamped": dataclasses.replace(mode, damping_ratio=3.0),
        "mode, zero-order hold": dataclasses.replace(mode, hold="zoh"),
        "creep": creep,
        "creep, zero-order hold": dataclasses.replace(creep, hold="zoh"),
        "creep, logarithmic": LogCreepOperator(0.3, 0.05, 1.5, 0.3, longest=10.0),
        "creep, logarithmic, zero-order hold": LogCreepOperator(0.3, 0.05, 1.5, 0.3, hold="zoh"),
        "transfer function": transfer,
        "transfer function, feed-through": TransferFunctionOperator(
            np.empty(0), np.array([70.0]), np.array([0.3]), np.array([0.2, -0.1]), hold="zoh"
        ),
        "transfer function, no zeros": TransferFunctionOperator(
            np.array([0.02, 0.05]), np.empty(0), np.empty(0), np.empty(0)
        ),
        "delay below one sample": DelayOperator(0.0037),
        "delay of several samples": DelayOperator(0.0537),
        "delay beyond the record": DelayOperator(7.3),
        "no limit": SaturationOperator(),
        "upper limit": SaturationOperator(upper=0.413),
        "both limits": SaturationOperator(-0.311, 0.413),
        "tanks": TankChainOperator(
            [0.11, 0.23], [0.5, 0.7], drive_offset=-0.73, gain=1.3, intercept=0.1, scale=0.8
        ),
        "tanks, overflow": TankChainOperator(
            [0.11, 0.23, 0.03],
            [0.5, 0.7, 1.6],
            [1.07, 1.13, 1.11],
            [0.7, 0.4],
            drive_offset=-0.37,
            gain=1.3,
            hold="zoh",
            n_substeps=2,
        ),
        "tanks, limited reading": TankChainOperator(
            [0.11, 0.03], [0.5, 0.7], [0.83, 0.77], [0.9], drive_offset=-0.37, limit="reading"
        ),
        "soft saturation": SoftSaturationOperator(0.413, 1.7, 0.037),
        "soft saturation, upper": SoftSaturationOperator(0.213, 7.3, -0.037, side=1, rank=0),
        "dead band": DeadBandOperator(0.213, 0.037),
        "backlash": BacklashOperator(0.137),
        "slew limit": SlewLimitOperator(13.7),
        "slew limit, always": SlewLimitOperator(0.37),
        "dead zones": zones,
        "curve": PolynomialCurveOperator(np.array([0.2, -0.1, 0.05]), center=0.1, scale=0.7),
        "Coulomb friction": CoulombFrictionOperator(
            1.3, 0.8, 2.9, 0.3, 0.1, 0.3, 0.02, 0.1, slowest=0.01, fastest=50.0, smoothing=3
        ),
        "dynamic stiffness": DynamicStiffnessOperator(1e-3, 0.02, 0.7, 0.1, smoothing=2),
        "dynamic stiffness, of a velocity": DynamicStiffnessOperator(
            0.02, 0.7, intercept=0.1, drive="velocity"
        ),
        "Dahl friction": DahlOperator(0.11, 0.8, stiffness=0.3, damping=0.02, intercept=0.1),
        "Dahl friction, soft": DahlOperator(0.11, 0.8, damping=0.01, exponent=1.7),
        "Dahl friction, hard": DahlOperator(0.31, 0.8, exponent=0.6),
        "LuGre friction": LuGreOperator(0.11, 2.3, 0.6, 0.8, 0.03, 0.3, 0.02, 0.1),
        "slip elements": MaxwellSlipOperator(
            np.array([0.11, 0.213, 0.43]), np.array([0.6, 0.4, 0.3]), 0.2, 0.013, 0.1
        ),
        "Duhem": DuhemOperator(3.1, np.array([0.9]), np.array([0.4]), 0.1),
        "Duhem, cubic": DuhemOperator(
            2.3, np.array([0.9, 0.1, -0.2]), np.array([0.4, 0.1, 0.2]), 0.1, 0.21, 1.3
        ),
        "relays": PreisachOperator(
            np.array([-0.41, -0.1, 0.23, 0.5, 0.83]),
            np.array([0.3, 0.1, 0.4, 0.2, 0.5, 0.1, 0.3, 0.1, 0.2, 0.6]),
            np.array([0.2, 0.1, 0.4, 0.3]),
            0.1,
            0.117,
        ),
        "relays, all down at first": PreisachOperator(
            np.array([-0.1, 0.23, 0.5]), np.array([0.3, 0.1, 0.4]), center=-np.inf
        ),
        "ramps": KrasnoselskiiPokrovskiiOperator(
            np.array([-0.41, -0.1, 0.23, 0.83]),
            np.array([0.3, 0.1, 0.4, 0.2, 0.5, 0.1]),
            0.1,
            0.117,
        ),
        "tanh": TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.1),
        "system level": SystemLevelOperator(1.1, 0.4, 0.7, 0.1),
        "system level, as printed": SystemLevelOperator(1.1, 0.4, 2.7, 0.1, 0.003, "printed"),
        "gray box": GrayBoxOperator(
            SystemLevelOperator(1.1, 0.4, 0.7, 0.1), np.array([0.3, -0.1, 0.4, -0.3])
        ),
        "gray box, products": GrayBoxOperator(
            SystemLevelOperator(1.1, 0.4, 2.7, 0.1, 0.003, "printed"),
            np.r_[0.3, 0.4, -0.3, 0.02 * np.cos(np.arange(9))],
            1,
            2,
            2,
        ),
        "gray box, as printed": GrayBoxOperator(
            SystemLevelOperator(1.1, 0.4, 0.7, 0.1),
            np.r_[0.3, -0.1, 0.4, -0.3, 0.02 * np.cos(np.arange(10))],
            degree=2,
            dynamics="printed",
        ),
        "Jiles-Atherton": JilesAthertonOperator(1.3, 0.11, 0.15, 0.6, 0.2, 0.3, 0.1),
        "Bouc-Wen": BoucWenOperator(0.4, 0.7, 0.31, 0.6, 1.0, 0.0, 0.1),
        "Bouc-Wen, asymmetric": BoucWenOperator(0.4, -0.3, 0.47, 1.6, 1.7, 0.3, 0.1),
        "offset": OffsetOperator(np.array([0.7])),
        "drift": drift,
        "sinusoid": SinusoidOperator(np.array([0.5, 0.1, -0.2, 0.3]), np.array([3.0, 11.0])),
        "plays": plays,
        "plays, stop form": dataclasses.replace(plays, form="stop"),
        "plays, stop form, no spring left": PrandtlIshlinskiiOperator(
            np.array([0.21, 0.43]), np.array([1.0, 0.4]), form="stop"
        ),
        "monotone dead zones": MonotoneDeadZoneOperator(
            np.array([0.6, 1.3, 0.4]), np.array([-0.207, 0.313, 0.611]), n_lower=1
        ),
        "rate-dependent plays, thresholds": RateDependentPrandtlIshlinskiiOperator(
            np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), (), 0.1, 0.011
        ),
        "rate-dependent plays, weights": RateDependentPrandtlIshlinskiiOperator(
            np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), np.array([0.01, -0.02, 0.03])
        ),
        "series": SeriesOperator(
            ("delay", "plays", "zones", "lag"), (DelayOperator(0.013), plays, zones, lag)
        ),
        "series of linear ones": SeriesOperator(("lag", "mode"), (lag, mode)),
        "sum": SumOperator(("plays", "mode", "drift"), (plays, mode, drift)),
        "series of sums": SeriesOperator(
            ("plays", "modes"), (plays, SumOperator(("first", "second"), (mode, transfer)))
        ),
        "sum of series": SumOperator(
            ("series", "creep"), (SeriesOperator(("plays", "lag"), (plays, lag)), creep)
        ),
        "friction stage": FrictionStageOperator(
            90.0, 0.15, 0.29, 0.7, 3.0, 8.0, 0.1, 0.8, 0.1, n_substeps=4
        ),
        "friction stage, stiff bristles": FrictionStageOperator(
            20.0, 3.0, 0.03, 0.7, 0.3, 1e3, n_substeps=1
        ),
        "restoring force": RestoringForceOperator(
            90.0, 0.15, [0.2, 0.05], [0.1], 2.0, 0.1, 0.07, 0.8, 0.1, scale=0.9, n_substeps=4
        ),
        "restoring force, no polynomials": RestoringForceOperator(
            20.0, 3.0, [], [], 1e3, 0.1, n_substeps=1
        ),
        "restoring force, no hysteresis": RestoringForceOperator(
            90.0, 0.15, [0.2], [0.1], 0.0, 0.5, 0.07, 0.8, 0.1, scale=0.9, n_substeps=4
        ),
        "Bouc-Wen stage": BoucWenStageOperator(
            90.0, 0.15, 2.0, 0.1, 0.3, 1.7, 0.8, 0.1, n_substeps=4
        ),
        "Bouc-Wen stage without limit": BoucWenStageOperator(
            20.0, 3.0, 3.0, 0.8, -1.3, 1.01, n_substeps=1
        ),
        "empty sum": SumOperator((), ()),
        "gain": GainOperator(1.3, 0.2),
        "held": FrozenOperator(plays),
        "series with a held series": SeriesOperator(
            ("delay", "held", "lag"),
            (DelayOperator(0.013), FrozenOperator(SeriesOperator(("p", "z"), (plays, zones))), lag),
        ),
        "sum with a held one": SumOperator(("lag", "creep"), (lag, FrozenOperator(creep))),
        "scheduled": ScheduledOperator(
            mode, (1, 0, 2, 0), np.array([80.0, 95.0, 0.15, 0.8, 0.9, 1.1, 0.1]), 1.0, 5.0, 2.3
        ),
    }


OPERATORS = make_operators()
ABSTRACT = {StaticOperator}
# in test_multi_input.py and test_columns.py
SEVERAL_INPUTS = {MultiInputTransferFunctionOperator, ColumnOperator, ModulatedOperator}
UNDRIVEN = {"drift", "sinusoid", "sum"}  # they go on by themselves


@pytest.fixture(params=OPERATORS, scope="module")
def name(request):
    return request.param


@pytest.fixture(scope="module")
def operator(name):
    return OPERATORS[name]


@pytest.fixture(scope="module")
def u():
    rng = np.random.default_rng(3)
    return 0.4 + 0.25 * np.cumsum(rng.normal(size=N)) * np.hanning(N + 20)[:N]


def flatten(state):
    """Turn a state into numbers."""
    if isinstance(state, tuple):
        return np.concatenate([np.empty(0), *(flatten(part) for part in state)])
    if dataclasses.is_dataclass(state):
        return flatten(dataclasses.astuple(state))
    return np.ravel(np.asarray(state, dtype=float))


def test_every_operator_is_covered():
    classes = {kind for _, kind in all_operators()}
    assert classes - ABSTRACT - SEVERAL_INPUTS == {type(op) for op in OPERATORS.values()}


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
@settings(deadline=None, max_examples=8)
@given(cuts=st.lists(st.integers(1, N - 1), max_size=5, unique=True))
def test_cut_signal_gives_the_whole(operator, u, initial_state, cuts):
    state = operator.init(u[0], initial_state)
    whole, last = operator.run(u, DT, state)
    parts = []
    for part in np.split(u, sorted(cuts)):
        y, state = operator.run(part, DT, state)
        parts.append(y)
    np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(flatten(state), flatten(last), rtol=1e-11, atol=1e-12)


def test_step_by_step_equals_run(operator, u):
    state = operator.init(u[0])
    y = np.empty(N)
    for k, value in enumerate(u):
        state, y[k] = operator.step(state, value, DT)
    np.testing.assert_allclose(y, operator.run(u, DT)[0], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_linearize_returns_what_run_returns(operator, u, initial_state):
    y, dy = operator.linearize(u, np.ones((N, 2)), DT, initial_state)
    expected, _ = operator.run(u, DT, operator.init(u[0], initial_state))
    np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-13)
    assert dy.shape == (N, 2 + operator.n_parameters)
    assert dy.flags.c_contiguous


@pytest.mark.parametrize("initial_state", ["rest", "zero"])
def test_tangents_are_central_differences(operator, u, initial_state):
    rng = np.random.default_rng(0)
    du = np.cumsum(rng.normal(size=(N, 2)), axis=0)
    _, dy = operator.linearize(u, du, DT, initial_state)

    def output(vector, signal):
        moved = operator.unpack(vector)
        return moved.run(signal, DT, moved.init(signal[0], initial_state))[0]

    vector = operator.pack()
    expected = np.empty_like(dy)
    for j in range(2):
        h = 1e-6 / np.abs(du[:, j]).max()
        above, below = output(vector, u + h * du[:, j]), output(vector, u - h * du[:, j])
        expected[:, j] = (above - below) / (2 * h)
    for j in range(len(vector)):
        h = np.zeros(len(vector))
        h[j] = 1e-6 * max(abs(vector[j]), 1e-2)
        expected[:, 2 + j] = (output(vector + h, u) - output(vector - h, u)) / (2 * h[j])
    for j in range(dy.shape[1]):
        scale = max(np.abs(expected[:, j]).max(), 1.0)
        np.testing.assert_allclose(dy[:, j], expected[:, j], atol=1e-6 * scale, rtol=0)


def test_tangents_without_upstream_parameters_are_the_same(operator, u):
    _, alone = operator.linearize(u, np.empty((N, 0)), DT)
    _, beside = operator.linearize(u, np.ones((N, 1)), DT)
    np.testing.assert_allclose(alone, beside[:, 1:], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("level", [0.0, 0.4, -1.3])
@pytest.mark.parametrize("driven", sorted(set(OPERATORS) - UNDRIVEN))
def test_rest_stays_at_rest(driven, level):
    operator = OPERATORS[driven]
    y, state = operator.run(np.full(N, level), DT, operator.init(level, "rest"))
    np.testing.assert_allclose(y, y[0], rtol=1e-12, atol=1e-13)
    later, _ = operator.run(np.full(N, level), DT, state)
    np.testing.assert_allclose(later, y[0], rtol=1e-11, atol=1e-12)


def test_default_state_is_rest_at_the_first_sample(operator, u):
    np.testing.assert_array_equal(
        operator.run(u, DT)[0], operator.run(u, DT, operator.init(u[0], "rest"))[0]
    )


def test_states_and_inputs_are_left_alone(operator, u):
    signal, du = u.copy(), np.ones((N, 1))
    _, state = operator.run(signal, DT)
    kept = copy.deepcopy(state)
    vector = operator.pack()
    first = operator.run(signal, DT, state)[0]
    operator.step(state, 3.0, DT)
    operator.linearize(signal, du, DT)
    np.testing.assert_array_equal(flatten(state), flatten(kept))
    np.testing.assert_array_equal(operator.run(signal, DT, state)[0], first)
    np.testing.assert_array_equal(signal, u)
    np.testing.assert_array_equal(du, 1.0)
    np.testing.assert_array_equal(operator.pack(), vector)


def test_read_only_and_strided_inputs(operator, u):
    expected = operator.run(u, DT)[0]
    _, dy = operator.linearize(u, np.ones((N, 1)), DT)
    frozen, du = u.copy(), np.ones((N, 1))
    frozen.flags.writeable = du.flags.writeable = False
    np.testing.assert_array_equal(operator.run(frozen, DT)[0], expected)
    np.testing.assert_array_equal(operator.linearize(frozen, du, DT)[1], dy)
    strided = np.stack([u, -u], axis=1)[:, 0]
    np.testing.assert_array_equal(operator.run(strided, DT)[0], expected)
    np.testing.assert_array_equal(operator.linearize(strided, np.ones((N, 2))[:, ::2], DT)[1], dy)


def test_pack_and_unpack_are_inverse(operator, u):
    vector = operator.pack()
    assert vector.shape == (operator.n_parameters,)
    assert len(operator.entries()) == operator.n_parameters
    assert len({name for name, _ in operator.entries()}) == operator.n_parameters
    for mask in (operator.linear_mask(), operator.gauge_mask(), operator.gauge_entries()):
        assert mask.shape == vector.shape
        assert mask.dtype == bool
    again = operator.unpack(vector)
    np.testing.assert_array_equal(again.run(u, DT)[0], operator.run(u, DT)[0])
    moved = operator.unpack(1.01 * vector)
    np.testing.assert_array_equal(moved.pack(), 1.01 * vector)
    np.testing.assert_array_equal(operator.pack(), vector)


def test_linear_parameters_are_linear_all_at_once(operator, u):
    """The second difference of the output along any direction of them is zero."""
    mask = operator.linear_mask()
    rng = np.random.default_rng(1)
    direction = np.where(mask, rng.normal(size=mask.size), 0.0)
    y = [operator.unpack(operator.pack() + a * direction).run(u, DT)[0] for a in (0.0, 1.0, 2.0)]
    np.testing.assert_allclose(y[2] - 2 * y[1] + y[0], 0.0, atol=1e-11)
    if mask.any():
        assert np.abs(y[1] - y[0]).max() > 1e-3


def test_signal_linear_means_affine_in_the_signal(name, operator, u):
    other = np.cos(np.arange(N) / 5.0)
    y = [operator.run(u + a * other, DT)[0] for a in (0.0, 1.0, 2.0)]
    bent = np.abs(y[2] - 2 * y[1] + y[0]).max() > 1e-9
    assert bent == (not (operator.signal_linear or name == "no limit"))


def test_past_does_not_know_the_future(operator, u):
    changed = np.r_[u[: N // 2], u[N // 2 :] + 1.0]
    np.testing.assert_array_equal(
        operator.run(u, DT)[0][: N // 2], operator.run(changed, DT)[0][: N // 2]
    )


def test_pickle_and_copy_keep_the_output(operator, u):
    expected = operator.run(u, DT)[0]
    operator.linearize(u, np.empty((N, 0)), DT)
    for again in (pickle.loads(pickle.dumps(operator)), copy.deepcopy(operator)):
        np.testing.assert_array_equal(again.run(u, DT)[0], expected)


def test_operators_are_frozen(operator):
    field = next(iter(dataclasses.fields(operator)))
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(operator, field.name, None)
