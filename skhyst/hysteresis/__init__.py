"""Hysteresis models: plays, stops, relays, Bouc-Wen, friction, magnetics, stages with mass."""

from ._backlash import Backlash, BacklashOperator
from ._bouc_wen import BoucWen, BoucWenOperator
from ._bouc_wen_stage import BoucWenStage, BoucWenStageOperator
from ._coulomb_friction import CoulombFriction, CoulombFrictionOperator
from ._dahl import Dahl, DahlOperator
from ._duhem import Duhem, DuhemOperator
from ._end_stops import EndStops, EndStopsOperator
from ._free_mass import FreeMass, FreeMassOperator
from ._friction_stage import FrictionStage, FrictionStageOperator
from ._jiles_atherton import JilesAtherton, JilesAthertonOperator
from ._krasnoselskii_pokrovskii import KrasnoselskiiPokrovskii, KrasnoselskiiPokrovskiiOperator
from ._lugre import LuGre, LuGreOperator
from ._maxwell_slip import MaxwellSlip, MaxwellSlipOperator
from ._modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from ._oscillator import OscillatorOperator
from ._prandtl_ishlinskii import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from ._preisach import Preisach, PreisachOperator
from ._rate_dependent_prandtl_ishlinskii import (
    RateDependentPrandtlIshlinskii,
    RateDependentPrandtlIshlinskiiOperator,
)
from ._restoring_force import RestoringForce, RestoringForceOperator
from ._slew_limit import SlewLimit, SlewLimitOperator
from ._system_level import SystemLevelHysteresis, SystemLevelOperator
from ._tanh import TanhHysteresis, TanhHysteresisOperator

__all__ = [
    "Backlash",
    "BacklashOperator",
    "BoucWen",
    "BoucWenOperator",
    "BoucWenStage",
    "BoucWenStageOperator",
    "CoulombFriction",
    "CoulombFrictionOperator",
    "Dahl",
    "DahlOperator",
    "Duhem",
    "DuhemOperator",
    "EndStops",
    "EndStopsOperator",
    "FreeMass",
    "FreeMassOperator",
    "FrictionStage",
    "FrictionStageOperator",
    "JilesAtherton",
    "JilesAthertonOperator",
    "KrasnoselskiiPokrovskii",
    "KrasnoselskiiPokrovskiiOperator",
    "LuGre",
    "LuGreOperator",
    "MaxwellSlip",
    "MaxwellSlipOperator",
    "ModifiedPrandtlIshlinskii",
    "OscillatorOperator",
    "PrandtlIshlinskii",
    "PrandtlIshlinskiiOperator",
    "Preisach",
    "PreisachOperator",
    "RateDependentPrandtlIshlinskii",
    "RateDependentPrandtlIshlinskiiOperator",
    "RestoringForce",
    "RestoringForceOperator",
    "SlewLimit",
    "SlewLimitOperator",
    "SystemLevelHysteresis",
    "SystemLevelOperator",
    "TanhHysteresis",
    "TanhHysteresisOperator",
]
