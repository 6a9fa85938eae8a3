"""Frozen numerics: parameters and a state that map a signal to a signal, with derivatives."""

from ._base import Operator, ParameterSpec, parameter
from ._compose import SeriesOperator, SumOperator
from ._delay import DelayOperator
from ._disturbance import DisturbanceOperator, DriftOperator, OffsetOperator, SinusoidOperator
from ._dynamics import (
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from ._linear import LinearOperator
from ._prandtl_ishlinskii import PlayMemory, PrandtlIshlinskiiOperator
from ._static import DeadZoneOperator, PolynomialCurveOperator, SaturationOperator, StaticOperator
from ._thresholds import play_thresholds, turning_points

__all__ = [
    "DeadZoneOperator",
    "DelayOperator",
    "DisturbanceOperator",
    "DriftOperator",
    "FirstOrderLagOperator",
    "KelvinVoigtOperator",
    "LinearOperator",
    "OffsetOperator",
    "Operator",
    "ParameterSpec",
    "PlayMemory",
    "PolynomialCurveOperator",
    "PrandtlIshlinskiiOperator",
    "SaturationOperator",
    "SecondOrderModeOperator",
    "SeriesOperator",
    "SinusoidOperator",
    "StaticOperator",
    "SumOperator",
    "TransferFunctionOperator",
    "parameter",
    "play_thresholds",
    "turning_points",
]
