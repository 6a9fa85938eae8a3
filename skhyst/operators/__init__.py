"""The protocol of operators, series and sums of them, and loops that several models share."""

from ._check_operator import check_operator
from ._compiled_step import (
    CompiledCall,
    CompiledColumn,
    CompiledColumnSeries,
    CompiledLaw,
    CompiledParts,
    CompiledProduct,
    CompiledSeries,
    CompiledStep,
    CompiledSum,
    Stepper,
    in_ring,
)
from ._composition import (
    FrozenOperator,
    SeriesOperator,
    SumOperator,
    WrappedOperator,
    add_disturbances,
    split_disturbances,
)
from ._differences import latest, samples_before, slope_step, slopes, stepped_slopes
from ._linear_inverse import InverseLinearOperator, in_weights, preview_step
from ._one_state import OneStateOperator
from ._plays import (
    Superposition,
    clip_play,
    play_basis,
    play_sum_run,
    play_sum_step,
    play_sum_table,
    play_tangents,
    play_thresholds,
    stop_basis,
    turning_points,
)
from ._products import sum_of_products
from ._protocol import Operator, ParameterSpec, as_constant, as_signal, parameter
from ._records import run_records
from ._root_inverse import InverseOperator, RootInverseOperator, inverse_of
from ._state_space import (
    block_run,
    block_table,
    first_order_run,
    second_order_run,
    state_space_run,
    state_space_step,
    state_space_tangents,
)
from ._window_inverse import WindowInverseOperator

__all__ = [
    "CompiledCall",
    "CompiledColumn",
    "CompiledColumnSeries",
    "CompiledLaw",
    "CompiledParts",
    "CompiledProduct",
    "CompiledSeries",
    "CompiledStep",
    "CompiledSum",
    "FrozenOperator",
    "InverseLinearOperator",
    "InverseOperator",
    "OneStateOperator",
    "Operator",
    "ParameterSpec",
    "RootInverseOperator",
    "SeriesOperator",
    "Stepper",
    "SumOperator",
    "Superposition",
    "WindowInverseOperator",
    "WrappedOperator",
    "add_disturbances",
    "as_constant",
    "as_signal",
    "block_run",
    "block_table",
    "check_operator",
    "clip_play",
    "first_order_run",
    "in_ring",
    "in_weights",
    "inverse_of",
    "latest",
    "parameter",
    "play_basis",
    "play_sum_run",
    "play_sum_step",
    "play_sum_table",
    "play_tangents",
    "play_thresholds",
    "preview_step",
    "run_records",
    "samples_before",
    "second_order_run",
    "slope_step",
    "slopes",
    "split_disturbances",
    "state_space_run",
    "state_space_step",
    "state_space_tangents",
    "stepped_slopes",
    "stop_basis",
    "sum_of_products",
    "turning_points",
]
