"""Units of drive, response and time, in words: those that the columns' names carry."""

import re
from dataclasses import dataclass

_BRACKETED = re.compile(r"[(\[](?![\d\s:,.-]+[)\]])([^()\[\]]{1,12})[)\]]\s*$")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_SPELLED = {  # what else they are called
    "s": ("sec", "secs", "second", "seconds"),
    "ms": ("msec", "millisecond", "milliseconds"),
    "us": ("µs", "μs", "usec", "microsecond", "microseconds"),
    "ns": ("nsec", "nanosecond", "nanoseconds"),
    "min": ("minute", "minutes"),
    "h": ("hr", "hrs", "hour", "hours"),
}
_TIMES = {word: unit for unit, words in _SPELLED.items() for word in (unit, *words)}
_PER_SAMPLE = (  # where nobody has said how long a sample is
    (re.compile(r"√Hz\b"), "√(cycles/sample)"),
    (re.compile(r"\bHz\b"), "cycles/sample"),
    (re.compile(r"(?<=/)s\b"), "sample"),
    (re.compile(r"(?<![\w/])s\b"), "samples"),
)


def unit_of(name) -> str:
    """Return the unit that a column's name carries in brackets, or "".

    Parameters
    ----------
    name : str
        Of a column.

    Returns
    -------
    str

    Examples
    --------
    >>> from skhyst.records import unit_of
    >>> unit_of("voltage (V)"), unit_of("x [um]"), unit_of("speed"), unit_of("gauge[0]")
    ('V', 'um', '', '')
    """
    found = _BRACKETED.search(str(name))
    return found.group(1).strip() if found else ""


def without_unit(name):
    """Return a column's name without the unit in brackets."""
    return _BRACKETED.sub("", name).strip()


def time_unit_of(name):
    """Return the unit of time that a column's name says, in brackets or as its last word, or "".

    Raises
    ------
    ValueError
        If what stands in brackets is no unit of time.
    """
    said = unit_of(name)
    if said and said.lower() not in _TIMES:
        raise ValueError(said)
    return _TIMES.get(said.lower() or re.split(r"[\W_]", str(name))[-1].lower(), "")


@dataclass(frozen=True)
class Units:
    """Units of a recording's drive, response and time.

    Parameters
    ----------
    drive, response : str, default=""
        "" where nobody has said what they are.
    time : {"s", "sample"}, default="s"
        "sample" where there is no time: frequencies are then in cycles/sample.

    Examples
    --------
    >>> from skhyst.records import Units
    >>> Units("V", "um").of("response/drive"), Units().of("drive/s"), Units("V", "V").of("V/V")
    ('um/V', 'drive/s', '')
    >>> Units(time="sample").of("Hz"), Units("V").label("rate (drive/s)")
    ('cycles/sample', 'rate (V/s)')
    """

    drive: str = ""
    response: str = ""
    time: str = "s"

    def in_time(self, text) -> str:
        """Return a text with its s and Hz in the unit of time."""
        for pattern, words in _PER_SAMPLE if self.time == "sample" else ():
            text = pattern.sub(words, text)
        return text

    def of(self, unit) -> str:
        """Return a unit that is written in terms of drive, response, s and Hz; "" for a ratio."""
        words = {"drive": self.drive, "response": self.response}
        unit = re.sub(
            r"\b(drive|response)\b", lambda w: words[w.group()] or w.group(), self.in_time(unit)
        )
        return re.sub(r"^(\S+)/\1$", "", unit)

    def label(self, text) -> str:
        """Return an axis's label with what stands in brackets at its end in these units."""
        return re.sub(r"\(([^()]+)\)$", lambda found: f"({self.of(found.group(1))})", text)
