"""Displays: pictures of recordings, models and searches.

Every display stores data first and draws afterwards. Drawing needs matplotlib, which the extra
``skhyst[plot]`` installs; making a display and reading its data does not.
"""

from ._bode import FrequencyResponseDisplay
from ._evidence_display import EvidenceDisplay
from ._fleet import FleetDisplay
from ._hysteresis_loop import HysteresisLoopDisplay
from ._loop_figures import LoopFiguresDisplay
from ._model_comparison import FAR as FAR
from ._model_comparison import ModelComparisonDisplay, compare_models
from ._plot_data import binned_statistics as binned_statistics
from ._plot_data import branch as branch
from ._plot_data import spectrum as spectrum
from ._pole_zero import PoleZeroDisplay
from ._prediction import PredictionDisplay
from ._ranking import EffectRankingDisplay
from ._recording import RecordingDisplay
from ._residual import ResidualDisplay
from ._svg import svg_text as svg_text

__all__ = [
    "EffectRankingDisplay",
    "EvidenceDisplay",
    "FleetDisplay",
    "FrequencyResponseDisplay",
    "HysteresisLoopDisplay",
    "LoopFiguresDisplay",
    "ModelComparisonDisplay",
    "PoleZeroDisplay",
    "PredictionDisplay",
    "RecordingDisplay",
    "ResidualDisplay",
    "compare_models",
]
