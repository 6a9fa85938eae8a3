"""Readers of file formats: one small function per format returns the variables of a file.

Nothing in a file is ever executed: pickled objects, MATLAB objects and function handles are listed
and refused, and so are HDF5 data that are stored in another file.
"""

import importlib
import io
import json
import math
import re
import warnings
import zipfile
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from .._files import check_input
from .._sizes import Finite, check_archive, check_array, check_size, largest_size
from ..exceptions import RecordError
from ._column_names import interval_of, is_time, unit_of
from ._mat_objects import matlab_object, matlab_text
from ._mat_tags import check_tags
from ._text import read_table
from ._workbook import read_workbook

_HDF5 = b"\x89HDF\r\n\x1a\n"
_OPAQUE = ("s0", "s1", "s2", "arr")  # name, type system, class, content of a MATLAB object
_UNIT_FIELDS = ("unit", "units")
_REFERENCES = "references or lists of different lengths"
_TIME_UNIT = "timeunit"  # of the interval, as in an iddata of MATLAB
_NAME_FIELDS = ("name", "label")  # the latter of Simulink
_LINES = (".jsonl", ".ndjson")  # JSON, a record in each line


@dataclass(frozen=True)
class Variable:
    """One array of a file, loaded when it is needed.

    ``name`` is "" where the file holds one array without a name; ``refused`` is the reason why it
    is not read, "" where it is read. ``unit`` is the unit if the file gives it elsewhere than in
    the name, else ""; ``interval`` is the sampling interval in s, None if the file does not give
    it. ``group`` is the first part of the name: that of a group, struct or sheet.
    """

    name: str
    shape: tuple
    load: Callable
    refused: str = ""
    unit: str = ""
    interval: float | None = None
    group: str = ""

    @property
    def label(self):
        """The name with its unit."""
        is_separate = self.unit and not unit_of(self.name)
        return f"{self.name} [{self.unit}]" if is_separate else self.name

    @property
    def bare(self):
        """The name within the group."""
        return self.name[len(self.group) + 1 :] if self.group else self.name

    @property
    def bare_label(self):
        """The name within the group with its unit."""
        return replace(self, name=self.bare, group="").label


def _file_variables(path, layout):
    """List the variables of a file by its suffix; ``layout`` are options of delimited text."""
    if path.suffix.lower() not in _READERS:
        remedy = _ELSEWHERE.get(path.suffix.lower(), "")
        raise RecordError(
            f"The 'path' parameter of read_records must end in one of {', '.join(_READERS)}. "
            f"Got {path.name!r} instead.{remedy}"
        )
    check_input(path)
    if path.stat().st_size == 0:
        raise RecordError(f"{path.name} is empty: {_expected(path)} was expected.")
    with reading(path):
        variables = _with_scalars(_READERS[path.suffix.lower()][0](path, **layout))
        if not variables:
            raise RecordError("it holds no variable")
    return variables


def _with_scalars(variables):
    """Return variables with the metadata in scalars next to them: a rate, a unit, a name.

    A rate applies to its group or struct and to those within it. A unit and a name belong to the
    only array of a struct, ``units.u`` to the array ``u``, and ``TimeUnit`` to times and intervals.
    """
    facts, arrays, kept = {}, {}, []
    for v in variables:
        kind = v.bare.lower()
        if v.refused or not _is_single(v):
            arrays.setdefault(v.group, []).append(v.name)
            kept.append(v)
        elif v.group.lower().endswith(_UNIT_FIELDS):
            facts[re.split(r"[./]?\w+$", v.group)[0], "unit of", v.bare] = v.load()
        elif kind in (*_UNIT_FIELDS, *_NAME_FIELDS, _TIME_UNIT):
            facts[v.group, kind] = v.load()
        else:
            if interval_of(v.bare, 1.0) is not None:
                facts.setdefault((v.group, "rates"), []).append(v)
            kept.append(v)
    return [
        v if _is_single(v) else _with_file_facts(v, facts, len(arrays.get(v.group, ())) == 1)
        for v in kept
    ] or variables


def _is_single(variable):
    return math.prod(variable.shape) == 1


