"""Compositions of models, fitted jointly."""

from ._cascade import Cascade
from ._scheduled_parameters import ScheduledParameters
from ._sum import Sum

__all__ = ["Cascade", "ScheduledParameters", "Sum"]
