"""Use of models: drives, loops, estimates of what a device does, and changes of it."""

from ._compensator import InverseCompensator
from ._damping import IntegralResonantControl
from ._feedback import FeedforwardPI
from ._loop import Loop, simulate_loop
from ._monitor import Monitor
from ._observer import Observer

__all__ = [
    "FeedforwardPI",
    "IntegralResonantControl",
    "InverseCompensator",
    "Loop",
    "Monitor",
    "Observer",
    "simulate_loop",
]
