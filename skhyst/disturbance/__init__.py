"""Disturbances: functions of time in each record, whatever the drive."""

from ._models import Drift, Offset, PeriodicDisturbance

__all__ = ["Drift", "Offset", "PeriodicDisturbance"]
