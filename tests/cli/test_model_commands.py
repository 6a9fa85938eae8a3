"""The commands that take a model: the same results as Python, nothing run, nothing lost."""

import copy
import importlib.util
import re
import shutil
import subprocess
import sys
from zipfile import ZipFile

import joblib
import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import Ridge

from skhyst.cli import main
from skhyst.control import InverseCompensator
from skhyst.exceptions import ReachWarning
from skhyst.export import to_c, to_fmu, to_structured_text
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.persistence import save_model
from skhyst.records import read_records


@pytest.fixture(scope="module")
def model():
    u = 5.0 * np.sin(0.05 * np.arange(300)) * np.linspace(0.2, 1.0, 300)
    plays = PrandtlIshlinskiiOperator(np.arange(4.0), np.array([1.0, 0.3, 0.2, 0.1]))
    return PrandtlIshlinskii(4, dt=1e-3).fit(u[:, None], plays.run(u, 1e-3)[0])


@pytest.fixture
def model_file(model, tmp_path):
    """The model in a file that is read without running anything."""
    pytest.importorskip("skops.io")
    save_model(model, tmp_path / "stage.skops")
    return tmp_path / "stage.skops"


@pytest.fixture
def reference(tmp_path):
    time = 1e-3 * np.arange(200)
    path = tmp_path / "reference.csv"
    wanted = 4.0 * np.sin(30.0 * time) ** 2
    pd.DataFrame({"t": 1e3 * time, "um": wanted}).to_csv(path, index=False)
    return path


def test_compensate_equals_python(model, model_file, reference, tmp_path, capsys):
    out = tmp_path / "new" / "drive.csv"
    call = ["compensate", str(model_file), str(reference), "-o", str(out), "--time-unit", "ms"]
    limited = [*call, "--limits", "-1", "2.5", "--bandwidth", "40"]
    assert main([*limited, "--force"]) == 0
    X, y = read_records(reference, drive="um", response="um", time="t", time_unit="ms")
    same = InverseCompensator(model, drive_limits=(-1.0, 2.5), bandwidth=40.0).fit(X, y)
    with pytest.warns(ReachWarning) as said:
        drive = same.predict(X)
    table = np.genfromtxt(out, delimiter=",", names=True)  # to the last digit
    ends = (table["drive"][0], table["drive"][-1])
    assert max(map(abs, ends)) <= same.rate_limit_ * 1e-3 * (1.0 + 1e-9)  # a step from rest at 0
    table = table[(table["time"] > -5e-4) & (table["time"] < 0.1995)]
    np.testing.assert_allclose(table["drive"], drive, rtol=1e-15)
    np.testing.assert_allclose(table["time"], 1e-3 * np.arange(200), atol=1e-15)
    printed = capsys.readouterr().out
    residual = np.abs(model.predict(drive[:, None]) - y).max()
    assert f"{residual:.4g} ({100 * residual / np.ptp(y):.3g} % of the range)" in printed
    assert any("limits of the drive cut" in str(one.message) for one in said)
    assert all(str(one.message) in printed for one in said)
    assert main([*call, "--reference", "um", "--time", "t", "--force"]) == 0
    assert "cut" not in capsys.readouterr().out


def test_a_drive_that_misses_the_reference_is_not_written(model_file, tmp_path, capsys):
    """Beyond the fit's range by default; what a device would miss stands before the reason."""
    wanted = pd.DataFrame({"t": 1e-3 * np.arange(200), "um": 15.0 * np.sin(np.arange(200) / 30)})
    wanted.to_csv(tmp_path / "far.csv", index=False)
    out = tmp_path / "drive.csv"
    call = ["compensate", str(model_file), str(tmp_path / "far.csv"), "-o", str(out)]
    assert main([*call, "--time-unit", "s"]) == 1
    said = capsys.readouterr()
    assert not out.exists()
    assert re.search(
        r"drive.csv is not written: .* miss the reference by up to \d+\.?\d* ", said.err
    )
    assert re.search(r"The limits of the drive cut \d+\.?\d* % of the samples", said.out)
    assert main([*call, "--time-unit", "s", "--force"]) == 0
    assert "overridden by --force: " in capsys.readouterr().out
    drive = pd.read_csv(out)["drive"]
    assert drive.abs().max() <= 5.0  # of the recording
    assert main([*call, "--time-unit", "s", "--no-limits", "--force"]) == 0
    assert pd.read_csv(out)["drive"].abs().max() > 8.0
    assert "of the drive are beyond the range of the fit" in capsys.readouterr().out
    assert main([*call, "--time-unit", "s", "--limits", "-9e0", "9", "--force"]) == 0
    assert 5.0 < pd.read_csv(out)["drive"].abs().max() <= 9.0


