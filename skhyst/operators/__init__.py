"""Frozen numerics: parameters and a state that map a signal to a signal, with derivatives."""

from ._backlash import BacklashOperator
from ._base import Operator, ParameterSpec, parameter
from ._bouc_wen import BoucWenOperator, BoucWenState
from ._bouc_wen_stage import BoucWenStageOperator
from ._columns import ColumnOperator, ModulatedOperator
from ._compose import FrozenOperator, SeriesOperator, SumOperator
from ._coulomb_friction import CoulombFrictionOperator
from ._dahl import DahlOperator
from ._delay import DelayOperator
from ._disturbance import DisturbanceOperator, DriftOperator, OffsetOperator, SinusoidOperator
from ._duhem import DuhemOperator
from ._dynamic_stiffness import DynamicStiffnessOperator
from ._dynamics import (
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from ._friction_stage import FrictionStageOperator
from ._gain import GainOperator
from ._gray_box import GrayBoxOperator
from ._jiles_atherton import JilesAthertonOperator
from ._krasnoselskii_pokrovskii import KrasnoselskiiPokrovskiiOperator
from ._linear import LinearOperator
from ._log_creep import LogCreepOperator
from ._lugre import LuGreOperator
from ._maxwell_slip import MaxwellSlipOperator
from ._monotone_dead_zones import MonotoneDeadZoneOperator
from ._multi_input import MultiInputTransferFunctionOperator
from ._oscillator import OscillatorOperator
from ._prandtl_ishlinskii import PlayMemory, PrandtlIshlinskiiOperator
from ._preisach import PreisachMemory, PreisachOperator
from ._rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskiiOperator
from ._restoring_force import RestoringForceOperator
from ._scheduled import ScheduledOperator
from ._slew_limit import SlewLimitOperator
from ._soft_saturation import SoftSaturationOperator
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
from ._tank_chain import TankChainOperator
from ._thresholds import play_thresholds, turning_points

__all__ = [
    "BacklashOperator",
    "BoucWenOperator",
    "BoucWenStageOperator",
    "BoucWenState",
    "ColumnOperator",
    "CoulombFrictionOperator",
    "DahlOperator",
    "DeadBandOperator",
    "DeadZoneOperator",
    "DelayOperator",
    "DisturbanceOperator",
    "DriftOperator",
    "DuhemOperator",
    "DynamicStiffnessOperator",
    "FirstOrderLagOperator",
    "FrictionStageOperator",
    "FrozenOperator",
    "GainOperator",
    "GrayBoxOperator",
    "JilesAthertonOperator",
    "KelvinVoigtOperator",
    "KrasnoselskiiPokrovskiiOperator",
    "LinearOperator",
    "LogCreepOperator",
    "LuGreOperator",
    "MaxwellSlipOperator",
    "ModulatedOperator",
    "MonotoneDeadZoneOperator",
    "MultiInputTransferFunctionOperator",
    "OffsetOperator",
    "Operator",
    "OscillatorOperator",
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
    "SoftSaturationOperator",
    "StaticOperator",
    "SumOperator",
    "SystemLevelOperator",
    "TanhHysteresisOperator",
    "TankChainOperator",
    "TransferFunctionOperator",
    "parameter",
    "play_thresholds",
    "turning_points",
]
