"""Recordings as their authors published them, one call each; skipped where they are absent."""

import numpy as np
import pytest
from recordings import SHARED as DATA

from skhyst.exceptions import RecordError
from skhyst.io import recognise_columns
from skhyst.records import (
    iter_records,
    read_records,
    record_slices,
    resample_records,
)

pytestmark = pytest.mark.needs_recordings

AFM = "piezo_afm/SG_data_triangle_sin_raw.mat"
DAMPER = "friction_damper/dataset-1_0.5Hz20lbtension.json"
PNEUMATIC = "pneumatic_cylinder/Circle_3bar.csv"

BY_POSITION = {"drive": 1, "response": 3, "time": 0}
SPACE_VECTOR = {"drive": "[0, 2, 1]", "auxiliary": ["[1, 2, 1]", "[2, 2, 1]"]}
PNZT = {"drive": "Vplus_19kv", "response": "Displacement_19kv"}


def rated(drive, response, rate):
    return {"drive": drive, "response": response, "sampling_rate": rate}


CASES = {  # file: columns, rows, interval in s
    AFM: (rated("V", "SG[0]", 1.0), 4824, 1.0),
    "mr_damper/5mm3Hz0x5A.txt": (BY_POSITION | {"auxiliary": [2]}, 4257, 0.001),
    "mr_damper/25mm0x1Hz1A.txt": (BY_POSITION, 10_492, 0.005),
    "emps/DATA_EMPS.mat": ({"drive": "vir", "response": "qm", "time": "t"}, 24_841, 0.001),
    "silverbox/SNLS80mV.csv": (rated("V1", "V2", 610.35), 131_072, 1 / 610.35),
    "cascaded_tanks/dataBenchmark.csv": (rated("uEst", "yEst", 0.25), 1024, 4.0),
    "bouc_wen_benchmark/test.h5": (rated("multisine/u", "multisine/y", 750.0), 8192, 1 / 750),
    DAMPER: ({"drive": "data[1]", "response": "data[2]", "time": "data[0]"}, 18_433, 1 / 1024),
    "piezo_pnzt/MeasurementData.mat": (PNZT, 401, 1.0),
    "bh_loops/1_isotropic/H_MnZn_ferrite.mat": ({"drive": "HmeasT[3]"}, 129, 1.0),
    "piezo_fsm/u_100mV_test.npy": (SPACE_VECTOR | {"sampling_rate": 6400.0}, 8192, 1 / 6400),
}


@pytest.mark.parametrize("name", CASES)
def test_a_published_recording_is_one_even_record(name):
    options, n_samples, dt = CASES[name]
    X, y = read_records(DATA / name, **options)
    (record,) = record_slices(X, y)
    assert record.n_samples == n_samples
    assert record.dt == pytest.approx(dt, rel=1e-8)
    assert np.isfinite(X).all(axis=None)
    assert X.iloc[:, 0].std() > 0
    assert y is None or y.std() > 0


@pytest.mark.parametrize("name", CASES)
def test_no_column_of_a_published_recording_is_guessed_wrongly(name):
    options, *_ = CASES[name]
    try:
        found = recognise_columns(DATA / name)
    except RecordError as error:
        assert any(words in str(error) for words in ("Candidates", "no column is a signal"))  # noqa: PT017
        return
    for role in ("drive", "response"):
        assert str(options[role]).rpartition("/")[2] == found[role].name


def test_positions_and_names_address_the_same_column():
    by_name, _ = read_records(DATA / DAMPER, drive="data[1]", time="data[0]")
    by_position, _ = read_records(DATA / DAMPER, drive=1, time=0)
    np.testing.assert_array_equal(by_name, by_position)


@pytest.mark.parametrize(("axis", "lost"), [(1, 37), (2, 71)])
def test_lost_readings_of_the_afm_scanner(axis, lost):
    column = f"SG[{axis}]"
    options = {"drive": "V", "response": column, "missing_code": {column: 0}}
    with pytest.raises(RecordError, match=rf"of 4824 rows.* {lost} row\(s\)"):
        read_records(DATA / AFM, **options)
    X, y = read_records(DATA / AFM, on_missing="interpolate", **options)
    assert len(X) == 4824
    assert y.min() > 0
    X, y = read_records(DATA / AFM, on_missing="drop", **options)
    assert 4824 - 2 * lost < len(X) <= 4824 - lost
    assert len(list(iter_records(X, y))) > lost / 2


def test_the_uneven_clock_of_the_pneumatic_cylinder():
    X, y = read_records(DATA / PNEUMATIC, drive=5, response=6, time=0, time_unit="ms")
    with pytest.raises(RecordError, match="resample_records"):
        record_slices(X, y)
    X_new, y_new = resample_records(X, y, dt=0.01)
    found = record_slices(X_new, y_new)
    assert found[0].dt == 0.01
    assert len(found) == 3  # the recording was interrupted twice, for 0.3 and 2.66 s
    assert y_new.mean() == pytest.approx(y.mean(), rel=0.01)
