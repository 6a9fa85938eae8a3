"""Linear dynamics."""

from ._delay import Delay, DelayOperator
from ._dynamic_stiffness import DynamicStiffness, DynamicStiffnessOperator
from ._dynamics import (
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from ._estimate_response import frequency_response
from ._frequency_response import FrequencyResponse
from ._gain import Gain, GainOperator
from ._kelvin_voigt import KelvinVoigt
from ._linear import LinearOperator
from ._log_creep import LogCreep, LogCreepOperator
from ._low_order import FirstOrderLag, SecondOrderMode
from ._modal import ModalModel
from ._multi_input import MultiInputTransferFunctionOperator
from ._state_space import SampledStateSpace
from ._transfer_function import TransferFunction

__all__ = [
    "Delay",
    "DelayOperator",
    "DynamicStiffness",
    "DynamicStiffnessOperator",
    "FirstOrderLag",
    "FirstOrderLagOperator",
    "FrequencyResponse",
    "Gain",
    "GainOperator",
    "KelvinVoigt",
    "KelvinVoigtOperator",
    "LinearOperator",
    "LogCreep",
    "LogCreepOperator",
    "ModalModel",
    "MultiInputTransferFunctionOperator",
    "SampledStateSpace",
    "SecondOrderMode",
    "SecondOrderModeOperator",
    "TransferFunction",
    "TransferFunctionOperator",
    "frequency_response",
]
