"""Layout of delimited text: its delimiter, first and last row of its table, types of its columns.

Every delimiter is tried. It splits a line into fields, each a number, a date or clock time, text,
or blank; the table is the longest run of rows of one form, weighted by the fraction of columns with
numbers or times. Several delimiters may give a table: ``0,5`` is one number or two. Then the names
of the columns decide, and if they do not, the text is refused: a wrong guess would be worse.
"""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from itertools import dropwhile, groupby, pairwise

from ..exceptions import RecordError
from ._column_names import SYMBOLS, interval_of, unit_of
from ._missing import marks_missing

_DELIMITERS = (";", "\t", ",", " ", None)  # " ": any white space; None: there is one column
_SHOWN = 40  # characters of a line that a message shows
_FORMS = 20  # forms of rows that are tried, the most frequent ones
_POINT = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")
_INTEGER = re.compile(r"[+-]?\d+")
_FRACTION = re.compile(r"0\d+([eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+(,\d+)?")
_STAMP = re.compile(r"(\d{4}-\d\d-\d\d[T ]?)?(\d+:\d\d(:\d\d([.,]\d+)?)?)?(Z|[+-]\d\d:?\d\d)?")
BEYOND = {"inf", "-inf", "+inf", "∞", "-∞"}  # of the instrument's range
_BLANK = {"", "nan", "-nan", "na", "n/a", "#n/a", "null", "none", "<na>", *BEYOND}
_UNIT = re.compile(rf"[(\[<{{].*[)\]>}}]|[-–]+|{SYMBOLS}")
_SPELLED = {  # as instruments write them
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
    **dict.fromkeys(("watt", "watts"), "W"),
    "newton": "N",
    "sequence": "",  # the number of the row
    "value": "",
}
_NAMES_OF = re.compile(r"(trace|signal|channel|column)?[ _]?names?|signal", re.IGNORECASE)
_MARK = re.compile(r"\W*(data|end[ _]?(of[ _]?)?header)\W*", re.IGNORECASE)
_NUMBERED = re.compile(r"name[ _]?(\d+)\s*[=:]\s*(.+)", re.IGNORECASE)
_UNITS_OF = re.compile(
    r"((vert(ical)?|[vy]_?|trace|signal|channel)[ _]?)?units?([ _]label)?", re.IGNORECASE
)
_UNIT_OF_TIME = re.compile(r"(horizontal|[hx]_?)[ _]?units?([ _]label)?", re.IGNORECASE)
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_ASSIGNED = re.compile(rf"([^=:]+?)\s*[=:]\s*({_NUMBER})\s*([munµμ]?s|[kM]?Hz)?")
# as "Sampling period 0.002 s", "Abtastrate;500;Hz" or "Sampling rate: 1,000 Hz"
_STATED = re.compile(
    rf"([^=:;]+?)[\s=:;]+(\d{{1,3}}(?:,\d{{3}})+|\d+,\d+|{_NUMBER})[\s;]*([a-zµμ]+(?:/s)?)?",
    re.IGNORECASE,
)
_WITH_UNIT = re.compile(rf"{_NUMBER}\s+(?:{SYMBOLS})")
_COMMENTED = re.compile(r"([#%]*)\s*(.*)", re.DOTALL)
_FACT = re.compile(r"\w+:\s+\S+")  # of Octave: "# columns: 3", which are no names of columns
_NO_UNIT = re.compile(r"[-–]*|1")
_SETTLE = (
    "pass delimiter=',' where they separate columns, or decimal=',' where they are decimal signs"
)


