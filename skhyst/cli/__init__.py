"""The command line: one module per command, which calls the public interface."""

from ._main import main

__all__ = ["main"]
