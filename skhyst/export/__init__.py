"""Export of models: C programs, functional mock-up units, and systems of python-control."""

from ._c import to_c
from ._control import to_control
from ._controllers import EmulatedController, program_sizes
from ._fmu import to_fmu

__all__ = ["EmulatedController", "program_sizes", "to_c", "to_control", "to_fmu"]
