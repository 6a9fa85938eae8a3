"""Docstrings: what that of a base class, or of a like function, says is said once."""

import inspect
from itertools import takewhile

_TITLES = ("Parameters", "Attributes", "Returns", "Raises")  # in their order


def inherit_documentation(cls):
    """Complete the docstring of a class by what its bases say of its parameters and attributes.

    Parameters come in the order of the constructor, attributes behind the class's own.
    """
    if cls.__dict__.get("__doc__"):
        # a dataclass has no constructor of its own yet when it is made
        order = [*inspect.signature(cls.__init__).parameters, *inspect.get_annotations(cls)]
        cls.__doc__ = _completed(cls.__doc__, order, cls.__mro__[1:], _TITLES[:2])


def documented_like(*others):
    """Decorate a function: complete its docstring by what those of other functions say.

    That is what they say of its parameters, what is returned and what is raised, where the function
    has no such sections.
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
    lines += [""] * (len(lines) == 1)  # between a summary alone and its first section
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
        if title == "Parameters":
            place = {names: order.index(names[0]) for names in entries if names[0] in order}
            entries = dict(sorted(entries.items(), key=lambda e: place.get(e[0], -1)))
        if entries:
            text = [line for entry in entries.values() for line in entry]
            head = [] if start < stop else [title, "-" * len(title)]
            lines[start:stop] = [*head, *text, ""]
    return "\n".join(lines)


def _section(lines, title):
    """Return where the entries of a section are, or, twice, where it would begin."""
    heads = [i for i, line in enumerate(lines[1:]) if line.strip("-") == "" and len(line) > 2]
    heads.append(len(lines))
    own = next((i for i in heads[:-1] if lines[i] == title), None)
    if own is None:
        before = _TITLES[: _TITLES.index(title)]
        first = next(i for i in heads if i == len(lines) or lines[i] not in before)
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
        names = tuple(name.strip(" *") for name in lines[start].split(" :")[0].split(","))
        entries[names] = entry
    return entries
