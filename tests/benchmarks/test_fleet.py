"""A tiny case of the benchmark of fleets, on threads."""

from contextlib import contextmanager

import fleet
from joblib import parallel_config


def test_threads_lose_nothing(monkeypatch, capsys):
    @contextmanager
    def on_threads():
        with parallel_config("threading", n_jobs=2):
            yield None

    monkeypatch.setitem(fleet.ENGINES, "dask", on_threads)
    monkeypatch.setattr("sys.argv", ["fleet.py", "--recordings", "3", "--engines", "dask"])
    assert fleet.main() == 0
    assert capsys.readouterr().out.count("kept") == 4


def test_what_is_lost_is_counted(tmp_path):
    serial = fleet.searched(fleet.write_fleet(tmp_path, 2))
    assert fleet.lost(serial, serial) == 0
    assert fleet.lost(serial.iloc[:1], serial) == 1
    assert fleet.lost(serial.assign(verdict=["another", ""]), serial) == 1
