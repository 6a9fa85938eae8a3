"""Docstrings completed by those of base classes and of similar functions."""

import dataclasses
import inspect
from itertools import takewhile
from types import FunctionType

_TITLES = ("Parameters", "Attributes", "Returns", "Yields", "Raises")  # in the order of numpydoc
# another method need not raise what the base's does
_METHOD_TITLES = ("Parameters", "Returns", "Yields")


def inherit_documentation(cls, *, attributes=True):
    """Complete the docstrings of a class and of its methods by those of its bases.

    The class gets the documentation of its bases for its parameters, in the order of the
    constructor, and for its attributes, after its own, if ``attributes``. A method gets that of the
    base's method for its parameters and return values. Python itself finds the docstring of the
    base for a method that has none.
    """
    bases = cls.__mro__[1:]
    if cls.__dict__.get("__doc__"):
        cls.__doc__ = _completed(cls.__doc__, _constructor(cls), bases, _TITLES[: 1 + attributes])
    for name, method in vars(cls).items():
        is_own = isinstance(method, FunctionType) and method.__qualname__.startswith(
            cls.__qualname__
        )
        if is_own and method.__doc__ and name[0] != "_":
            overridden = [vars(base)[name] for base in bases if name in vars(base)]
            if overridden:
                order = list(inspect.signature(method).parameters)
                method.__doc__ = _completed(method.__doc__, order, overridden, _METHOD_TITLES)


def _constructor(cls):
    """Return the names of the parameters of a class, in order."""
    if not dataclasses.is_dataclass(cls):
        return list(inspect.signature(cls.__init__).parameters)
    # the decorator has not seen the class yet: its fields are those of the base, then its own
    inherited = {f.name: f.kw_only for f in dataclasses.fields(cls) if f.init}
    names = [*inherited, *inspect.get_annotations(cls)]
    return sorted(dict.fromkeys(names), key=lambda name: inherited.get(name, False))


def documented_like(*others):
    """Decorate a function: complete its docstring by those of other functions.

    Their documentation of its parameters is added, and of returns and raised errors if the function
    has no such section.
    """

    def decorate(function):
        if function.__doc__:  # Python may be told to leave docstrings out
            titles = [title for title in _TITLES if title != "Attributes"]
            order = list(inspect.signature(function).parameters)
            function.__doc__ = _completed(function.__doc__, order, others, titles)
        return function

    return decorate


def _completed(docstring, order, sources, titles):
    """Return a docstring with the entries of sources; ``order`` are the names of parameters."""
    lines = inspect.cleandoc(docstring).split("\n")
    for title in titles:
        start, stop = _section(lines, title)
        entries = _entries(lines[start:stop])
        described = {name for names in entries for name in names}
        if title in ("Returns", "Raises") and entries:
            continue
        for source in sources:
            inherited = inspect.cleandoc(source.__doc__ or "").split("\n")
            for names, entry in _entries(inherited[slice(*_section(inherited, title))]).items():
                if described.isdisjoint(names) and (title != "Parameters" or names[0] in order):
                    entries[names] = entry
                    described.update(names)
            if title == "Returns" and entries:  # those of another source are in its place
                break
        if title == "Parameters":
            place = {names: order.index(names[0]) for names in entries if names[0] in order}
            entries = dict(sorted(entries.items(), key=lambda e: place.get(e[0], -1)))
        if entries:
            text = [line for entry in entries.values() for line in entry]
            head = [] if start < stop else [title, "-" * len(title)]
            if head and lines[start - 1]:
                head.insert(0, "")
            lines[start:stop] = [*head, *text, ""]
    return "\n".join(lines)


def _section(lines, title):
    """Return the first and the last line (excluded) of the entries of a section.

    Without such a section, both are the line at which it would begin.
    """
    heads = [i for i, line in enumerate(lines[1:]) if line.strip("-") == "" and len(line) > 2]
    heads.append(len(lines))
    head = next((i for i in heads[:-1] if lines[i] == title), None)
    if head is None:
        before = _TITLES[: _TITLES.index(title)]
        first = next(i for i in heads if i == len(lines) or lines[i] not in before)
        return first, first
    return head + 2, heads[heads.index(head) + 1]


def _entries(lines):
    """Return the entries of a section: a list of lines by the tuple of names that it describes."""
    starts = [i for i, line in enumerate(lines) if line[:1].strip()]
    entries = {}
    for start in starts:
        rest = takewhile(lambda line: not line[:1].strip(), lines[start + 1 :])
        entry = [lines[start], *rest]
        while not entry[-1].strip():
            entry.pop()
        names = tuple(name.strip(" *") for name in lines[start].split(" :")[0].split(","))
        entries[names] = entry
    return entries
