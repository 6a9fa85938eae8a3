"""Hysteresis models."""

from ._backlash import Backlash
from ._bouc_wen import BoucWen
from ._bouc_wen_stage import BoucWenStage
from ._coulomb_friction import CoulombFriction
from ._dahl import Dahl
from ._duhem import Duhem
from ._friction_stage import FrictionStage
from ._jiles_atherton import JilesAtherton
from ._krasnoselskii_pokrovskii import KrasnoselskiiPokrovskii
from ._lugre import LuGre
from ._maxwell_slip import MaxwellSlip
from ._modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from ._prandtl_ishlinskii import PrandtlIshlinskii
from ._preisach import Preisach
from ._rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from ._restoring_force import RestoringForce
from ._slew_limit import SlewLimit
from ._system_level import SystemLevelHysteresis
from ._tanh import TanhHysteresis

__all__ = [
    "Backlash",
    "BoucWen",
    "BoucWenStage",
    "CoulombFriction",
    "Dahl",
    "Duhem",
    "FrictionStage",
    "JilesAtherton",
    "KrasnoselskiiPokrovskii",
    "LuGre",
    "MaxwellSlip",
    "ModifiedPrandtlIshlinskii",
    "PrandtlIshlinskii",
    "Preisach",
    "RateDependentPrandtlIshlinskii",
    "RestoringForce",
    "SlewLimit",
    "SystemLevelHysteresis",
    "TanhHysteresis",
]