def _with_file_facts(variable, facts, is_only):
    """Return a variable with the interval, unit and name that the file gives for it."""
    group, changes = variable.group, {}
    while variable.interval is None and "interval" not in changes:
        for rate in facts.get((group, "rates"), ()):
            value = np.ravel(rate.load())
            keys = [(group, "unit of", rate.bare), (group, _TIME_UNIT)]
            unit = rate.unit or next((word for key in keys if (word := _word(facts.get(key)))), "")
            if value.dtype.kind in "iuf" and value[0] > 0.0:
                changes.setdefault("interval", interval_of(rate.bare, float(value[0]), unit))
        if not group:
            break
        group = re.split(r"[./]?[^./]+$", group)[0]
    keys = [(variable.group, "unit of", variable.bare)]
    keys += [(variable.group, kind) for kind in _UNIT_FIELDS] if is_only else []
    keys += [(variable.group, _TIME_UNIT)] if is_time(variable.bare) else []
    unit = next((text for key in keys if (text := _word(facts.get(key)))), "")
    if unit and not variable.unit:
        changes["unit"] = unit
    names = [_word(facts.get((variable.group, kind))) for kind in _NAME_FIELDS]
    if is_only and variable.group and any(names):
        changes |= {"name": next(filter(None, names)), "group": ""}
    return replace(variable, **changes) if changes else variable


def _word(value):
    value = np.ravel(np.empty(0) if value is None else value)
    return str(value[0]).strip() if value.size == 1 and value.dtype.kind in "OUST" else ""


@dataclass(frozen=True)
class Table:
    """A frame instead of a file: its name and suffix in error messages."""

    name: str = "the frame"
    suffix: str = ""


def opened(source, **layout):
    """Return a path, or a Table for a frame, and the variables in it.

    ``layout`` holds the options of delimited text, None if they are not given.
    """
    is_frame = hasattr(source, "columns")
    name = getattr(source, "attrs", {}).get("name", Table.name)
    path = Table(name) if is_frame else Path(source).expanduser()
    layout = {name: value for name, value in layout.items() if value is not None}
    if layout and _READERS.get(path.suffix.lower()) is not _TEXT:
        raise ValueError(
            f"The {' and '.join(map(repr, layout))} of read_records must be None where 'path' is "
            f"no delimited text. Got {path.name!r} instead."
        )
    return path, _frame_variables(source) if is_frame else _file_variables(path, layout)


def _frame_variables(frame):
    """List the columns of a frame or table, and the levels of its index unless it counts rows.

    Units are those of pint, or of a dict ``frame.attrs["units"]``; the sampling interval in s is
    ``frame.attrs["interval"]``, the name in messages ``frame.attrs["name"]``.
    """
    if hasattr(frame, "column_names"):  # an Arrow table
        frame = frame.to_pandas()
    attributes = getattr(frame, "attrs", {})
    units, interval = attributes.get("units", {}), attributes.get("interval")
    if hasattr(frame, "iloc") and not isinstance(frame.index, pd.RangeIndex):
        frame = frame.reset_index()
    columns = [
        frame.iloc[:, i] if hasattr(frame, "iloc") else frame[:, i] for i in range(frame.shape[1])
    ]
    pint_units = [getattr(c.dtype, "units", None) for c in columns]
    return [
        Variable(
            str(c.name),
            (len(c),),
            c.to_numpy if unit is None else partial(c.to_numpy, dtype=float),
            unit=str(units.get(c.name, "")) if unit is None else f"{unit:~}",
            interval=interval,
        )
        for c, unit in zip(columns, pint_units, strict=True)
    ]


@contextmanager
def reading(path):
    """Turn every fault of a parser into a RecordError that names the file."""
    try:
        yield
    except (ImportError, PermissionError):
        raise
    except Exception as error:  # on broken files parsers raise exceptions of any type
        reason = str(error) or type(error).__name__
        raise RecordError(
            f"{path.name} cannot be read: {_expected(path)} was expected, but {reason}."
        ) from error


def _expected(path):
    return _READERS.get(path.suffix.lower(), (None, "a table"))[1]


