"""Parameters of Python in messages, replaced by options of the command line."""

import re
import shlex

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


def as_options(text):
    """Return a message with its parameters as options, ``time_unit='ms'`` as ``--time-unit ms``."""
    for pattern, words in _REPLACED:
        text = re.sub(pattern, words, text)
    return _NAMED.sub(_option, _GIVEN.sub(_option, text))


def _option(found):
    name, *value = found.groups()
    return " ".join(
        [f"--{name.replace('_', '-')}", *(shlex.quote(given.strip("'")) for given in value)]
    )