@dataclass(frozen=True)
class Layout:
    """A text split by one delimiter: its lines as rows, and the table in them.

    ``form`` has one letter per column: numbers ("n"), times ("s"), text ("t") or blank ("b");
    ``decimal`` is the decimal sign that was given, None for any.
    """

    delimiter: str | None
    decimal: str | None
    rows: list
    form: str
    first: int
    last: int
    n_rows: int  # of the longest run

    @property
    def table(self):
        """Rows of the table, among those of the sample."""
        return self.rows[self.first : self.last + 1]

    @property
    def commas(self):
        """Numbers with a comma in the table."""
        return [field for row in self.table for field in row if _COMMA.fullmatch(field)]

    @property
    def sign(self):
        """Decimal sign of the table."""
        return self.decimal or ("," if self.commas else ".")

    @property
    def splits_numbers(self):
        """Whether a field after a comma is the fraction of a number, as 05 in 1,05."""
        table = self.table if self.delimiter == "," else []
        return any(_FRACTION.fullmatch(field) for row in table for field in row[1:])

    @property
    def head(self):
        """Names and units of the columns, "" if there is none.

        Names are in the line above the table, or above the line of units; else in lines with a key
        of their own, or above all attributes of each column.
        """
        if self._keyed_names:
            return self._keyed_names
        fitting, width, above, known = [], len(self.form), self.first, None
        while above and _MARK.fullmatch("".join(self.rows[above - 1])):
            above -= 1
        for row in reversed(self.rows[max(above - 2, 0) : above]):
            row = _uncommented(row, width)
            row = row[:known]
            while len(row) > width and row[-1].lower() in ("", "comment"):
                row = row[:-1]  # a name without a column
            if len(row) > width:  # values of the preamble follow the units, below their keys
                row = [*dropwhile(_is_number, reversed(row))][::-1]
                known = len(row)
            if not width - 1 <= len(row) <= width or not any(map(_is_text, row)):
                break
            fitting.append([*row, ""][:width])
        named = fitting and all(map(_is_text, fitting[0])) and len({*fitting[0]}) == width
        if not named and self._above:
            return self._above
        if not fitting:
            return [""] * width, [""] * width
        last, above = fitting[0], fitting[-1]
        if len(fitting) > 1 and any(above) and _are_units(above) and not _are_units(last):
            return last, list(map(_bare_unit, above))
        if len(fitting) > 1 and _are_units(last) and (_are_names(above) or _are_spelled(last)):
            keyed = self._keyed_units(width)  # above a row of "Second,Value,Value"
            return above, [
                _bare_unit(field) or unit for field, unit in zip(last, keyed, strict=True)
            ]
        return last, self._keyed_units(width)

    @property
    def names_at(self):
        """Number of the row of names, None if there is none."""
        names = {*self.head[0]} - {""}
        rows = [_uncommented(row, len(self.form)) for row in self.rows[: self.first]]
        return max((i for i, row in enumerate(rows) if names and names <= {*row}), default=None)

    @property
    def _keyed_names(self):
        """Names and units from lines with a key, None if there is no such line.

        A line has its key in a column that is blank in the table ("trace_names,time,Out1"), or
        before each of its values ("Name,u,Name,x"), or it gives one name ("NAME0 = command").
        """
        width, rows = len(self.form), self.rows[: self.first]
        numbered = [_NUMBERED.fullmatch(_assignment(row)) for row in rows]
        by_number = {int(found[1]): found[2].strip() for found in numbered if found}
        if by_number:
            return [by_number.get(i, "") for i in range(width)], [""] * width
        pairs = [row for row in rows if 2 < len(row) == width and len({*row[::2]}) == 1]
        keyed = {row[0].lower(): ["sample", *row[1:]] for row in pairs}
        if not keyed:
            blank = self.form[0] == "b"
            rows = [row for row in rows if len(row) == width + (not blank)]
            keyed = {row[0].lower(): [""] * blank + row[1:] for row in rows}
        names = next((values for key, values in keyed.items() if _NAMES_OF.fullmatch(key)), None)
        if not names:
            return None
        units = next(
            (values for key, values in keyed.items() if _UNITS_OF.fullmatch(key)), [""] * width
        )
        units = [_bare_unit(unit) for unit in units]
        if pairs:
            odd = range(0, width, 2)
            return [
                [filler if i in odd else field for i, field in enumerate(values)]
                for values, filler in ((names, "sample"), (units, ""))
            ]
        paths = keyed.get("path", [""] * width)
        names = [
            f"{path}/{name}" if path else name for path, name in zip(paths, names, strict=True)
        ]
        return names, units

    @property
    def _above(self):
        """Names and units from all lines on each column above the table, None if there are none."""
        width, first = len(self.form), self.first
        while first and len(self.rows[first - 1]) == width:
            first -= 1
        while first < self.first and _UNITS_OF.fullmatch(self.rows[first][0]):
            first += 1  # a line with its key is not the first of the lines on each column
        block = self.rows[first : self.first]
        if len(block) < 3 or not all(block[0]) or not _are_names(block[0]):
            return None
        units = block[1] if _are_units(block[1]) else [""] * width
        return block[0], [_bare_unit(field) for field in units]

    def _keyed_units(self, width):
        """Return the units in lines above the names, as "Vertical Units,V,V" or CH1:V,CH2:V."""
        units = [""] * width
        for row in self.rows[: self.first]:
            row = [row[0], *(field.rpartition(":")[2] for field in row[1:])]
            values = [field for field in row[1:] if field]
            cells = row[1:width] if len(row) >= width else values
            if _UNIT_OF_TIME.fullmatch(row[0]) and values and _are_units(values[:1]):
                units[0] = _bare_unit(values[0])
            elif _UNITS_OF.fullmatch(row[0]) and len(values) == width and _are_units(values):
                units = list(map(_bare_unit, values))
            elif _UNITS_OF.fullmatch(row[0]) and len(cells) == width - 1 and _are_units(cells):
                units[1:] = map(_bare_unit, cells)
        return units

    @property
    def interval(self):
        """Sampling interval in s from the lines above the table, None if they do not contain it."""
        mark = "," if self.delimiter == "," else " "
        for row, below in pairwise([*self.rows[: self.first], []]):
            for i, field in enumerate([mark.join(row).lstrip("#% "), *row], -1):
                stated = _STATED.fullmatch(field)
                name, value, unit = stated.groups("") if stated else (field.rstrip(" :="), "", "")
                beside = [*row[i + 1 : i + 2], *below[i : i + 1]] if i >= 0 and not value else []
                for number in map(self._number, (value, *beside)):
                    behind = "" if value else next(iter(row[i + 2 : i + 3]), "")
                    for one in (unit,) if unit else (behind, ""):  # the cell may be another fact
                        found = number and interval_of(name, number, one)
                        if found:
                            return found
        return None

    def _number(self, field):
        """Return a positive number above the table, None if it is none or has two meanings."""
        if self.commas:
            field = "" if _GROUPED.fullmatch(field) else field.replace(",", ".")
        elif _THOUSANDS.fullmatch(field):
            field = field.replace(",", "")
        number = float(field) if re.fullmatch(_NUMBER, field) else 0.0
        return number if number > 0.0 else None

    def ends(self, rows):
        """Return the number of rows to the end of the table, and that of one that is no footer."""
        fitting = [
            i
            for i, row in enumerate(rows)
            if fits(self.form, self.form_of(row)) and _names_value(row) <= _names_value(rows[0])
        ]
        if not fitting:
            raise RecordError("its last lines are not rows of the table that it begins with")
        n_rows = fitting[-1] + 1
        below = (i for i in range(n_rows, len(rows)) if not self._is_footer(rows[i]))
        return n_rows, next(below, None)

    def _is_footer(self, row):
        """Whether a row is blank, or has text in the first column of numbers or times."""
        kinds = self.form_of(row)
        key = next(i for i, kind in enumerate(self.form) if kind in "ns")
        field = kinds[key : key + 1] or kinds.replace("s", "n")
        return set(kinds) == {"b"} or _names_value(row) or not set(field) & {"n", "s", "b"}

    def form_of(self, row):
        """Return a letter for each field: a number, a time, text, blank, or "x": not split."""
        return "".join(_kind(field, self.decimal) for field in row)


