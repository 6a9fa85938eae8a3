"""A file with the state of a search, from which the same search is continued.

The file is written by skops as a whole after each step. Reading it makes objects of those types
alone that the new search consists of itself, and of skhyst: nothing is run. A search is decided by
its data, its parameters and the version of the package; a digest of these has to be the same.
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
        What the search is about.
    """

    def __init__(self, path, search, *data):
        self.path = Path(path)
        self._skops = skops_io(self.path)
        own = {k: v for k, v in search.get_params().items() if k not in _NOT_DECISIVE}
        self._key = joblib.hash((version("skhyst"), own, data))

    def load(self, example):
        """Return the steps that are kept, none where there is no file yet.

        Parameters
        ----------
        example : object
            What the steps consist of, whose types are trusted.

        Raises
        ------
        ValueError
            If the file is not a checkpoint, or one of other data, parameters or version.
        """
        if not self.path.exists():
            return {}
        check_input(self.path)
        known = self._skops.get_untrusted_types(data=self._skops.dumps(example))
        try:
            kept = read_trusted(self.path, known)
        except ImportError:
            raise
        except Exception as error:  # of a file that is something else anything may come
            raise ValueError(f"{self.path} is no checkpoint of a search ({error}).") from error
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
