"""Many recordings: as one by one, whatever runs them; nothing is lost, nothing is done twice."""

from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pandas as pd
import pytest
from joblib import parallel_config

from skhyst.cli import main
from skhyst.diagnosis import EffectSearchCV
from skhyst.fleet import diagnose_files, read_summary
from skhyst.linear import FirstOrderLagOperator, Gain
from skhyst.records import read_records

READING = {"drive": "u", "response": "y", "time": "t"}


def make_files(folder, n=4, broken=(1,)):
    files = []
    for number in range(n):
        rng = np.random.default_rng(number)
        t = 0.01 * np.arange(200)
        u = np.sin(2 * np.pi * 2 * t) + 0.3 * rng.normal(size=t.size)
        if number % 2:
            y, _ = FirstOrderLagOperator(0.05).run(2.0 * u, 0.01)
        else:
            y = 2.0 * u
        y = y + 0.05 * rng.normal(size=t.size)
        files.append(folder / f"stage_{number}.csv")
        pd.DataFrame({"t": t, "u": u, "y": y}).to_csv(files[-1], index=False)
    for number in broken:
        files[number].write_bytes(b"\x00\xff no recording")
    return files


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return make_files(tmp_path_factory.mktemp("fleet"))


@pytest.fixture
def search():
    return EffectSearchCV(Gain(), effects=["lag"], random_state=0)


@pytest.fixture(scope="module")
def serial(files):
    search = EffectSearchCV(Gain(), effects=["lag"], random_state=0)
    return diagnose_files(files, search, reading=READING)


def test_a_row_says_what_a_search_finds(files, serial, search):
    assert serial["file"].tolist() == [str(file) for file in files]
    assert serial["failure"].astype(bool).tolist() == [False, True, False, False]
    assert serial["effects"].tolist() == ["", "", "", "lag"]
    search.fit(*read_records(files[3], **READING))
    row = serial.loc[3]
    assert (row["verdict"], row["error_after"]) == (search.verdict_, search.error_after_)
    for name, value in search.best_estimator_.params_.items():
        assert row[f"param {name}"] == value
        assert row[f"std {name}"] == search.best_estimator_.params_std_[name]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_threads_and_the_table_equal_the_serial_run(files, serial, search, tmp_path, suffix):
    path = tmp_path / f"summary{suffix}"
    with parallel_config("threading", n_jobs=2):
        table = diagnose_files(files, search, reading=READING, summary=path)
    pd.testing.assert_frame_equal(table, serial)
    pd.testing.assert_frame_equal(read_summary(path), serial, check_dtype=False)


def test_a_run_goes_on_where_it_was_stopped(files, serial, search, tmp_path, monkeypatch):
    path, searched, fit = tmp_path / "summary.csv", [], EffectSearchCV.fit

    def stopped(self, X, y):
        searched.append(len(X))
        if len(searched) == 2:
            raise KeyboardInterrupt
        return fit(self, X, y)

    monkeypatch.setattr(EffectSearchCV, "fit", stopped)
    with pytest.raises(KeyboardInterrupt):
        diagnose_files(files, search, reading=READING, summary=path)
    assert len(read_summary(path)) == 2  # one of them is the broken one
    table = diagnose_files(files, search, reading=READING, summary=path)
    pd.testing.assert_frame_equal(table, serial, check_dtype=False)
    assert len(searched) == 4
    diagnose_files(files[:2], search, reading=READING, summary=path)
    assert len(searched) == 4
    assert len(read_summary(path)) == 4  # what was not asked for stays
    diagnose_files(files[:1], search, reading=READING, summary=path, force=True)
    assert len(searched) == 5


def test_what_cannot_be_gone_on_with_is_refused(files, search, tmp_path):
    path = tmp_path / "summary.csv"
    diagnose_files(files[:1], search, reading=READING, summary=path)
    other = search.set_params(alpha=0.05)
    with pytest.raises(ValueError, match="other options"):
        diagnose_files(files, other, reading=READING, summary=path)
    with pytest.raises(ValueError, match=r"must end in \.parquet or \.csv"):
        diagnose_files(files, search, summary=tmp_path / "summary.json")
    with pytest.raises(ValueError, match="each recording once"):
        diagnose_files([files[0], files[0]], search)
    with pytest.raises(ValueError, match=r"no table of diagnose_files"):
        read_summary(files[0])
    with pytest.raises(FileExistsError, match="is an input"):
        diagnose_files(files, search, summary=files[0])


def test_the_command_line_equals_python(files, serial, tmp_path, capsys):
    path = tmp_path / "summary.csv"
    options = ["--drive", "u", "--response", "y", "--time", "t", "--model", "gain"]
    options += ["--effects", "lag", "--jobs", "1", "--summary", str(path)]
    command = ["diagnose", *map(str, files), *options]
    assert main(command) == 0
    told = capsys.readouterr()
    assert "4 recordings: 1 could not be searched" in told.out
    assert "lag: 1" in told.out
    assert f"{files[3]}: lag" in told.err
    table = read_summary(path).drop(columns="options")
    pd.testing.assert_frame_equal(table, serial.drop(columns="options"), check_dtype=False)
    assert main([*command, "--quiet"]) == 0
    assert capsys.readouterr().err == ""
    assert main([*command, "--report", str(tmp_path / "report.html")]) == 1
    assert "--report" in capsys.readouterr().err
    assert main(["diagnose", *map(str, files[:2]), *options[:-2]]) == 1
    assert "add --summary" in capsys.readouterr().err


def test_what_a_table_needs_is_found_out_first(files, search, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr(EffectSearchCV, "fit", None)
    with pytest.raises(ImportError, match=r"skhyst\[io\]"):
        diagnose_files(files, search, reading=READING, summary=tmp_path / "summary.parquet")


def test_a_worker_that_dies_is_told(files, tmp_path, capsys, monkeypatch):
    def killed(*args, **options):
        raise BrokenProcessPool

    monkeypatch.setattr("skhyst.cli._diagnose.diagnose_files", killed)
    command = ["diagnose", str(files[0]), "--drive", "u", "--response", "y", "--model", "gain"]
    command += ["--summary"]
    assert main([*command, str(tmp_path / "summary.csv")]) == 1
    assert "the same command resumes from there" in capsys.readouterr().err
