"""Compositions of models, fitted jointly."""

from ._cascade import Cascade
from ._columns import Modulated, OnColumn
from ._corrected import Corrected
from ._scheduled_parameters import ScheduledParameters
from ._sum import Sum

__all__ = ["Cascade", "Corrected", "Modulated", "OnColumn", "ScheduledParameters", "Sum"]
