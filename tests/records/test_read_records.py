"""Reading: every format gives the same records, columns by every address, lost readings, units."""

import datetime
import json
import sys
import warnings

import h5py
import nptdms
import numpy as np
import openpyxl
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat, wavfile

from skhyst.exceptions import RecordError, TimeUnitWarning
from skhyst.records import read_records, record_slices, stack_records

N = 40
T = 0.002 * np.arange(N)
U = np.sin(np.arange(N) / 5)
W = np.linspace(20.0, 21.0, N)
Y = 3e-6 * U + 1e-7
COLUMNS = {"t": T, "u": U, "w": W, "y": Y}
TABLE = pd.DataFrame(COLUMNS)


def write_tdms(path):
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment([nptdms.ChannelObject("run", n, v) for n, v in COLUMNS.items()])


def write_hdf5(path):
    with h5py.File(path, "w") as file:
        for name, values in COLUMNS.items():
            file[f"run/{name}"] = values[:, None]


def write_mat73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file[f"run/{name}"] = values[None, :]  # as MATLAB stores a column
        file["#refs#/a"] = np.zeros(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, made for a test")


def write_workbook(path, sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, table in sheets.items():
        sheet = book.create_sheet(title)
        sheet.append(["Operator", "Smith"])
        if table is not None:
            for row in ([], table.columns.tolist(), *table.itertuples(index=False)):
                sheet.append(list(row))
    book.save(path)


WRITERS = {
    "comma.csv": lambda p: TABLE.to_csv(p, index=False),
    "semicolon.csv": lambda p: TABLE.to_csv(p, index=False, sep=";", decimal=","),
    "tab.tsv": lambda p: TABLE.to_csv(p, index=False, sep="\t"),
    "spaces.txt": lambda p: np.savetxt(p, TABLE, header="  t   u w  y", comments="", fmt="%25.17g"),
    "commented.dat": lambda p: np.savetxt(p, TABLE, header="t u w y", fmt="%.17g"),
    "preamble.csv": lambda p: p.write_text(
        "Rig 7\nsaved by someone\n\n" + TABLE.to_csv(index=False)
    ),
    "utf16.csv": lambda p: p.write_text(TABLE.to_csv(index=False), encoding="utf-16"),
    "windows.csv": lambda p: p.write_bytes(
        TABLE.to_csv(index=False, lineterminator="\r\n").encode("utf-8-sig")
    ),
    "vectors.mat": lambda p: savemat(p, {"gain": 3.0, **COLUMNS}),
    "struct.mat": lambda p: savemat(p, {"run": COLUMNS, "note": "a stage"}),
    "v73.mat": write_mat73,
    "columns.npz": lambda p: np.savez(p, **COLUMNS),
    "fields.npy": lambda p: np.save(p, TABLE.to_records(index=False)),
    "columns.json": lambda p: p.write_text(json.dumps({k: v.tolist() for k, v in COLUMNS.items()})),
    "records.json": lambda p: p.write_text(json.dumps(TABLE.to_dict("records"))),
    "groups.h5": write_hdf5,
    "groups.hdf5": write_hdf5,
    "table.parquet": lambda p: TABLE.to_parquet(p, index=False),
    "table.feather": lambda p: TABLE.to_feather(p),
    "channels.tdms": write_tdms,
    "sheet.xlsx": lambda p: write_workbook(p, {"Run 1": TABLE}),
    "sheets.xlsx": lambda p: write_workbook(p, {"Notes": None, "Run 1": TABLE}),
}


@pytest.fixture(params=WRITERS)
def recording(request, tmp_path):
    path = tmp_path / request.param
    WRITERS[request.param](path)
    return path


def read(folder, table, drive="u", **options):
    """Write a table, text or frame, and read it."""
    path = folder / "rig.csv"
    path.write_text(table if isinstance(table, str) else table.to_csv(index=False))
    return read_records(path, drive=drive, **options)


def lengths(X, y=None):
    return [record.n_samples for record in record_slices(X, y)]


def test_every_format_gives_the_same_records(recording):
    X, y = read_records(recording, drive="u", response="y", time="t", auxiliary=["w"])
    np.testing.assert_allclose(X, np.column_stack([U, W]), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(y, Y, rtol=1e-9, atol=1e-20)
    assert X.index.equals(y.index)
    assert list(X.index.names) == ["record", "time"]
    (record,) = record_slices(X, y)
    assert (record.dt, record.start_time, record.n_samples) == (0.002, 0.0, N)


def test_a_missing_column_lists_those_of_the_file(recording):
    with pytest.raises(RecordError, match="has no column 'voltage'") as error:
        read_records(recording, drive="voltage")
    assert recording.name in str(error.value)
    assert str(N) in str(error.value)


def test_columns_by_position_and_without_a_header(tmp_path):
    path = tmp_path / "rows.csv"
    np.savetxt(path, TABLE, delimiter=",")
    X, y = read_records(path, drive=1, response=3, time=0, auxiliary=2)
    np.testing.assert_allclose(X, np.column_stack([U, W]))
    np.testing.assert_allclose(y, Y)
    assert all(isinstance(name, str) for name in X.columns)
    with pytest.raises(RecordError, match="no column at position 4: it has 4 columns"):
        read_records(path, drive=4)
    head = "# Created by Octave\n# name: data\n# type: matrix\n# rows: 40\n# columns: 3\n"
    path = tmp_path / "octave.txt"
    path.write_text(head + TABLE[["t", "u", "y"]].to_csv(sep=" ", header=False, index=False))
    assert list(read_records(path, drive=1, response=2, time=0)[0].columns) == ["1"]


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("m.mat", lambda p, v: savemat(p, {"data": v})),
        ("m.npz", lambda p, v: np.savez(p, data=v)),
        ("m.json", lambda p, v: p.write_text(json.dumps({"data": v.tolist(), "dt": 0.002}))),
    ],
)
def test_columns_of_a_matrix(tmp_path, name, write):
    path = tmp_path / name
    write(path, TABLE.to_numpy())
    X, y = read_records(path, drive="data[1]", response="data[:, 3]", time="data[0]")
    np.testing.assert_array_equal(X["data[1]"], U)
    np.testing.assert_array_equal(y, Y)
    np.testing.assert_array_equal(read_records(path, drive=1)[0].iloc[:, 0], U)
    with pytest.raises(RecordError, match=r"\(40, 4\)"):
        read_records(path, drive="data")
    with pytest.raises(RecordError, match=r"\(40, 4\)"):
        read_records(path, drive="data[4]")


def test_rows_across_and_more_axes(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, TABLE.to_numpy().T)
    np.testing.assert_array_equal(read_records(path, drive="[1, :]")[0].iloc[:, 0], U)
    np.save(path, np.stack([TABLE.to_numpy(), 2 * TABLE.to_numpy()], axis=2))
    np.testing.assert_array_equal(read_records(path, drive="[1, 1]")[0].iloc[:, 0], 2 * U)


def test_columns_that_do_not_go_together_are_refused(tmp_path):
    np.savez(tmp_path / "a.npz", u=U, y=Y[:-1])
    with pytest.raises(RecordError, match="differ in length: 'u' 40, 'y' 39"):
        read_records(tmp_path / "a.npz", drive="u", response="y")
    with pytest.raises(RecordError, match="'u' more than once"):
        read(tmp_path, TABLE, auxiliary=["u"])


def test_without_times_the_rows_are_counted(tmp_path):
    X, y = read(tmp_path, TABLE)
    assert y is None
    assert X.index.levels[1].dtype.kind == "i"
    assert record_slices(X, dt=0.5)[0].dt == 0.5
    X, _ = read(tmp_path, TABLE, sampling_rate=500.0)
    assert record_slices(X)[0].dt == 0.002


def test_a_date_that_jumps_beside_a_clock_begins_a_record(tmp_path):
    for start, n_first in (("10:00:00", 15), ("23:59:59.970", N)):  # at midnight the clock goes on
        clock = pd.Timestamp(f"2024-05-31 {start}") + pd.to_timedelta(T, "s")
        day = np.where(np.arange(N) < 15, "2024-05-31", "2024-06-01")
        table = TABLE.assign(day=day, clock=clock.strftime("%H:%M:%S.%f"))
        X, _ = read(tmp_path, table, time="clock")
        assert record_slices(X)[0].n_samples == n_first


def test_the_end_of_summer_time_is_told(tmp_path):
    local = pd.Timestamp("2024-10-27 02:59:59.98") + pd.to_timedelta(T, "s")
    local = local.where(np.arange(N) < 10, local - pd.Timedelta("1h"))
    with pytest.warns(TimeUnitWarning, match="by an hour at row 10"):
        X, _ = read(tmp_path, TABLE.assign(clock=local), time="clock")
    assert [r.n_samples for r in record_slices(X)] == [10, N - 10]


@pytest.mark.parametrize("turn", [2**16, 2**32])
def test_a_counter_that_overflows_goes_on(tmp_path, turn):
    """One that begins at 0 counts records anew."""
    for first, n_records in ((turn - 2 * 20, 1), (0, 2)):
        count = (first + 2 * np.arange(N)) % turn if first else 2 * (np.arange(N) % (N // 2))
        table = TABLE.assign(millis=count)
        found = record_slices(read(tmp_path, table, time="millis")[0])
        assert [r.n_samples for r in found] == [N // n_records] * n_records
        assert found[0].dt == pytest.approx(0.002)


@pytest.mark.parametrize(("unit", "seconds"), [("ms", 1e-3), ("us", 1e-6), ("h", 3600.0)])
def test_units_of_time(tmp_path, unit, seconds):
    X, _ = read(tmp_path, TABLE.assign(t=T / seconds), time="t", time_unit=unit)
    assert record_slices(X)[0].dt == pytest.approx(0.002)


def test_dates_and_clock_times(tmp_path):
    start = datetime.datetime(2024, 5, 31, 23, 59, 59, 990_000)
    dates = [(start + datetime.timedelta(seconds=t)).isoformat() for t in T]
    for times, kind in ((dates, "M"), ([f"00:00:0{t:.3f}" for t in T], "m")):
        X, _ = read(tmp_path, TABLE.assign(t=times), time="t")
        assert X.index.levels[1].dtype.kind == kind
        assert record_slices(X)[0].dt == 0.002
    clocks = [date[11:] for date in dates]  # over midnight, and from the start again
    twelve = [clock.replace("23:", "12:").replace("00:00:", "1:00:") for clock in clocks]
    restarts = clocks[:15] + clocks[:25]
    for times, sizes in ((clocks, [len(T)]), (twelve, [len(T)]), (restarts, [15, 25])):
        found = record_slices(read(tmp_path, TABLE.assign(t=times), time="t")[0])
        assert [record.n_samples for record in found] == sizes
    with pytest.raises(RecordError, match="ISO 8601"):
        read(tmp_path, TABLE.assign(t="noon"), time="t")


@pytest.mark.parametrize("labels", [["a"] * 15 + ["b"] * 25, [3] * 15 + [1] * 25])
def test_records_by_a_column_and_by_restarts(tmp_path, labels):
    runs = TABLE.assign(t=np.concatenate([T[:15], T[:25]]), run=labels)
    found = record_slices(read(tmp_path, runs, time="t", record="run")[0])
    assert [(r.label, r.n_samples) for r in found] == [(labels[0], 15), (labels[-1], 25)]
    found = record_slices(read(tmp_path, runs, time="t")[0])
    assert [(r.label, r.n_samples) for r in found] == [(0, 15), (1, 25)]
    found = record_slices(read(tmp_path, runs, record="run", sampling_rate=500)[0])
    assert [(r.start_time, r.n_samples) for r in found] == [(0.0, 15), (0.0, 25)]


def test_structs_of_matlab_7_3_are_read_with_their_units(tmp_path):
    """Those of an array of structs are records; their fields are references."""
    with h5py.File(tmp_path / "rig.mat", "w") as file:
        for k, v in {"u": U, "y": Y, "fs": [500.0]}.items():
            file[f"one/{k}"] = np.atleast_2d(v)
        for k, unit in {"u": "V", "y": "um"}.items():
            file[f"one/units/{k}"] = np.array([[ord(letter)] for letter in unit], dtype="u2")
            file[f"one/units/{k}"].attrs["MATLAB_class"] = np.bytes_("char")
    with h5py.File(tmp_path / "array.mat", "w") as file:
        for k, v in COLUMNS.items():
            for i, n in enumerate((N, N - 9)):
                file[f"#refs#/{k}{i}"] = v[None, :n]
            refs = [[file[f"#refs#/{k}{i}"].ref] for i in (0, 1)]
            file.create_dataset(f"runs/{k}", data=np.array(refs, dtype=h5py.ref_dtype))
    X, y = read_records(tmp_path / "rig.mat")
    assert (list(X.columns), y.name) == (["one.u [V]"], "one.y [um]")
    X, y = read_records(tmp_path / "array.mat", drive="u", response="y", time="t")
    assert [(r.label, r.n_samples) for r in record_slices(X, y)] == [
        ("runs[0]", N),
        ("runs[1]", N - 9),
    ]


def test_runs_that_alternate_in_the_rows_are_named_and_read(tmp_path):
    table = pd.concat([TABLE.assign(run=k) for k in (1, 2)]).sort_values("t", kind="stable")
    for known in ({}, {"drive": "u", "response": "y", "time": "t"}):
        with pytest.raises(RecordError, match="pass record='run' with the time"):
            read_records(table.reset_index(drop=True), **known)
    X, y = read(tmp_path, table, response="y", time="t", record="run")
    assert [(r.label, r.n_samples) for r in record_slices(X, y)] == [(1, N), (2, N)]
    np.testing.assert_array_equal(X["u"], [*U, *U])


def test_files_stack_to_records(tmp_path):
    runs = [read(tmp_path, TABLE, response="y", time="t") for _ in range(2)]
    X, y = stack_records(runs, labels=["slow", "fast"])
    assert [r.label for r in record_slices(X, y)] == ["slow", "fast"]


@pytest.mark.parametrize("lost", [np.nan, np.inf, -999.0])
def test_lost_readings_are_named(tmp_path, lost):
    values = Y.copy()
    values[[4, 5, 20]] = lost
    table = TABLE.assign(y=values)
    with pytest.raises(RecordError, match=r"y: 3 row\(s\) \(4, 5, 20\).*'drop' or on_missing="):
        read(tmp_path, table, response="y", time="t", missing_code={"y": -999})
    read(tmp_path, table, time="t", missing_code=-999)  # nothing lost in what is read


@pytest.mark.parametrize("options", [{"time": "t"}, {"sampling_rate": 500.0}, {}])
def test_lost_readings_are_dropped_and_start_a_record(tmp_path, options):
    table = TABLE.copy()
    table.loc[[0, 9, 10, 20, 22], "y"] = np.nan
    X, y = read(tmp_path, table, response="y", on_missing="drop", **options)
    found = record_slices(X, y, dt=0.002)
    assert [r.n_samples for r in found] == [8, 9, 17]  # row 21 stood alone
    assert [r.start_time for r in found] == pytest.approx([0.002, 0.022, 0.046])
    np.testing.assert_allclose(X["u"], np.delete(U, [0, 9, 10, 20, 21, 22]))


def test_dropping_does_not_reach_into_another_record(tmp_path):
    lost = TABLE.assign(run=["a"] * 10 + ["b"] + ["c"] * (N - 11))
    lost.loc[[9, 11], "y"] = np.nan
    X, _ = read(tmp_path, lost, response="y", record="run", on_missing="drop")
    np.testing.assert_allclose(X["u"], np.delete(U, [9, 11]))
    lost = TABLE.assign(t=np.concatenate([T[:20], T[:20]]))
    lost.loc[[18, 22], "y"] = np.nan
    X, y = read(tmp_path, lost, response="y", time="t", on_missing="drop")
    np.testing.assert_allclose(X["u"], np.delete(U, [18, 19, 22]))  # 19 is left alone, 20 is not
    assert lengths(X, y) == [18, 2, 17]


@pytest.mark.parametrize("options", [{"record": "run"}, {"record": "run", "time": "t"}, {}])
def test_nothing_is_dropped_where_nothing_is_missing(tmp_path, options):
    single = TABLE.assign(run=["a"] + ["b"] * (N - 2) + ["c"])  # two records of one row
    X, _ = read(tmp_path, single, on_missing="drop", **options)
    np.testing.assert_allclose(X["u"], U)
    assert len(read(tmp_path, "t,u\n0,1\n", on_missing="drop")[0]) == 1
    with pytest.raises(RecordError, match="does not determine the sampling interval"):
        record_slices(read(tmp_path, "t,u\n0,1\n", time="t", on_missing="drop")[0])


@settings(deadline=None, max_examples=20)
@given(st.sets(st.integers(1, N - 2), max_size=20))
def test_interpolation_restores_a_straight_line(tmp_path_factory, lost):
    values = 2.0 * T + 1.0
    values[list(lost)] = -1.0
    options = {"time": "t", "missing_code": -1, "on_missing": "interpolate"}
    X, _ = read(tmp_path_factory.mktemp("line"), pd.DataFrame({"t": T, "u": values}), **options)
    np.testing.assert_allclose(X["u"], 2.0 * T + 1.0, rtol=1e-12)


def test_interpolation_drops_edges_and_stays_within_records_and_gaps(tmp_path):
    table = TABLE.assign(run=[0] * 20 + [1] * 20)
    table.loc[[0, 19, 20, 39], "u"] = np.nan
    interpolated = {"time": "t", "on_missing": "interpolate"}
    assert lengths(read(tmp_path, table, record="run", **interpolated)[0]) == [18, 18]
    table = TABLE.assign(t=T + 1.0 * (np.arange(N) >= 20))
    table.loc[[5, 19, 20], "u"] = np.nan
    assert lengths(read(tmp_path, table, **interpolated)[0]) == [19, 19]


def test_a_lost_time_cannot_be_interpolated(tmp_path):
    table = TABLE.assign(t=np.where(np.arange(N) == 7, np.nan, T))
    for policy in ("raise", "interpolate"):
        with pytest.raises(
            RecordError, match=r"the time: 1 row\(s\) \(7\)\. Pass on_missing='drop'"
        ):
            read(tmp_path, table, time="t", on_missing=policy)
    X, _ = read(tmp_path, table, time="t", on_missing="drop")
    assert len(X) == N - 1


@pytest.mark.parametrize(
    "head",
    [
        "voltage;path\n",
        "Operator;Smith\nvoltage;path\n",
        "Operator;Smith\nrig;7\nvoltage;path\n",
        "voltage;path\nV;nm\n",
        "voltage;path\n[V];[some unit]\n",
        "voltage;path\nmV/s;m/s^2\n",
        "Operator;Smith\nRoom;cellar\nvoltage;path\n(V);-\n",
        "# Operator;Smith\n# voltage;path\n",
        "Saved;2024\nV;m\n",  # names that are symbols of units
    ],
)
def test_the_header_is_the_last_line_above_the_numbers_or_their_units(tmp_path, head):
    drive, response = ("V", "m") if "voltage" not in head else ("voltage", "path")
    X, y = read(tmp_path, head + "0,5;1,5\n1,0;2,5\n1,5;3,5\n", drive, response=response)
    assert (X.iloc[:, 0].tolist(), y.tolist()) == ([0.5, 1.0, 1.5], [1.5, 2.5, 3.5])
    units = [line for line in head.splitlines()[1:] if line[0] in "V[m("] if "volt" in head else []
    (name,) = X.columns
    assert name.startswith(drive)
    said = [line.strip("[]()").split(";")[0].rstrip("])") for line in units]
    assert name == (f"{drive} [{said[0]}]" if said else drive)


@pytest.mark.parametrize("integer", [int, np.int64, np.uint8])
def test_integers_of_every_type_are_positions_and_rates(tmp_path, integer):
    options = {"auxiliary": 2, "sampling_rate": 100, "response": 3}
    options = {name: integer(value) for name, value in options.items()}
    X, _ = read(tmp_path, TABLE, integer(1), **options)
    assert list(X.columns) == ["u", "w"]
    assert record_slices(X)[0].dt == 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": "t", "sampling_rate": 1.0}, "'sampling_rate' parameter .* must be None"),
        ({"sampling_rate": 0.0}, "'sampling_rate' parameter .* positive"),
        ({"sampling_rate": "100"}, "'sampling_rate' parameter .* positive .* Got '100'"),
        ({"on_missing": "ignore"}, "'on_missing' parameter"),
        ({"time_unit": "days"}, "'time_unit' parameter"),
        ({"missing_code": {"z": 0}}, "'missing_code' parameter .* Got 'z'"),
        ({"auxiliary": [2.5]}, "named by a str or by its position"),
        ({"auxiliary": 2.5}, "named by a str or by its position .* Got 2.5"),
    ],
)
def test_parameters_are_checked(tmp_path, options, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, TABLE, **options)


def test_times_too_coarse_or_out_of_order_and_nothing_left(tmp_path):
    with pytest.raises(RecordError, match=r"does not advance .*'sampling_rate'"):
        read(tmp_path, TABLE.assign(t=np.round(T, 2)), time="t")
    with pytest.raises(RecordError, match="shuffled"):
        read(tmp_path, TABLE.sample(frac=1.0, random_state=0), time="t")
    for policy in ("drop", "interpolate"):
        with pytest.raises(RecordError, match=r"rig\.csv"):
            read(tmp_path, "u,y\n1,\n2,\n3,\n", response="y", on_missing=policy)


@pytest.mark.parametrize(
    ("name", "package"),
    [("a.h5", "h5py"), ("a.parquet", "pyarrow"), ("a.tdms", "nptdms"), ("a.xlsx", "openpyxl")],
)
def test_a_package_that_is_not_installed_is_named(tmp_path, monkeypatch, name, package):
    (tmp_path / name).write_bytes(b"something")
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setitem(sys.modules, f"{package}.parquet", None)
    with pytest.raises(ImportError, match=rf"{package}: pip install 'skhyst\[io\]'"):
        read_records(tmp_path / name, drive="u")


def write_tdms_waveform(path, increments=(0.002, 0.002)):
    channels = [
        nptdms.ChannelObject("run", name, COLUMNS[name], {"wf_increment": dt, "unit_string": unit})
        for name, dt, unit in zip("uy", increments, ("V", "um"), strict=True)
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def write_hdf5_said(path):
    with h5py.File(path, "w") as file:
        file.attrs["sampling_rate"] = 500
        for name, unit in (("u", "V"), ("y", np.bytes_("um"))):
            file[f"run/{name}"] = COLUMNS[name]
            file[f"run/{name}"].attrs["units"] = unit


@pytest.mark.parametrize(
    ("suffix", "write"), [(".tdms", write_tdms_waveform), (".h5", write_hdf5_said)]
)
def test_what_a_file_says_of_interval_and_units_is_used(tmp_path, suffix, write):
    path = tmp_path / f"rig{suffix}"
    write(path)
    X, y = read_records(path, drive="u", response="run/y")
    (record,) = record_slices(X, y)
    assert (record.dt, record.time_unit) == (0.002, "s")
    assert (list(X.columns), y.name) == (["run/u [V]"], "run/y [um]")
    X, _ = read_records(path, drive="run/u [V]", sampling_rate=100.0)  # what is given comes first
    assert record_slices(X)[0].dt == 0.01


@pytest.mark.parametrize(
    "said",
    [
        {"fs_kHz": 0.5},
        {"dt_ms": 2.0},
        {"Ts": 2.0, "TimeUnit": "milliseconds"},
        {"Ts": 2000.0, "units": {"Ts": "us"}},
        {"fs": 1000.0, "t": T},
    ],
)
def test_a_rate_has_its_unit_and_a_time_that_contradicts_it_is_told(tmp_path, said):
    savemat(tmp_path / "rig.mat", {"rig": {"u": COLUMNS["u"], "y": COLUMNS["y"]} | said})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        X, _ = read_records(tmp_path / "rig.mat")
    assert record_slices(X)[0].dt == pytest.approx(0.002)
    assert [w.category for w in told] == [TimeUnitWarning] * ("t" in said)
    assert all("(500 Hz), the file says 0.001 s (1000 Hz)" in str(w.message) for w in told)


def test_sheets_with_units_below_the_names_are_records(tmp_path):
    table = TABLE.rename(columns={"u": "voltage"}).assign(t=1e3 * T, day="2024-05-31", ok=True)
    units = pd.DataFrame([["ms", "V", "K", "um", "", ""]], columns=table.columns)
    table = pd.concat([units, table.astype(object)])
    write_workbook(tmp_path / "rig.xlsx", {"up": table, "down": table[:11], "notes": None})
    X, y = read_records(tmp_path / "rig.xlsx")
    assert (list(X.columns), y.name) == (["voltage [V]"], "y [um]")
    found = record_slices(X, y)
    assert [(r.label, r.n_samples, r.dt) for r in found] == [
        ("up", N, pytest.approx(0.002)),
        ("down", 10, pytest.approx(0.002)),
    ]
    X, _ = read_records(tmp_path / "rig.xlsx", drive="down/ok", response="down/y")
    assert X["down/ok"].tolist() == [1.0] * 10


def test_channels_of_different_intervals_are_refused(tmp_path):
    path = tmp_path / "rig.tdms"
    write_tdms_waveform(path, (0.002, 0.004))
    with pytest.raises(RecordError, match=r"'run/u \[V\]' 0.002 s, 'run/y \[um\]' 0.004 s"):
        read_records(path, drive="u", response="y")


def test_the_rate_of_a_wav_file_is_used(tmp_path):
    path = tmp_path / "rig.wav"
    wavfile.write(path, 8000, np.column_stack([U, Y]).astype(np.float32))
    X, y = read_records(path, drive=0, response="channel[1]")
    assert record_slices(X, y)[0].dt == 1.0 / 8000
    np.testing.assert_allclose(X.iloc[:, 0], U, rtol=1e-6)
    np.testing.assert_allclose(y, Y, rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "seconds"),
    [
        *[("t [ms]", 1e-3), ("time_ms", 1e-3), ("Time (µs)", 1e-6), ("t/min", 60.0)],
        *[("Zeit in h", 3600.0), ("ms", 1e-3), ("t_s", 1.0), ("t", 1.0)],
    ],
)
def test_the_unit_of_time_is_that_of_the_name(tmp_path, name, seconds):
    table = TABLE.rename(columns={"t": name})
    table[name] /= seconds
    assert record_slices(read(tmp_path, table, time=0)[0])[0].dt == pytest.approx(0.002)
    other = read(tmp_path, table, time=0, time_unit="us")[0]  # what is given comes first
    assert record_slices(other)[0].dt == pytest.approx(0.002 / seconds * 1e-6)


def test_the_unit_of_time_is_that_of_the_line_below_the_names(tmp_path):
    text = "t,u\nms,V\n" + "".join(f"{2 * i},{u}\n" for i, u in enumerate(U))
    X, _ = read(tmp_path, text, time="t")
    assert record_slices(X)[0].dt == pytest.approx(0.002)
    refused = r"in 'counts', which is not a known unit of time.* 'time_unit'"
    with pytest.raises(RecordError, match=refused):
        read(tmp_path, TABLE.rename(columns={"t": "t [counts]"}), time=0)


def test_a_time_without_a_unit_that_counts_in_seconds_is_questioned(tmp_path):
    table = TABLE.assign(t=np.arange(N))
    with pytest.warns(TimeUnitWarning, match=r"1 s from sample to sample.*'sampling_rate'"):
        read(tmp_path, table, time="t")
    read(tmp_path, table, time="t", time_unit="s")  # no question where it is said


@pytest.mark.parametrize("first", [45000.0, 739000.0])  # of a spreadsheet, of MATLAB
def test_day_numbers_without_a_unit_are_questioned(tmp_path, first):
    table = TABLE.assign(t=first + np.arange(N) / 1440.0)
    with pytest.warns(TimeUnitWarning, match=r"days \('d'\)"):
        read(tmp_path, table, time="t")
    X, _ = read(tmp_path, table, time="t", time_unit="d")
    assert record_slices(X)[0].dt == pytest.approx(60.0)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%d.%m.%Y  %H:%M", "%Y.%m.%d %H:%M"])
def test_dates_with_points_are_no_clock_times(tmp_path, form, separator):
    for begin, n in (("2024-01-10", 200), ("2024-01-01", 20)):
        dates = pd.date_range(begin, periods=n, freq="1h").strftime(form)
        text = "\n".join(f"{date}{separator}{i % 7}" for i, date in enumerate(dates))
        X, _ = read(tmp_path, f"t{separator}u\n{text}\n", time="t")
        assert [(r.n_samples, r.dt) for r in record_slices(X)] == [(n, 3600.0)]


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%d.%m.%y %I:%M %p"])
def test_dates_of_more_than_one_meaning_are_refused(tmp_path, form):
    """A step of a day may be one of a month; one of an hour leaves no gap in one of them alone."""
    for step, n in (("1D", 12), ("1h", 200)):
        dates = pd.date_range("2024-01-01", periods=n, freq=step).strftime(form)
        table = pd.DataFrame({"t": dates, "u": np.arange(n) % 7})
        if step == "1h":
            assert record_slices(read(tmp_path, table, time="t")[0])[0].dt == 3600.0
            continue
        with pytest.raises(RecordError, match=r"have one meaning .* 'sampling_rate'"):
            read(tmp_path, table, time="t")


@pytest.mark.parametrize(
    ("library", "kind"), [("pandas", "DataFrame"), ("polars", "DataFrame"), ("pyarrow", "table")]
)
def test_a_table_in_memory_is_read_as_a_file_is(library, kind):
    make = getattr(pytest.importorskip(library), kind)
    table = make({"time_ms": 1e3 * T, "u [V]": U, "y": Y})
    X, y = read_records(table, drive="u", response="y", time="time_ms")
    np.testing.assert_array_equal(X["u [V]"], U)
    np.testing.assert_array_equal(y, Y)
    assert record_slices(X, y)[0].dt == pytest.approx(0.002)
    with pytest.raises(RecordError, match="the frame has no column 'v'"):
        read_records(table, drive="v")


def test_an_index_of_a_table_can_be_named_as_a_column():
    table = TABLE.set_index("t")[["u", "y"]]
    X, _ = read_records(table, drive="u", time="t")
    assert record_slices(X)[0].dt == 0.002


@pytest.mark.parametrize(("library", "kind"), [("polars", "DataFrame"), ("pyarrow", "table")])
def test_a_frame_without_an_index_counts_samples_and_keeps_its_names(library, kind):
    frame = getattr(pytest.importorskip(library), kind)({"u": U, "w": W})
    X = stack_records([frame], labels=["a"], dt=0.002)
    assert list(X.columns) == ["u", "w"]
    assert record_slices(X)[0].time_unit == "s"
    assert record_slices(frame)[0].time_unit == "sample"


def test_units_that_a_frame_says_are_those_of_the_columns():
    table = TABLE.copy()
    table.attrs["units"] = {"u": "V", "y": "um"}
    X, y = read_records(table, drive="u", response="y", time="t")
    assert (list(X.columns), y.name) == (["u [V]"], "y [um]")
    pytest.importorskip("pint_pandas")
    of_pint = TABLE.astype({"u": "pint[mV]"})
    np.testing.assert_array_equal(read_records(of_pint, drive="u", time="t")[0]["u [mV]"], U)


def test_units_are_given_in_place_of_those_of_the_file(tmp_path):
    table = TABLE.rename(columns={"u": "u (mV)"})
    options = {"response": "y", "time": "t", "units": {"u": "V", "y": "um"}}
    X, y = read(tmp_path, table, **options)
    assert (list(X.columns), y.name) == (["u [V]"], "y [um]")
    with pytest.raises(ValueError, match=r"'units' parameter .* Got 'w' instead"):
        read(tmp_path, table, units={"w": "K"})
