"""Identification: least squares over operators. Knows no estimator."""

from ._bounded import bounded_step
from ._cuckoo_search import CuckooSearch, ModifiedCuckooSearch
from ._differential_evolution import DifferentialEvolution
from ._histories import estimate_histories
from ._identify import METHODS, IdentificationResult, identify
from ._method import Method
from ._multistart import VariableProjection
from ._particle_swarm import ParticleSwarm
from ._population import PopulationMethod
from ._problem import OperatorProblem, RecordData
from ._starts import distribute_poles, pole_starts, sections
from ._variable_projection import predicted_cost, variable_projection

__all__ = [
    "METHODS",
    "CuckooSearch",
    "DifferentialEvolution",
    "IdentificationResult",
    "Method",
    "ModifiedCuckooSearch",
    "OperatorProblem",
    "ParticleSwarm",
    "PopulationMethod",
    "RecordData",
    "VariableProjection",
    "bounded_step",
    "distribute_poles",
    "estimate_histories",
    "identify",
    "pole_starts",
    "predicted_cost",
    "sections",
    "variable_projection",
]