def test_a_reference_with_a_gap_has_no_drive(model_file, tmp_path, capsys):
    """An amplifier would jump from one piece to the next."""
    t = 1e-3 * np.arange(200)
    wanted = pd.DataFrame({"t": t + (t > 0.1), "um": np.sin(np.arange(200) / 30)})
    wanted.to_csv(tmp_path / "gap.csv", index=False)
    call = ["compensate", str(model_file), str(tmp_path / "gap.csv"), "--time-unit", "s"]
    assert main([*call, "-o", str(tmp_path / "drive.csv"), "--force"]) == 1
    assert "has a gap of 1.001 s behind the time 0.1," in capsys.readouterr().err
    assert not (tmp_path / "drive.csv").exists()


def test_a_model_that_does_not_know_its_drive_needs_limits(model, reference, tmp_path, capsys):
    pytest.importorskip("skops.io")
    older = copy.copy(model)
    del older.drive_range_, older.drive_rate_
    save_model(older, tmp_path / "older.skops")
    out = tmp_path / "drive.csv"
    call = ["compensate", str(tmp_path / "older.skops"), str(reference), "-o", str(out)]
    call += ["--time-unit", "ms"]
    assert main(call) == 1
    assert not out.exists()
    assert "Give the limits of the amplifier (--limits)" in capsys.readouterr().err
    assert main([*call, "--limits", "-5", "5"]) == 0
    assert out.exists()


def test_export_equals_python(model, model_file, reference, tmp_path):
    units = {"input_unit": 1e-3, "output_unit": 1e-3}
    drive = pd.read_csv(reference)["um"]
    for more, same in (
        ([], {}),
        (["--dtype", "float32", "--dt", "0.01", "--u0", "0.5", "--name", "stage"], {"u0": 0.5}),
        (["--dtype", "int32", "--drive", str(reference), "--input-unit", "1e-3"], units),
    ):
        same = same | {"dtype": more[1]} if more else same
        same |= {"dt": 0.01} if "--dt" in more else {}
        same |= {"drive": drive} if "--drive" in more else {}
        more += ["--output-unit", "1e-3"] if "--drive" in more else []
        call = ["export", str(model_file), "--c", str(tmp_path / "c"), *more]
        assert main([*call, "--force"]) == 0
        for path in to_c(model, tmp_path / "python", "stage", **same):
            assert (tmp_path / "c" / path.name).read_text() == path.read_text()
    assert main(["export", str(model_file), "--st", str(tmp_path / "st"), "--u0", "0.5"]) == 0
    for path in to_structured_text(model, tmp_path / "python", "stage", u0=0.5):
        assert (tmp_path / "st" / path.name).read_text() == path.read_text()


def test_an_fmu_equals_python(model, model_file, tmp_path, capsys):
    out = tmp_path / "new" / "unit.fmu"
    call = ["export", str(model_file), "--fmu", str(out), "--input-unit", "V", "--u0", "0.5"]
    assert main([*call, "--fmi-version", "2.0"]) == 0
    printed = capsys.readouterr().out
    assert ("no finding" if importlib.util.find_spec("fmpy") else "skhyst[fmi]") in printed
    same = to_fmu(model, tmp_path / "unit.fmu", "2.0", input_unit="V", u0=0.5)
    names = ("modelDescription.xml", "sources/unit.c", "sources/unit_fmu.c")
    assert all(ZipFile(out).read(name) == ZipFile(same).read(name) for name in names)


