"""Which estimators and operators the package has, for tests, tables and tools that take any."""

import importlib
import inspect
import pkgutil

from sklearn.base import BaseEstimator

from .operators import Operator

__all__ = ["all_estimators", "all_operators"]


def all_estimators():
    """Return every public estimator of skhyst.

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
    return _public_subclasses(BaseEstimator)


def all_operators():
    """Return every public operator of skhyst.

    Returns
    -------
    list of (str, type)
        Name and class, each class once, sorted by name.

    Examples
    --------
    >>> from skhyst.discovery import all_operators
    >>> dict(all_operators())["DahlOperator"]
    <class 'skhyst.hysteresis._dahl.DahlOperator'>
    """
    return _public_subclasses(Operator)


def _public_subclasses(base):
    """Return the concrete subclasses among what the public modules list in ``__all__``."""
    package = importlib.import_module(__package__)
    found = set()
    for module in pkgutil.iter_modules(package.__path__):
        if module.name.startswith("_") or module.name == "base":  # no models, their base
            continue
        public = importlib.import_module(f"{__package__}.{module.name}")
        for name in getattr(public, "__all__", ()):
            member = getattr(public, name)
            if (
                inspect.isclass(member)
                and issubclass(member, base)
                and not inspect.isabstract(member)
            ):
                found.add((name, member))
    return sorted(found, key=lambda pair: pair[0])
