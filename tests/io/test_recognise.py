"""Columns are recognised by names, units and values, and asked for where two may be meant."""

import h5py
import numpy as np
import pandas as pd
import pytest

from skhyst.exceptions import RecordError
from skhyst.io import recognise_columns
from skhyst.records import (
    inspect_recording,
    read_records,
    record_slices,
)

N = 200
T = 1e-3 * np.arange(N)
U, Y, Z = np.sin(50.0 * T), np.cos(40.0 * T), np.sin(77.0 * T)


def recognised(table, **given):
    found = recognise_columns(pd.DataFrame(table), **given)
    return tuple(
        found[role].name if role in found else None for role in ("time", "drive", "response")
    )


@pytest.mark.parametrize(
    ("table", "names"),
    [
        ({"time_ms": T, "U [V]": U, "sg [um]": Y}, ("time_ms", "U [V]", "sg [um]")),
        ({"position": Y, "voltage": U, "time": T}, ("time", "voltage", "position")),
        ({"Zeit": T, "Spannung (V)": U, "Weg (µm)": Y}, ("Zeit", "Spannung (V)", "Weg (µm)")),
        ({"Dev1/ai0": Y, "Dev1/ao0": U}, (None, "Dev1/ao0", "Dev1/ai0")),
        ({"t": T, "input": U, "voltage [V]": Z, "output": Y}, ("t", "input", "output")),
        ({"t": T, "sensor [V]": Y, "command [V]": U}, ("t", "command [V]", "sensor [V]")),
        ({"a": T, "voltage": U, "ch2": Y}, ("a", "voltage", "ch2")),
        ({"t": T, "voltage": U, "force [N]": Y}, ("t", "voltage", "force [N]")),
        ({"t": T, "force [N]": U, "displacement [mm]": Y}, ("t", "force [N]", "displacement [mm]")),
        ({"V": U, "nm": Y, "temperature": Z}, (None, "V", "nm")),
        (
            {"Zeit in ms": T, "Kraft in N": U, "Weg / mm": Y},
            ("Zeit in ms", "Kraft in N", "Weg / mm"),
        ),
        ({"tiempo": T, "entrada": U, "posición": Y}, ("tiempo", "entrada", "posición")),
        ({"t": T, "H (A/m)": U, "B (T)": Y}, ("t", "H (A/m)", "B (T)")),
        ({"t": T, "heater [W]": U, "temperature": Y}, ("t", "heater [W]", "temperature")),
        ({"t": T, "current [A]": 0 * U, "load": U, "pos": Y}, ("t", "load", "pos")),
        (
            {"Target Position": U, "Current Position": Y},
            (None, "Target Position", "Current Position"),
        ),
        ({"t [s]": T, "u": U, "y": Y, "T [K]": Z, "n": np.arange(N)}, ("t [s]", "u", "y")),
        ({"t [s]": T, "d": U, "time [s]": T, "level": Y}, ("t [s]", "d", "level")),
        ({"t": T, "Rig/Cmd/Out1": U, "Rig/Pos/Out1": Y}, ("t", "Rig/Cmd/Out1", "Rig/Pos/Out1")),
    ],
)
def test_what_names_and_values_tell(table, names):
    assert recognised(table) == names


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"A": T, "B": U, "C": Y}, "the drive: .* Candidates: 'B', 'C'"),
        ({"t": T, "Channel A": U, "Channel B": Y}, "the drive: .* 'Channel A', 'Channel B'"),
        ({"t": T, "log.t": T, "b": U, "c": Y}, "the drive: .* Candidates: 'b', 'c'"),
        ({"t": T, "voltage": U, "current": Z, "x": Y}, "the drive: .* 'voltage', 'current'"),
        ({"t": T, "voltage": U, "b": Y, "c": Z}, "the response: .* 'b', 'c'"),
        ({"t": T, "time": 2.0 * T, "voltage": U, "position": Y}, "the time: .* 't', 'time'"),
        ({"t [s]": T, "t [ms]": T, "u": U, "y": Y}, "the time: .* 't \\[s\\]'"),
        ({"t1": T, "voltage": U, "t2": T + 5e-4, "position": Y}, "a row is not one instant"),
        ({"voltage": U, "Time": T, "position": Y, "Time 2": 2 * T}, "a row is not one instant"),
        (
            {"t1": T, "voltage": U, "t2": [*2 * T[:99], *[np.nan] * 101], "position": Y},
            r"the columns 0 \('t1'\) and 2 \('t2'\): a row is not one instant",
        ),
        ({"t": T, "x": U, "y": Y}, "the drive: .* 'x'"),
        ({"n": np.arange(N), "voltage": U}, "the response"),
        ({"t": T, "drive output": U, "position": Y}, "the drive: .* 'drive output'"),
        ({"u": U, "y": np.full(N, 2.0).astype(str), "voltage [V]": Z}, None),
    ],
)
def test_what_nothing_tells_is_asked_for(table, message):
    if message is None:
        assert recognised(table) == (
            None,
            "u",
            "y",
        )  # the names tell; that it holds text is told when read
        return
    with pytest.raises(RecordError, match=message):
        recognised(table)
    with pytest.raises(RecordError, match=message):
        read_records(pd.DataFrame(table))


