"""Compositions of models, fitted jointly."""

from ._backfitting import Backfitting, Turn, explained_change, fold_of_rows
from ._cascade import Cascade, thin_records
from ._columns import (
    ColumnOperator,
    Modulated,
    ModulatedOperator,
    OnColumn,
    amplitude,
    is_constant,
    sensitivity_name,
)
from ._corrected import Corrected
from ._scheduled_parameters import ScheduledOperator, ScheduledParameters
from ._sum import Sum

__all__ = [
    "Backfitting",
    "Cascade",
    "ColumnOperator",
    "Corrected",
    "Modulated",
    "ModulatedOperator",
    "OnColumn",
    "ScheduledOperator",
    "ScheduledParameters",
    "Sum",
    "Turn",
    "amplitude",
    "explained_change",
    "fold_of_rows",
    "is_constant",
    "sensitivity_name",
    "thin_records",
]
