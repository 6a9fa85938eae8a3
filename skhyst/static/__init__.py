"""Memoryless curves, to stand in a cascade."""

from ._curves import DeadZones, Saturation, SmoothCurve

__all__ = ["DeadZones", "Saturation", "SmoothCurve"]
