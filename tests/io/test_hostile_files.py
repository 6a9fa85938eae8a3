"""Broken and hostile files: every one is refused by name, and none is executed."""

import io
import json
import os
import pickle
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
from scipy.io import savemat
from scipy.io.matlab import MatlabFunction, MatlabOpaque
from sound import sound_files

from skhyst.exceptions import RecordError
from skhyst.io._formats import _held
from skhyst.records import read_records

SUFFIXES = [
    *(".csv", ".txt", ".tsv", ".dat", ".mat", ".npy", ".npz"),
    *(".json", ".h5", ".hdf5", ".parquet", ".feather", ".tdms", ".wav", ".xlsx"),
]
GARBAGE = np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes()


class Trap:
    """Creates a file where it is unpickled."""

    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return os.mkdir, (str(self.marker),)


WHOLE = sound_files()


def written(folder, suffix, content):
    """Return the path of a new file."""
    path = folder / f"rig{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refused(path, drive=0, **options):
    with pytest.raises(RecordError) as error:
        read_records(path, drive=drive, **options)
    assert path.name in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "content",
    [b"", GARBAGE, b"\x00" * 300, b"\x80\x04K\x01."],
    ids=["empty", "random", "zeros", "pickle"],
)
def test_what_is_no_recording_is_refused(tmp_path, suffix, content):
    refused(written(tmp_path, suffix, content))


@pytest.mark.parametrize("suffix", WHOLE)
def test_sound_files_are_read_and_truncated_ones_refused(tmp_path, suffix):
    path = written(tmp_path, suffix, WHOLE[suffix])
    np.testing.assert_array_equal(read_records(path, drive=0)[0].iloc[:, 0], np.arange(2000.0))
    for part in (0.02, 0.3, 0.9) if suffix != ".tdms" else ():  # of TDMS what is whole is read
        refused(written(tmp_path, suffix, WHOLE[suffix][: int(part * len(WHOLE[suffix]))]))


def test_pickles_in_npy_and_npz_are_not_executed(tmp_path):
    marker = tmp_path / "executed"
    objects = np.array([Trap(marker), 1.0], dtype=object)
    np.save(tmp_path / "a.npy", objects, allow_pickle=True)
    np.savez(tmp_path / "a.npz", allow_pickle=True, u=objects, v=np.arange(3.0))
    for name, drive in (("a.npy", 0), ("a.npz", "u")):
        assert "pickle" in refused(tmp_path / name, drive)
        assert not marker.exists()
    assert len(read_records(tmp_path / "a.npz", drive="v")[0]) == 3
    np.load(tmp_path / "a.npy", allow_pickle=True)
    assert marker.exists()  # the trap does work


def test_a_pickle_with_a_false_suffix_is_not_executed(tmp_path):
    marker = tmp_path / "executed"
    for suffix in SUFFIXES:
        for protocol in (0, pickle.DEFAULT_PROTOCOL):
            refused(written(tmp_path, suffix, pickle.dumps(Trap(marker), protocol=protocol)), "u")
    assert not marker.exists()


@pytest.fixture
def little_memory():
    """Memory of 512 MiB more than there is now, beyond which any allocation fails."""
    resource = pytest.importorskip("resource")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    old = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**29, old[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, old)


def array_header(descr, shape, version=1):
    """The header of an array in NumPy's format, with 80 bytes behind it."""
    file = io.BytesIO()
    write = getattr(np.lib.format, f"write_array_header_{version}_0")
    write(file, {"descr": descr, "fortran_order": False, "shape": shape})
    return file.getvalue() + b"\x00" * 80


@pytest.mark.parametrize(
    ("descr", "shape"),
    [
        ("<f8", (3 * 10**9,)),  # 22 GiB
        ("<f8", (10**13,)),
        ("<f8", (10**30,)),
        ("|V0", (3 * 10**9,)),  # elements without bytes
        ("<U0", (3 * 10**9,)),
        ([("u", "<f8", (10**8,))], (1,)),
        ("<f8", (-1, -(10**9))),
    ],
)
@pytest.mark.parametrize("version", [1, 2])
def test_a_huge_shape_in_a_header_is_refused_before_memory_is_taken(
    tmp_path, little_memory, descr, shape, version
):
    content = array_header(descr, shape, version)
    assert "declares" in refused(written(tmp_path, ".npy", content))
    path = tmp_path / "rig.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("u.npy", content)
    assert "declares" in refused(path, "u")


def test_a_header_as_long_as_the_memory_is_refused(tmp_path, little_memory):
    refused(written(tmp_path, ".npy", b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + b" " * 80))


def test_datasets_without_readings_are_refused_before_memory_is_taken(tmp_path, little_memory):
    path = tmp_path / "rig.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("u", (3 * 10**9,), "f8", chunks=(1000,))
        file["y"] = np.arange(5.0)
    assert "larger than the data stored in the file" in refused(path, "u")
    assert len(read_records(path, drive="y")[0]) == 5


