"""Test signals, published parameters, and the recordings that they generate."""

from ._catalogue import FEWEST as FEWEST
from ._catalogue import from_rest_to_rest, signals_within
from ._inchworm_motor import inchworm_motor_stepper, make_inchworm_motor, walking_drive
from ._random_test_signals import band_limited_noise, multisine
from ._scanning_stage import (
    load_scanning_stage_parameters,
    make_scanning_stage,
    scanning_stage_stepper,
)
from ._stepping import DeviceStepper
from ._tanh_paper import load_tanh_parameters, make_tanh_recording
from ._test_signals import (
    decaying_sine,
    first_order_reversal_curves,
    sine,
    steps,
    swept_sine,
    triangle,
)

__all__ = [
    "DeviceStepper",
    "band_limited_noise",
    "decaying_sine",
    "first_order_reversal_curves",
    "from_rest_to_rest",
    "inchworm_motor_stepper",
    "load_scanning_stage_parameters",
    "load_tanh_parameters",
    "make_inchworm_motor",
    "make_scanning_stage",
    "make_tanh_recording",
    "multisine",
    "scanning_stage_stepper",
    "signals_within",
    "sine",
    "steps",
    "swept_sine",
    "triangle",
    "walking_drive",
]
