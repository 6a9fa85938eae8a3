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
)
from ._corrected import Corrected
from ._scheduled_parameters import ScheduledOperator, ScheduledParameters
from ._stages import (
    Stage,
    modulated,
    put_beside_series,
    scheduled,
    series_stages,
    snake_case,
    stage_values,
    with_series_stages,
    with_stage_values,
)
from ._sum import Sum, constant_entries

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
    "Stage",
    "Sum",
    "Turn",
    "amplitude",
    "constant_entries",
    "explained_change",
    "fold_of_rows",
    "is_constant",
    "modulated",
    "put_beside_series",
    "scheduled",
    "series_stages",
    "snake_case",
    "stage_values",
    "thin_records",
    "with_series_stages",
    "with_stage_values",
]
