"""Errors and warnings of skhyst."""

__all__ = [
    "ConvergenceWarning",
    "DivergenceWarning",
    "ExtrapolationWarning",
    "ReachWarning",
    "RecordError",
    "ShortRecordWarning",
    "TimeUnitWarning",
]

from sklearn.exceptions import ConvergenceWarning


class RecordError(ValueError):
    """The rows do not form records: uneven sampling, shuffled rows, a lost index, bad values."""


class DivergenceWarning(UserWarning):
    """A simulation left every physical range; the values returned are finite but meaningless."""


class ExtrapolationWarning(UserWarning):
    """A model predicts for inputs, or at an interval, far beyond those of its fit."""


class ReachWarning(UserWarning):
    """A reference is outside the range that the device reaches with its drive or its stages."""


class TimeUnitWarning(UserWarning):
    """A time has no plausible unit, contradicts the rate of the file, or steps back by an hour."""


class ShortRecordWarning(ConvergenceWarning):
    """Records are too short relative to the correlation time of their noise for standard errors."""
