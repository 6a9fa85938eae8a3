"""Find the physical effect that a model lacks."""

from ._effects import Effect, effect_names, register_effect, unregister_effect
from ._evidence import Evidence, Picture
from ._report import Report
from ._search import EffectSearchCV

__all__ = [
    "Effect",
    "EffectSearchCV",
    "Evidence",
    "Picture",
    "Report",
    "effect_names",
    "register_effect",
    "unregister_effect",
]