def _optional(name, suffix):
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(
            f"Reading {suffix} files needs {name.split('.')[0]}: pip install 'skhyst[io]'."
        ) from error


def _held(name, values):
    """Return the variables of an array in memory; a struct or a cell array has more than one."""
    refused = _refusal(values)
    if refused:
        if values.dtype.names == _OPAQUE:  # scipy keeps its name in the first field only
            name = matlab_text(values.flat[0]["s0"])
        return [Variable(name, getattr(values, "shape", ()), lambda: values, refused)]
    if values.dtype.names and values.dtype.hasobject:  # MATLAB struct
        return [
            part
            for label, element in _elements(name, values)
            for field in values.dtype.names
            for part in _held(f"{label}.{field}", element[field])
        ]
    if values.dtype.names:
        return [
            Variable(_join(name, field, "."), values.shape, partial(values.__getitem__, field))
            for field in values.dtype.names
        ]
    if values.dtype.hasobject and any(isinstance(v, np.ndarray) for v in values.flat):  # cell
        return [part for label, cell in _elements(name, values) for part in _held(label, cell)]
    return [Variable(name, values.shape, lambda: values)]


def _refusal(values):
    kind = type(values).__name__
    if kind == "MatlabFunction":
        return "a MATLAB function handle"
    if kind == "MatlabObject":
        return matlab_object(values.classname)
    if kind == "MatlabOpaque":
        return matlab_object(values.flat[0]["s2"] if values.dtype.names == _OPAQUE else "object")
    return "" if isinstance(values, np.ndarray) else f"{kind}, not an array"


def _elements(name, values):
    if values.size == 1:
        return [(name, values.flat[0])]
    return [(f"{name}[{i}]", value) for i, value in enumerate(values.ravel(order="F"))]


def _join(group, name, separator):
    return f"{group}{separator}{name}" if group else name


def _read_text(path, **layout):
    return _table_variables({"": read_table(path, **layout)})


def _read_workbook(path):
    return _table_variables(read_workbook(path, _optional("openpyxl", path.suffix)))


def _table_variables(sheets):
    """Return the variables of tables by sheet; each of several tables is a group."""
    variables = []
    for sheet, tables in sheets.items():
        for number, (names, units, columns, interval) in enumerate(tables, 1):
            parts = [sheet] * (len(sheets) > 1) + [str(number)] * (len(tables) > 1)
            group = "/".join(parts)
            variables += [
                Variable(
                    _join(group, name, "/"),
                    values.shape,
                    partial(np.asarray, values),
                    unit=unit,
                    interval=interval,
                    group=group,
                )
                for name, unit, values in zip(names, units, columns, strict=True)
            ]
    return variables


def _read_npy(path):
    with path.open("rb") as file:
        check_array(file, path.stat().st_size)
    return _held("", np.lib.format.open_memmap(path, mode="r").view(np.ndarray))


def _read_npz(path):
    with zipfile.ZipFile(path) as archive:
        check_archive(archive, path.stat().st_size)
        return [part for entry in archive.infolist() for part in _npz_entry(archive, entry)]


def _npz_entry(archive, entry):
    """Return the variables of one array of an archive."""
    name = entry.filename.removesuffix(".npy")
    try:
        with archive.open(entry) as stream:
            check_array(stream, entry.file_size)
    except ValueError as error:  # RecordError is one
        return [Variable(name, (), partial(np.empty, 0), f"no array: {error}")]
    with archive.open(entry) as stream:
        return _held(name, np.lib.format.read_array(stream, allow_pickle=False))


def _read_mat(path):
    from scipy.io import loadmat
    from scipy.io.matlab import matfile_version

    with path.open("rb") as file:
        head = file.read(520)
    if _HDF5 in (head[:8], head[512:]):
        return _read_hdf5(path, matlab=True)
    data = path.read_bytes()  # read once: the parser must get the bytes that are checked here
    if matfile_version(io.BytesIO(data))[0] == 1:
        check_tags(data)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*`spmatrix`", DeprecationWarning)  # either is refused
        content = loadmat(io.BytesIO(data), struct_as_record=True, chars_as_strings=True)
    return [
        replace(variable, group=variable.name.rpartition(".")[0])
        for name, values in content.items()
        if not name.startswith("__")
        for variable in _held(name, values)
    ]


