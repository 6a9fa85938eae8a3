"""The cache of compiled code: what is not whole is compiled anew, and written again."""

import pickle
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest

from skhyst._jit import bind, jit

KERNEL = """
def total(values, gain):
    y = 0.0
    for value in values:
        y += gain * value
    return y


def law(value):
    return 3.0 * value
"""
VALUES = np.array([1.0, 2.0, 4.0])


def loop(values):
    """Add what a law makes of values."""
    y = 0.0
    for value in values:
        y += step(value)  # noqa: F821
    return y


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    """A module of its own, with a folder of its own to cache in."""
    Path(tmp_path, "kernel_of_test.py").write_text(KERNEL)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.syspath_prepend(tmp_path)
    yield import_module("kernel_of_test")
    sys.modules.pop("kernel_of_test")


def files(folder, suffix):
    return sorted(folder.rglob(f"*.{suffix}"))


def ran(function, values=VALUES):
    """Return the result of a function that is compiled as in a new process, and cache hits."""
    compiled = jit(function)
    return compiled(values, 2.0), sum(compiled.stats.cache_hits.values())


def halved(data):
    return data[: len(data) // 2]


def emptied(data):
    return b""


def zeros(data):
    return bytes(len(data))


def middle_lost(data):
    """As where a power failure leaves a block of zeros in the middle: pickle sees nothing."""
    start = len(data) // 2
    return data[:start] + bytes(64) + data[start + 64 :]


def of_a_module_that_is_gone(data):
    gone = ModuleType("gone_with_the_last_version")
    gone.Law = type("Law", (), {"__module__": gone.__name__})
    sys.modules[gone.__name__] = gone
    try:
        return pickle.dumps(gone.Law())
    finally:
        del sys.modules[gone.__name__]


def of_another_layout(data):
    return pickle.dumps((1, 2))


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize(
    "damage",
    [halved, emptied, zeros, middle_lost, of_a_module_that_is_gone, of_another_layout],
    ids=lambda damage: damage.__name__,
)
def test_what_is_damaged_is_compiled_anew(kernel, tmp_path, damage, suffix):
    assert ran(kernel.total) == (14.0, 0)
    (file,) = files(tmp_path, suffix)
    whole = file.read_bytes()
    file.write_bytes(damage(whole))
    assert file.read_bytes() != whole
    assert ran(kernel.total) == (14.0, 0)
    assert ran(kernel.total) == (14.0, 1)  # from what was written again


def test_two_processes_that_begin_a_cache_get_no_code_of_each_other(kernel, tmp_path):
    """Both find it empty, and so call their code, of a signature each, by the same name."""
    integers = np.array([1, 2, 4])
    ran(kernel.total, integers)
    (data,) = files(tmp_path, "nbc")
    of_integers = data.read_bytes()
    data.unlink()
    files(tmp_path, "nbi")[0].unlink()
    ran(kernel.total)
    assert files(tmp_path, "nbc") == [data]
    data.write_bytes(of_integers)  # of the process that was last
    assert ran(kernel.total) == (14.0, 0)
    assert ran(kernel.total) == (14.0, 1)
    assert ran(kernel.total, integers) == (14.0, 0)


def test_a_loop_is_cached_with_its_law(kernel, tmp_path):
    for hits in (0, 1):
        bound = bind(loop, jit(kernel.law))
        assert bound(VALUES) == 21.0
        assert sum(bound.stats.cache_hits.values()) == hits
    names = [file.name.partition("-")[0] for file in files(tmp_path, "nbi")]
    assert names == ["kernel_of_test.law", "kernel_of_test.law_loop"]


LAW = """
import numpy as np
from skhyst._jit import jit

GAIN = 3.0
TABLE = np.array([0.0, 1.0])


@jit
def law(value):
    return GAIN * value + TABLE[0]
"""
CALLER = """
from law_of_test import law
from skhyst._jit import jit


@jit
def total(values):
    y = 0.0
    for value in values:
        y += law(value)
    return y
"""


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [("+ TABLE[0]", "+ 2 * TABLE[1]", 27.0), ("3.0", "4.00", 28.0), ("[0.0,", "[1.00,", 24.0)],
    ids=["law", "constant", "array"],
)
def test_what_changes_in_another_file_is_compiled_anew(kernel, tmp_path, old, new, expected):
    """After an upgrade the file of the loop may be as it was."""
    Path(tmp_path, "caller_of_test.py").write_text(CALLER)
    found = []
    for text in (LAW, LAW, LAW.replace(old, new)):
        Path(tmp_path, "law_of_test.py").write_text(text)
        total = import_module("caller_of_test").total
        found.append((total(VALUES), sum(total.stats.cache_hits.values())))
        del sys.modules["law_of_test"], sys.modules["caller_of_test"]
    assert found == [(21.0, 0), (21.0, 1), (expected, 0)]


def test_a_folder_that_can_no_longer_be_written_costs_the_cache_alone(kernel, tmp_path):
    compiled = jit(kernel.total)
    (tmp_path / "cache").rename(tmp_path / "old")
    (tmp_path / "cache").write_text("")  # no folder, even for root
    assert compiled(VALUES, 2.0) == 14.0
