"""Disturbances: functions of time in each record, whatever the drive."""

from ._models import (
    DisturbanceOperator,
    Drift,
    DriftOperator,
    Offset,
    OffsetOperator,
    PeriodicDisturbance,
    SinusoidOperator,
)

__all__ = [
    "DisturbanceOperator",
    "Drift",
    "DriftOperator",
    "Offset",
    "OffsetOperator",
    "PeriodicDisturbance",
    "SinusoidOperator",
]
