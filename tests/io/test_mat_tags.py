"""MATLAB files of version 5: sound ones pass, broken ones are refused and never end Python."""

import io
import os
import struct
import subprocess
import sys
import textwrap
import zlib

import numpy as np
import pytest
import scipy.sparse
from scipy.io import savemat

from skhyst.exceptions import RecordError
from skhyst.records import read_records

DRIVE = np.arange(50.0)
CONTENT = {
    "u": DRIVE,
    "complex": DRIVE + 1j,
    "logical": DRIVE > 3,
    "short": DRIVE.astype(np.int8),
    "text": "a stage",
    "texts": np.array(["ab", "cde"]),
    "none": np.zeros((0, 3)),
    "no_text": "",
    "sparse": scipy.sparse.csc_array(np.eye(4)),
    "flags": scipy.sparse.csc_array(np.eye(4) > 0),
    "run": {"drive": DRIVE, "note": "x", "inner": {"rate": 1e3, "empty": np.zeros((0, 0))}},
    "runs": np.zeros(3, dtype=[("a", float), ("b", int)]),
    "cells": np.array([DRIVE, "b", np.zeros((0, 0)), None], dtype=object)[:3],
}


def saved(content=CONTENT, **options):
    file = io.BytesIO()
    savemat(file, content, **options)
    return file.getvalue()


PLAIN = saved({"u": DRIVE})
HEADER = PLAIN[:128]


def compressed(data, level=6, cut=0):
    packed = zlib.compress(data, level)
    packed = packed[: len(packed) - cut]
    return HEADER + struct.pack("<II", 15, len(packed)) + packed


def matrix(kind, *parts, size=(1, 1), name=b"u", order="<"):
    """Return a variable, tag and all."""
    body = struct.pack(f"{order}IIII", 6, 8, kind, 0)
    body += struct.pack(f"{order}IIii", 5, 8, *size)
    body += struct.pack(f"{order}II", 1, len(name)) + name + bytes(-len(name) % 8) + b"".join(parts)
    return struct.pack(f"{order}II", 14, len(body)) + body


def doubles(values, order="<"):
    return struct.pack(f"{order}II{len(values)}d", 9, 8 * len(values), *values)


def read(folder, data, drive="u"):
    (folder / "rig.mat").write_bytes(data)
    return read_records(folder / "rig.mat", drive=drive)[0].iloc[:, 0]


def changed(offset, value, data=PLAIN):
    return data[:offset] + bytes([value]) + data[offset + 1 :]


@pytest.mark.parametrize("compression", [False, True])
def test_what_scipy_saves_passes(tmp_path, compression):
    for drive in ("u", "run.drive", "cells[0]"):
        data = saved(do_compression=compression)
        np.testing.assert_array_equal(read(tmp_path, data, drive), DRIVE)


@pytest.mark.parametrize("order", ["<", ">"])
def test_either_byte_order(tmp_path, order):
    version = {"<": b"\x00\x01IM", ">": b"\x01\x00MI"}[order]
    content = matrix(6, doubles([1.0, 2.0, 5.0], order), size=(3, 1), order=order)
    assert read(tmp_path, HEADER[:124] + version + content).tolist() == [1.0, 2.0, 5.0]
    with pytest.raises(RecordError, match="past the end"):
        read(tmp_path, HEADER[:124] + version + content[:-1])


def test_version_4_is_read(tmp_path):
    np.testing.assert_array_equal(read(tmp_path, saved({"u": DRIVE}, format="4")), DRIVE)


# In PLAIN the tag of the variable starts at byte 128, flags at 136, size at 152, name at 168 (in
# its tag) and numbers at 176.
@pytest.mark.parametrize(
    ("data", "message"),
    [
        *((changed(176, code), f"unknown type code {code} ") for code in (0, 8, 14, 15, 19, 200)),
        (changed(177, 1), "unknown type code 265"),
        (changed(178, 9), "an element in its tag has 9 bytes"),
        (changed(181, 200), "past the end"),
        (changed(128, 9), "not a variable"),
        (changed(133, 200), "past the end"),
        (changed(136, 9), "no array flags"),
        (changed(144, 99), "unknown class 99"),
        (changed(152, 9), "unknown type code 9 "),
        (changed(163, 255), "negative"),
        (changed(168, 9), "unknown type code 9 "),
        (PLAIN + b"\x00" * 8, "not a variable"),
        (PLAIN + b"\x00", "past the end"),
        (PLAIN[:-1], "past the end"),
        (HEADER + matrix(4, struct.pack("<II", 1, 0), size=(2**15, 2**15)), "have no data"),
        (
            HEADER + matrix(2, struct.pack("<IIII", 262149, 8, 1, 0), size=(2**15, 2**15)),
            "no fields",
        ),
        (HEADER + matrix(1, size=(2**30, 2**30)), "past the end"),
        (HEADER + matrix(1, doubles([1.0])), "not a variable"),
        (compressed(matrix(6, struct.pack("<II", 25, 0))), "unknown type code"),
        (compressed(PLAIN[128:])[:-3], "past the end"),
        (changed(150, 1, compressed(PLAIN[128:], 0)), "cannot be decompressed"),
        (compressed(PLAIN[128:], cut=6), "cut or too long"),
    ],
)
def test_broken_variables_are_refused(tmp_path, data, message):
    with pytest.raises(RecordError, match=message):
        read(tmp_path, data)


def test_deep_nesting_is_refused(tmp_path):
    content = matrix(6, doubles([1.0, 2.0]), size=(2, 1))
    for _ in range(20):
        content = matrix(1, content, name=b"u")
    assert read(tmp_path, HEADER + content).tolist() == [1.0, 2.0]
    for _ in range(2000):
        content = matrix(1, content, name=b"")
    with pytest.raises(RecordError, match="inside one another"):
        read(tmp_path, compressed(content))


@pytest.mark.slow
def test_no_corrupted_byte_ends_python(tmp_path):
    """Read 40 corrupted files in one process: it must live on, and refuse what it cannot read."""
    (tmp_path / "plain.mat").write_bytes(saved())
    (tmp_path / "packed.mat").write_bytes(saved(do_compression=True))
    script = """
        import random, sys, warnings
        from pathlib import Path
        from skhyst.exceptions import RecordError
        from skhyst.records import read_records

        warnings.simplefilter("ignore")
        folder, broken = Path(sys.argv[1]), Path(sys.argv[1], "broken.mat")
        choice, refused = random.Random(0), 0
        for i in range(40):
            data = bytearray((folder / ("packed.mat" if i % 4 == 0 else "plain.mat")).read_bytes())
            data[choice.randrange(128, len(data))] = choice.choice([0, 8, 14, 25, 127, 255])
            broken.write_bytes(data)
            try:
                read_records(broken, drive="u")
            except RecordError:
                refused += 1
        data = bytearray((folder / "plain.mat").read_bytes())
        data[177] = 0x7F  # the type of the first numbers
        broken.write_bytes(data)
        try:
            read_records(broken, drive="u")
        except RecordError:
            print(refused)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(tmp_path)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": ""},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert 0 < int(done.stdout) <= 40
