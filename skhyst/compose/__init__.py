"""Compositions of models, fitted jointly."""

from ._cascade import Cascade
from ._sum import Sum

__all__ = ["Cascade", "Sum"]
