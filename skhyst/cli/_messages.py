"""Parameters of Python in messages, replaced by options of the command line."""

import re
import shlex

_NAMES = "|".join(
    [
        *("drive", "response", "time", "time_unit", "sampling_rate", "on_missing", "missing_code"),
        *("delimiter", "decimal", "resample"),
    ]
)
_GIVEN = re.compile(rf"\b({_NAMES})=('[^']*'|[\w.-]*\w)")
_REPLACED = (
    (r"call skhyst\.records\.resample_records, which EffectSearchCV does with", "interpolate with"),
    (  # of Python alone
        r"( If the rows [^:]*:)? Use a splitter .*? as its resource"
        r"(\.|; X\.sort_index\(\) [^.]*\.)?",
        "",
    ),
    (r" \(the '(\w+)' parameter of read_records, --\1 on the command line\)", r" (--\1)"),
    (
        r"'(\w+)' parameter of read_records must be None where 'time'",
        r"'\1' must be left out if 'time'",
    ),
    (r"'(\w+)' parameter of read_records must", r"'\1' must"),
)
_NAMED = re.compile(r"'(time_unit|sampling_rate|on_missing|missing_code)'")  # not names of columns


def as_options(text, known):
    """Return a message with its parameters as options, ``time_unit='ms'`` as ``--time-unit ms``.

    ``known`` are the names of the options of the command. Another option is named with the command
    that has it, ``skhyst diagnose``.
    """

    def option(found):
        name, *value = found.groups()
        words = [f"--{name.replace('_', '-')}", *(shlex.quote(own.strip("'")) for own in value)]
        return " ".join(words if name in known else ["skhyst diagnose", *words])

    for pattern, words in _REPLACED:
        text = re.sub(pattern, words, text)
    return _NAMED.sub(option, _GIVEN.sub(option, text))
