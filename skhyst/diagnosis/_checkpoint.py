"""A file with the state of a search, from which the search can be continued.

The file is written by skops, replaced as a whole after each step. Only types that the new search
itself consists of, and types of skhyst, are trusted on reading: no code of the file is run. The
data, the parameters and the version of the package determine the result of a search; a digest of
them has to match.
"""

import warnings
from importlib.metadata import version
from pathlib import Path

import joblib

from .._files import check_input, replacing
from ..persistence import read_trusted, skops_io

_NOT_DECISIVE = ("checkpoint", "n_jobs", "unknown", "verbose")


class Checkpoint:
    """A file with the state of a search.

    Parameters
    ----------
    path : path-like
    search : EffectSearchCV
    *data
        The data of the search.
    """

    def __init__(self, path, search, *data):
        self.path = Path(path)
        self._skops = skops_io(self.path)
        own = {k: v for k, v in search.get_params().items() if k not in _NOT_DECISIVE}
        self._key = joblib.hash((version("skhyst"), own, data))

    def load(self, example):
        """Return the steps in the file; none if there is no file yet.

        Parameters
        ----------
        example : object
            An example of the steps, whose types are trusted.

        Raises
        ------
        ValueError
            If the file is not a checkpoint, or one of other data, parameters or another version.
        """
        if not self.path.exists():
            return {}
        check_input(self.path)
        known = self._skops.get_untrusted_types(data=self._skops.dumps(example))
        try:
            kept = read_trusted(self.path, known)
        except ImportError:
            raise
        except Exception as error:  # a file of another format may raise any exception
            raise ValueError(f"{self.path} is not a checkpoint of a search ({error}).") from error
        if not isinstance(kept, dict) or kept.pop("key", None) != self._key:
            raise ValueError(
                f"{self.path} is the checkpoint of another search: data, parameters or the version "
                "of skhyst differ. Name another file, or remove it."
            )
        return kept["steps"]

    def save(self, steps):
        """Keep the steps; a file that cannot be written does not end the search."""
        try:
            with replacing(self.path) as (part,):
                self._skops.dump({"key": self._key, "steps": steps}, part)
        except Exception as error:  # a full disk, or an estimator that skops does not know
            warnings.warn(
                f"The checkpoint cannot be written: {error}", RuntimeWarning, stacklevel=2
            )
