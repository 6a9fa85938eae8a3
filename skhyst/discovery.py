"""Which estimators the package has, for tests, tables and tools that take any of them."""

import importlib
import inspect
import pkgutil

from sklearn.base import BaseEstimator

__all__ = ["all_estimators"]


def all_estimators():
    """Return every public estimator of skhyst.

    The public subpackages are imported, and the estimators among the names in their ``__all__``
    are collected.

    Returns
    -------
    list of (str, type)
        Name and class, each class once, sorted by name.

    Examples
    --------
    >>> from skhyst.discovery import all_estimators
    >>> dict(all_estimators())["Cascade"]
    <class 'skhyst.compose._cascade.Cascade'>
    """
    package = importlib.import_module(__package__)
    found = set()
    for module in pkgutil.iter_modules(package.__path__):
        if not module.ispkg or module.name.startswith("_"):
            continue
        public = importlib.import_module(f"{__package__}.{module.name}")
        for name in getattr(public, "__all__", ()):
            member = getattr(public, name)
            if inspect.isclass(member) and issubclass(member, BaseEstimator):
                found.add((name, member))
    return sorted(found, key=lambda pair: pair[0])
