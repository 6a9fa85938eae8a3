"""Files are written whole or not at all, and nothing but a file is read or replaced."""

import gc
import os
import stat

import numpy as np
import pandas as pd
import pytest

from skhyst._files import check_input, check_outputs, replacing
from skhyst.diagnosis import EffectSearchCV, Experiment
from skhyst.export import to_c, to_fmu
from skhyst.hysteresis import BacklashOperator
from skhyst.linear import Gain
from skhyst.persistence import save_model

resource = pytest.importorskip("resource", reason="limits of POSIX")
DRIVE = pd.Series(np.arange(900.0), pd.Index(1e-3 * np.arange(900), name="time"), name="drive")


@pytest.fixture(scope="module")
def search():
    u = np.sin(0.1 * np.arange(400))
    y = 2.0 * u + 0.01 * np.random.default_rng(0).normal(size=u.size)
    return EffectSearchCV(Gain(), effects=["lag"], max_effects=1).fit(u[:, None], y)


WRITERS = {  # each writer of the package, by the file that it writes
    "report.md": lambda search, path: search.report().to_markdown(path),
    "report.json": lambda search, path: search.report().to_json(path),
    "report.html": lambda search, path: search.report().to_html(path),
    "model.joblib": lambda search, path: save_model(search, path),
    "model.skops": lambda search, path: save_model(search.best_estimator_, path),
    "drive.csv": lambda search, path: Experiment(DRIVE, "", "", 0.0).save(path, force=True),
    "gear.c": lambda search, path: to_c(BacklashOperator(0.2), path.parent, "gear", dt=1e-3),
    "gear.fmu": lambda search, path: to_fmu(BacklashOperator(0.2), path, dt=1e-3),
}
EACH = pytest.mark.parametrize(  # the pictures of the page take seconds
    "name", [pytest.param(n, marks=pytest.mark.slow) if n == "report.html" else n for n in WRITERS]
)


# where writing fails, the pickler of Python 3.13 leaves a buffer that is still seen
@pytest.mark.filterwarnings(
    "ignore:Exception ignored.*BytesIO:pytest.PytestUnraisableExceptionWarning"
)
@EACH
def test_a_full_disk_leaves_the_old_file_whole(search, tmp_path, name):
    path, write = tmp_path / name, WRITERS[name]
    write(search, path)
    whole = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    path.write_text("mine")
    path.chmod(0o640)
    room = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, room[1]))
    try:
        with pytest.raises(OSError, match=r"^\S+ (cannot be written: File too large\.|was not)"):
            write(search, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, room)
    gc.collect()
    found = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert found == whole | {name: b"mine"}
    write(search, path)
    assert path.stat().st_size > 500
    assert {file.name for file in tmp_path.iterdir()} == set(whole)
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


@pytest.mark.parametrize("name", [name for name in WRITERS if name != "report.html"])
def test_no_writer_follows_a_link(search, tmp_path, name):
    (tmp_path / "other").write_text("mine")
    (tmp_path / name).symlink_to("other")
    with pytest.raises(FileExistsError, match="is a link to other"):
        WRITERS[name](search, tmp_path / name)
    assert (tmp_path / "other").read_text() == "mine"
    (tmp_path / "other").unlink()  # the link leads nowhere
    with pytest.raises(FileExistsError, match="is a link to other"):
        WRITERS[name](search, tmp_path / name)


def test_files_take_their_places_together(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_text("old")
    interrupted = replacing(one, two)
    for part in interrupted.__enter__():
        part.write_text("new")
    assert not interrupted.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    assert [path.name for path in tmp_path.iterdir()] == ["one"]
    assert one.read_text() == "old"
    with replacing(one, two) as parts:
        for part in parts:
            part.write_text("new")
        assert one.read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "two"]
    assert one.read_text() == two.read_text() == "new"


def test_a_new_file_has_the_permissions_that_any_has(tmp_path):
    (tmp_path / "usual").write_text("")
    with replacing(tmp_path / "new") as (part,):
        part.write_text("")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_targets_that_are_no_files_or_protected(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    for path, message in (
        (tmp_path / "pipe", "pipe is a pipe or a device"),
        (tmp_path, "is a folder"),
        (tmp_path / "none" / "file", r"file cannot be written: No such file or directory\."),
    ):
        with pytest.raises(OSError, match=message), replacing(path):
            pass
        if path.parent.exists():
            with pytest.raises(OSError, match=message):
                check_outputs([path], force=True)
    (tmp_path / "mine").write_text("mine")
    with pytest.raises(OSError, match="file cannot be written"):
        check_outputs([tmp_path / "mine" / "file"])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(PermissionError, match="mine is protected"), replacing(tmp_path / "mine"):
        pass


def test_outputs_are_compared_as_files_not_as_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    path = tmp_path / "rig.csv"
    for other in (path.relative_to(tmp_path), tmp_path / "new" / ".." / "rig.csv", path):
        with pytest.raises(FileExistsError, match="two outputs"):
            check_outputs([path, other])
    path.write_text("mine")
    os.link(path, "hard.csv")
    (tmp_path / "link").symlink_to(tmp_path)
    for other in ("rig.csv", "hard.csv", "link/rig.csv"):
        for read in (path, type(path)("~/rig.csv")):
            with pytest.raises(FileExistsError, match="never overwritten"):
                check_outputs([type(path)(other)], [read], force=True)
    with pytest.raises(FileExistsError, match="exists already"):
        check_outputs([path])
    check_outputs([path, tmp_path / "new" / "one"], [tmp_path / "absent"], force=True)
    assert path.read_text() == "mine"
    assert list((tmp_path / "new").iterdir()) == []


def test_what_is_read_is_a_file(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for name in ("pipe", "."):
        with pytest.raises(OSError, match="a file was expected"):
            check_input(tmp_path / name)
    with pytest.raises(FileNotFoundError, match="no file"):
        check_input(tmp_path / "absent")
