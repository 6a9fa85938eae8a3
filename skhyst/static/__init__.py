"""Memoryless curves, to stand in a cascade."""

from ._curves import DeadBand, DeadZones, Saturation, SmoothCurve
from ._soft_saturation import SoftSaturation

__all__ = ["DeadBand", "DeadZones", "Saturation", "SmoothCurve", "SoftSaturation"]
