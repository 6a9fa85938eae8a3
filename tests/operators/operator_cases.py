"""One operator of every kind, and what it answers to one drive."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from skhyst.discovery import all_operators
from skhyst.operators import Stepper

op = SimpleNamespace(**dict(all_operators()))
DT = 0.01
N = 60


def _unknown():
    basis = np.cos(np.outer(np.arange(9), [0.7, 1.9]))
    return np.array([0.1, -0.07]), basis, -1.031, 1.217


def _surface():
    basis = np.cos(np.outer(np.arange(49), [0.7, 1.9]))
    return np.array([0.1, -0.07]), basis, -0.731, 0.817


def make_operators():
    lag = op.FirstOrderLagOperator(0.03, gain=1.4, intercept=-0.2)
    mode = op.SecondOrderModeOperator(90.0, 0.15, gain=0.8, intercept=0.1)
    plays = op.PrandtlIshlinskiiOperator(
        np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), 0.05, 0.031
    )
    transfer = op.TransferFunctionOperator(
        np.array([0.02]), np.array([70.0]), np.array([0.3]), np.array([0.2, -0.1]), 1.3, 0.4
    )
    creep = op.KelvinVoigtOperator(np.array([0.2, 0.1]), np.array([0.02, 0.3]), 1.5, 0.3)
    drift = op.DriftOperator(np.array([0.3, -0.5, 0.2]), 0.4)
    zones = op.DeadZoneOperator(np.array([0.4, -0.2]), np.array([0.313, -0.207]), np.array([1, -1]))
    return {
        "lag": lag,
        "lag, zero-order hold": dataclasses.replace(lag, hold="zoh"),
        "mode": mode,
        "mode, overdamped": dataclasses.replace(mode, damping_ratio=3.0),
        "mode, zero-order hold": dataclasses.replace(mode, hold="zoh"),
        "mode, band-limited": dataclasses.replace(mode, hold="bandlimited"),
        "creep": creep,
        "creep, zero-order hold": dataclasses.replace(creep, hold="zoh"),
        "creep, logarithmic": op.LogCreepOperator(0.3, 0.05, 1.5, 0.3, longest=10.0),
        "creep, logarithmic, zero-order hold": op.LogCreepOperator(0.3, 0.05, 1.5, 0.3, hold="zoh"),
        "creep, logarithmic, band-limited": op.LogCreepOperator(
            0.3, 0.05, 1.5, 0.3, hold="bandlimited"
        ),
        "transfer function": transfer,
        "transfer function, feed-through": op.TransferFunctionOperator(
            np.empty(0), np.array([70.0]), np.array([0.3]), np.array([0.2, -0.1]), hold="zoh"
        ),
        "transfer function, no zeros": op.TransferFunctionOperator(
            np.array([0.02, 0.05]), np.empty(0), np.empty(0), np.empty(0)
        ),
        "transfer function, integrator": dataclasses.replace(transfer, integrators=1),
        "transfer function, two integrators, zero-order hold": op.TransferFunctionOperator(
            np.empty(0), np.array([70.0]), np.array([0.3]), np.empty(0), hold="zoh", integrators=2
        ),
        "integrator alone": op.TransferFunctionOperator(*4 * (np.empty(0),), 1.3, integrators=1),
        "delay below one sample": op.DelayOperator(0.0037),
        "delay of several samples": op.DelayOperator(0.0537),
        "delay beyond the record": op.DelayOperator(7.3),
        "time shift": op.TimeShiftOperator(0.0137),
        "time shift, ahead": op.TimeShiftOperator(-0.0263),
        "time shift, straight": op.TimeShiftOperator(0.0137, between="line"),
        "clocks that differ": op.TimeShiftOperator(0.0137, -0.0031),
        "no limit": op.SaturationOperator(),
        "upper limit": op.SaturationOperator(upper=0.413),
        "both limits": op.SaturationOperator(-0.311, 0.413),
        "tanks": op.TankChainOperator(
            [0.11, 0.23], [0.5, 0.7], drive_offset=-0.73, gain=1.3, intercept=0.1, scale=0.8
        ),
        "tanks, overflow": op.TankChainOperator(
            [0.11, 0.23, 0.03],
            [0.5, 0.7, 1.6],
            [1.07, 1.13, 1.11],
            [0.7, 0.4],
            drive_offset=-0.37,
            gain=1.3,
            hold="zoh",
            n_substeps=2,
        ),
        "tanks, limited reading": op.TankChainOperator(
            [0.11, 0.03], [0.5, 0.7], [0.83, 0.77], [0.9], drive_offset=-0.37, limit="reading"
        ),
        "tanks, band-limited": op.TankChainOperator(
            [0.11, 0.23], [0.5, 0.7], drive_offset=-2.73, gain=1.3, hold="bandlimited"
        ),
        "soft saturation": op.SoftSaturationOperator(0.413, 1.7, 0.037),
        "soft saturation, upper": op.SoftSaturationOperator(
            0.213, 7.3, -0.037, side=1, stage_order=0
        ),
        "dead band": op.DeadBandOperator(0.213, 0.037),
        "backlash": op.BacklashOperator(0.137),
        "slew limit": op.SlewLimitOperator(13.7),
        "slew limit, always": op.SlewLimitOperator(0.37),
        "dead zones": zones,
        "unknown term": op.UnknownTermOperator(*_unknown(), passed=1.0),
        "unknown term of the rate": op.UnknownTermOperator(*_unknown(), argument="rate"),
        "unknown term of a play": op.UnknownTermOperator(
            *_unknown(), argument="play", half_gap=0.21, passed=1.0, fade=0.1
        ),
        "unknown term of the time since a turn": op.UnknownTermOperator(
            *_unknown()[:2], 0.013, 0.217, argument="turn", passed=1.0
        ),
        "unknown surface of input and rate": op.UnknownTermOperator(
            *_surface(), second="rate", second_low=-41.0, second_high=37.0, passed=1.0, fade=0.3
        ),
        "unknown surface of play and time": op.UnknownTermOperator(
            *_surface(), "play", 0.21, second="turn", second_low=0.013, second_high=0.217
        ),
        "curve": op.PolynomialCurveOperator(np.array([0.2, -0.1, 0.05]), center=0.1, scale=0.7),
        "Coulomb friction": op.CoulombFrictionOperator(
            1.3, 0.8, 2.9, 0.3, 0.1, 0.3, 0.02, 0.1, slowest=0.01, fastest=50.0, smoothing=3
        ),
        "Coulomb friction of a velocity": op.CoulombFrictionOperator(
            0.13, 0.8, 0.29, 0.3, 0.1, damping=0.02, intercept=0.1, motion="velocity"
        ),
        "dynamic stiffness": op.DynamicStiffnessOperator(1e-3, 0.02, 0.7, 0.1, smoothing=2),
        "dynamic stiffness, of a velocity": op.DynamicStiffnessOperator(
            0.02, 0.7, intercept=0.1, drive="velocity"
        ),
        "Dahl friction": op.DahlOperator(0.11, 0.8, stiffness=0.3, damping=0.02, intercept=0.1),
        "Dahl friction, soft": op.DahlOperator(0.11, 0.8, damping=0.01, exponent=1.7),
        "Dahl friction, hard": op.DahlOperator(0.31, 0.8, exponent=0.6),
        "LuGre friction": op.LuGreOperator(0.11, 2.3, 0.6, 0.8, 0.03, 0.3, 0.02, 0.1),
        "slip elements": op.MaxwellSlipOperator(
            np.array([0.11, 0.213, 0.43]), np.array([0.6, 0.4, 0.3]), 0.2, 0.013, 0.1
        ),
        "Duhem": op.DuhemOperator(3.1, np.array([0.9]), np.array([0.4]), 0.1),
        "Duhem, cubic": op.DuhemOperator(
            2.3, np.array([0.9, 0.1, -0.2]), np.array([0.4, 0.1, 0.2]), 0.1, 0.21, 1.3
        ),
        "relays": op.PreisachOperator(
            np.array([-0.41, -0.1, 0.23, 0.5, 0.83]),
            np.array([0.3, 0.1, 0.4, 0.2, 0.5, 0.1, 0.3, 0.1, 0.2, 0.6]),
            np.array([0.2, 0.1, 0.4, 0.3]),
            0.1,
            0.117,
        ),
        "relays, all down at first": op.PreisachOperator(
            np.array([-0.1, 0.23, 0.5]), np.array([0.3, 0.1, 0.4]), center=-np.inf
        ),
        "ramps": op.KrasnoselskiiPokrovskiiOperator(
            np.array([-0.41, -0.1, 0.23, 0.83]),
            np.array([0.3, 0.1, 0.4, 0.2, 0.5, 0.1]),
            0.1,
            0.117,
        ),
        "tanh": op.TanhHysteresisOperator(0.3, -0.002, 0.4, 2.3, 0.1),
        "system level": op.SystemLevelOperator(1.1, 0.4, 0.7, 0.1),
        "system level, as printed": op.SystemLevelOperator(1.1, 0.4, 2.7, 0.1, 0.003, "printed"),
        "gray box": op.GrayBoxOperator(
            op.SystemLevelOperator(1.1, 0.4, 0.7, 0.1), np.array([0.3, -0.1, 0.4, -0.3])
        ),
        "gray box, products": op.GrayBoxOperator(
            op.SystemLevelOperator(1.1, 0.4, 2.7, 0.1, 0.003, "printed"),
            np.r_[0.3, 0.4, -0.3, 0.02 * np.cos(np.arange(9))],
            1,
            2,
            2,
        ),
        "gray box, as printed": op.GrayBoxOperator(
            op.SystemLevelOperator(1.1, 0.4, 0.7, 0.1),
            np.r_[0.3, -0.1, 0.4, -0.3, 0.02 * np.cos(np.arange(10))],
            degree=2,
            dynamics="printed",
        ),
        "Jiles-Atherton": op.JilesAthertonOperator(1.3, 0.11, 0.15, 0.6, 0.2, 0.3, 0.1),
        "Bouc-Wen": op.BoucWenOperator(0.4, 0.7, 0.31, 0.6, 1.0, 0.0, 0.1),
        "Bouc-Wen, asymmetric": op.BoucWenOperator(0.4, -0.3, 0.47, 1.6, 1.7, 0.3, 0.1),
        "offset": op.OffsetOperator(np.array([0.7])),
        "drift": drift,
        "sinusoid": op.SinusoidOperator(np.array([0.5, 0.1, -0.2, 0.3]), np.array([3.0, 11.0])),
        "plays": plays,
        "plays, stop form": dataclasses.replace(plays, form="stop"),
        "plays, stop form, no spring left": op.PrandtlIshlinskiiOperator(
            np.array([0.21, 0.43]), np.array([1.0, 0.4]), form="stop"
        ),
        "monotone dead zones": op.MonotoneDeadZoneOperator(
            np.array([0.6, 1.3, 0.4]), np.array([-0.207, 0.313, 0.611]), n_lower=1
        ),
        "rate-dependent plays, thresholds": op.RateDependentPrandtlIshlinskiiOperator(
            np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), (), 0.1, 0.011
        ),
        "rate-dependent plays, weights": op.RateDependentPrandtlIshlinskiiOperator(
            np.array([0.0, 0.21, 0.43]), np.array([1.0, 0.4, 0.3]), np.array([0.01, -0.02, 0.03])
        ),
        "rate-dependent plays, in proportion, smoothed": op.RateDependentPrandtlIshlinskiiOperator(
            np.array([0.0, 0.21, 0.43]),
            np.array([1.0, 0.4, 0.3]),
            np.array([0.01, -0.02, 0.03]),
            stretch=0.012,
            time_constant=0.04,
            smoothing="velocity",
        ),
        **{
            f"{name}, of movable thresholds": op.MovableOperator.around(own, 0.6)
            for name, own in {
                "plays": plays,
                "stops": dataclasses.replace(plays, form="stop"),
                "slip elements": op.MaxwellSlipOperator([0.17, 0.43], [1.0, 0.4], 0.2, 0.01, 0.3),
                "rate-dependent plays": op.RateDependentPrandtlIshlinskiiOperator(
                    [0.0, 0.21, 0.43], [1.0, 0.4, 0.3], [0.01, -0.02, 0.03], stretch=0.012
                ),
            }.items()
        },
        "series": op.Series(
            ("delay", "plays", "zones", "lag"), (op.DelayOperator(0.013), plays, zones, lag)
        ),
        "series of linear ones": op.Series(("lag", "mode"), (lag, mode)),
        "sum": op.SumOperator(("plays", "mode", "drift"), (plays, mode, drift)),
        "series of sums": op.Series(
            ("plays", "modes"), (plays, op.SumOperator(("first", "second"), (mode, transfer)))
        ),
        "sum of series": op.SumOperator(
            ("series", "creep"), (op.Series(("plays", "lag"), (plays, lag)), creep)
        ),
        "friction stage": op.FrictionStageOperator(
            90.0, 0.15, 0.29, 0.7, 3.0, 8.0, 0.1, 0.8, 0.1, n_substeps=4
        ),
        "friction stage, stiff bristles": op.FrictionStageOperator(
            20.0,
            3.0,
            0.03,
            0.7,
            0.3,
            1e3,
            n_substeps=1,
            friction_gradient=0.9,
            friction_center=0.137,
        ),
        "restoring force": op.RestoringForceOperator(
            90.0, 0.15, [0.2, 0.05], [0.1], 2.0, 0.1, 0.07, 0.8, 0.1, scale=0.9, n_substeps=4
        ),
        "restoring force, no polynomials": op.RestoringForceOperator(
            20.0, 3.0, [], [], 1e3, 0.1, n_substeps=1
        ),
        "restoring force, no hysteresis": op.RestoringForceOperator(
            90.0, 0.15, [0.2], [0.1], 0.0, 0.5, 0.07, 0.8, 0.1, scale=0.9, n_substeps=4
        ),
        "restoring force, band-limited": op.RestoringForceOperator(
            90.0, 0.15, [0.2], [0.1], 2.0, 0.1, 0.07, 0.8, 0.1, n_substeps=8, hold="bandlimited"
        ),
        "Bouc-Wen stage": op.BoucWenStageOperator(
            90.0, 0.15, 2.0, 0.1, 0.3, 1.7, 0.8, 0.1, n_substeps=4
        ),
        "Bouc-Wen stage without limit": op.BoucWenStageOperator(
            20.0, 3.0, 3.0, 0.8, -1.3, 1.01, n_substeps=1
        ),
        "end stops": op.EndStopsOperator(
            90.0, 0.15, 30.0, 0.3, 0.02, 0.613, gain=0.8, intercept=0.1, n_substeps=4
        ),
        "upper end stop": op.EndStopsOperator(20.0, 0.05, 300.0, upper=0.437, n_substeps=2),
        "end stops that overlap": op.EndStopsOperator(20.0, 0.3, 3.0, 0.1, 0.713, 0.237),
        "free mass": op.FreeMassOperator(
            0.01, 0.1, force_offset=0.3, force_drift=0.2, intercept=0.2
        ),
        "free mass, held drive, no damping": op.FreeMassOperator(0.02, hold="zoh"),
        "free mass, friction": op.FreeMassOperator(
            0.01, 0.1, 0.3, 0.5, 0.2, force_offset=0.3, force_drift=0.5, intercept=0.2
        ),
        "free mass, rigid": op.FreeMassOperator(0.01, friction=1.5),
        "free mass, Stribeck curve": op.FreeMassOperator(
            0.01,
            0.1,
            0.3,
            0.5,
            0.2,
            0.3,
            0.7,
            friction_gradient=0.9,
            friction_center=0.137,
            force_offset=0.3,
            intercept=0.2,
            n_substeps=3,
        ),
        "free mass, spring and stops": op.FreeMassOperator(
            0.01,
            0.1,
            friction=0.2,
            cubic_stiffness=0.4,
            center=0.1,
            stop_stiffness=300.0,
            stop_damping=0.2,
            lower=-0.413,
            upper=0.513,
            intercept=0.2,
            hold="zoh",
            n_substeps=5,
        ),
        "static feedback": op.FeedbackOperator(
            ("linear", "curve"),
            (mode, op.PolynomialCurveOperator(np.array([0.1, 0.08, -0.02]), center=0.1, scale=0.9)),
            n_substeps=2,
        ),
        "static feedback, several poles, zero-order hold": op.FeedbackOperator(
            ("linear", "curve"), (dataclasses.replace(transfer, hold="zoh"), zones), n_substeps=1
        ),
        "static feedback of the velocity": op.FeedbackOperator(
            ("linear", "curve"),
            (mode, op.UnknownTermOperator(*_unknown()[:2], -41.0, 37.0)),
            n_substeps=2,
            argument="velocity",
        ),
        "static feedback of displacement and velocity": op.FeedbackOperator(
            ("linear", "curve"),
            (
                mode,
                op.UnknownTermOperator(
                    *_surface(), second="rate", second_low=-41.0, second_high=37.0, passed=1.0
                ),
            ),
            n_substeps=2,
            argument="both",
        ),
        "fold": op.FoldOperator(0.413),
        "fold, upper": op.FoldOperator(0.413, side=-1),
        "empty sum": op.SumOperator((), ()),
        "gain": op.GainOperator(1.3, 0.2),
        "held": op.FrozenOperator(plays),
        "series with a held series": op.Series(
            ("delay", "held", "lag"),
            (
                op.DelayOperator(0.013),
                op.FrozenOperator(op.Series(("p", "z"), (plays, zones))),
                lag,
            ),
        ),
        "sum with a held one": op.SumOperator(("lag", "creep"), (lag, op.FrozenOperator(creep))),
        "scheduled": op.Scheduled(
            mode, (1, 0, 2, 0), np.array([80.0, 95.0, 0.15, 0.8, 0.9, 1.1, 0.1]), 1.0, 5.0, 2.3
        ),
    }


OPERATORS = make_operators()


def make_drive():
    rng = np.random.default_rng(3)
    return 0.4 + 0.25 * np.cumsum(rng.normal(size=N)) * np.hanning(N + 20)[:N]


def responses():
    """Return what run, sensitivities and a step give from rest and from zero, arrays by name."""
    u, du = make_drive(), np.random.default_rng(0).normal(size=(N, 2))
    found = {}
    for name, operator in OPERATORS.items():
        for initial_state in ("rest", "zero"):
            state = operator.init(u[0], initial_state)
            y, _ = operator.run(u, DT, state)
            _, dy = operator.sensitivities(u, du, DT, initial_state)
            if operator.causal:
                y = np.column_stack([y, Stepper(operator.compiled_step(DT, state)).run(u)])
            found[f"{name}, from {initial_state}"] = np.column_stack([y, dy])
    return found
