"""Fitted models in files that are read without running anything."""

from ._skops import load_model, read_trusted, save_model, skops_io

__all__ = ["load_model", "read_trusted", "save_model", "skops_io"]
