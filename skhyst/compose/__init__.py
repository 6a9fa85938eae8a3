"""Compositions of models, fitted jointly."""

from ._backfitting import Backfitting as Backfitting
from ._backfitting import Turn as Turn
from ._cascade import Cascade
from ._columns import Modulated, OnColumn
from ._columns import amplitude as amplitude
from ._columns import is_constant as is_constant
from ._columns import lags_of_column as lags_of_column
from ._corrected import Corrected
from ._divided import Divisions as Divisions
from ._feedback import Feedback
from ._modal_feedback import ModalFeedback, SampledFeedback
from ._scheduled_parameters import ScheduledParameters
from ._shared_parameters import SharedParameters
from ._sum import Sum

__all__ = [
    "Cascade",
    "Corrected",
    "Feedback",
    "ModalFeedback",
    "Modulated",
    "OnColumn",
    "SampledFeedback",
    "ScheduledParameters",
    "SharedParameters",
    "Sum",
]
