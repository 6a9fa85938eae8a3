"""Files of earlier versions, in which classes and parameters have other names or are missing.

A class is looked up by its public name, wherever it is defined now. A missing parameter gets its
default, which corresponds to the earlier behaviour.
"""

import importlib
import inspect
import io
import json
import sys
import zipfile
from functools import cache
from pathlib import Path

from sklearn.base import BaseEstimator

from .._sizes import check_archive, check_array
from ..operators import Operator
from ..records import RecordSlice
from ._json import class_named, field_named, refuse_values, refuse_wrong

_SCHEMA = "schema.json"  # of a skops file
_PACKAGE = __package__.partition(".")[0]
_METRICS = f"{_PACKAGE}.metrics"  # its functions only compute with their arguments
_EDITS = {"skhyst.diagnosis._edits.Beside": "AddDisturbance"}  # classes without a public name
_PLAIN = {"skhyst.compose._stages.Stage"}  # named tuples that are derived from the rest of a file


def with_present_names(path):
    """Return the bytes of a skops file with the present names of its classes, and all names in it.

    Raises
    ------
    RecordError
        If it unpacks to much more than its own size, or declares arrays that it does not contain:
        before memory is allocated for them.
    """
    content, names = io.BytesIO(), set()
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(content, "w") as new:
        check_archive(old, Path(path).stat().st_size)
        for entry in old.infolist():
            if entry.filename.endswith(".npy"):
                with old.open(entry) as stream:
                    check_array(stream, entry.file_size)
            data = old.read(entry)
            if entry.filename == _SCHEMA:
                schema = json.loads(data, object_hook=lambda node: _present(node, names))
                data = json.dumps(schema).encode()
            new.writestr(entry.filename, data)
    return content.getvalue(), names


def is_known(name):
    """Whether a name is skhyst's own, or in a module that is imported already."""
    module = name.rpartition(".")[0]
    return module.partition(".")[0] == _PACKAGE or module in sys.modules


def _present(node, names):
    module, name = node.get("__module__"), node.get("__class__")
    attributes = node.get("content")
    if str(module).startswith("skhyst.") and node.get("__loader__") == "ObjectNode" and attributes:
        named = attributes["content"].items()  # in the order of their types
        attributes["content"] = {field_named(key, name): item for key, item in named}
    if f"{module}.{name}" in _PLAIN:
        node.update(__module__="builtins", __class__="tuple")
    elif f"{module}.{name}" in _EDITS:
        node.update(__class__=_EDITS[f"{module}.{name}"])
    elif module and not is_own(f"{module}.{name}"):
        kind = class_named(f"{module}.{name}")
        if kind is not None:
            node.update(__module__=kind.__module__, __class__=kind.__name__)
    if node.get("__module__"):
        names.add(f"{node['__module__']}.{node.get('__class__')}")
    return node


@cache
def is_own(name):
    """Whether a qualified name is that of a class, or of a metric, that skhyst defines."""
    module, _, name = name.rpartition(".")
    if module.partition(".")[0] != _PACKAGE:
        return False
    try:
        member = getattr(importlib.import_module(module), name, None)
    except ImportError:
        return False
    is_class_or_metric = inspect.isclass(member) or (
        inspect.isfunction(member) and in_package(module, _METRICS)
    )
    return is_class_or_metric and in_package(member.__module__, module)


def in_package(module, package):
    """Whether a module is, or lies in, a package."""
    return f"{module}.".startswith(f"{package}.")


def checked(value):
    """Return an object after validation, with the defaults of missing parameters of estimators.

    Raises
    ------
    ValueError
        If an operator, or a fitted attribute, has invalid values.
    """
    if isinstance(value, Operator):
        value.__post_init__()  # skops sets fields without it
        refuse_values(value)
        for child in value.children:
            checked(child)
        return value
    if isinstance(value, RecordSlice):
        value.__post_init__()
    is_own = isinstance(value, BaseEstimator) and type(value).__module__.startswith("skhyst.")
    if is_own:
        for name, parameter in inspect.signature(type(value)).parameters.items():
            if not hasattr(value, name) and parameter.default is not parameter.empty:
                setattr(value, name, parameter.default)
    parts = vars(value).values() if isinstance(value, BaseEstimator) else ()
    if isinstance(value, (list, tuple, dict)):
        parts = value.values() if isinstance(value, dict) else value
    for part in parts:
        checked(part)
    if is_own:
        refuse_wrong(vars(value), type(value))
    return value
