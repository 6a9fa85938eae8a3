"""Memoryless curves, to stand in a cascade."""

from ._curves import DeadBand, DeadZones, Saturation, SmoothCurve
from ._monotone_dead_zones import MonotoneDeadZoneOperator
from ._soft_saturation import SoftSaturation, SoftSaturationOperator
from ._static import (
    DeadBandOperator,
    DeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
    StaticOperator,
)

__all__ = [
    "DeadBand",
    "DeadBandOperator",
    "DeadZoneOperator",
    "DeadZones",
    "MonotoneDeadZoneOperator",
    "PolynomialCurveOperator",
    "Saturation",
    "SaturationOperator",
    "SmoothCurve",
    "SoftSaturation",
    "SoftSaturationOperator",
    "StaticOperator",
]
