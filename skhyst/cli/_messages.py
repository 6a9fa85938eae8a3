"""Parameters of Python in messages, replaced by options of the command line."""

import re

_NAMES = "|".join(
    [
        *("drive", "response", "time_unit", "sampling_rate", "on_missing", "missing_code"),
        *("delimiter", "decimal", "resample"),
    ]
)
_GIVEN = re.compile(rf"\b({_NAMES})=('[^']*'|[\w.-]*\w)")
_REPLACED = (
    (r"call skhyst\.records\.resample_records, which EffectSearchCV does with", "interpolate with"),
    (r"( If the rows [^:]*:)? Use a splitter .*? as its resource\.?", ""),  # of Python alone
)
_NAMED = re.compile(r"'(time_unit|sampling_rate|on_missing|missing_code)'")  # not names of columns


def as_options(text, known):
    """Return a message with its parameters as options, ``time_unit='ms'`` as ``--time-unit ms``.

    ``known`` are the names of the options of the command; others stay parameters of Python.
    """

    def option(found):
        name, *value = found.groups()
        if name not in known:
            return found.group()
        return " ".join([f"--{name.replace('_', '-')}", *(given.strip("'") for given in value)])

    for pattern, words in _REPLACED if "resample" in known else _REPLACED[1:]:
        text = re.sub(pattern, words, text)
    return _NAMED.sub(option, _GIVEN.sub(option, text))
