"""Identification: least squares over operators. Knows no estimator."""

from ._histories import estimate_histories
from ._identify import IdentificationResult, identify
from ._problem import OperatorProblem, RecordData
from ._starts import distribute_poles, pole_starts, sections
from ._variable_projection import predicted_cost, variable_projection

__all__ = [
    "IdentificationResult",
    "OperatorProblem",
    "RecordData",
    "distribute_poles",
    "estimate_histories",
    "identify",
    "pole_starts",
    "predicted_cost",
    "sections",
    "variable_projection",
]