def test_without_fmpy_a_unit_is_written_and_says_what_is_missing(
    model_file, tmp_path, capsys, monkeypatch
):
    monkeypatch.setitem(sys.modules, "fmpy.validation", None)
    assert main(["export", str(model_file), "--fmu", str(tmp_path / "unit.fmu")]) == 0
    assert "skhyst[fmi]" in capsys.readouterr().out
    assert (tmp_path / "unit.fmu").exists()


def test_a_compensator_is_exported(model, tmp_path):
    pytest.importorskip("skops.io")
    X = np.linspace(0.0, 1.0, 4)[:, None]
    compensator = InverseCompensator(model, drive_limits=(-1.0, 2.0)).fit(X, X[:, 0])
    save_model(compensator, tmp_path / "inverse.skops")
    assert main(["export", str(tmp_path / "inverse.skops"), "--c", str(tmp_path / "c")]) == 0
    for path in to_c(compensator, tmp_path, "inverse"):
        assert (tmp_path / "c" / path.name).read_text() == path.read_text()


def test_what_is_there_is_kept(model_file, tmp_path, capsys):
    for out, file in ((["--c", tmp_path], "stage.h"), (["--fmu", tmp_path / "a.fmu"], "a.fmu")):
        (tmp_path / file).write_text("mine")
        call = ["export", str(model_file), *map(str, out)]
        assert main(call) == 1
        assert f"{file} exists already: add --force" in capsys.readouterr().err
        assert (tmp_path / file).read_text() == "mine"
        assert not (tmp_path / "stage.c").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--fmu", "unit.fmu", "--dtype", "float32"], "--dtype is not an option of --fmu"),
        (["--c", "folder", "--fmi-version", "2.0"], "--fmi-version is not an option of --c"),
        (["--st", "folder", "--sizes"], "--sizes is not an option of --st"),
        (["--fmu", "unit.zip"], r"must end in .fmu"),
        (
            ["--c", "folder", "--dtype", "int32", "--input-unit", "V"],
            "could not convert string to float",
        ),
    ],
)
def test_options_of_export_are_checked(model_file, tmp_path, capsys, monkeypatch, more, message):
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(model_file), *more]) == 1
    assert message in capsys.readouterr().err


def test_what_cannot_be_exported_is_said(model_file, tmp_path, capsys, monkeypatch):
    def refuse(*args, **kwargs):
        raise NotImplementedError("the output depends on later input")

    monkeypatch.setattr("skhyst.cli._export.to_c", refuse)
    assert main(["export", str(model_file), "--c", str(tmp_path)]) == 1
    assert capsys.readouterr().err == "skhyst: the output depends on later input\n"


def test_no_model_and_no_reference_is_written_over(model_file, reference, tmp_path, capsys):
    unit = tmp_path / "stage.fmu"
    shutil.copy(model_file, unit)
    compensate = ["compensate", str(model_file), str(reference), "-o"]
    for path, call in (
        (model_file, [*compensate, str(model_file)]),
        (reference, [*compensate, str(reference)]),
        (unit, ["export", str(unit), "--fmu", str(unit)]),
    ):
        old = path.read_bytes()
        assert main([*call, "--force"]) == 1
        printed = capsys.readouterr().err
        assert "is an input" in printed
        assert printed.count("\n") == 1
        assert path.read_bytes() == old


def test_export_writes_one_of_both(model_file, tmp_path, capsys):
    both = ["--c", str(tmp_path), "--fmu", str(tmp_path / "unit.fmu")]
    for more in ([], both):
        with pytest.raises(SystemExit, match="2"):
            main(["export", str(model_file), *more])


