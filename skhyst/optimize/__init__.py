"""Identification: least squares over operators. Knows no estimator."""

from ._bounded_step import bounded_step as bounded_step
from ._exchange import Alone as Alone
from ._exchange import block_folds as block_folds
from ._exchange import exchanged as exchanged
from ._exchange import merged_segments as merged_segments
from ._exchange import record_folds as record_folds
from ._exchange import whole_record_folds as whole_record_folds
from ._frequency_problem import FrequencyProblem as FrequencyProblem
from ._frequency_problem import identify_response as identify_response
from ._further_starts import LEVEL as LEVEL
from ._further_starts import apart_p_value as apart_p_value
from ._further_starts import has_start_misfit as has_start_misfit
from ._further_starts import is_coloured as is_coloured
from ._further_starts import start_p_value as start_p_value
from ._further_starts import with_further_starts as with_further_starts
from ._identify import METHODS as METHODS
from ._identify import NOISELESS as NOISELESS
from ._identify import IdentificationResult, identify
from ._identify import as_of as as_of
from ._identify import calibrated as calibrated
from ._identify import constant_entries as constant_entries
from ._identify import places_in_sum as places_in_sum
from ._input_history import estimate_input_history as estimate_input_history
from ._input_history import input_history_of as input_history_of
from ._input_history import later_halves as later_halves
from ._input_history import start_precision as start_precision
from ._input_history import with_input_history as with_input_history
from ._levenberg_marquardt import LevenbergMarquardt
from ._modal_problem import ModalProblem as ModalProblem
from ._modal_problem import modal_start as modal_start
from ._nonnegative import nonnegative_minimum as nonnegative_minimum
from ._pole_starts import distribute_poles as distribute_poles
from ._pole_starts import pole_starts as pole_starts
from ._pole_starts import record_poles as record_poles
from ._pole_starts import sections as sections
from ._pole_starts import warp as warp
from ._population import (
    CuckooSearch,
    DifferentialEvolution,
    ModifiedCuckooSearch,
    ParticleSwarm,
)
from ._problem import OperatorProblem as OperatorProblem
from ._problem import RecordData
from ._problem import ages as ages
from ._problem import record_with_history as record_with_history
from ._standard_errors import coloured_covariance as coloured_covariance
from ._standard_errors import penalised_covariance as penalised_covariance
from ._start_values import best_from_own_starts as best_from_own_starts
from ._start_values import estimate_start_values as estimate_start_values
from ._start_values import identify_from_own_starts as identify_from_own_starts
from ._variable_projection import Method, VariableProjection
from ._variable_projection import damped_step as damped_step
from ._variable_projection import predicted_cost as predicted_cost
from ._variable_projection import single_step as single_step
from ._variable_projection import solve_linear as solve_linear
from ._variable_projection import start_descent_and_predict as start_descent_and_predict
from ._variable_projection import variable_projection as variable_projection
from ._vector_fitting import RationalBlock as RationalBlock
from ._vector_fitting import rational_residues as rational_residues
from ._vector_fitting import vector_fit as vector_fit

__all__ = [
    "CuckooSearch",
    "DifferentialEvolution",
    "IdentificationResult",
    "LevenbergMarquardt",
    "Method",
    "ModifiedCuckooSearch",
    "ParticleSwarm",
    "RecordData",
    "VariableProjection",
    "identify",
]
