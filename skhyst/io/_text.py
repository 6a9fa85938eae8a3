"""Delimited text: find its layout, then read the columns."""

import io
import re
from itertools import islice, pairwise, takewhile

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._column_names import is_time, unit_of, without_unit
from ._layout import BEYOND, fields, find_layout, fits, is_assignment
from ._missing import marks_missing

_SAMPLE = 65_536  # characters at the beginning and the end from which the layout is determined
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_NAMES = re.compile(r"[\"'#%(\[\s]*[^\W\d]")  # of a line that may contain names
_HEADS = 8  # repeated groups of lines that are tried as names
_LINE = re.compile(r"[^\r\n]+")
_ARRIVED = re.compile(r"^(\d\d:\d\d:\d\d[.,]\d+) -> (?=.*?([;\t,]|$))", re.MULTILINE)
_MARK = re.compile(r"[\W_]*(run|test|trial|record)?[\W_]*(\d{1,3}|(?<![^\W_])[a-h])?$")  # of a run
_TITLE = re.compile(
    r"^\W*(run|record|recording|trial|test|sweep|measurement|messung)[ _#.:]*\w{1,8}\W*$",
    re.IGNORECASE | re.MULTILINE,
)
_WRAPPED = re.compile(r"^[ \t]*[(\[][ \t]*([-+.\d][^()\[\]\r\n]*)[)\]],?[ \t]*$", re.MULTILINE)
_PREAMBLE = 50  # lines above labelled readings
_LABEL = re.compile(r"([^\W\d]\w*)[ ]?[:=][ ]?([-+.\d][^\s,;]*)")
_LABELS = re.compile(rf"\s*{_LABEL.pattern}(?:[\s,;]+{_LABEL.pattern})+[\s,;]*")
_EXPONENT = re.compile(r"(?<=[\d.])[dD](?=[+-]\d\d)")  # of Fortran
_NOWHERE = "\x1f"  # a delimiter that no text has
_IDEOGRAPHS = "\u3005\u4e00-\u9fff"
_SCRIPTS = {  # encodings that are tried: letters of the script
    "cp932": f"\u3040-\u30ff{_IDEOGRAPHS}",  # Japanese
    "euc_kr": "\uac00-\ud7a3",  # whose letters have no others among the Chinese ones
    "gb2312": _IDEOGRAPHS,
    "cp1251": "\u0400-\u04ff",  # Cyrillic
}


def read_table(path, delimiter=None, decimal=None):
    """Return the tables of a delimited text file, as `parse_table` does."""
    return parse_table(_decode(path.read_bytes()), delimiter, decimal)


def parse_table(text, delimiter=None, decimal=None):
    """Return the tables in a text: for each its names, units and columns, and the interval.

    The numbers may follow a preamble, a line of names and a line of units, and be followed by a
    footer of text. Without a line of names, names are the positions; without units, these are "";
    the interval in s is None if the preamble does not contain it. There is more than one table if
    the line of names is repeated, below its rows or next to itself, or if a line such as "Run 2"
    stands between rows. Columns are floats or objects (text).
    """
    # a serial monitor writes "12:00:00.123 -> " before each line
    text = _ARRIVED.sub(lambda found: found[1] + (delimiter or found[2] or " "), text)
    text = _EXPONENT.sub("E", text.replace("\N{MINUS SIGN}", "-"))
    text = _labelled(_WRAPPED.sub(r"\1", text))
    blocks = _repeated(text, delimiter, decimal) or _titled(text, delimiter, decimal)
    tables = []
    for block in blocks:
        if block is blocks[0] or len(_lines(block, 0, _SAMPLE)) > 1:  # names without rows
            tables += _side_by_side(*_parsed(block, delimiter, decimal))
    return tables


def _labelled(text):
    """Return readings with their labels, as "u:1.5,x:2" for a serial plotter, as a table."""
    if not any(_LABELS.fullmatch(line[0]) for line in islice(_LINE.finditer(text), _PREAMBLE)):
        return text
    lines = [line[0] for line in _lines(text, 0, len(text))]
    rows = [_LABEL.findall(line) if _LABELS.fullmatch(line) else [] for line in lines]
    used = [i for i, row in enumerate(rows) if row]
    rows = rows[used[0] : used[-1] + 1]  # text may be above and below
    names = [name for name, _ in rows[0]]
    if any([name for name, _ in row] != names for row in rows):
        return text
    values = ["\t".join(value for _, value in row) for row in rows]
    return "\n".join(["\t".join(names), *values])


