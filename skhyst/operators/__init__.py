"""Frozen numerics: parameters and a state that map a signal to a signal, with derivatives."""

from ._backlash import BacklashOperator
from ._base import Operator, ParameterSpec, parameter
from ._bouc_wen import BoucWenOperator, BoucWenState
from ._compose import FrozenOperator, SeriesOperator, SumOperator
from ._dahl import DahlOperator
from ._delay import DelayOperator
from ._disturbance import DisturbanceOperator, DriftOperator, OffsetOperator, SinusoidOperator
from ._duhem import DuhemOperator
from ._dynamics import (
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from ._friction_stage import FrictionStageOperator
from ._gray_box import GrayBoxOperator
from ._jiles_atherton import JilesAthertonOperator
from ._krasnoselskii_pokrovskii import KrasnoselskiiPokrovskiiOperator
from ._linear import LinearOperator
from ._log_creep import LogCreepOperator
from ._lugre import LuGreOperator
from ._maxwell_slip import MaxwellSlipOperator
from ._monotone_dead_zones import MonotoneDeadZoneOperator
from ._multi_input import MultiInputTransferFunctionOperator
from ._prandtl_ishlinskii import PlayMemory, PrandtlIshlinskiiOperator
from ._preisach import PreisachMemory, PreisachOperator
from ._rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskiiOperator
from ._restoring_force import RestoringForceOperator
from ._scheduled import ScheduledOperator
from ._slew_limit import SlewLimitOperator
from ._state_space import SampledStateSpace
from ._static import (
    DeadBandOperator,
    DeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
    StaticOperator,
)
from ._system_level import SystemLevelOperator
from ._tanh import TanhHysteresisOperator
from ._thresholds import play_thresholds, turning_points

__all__ = [
    "BacklashOperator",
    "BoucWenOperator",
    "BoucWenState",
    "DahlOperator",
    "DeadBandOperator",
    "DeadZoneOperator",
    "DelayOperator",
    "DisturbanceOperator",
    "DriftOperator",
    "DuhemOperator",
    "FirstOrderLagOperator",
    "FrictionStageOperator",
    "FrozenOperator",
    "GrayBoxOperator",
    "JilesAthertonOperator",
    "KelvinVoigtOperator",
    "KrasnoselskiiPokrovskiiOperator",
    "LinearOperator",
    "LogCreepOperator",
    "LuGreOperator",
    "MaxwellSlipOperator",
    "MonotoneDeadZoneOperator",
    "MultiInputTransferFunctionOperator",
    "OffsetOperator",
    "Operator",
    "ParameterSpec",
    "PlayMemory",
    "PolynomialCurveOperator",
    "PrandtlIshlinskiiOperator",
    "PreisachMemory",
    "PreisachOperator",
    "RateDependentPrandtlIshlinskiiOperator",
    "RestoringForceOperator",
    "SampledStateSpace",
    "SaturationOperator",
    "ScheduledOperator",
    "SecondOrderModeOperator",
    "SeriesOperator",
    "SinusoidOperator",
    "SlewLimitOperator",
    "StaticOperator",
    "SumOperator",
    "SystemLevelOperator",
    "TanhHysteresisOperator",
    "TransferFunctionOperator",
    "parameter",
    "play_thresholds",
    "turning_points",
]
