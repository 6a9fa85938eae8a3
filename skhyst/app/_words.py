"""Messages of the library in the words of the page: fields in place of parameters."""

import re

FIELDS = {
    "delimiter": "Separator",
    "decimal": "Decimal sign",
    "on_missing": "Lost readings",
    "missing_code": "Code of a lost reading",
    "sampling_rate": "Sampling rate",
    "time_unit": "Unit of the time",
    "units": "Unit",
    "resample": "Uneven times",
    "effects": "Effects",
    "cv": "Folds",
    "random_state": "Seed",
}
"""Parameters of reading and of a search: the labels of their fields."""

_NAMES = "|".join(FIELDS)
_REPLACED = (
    (r" If the rows are a random subset: .*", ""),
    (
        r"( If the rows have been shuffled:)? Use a splitter that .*? its resource"
        r"(\.|; X\.sort_index\(\) [^.]*\.)",
        "",
    ),
    (
        r"resample with skhyst\.records\.resample_records \(--resample\)",
        "choose 'interpolate' under Uneven times",
    ),
    (
        r"as missing_code \(--missing-code\), and on_missing",
        "under Code of a lost reading, and choose under Lost readings",
    ),
    (r"it is the first column of X, and the time belongs .*", "give it the role of the time."),
    (r"column \d+ of X twice", "the same signal twice"),
    (
        r"call skhyst\.records\.resample_records, which EffectSearchCV does with resample='auto'",
        "choose 'interpolate' under Uneven times",
    ),
    (r"Columns in several files .*", "Add the file of the other, as columns of one recording."),
    (r"pass drive='[^']*' and response='[^']*'", "exchange them in the table"),
    (r"([Pp])ass (drive|response|time|record)=NAME", r"\1ick the \2 in the table"),
    (rf"([Pp])ass (?='?(?:{_NAMES})['=])", r"\1ick "),
    (rf"\bread with (?=(?:{_NAMES})=)", "pick "),
)
_GIVEN = re.compile(rf"\b({_NAMES})=('[^']*'|[\w.-]*\w)")
_NAMED = re.compile(r"'(time_unit|sampling_rate|on_missing|missing_code)'(?! parameter)")
_PARAMETER = re.compile(r"The '(\w+)' parameter of \w+ must")


def page_message(text) -> str:
    """Return a message as one who clicks would say it.

    Parameters
    ----------
    text : str
        Message of an error or a warning.

    Returns
    -------
    str
    """
    for pattern, words in _REPLACED:
        text = re.sub(pattern, words, text, flags=re.DOTALL)
    text = _GIVEN.sub(lambda found: f"{found[2]} under {FIELDS[found[1]]}", text)
    text = _NAMED.sub(lambda found: FIELDS[found[1]], text)
    return _PARAMETER.sub(lambda found: f"{FIELDS.get(found[1], found[1])} must", text)