def _read_hdf5(path, matlab=False):
    h5py = _optional("h5py", path.suffix)
    variables = []

    def collect(name, item):
        if not isinstance(item, h5py.Dataset) or (matlab and name.startswith("#")):
            return
        shown = name.replace("/", ".") if matlab else name
        if matlab and _hdf5_refusal(h5py, item) == _REFERENCES:  # of a struct array or a cell
            labels = [label for label, _ in _elements("", item[()].T)]
            targets = [file[one] if one else None for one in item[()].T.ravel(order="F")]
            if all(isinstance(t, h5py.Dataset) and t.dtype.kind != "O" for t in targets):
                is_cell = matlab_text(item.attrs.get("MATLAB_class", b"")) == "cell"
                for label, target in zip(labels, targets, strict=True):
                    inner = f"{shown}{label}" if is_cell else f"{label}.".join(shown.rsplit(".", 1))
                    held(target.name, target, inner)
                return
        held(name, item, shown)

    def held(name, item, shown):
        shape = item.shape or ()
        refused = _hdf5_refusal(h5py, item)
        for field in item.dtype.names or (None,):
            load = partial(_hdf5_values, h5py, path, name, field, matlab)
            full = shown if field is None else f"{shown}.{field}"
            size = (1,) if _is_text(item) else shape[::-1] if matlab else shape
            group = full[: -len(field or shown.rpartition("." if matlab else "/")[2]) - 1]
            variables.append(
                Variable(full, size, load, refused, *_hdf5_unit_and_interval(item), group)
            )

    with h5py.File(path, "r") as file:
        file.visititems(collect)  # follows no link to another file
    return variables


def _hdf5_unit_and_interval(item):
    """Return the unit of a dataset, and the interval from its attributes or those of its groups."""
    attributes = dict(item.attrs)
    lower = {key.lower(): value for key, value in item.attrs.items()}
    unit = next((lower[key] for key in ("unit", "units", "unit_string") if key in lower), "")
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    facts, group = attributes, item
    while group.name != "/":
        group = group.parent
        facts = dict(group.attrs) | facts
    interval = None
    for key, value in facts.items():
        value = np.ravel(value)
        if value.size == 1 and value.dtype.kind in "iuf" and value[0] > 0:
            interval = interval_of(key, float(value[0])) or interval
    return unit if isinstance(unit, str) else "", interval


def _hdf5_refusal(h5py, item):
    kind = matlab_text(item.attrs.get("MATLAB_class", b""))
    objects = item.dtype.kind == "O" and h5py.check_string_dtype(item.dtype) is None
    reasons = {
        "a MATLAB function handle": kind == "function_handle",
        "MATLAB text or empty": "MATLAB_empty" in item.attrs
        or (kind == "char" and not _is_text(item)),
        matlab_object(kind): "MATLAB_object_decode" in item.attrs,
        "data that are stored in another file": item.external or item.is_virtual,
        "empty": item.shape is None,
        _REFERENCES: objects,
    }
    reason = next((reason for reason, holds in reasons.items() if holds), "")
    if not reason and item.nbytes > largest_size(item.id.get_storage_size()):
        reason = "larger than the data stored in the file"
    return reason


def _is_text(item):
    """Whether a dataset is one line of text of MATLAB, which stores it as numbers."""
    is_char = matlab_text(item.attrs.get("MATLAB_class", b"")) == "char"
    return is_char and "MATLAB_empty" not in item.attrs and item.ndim == 2 and 1 in item.shape


def _hdf5_values(h5py, path, name, field, transpose):
    with h5py.File(path, "r") as file:
        item = file[name]
        if transpose and _is_text(item):
            return np.array(["".join(map(chr, item[()].ravel()))])
        text = h5py.check_string_dtype(item.dtype) is not None
        values = item.asstr()[()] if text else item[()] if field is None else item[field]
    # MATLAB stores arrays in column-major order
    return np.asarray(values).T if transpose else np.asarray(values)


