"""Find the physical effect that a model lacks."""

from ._effects import EFFECTS, Effect, effect_names, register_effect, unregister_effect
from ._evidence import Evidence
from ._next_experiment import Experiment, next_experiment
from ._pictures import Picture
from ._progress import Progress
from ._report import Report
from ._search import EffectSearchCV

__all__ = [
    "EFFECTS",
    "Effect",
    "EffectSearchCV",
    "Evidence",
    "Experiment",
    "Picture",
    "Progress",
    "Report",
    "effect_names",
    "next_experiment",
    "register_effect",
    "unregister_effect",
]
