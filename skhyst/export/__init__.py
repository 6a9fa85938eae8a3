"""Models as programs in other languages."""

from ._c import to_c

__all__ = ["to_c"]
