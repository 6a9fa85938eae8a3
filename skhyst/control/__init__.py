"""Use of models: drives that make a device follow a reference, and loops around it."""

from ._compensator import InverseCompensator
from ._damping import IntegralResonantControl
from ._feedback import FeedforwardPI
from ._loop import Loop, simulate_loop

__all__ = [
    "FeedforwardPI",
    "IntegralResonantControl",
    "InverseCompensator",
    "Loop",
    "simulate_loop",
]