def find_layout(lines, delimiter, decimal):
    """Return the layout of a text, from its first lines or all of them."""
    _refuse_units(lines, delimiter)
    layouts = []
    for candidate in _DELIMITERS if delimiter is None else (delimiter,):
        layout = _under(lines, candidate, decimal)
        # a comma cannot be both, unless numbers with decimal commas are in quotes
        split = candidate == decimal == "," and layout and not layout.commas
        if layout and (delimiter or not split):
            layouts.append(layout)
    if not layouts:
        first = lines[0].strip()[:_SHOWN] if lines else ""
        raise RecordError(
            "it has no row of numbers between separators, each without its unit. It begins with "
            f"{first!r}"
        )
    most = max(layout.n_rows for layout in layouts)
    layouts = [layout for layout in layouts if layout.n_rows == most]
    layouts = [layout for layout in layouts if layout.delimiter in (";", "\t")] or layouts
    layouts = [layout for layout in layouts if not layout.splits_numbers] or layouts
    if len(layouts) > 1:
        layouts = [layout for layout in layouts if _is_named(layout)]
    if len(layouts) != 1:
        raise RecordError(f"its commas or blanks can be read in several ways: {_SETTLE}")
    (layout,) = layouts
    _refuse_odd_rows(layout)
    if not decimal and delimiter != ",":
        _refuse_commas(layout)
    if not decimal:
        _refuse_points(layout)
    return layout


