"""Export of models: C, Structured Text, functional mock-up units, systems of python-control."""

from ._c import to_c
from ._control import to_control
from ._controllers import EmulatedController, program_sizes
from ._fmu import to_fmu
from ._structured_text import to_structured_text

__all__ = [
    "EmulatedController",
    "program_sizes",
    "to_c",
    "to_control",
    "to_fmu",
    "to_structured_text",
]
