"""Splitters and scorers for data in records; the rest is scikit-learn's own."""

from ._scorer import washout_scorer
from ._split import BlockedTimeSeriesSplit, RecordKFold

__all__ = ["BlockedTimeSeriesSplit", "RecordKFold", "washout_scorer"]
