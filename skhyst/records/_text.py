"""Delimited text: find the delimiter, the decimal sign and the header, then read the columns."""

import csv
import io
import re
from collections import Counter

import pandas as pd

from ..exceptions import RecordError

_SAMPLE = 65_536  # characters in which delimiter and header are looked for
_DELIMITERS = (";", "\t", ",", " ")  # " " stands for any white space
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_BLANK = {"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "<na>", "inf", "-inf", "+inf"}
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_SYMBOL = (
    r"(%|°[CF]?|deg|([YZEPTGMkhdcmuµμnpfazy]|da)?(m|s|g|A|K|V|N|Pa|J|W|Hz|C|F|Ω|[Oo]hm|T|H|L|l|Wb|S"
    r"|rad|bar|Nm|eV|mol)|sec|min|hr?|psi|dB|rpm|a\.u\.|counts)(\^?-?[1-9]|[²³])?"
)
_UNIT = re.compile(rf"[(\[<{{].*[)\]>}}]|[-–]+|(1/)?{_SYMBOL}([/*·]{_SYMBOL})*")
_NO_UNIT = re.compile(r"[-–]*|1")
_NEWLINE = re.compile(r"\r\n|\r|\n")


def read_table(path):
    """Return the names, units and columns of a delimited text file, as floats or objects (text).

    A line of names, a line of units below it, and a preamble of other lines above it may stand
    before the numbers; names are their positions, and units "", where there is no such line.
    """
    text = _decode(path.read_bytes())
    lines, offsets = _sample(text)
    delimiter, tail = _sniff(lines)
    rows = [_fields(line, delimiter) for line in lines]
    first = _first_row(rows, rows[-len(tail) :])
    if first is None:
        raise RecordError("it has no row of numbers")
    frame = pd.read_csv(
        io.StringIO(text[offsets[first] :]),
        sep=r"\s+" if delimiter == " " else delimiter,
        header=None,
        decimal="," if delimiter != "," and _decimal_comma(rows[first:]) else ".",
        skipinitialspace=True,
        low_memory=False,
    )
    names, units = _names(rows[:first], len(frame.columns))
    columns = [frame[column].to_numpy() for column in frame.columns]
    while len(columns) > 1 and not names[-1].strip() and pd.isna(columns[-1]).all():
        for own in (names, units, columns):  # a delimiter at the end of every line
            own.pop()
    return [name or str(i) for i, name in enumerate(names)], units, columns


def _decode(data):
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    if _BINARY.search(data):
        raise RecordError("it is binary, not text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _sample(text):
    """Return the first lines that are not blank and the offset of each."""
    lines, offsets, start = [], [], 0
    for end in [*_NEWLINE.finditer(text, 0, min(_SAMPLE, len(text))), None]:
        if end is None and lines and len(text) > _SAMPLE:
            break  # the sample cuts this line in two
        line = text[start : end.start() if end else len(text)]
        if line.strip():
            lines.append(line)
            offsets.append(start)
        start = end.end() if end else len(text)
    if not lines:
        raise RecordError("it is empty")
    return lines, offsets


def _sniff(lines):
    """Return the delimiter that makes most fields numbers, and lines that are surely data."""
    tail = lines[len(lines) // 2 :][-200:]
    best, found = (0.0, 0), ","
    for delimiter in _DELIMITERS:
        rows = [_fields(line, delimiter) for line in tail]
        width, common = Counter(map(len, rows)).most_common(1)[0]
        if width < 2 or common < 0.8 * len(rows):
            continue
        fields = [field for row in rows for field in row]
        numeric = sum(_is_number(field, delimiter) for field in fields)
        filled = sum(field.lower() not in _BLANK for field in fields)
        score = (numeric / max(filled, 1), width)
        if score > best:
            best, found = score, delimiter
    return found, tail


def _fields(line, delimiter):
    if delimiter == " ":
        line = " ".join(line.split())
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:
        raise RecordError(f"a line is no row of a table ({error})") from error
    return [field.strip() for field in row]


def _is_number(field, delimiter):
    if _POINT.fullmatch(field):
        return True
    return delimiter != "," and _COMMA.fullmatch(field) is not None


def _decimal_comma(rows):
    fields = [field for row in rows for field in row]
    commas = sum(_COMMA.fullmatch(field) is not None for field in fields)
    points = sum("." in field and _POINT.fullmatch(field) is not None for field in fields)
    return commas > points


def _first_row(rows, tail):
    """Return the number of the first line that looks like the last ones, None if none does."""
    width = Counter(map(len, tail)).most_common(1)[0][0]
    tail = [row for row in tail if len(row) == width]
    text = {i for i in range(width) if sum(_is_text(row[i]) for row in tail) > len(tail) / 2}
    for i, row in enumerate(rows):
        filled = [j for j, field in enumerate(row) if j not in text and field.lower() not in _BLANK]
        if len(row) == width and filled and not any(_is_text(row[j]) for j in filled):
            return i
    return None


def _is_text(field):
    return field.lower() not in _BLANK and not _is_number(field, ";")


def _names(head, width):
    """Return names and units: the last line above the numbers, or the one above units."""
    fitting = []
    for row in reversed(head[-2:]):
        if row and row[0].startswith(("#", "%")):
            row = [row[0].lstrip("#% "), *row[1:]]
            row = row[1:] if len(row) == width + 1 and not row[0] else row
        if not width - 1 <= len(row) <= width or not any(map(_is_text, row)):
            break
        fitting.append([*row, ""][:width])
    if not fitting:
        return [str(i) for i in range(width)], [""] * width
    last, above = fitting[0], fitting[-1]
    two = len(fitting) > 1 and _are_units(last) and all(map(_is_text, filter(None, above)))
    if not two:
        return last, [""] * width
    return above, [
        "" if _NO_UNIT.fullmatch(field) or field.lower() in _BLANK else field.strip("()[]<>{}")
        for field in last
    ]


def _are_units(row):
    filled = [field for field in row if field.lower() not in _BLANK]
    return all(_UNIT.fullmatch(field) for field in filled)
