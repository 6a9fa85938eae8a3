"""Fitted models in files that are read without executing code."""

from ._json import from_json, to_json
from ._skops import load_model, read_trusted, save_model, skops_io

__all__ = ["from_json", "load_model", "read_trusted", "save_model", "skops_io", "to_json"]