class Trap:
    """Creates a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def test_a_pickle_is_loaded_only_where_it_is_trusted(model, tmp_path, capsys):
    path, marker = tmp_path / "stage.joblib", tmp_path / "marker"
    call = ["export", str(path), "--c", str(tmp_path)]
    joblib.dump(Trap(marker), path)
    assert main(call) == 1
    assert "--trust" in capsys.readouterr().err
    assert not marker.exists()
    joblib.dump(model, path)
    assert main([*call, "--trust"]) == 0
    assert (tmp_path / "stage.c").exists()


@pytest.mark.parametrize(
    ("held", "name"),
    [
        (subprocess.Popen, "subprocess.Popen"),
        (main, "skhyst.cli._main.main"),
        (eval, "builtins.eval"),
    ],
)
def test_a_file_that_names_what_can_run_code_is_refused(model, tmp_path, capsys, held, name):
    pytest.importorskip("skops.io")
    hostile = PrandtlIshlinskii()
    vars(hostile).update(vars(model), note=held)
    with pytest.warns(UserWarning, match=name):
        save_model(hostile, tmp_path / "stage.skops")
    assert main(["export", str(tmp_path / "stage.skops"), "--c", str(tmp_path)]) == 1
    printed = capsys.readouterr().err
    assert name in printed
    assert "--trust" in printed


def test_models_that_are_none_are_refused(model_file, reference, tmp_path, capsys, monkeypatch):
    def error(path, *more):
        out = ["-o", str(tmp_path / "drive.csv"), "--time-unit", "ms"]
        assert main(["compensate", str(path), str(reference), *out, *more]) == 1
        assert not (tmp_path / "drive.csv").exists()
        return capsys.readouterr().err

    assert "absent.skops" in error(tmp_path / "absent.skops")
    broken = tmp_path / "broken.skops"
    broken.write_bytes(model_file.read_bytes()[200:])
    assert "broken" in error(broken)
    broken.write_bytes(b"garbage")
    assert "broken" in error(broken, "--trust")
    for other, name in ((Ridge(), "Ridge"), (PrandtlIshlinskii(), "PrandtlIshlinskii")):
        save_model(other, tmp_path / "other.skops")
        assert f"{name}, not a fitted" in error(tmp_path / "other.skops")
    monkeypatch.setitem(sys.modules, "skops.io", None)
    assert "skhyst[io]" in error(model_file)


def test_references_that_are_none_are_refused(model_file, reference, tmp_path, capsys):
    def error(*more):
        out = ["-o", str(tmp_path / "drive.csv"), "--time-unit", "ms"]
        assert main(["compensate", str(model_file), *out, *map(str, more)]) == 1
        return capsys.readouterr().err

    assert "absent.csv" in error(tmp_path / "absent.csv")
    assert "nothing" in error(reference, "--reference", "nothing")
    assert "lower" in error(reference, "--limits", "2", "1")
    assert "bandwidth" in error(reference, "--bandwidth", "-1")
    assert "not within the limits of the drive" in error(reference, "--rest", "-1e2")
    table = pd.read_csv(reference)
    table.loc[7, "um"] = np.nan
    table.to_csv(reference, index=False)
    assert re.search(
        "um: 1 row.*Pass --on-missing drop or --on-missing interpolate", error(reference)
    )
    out = tmp_path / "drive.csv"
    call = ["compensate", str(model_file), str(reference), "-o", str(out), "--time-unit", "ms"]
    assert main([*call, "--on-missing", "interpolate", "--force"]) == 0
    expected = pd.read_csv(out)
    # the column of the records is neither the time nor the reference
    table.insert(0, "record", "a")
    table["um"] = table["um"].interpolate()
    table.to_csv(reference, index=False)
    assert main([*call, "--force"]) == 0
    np.testing.assert_allclose(pd.read_csv(out)["drive"], expected["drive"])
    # a rate in place of a time, and a grid in place of uneven instants
    table[["um"]].to_csv(reference, index=False)
    rated = [*call[:-2], "--sampling-rate", "1000", "--force"]
    assert main(rated) == 0
    np.testing.assert_allclose(pd.read_csv(out)["drive"], expected["drive"])
    t = np.arange(200) + 0.3 * (np.arange(200) % 2)
    pd.DataFrame({"t": t, "um": 4.0 * np.sin(0.03 * t) ** 2}).to_csv(reference, index=False)
    assert "--resample" in error(reference, "--force")
    assert main([*call, "--resample", "1e-3", "--force"]) == 0
    np.testing.assert_allclose(pd.read_csv(out)["drive"], expected["drive"], atol=0.01)