def fields(line, delimiter):
    """Return the fields of a line."""
    if delimiter is None:
        return [line.strip().strip('"')]
    if delimiter == " ":
        mark, names = _COMMENTED.fullmatch(line.strip()).groups()
        if mark and _FACT.fullmatch(names):
            return [line.strip()]
        aligned = re.split(r"\s{2,}", names)
        # names that may have blanks, as "Time (s)"
        if len(aligned) > 1 and (mark or all(map(unit_of, aligned))):
            return [mark + aligned[0], *aligned[1:]]
        line = " ".join(line.split())
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error as error:
        raise RecordError(f"a line is not a row of a table ({error})") from error
    return [field.strip() for field in row]


def fits(form, kinds):
    """Whether a row of the form ``kinds`` can be one of a table of the given form."""
    return (
        len(kinds) == len(form)
        and "x" not in kinds
        and any(kind in "ns" for kind in kinds)
        and all(a == b or a in "tb" or b == "b" for a, b in zip(form, kinds, strict=True))
    )


def _names_value(row):
    """Whether a row is a name with its value, as "mean: 1.25" below a column of labels."""
    return row[0].endswith(":")


def _under(lines, delimiter, decimal):
    """Return the layout under a delimiter, None if it gives no table."""
    rows = [fields(line, delimiter) for line in lines]
    forms = ["".join(_kind(field, decimal) for field in row) for row in rows]
    known = [
        form
        for form, _ in Counter(forms).most_common(_FORMS)
        if "n" in form and "x" not in form and (len(form) > 1) == (delimiter is not None)
    ]
    if not known:
        return None
    form = max(known, key=lambda form: _longest(form, forms) * _numeric_fraction(form))
    runs = _runs(form, forms)
    (start, n_rows), (first, _) = max(runs, key=lambda run: run[1]), runs[0]
    last = sum(runs[-1]) - 1
    blank = [i for i, kind in enumerate(form) if kind == "b"]
    same = [i for i in range(first, start) if fits(form, forms[i])]
    same = [i for i in same if all(forms[i][k] == "b" for k in blank)]
    if first < start and 2 * len(same) < start - first:
        # mostly other rows: a preamble, if it contains names or a value for each column
        below = Layout(delimiter, decimal, rows, form, start, last, n_rows)
        first = start if below._keyed_names or all(below.head[0]) else first
    while first and "n" in forms[first - 1] and not set(forms[first - 1]) & {"t", "x"}:
        first -= 1  # rows of numbers of another width are refused later, not read as a header
    return Layout(delimiter, decimal, rows, form, first, last, n_rows)


def _runs(form, forms):
    """Return the first row and the length of each run of rows that fit."""
    ends = [0]
    runs = []
    for fit, rows_of_run in groupby(forms, key=lambda kinds: fits(form, kinds)):
        ends.append(ends[-1] + len(list(rows_of_run)))
        runs += [(ends[-2], ends[-1] - ends[-2])] if fit else []
    return runs


def _longest(form, forms):
    """Return the length of the longest run of rows that fit."""
    return max(length for _, length in _runs(form, forms))


def _numeric_fraction(form):
    return sum(kind in "ns" for kind in form) / len(form)


def _kind(field, decimal):
    if marks_missing(field):
        return "b"
    if _is_number(field, decimal):
        return "n"
    if _STAMP.fullmatch(field):
        return "s"
    parts = field.split()
    several = len(parts) > 1 and all(_is_number(part, decimal) for part in parts)
    cut = field[0] == "," or field[-1] == ","
    return "x" if several or cut or ";" in field or "\t" in field else "t"


def _is_number(field, decimal=None):
    if _INTEGER.fullmatch(field):
        return True
    point = decimal != "," and _POINT.fullmatch(field)
    grouped = decimal == "," and _GROUPED.fullmatch(field)
    return bool(point or grouped or (decimal != "." and _COMMA.fullmatch(field)))


def _is_text(field):
    return field.lower() not in _BLANK and not _is_number(field)


def _are_names(row):
    return all(map(_is_text, filter(None, row)))


