"""Models as programs in other languages."""

from ._c import to_c
from ._fmu import to_fmu

__all__ = ["to_c", "to_fmu"]