def test_all_that_is_open_is_asked_at_once(tmp_path):
    """With what is known; a feedback is no drive, and a count of the rows is neither."""
    with pytest.raises(RecordError) as told:
        recognised({"t": T, "a": U, "b": Y})
    message = str(told.value)
    assert "pass drive=NAME. Candidates: 'a', 'b'" in message
    assert "pass response=NAME. Candidates: 'a', 'b'" in message
    assert message.endswith("Recognised: time 't'.")
    assert recognised({"Tick": np.arange(N), "Ref": U, "Fbk": Y}) == (None, "Ref", "Fbk")
    np.savez(tmp_path / "rig.npz", u=np.zeros((10, 2, 3, 2)))
    with pytest.raises(
        RecordError, match=r"is a signal\. It has: u \(10, 2, 3, 2\).* as 'u\[:, 0, 0, 0\]'"
    ):
        recognise_columns(tmp_path / "rig.npz")


def test_one_option_settles_two_channels_of_one_unit():
    table = pd.DataFrame({"t": T, "CH1 [V]": U, "CH2 [V]": Y})
    found = recognise_columns(table, drive="CH1 [V]")
    assert found["response"].name == "CH2 [V]"


@pytest.mark.parametrize(
    ("one", "other"), [(("u1", "y1"), ("u2", "y2")), (("x cmd", "x pos"), ("y cmd", "y pos"))]
)
def test_the_drive_of_one_axis_gives_its_response(one, other):
    table = {"t": T} | dict(zip((*one, *other), (U, Y, Z, -Y), strict=True))
    with pytest.raises(RecordError, match=f"2 axes .*'{one[0]}', '{one[1]}'; '{other[0]}'"):
        recognised(table)
    assert recognised(table, drive=one[0]) == ("t", None, one[1])
    assert recognised(table, response=other[1]) == ("t", other[0], None)


def test_what_is_given_is_no_candidate():
    table = {"a": T, "b": U, "c": Y}
    assert recognised(table, drive="b") == ("a", None, "c")
    assert recognised(table | {"d": Z}, drive="b", auxiliary=["d"]) == ("a", None, "c")
    assert recognised(table, drive=2, sampling_rate=1e3, response="b") == (None, None, None)


def test_times_of_each_signal_are_one_time_or_refused():
    """Rounded times and a date are one time; what is given does not make two times one."""
    day = np.datetime64("2024-05-31") + (1e6 * T).astype("timedelta64[us]")
    for second in (np.round(T + 1e-5, 4), 1e3 * T, day):
        name = "t [ms]" if second[-1] == 1e3 * T[-1] else "t2 [s]"
        table = pd.DataFrame({"t [s]": T, "u": U, name: second, "y": Y})
        X, _ = read_records(table, drive="u", response="y", time="t [s]")
        assert len(X) == N
    table = pd.DataFrame({"t [s]": T, "u": U, "t2 [s]": T + 5e-4, "y": Y})
    for known in ({"time": "t [s]"}, {"sampling_rate": 1e3}):
        with pytest.raises(RecordError, match="a row is not one instant"):
            read_records(table, drive="u", response="y", **known)


def test_a_time_must_rise():
    """A column of that name that does not, as of rows out of order, is asked for."""
    table = {"time [s]": Z, "voltage": U, "position": Y}
    with pytest.raises(RecordError, match=r"'time \[s\]' do not increase from row to row"):
        recognised(table)
    assert recognised(table, sampling_rate=1e3) == (None, "voltage", "position")
    table = {"time [s]": 0.0 * Z, "settling time [s]": Z, "voltage": U, "position": Y}
    assert recognised(table) == (None, "voltage", "position")


