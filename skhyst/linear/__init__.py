"""Linear dynamics: gains, lags, modes, delays, creep, transfer functions, frequency responses."""

from ._delay import Delay, DelayOperator
from ._dynamic_stiffness import DynamicStiffness, DynamicStiffnessOperator
from ._estimate_response import frequency_response
from ._first_order_lag import FirstOrderLag, FirstOrderLagOperator
from ._frequency_response import FrequencyResponse
from ._gain import Gain, GainOperator
from ._kelvin_voigt import KelvinVoigt, KelvinVoigtOperator
from ._linear import LinearOperator
from ._log_creep import LogCreep, LogCreepOperator
from ._modal import ModalModel, SampledStateSpace
from ._modal import SampledSystem as SampledSystem
from ._second_order_mode import SecondOrderMode, SecondOrderModeOperator
from ._time_shift import TimeShift, TimeShiftOperator
from ._transfer_function import (
    MultiInputTransferFunctionOperator,
    TransferFunction,
    TransferFunctionOperator,
)

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
    "TimeShift",
    "TimeShiftOperator",
    "TransferFunction",
    "TransferFunctionOperator",
    "frequency_response",
]
