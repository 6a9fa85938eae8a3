"""Identification: least squares over operators. Knows no estimator."""

from ._bounded import bounded_step
from ._cuckoo_search import CuckooSearch, ModifiedCuckooSearch
from ._differential_evolution import DifferentialEvolution
from ._frequency_problem import FrequencyProblem, identify_response
from ._histories import estimate_histories
from ._identify import METHODS, IdentificationResult, identify
from ._levenberg_marquardt import LevenbergMarquardt
from ._method import Method
from ._modal_problem import ModalProblem, modal_start
from ._multistart import VariableProjection
from ._nonnegative import nonnegative_minimum
from ._particle_swarm import ParticleSwarm
from ._population import PopulationMethod
from ._problem import OperatorProblem, RecordData
from ._sections import sections
from ._starts import distribute_poles, pole_starts, record_poles, warp
from ._variable_projection import predicted_cost, single_step, variable_projection
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
    "bounded_step",
    "distribute_poles",
    "estimate_histories",
    "identify",
    "identify_response",
    "modal_start",
    "nonnegative_minimum",
    "pole_starts",
    "predicted_cost",
    "rational_residues",
    "record_poles",
    "sections",
    "single_step",
    "variable_projection",
    "vector_fit",
    "warp",
]