def test_read_records_takes_what_is_recognised(tmp_path):
    path = tmp_path / "rig.csv"
    runs = [{"run": k, "t [ms]": 1e3 * T, "volt": U, "um": Y + k} for k in (3, 5)]
    pd.concat(map(pd.DataFrame, runs)).to_csv(path, index=False)
    X, y = read_records(path)
    assert (list(X.columns), y.name) == (["volt"], "um")
    assert [(r.label, r.n_samples) for r in record_slices(X, y)] == [(3, N), (5, N)]
    assert record_slices(X, y)[0].dt == pytest.approx(1e-3)


def test_groups_that_have_all_columns_are_records(tmp_path):
    path = tmp_path / "rig.h5"
    with h5py.File(path, "w") as file:
        for label, n in (("slow", N), ("fast", N // 2)):
            for name, values in (("t", T), ("voltage", U), ("position", Y)):
                file[f"{label}/{name}"] = values[:n]
        file["calibration/voltage"] = U
    for columns in ({}, {"drive": "voltage", "response": "position", "time": "t"}):
        X, y = read_records(path, **columns)
        assert list(X.columns) == ["voltage"]
        assert [(r.label, r.n_samples) for r in record_slices(X, y)] == [("fast", 100), ("slow", N)]
    X, _ = read_records(path, drive="slow/voltage", response="slow/position")
    assert len(X) == N
    with h5py.File(path, "a") as file:
        for name, values, unit in (("force", U, "N"), ("sag", Y, "mm")):
            file.create_dataset(f"beam/{name}", data=values).attrs["unit"] = unit
    X, y = read_records(path, drive="force [N]", response="sag [mm]")  # as they are listed
    assert (list(X), y.name) == (["beam/force [N]"], "beam/sag [mm]")


def test_files_are_records_of_their_names(tmp_path):
    for name, scale in (("a", 1.0), ("b", 2.0)):
        pd.DataFrame({"t": T, "volt": U, "um": scale * Y}).to_csv(tmp_path / f"{name}.csv")
    files = [tmp_path / "a.csv", tmp_path / "b.csv"]
    X, y = read_records(files, drive="volt", response="um", time="t")
    assert [(r.label, r.n_samples) for r in record_slices(X, y)] == [("a", N), ("b", N)]
    np.testing.assert_array_equal(y.loc["b"], pd.read_csv(files[1])["um"])
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "a.csv"
    pd.DataFrame({"t": np.append(T[:50], T[:50]), "volt": U[:100], "um": Y[:100]}).to_csv(other)
    X, _ = read_records([files[0], other], drive="volt", time="t")
    assert {r.label for r in record_slices(X)} == {str(files[0]), f"{other}/0", f"{other}/1"}
    pd.DataFrame({"t": T, "volt": U, "um (nm)": Y}).to_csv(files[1])
    with pytest.raises(RecordError, match=r"um in 'a' and volt, um \(nm\) in 'b'"):
        read_records(files, drive="volt", response=3, time="t")
    for wrong, message in (([], "name a file"), ([files[0], files[0]], "once")):
        with pytest.raises(RecordError, match=message):
            read_records(wrong, drive="volt")


@pytest.mark.parametrize("code", [-9999.0, 999.9, 1e30, 9.91e37])
def test_a_reading_that_may_stand_for_a_lost_one_is_asked_for(code):
    table = pd.DataFrame({"t": T, "u": U, "y": np.where(np.arange(N) % 50 == 7, code, Y)})
    message = rf"The reading {code:.15g} of 'y' .* 4 of 200 .*on_missing='interpolate'"
    with pytest.raises(RecordError, match=message.replace("+", r"\+")):
        read_records(table)
    for given in ({}, {"missing_code": code}):
        assert len(read_records(table, on_missing="drop", **given)[0]) == N - 4
    assert len(read_records(table, missing_code=np.nan)[0]) == N
    near = table.assign(y=np.where(np.arange(N) % 50 == 7, code, code * (0.5 + 0.1 * Y)))
    assert len(read_records(near)[0]) == N


def faults(table, **options):
    return "\n".join(inspect_recording(pd.DataFrame(table), **options).faults)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"y": np.minimum(Y, 0.8)}, "'y' is at its largest value, 0.8, in"),
        ({"y": U}, "'u' and 'y' are the same signal"),
        ({"y": np.full(N, 3.0)}, "'y' does not move: it is 3 throughout"),
        ({"y": np.where(T[9] == T, np.nan, Y)}, r"y: 1 row\(s\) \(9\)"),
        ({"y": np.where(T[9] == T, -9999.0, Y)}, "The reading -9999 of 'y'"),
        ({"w": np.where(T[9] == T, np.nan, Y)}, "'w' lacks 1 of 200"),
        ({"t": T + 4e-4 * U}, "must be even"),
        ({"u": ["on"] * N}, "Got 'on' in row 0"),
        ({"y": np.where(abs(T - T[60]) < 0.0105, 0.0, Y)}, r"stuck sensor \(0\) in 21 of the rows"),
    ],
)
def test_faults_are_told_without_a_model(change, message):
    table = {"t": T, "u": U, "y": Y}
    assert faults(table) == ""
    assert pd.Series([faults(table | change)]).str.contains(message).all(), faults(table | change)


