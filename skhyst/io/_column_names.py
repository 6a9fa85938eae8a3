"""Units in the names of columns."""

import re

_BRACKETED = re.compile(r"[(\[](?![\d\s:,.-]+[)\]])([^()\[\]]{1,12})[)\]]\s*$")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_SPELLED = {  # other spellings
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millisecond", "milliseconds"),
    "us": ("µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("nsec", "nanosecond", "nanoseconds"),
    "min": ("minute", "minutes"),
    "h": ("hr", "hrs", "hour", "hours"),
}
_TIMES = {word: unit for unit, words in _SPELLED.items() for word in (unit, *words)}


def unit_of(name) -> str:
    """Return the unit in brackets at the end of a column's name, or "".

    Parameters
    ----------
    name : str
        Name of a column.

    Returns
    -------
    str

    Examples
    --------
    >>> from skhyst.io import unit_of
    >>> unit_of("voltage (V)"), unit_of("x [um]"), unit_of("speed"), unit_of("gauge[0]")
    ('V', 'um', '', '')
    """
    found = _BRACKETED.search(str(name))
    return found.group(1).strip() if found else ""


def without_unit(name):
    """Return a column's name without the unit in brackets."""
    return _BRACKETED.sub("", name).strip()


def time_unit_of(name):
    """Return the unit of time in a column's name, in brackets or as its last word, or "".

    Raises
    ------
    ValueError
        If the unit in brackets is not a unit of time.
    """
    said = unit_of(name)
    if said and said.lower() not in _TIMES:
        raise ValueError(said)
    return _TIMES.get(said.lower() or re.split(r"[\W_]", str(name))[-1].lower(), "")
