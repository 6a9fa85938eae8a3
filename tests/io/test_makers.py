"""Files of instruments and of MATLAB: columns, times and units as they were written."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scope_layouts import MAKERS, signals

from skhyst.exceptions import RecordError
from skhyst.io import join_files, recognise_columns
from skhyst.records import read_records, sampling_interval

T, U, Y = signals()
NAMES = {  # of the first and the second channel, with their units
    "tektronix": ("CH1 [V]", "CH2 [V]"),
    "keysight": ("1 [V]", "2 [V]"),
    "rigol": ("CH1 [V]", "CH2 [V]"),
    "rigol_mso": ("CH1V", "CH2V"),
    "picoscope": ("Channel A [V]", "Channel B [mV]"),
    "labview": ("Voltage_0 [V]", "Voltage_1 [V]"),
    "labview_without_time": ("Voltage_0", "Voltage_1"),
    "catman": ("Kraft [N]", "Weg [mm]"),
    "dspace": ("Model Root/Amp/Out1 [V]", "Model Root/Gauge/Out1 [um]"),
    "siglent": ("CH1 [V]", "CH2 [V]"),
    "rohde_schwarz": ("C1 in V", "C2 in V"),
    "yokogawa": ("CH1 [V]", "CH2 [V]"),
    "hioki": ("ACH1 [V]", "ACH2 [V]"),
    "labview_with_times": ("Voltage_0 [V]", "Voltage_1 [V]"),
    "twincat": ("uDrive [V]", "xPos [mm]"),
    "pi_recorder": ("Target Position axis 1", "Current Position axis 1"),
}


@pytest.mark.parametrize("maker", NAMES)
def test_a_file_of_an_instrument_is_read_with_one_option(tmp_path, maker):
    write, suffix = MAKERS[maker]
    path = tmp_path / f"scope{suffix}"
    path.write_text(write(T, U, Y), encoding="latin-1")
    drive, response = NAMES[maker]
    X, y = read_records(path, drive=drive, response=response, time=_time_of(path, drive))
    factor = 1e3 if response.endswith("[mV]") else 1.0
    assert (list(X), y.name) == ([drive], response)
    np.testing.assert_allclose(X[drive], U, atol=1e-6)
    np.testing.assert_allclose(y, factor * Y, atol=1e-6 * factor)
    assert sampling_interval(X) == pytest.approx(1e-3)


def _time_of(path, drive):
    found = recognise_columns(path, drive=drive)
    return found["time"].column if "time" in found else None


@pytest.mark.parametrize("maker", ["tektronix_tds", "lecroy"])
def test_channels_in_files_of_their_own_are_joined(tmp_path, maker):
    write, suffix = MAKERS[maker]
    files = [tmp_path / f"{name}{suffix}" for name in ("drive", "sensor")]
    for path, values in zip(files, (U, Y), strict=True):
        path.write_text(write(T, values, values))
    X, y = read_records(join_files(files))
    assert X.columns[0].startswith("drive ")
    assert y.name.startswith("sensor ")
    np.testing.assert_allclose(X.iloc[:, 0], U, atol=1e-6)
    np.testing.assert_allclose(y, Y, atol=1e-6)
    assert sampling_interval(X) == pytest.approx(1e-3)


def test_files_that_do_not_belong_together_are_not_joined(tmp_path):
    for name, n in (("a", 10), ("b", 11)):
        pd.DataFrame({name: np.arange(n) ** 2}).to_csv(tmp_path / f"{name}.csv", index=False)
    with pytest.raises(RecordError, match=r"must agree\. Got a\.csv 10, b\.csv 11 rows"):
        join_files([tmp_path / "a.csv", tmp_path / "b.csv"])


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
@pytest.mark.parametrize("additive", [False, True])
def test_recordings_below_or_beside_each_other_are_records(tmp_path, suffix, additive):
    tables = [pd.DataFrame({"t": T[:n], "u": k * U[:n], "y": Y[:n]}) for k, n in ((1, 90), (2, 60))]
    if additive:
        both = pd.concat([tables[0], pd.Series(np.nan, range(90), name=""), tables[1]], axis=1)
        table = pd.DataFrame([both.columns.tolist(), *both.to_numpy(dtype=object).tolist()])
    else:
        blocks = [[own.columns.tolist(), *own.to_numpy(dtype=object).tolist()] for own in tables]
        table = pd.DataFrame([*blocks[0], *blocks[1]])
    path = tmp_path / f"rig{suffix}"
    write = table.to_csv if suffix == ".csv" else table.to_excel
    write(path, index=False, header=False)
    X, y = read_records(path)
    lengths = X.groupby(level="record", sort=False).size()
    assert lengths.tolist() == [90, 60]
    np.testing.assert_allclose(X["u"], np.concatenate([own["u"] for own in tables]))
    np.testing.assert_allclose(y, np.concatenate([own["y"] for own in tables]))


def test_notes_and_units_between_recordings_are_no_rows(tmp_path):
    rows = "".join(f"{t:.3f},{u},{y}\n" for t, u, y in zip(T, U, Y, strict=True))
    named = "".join(f"run {k}\nt,u,y\ns,V,um\n{rows}\n" for k in (1, 2, 3))
    head = (
        "Samples,400,400\nY_Unit_Label,V,um\nDelta_X,1e-3,1e-3\n***End_of_Header***\nX_Value,u,y\n"
    )
    for text in (named, f"LabVIEW Measurement\n{f'{head}{rows}' * 3}"):
        (tmp_path / "rig.csv").write_text(text)
        X, y = read_records(tmp_path / "rig.csv")
        assert X.groupby(level="record").size().tolist() == [400] * 3
        assert (X.columns[0], y.name) == ("u [V]", "y [um]")


@pytest.mark.parametrize(
    ("more", "interval"), [({"fs": 1000.0}, 1e-3), ({"Ts": 0.002}, 2e-3), ({"dt": 5e-4}, 5e-4)]
)
def test_a_struct_tells_its_interval(tmp_path, more, interval):
    savemat(tmp_path / "rig.mat", {"rig": {"u": U, "y": Y, **more}})
    X, _ = read_records(tmp_path / "rig.mat")
    assert sampling_interval(X) == pytest.approx(interval)


def test_a_struct_tells_units_and_names(tmp_path):
    units = {"u": "V", "y": "um"}
    savemat(tmp_path / "rig.mat", {"rig": {"u": U, "y": Y, "units": units}, "fs": 1000.0})
    X, y = read_records(tmp_path / "rig.mat")
    assert (X.columns[0], y.name) == ("rig.u [V]", "rig.y [um]")
    assert sampling_interval(X) == pytest.approx(1e-3)
    one = {"data": U, "name": "command", "unit": "V", "Ts": 1e-3}
    other = one | {"data": Y, "name": "sensor", "unit": "nm"}
    savemat(tmp_path / "log.mat", {"a": one, "b": other})
    X, y = read_records(tmp_path / "log.mat")
    assert (X.columns[0], y.name) == ("command [V]", "sensor [nm]")
    assert sampling_interval(X) == pytest.approx(1e-3)
