"""Memoryless curves (static nonlinearities), to be used in a cascade, and terms to be learned."""

from ._base import StaticOperator
from ._dead_band import DeadBand, DeadBandOperator
from ._dead_zones import DeadZoneOperator, DeadZones, MonotoneDeadZoneOperator
from ._fold import Fold, FoldOperator
from ._saturation import Saturation, SaturationOperator
from ._smooth_curve import PolynomialCurveOperator, SmoothCurve
from ._soft_saturation import SoftSaturation, SoftSaturationOperator
from ._unknown_term import ARGUMENTS as ARGUMENTS
from ._unknown_term import UnknownTerm, UnknownTermOperator
from ._unknown_term import smooth as smooth

__all__ = [
    "DeadBand",
    "DeadBandOperator",
    "DeadZoneOperator",
    "DeadZones",
    "Fold",
    "FoldOperator",
    "MonotoneDeadZoneOperator",
    "PolynomialCurveOperator",
    "Saturation",
    "SaturationOperator",
    "SmoothCurve",
    "SoftSaturation",
    "SoftSaturationOperator",
    "StaticOperator",
    "UnknownTerm",
    "UnknownTermOperator",
]
