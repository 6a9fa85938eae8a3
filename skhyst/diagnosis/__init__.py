"""Find the physical effect that a model lacks."""

from .._progress import Progress
from ._effects import EFFECTS as EFFECTS
from ._effects import Effect, effect_names, register_effect, unregister_effect
from ._evidence import Evidence
from ._next_experiment import Experiment, next_experiment
from ._pictures import Picture
from ._report import Report
from ._search import EffectSearchCV
from ._unknown import LawAt, Unknown

__all__ = [
    "Effect",
    "EffectSearchCV",
    "Evidence",
    "Experiment",
    "LawAt",
    "Picture",
    "Progress",
    "Report",
    "Unknown",
    "effect_names",
    "next_experiment",
    "register_effect",
    "unregister_effect",
]
