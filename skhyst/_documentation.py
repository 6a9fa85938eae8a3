"""Docstrings of classes: what a base class says of a parameter is said once."""

import inspect
from itertools import takewhile

__all__ = ["inherit_documentation"]


def inherit_documentation(cls):
    """Complete the docstring of a class by what its bases say of its parameters and attributes.

    Parameters come in the order of the constructor, attributes behind the class's own.
    """
    if not cls.__dict__.get("__doc__"):
        return
    lines = inspect.cleandoc(cls.__doc__).split("\n")
    # a dataclass has no constructor of its own yet when it is made
    order = [*inspect.signature(cls.__init__).parameters, *inspect.get_annotations(cls)]
    for title in ("Parameters", "Attributes"):
        start, stop = _section(lines, title)
        entries = _entries(lines[start:stop])
        described = {name for names in entries for name in names}
        for base in cls.__mro__[1:]:
            inherited = inspect.cleandoc(base.__doc__ or "").split("\n")
            for names, entry in _entries(inherited[slice(*_section(inherited, title))]).items():
                if described.isdisjoint(names) and (title == "Attributes" or names[0] in order):
                    entries[names] = entry
                    described.update(names)
        if title == "Parameters":
            place = {names: order.index(names[0]) for names in entries if names[0] in order}
            entries = dict(sorted(entries.items(), key=lambda e: place.get(e[0], -1)))
        if entries:
            text = [line for entry in entries.values() for line in entry]
            head = [] if start < stop else [title, "-" * len(title)]
            lines[start:stop] = [*head, *text, ""]
    cls.__doc__ = "\n".join(lines)


def _section(lines, title):
    """Return where the entries of a section are, or, twice, where it would begin."""
    heads = [i for i, line in enumerate(lines[1:]) if line.strip("-") == "" and len(line) > 2]
    heads.append(len(lines))
    own = next((i for i in heads[:-1] if lines[i] == title), None)
    if own is None:
        first = next(i for i in heads if i == len(lines) or lines[i] != "Parameters")
        return first, first
    return own + 2, heads[heads.index(own) + 1]


def _entries(lines):
    """Return the entries of a section, lists of lines, by the names that they describe."""
    starts = [i for i, line in enumerate(lines) if line[:1].strip()]
    entries = {}
    for start in starts:
        rest = takewhile(lambda line: not line[:1].strip(), lines[start + 1 :])
        entry = [lines[start], *rest]
        while not entry[-1].strip():
            entry.pop()
        names = tuple(name.strip() for name in lines[start].split(" :")[0].split(","))
        entries[names] = entry
    return entries
