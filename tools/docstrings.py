"""Check the docstrings of public names by numpydoc: `python tools/docstrings.py`.

A method without a docstring of its own has that of a base class, which then has to describe the
method's own parameters. `[tool.numpydoc_validation]` of pyproject.toml lists the checks that are
switched off, each with its reason.
"""

import dataclasses
import importlib
import inspect
import pkgutil
import sys
from functools import cached_property
from pathlib import Path

from numpydoc.docscrape import ClassDoc, get_doc_object
from numpydoc.hooks.validate_docstrings import parse_config
from numpydoc.validate import ERROR_MSGS, Validator, validate
from sklearn.base import BaseEstimator

ROOT = Path(__file__).resolve().parents[1]


class Documented(Validator):
    """An object with the docstring that it shows, whether its own or that of a base class."""

    source_file_def_line = None  # a decorated lambda has none that numpydoc finds

    def __init__(self, obj_name):
        shown = self._load_obj(obj_name)
        text = inspect.getdoc(shown) or ""
        if isinstance(shown, property | cached_property):
            text = shown.__doc__ or ""  # Python gives that of a base's value, such as `bool`
        super().__init__(get_doc_object(shown, doc=text))
        self.raw_doc = f"\n{text}\n" if text else ""


def public_names(package):
    """Yield the dotted names of what the public modules list, and of methods and properties."""
    for module in public_modules(package):
        listed = importlib.import_module(module)
        for name in getattr(listed, "__all__", ()):
            member = getattr(listed, name)
            if getattr(member, "__module__", "").partition(".")[0] == package:
                yield f"{module}.{name}"
                if inspect.isclass(member):
                    yield from (f"{module}.{name}.{own}" for own in members(member, package))


def public_modules(package):
    """Return the names of the modules without an underscore."""
    path = importlib.import_module(package).__path__
    names = [module.name for module in pkgutil.walk_packages(path, f"{package}.")]
    return [name for name in names if not any(part[0] == "_" for part in name.split("."))]


def members(kind, package):
    """Return the public methods and properties that a class has from a package."""
    names = {
        name
        for base in kind.__mro__
        if base.__module__.partition(".")[0] == package
        for name in vars(base)
        if not name.startswith("_")
    }
    return sorted(name for name in names if is_code(inspect.getattr_static(kind, name)))


def is_code(member):
    """Return whether a member of a class is a method or a property."""
    member = getattr(member, "__func__", member)  # of a class method or a static one
    return inspect.isfunction(member) or isinstance(member, property | cached_property)


# what only the search asks of an operator: the developers' page describes it
TRAITS = {"characteristics", "lag_rates", "finer", "n_ringing", "position_tangents"}


def faults(names, switched_off):
    """Yield what numpydoc finds, (name, check, message), once for each docstring."""
    seen = set()
    for name in names:
        shown = Validator._load_obj(name)
        code = getattr(shown, "fget", shown)
        code = getattr(code, "__func__", code)
        if code not in seen:
            seen.add(code)
            off = switched_off | skipped_checks(name, shown)
            found = validate(name, validator_cls=Documented)["errors"]
            yield from ((name, check, text) for check, text in found if check not in off)


def skipped_checks(name, shown):
    """Return the checks that an object of this kind need not pass."""
    if inspect.isclass(shown):
        return skipped_class_checks(shown)
    off = {"SA01"}  # a class leads to its like
    owner = Validator._load_obj(name.rpartition(".")[0])
    if inspect.isclass(owner):
        off |= {"EX01"}  # that of the class uses its methods
        if name.rpartition(".")[2] in TRAITS:
            off |= {"GL08", "PR01", "RT01"}
        if not callable(shown):
            off |= {"GL08"} if name.rpartition(".")[2] in attributes(owner) else set()
        elif not set(inspect.signature(shown).parameters) - {"self", "cls"}:
            off |= {"RT01"}  # like a property: the summary says what it returns
    return off


def skipped_class_checks(kind):
    """Return the checks that a class need not pass."""
    if issubclass(kind, BaseEstimator):
        return set()
    off = {"SA01"}
    if not hasattr(kind, "run") or inspect.isabstract(kind):
        off |= {
            "EX01"
        }  # what a function returns, and what is a base, are shown where they are used
    if kind.__subclasses__():
        off |= {"PR02"}  # a base describes parameters that its subclasses have
    if dataclasses.is_dataclass(kind) and all(own.kw_only for own in dataclasses.fields(kind)):
        off |= {"PR03"}  # their order has no meaning: those of a class come before its base's
    return off


def attributes(kind):
    """Return the names of properties that a class or a base describes."""
    found = set()
    for base in kind.__mro__[:-1]:
        section = ClassDoc(base, config={"show_class_members": False})["Attributes"]
        found |= {name for entry in section for name in entry.name.split(", ")}
        found |= {name for name, own in vars(base).items() if not callable(own) and own.__doc__}
    return found


def main():
    off = ERROR_MSGS.keys() - parse_config(ROOT)["checks"]
    found = [" ".join(fault) for fault in faults(public_names("skhyst"), off)]
    print("\n".join(found))
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
