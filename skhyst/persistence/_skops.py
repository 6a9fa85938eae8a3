"""Fitted models in files: skops, which is read without running anything, or joblib, a pickle.

skops writes names of types and their fields; reading makes objects of those types alone that are
trusted. Trusted are the classes of skhyst, whose construction sets fields and no more, and what
skops trusts itself: the types of NumPy and the estimators of scikit-learn. Functions, methods and
whatever else a file may name are refused.
"""

import importlib
import inspect
import zipfile
from pathlib import Path

import joblib
from sklearn.base import BaseEstimator
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import check_is_fitted

from .._files import check_input, replacing

__all__ = ["load_model", "read_trusted", "save_model", "skops_io"]


def save_model(model, path) -> None:
    """Write a fitted model or search into a file, whole or not at all.

    Parameters
    ----------
    model : estimator
    path : path-like
        skops where it ends in ``.skops``, which :func:`load_model` reads without running anything;
        by joblib otherwise, a pickle.

    Raises
    ------
    ImportError
        If skops is needed and missing.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from skhyst.linear import Gain
    >>> from skhyst.persistence import load_model, save_model
    >>> model = Gain().fit([[0.0], [1.0], [2.0]], [0.0, 2.0, 4.0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "model.skops")
    ...     save_model(model, path)
    ...     load_model(path).predict([[3.0]])
    array([6.])
    """
    dump = skops_io(path).dump if Path(path).suffix.lower() == ".skops" else joblib.dump
    with replacing(path) as (part,):
        dump(model, part)


def load_model(path, trust=False) -> BaseEstimator:
    """Return the fitted model in a file; what can run code is refused unless it is trusted.

    Parameters
    ----------
    path : path-like
    trust : bool, default=False
        Whether a pickle is loaded too, and types that are neither of skhyst nor known to skops:
        both can run any code.

    Returns
    -------
    estimator
        Fitted.

    Raises
    ------
    ValueError
        If the file is broken, holds no fitted model, or can run code and is not trusted.
    FileNotFoundError, OSError, ImportError
        If there is no file, it is none, or skops is missing.
    """
    path = Path(path)
    check_input(path)
    with path.open("rb") as file:
        safe = zipfile.is_zipfile(file)
    if not safe and not trust:
        raise ValueError(
            f"{path} is no skops file, and any other may run code when it is loaded. Save the "
            "model as .skops; or, if it is a pickle and you trust whoever made it, add --trust (in "
            "Python trust=True)."
        )
    load = _load_skops if safe else _load_pickle
    try:
        model = load(path, trust)
    except (ImportError, _Refused):
        raise
    except Exception as error:  # of a broken file anything may come
        raise ValueError(f"{path} is broken: no model can be read from it ({error!r}).") from error
    if not (hasattr(model, "stepper") and _is_fitted(model)):
        raise ValueError(f"{path} holds {type(model).__name__}, not a fitted model of skhyst.")
    return model


def _is_fitted(model):
    try:
        check_is_fitted(model)
    except (NotFittedError, TypeError):  # TypeError: no estimator, which is not fitted
        return not hasattr(model, "fit")
    return True


class _Refused(ValueError):
    """A file names types that are not trusted."""


def _load_pickle(path, trust):
    return joblib.load(path)


def _load_skops(path, trust):
    return read_trusted(path, skops_io(path).get_untrusted_types(file=path) if trust else ())


def read_trusted(path, known=()):
    """Return what a skops file holds, of classes of skhyst and types with known names alone."""
    skops = skops_io(path)
    named = skops.get_untrusted_types(file=path)
    foreign = [name for name in named if name not in known and not _is_own_class(name)]
    if foreign:
        raise _Refused(
            f"{path} holds {', '.join(foreign)}, which may run code when it is loaded. If you "
            "trust whoever made the file, add --trust (in Python trust=True)."
        )
    return skops.load(path, trusted=named)


def _is_own_class(name):
    """Whether a qualified name is that of a class that a module of skhyst defines."""
    module, _, name = name.rpartition(".")
    if module.partition(".")[0] != __package__.partition(".")[0]:
        return False
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError:
        return False
    return inspect.isclass(found) and found.__module__ == module


def skops_io(path):
    """Return the module that reads and writes skops files, such as the one at ``path``."""
    try:
        import skops.io
    except ImportError as error:
        raise ImportError(
            f'{path} needs skops. Install it with: python -m pip install "skhyst[io]"'
        ) from error
    return skops.io
