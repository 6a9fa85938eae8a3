"""Errors and warnings of skhyst."""

__all__ = [
    "ConvergenceWarning",
    "DivergenceWarning",
    "ReachWarning",
    "RecordError",
    "ShortRecordWarning",
    "TimeUnitWarning",
]

from sklearn.exceptions import ConvergenceWarning


class RecordError(ValueError):
    """The rows do not form records: uneven sampling, shuffled rows, a lost index, broken values."""


class DivergenceWarning(UserWarning):
    """A simulation left every physical range; the values returned are finite but meaningless."""


class ReachWarning(UserWarning):
    """A reference is asked of a device that its drive, or a stage of its model, does not reach."""


class TimeUnitWarning(UserWarning):
    """A column of times has no unit, and what it would be in seconds is implausible."""


class ShortRecordWarning(ConvergenceWarning):
    """Records are too short beside the course of their noise for the standard errors to hold."""
