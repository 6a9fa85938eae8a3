"""Memoryless curves, to stand in a cascade."""

from ._curves import DeadBand, DeadZones, Saturation, SmoothCurve

__all__ = ["DeadBand", "DeadZones", "Saturation", "SmoothCurve"]
