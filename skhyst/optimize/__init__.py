"""Identification: least squares over operators. Knows no estimator."""

from ._bounded_step import bounded_step
from ._frequency_problem import FrequencyProblem, identify_response
from ._identify import METHODS, IdentificationResult, constant_entries, identify
from ._input_history import estimate_input_history, input_history_of, with_input_history
from ._levenberg_marquardt import LevenbergMarquardt
from ._modal_problem import ModalProblem, modal_start
from ._nonnegative import nonnegative_minimum
from ._pole_starts import distribute_poles, pole_starts, record_poles, sections, warp
from ._population import (
    CuckooSearch,
    DifferentialEvolution,
    ModifiedCuckooSearch,
    ParticleSwarm,
    PopulationMethod,
)
from ._problem import OperatorProblem, RecordData, ages, path_of
from ._single_step import predicted_cost, single_step
from ._standard_errors import coloured_covariance
from ._variable_projection import (
    Method,
    VariableProjection,
    restrict,
    search_box,
    variable_projection,
)
from ._vector_fitting import RationalBlock, rational_residues, vector_fit

__all__ = [
    "METHODS",
    "CuckooSearch",
    "DifferentialEvolution",
    "FrequencyProblem",
    "IdentificationResult",
    "LevenbergMarquardt",
    "Method",
    "ModalProblem",
    "ModifiedCuckooSearch",
    "OperatorProblem",
    "ParticleSwarm",
    "PopulationMethod",
    "RationalBlock",
    "RecordData",
    "VariableProjection",
    "ages",
    "bounded_step",
    "coloured_covariance",
    "constant_entries",
    "distribute_poles",
    "estimate_input_history",
    "identify",
    "identify_response",
    "input_history_of",
    "modal_start",
    "nonnegative_minimum",
    "path_of",
    "pole_starts",
    "predicted_cost",
    "rational_residues",
    "record_poles",
    "restrict",
    "search_box",
    "sections",
    "single_step",
    "variable_projection",
    "vector_fit",
    "warp",
    "with_input_history",
]
