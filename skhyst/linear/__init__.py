"""Linear dynamics."""

from ._delay import Delay
from ._kelvin_voigt import KelvinVoigt
from ._low_order import FirstOrderLag, SecondOrderMode
from ._transfer_function import TransferFunction

__all__ = ["Delay", "FirstOrderLag", "KelvinVoigt", "SecondOrderMode", "TransferFunction"]
