"""The command line: arguments and options to the public interface, a module for each command."""

from ._main import main

__all__ = ["main"]
