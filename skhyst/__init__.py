"""Scikit-learn-compatible hysteresis and dynamic models for actuators.

The package fits a declared model to a recording, looks at what the model leaves unexplained,
names the physical effect that is missing, adds it and reports the error on held-out data
before and after. See :class:`skhyst.diagnosis.EffectSearchCV`.
"""

import importlib
import importlib.metadata
import pkgutil

__version__ = importlib.metadata.version(__name__)


def __getattr__(name):
    """Import a subpackage when it is first asked for."""
    if name in __dir__():
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    modules = (module.name for module in pkgutil.iter_modules(__path__))
    return [name for name in modules if not name.startswith("_")] + ["__version__"]
