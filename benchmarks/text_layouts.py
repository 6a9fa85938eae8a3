"""Text files of every layout, read back: right, refused, or wrong.

    python benchmarks/text_layouts.py [--layouts 2000] [--seed 0] [--show right|refused|wrong]

A layout is drawn from what instruments and spreadsheets write: delimiter, decimal sign, formats of
numbers, names, units, preamble, footer, padding, quotes, blank lines, line ends and encoding, and a
table of two rows or more. Right: every column of numbers is read, by its name where it has one and
by its position, as it was written. Refused: a RecordError. Wrong: other values. The bars are none
wrong and 97 % right; some, such as integers between commas without names, have no one truth.
"""

import argparse
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from skhyst.exceptions import RecordError
from skhyst.records import read_records

__all__ = ["draw_layout", "judge"]

_BAR = 0.97
_SIGNS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), (" ", ","))
_FORMATS = ("%.2f", "%.3f", "%.6f", "%.5g", "%.4e", "%d")
_NAMES = ("voltage", "path", "force", "temperature", "current", "sensor 2", "gap (upper)", "U_1")
_UNITS = ("V", "um", "N", "degC", "mA", "µm", "nm", "[V]", "(um)", "-")
_PREAMBLE = (
    *("Rig 7, cellar", "Operator: Smith", "Sampling rate: 1000 Hz", "saved 2024-05-31 12:00:00"),
    *(
        "# made by a controller",
        "Channels=3",
        "[Header]",
        "% a comment",
        "Gain;2.5",
        "Device\tE-625",
    ),
)
_FOOTER = ("# end", "End of file", "-- 200 samples --", "Stopped by user", "mean: 1.25", "% done")


def draw_layout(rng):
    """Return the bytes of a file, its columns by position, and their names, None without them.

    A column that holds text or times is None.
    """
    delimiter, decimal = _SIGNS[rng.integers(len(_SIGNS))]
    n_rows = int(rng.choice([2, 3, 5, 20, 200, 4000], p=[0.1, 0.1, 0.2, 0.3, 0.25, 0.05]))
    n_columns = int(rng.integers(1, 5))
    kinds = ["n"] * n_columns
    if n_columns > 1 and rng.random() < 0.2:
        kinds[0] = str(rng.choice(["clock", "date", "label"]))
    cells, truth = zip(
        *(_column(rng, kind, i, n_rows) for i, kind in enumerate(kinds)), strict=True
    )
    cells = [[cell.replace(".", decimal) for cell in column] for column in cells]
    if delimiter == "," and decimal == "." and rng.random() < 0.2:
        cells, decimal = [[f'"{c.replace(".", ",")}"' for c in column] for column in cells], ","
    names = _names(rng, delimiter, n_columns)
    lines = [*_head(rng, names, delimiter, n_columns)]
    lines += _rows(rng, cells, delimiter)
    if rng.random() < 0.2:
        lines += list(rng.choice(_FOOTER, rng.integers(1, 3), replace=False))
    if rng.random() < 0.1:
        lines.insert(len(lines) - n_rows, "")
    text = str(rng.choice(["\n", "\r\n", "\r"], p=[0.6, 0.35, 0.05])).join([*lines, ""])
    encoding = rng.choice(["utf-8", "utf-8-sig", "latin-1", "utf-16"], p=[0.6, 0.15, 0.15, 0.1])
    return text.encode(encoding), truth, names


def _column(rng, kind, i, n_rows):
    """Return the cells of a column as text with points, and the numbers that they stand for."""
    step = 10.0 ** -rng.integers(0, 5)
    if kind == "clock":
        return [f"12:00:{0.01 * k:06.3f}" for k in range(n_rows)], None
    if kind == "date":
        return [f"2024-05-31T12:00:{0.01 * k:06.3f}" for k in range(n_rows)], None
    if kind == "label":
        return [f"run{k // 2}" for k in range(n_rows)], None
    form = _FORMATS[rng.integers(len(_FORMATS))]
    if i == 0 and rng.random() < 0.7:  # time
        values = step * np.arange(n_rows)
    else:
        values = 10.0 ** rng.integers(-3, 4) * rng.normal(size=n_rows) + rng.integers(0, 2) * 50.0
    cells = [form % value for value in values]
    return cells, np.array([float(cell) for cell in cells])


def _names(rng, delimiter, n_columns):
    if rng.random() < 0.25:
        return None
    chosen = rng.choice([n for n in _NAMES if delimiter != " " or " " not in n], n_columns, False)
    return [str(name) for name in chosen]


def _head(rng, names, delimiter, n_columns):
    """Yield the lines above the table."""
    if rng.random() < 0.3:
        yield from rng.choice(_PREAMBLE, rng.integers(1, 5), replace=False)
        if rng.random() < 0.5:
            yield ""
    if names:
        mark = "# " if rng.random() < 0.1 else ""
        quote = '"' if rng.random() < 0.1 else ""
        yield mark + delimiter.join(f"{quote}{name}{quote}" for name in names)
        if rng.random() < 0.2:
            yield delimiter.join(rng.choice(_UNITS, n_columns))


def _rows(rng, cells, delimiter):
    """Return the lines of the table."""
    style = rng.choice(["plain", "padded", "spaced", "ended"], p=[0.7, 0.1, 0.1, 0.1])
    if style == "padded":
        width = max(len(cell) for column in cells for cell in column) + 1
        cells = [[cell.rjust(width) for cell in column] for column in cells]
    separator = f"{delimiter} " if style == "spaced" else delimiter
    end = delimiter if style == "ended" and delimiter != " " and len(cells) > 1 else ""
    return [separator.join(row) + end for row in zip(*cells, strict=True)]


def judge(path, truth, names):
    """Return "right", "refused" or "wrong"."""
    refused = False
    for i, values in enumerate(truth):
        for column in (i,) if names is None else (i, names[i]):
            if values is None:
                continue
            try:
                found = read_records(path, drive=column)[0].iloc[:, 0].to_numpy()
            except RecordError:
                refused = True
                continue
            if found.shape != values.shape or not np.allclose(found, values, 1e-12, 0.0):
                return "wrong"
    return "refused" if refused else "right"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layouts", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", choices=("right", "refused", "wrong"), default="wrong")
    options = parser.parse_args()
    counts = Counter()
    with TemporaryDirectory() as folder:
        for number in range(options.layouts):
            data, truth, names = draw_layout(np.random.default_rng([options.seed, number]))
            path = Path(folder, "rig.txt")
            path.write_bytes(data)
            verdict = judge(path, truth, names)
            counts[verdict] += 1
            if verdict == options.show:
                print(f"{verdict}, layout {number}: {data[:300]!r}")
    for verdict in ("right", "refused", "wrong"):
        print(f"{verdict:8s} {counts[verdict]:6d} ({counts[verdict] / options.layouts:.1%})")
    return int(counts["wrong"] > 0 or counts["right"] < _BAR * options.layouts)


if __name__ == "__main__":
    sys.exit(main())