def _read_json(path):
    data = path.read_bytes()
    try:
        content = json.loads(data)
    except json.JSONDecodeError:  # a record in each line
        content = [json.loads(line) for line in data.splitlines() if line.strip()]
    content = [content] if isinstance(content, dict) and path.suffix in _LINES else content
    return _json_variables("", content, path.stat().st_size)


def _flat(row):
    """Return a record with the entries of the records within it, as sensor.position."""
    flat = {}
    for name, value in row.items():
        inner = _flat(value) if isinstance(value, dict) else {"": value}
        flat |= {_join(name, key, ".") if key else name: one for key, one in inner.items()}
    return flat


def _json_variables(name, content, size, group=""):
    """Return the variables of a part of a file of ``size`` bytes."""
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        content = [_flat(row) for row in content]
        names = dict.fromkeys(key for row in content for key in row)
        if len(names) * len(content) > size:  # a reading takes at least one byte
            raise RecordError(f"its {len(content)} rows share few of {len(names)} names")
        content = {key: [row.get(key) for row in content] for key in names}
    if isinstance(content, dict):
        return [
            variable
            for key, value in content.items()
            for variable in _json_variables(_join(name, key, "."), value, size, name)
        ]
    try:
        values = np.asarray(content, dtype=float)
    except ValueError:
        values = np.asarray(content, dtype=object)
    except (TypeError, OverflowError):
        return [Variable(name, (), partial(np.empty, 0), "neither numbers nor text")]
    if any(isinstance(value, list) for value in values.flat):
        return [Variable(name, values.shape, partial(np.empty, 0), "rows of different lengths")]
    return [Variable(name, values.shape, lambda: values, group=group)]


def _read_parquet(path):
    parquet = _optional("pyarrow.parquet", path.suffix)
    with parquet.ParquetFile(path) as file:
        fields, size = list(file.schema_arrow), path.stat().st_size
        rows = max(file.metadata.num_rows, *_parquet_rows(file))
        check_size("its table", rows * _arrow_width(fields), size)
        groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
        check_size("its pages", sum(group.total_byte_size for group in groups), size)
    load, names = partial(_parquet_values, parquet, path), [field.name for field in fields]
    return [
        Variable(
            field.name,
            (rows,),
            partial(load, field.name, names[:i].count(field.name)),
            "lists or structs" if field.type.num_fields else "",
        )
        for i, field in enumerate(fields)
    ]


def _parquet_rows(file):
    """Return the declared contents of the row groups, and of each plain column's chunks."""
    groups = [file.metadata.row_group(i) for i in range(file.num_row_groups)]
    plain = [j for j, entry in enumerate(file.schema) if entry.max_repetition_level == 0]
    return [
        sum(group.num_rows for group in groups),
        *(sum(group.column(j).num_values for group in groups) for j in plain),
    ]