def _repeated(text, delimiter, decimal):
    """Return the parts of a text whose line of names is repeated, None if it is not."""
    lines = [line[0] for line in _lines(text, 0, _SAMPLE)]
    first = {line: i for i, line in reversed(list(enumerate(lines)))}
    again = [first[line] < i and bool(_NAMES.match(line)) for i, line in enumerate(lines)]
    begins = (i for i, is_again in enumerate(again) if is_again and not again[i - 1])
    for stop in (*islice(begins, _HEADS), len(lines)):
        try:
            layout = find_layout(lines[:stop], delimiter, decimal)
        except RecordError:
            continue
        repeated = [*takewhile(again.__getitem__, range(stop, len(lines)))]
        at = layout.names_at
        if at is not None and (stop == len(lines) or lines[at] in [lines[i] for i in repeated]):
            return _parts(text, lines[at], layout)
    return None


def _parts(text, names, layout):
    """Return the parts of a text, each from below the rows above a line of names."""
    heads = [*re.finditer(rf"^{re.escape(names)}\s*$", text, re.MULTILINE)]
    starts = [0]
    for above, head in pairwise(heads):
        start = head.start()
        for line in reversed(_lines(text, above.end(), start)):
            if fits(layout.form, layout.form_of(fields(line[0], layout.delimiter))):
                break
            start = line.start()  # as of a second segment of LabVIEW
        starts.append(start)
    parts = [text[start:end] for start, end in pairwise([*starts, len(text)])]
    return parts if len(parts) > 1 else None


def _titled(text, delimiter, decimal):
    """Return the parts of a text between lines such as "Run 2", each below the first's head."""
    titles = [*_TITLE.finditer(text)]
    for number, title in enumerate(titles):
        try:
            layout, begin, _ = _table(text[: title.start()], delimiter, decimal)
        except RecordError:  # the title of the first
            continue
        if layout.n_rows > 1:
            starts = [title.end() for title in titles[number:]]
            ends = [*(title.start() for title in titles[number + 1 :]), len(text)]
            parts = [text[start:end] for start, end in zip(starts, ends, strict=True)]
            return [text[: title.start()], *(text[:begin] + part for part in parts)]
    return [text]


