"""Displays: pictures of recordings, models and searches.

Every display stores data first and draws afterwards. Drawing needs matplotlib, which the extra
``skhyst[plot]`` installs; making a display and reading its data does not.
"""

from skhyst.inspection._evidence import EvidenceDisplay
from skhyst.inspection._loop import HysteresisLoopDisplay
from skhyst.inspection._ranking import EffectRankingDisplay
from skhyst.inspection._residual import ResidualDisplay

__all__ = ["EffectRankingDisplay", "EvidenceDisplay", "HysteresisLoopDisplay", "ResidualDisplay"]