def _arrow_width(fields):
    """Return the bytes of a row in memory: of a number at least 8, of text those of a reference."""
    return sum(max(_arrow_bits(field.type) // 8, 8) for field in fields)


def _arrow_bits(kind):
    """Return the bits of a value of an Arrow type, 0 if they vary, as for text."""
    try:
        return _arrow_bits(kind.value_type) if hasattr(kind, "index_type") else kind.bit_width
    except ValueError:
        return 0


def _parquet_values(parquet, path, name, occurrence):
    with parquet.ParquetFile(path, read_dictionary=[name]) as file:
        values = file.read(columns=[name]).column(occurrence)
    return _arrow_values(name, values, path.stat().st_size)


def _arrow_values(name, values, size):
    """Return a column of a file of ``size`` bytes."""
    if not hasattr(values.type, "index_type"):
        return values.to_numpy()
    if not _arrow_bits(values.type):  # one stored text may be the value of all rows
        lengths = [
            len(text) * int(count)
            for part in values.chunks
            for text, count in zip(
                part.dictionary.to_pylist(),
                np.bincount(part.indices.drop_null().to_numpy(), minlength=len(part.dictionary)),
                strict=True,
            )
        ]
        check_size(f"the text in {name!r}", sum(lengths), size)
    return values.cast(values.type.value_type).to_numpy()  # which alone would fill missing cells


def _read_feather(path):
    ipc, arrow = (_optional(name, path.suffix) for name in ("pyarrow.ipc", "pyarrow"))
    content = arrow.py_buffer(path.read_bytes())  # columns are views of it, not copies
    with ipc.open_file(content) as file:
        fields = list(file.schema)
    with _feather_columns(ipc, content, [0]) as file:
        rows = sum(file.get_batch(i).num_rows for i in range(file.num_record_batches))
    check_size("its table", rows * _arrow_width(fields), content.size)
    load = partial(_feather_values, ipc, content)
    return [
        Variable(field.name, (rows,), partial(load, i, field.name))
        for i, field in enumerate(fields)
    ]


def _feather_columns(ipc, content, columns):
    return ipc.open_file(content, options=ipc.IpcReadOptions(included_fields=columns))


def _feather_values(ipc, content, column, name):
    with _feather_columns(ipc, content, [column]) as file:
        values = file.read_all().column(0)
    values.validate(full=True)  # offsets of strings in a broken file may point outside the data
    return _arrow_values(name, values, content.size)


def _read_tdms(path):
    nptdms = _optional("nptdms", path.suffix)
    with Finite(path) as stream, nptdms.TdmsFile.open(stream) as file:
        channels = [
            (group.name, channel.name, len(channel), _tdms_unit_and_interval(channel.properties))
            for group in file.groups()
            for channel in group.channels()
        ]
    load = partial(_tdms_values, nptdms, path)
    return [
        Variable(f"{g}/{c}", (length,), partial(load, g, c), "", *facts, g)
        for g, c, length, facts in channels
    ]


def _tdms_unit_and_interval(properties):
    """Return the unit and the interval of a channel; LabVIEW writes 0 for an unknown interval."""
    interval = float(properties.get("wf_increment", 0.0))
    return str(properties.get("unit_string", "")).strip(), interval if interval > 0.0 else None


def _tdms_values(nptdms, path, group, channel):
    with Finite(path) as stream, nptdms.TdmsFile.open(stream) as file:
        return np.asarray(file[group][channel][:])


def _read_wav(path):
    from scipy.io import wavfile

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)  # chunks other than samples
        warnings.filterwarnings("error", "Reached EOF", wavfile.WavFileWarning)
        # from memory, so that a length in the header beyond the file allocates nothing
        rate, values = wavfile.read(io.BytesIO(path.read_bytes()))
    return [Variable("channel", values.shape, lambda: values, interval=1.0 / rate)]


_TEXT = (_read_text, "a table of delimited text")
_READERS = {
    ".csv": _TEXT,
    ".txt": _TEXT,
    ".tsv": _TEXT,
    ".dat": _TEXT,
    ".lvm": _TEXT,
    ".asc": _TEXT,
    ".xlsx": (_read_workbook, "an Excel workbook"),
    ".mat": (_read_mat, "a MATLAB file"),
    ".npy": (_read_npy, "a NumPy array"),
    ".npz": (_read_npz, "an archive of NumPy arrays"),
    ".json": (_read_json, "a JSON list of rows, list of records or dict of columns"),
    **dict.fromkeys(_LINES, (_read_json, "JSON with a record in each line")),
    ".h5": (_read_hdf5, "an HDF5 file"),
    ".hdf5": (_read_hdf5, "an HDF5 file"),
    ".parquet": (_read_parquet, "a Parquet file"),
    ".feather": (_read_feather, "a Feather file of version 2"),
    ".tdms": (_read_tdms, "a TDMS file"),
    ".wav": (_read_wav, "a WAV file"),
}
_MDF = (
    " An MDF file can be exported with asammdf: MDF('rig.mf4').export('parquet', 'rig.parquet', "
    "single_time_base=True)."
)
_ELSEWHERE = {
    ".mf4": _MDF,
    ".mdf": _MDF,
    ".xls": " Save the workbook as .xlsx.",
    ".xlsm": " Save the workbook as .xlsx.",
    ".ods": " Save the workbook as .xlsx.",
    ".gz": " Unpack it first.",
    ".zip": " Unpack it first.",
}
