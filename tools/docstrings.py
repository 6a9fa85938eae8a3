"""Check the docstrings of what is public by numpydoc: `python tools/docstrings.py`.

A method without a docstring of its own has that of a base class, which then has to describe the
method's own parameters. `[tool.numpydoc_validation]` of pyproject.toml lists the checks that are
switched off, each with its reason.
"""

import importlib
import inspect
import pkgutil
import sys
from functools import cached_property
from pathlib import Path

from numpydoc.docscrape import get_doc_object
from numpydoc.hooks.validate_docstrings import parse_config
from numpydoc.validate import ERROR_MSGS, Validator, validate
from sklearn.base import BaseEstimator

ROOT = Path(__file__).resolve().parents[1]


class Documented(Validator):
    """An object with the docstring that it shows, whether its own or that of a base class."""

    def __init__(self, obj_name):
        shown = self._load_obj(obj_name)
        text = inspect.getdoc(shown) or ""
        super().__init__(get_doc_object(shown, doc=text))
        self.raw_doc = f"\n{text}\n" if text else ""

    source_file_def_line = None  # a decorated lambda has none that numpydoc finds


def public_names(package="skhyst"):
    """Yield the dotted names of what the public modules list, and of methods and properties."""
    for module in sorted(public_modules(package)):
        listed = importlib.import_module(module)
        for name in getattr(listed, "__all__", ()):
            member = getattr(listed, name)
            if inspect.isclass(member):
                yield f"{module}.{name}"
                yield from (f"{module}.{name}.{own}" for own in own_members(member, package))
            elif inspect.isfunction(member):
                yield f"{module}.{name}"


def public_modules(package):
    """Return the names of the modules without an underscore."""
    path = importlib.import_module(package).__path__
    names = [module.name for module in pkgutil.walk_packages(path, f"{package}.")]
    return [name for name in names if not any(part[0] == "_" for part in name.split("."))]


def own_members(kind, package):
    """Return the public methods and properties that a class has from this package."""
    bases = [base for base in kind.__mro__ if base.__module__.partition(".")[0] == package]
    found = {}
    for base in bases:
        for name, member in vars(base).items():
            is_code = callable(member) or isinstance(member, DESCRIPTORS)
            if is_code and not name.startswith("_") and not inspect.isclass(member):
                found.setdefault(name)
    return sorted(found)


DESCRIPTORS = (property, cached_property, classmethod, staticmethod)


def faults(names, switched_off):
    """Yield what numpydoc finds, (name, check, message), once for each docstring."""
    seen = set()
    for name in names:
        shown = Validator._load_obj(name)
        code = getattr(shown, "fget", shown)
        code = getattr(code, "__func__", code)
        if id(code) in seen:
            continue
        seen.add(id(code))
        for check, message in validate(name, validator_cls=Documented)["errors"]:
            if check not in switched_off | off_for(shown):
                yield name, check, message


def off_for(shown):
    """Return the checks that only some objects have to pass."""
    is_model = inspect.isclass(shown) and issubclass(shown, BaseEstimator)
    return set()


def main():
    checks = parse_config(ROOT)["checks"]
    off = checks - {"all"} if "all" in checks else set(ERROR_MSGS) - checks
    found = [f"{name} {check} {text}" for name, check, text in faults(public_names(), off)]
    print("\n".join(found))
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
