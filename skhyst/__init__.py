"""Scikit-learn-compatible hysteresis and dynamic models for actuators.

The package fits a declared model to a recording, examines the residual, names the physical effect
that is missing, adds it and reports the error on held-out data before and after. See
:class:`skhyst.diagnosis.EffectSearchCV`.
"""

import importlib
import importlib.metadata
import pkgutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # type checkers do not see imports on demand
    from . import app as app
    from . import autoregressive as autoregressive
    from . import base as base
    from . import cli as cli
    from . import compose as compose
    from . import control as control
    from . import datasets as datasets
    from . import diagnosis as diagnosis
    from . import discovery as discovery
    from . import disturbance as disturbance
    from . import exceptions as exceptions
    from . import export as export
    from . import fleet as fleet
    from . import fluid as fluid
    from . import hysteresis as hysteresis
    from . import inspection as inspection
    from . import io as io
    from . import linear as linear
    from . import metrics as metrics
    from . import model_selection as model_selection
    from . import neural as neural
    from . import noise as noise
    from . import operators as operators
    from . import optimize as optimize
    from . import persistence as persistence
    from . import preprocessing as preprocessing
    from . import records as records
    from . import static as static

__version__ = importlib.metadata.version(__name__)


def __getattr__(name):
    """Import a subpackage when it is first asked for."""
    if name in __dir__():
        return importlib.import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    modules = (module.name for module in pkgutil.iter_modules(__path__))
    return [name for name in modules if not name.startswith("_")] + ["__version__"]