def _are_units(row):
    words = [field for field in row if field.lower() not in _BLANK]
    return all(_UNIT.fullmatch(field) or field.lower() in _SPELLED for field in words) or (
        # numbers of the preamble may follow them, such as the start and increment of the time
        _are_spelled(row)
    )


def _are_spelled(row):
    words = [field.lower() for field in row if _is_text(field)]
    return len(words) > 1 and all(field in _SPELLED for field in words)


def _bare_unit(field):
    unit = _SPELLED.get(field.lower(), "" if _is_number(field) else field.strip("()[]<>{}"))
    return "" if _NO_UNIT.fullmatch(unit) or unit.lower() in _BLANK else unit


def is_assignment(field):
    """Whether a field assigns a value, such as "tInc = 1e-3", instead of being a name."""
    return bool(_ASSIGNED.fullmatch(field))


def _assignment(row):
    """Return a row as one text, without comment marks."""
    return " ".join(row).lstrip("#% ")


def _uncommented(row, width):
    if row and row[0].startswith(("#", "%")):
        row = [row[0].lstrip("#% ").strip('"'), *row[1:]]
        row = row[1:] if len(row) == width + 1 and not row[0] else row
    return row


def _is_named(layout):
    """Whether the line above the table has as many names as columns, none of them a unit."""
    if not layout.first:
        return False
    row = _uncommented(layout.rows[layout.first - 1], len(layout.form))
    if len(row) != len(layout.form) or not all(map(_is_text, row)):
        return False
    if layout.delimiter is None:
        return not set(row[0]) & {",", ";", "\t"}
    return _are_units(row) or not any(_UNIT.fullmatch(name) for name in row)


def _refuse_units(lines, delimiter):
    """Refuse a text most of whose lines have cells such as 1.5 V."""
    for candidate in _DELIMITERS[:3] if delimiter is None else (delimiter,):
        cells = [next(filter(_WITH_UNIT.fullmatch, fields(line, candidate)), "") for line in lines]
        if 2 * len([*filter(None, cells)]) > len(lines):
            cell = next(filter(None, cells))
            raise RecordError(
                f"its cells hold units, as {cell!r}: leave the numbers alone in them, and write "
                "the units behind the names, as in 'time [s]'"
            )


def _refuse_odd_rows(layout):
    """Refuse rows of another width, and a first row that may be the numbers of the columns."""
    width, table = len(layout.form), layout.table
    odd = next((row for row in table if len(row) != width), None)
    if odd:
        raise RecordError(f"{' '.join(odd)[:40]!r} is not a row of a table of {width} columns")
    first, *rest = table
    numbers = [[str(i) for i in range(start, start + width)] for start in (0, 1)]
    if any(layout.head[0]) or width == 1 or not rest or first not in numbers:
        return
    columns = zip(*rest, strict=True)
    if all(any(not _INTEGER.fullmatch(field) for field in column) for column in columns):
        raise RecordError(f"its first row, {' '.join(first)}, may number the columns: name them")


def _refuse_commas(layout):
    """Refuse commas that may be decimal signs, or thousands separators."""
    written = [f for row in layout.table for f in row if _kind(f, None) == "n"]
    integers = layout.delimiter == "," and all(map(_INTEGER.fullmatch, written))
    if integers and "nn" in layout.form and not _is_named(layout):
        raise RecordError(f"its commas may be decimal signs: {_SETTLE}")
    if layout.commas and all(map(_THOUSANDS.fullmatch, layout.commas)):
        raise RecordError("its commas may separate thousands: pass decimal=',' where they do not")


def _refuse_points(layout):
    """Refuse points that may separate thousands: behind them always three digits, as in 17.143.

    Beside whole numbers below 1000, as no number of fixed decimals is written.
    """
    for column in zip(*layout.table, strict=True):
        whole = [field for field in column if _INTEGER.fullmatch(field)]
        pointed = [f for f in column if f not in whole and _kind(f, None) == "n"]
        if (
            whole
            and pointed
            and all(_GROUPED.fullmatch(f) and "," not in f for f in pointed)
            and all(len(f.lstrip("+-")) < 4 for f in whole)
        ):
            raise RecordError(
                f"the point of {pointed[0]} may separate thousands: pass decimal=',' where it "
                "does, decimal='.' where it is a decimal sign"
            )
