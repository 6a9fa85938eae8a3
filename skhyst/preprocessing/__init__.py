"""Transformers that turn a drive into features with memory, record by record.

A static regressor after one of them becomes a hysteresis model. A DataFrame gives a DataFrame with
the same index, so that record and time are kept through a pipeline.
"""

from ._base import find_column as find_column
from ._input_gradient import GeneralizedInputGradient
from ._lagged_features import LaggedFeatures
from ._lagged_features import lagged_columns as lagged_columns
from ._lagged_features import read_lag_table as read_lag_table
from ._lagged_features import read_lags as read_lags
from ._play_operators import PlayOperators, StopOperators
from ._sample_rules import SampleRules as SampleRules
from ._sample_rules import follow_rules as follow_rules

__all__ = ["GeneralizedInputGradient", "LaggedFeatures", "PlayOperators", "StopOperators"]
