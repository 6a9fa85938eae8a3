"""Splitters, folds and scorers for data in records; the rest is scikit-learn's own."""

from ._folds import by_content as by_content
from ._folds import segment_folds
from ._folds import stretches as stretches
from ._scorer import predicted_from as predicted_from
from ._scorer import washout_scorer
from ._split import BlockedTimeSeriesSplit, RecordKFold

__all__ = ["BlockedTimeSeriesSplit", "RecordKFold", "segment_folds", "washout_scorer"]