def test_faults_of_a_record_are_told_with_its_name(tmp_path):
    """Whether the records are sheets, or begin where time steps back."""
    path, first = tmp_path / "rig.xlsx", {"t": T, "u": U, "y": Y}
    second = pd.DataFrame({"t": T, "u": 3.0 * U, "y": np.minimum(2.0 * Y, 0.8)})
    with pd.ExcelWriter(path) as book:
        pd.DataFrame(first).to_excel(book, sheet_name="a", index=False)
        second.to_excel(book, sheet_name="b", index=False)
    overview = inspect_recording(path)
    drive = overview.columns[1]
    assert (drive.low, drive.high) == pytest.approx((3.0 * U.min(), 3.0 * U.max()))
    assert all(fault.startswith("record b: 'y' is at its largest") for fault in overview.faults)
    assert overview.faults
    for change, message in (
        ({"y": 2.0}, "record 1: 'y' does not move: it is 2 throughout."),
        ({"u": Y, "y": Y}, "record 1: 'u' and 'y' are the same signal."),
        ({"u": U, "y": Y}, "record 1: repeated record in 200 of the rows"),
    ):
        assert message in faults(pd.concat([pd.DataFrame(first), second.assign(**change)]))


def test_signals_that_share_a_name_are_told_apart_by_their_positions(tmp_path):
    path = tmp_path / "scope.csv"
    path.write_text(
        "t,CH1,CH1\n" + "\n".join(f"{t},{u},{y}" for t, u, y in zip(T, U, Y, strict=True))
    )
    for drive in (1, "1"):
        assert recognise_columns(path, drive=drive)["response"].column == 2
    columns = inspect_recording(path, drive=1).columns
    assert [column.role for column in columns] == ["time", "drive", "response"]


def test_the_port_of_an_instrument_is_no_role():
    table = {"t": T, "Amp out [V]": U, "Sensor in [V]": Y}
    assert recognised(table) == ("t", "Amp out [V]", "Sensor in [V]")
    assert recognised({"t": T, "ADC in": Y, "DAC out": U}) == ("t", "DAC out", "ADC in")
    assert recognised({"t": T, "piezo in": U, "piezo out": Y}) == ("t", "piezo in", "piezo out")


def test_an_overview_tells_roles_records_and_intervals():
    table = pd.DataFrame({"t [ms]": 1e3 * np.append(T, T), "u": [*U, *Z], "y": [*Y, *U]})
    overview = inspect_recording(table)
    assert [column.role for column in overview.columns] == ["time", "drive", "response"]
    assert [record.n_samples for record in overview.records] == [N, N]
    # between one and two readings for each part of the thumbnail, all at their place
    np.testing.assert_array_equal(overview.columns[1].outline.T, [np.arange(2 * N), table["u"]])
    assert "record 1: 200 samples every 0.001 s, 0.2 s in all" in str(overview)
    assert "as given" in str(inspect_recording(table, drive="y", response="u"))


@pytest.mark.parametrize(
    ("force", "motion", "doubted"),
    [
        ("force [N]", "displacement [mm]", True),
        ("F [kN]", "velocity", True),
        ("force command [N]", "displacement [mm]", False),
        ("voltage", "displacement [mm]", False),
    ],
)
def test_a_force_and_a_motion_may_each_be_the_cause(force, motion, doubted):
    found = recognise_columns(pd.DataFrame({"t": T, force: U, motion: Y}))["drive"]
    assert found.name == force
    assert bool(found.doubt) == doubted
    assert f"drive={motion!r} and response={force!r}" in found.doubt or not doubted
