"""Hysteresis models."""

from ._prandtl_ishlinskii import PrandtlIshlinskii

__all__ = ["PrandtlIshlinskii"]
