"""Fleets: one model a device, and searches over many recordings."""

from ._diagnose_files import diagnose_files, read_summary
from ._per_device import PerDevice

__all__ = ["PerDevice", "diagnose_files", "read_summary"]
