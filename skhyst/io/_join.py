"""Join the columns of one recording that is stored in several files."""

from pathlib import Path

import numpy as np
import pandas as pd

from ..exceptions import RecordError
from ._file_columns import load_column, long_columns
from ._formats import opened


def join_files(paths, *, delimiter=None, decimal=None) -> pd.DataFrame:
    r"""Put the columns of several files of one recording side by side.

    Parameters
    ----------
    paths : sequence of str or Path
        Files with one row for each sample, as :func:`~skhyst.records.read_records` reads them.
    delimiter, decimal : str, optional
        Of delimited text, as in :func:`~skhyst.records.read_records`.

    Returns
    -------
    DataFrame of shape (n_samples, n_columns)
        Names have their units in brackets. A column that is equal in all files, such as the time,
        occurs once; other names that repeat are prefixed by the name of their file.
        ``attrs["interval"]`` is the sampling interval in s, if a file gives it; ``attrs["name"]``
        are the names of the files.

    Raises
    ------
    RecordError
        If a file cannot be read, or the files differ in their number of rows or their interval.

    See Also
    --------
    skhyst.records.read_records : Read the columns, such as those of the joined frame, as records.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> from skhyst.io import join_files
    >>> with TemporaryDirectory() as folder:
    ...     files = [Path(folder, name) for name in ("H.csv", "B.csv")]
    ...     _ = files[0].write_text("t,H\n0,1.5\n1,2.5\n")
    ...     _ = files[1].write_text("t,B\n0,0.3\n1,0.4\n")
    ...     join_files(files).columns.tolist()
    ['t', 'H', 'B']
    """
    columns, intervals = {}, {}
    for path in map(Path, paths):
        source, variables = opened(path, delimiter=delimiter, decimal=decimal)
        for place in long_columns(variables):
            column = load_column(source, variables, place.position)
            if column.interval is not None:
                intervals[source.name] = column.interval
            columns[source.name, place.full_name] = column.values
    sizes = {file: len(values) for (file, _), values in columns.items()}
    for values_by_file, kind in ((sizes, "rows"), (intervals, "s from sample to sample")):
        if len(set(values_by_file.values())) > 1:
            listed = ", ".join(f"{file} {value:g}" for file, value in values_by_file.items())
            raise RecordError(f"Files of one recording must agree. Got {listed} {kind} instead.")
    joined = {}
    for (file, name), values in columns.items():
        same = [v for (_, column), v in columns.items() if column == name]
        is_shared = all(np.array_equal(same[0], v) for v in same)
        joined[name if is_shared else f"{Path(file).stem} {name}"] = values
    frame = pd.DataFrame(joined)
    frame.attrs["name"] = ", ".join(dict.fromkeys(file for file, _ in columns))
    if intervals:
        frame.attrs["interval"] = next(iter(intervals.values()))
    return frame
