"""Memoryless curves (static nonlinearities), to be used in a cascade."""

from ._base import StaticOperator
from ._dead_band import DeadBand, DeadBandOperator
from ._dead_zones import DeadZoneOperator, DeadZones, MonotoneDeadZoneOperator
from ._fold import Fold, FoldOperator
from ._saturation import Saturation, SaturationOperator
from ._smooth_curve import PolynomialCurveOperator, SmoothCurve
from ._soft_saturation import SoftSaturation, SoftSaturationOperator

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
]
