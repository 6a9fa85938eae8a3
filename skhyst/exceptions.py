"""Errors and warnings of skhyst."""

__all__ = ["ConvergenceWarning", "DivergenceWarning", "RecordError"]

from sklearn.exceptions import ConvergenceWarning


class RecordError(ValueError):
    """The rows do not form records: uneven sampling, shuffled rows, a lost index, broken values."""


class DivergenceWarning(UserWarning):
    """A simulation left every physical range; the values returned are finite but meaningless."""
