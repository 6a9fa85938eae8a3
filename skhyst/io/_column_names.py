"""Units in the names of columns."""

import re

_SYMBOL = (
    r"(?:%|°[CF]?|deg[CF]?|(?:[YZEPTGMkhdcmuµμnpfazy]|da)?"
    r"(?:m|s|g|A|K|V|N|Pa|J|W|Hz|C|F|Ω|[Oo]hm|T|H|L|l|Wb|S|rad|bar|Nm|eV|mol)"
    r"|sec|毫?秒|min|hr?|psi|dB|rpm|a\.u\.|counts)(?:\^?-?[1-9]|[²³])?"
)
SYMBOLS = rf"(?:1/)?{_SYMBOL}(?:[/*·]{_SYMBOL})*"  # of a unit, without brackets
_BRACKETED = re.compile(r"[(\[](?![\d\s:,.-]+[)\]])([^()\[\]]{1,12})[)\]]\s*$")
_BEHIND = re.compile(rf"(?<=\S)\s+(?:/|in)\s+({SYMBOLS})\s*$")  # "Force / N", "Kraft in N"
TIME = "t|times?|timestamp|elapsed|zeit|zeitstempel|temps|tiempo|tempo|时间|時間"  # words for it
_MICRO = re.compile("[µμ]")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
_SPELLED = {  # other spellings
    "s": ("sec", "secs", "second", "seconds", "秒"),
    "ms": ("msec", "millis", "millisecond", "milliseconds", "毫秒"),
    "us": ("µs", "μs", "usec", "micros", "microsecond", "microseconds"),
    "ns": ("nsec", "nanosecond", "nanoseconds"),
    "min": ("minute", "minutes"),
    "h": ("hr", "hrs", "hour", "hours"),
}
_TIMES = {word: unit for unit, words in _SPELLED.items() for word in (unit, *words)}
_BRACKETED_TIMES = _TIMES | dict.fromkeys(("d", "day", "days"), "d")  # by itself d is a distance
_INTERVAL = re.compile(
    r"((sampl(e|ing)|scan|acquisition|logging)[ _]?)?interval|sampl(e|ing)[ _]?(time|cycle|period)"
    r"|abtast(zeit|intervall|periode)|delta[ _](x|t)|Δt|hresolution|t_?inc|(wf_)?increment"
    r"|tinterval|dt|ts",
    re.IGNORECASE,
)
_RATE = re.compile(
    r"(sampl(e|ing)|scan|acquisition)[ _]?(rate|frequency)|samples (per|/) s(ec(ond)?)?"
    r"|abtast(rate|frequenz)|fs",
    re.IGNORECASE,
)
_HERTZ = re.compile(r"([kMG]?)(Hz|Sa?/s|samples/s|Sps)")
_LAST_UNIT = re.compile(r"(?<=\w)[ _]([munµμ]?s|[kMG]?Hz)$")  # "dt_ms", "fs kHz"


def interval_of(name, value, unit=""):
    """Return the sampling interval in s if a name is one of an interval or a rate, else None.

    ``unit`` is its unit where the name has none; without any it is s or Hz. In another unit it is
    none of them, and a rate alone is one of samples only if it has a unit.
    """
    last = _LAST_UNIT.search(name)
    unit = unit_of(name) or (last[1] if last else unit)
    bare = _LAST_UNIT.sub("", without_unit(name))
    if _INTERVAL.fullmatch(bare):
        unit = _BRACKETED_TIMES.get(unit.lower()) if unit else "s"
        return value * SECONDS[unit] if unit else None
    hertz = _HERTZ.fullmatch(unit)
    if (_RATE.fullmatch(bare) and (hertz or not unit)) or (bare.lower() == "rate" and hertz):
        return 1.0 / (value * {"k": 1e3, "M": 1e6, "G": 1e9}.get(hertz and hertz[1], 1.0))
    return None


def unit_of(name) -> str:
    """Return the unit at the end of a column's name, in brackets or behind "/" or "in", or "".

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
    >>> unit_of("voltage (V)"), unit_of("x / um"), unit_of("speed"), unit_of("gauge[0]")
    ('V', 'um', '', '')
    """
    match = _BRACKETED.search(str(name)) or _BEHIND.search(str(name))
    return match.group(1).strip() if match else ""


def symbol_of(name) -> str:
    """Return the unit in a column's name if it consists of usual symbols; micro is "u".

    Parameters
    ----------
    name : str
        Name of a column.

    Returns
    -------
    str
        Or "".

    Examples
    --------
    >>> from skhyst.io import symbol_of
    >>> symbol_of("x [µm]"), symbol_of("x (raw)")
    ('um', '')
    """
    unit = unit_of(name)
    return _MICRO.sub("u", unit) if re.fullmatch(SYMBOLS, unit) else ""


def without_unit(name):
    """Return a column's name without its unit."""
    return _BEHIND.sub("", _BRACKETED.sub("", name)).strip()


def is_time(name):
    """Whether a name is a word for the time, or ends with a unit of time."""
    try:
        return bool(time_unit_of(name) or re.fullmatch(TIME, without_unit(name).lower()))
    except ValueError:
        return False


def time_unit_of(name):
    """Return the unit of time in a column's name, in brackets or as its last word, or "".

    Raises
    ------
    ValueError
        If the unit in brackets is not a unit of time.
    """
    unit = unit_of(name)
    if unit and unit.lower() not in _BRACKETED_TIMES:
        raise ValueError(unit)
    if unit:
        return _BRACKETED_TIMES[unit.lower()]
    joined = re.fullmatch(rf"(?i:{TIME})(?<=[a-z])([A-Z]\w*)", str(name))  # as timeMS
    return _TIMES.get((joined[1] if joined else re.split(r"[\W_]", str(name))[-1]).lower(), "")
