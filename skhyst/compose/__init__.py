"""Compositions of models, fitted jointly."""

from ._backfitting import Backfitting, Turn, explained_change, fold_of_rows
from ._cascade import Cascade, thin_records
from ._columns import (
    Modulated,
    OnColumn,
    amplitude,
    is_constant,
)
from ._corrected import Corrected
from ._scheduled_parameters import ScheduledParameters
from ._sum import Sum

__all__ = [
    "Backfitting",
    "Cascade",
    "Corrected",
    "Modulated",
    "OnColumn",
    "ScheduledParameters",
    "Sum",
    "Turn",
    "amplitude",
    "explained_change",
    "fold_of_rows",
    "is_constant",
    "thin_records",
]