def test_tables_of_more_rows_than_a_file_can_hold_are_refused(tmp_path, little_memory):
    import pyarrow
    import pyarrow.feather
    import pyarrow.parquet

    rows = pyarrow.table({"u": pyarrow.chunked_array([np.zeros(10**6)] * 10)})
    pyarrow.parquet.write_table(rows, tmp_path / "rig.parquet", compression="zstd")
    pyarrow.feather.write_feather(rows, tmp_path / "rig.feather", compression="zstd")
    for suffix in (".parquet", ".feather"):
        assert "declares" in refused(tmp_path / f"rig{suffix}", "u")
    text = json.dumps([{f"n{i}": 1} for i in range(20_000)])
    assert "share few" in refused(written(tmp_path, ".json", text), "n0")


ZEROS = bytes(10**7)  # of which 26 are more than any small file may unpack to


def packed_npz(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        header = array_header("<f8", (26, 1_250_000))[:-80]
        with archive.open("u.npy", "w", force_zip64=True) as entry:
            entry.write(header)
            for _ in range(26):
                entry.write(ZEROS)


def packed_mat(path):
    deflater = zlib.compressobj(1)
    content = b"".join(deflater.compress(ZEROS) for _ in range(26)) + deflater.flush()
    tag = (15).to_bytes(4, "little") + len(content).to_bytes(4, "little")
    path.write_bytes(b"MATLAB 5.0".ljust(124) + b"\x00\x01IM" + tag + content)


def packed_hdf5(path):
    chunk = zlib.compress(ZEROS)
    with h5py.File(path, "w") as file:
        data = file.create_dataset(
            "u", (26 * 1_250_000,), "f8", chunks=(1_250_000,), compression="gzip"
        )
        for k in range(26):
            data.id.write_direct_chunk((k * 1_250_000,), chunk)


@pytest.mark.parametrize(
    ("suffix", "pack"), [(".npz", packed_npz), (".mat", packed_mat), (".h5", packed_hdf5)]
)
def test_what_unpacks_to_much_more_is_refused(tmp_path, little_memory, suffix, pack):
    """As dense as its compression can be, so that only the sum tells."""
    pack(tmp_path / f"rig{suffix}")
    assert (tmp_path / f"rig{suffix}").stat().st_size > 260e6 / 1032
    told = refused(tmp_path / f"rig{suffix}", "u")
    assert any(reason in told for reason in ("declares", "too long", "larger than the data"))


def test_an_archive_whose_entries_share_their_bytes_is_refused(tmp_path):
    path = tmp_path / "rig.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("u.npy", array_header("<f8", (10,)))
        archive.filelist *= 3
    assert "overlap" in refused(path, "u")


@pytest.mark.parametrize("suffix", [".parquet", ".feather"])
def test_columns_together_are_refused_by_what_they_declare(tmp_path, little_memory, suffix):
    """Each alone is within what the file can be expanded to."""
    import pyarrow
    import pyarrow.feather
    import pyarrow.parquet

    path, zeros = tmp_path / f"rig{suffix}", np.zeros(10**5)
    write = {".parquet": pyarrow.parquet.write_table, ".feather": pyarrow.feather.write_feather}
    write[suffix](pyarrow.table({f"u{k}": zeros for k in range(200)}), path, compression="zstd")
    assert 1032 * path.stat().st_size > zeros.nbytes
    assert f"declares {200 * zeros.nbytes}" in refused(path, "u0")


def test_a_long_text_that_is_repeated_is_refused(tmp_path, little_memory):
    """1 GB of text, of which the file has 10 kB."""
    import pyarrow
    import pyarrow.parquet

    long, which = "x" * 10**4, np.repeat([0, 1], 50_000)
    names = pyarrow.DictionaryArray.from_arrays(pyarrow.array(which), [long, "b"])
    table = pyarrow.table({"u": np.arange(1e5), "run": names, "l": [[1.0]] * 10**5})
    path = tmp_path / "rig.parquet"
    pyarrow.parquet.write_table(table, path, store_schema=False)
    assert len(read_records(path, drive="u")[0]) == 10**5
    assert "the text in 'run' declares 500050000 bytes" in refused(path, "u", record="run")
    assert "lists or structs" in refused(path, "l")


@pytest.mark.parametrize("kept", [True, False])
def test_cells_of_text_that_are_missing(tmp_path, kept):
    import pyarrow
    import pyarrow.feather
    import pyarrow.parquet

    text = pyarrow.array(["1.5", None, "2.5"])
    for column in (text, text.dictionary_encode(), pyarrow.array([1.5, None, 2.5])):
        table = pyarrow.table({"u": column})
        pyarrow.parquet.write_table(table, tmp_path / "rig.parquet", store_schema=kept)
        pyarrow.feather.write_feather(table, tmp_path / "rig.feather")
        for name in ("rig.parquet", "rig.feather"):
            X = read_records(tmp_path / name, drive="u", on_missing="interpolate")[0]
            assert X["u"].tolist() == [1.5, 2.0, 2.5]


def test_a_workbook_of_few_cells_far_apart_is_refused(tmp_path, little_memory):
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = 1, 2
    book.save(tmp_path / "rig.xlsx")
    assert "spreads few cells" in refused(tmp_path / "rig.xlsx")


@pytest.mark.parametrize("bomb", ["dense", "overlapping", "entities"])
def test_a_workbook_that_unpacks_to_much_more_is_refused(tmp_path, little_memory, bomb):
    path = written(tmp_path, ".xlsx", WHOLE[".xlsx"])
    with zipfile.ZipFile(path) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    sheet = "xl/worksheets/sheet1.xml"
    rows = content[sheet].replace(b"<v>1</v>", b"<v>1" + 2**24 * b" " + b"</v>")
    entities = "".join(f'<!ENTITY e{i + 1} "{10 * f"&e{i};"}">' for i in range(9)).encode()
    entities = b'<!DOCTYPE w [<!ENTITY e0 "0123456789">' + entities + b"]>"
    content[sheet] = {
        "dense": rows,
        "overlapping": content[sheet],
        "entities": entities + content[sheet].replace(b"<v>1</v>", b"<v>&e9;</v>"),
    }[bomb]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            archive.writestr(name, data)
        if bomb == "overlapping":
            archive.filelist *= 3
    refused(path)


def test_a_channel_that_declares_more_is_read_as_far_as_it_goes(tmp_path, little_memory):
    content = WHOLE[".tdms"]
    length = (2000).to_bytes(8, "little")
    assert content.count(length) == 1
    huge = content.replace(length, (3 * 10**9).to_bytes(8, "little"))
    assert len(read_records(written(tmp_path, ".tdms", huge), drive="u")[0]) == 2000


def test_columns_of_a_huge_empty_matrix_are_not_listed(tmp_path, little_memory):
    head = np.array([0, 0, 2 * 10**9, 0, 2], dtype="<i4").tobytes()  # version 4: 0 x 2e9 doubles
    refused(written(tmp_path, ".mat", head + b"u\x00"))


def test_matlab_functions_and_objects_are_refused_and_the_rest_is_read(tmp_path):
    for kind, message in ((MatlabFunction, "function handle"), (MatlabOpaque, "MATLAB object")):
        (variable,) = _held("f", np.zeros((1, 1)).view(kind))
        assert message in variable.refused
    path = tmp_path / "rig.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["u"] = np.arange(5.0)[None, :]
        file["f"] = np.zeros((1, 6), dtype=np.uint32)
        file["f"].attrs["MATLAB_class"] = np.bytes_("function_handle")
        file["o"] = np.zeros((1, 6), dtype=np.uint32)
        file["o"].attrs["MATLAB_object_decode"] = 3
    assert "a MATLAB function handle" in refused(path, "f")
    assert "a MATLAB object" in refused(path, "o")
    assert len(read_records(path, drive="u")[0]) == 5


@pytest.mark.parametrize(
    ("kind", "line"),
    [("timetable", "writetimetable"), ("iddata", "x.SamplingInstants"), ("rig", "struct(x)")],
)
def test_a_matlab_object_is_refused_with_the_line_that_exports_it(tmp_path, kind, line):
    fields = (b"o", b"MCOS", kind.encode(), np.zeros(6, dtype=np.uint32))
    opaque = np.array([fields], dtype=[(name, "O") for name in ("s0", "s1", "s2", "arr")])
    (variable,) = _held("None", opaque.view(MatlabOpaque))
    assert (variable.name, variable.refused.startswith(f"a MATLAB {kind} ")) == ("o", True)
    path = tmp_path / "rig.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["o"] = np.zeros((1, 6), dtype=np.uint32)
        file["o"].attrs["MATLAB_class"] = np.bytes_(kind)
        file["o"].attrs["MATLAB_object_decode"] = 3
    assert line in refused(path, "o")
    assert line in variable.refused


def test_matlab_cells_and_text(tmp_path):
    path = tmp_path / "rig.mat"
    cells = np.array([np.arange(3.0), np.arange(4.0)], dtype=object)
    savemat(path, {"c": cells, "note": "abc"})
    assert len(read_records(path, drive="c[1]")[0]) == 4
    refused(path, "c")
    refused(path, "note")


def test_hdf5_does_not_reach_into_other_files(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["u"] = np.arange(5.0)
    (tmp_path / "raw.bin").write_bytes(np.arange(5.0).tobytes())
    path = tmp_path / "rig.h5"
    with h5py.File(path, "w") as file:
        file["own"] = np.arange(5.0)
        file["link"] = h5py.ExternalLink("secret.h5", "u")
        external = [(str(tmp_path / "raw.bin"), 0, 40)]
        file.create_dataset("outside", (5,), "f8", external=external)
        layout = h5py.VirtualLayout((5,), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "secret.h5"), "u", shape=(5,))
        file.create_virtual_dataset("virtual", layout)
    for name in ("link", "outside", "virtual"):
        refused(path, name)
    assert len(read_records(path, drive="own")[0]) == 5


@pytest.mark.parametrize(
    "text",
    [
        "[" * 200_000,
        '{"u": [1, 2, [3]]}',
        '{"u": [1, "x", 3]}',
        '{"u": [1e999, 2, 3]}',
        '{"u": [1' + "0" * 400 + ", 2]}",
        '{"u": [true, null, {}]}',
        '{"u": "text"}',
        "3",
        "null",
        "[]",
        "{}",
        '[{"u": 1}, {"v": 2}]',
        '{"u": [1, 2}',
    ],
    ids=lambda text: text[:12],
)
def test_json_that_is_no_recording(tmp_path, text):
    refused(written(tmp_path, ".json", text), "u")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("u,y\n1,2\n3,oops\n5,6\n7,8\n9,1\n2,2\n", "Got 'oops' in row 1"),
        (
            "only words\nand more words\n",
            "no row of numbers between separators, each without its unit. It begins with 'only",
        ),
        ("\n\n \n", ""),
        ("u,u\n1,2\n3,4\n", "2 columns that 'u' may mean, at the positions 0, 1"),
        ('u,y\n1,"2\n3,4\n', ""),
        ("u,y\n1,2\n3,4,5,6\n5,6\n", ""),
        ("u,y\n1.0,2.0\n2.0,3.0\n3.0,", "y: 1 row(s) (2)"),
    ],
    ids=["word", "words", "blank", "duplicate", "quote", "ragged", "truncated"],
)
def test_texts_that_are_no_table(tmp_path, text, message):
    assert message in refused(written(tmp_path, ".csv", text), "u", response=1)


