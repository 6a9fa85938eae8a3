"""Use of models: inverse compensation, feedback loops, observers, and monitoring for changes."""

from ._compensator import InverseCompensator
from ._damping import IntegralResonantControl
from ._feedforward_pi import FeedforwardPI
from ._monitor import Monitor
from ._observer import Observer
from ._simulate_loop import Loop, simulate_loop

__all__ = [
    "FeedforwardPI",
    "IntegralResonantControl",
    "InverseCompensator",
    "Loop",
    "Monitor",
    "Observer",
    "simulate_loop",
]
