"""Compositions of models, fitted jointly."""

from ._cascade import Cascade
from ._columns import ColumnOperator, Modulated, ModulatedOperator, OnColumn
from ._corrected import Corrected
from ._scheduled_parameters import ScheduledOperator, ScheduledParameters
from ._sum import Sum

__all__ = [
    "Cascade",
    "ColumnOperator",
    "Corrected",
    "Modulated",
    "ModulatedOperator",
    "OnColumn",
    "ScheduledOperator",
    "ScheduledParameters",
    "Sum",
]
