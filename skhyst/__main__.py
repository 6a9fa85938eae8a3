"""Run the command line, by ``skhyst`` or ``python -m skhyst``."""

import sys

from .cli import main

if __name__ == "__main__":
    sys.exit(main())
