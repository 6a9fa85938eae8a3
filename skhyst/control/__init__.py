"""Use of models: drives that make a device follow a reference."""

from ._compensator import InverseCompensator

__all__ = ["InverseCompensator"]
