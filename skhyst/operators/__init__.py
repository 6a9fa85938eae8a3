"""The protocol of operators, the nodes of the tree, inverses, and loops that models share."""

from ._check_operator import check_operator
from ._compiled_step import ROUNDING as ROUNDING
from ._compiled_step import CompiledCall as CompiledCall
from ._compiled_step import CompiledColumn as CompiledColumn
from ._compiled_step import CompiledColumnSeries as CompiledColumnSeries
from ._compiled_step import CompiledLaw, CompiledStep, Signal, Stepper
from ._compiled_step import CompiledParts as CompiledParts
from ._compiled_step import CompiledSeries as CompiledSeries
from ._compiled_step import CompiledSum as CompiledSum
from ._compiled_step import in_ring as in_ring
from ._composition import (
    FrozenOperator,
    OnColumnOperator,
    Scaled,
    Scheduled,
    Series,
    SumOperator,
)
from ._composition import add_disturbances as add_disturbances
from ._composition import bare as bare
from ._composition import can_scale as can_scale
from ._composition import of_columns as of_columns
from ._composition import split_disturbances as split_disturbances
from ._driven_series import add_parallel as add_parallel
from ._driven_series import modulated as modulated
from ._driven_series import on_column as on_column
from ._driven_series import scheduled as scheduled
from ._driven_series import series_stages as series_stages
from ._driven_series import stage_values as stage_values
from ._driven_series import with_series_stages as with_series_stages
from ._driven_series import with_stage_values as with_stage_values
from ._feedback import FEEDBACK_ARGUMENTS as FEEDBACK_ARGUMENTS
from ._feedback import FeedbackOperator
from ._feedback import has_velocity as has_velocity
from ._held_input import HeldInput as HeldInput
from ._held_input import holding_what_moves as holding_what_moves
from ._held_input import holds_of_input as holds_of_input
from ._held_input import is_straight as is_straight
from ._held_input import resampled as resampled
from ._held_input import with_substeps_resampled as with_substeps_resampled
from ._linear_inverse import InverseLinearOperator
from ._linear_inverse import previewed as previewed
from ._one_state import OneStateOperator
from ._part import Factor
from ._part import ScaledWithin as ScaledWithin
from ._part import Stage as Stage
from ._part import StartValues as StartValues
from ._part import snake_case as snake_case
from ._plays import Superposition as Superposition
from ._plays import clip_play as clip_play
from ._plays import play_basis as play_basis
from ._plays import play_sum_run as play_sum_run
from ._plays import play_sum_step as play_sum_step
from ._plays import play_sum_table as play_sum_table
from ._plays import play_tangents as play_tangents
from ._plays import play_thresholds, turning_points
from ._plays import rate_play_run as rate_play_run
from ._plays import rate_play_sample as rate_play_sample
from ._plays import rate_play_tangents as rate_play_tangents
from ._plays import stop_basis as stop_basis
from ._plays import threshold_tangents as threshold_tangents
from ._plays import widened_play_step as widened_play_step
from ._products import sum_of_products as sum_of_products
from ._protocol import MOST_STEPS as MOST_STEPS
from ._protocol import Operator, ParameterSpec, parameter
from ._protocol import as_constant as as_constant
from ._protocol import as_signal as as_signal
from ._protocol import by_fields as by_fields
from ._protocol import is_array as is_array
from ._protocol import propagate as propagate
from ._records import cut_off as cut_off
from ._records import run_records as run_records
from ._records import run_variance as run_variance
from ._resolution import MovableOperator, Resolution
from ._resolution import has_weight as has_weight
from ._resolution import parts_with_resolution as parts_with_resolution
from ._resolution import same_places as same_places
from ._resolution import select_terms as select_terms
from ._resolution import with_terms as with_terms
from ._root_inverse import InverseOperator, RootInverseOperator, inverse_of
from ._slopes import latest as latest
from ._slopes import samples_before as samples_before
from ._slopes import slope_step as slope_step
from ._slopes import slopes as slopes
from ._slopes import stepped_slopes as stepped_slopes
from ._state_space import block_run as block_run
from ._state_space import block_table as block_table
from ._state_space import first_order_run as first_order_run
from ._state_space import second_order_run as second_order_run
from ._state_space import state_space_begin as state_space_begin
from ._state_space import state_space_run as state_space_run
from ._state_space import state_space_step as state_space_step
from ._state_space import state_space_tangents as state_space_tangents
from ._state_space import tangent_system as tangent_system
from ._window_inverse import WindowInverseOperator

__all__ = [
    "CompiledLaw",
    "CompiledStep",
    "Factor",
    "FeedbackOperator",
    "FrozenOperator",
    "InverseLinearOperator",
    "InverseOperator",
    "MovableOperator",
    "OnColumnOperator",
    "OneStateOperator",
    "Operator",
    "ParameterSpec",
    "Resolution",
    "RootInverseOperator",
    "Scaled",
    "Scheduled",
    "Series",
    "Signal",
    "Stepper",
    "SumOperator",
    "WindowInverseOperator",
    "check_operator",
    "inverse_of",
    "parameter",
    "play_thresholds",
    "turning_points",
]
