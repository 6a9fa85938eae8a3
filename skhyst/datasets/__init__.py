"""Published parameters, and the recordings that they generate."""

from ._tanh_paper import load_tanh_parameters, make_tanh_recording

__all__ = ["load_tanh_parameters", "make_tanh_recording"]
