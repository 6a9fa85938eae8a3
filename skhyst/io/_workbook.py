"""Excel workbooks: the cells of each sheet, parsed as delimited text.

A workbook is an archive of XML, which is read row by row. A few bytes can place a cell in any of a
million rows and 16,384 columns, so the blank rows and cells in between are counted, and must not
exceed the bytes of the archive.
"""

import re
import warnings
import zipfile
from datetime import date, time

from .._sizes import check_archive
from ..exceptions import RecordError
from ._text import parse_table

# An entry of a sound workbook is not compressed to less than 1 %: the limit of Apache POI
# (ZipSecureFile.setMinInflateRatio), which exempts the first 100 kB of an entry, too.
_DENSEST, _SPARED = 100, 100_000
_NUMBER = re.compile(r"[-+.\d]")


def read_workbook(path, openpyxl):
    """Return the tables by the title of the sheet, for every sheet with a table.

    Formulas are not evaluated: their saved values are read.
    """
    budget = _declared(path)
    tables_by_sheet, reasons = {}, ["it has no sheet"]
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # about styles, charts and the like
        book = openpyxl.load_workbook(file, read_only=True, data_only=True, keep_links=False)
        for sheet in book.worksheets:
            rows, budget = _cells(sheet, budget)
            text = "\n".join(map(_as_line, rows))
            try:
                try:
                    tables = parse_table(text, "\t", ".")
                except RecordError:  # its numbers may be text
                    tables = parse_table(text, "\t", ",")
            except RecordError as error:  # a sheet of notes
                reasons.append(f"in the sheet {sheet.title!r} {error}")
            else:
                tables_by_sheet[sheet.title] = tables
        book.close()
    if not tables_by_sheet:
        raise RecordError(reasons[-1])
    return tables_by_sheet


def _declared(path):
    """Return the uncompressed bytes of all entries; refuse entries compressed beyond the limit."""
    with zipfile.ZipFile(path) as archive:
        check_archive(archive, path.stat().st_size)
        entries = archive.infolist()
    for entry in entries:
        if entry.file_size > _SPARED + _DENSEST * entry.compress_size:
            raise RecordError(
                f"{entry.filename} declares {entry.file_size} bytes, of which the file holds "
                f"{entry.compress_size}"
            )
    return sum(entry.file_size for entry in entries)


def _cells(sheet, budget):
    """Return the rows of a sheet as text fields of equal number, and the remaining budget."""
    sheet.reset_dimensions()  # the declared size of the sheet may be wrong
    rows, width = [], 0
    for row in sheet.iter_rows(values_only=True):
        width = max(width, len(row))
        rows.append([_cell(value) for value in row])
        if (1 + width) * len(rows) > budget:
            raise RecordError(f"the sheet {sheet.title!r} spreads few cells over a wide table")
    used = [i for i in range(width) if any(row[i : i + 1] not in ([], [""]) for row in rows)]
    rows = [[row[i] if i < len(row) else "" for i in used] for row in rows]
    return rows, budget - (1 + width) * len(rows)


def _cell(value):
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, date | time):
        return value.isoformat()
    return " ".join(str(value).replace('"', "'").split())


def _as_line(row):
    """Return a row as a tab-separated line; of a row with a single text, this text only."""
    (first, *more) = [cell for cell in row if cell] or [""]
    if not more and not _NUMBER.match(first):
        return first
    return "\t".join(row if len(row) > 1 else [*row, ""])  # one column: every line ends in a tab