@pytest.mark.parametrize(
    ("content", "drive", "response"),
    [
        (b"u,u\n0.5,1.25\n1.5,2.25\n", 0, 1),
        ("V (°);µm\n0,5;1,25\n1,5;2,25\n".encode("latin-1"), "V (°)", "µm"),
        ("u,y\n0.5,1.25\n1.5,2.25\n".encode("utf-16-le"), "u", "y"),
    ],
    ids=["repeated", "not UTF-8", "no byte order mark"],
)
def test_unusual_names(tmp_path, content, drive, response):
    X, y = read_records(written(tmp_path, ".csv", content), drive=drive, response=response)
    assert (X.iloc[:, 0].tolist(), y.tolist()) == ([0.5, 1.5], [1.25, 2.25])


@pytest.mark.parametrize("unit", [5e-324, 1e-300, 1e-12, 1e12, 1e300])
@pytest.mark.parametrize("suffix", [".csv", ".mat", ".npz", ".json"])
def test_tiny_and_huge_units_survive(tmp_path, unit, suffix):
    path = tmp_path / f"rig{suffix}"
    values = unit * np.array([1.0, -2.0, 3.0, 0.0, 7.0])
    {
        ".csv": lambda: np.savetxt(path, values, header="u", fmt="%.17g", comments=""),
        ".mat": lambda: savemat(path, {"u": values}),
        ".npz": lambda: np.savez(path, u=values),
        ".json": lambda: path.write_text(json.dumps({"u": values.tolist()})),
    }[suffix]()
    np.testing.assert_allclose(read_records(path, drive="u")[0]["u"], values, rtol=1e-14)


def test_complex_and_text_columns_are_refused(tmp_path):
    path = tmp_path / "rig.npz"
    np.savez(path, c=np.array([1j, 2.0]), s=np.array(["a", "b"]), none=np.zeros(0))
    assert "real numbers" in refused(path, "c")
    assert "Got 'a' in row 0" in refused(path, "s")
    refused(path, "none")


def test_an_archive_of_other_things(tmp_path):
    path = tmp_path / "rig.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../etc/passwd", "root")
    refused(path)


def test_paths_that_are_no_files(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        read_records(tmp_path / "none.csv", drive="u")
    for name, remedy in (
        ("rig.pkl", ""),
        ("rig", ""),
        ("rig.mf4", "asammdf"),
        ("a.xls", r"\.xlsx"),
    ):
        (tmp_path / name).write_text("u\n1\n")
        with pytest.raises(RecordError, match=rf"must end in one of \.csv.* Got '{name}.*{remedy}"):
            read_records(tmp_path / name, drive="u")