def _side_by_side(names, units, columns, interval):
    """Return tables whose names repeat side by side, without the blank rows below them.

    Names that begin with a time repeat, too, if a mark follows them, as in t1, u1, y1, t2, u2, y2.
    The names are those of the first table, the units its own of each.
    """
    used = [i for i, v in enumerate(columns) if names[i] != str(i) or not pd.isna(v).all()]
    bare = [_MARK.sub("", without_unit(names[i]).lower()) for i in used]
    plain = [without_unit(names[i]) for i in used]
    for shown, least in ((plain, 2), (bare, 3)):
        widths = (n for n in range(least, len(shown) // 2 + 1) if len(shown) % n == 0)
        width = next((n for n in widths if shown == shown[:n] * (len(shown) // n)), None)
        if width and len(set(shown[:width])) == width and (least == 2 or is_time(shown[0])):
            break
    else:
        return [(*_without_copies(names, units, columns), interval)]
    tables, own = [], [unit_of(name) or unit for name, unit in zip(names, units, strict=True)]
    if any(own[i] != own[used[n % width]] for n, i in enumerate(used)):
        names, units = [without_unit(name) for name in names], own
    for k in range(0, len(used), width):
        group = used[k : k + width]
        empty = np.logical_and.reduce([pd.isna(columns[i]) for i in group])
        stop = len(empty) - int(np.argmin(empty[::-1])) if not empty.all() else 0
        first = [names[i] for i in used[:width]]
        tables.append(
            (first, [units[i] for i in group], [columns[i][:stop] for i in group], interval)
        )
    return tables


def _without_copies(names, units, columns):
    """Return the columns without copies of the same name and values, such as repeated times."""
    kept = [
        i
        for i, name in enumerate(names)
        if not any(
            names[k] == name
            and units[k] == units[i]
            and pd.Series(columns[k]).equals(pd.Series(columns[i]))
            for k in range(i)
        )
    ]
    return tuple([part[i] for i in kept] for part in (names, units, columns))


def _parsed(text, delimiter, decimal):
    layout, begin, end = _table(text, delimiter, decimal)
    separator = {None: _NOWHERE, " ": r"\s+"}.get(layout.delimiter, layout.delimiter)
    frame = pd.read_csv(
        io.StringIO(text[begin:end]),
        sep=separator,
        header=None,
        decimal=layout.sign,
        skipinitialspace=True,
        low_memory=False,
        na_values=sorted(BEYOND),
    )
    names, units = layout.head
    columns = [_as_numbers(frame[column], layout.sign).to_numpy() for column in frame.columns]
    _refuse_other_names(text[begin:end], names, layout)
    while len(columns) > 1 and _is_unnamed(names[-1]) and pd.isna(columns[-1]).all():
        for part in (names, units, columns):  # a delimiter at the end of every line
            part.pop()
    names = [name or str(i) for i, name in enumerate(names)]
    return names, units, columns, layout.interval


def _refuse_other_names(table, names, layout):
    """Refuse a line within a table that has its names in another order or with other units."""
    bare = sorted(map(without_unit, names))
    longest = max(bare, key=len)
    for found in re.finditer(re.escape(longest), table) if longest else ():
        line = _LINE.search(table, table.rfind("\n", 0, found.start()) + 1)
        if sorted(map(without_unit, fields(line[0], layout.delimiter))) == bare:
            raise RecordError(
                f"the line {line[0].strip()!r} within it has the names in another order or with "
                "other units: store what is below it in a file of its own"
            )


def _as_numbers(column, mark):
    """Return a column of text as numbers if its readings are, as 1.5, ---, 1.234,50 or 1'234.5."""
    if column.dtype.kind != "O":
        return column
    text = column.dropna().astype(str).str.strip()
    text = text[[not marks_missing(cell) for cell in text]]
    other = "." if mark == "," else ","
    groups = rf"\d{{1,3}}(?:[{other}'’\s]\d{{3}})+|\d*"
    form = rf"[+-]?(?:{groups})(?:\{mark}\d*)?(?:[eE][+-]?\d+)?"
    if text.empty or not text.str.fullmatch(form).all():
        return column
    text = text.str.replace(rf"[{other}'’\s]", "", regex=True).str.replace(mark, ".")
    numbers = text.map(float)
    return numbers.reindex(column.index) if np.isfinite(numbers).all() else column


def _is_unnamed(name):
    return not name.strip() or is_assignment(name)


def _table(text, delimiter, decimal):
    """Return the layout, and the first and last position of its table in the text."""
    lines = _lines(text, 0, _SAMPLE)
    if len(lines) > 1 and len(text) > _SAMPLE:
        lines.pop()  # the sample may cut it in two
    if not lines:
        raise RecordError("it is empty")
    layout = find_layout([line[0] for line in lines], delimiter, decimal)
    begin = lines[layout.first].start()
    rows, lines = layout.rows[layout.first :], lines[layout.first :]
    if len(text) > _SAMPLE:
        lines = _lines(text, max(len(text) - _SAMPLE, begin), len(text))
        lines = lines[1:] or lines  # the first may be cut
        rows = [fields(line[0], layout.delimiter) for line in lines]
    n_rows, odd = layout.ends(rows)
    if odd is not None:
        raise RecordError(
            f"line {1 + text.count(chr(10), 0, lines[odd].start())}, {' '.join(rows[odd])[:40]!r}, "
            "below the table is not a row of it: delete it, as where a logger was stopped in it"
        )
    return layout, begin, lines[n_rows - 1].end()


def _lines(text, start, end):
    """Return the lines that are not blank, as matches."""
    return [line for line in _LINE.finditer(text, start, end) if line[0].strip()]


def _decode(data):
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    for zero, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):  # without a byte order mark
        if not any(data[zero:_SAMPLE:2]) and all(data[1 - zero : _SAMPLE : 2]):
            return data.decode(encoding)
    if _BINARY.search(data):
        raise RecordError("it is binary, not text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        head = data[:_SAMPLE].rsplit(b"\n", 1)[0]  # which ends with a whole character
        encoding = next((c for c in _SCRIPTS if _is_written_in(head, c)), "")
        encoding = encoding or ("cp1250" if _is_central_european(head) else "cp1252")
        return data.decode(encoding, "replace")


def _is_central_european(data):
    """Whether Windows-1250 gives a letter within a word where Windows-1252 gives a symbol."""
    text, signs = data.decode("cp1250", "replace"), data.decode("cp1252", "replace")
    return any(
        before.isalpha() and letter.isalpha() and after.isalpha() and not sign.isalpha()
        for before, letter, after, sign in zip(text, text[1:], text[2:], signs[1:], strict=False)
    )


def _is_written_in(data, encoding):
    """Whether all letters beyond ASCII belong to the script of an encoding, and form words.

    Bytes of another encoding give other letters, or single ones within ASCII words: an é and the
    letter after it decode as one Japanese character.
    """
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        return False
    script, latin, fewest = f"[{_SCRIPTS[encoding]}]", "[A-Za-z]", 2
    mixed = f"{latin}{script}+{latin}"
    if encoding == "cp1251":  # in which all bytes are letters
        mixed, fewest = f"{latin}{script}|{script}{latin}", 4
    letters = [c for c in text if not c.isascii() and c.isalpha()]
    return (
        all(re.match(f"{script}|[\u00b5\u0370-\u03ff]", c) for c in letters)  # and Greek ones
        and re.search(f"{script}{{{fewest}}}", text) is not None
        and re.search(mixed, text) is None
    )
