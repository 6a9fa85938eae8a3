"""Transformers that turn a drive into features with memory, record by record.

A static regressor after one of them becomes a hysteresis model. A DataFrame gives a DataFrame with
the same index, so that record and time are kept through a pipeline.
"""

from ._base import find_column
from ._input_gradient import GeneralizedInputGradient
from ._lagged_features import LaggedFeatures, lagged_columns, read_lag_table, read_lags
from ._play_operators import PlayOperators, StopOperators
from ._sample_rules import SampleRules, follow_rules

__all__ = [
    "GeneralizedInputGradient",
    "LaggedFeatures",
    "PlayOperators",
    "SampleRules",
    "StopOperators",
    "find_column",
    "follow_rules",
    "lagged_columns",
    "read_lag_table",
    "read_lags",
]
