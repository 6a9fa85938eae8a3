"""Files of earlier versions: classes and parameters with other names, or that there were not yet.

A class is looked up by its public name, wherever it is defined now. A parameter that an estimator
did not have yet is at its default, which does what was done before there was a choice.
"""

import importlib
import inspect
import io
import json
import zipfile
from functools import cache

from sklearn.base import BaseEstimator

from ._json import class_named, field_named

_SCHEMA = "schema.json"  # of a skops file
_PLAIN = {"skhyst.compose._stages.Stage"}  # named tuples that are derived from the rest of a file


def with_present_names(path):
    """Return the bytes of a skops file with the present names of its classes."""
    content = io.BytesIO()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(content, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == _SCHEMA:
                data = json.dumps(json.loads(data, object_hook=_present)).encode()
            new.writestr(name, data)
    return content.getvalue()


def _present(node):
    module, name = node.get("__module__"), node.get("__class__")
    attributes = node.get("content")
    if str(module).startswith("skhyst.") and node.get("__loader__") == "ObjectNode" and attributes:
        named = attributes["content"].items()  # in the order of their types
        attributes["content"] = {field_named(key, name): item for key, item in named}
    if f"{module}.{name}" in _PLAIN:
        node.update(__module__="builtins", __class__="tuple")
    elif module and not is_own_class(f"{module}.{name}"):
        kind = class_named(f"{module}.{name}")
        if kind is not None:
            node.update(__module__=kind.__module__, __class__=kind.__name__)
    return node


@cache
def is_own_class(name):
    """Whether a qualified name is that of a class that a module or package of skhyst defines."""
    module, _, name = name.rpartition(".")
    if module.partition(".")[0] != __package__.partition(".")[0]:
        return False
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError:
        return False
    return inspect.isclass(found) and f"{found.__module__}.".startswith(f"{module}.")


def with_defaults(value):
    """Return an object whose estimators have all parameters, those that it lacks by default."""
    if isinstance(value, BaseEstimator) and type(value).__module__.startswith("skhyst."):
        for name, parameter in inspect.signature(type(value)).parameters.items():
            if not hasattr(value, name) and parameter.default is not parameter.empty:
                setattr(value, name, parameter.default)
    parts = vars(value).values() if isinstance(value, BaseEstimator) else ()
    if isinstance(value, (list, tuple, dict)):
        parts = value.values() if isinstance(value, dict) else value
    for part in parts:
        with_defaults(part)
    return value
