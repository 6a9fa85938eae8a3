"""Linear dynamics."""

from ._delay import Delay
from ._dynamic_stiffness import DynamicStiffness
from ._estimate_response import frequency_response
from ._frequency_response import FrequencyResponse
from ._gain import Gain
from ._kelvin_voigt import KelvinVoigt
from ._log_creep import LogCreep
from ._low_order import FirstOrderLag, SecondOrderMode
from ._modal import ModalModel
from ._transfer_function import TransferFunction

__all__ = [
    "Delay",
    "DynamicStiffness",
    "FirstOrderLag",
    "FrequencyResponse",
    "Gain",
    "KelvinVoigt",
    "LogCreep",
    "ModalModel",
    "SecondOrderMode",
    "TransferFunction",
    "frequency_response",
]
