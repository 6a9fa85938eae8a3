"""Run the command line, by ``skhyst`` or ``python -m skhyst``."""

import sys

from . import __version__


def main():
    """Answer what needs no model at once, and leave the rest to the command line."""
    if sys.argv[1:] == ["--version"]:
        print(f"skhyst {__version__}")
        return 0
    from .cli import main

    return main()


if __name__ == "__main__":
    sys.exit(main())
