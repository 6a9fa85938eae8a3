"""Splitters, folds and scorers for data in records; the rest is scikit-learn's own."""

from ._folds import by_content, segment_folds, stretches
from ._scorer import washout_scorer
from ._split import BlockedTimeSeriesSplit, RecordKFold

__all__ = [
    "BlockedTimeSeriesSplit",
    "RecordKFold",
    "by_content",
    "segment_folds",
    "stretches",
    "washout_scorer",
]
