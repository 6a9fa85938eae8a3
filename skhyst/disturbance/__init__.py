"""Additive disturbances: functions of the time since the start of a record, not the drive.

The coefficients of a disturbance belong to the record, not to the device. Identification solves
them exactly per record; the operator holds their mean over the records, which a free run of a new
record uses.
"""

from ._base import DisturbanceOperator
from ._drift import Drift, DriftOperator
from ._offset import Offset, OffsetOperator
from ._periodic_disturbance import PeriodicDisturbance, SinusoidOperator

__all__ = [
    "DisturbanceOperator",
    "Drift",
    "DriftOperator",
    "Offset",
    "OffsetOperator",
    "PeriodicDisturbance",
    "SinusoidOperator",
]
