"""Delimited text: find its layout, then read the columns."""

import io
import re

import pandas as pd

from ..exceptions import RecordError
from ._layout import fields, find_layout

_SAMPLE = 65_536  # characters at the beginning and the end from which the layout is determined
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_LINE = re.compile(r"[^\r\n]+")
_NOWHERE = "\x1f"  # a delimiter that no text has


def read_table(path, delimiter=None, decimal=None):
    """Return the names, units and columns of a delimited text file, as floats or objects (text).

    The numbers may follow a preamble, a line of names and a line of units, and be followed by a
    footer of text. Without a line of names, these are the positions; without units, they are "".
    """
    return parse_table(_decode(path.read_bytes()), delimiter, decimal)


def parse_table(text, delimiter=None, decimal=None):
    """Return the names, units and columns of a table in a text, as `read_table` does."""
    layout, begin, end = _table(text, delimiter, decimal)
    separator = {None: _NOWHERE, " ": r"\s+"}.get(layout.delimiter, layout.delimiter)
    frame = pd.read_csv(
        io.StringIO(text[begin:end]),
        sep=separator,
        header=None,
        decimal="," if layout.commas else ".",
        skipinitialspace=True,
        low_memory=False,
    )
    names, units = layout.head
    columns = [frame[column].to_numpy() for column in frame.columns]
    while len(columns) > 1 and not names[-1].strip() and pd.isna(columns[-1]).all():
        for own in (names, units, columns):  # a delimiter at the end of every line
            own.pop()
    return [name or str(i) for i, name in enumerate(names)], units, columns


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
    return layout, begin, lines[layout.ends(rows) - 1].end()


def _lines(text, start, end):
    """Return the lines that are not blank, as matches."""
    return [line for line in _LINE.finditer(text, start, end) if line[0].strip()]


def _decode(data):
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    if _BINARY.search(data):
        raise RecordError("it is binary, not text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
