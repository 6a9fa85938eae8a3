"""Fitted models in files that are read without executing code."""

from ._json import from_json, to_json
from ._skops import load_model, save_model
from ._skops import read_trusted as read_trusted
from ._skops import skops_io as skops_io

__all__ = ["from_json", "load_model", "save_model", "to_json"]
