"""Export of models: C programs, functional mock-up units, and systems of python-control."""

from ._c import to_c
from ._control import to_control
from ._fmu import to_fmu
from ._sizes import program_sizes

__all__ = ["program_sizes", "to_c", "to_control", "to_fmu"]
