"""Searches over many recordings, with one row per recording in a table that can be resumed."""

import importlib.util
import re
from itertools import islice
from pathlib import Path

import pandas as pd
from joblib import effective_n_jobs
from sklearn.base import clone

from .._files import check_input, check_outputs, replacing
from ..records import read_records
from ._workers import workers

_TEXTS = ("file", "failure", "effects", "verdict", "options")
_ERRORS = ("error_before", "error_after", "noise_floor")
# Recordings per worker and batch. Workers wait for the slowest recording of a batch: with 8 each,
# about an eighth of the time.
_BATCH = 8


def diagnose_files(
    files, search, *, reading=None, summary=None, force=False, n_jobs=None, on_done=None
) -> pd.DataFrame:
    """Search each of many recordings for missing effects.

    Parameters
    ----------
    files : sequence of str or Path
        Recordings, as :func:`skhyst.records.read_records` reads them.
    search : EffectSearchCV
        Not fitted; a clone of it is fitted to each recording. Its own ``n_jobs`` is used only if
        one recording is searched at a time.
    reading : dict, default=None
        Options of :func:`skhyst.records.read_records`: ``drive``, ``response``, ``time`` and so on.
    summary : str or Path, default=None
        Table to write, ``.parquet`` or ``.csv``; it is updated after each batch. Recordings that it
        contains are not searched again, so that an interrupted run can be resumed.
    force : bool, default=False
        Whether to start again if the table exists.
    n_jobs : int, default=None
        Number of recordings searched in parallel, by joblib; its backend, a cluster included, is
        chosen by :class:`joblib.parallel_config`.
    on_done : callable, default=None
        Called after each batch with its rows, a DataFrame.

    Returns
    -------
    DataFrame
        One row per recording, in the order of ``files``, followed by other rows that the table had:
        ``file``; ``failure``, the error message of a recording that could not be searched, else "";
        ``effects``, joined by ", "; ``verdict``; ``error_before``, ``error_after`` and
        ``noise_floor``; ``options``, those of reading and of the search; and for each parameter of
        the model that was found ``param NAME`` and ``std NAME``, NaN where the recording's model
        has none of that name.

    Raises
    ------
    ImportError
        If the table is to be ``.parquet`` and pyarrow is not installed (extra ``io``).
    ValueError
        If a recording is named twice, the table's name has another suffix, or the existing table
        was made with other options.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import pandas as pd
    >>> from skhyst.diagnosis import EffectSearchCV
    >>> from skhyst.fleet import diagnose_files
    >>> from skhyst.linear import FirstOrderLagOperator, Gain
    >>> rng = np.random.default_rng(0)
    >>> u = np.sin(0.1 * np.arange(300)) + 0.3 * rng.normal(size=300)
    >>> y = FirstOrderLagOperator(0.05).run(u, 0.01)[0] + 0.01 * rng.normal(size=300)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "stage.csv")
    ...     pd.DataFrame({"u": u, "y": y}).to_csv(path, index=False)
    ...     table = diagnose_files(
    ...         [path], EffectSearchCV(Gain(), effects=["lag"]),
    ...         reading={"drive": "u", "response": "y", "sampling_rate": 100.0})
    >>> table["effects"].tolist()
    ['lag']
    """
    files, reading = [str(file) for file in files], dict(reading or {})
    if len(set(files)) < len(files):
        raise ValueError("The 'files' parameter of diagnose_files must name each recording once.")
    options = _options(search, reading)
    path, done = None, pd.DataFrame({"file": []}, dtype=object)
    if summary is not None:
        path = Path(summary)
        done = _rows_there(path, files, options, force)
    left = iter([file for file in files if file not in set(done["file"])])
    at_a_time = effective_n_jobs(n_jobs)
    size = _BATCH * at_a_time if at_a_time > 1 else 1
    with workers(n_jobs) as run:
        while batch := list(islice(left, size)):
            jobs = [(file, clone(search), reading, options) for file in batch]
            rows = pd.DataFrame(run(_row, jobs))
            done = pd.concat([done, rows], ignore_index=True) if len(done) else rows
            if path is not None:
                _write(done, path)
            if on_done is not None:
                on_done(rows)
    order = {file: number for number, file in enumerate(files)}
    return done.sort_values("file", key=lambda names: names.map(order), ignore_index=True)


def read_summary(path) -> pd.DataFrame:
    """Read a table that :func:`diagnose_files` has written.

    Parameters
    ----------
    path : str or Path
        Ends in ``.parquet`` or ``.csv``.

    Returns
    -------
    DataFrame

    Raises
    ------
    ValueError
        If the name has another suffix, or the file is not a table of :func:`diagnose_files`.

    Examples
    --------
    >>> from skhyst.fleet import read_summary
    >>> read_summary("summary.txt")
    Traceback (most recent call last):
    ...
    ValueError: The summary must end in .parquet or .csv. Got summary.txt instead.
    """
    path = Path(path)
    parquet = _is_parquet(path)
    check_input(path)
    if parquet:
        table = pd.read_parquet(path)
    else:  # as text: exact numbers, and "nan" stays text in columns of text
        table = pd.read_csv(path, dtype=str, keep_default_na=False)
    if not set(_TEXTS) <= set(table.columns):
        raise ValueError(f"{path} is no table of diagnose_files.")
    texts = {name: table[name].astype(object) for name in _TEXTS}
    numbers = table.columns.difference(_TEXTS)
    return table.assign(**texts, **{n: table[n].replace("", "nan").astype(float) for n in numbers})


def _is_parquet(path):
    if path.suffix.lower() not in (".parquet", ".csv"):
        raise ValueError(f"The summary must end in .parquet or .csv. Got {path} instead.")
    return path.suffix.lower() == ".parquet"


def _rows_there(path, files, options, force):
    """Return the rows of an existing table that was made with the same options."""
    if _is_parquet(path) and importlib.util.find_spec("pyarrow") is None:
        raise ImportError(
            f'{path} needs pyarrow. Install it with: python -m pip install "skhyst[io]"'
        )
    check_outputs([path], [Path(file) for file in files], force=True)
    if force or not path.exists():
        return pd.DataFrame({"file": []}, dtype=object)
    table = read_summary(path)
    if (table["options"] != options).any():
        raise ValueError(
            f"{path} was made with other options: give them again, or another file, or add --force "
            "(in Python force=True) to begin anew."
        )
    return table


def _options(search, reading):
    """Return the options that the rows of a table depend on, as text; not those of parallelism."""
    same = clone(search).set_params(n_jobs=None, verbose=0)
    text = f"{same.__repr__(N_CHAR_MAX=100_000)} {sorted(reading.items())}"
    return re.sub(r" at 0x[0-9a-f]+", "", " ".join(text.split()))  # addresses change


def _row(file, search, reading, options):
    """Return the row of one recording."""
    row = {"file": file, "failure": "", "effects": "", "verdict": "", "options": options}
    try:
        search.fit(*read_records(file, **reading))
    except Exception as error:  # an error of one recording must not stop the others
        return row | {"failure": f"{type(error).__name__}: {error}"}
    row |= {"effects": ", ".join(search.effects_), "verdict": search.verdict_}
    row |= {name: float(getattr(search, f"{name}_")) for name in _ERRORS}
    model = search.best_estimator_
    for kind, attribute in (("param", "params_"), ("std", "params_std_")):
        values = getattr(model, attribute, {})
        row |= {f"{kind} {name}": float(value) for name, value in values.items()}
    return row


def _write(table, path):
    with replacing(path) as (part,):
        table.to_parquet(part, index=False) if _is_parquet(path) else table.to_csv(
            part, index=False
        )
