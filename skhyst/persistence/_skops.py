"""Fitted models in files: skops, which is read without executing code, or joblib, a pickle.

skops writes names of types and their fields; reading creates objects of trusted types only. Trusted
are the classes of skhyst, whose construction sets fields and does nothing else, its metrics, and
the types that skops trusts itself: those of NumPy and the estimators of scikit-learn. All other
names in a file, of functions, methods and other types, are refused, and no module is imported for
them. The version of skhyst that has written a skops file is an additional member of it.
"""

import warnings
import zipfile
from importlib.metadata import version
from pathlib import Path

import joblib
from sklearn.base import BaseEstimator
from sklearn.exceptions import NotFittedError
from sklearn.utils.validation import check_is_fitted

from .._files import check_input, replacing
from ._earlier import checked, in_package, is_known, is_own, with_present_names
from ._json import tried

__all__ = ["load_model", "read_trusted", "save_model", "skops_io"]

_VERSION = version("skhyst")
_MEMBER = "skhyst.version"


def save_model(model, path) -> None:
    """Write a fitted estimator to a file, completely or not at all.

    Parameters
    ----------
    model : estimator
        Fitted.
    path : path-like
        By skops if it ends in ``.skops``, which :func:`load_model` reads without executing code;
        otherwise by joblib, a pickle.

    Raises
    ------
    ImportError
        If skops is needed and missing.
    OSError
        If the file cannot be written.

    Warns
    -----
    UserWarning
        If :func:`load_model` will refuse the file without ``trust=True``, because of types that can
        run code: trees and forests of scikit-learn, kernels, scorers, functions of your own, ...

    See Also
    --------
    load_model : Read the file.
    to_json : Parametric models as readable text.

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
    skops = skops_io(path) if Path(path).suffix.lower() == ".skops" else None
    with replacing(path) as (part,):
        if skops is None:
            joblib.dump(model, part)
        else:
            skops.dump(model, part)
            foreign = [name for name in skops.get_untrusted_types(file=part) if not is_own(name)]
            with zipfile.ZipFile(part, "a") as file:
                file.writestr(_MEMBER, _VERSION)
    if skops is not None and foreign:
        warnings.warn(
            f"{path} holds {', '.join(foreign)}, which can run code: load_model refuses the file "
            "without trust=True (--trust on the command line).",
            UserWarning,
            stacklevel=2,
        )


def load_model(path, trust=False) -> BaseEstimator:
    """Return the fitted estimator in a file; files that can run code are refused unless trusted.

    Parameters
    ----------
    path : path-like
        File that :func:`save_model` has written.
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
        If the file is broken, holds no fitted estimator, can run code and is not trusted, or was
        written by a version whose objects this one does not have.
    FileNotFoundError, OSError, ImportError
        If there is no such file, it is not a file, or skops is missing.

    Warns
    -----
    UserWarning
        If another version of skhyst has written the file.

    See Also
    --------
    save_model : Write such a file.

    Examples
    --------
    See :func:`save_model`.
    """
    path = Path(path)
    check_input(path)
    with path.open("rb") as file:
        safe = zipfile.is_zipfile(file)
    if not safe and not trust:
        raise ValueError(
            f"{path} is not a skops file, and any other may run code when it is loaded. Save the "
            "model as .skops; or, if it is a pickle and you trust whoever made it, add --trust (in "
            "Python trust=True)."
        )
    load, written = _load_skops if safe else _load_pickle, None
    try:
        written = _writer(path) if safe else None
        model = load(path, trust)
    except (ImportError, _Refused):
        raise
    except Exception as error:  # a broken file may raise an exception of any type
        by = f", written by skhyst {written}," if written else ""
        raise ValueError(
            f"{path}{by} is broken, or cannot be read by skhyst {_VERSION} ({error!r})."
        ) from error
    if not (hasattr(model, "get_params") and _is_fitted(model)):
        raise ValueError(f"{path} holds {type(model).__name__}, not a fitted estimator.")
    if written not in (None, _VERSION):
        warnings.warn(
            f"{path} was written by skhyst {written}, this is {_VERSION}: compare its predictions "
            "with ones that are known, or fit it again.",
            UserWarning,
            stacklevel=2,
        )
    return model


def _writer(path):
    """Return the version of skhyst that has written a skops file, None if the file lacks it."""
    with zipfile.ZipFile(path) as file:
        if _MEMBER not in file.namelist():
            return None
        with file.open(_MEMBER) as member:
            return member.read(40).decode(errors="replace")


def _is_fitted(model):
    try:
        check_is_fitted(model)
    except (NotFittedError, TypeError):  # TypeError: not an estimator, or one without fit
        return not hasattr(model, "fit")
    return True


class _Refused(ValueError):
    """A file names types that are not trusted."""


def _load_pickle(path, trust):
    return joblib.load(path)


def _load_skops(path, trust):
    return read_trusted(path, skops_io(path).get_untrusted_types(file=path) if trust else ())


def read_trusted(path, known=()):
    """Return the object in a skops file of classes of skhyst and of types in ``known`` only."""
    skops = skops_io(path)
    data, names = with_present_names(path)
    foreign = sorted(name for name in names if name not in known and not is_known(name))
    if not foreign:  # otherwise reading might import foreign names
        named = skops.get_untrusted_types(data=data)
        foreign = [name for name in named if name not in known and not is_own(name)]
    if foreign:
        raise _Refused(
            f"{path} holds {', '.join(foreign)}, which may run code when it is loaded. If you "
            "trust whoever made the file, add --trust (in Python trust=True)."
        )
    model = checked(skops.loads(data, trusted=named))
    # the parts of a scikit-learn model need not accept numbers
    return model if any(in_package(name, "sklearn") for name in names) else tried(model)


def skops_io(path):
    """Return the module that reads and writes skops files, such as the one at ``path``."""
    try:
        import skops.io
    except ImportError as error:
        raise ImportError(
            f'{path} needs skops. Install it with: python -m pip install "skhyst[io]"'
        ) from error
    return skops.io
