"""Sound files of every format, from which mutants are made."""

import io
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

__all__ = ["checkpoint", "seeds", "sound_files"]

_TEXTS = (
    "t;u\n0;1,5\n1;2,5\n2;-3,25e-1\n# end\n",
    "Rig 7\n\ntime,voltage\ns,V\n0.0,1.5\n0.1,2.5\n0.2,\n",
    '"t"\t"u"\n2024-05-31T12:00:00\t1.5\n2024-05-31T12:00:01\t2.5\n',
    "0,5 1 7\r\n1,25 2 8\r\n",
    "time,u,y\n12:00:00.1,1e3,nan\n12:00:00.2,-9999,2\n",
)
_MODELS = (
    "prandtl_ishlinskii+transfer_function(n_poles=2)",
    "BoucWen(method='differential_evolution', random_state=3)",
    "prandtl_ishlinskii(30, dt=1e-3) + kelvin_voigt",
    "delay(bounds=(0.0, 1), initial_state='zero')+Gain()",
)


def sound_files():
    """Return a sound file of each binary or structured format, of one column u."""
    import h5py
    import nptdms
    import pyarrow
    import pyarrow.feather
    import pyarrow.parquet
    from scipy.io import savemat, wavfile

    values = np.arange(2000.0)
    binary = (".mat", ".npy", ".npz", ".h5", ".parquet", ".feather", ".tdms", ".wav", ".xlsx")
    files = {suffix: io.BytesIO() for suffix in binary}
    savemat(files[".mat"], {"u": values})
    np.save(files[".npy"], values)
    np.savez(files[".npz"], u=values)
    with h5py.File(files[".h5"], "w") as file:
        file["u"] = values
    table = pyarrow.table({"u": values})
    pyarrow.parquet.write_table(table, files[".parquet"])
    pyarrow.feather.write_feather(table, files[".feather"])
    _book({"u": values}).save(files[".xlsx"])
    with nptdms.TdmsWriter(files[".tdms"]) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "u", values)])
    wavfile.write(files[".wav"], 1000, values.astype(np.int16))
    content = {suffix: file.getvalue() for suffix, file in files.items()}
    return content | {".json": json.dumps({"u": values.tolist()}).encode()}


def seeds(form):
    """Return small sound files of a format: a suffix, ``"model"``, ``"model.json"``, ..."""
    return _MAKERS[form]()


def _texts():
    return [text.encode() for text in _TEXTS]


def _models():
    return [text.encode() for text in _MODELS]


def _json():
    t, u = [0.0, 0.1, 0.2], [1, -2.5, None]
    rows = [{"t": a, "u": b, "note": "x"} for a, b in zip(t, u, strict=True)]
    return [json.dumps(content).encode() for content in ({"t": t, "g": {"u": u}}, rows, u)]


def _npy():
    pairs = np.zeros(4, dtype=[("t", "<f8"), ("u", ">i2")])
    return [_saved(np.save, array) for array in (np.arange(20.0), pairs, np.eye(3, order="F"))]


def _npz():
    t, u = np.arange(20.0), np.arange(20, dtype=np.int16)
    return [_saved(write, t=t, u=u) for write in (np.savez, np.savez_compressed)]


def _mat():
    from scipy.io import savemat
    from scipy.sparse import eye_array

    u = np.arange(20.0)
    cells = np.array([np.arange(3.0), "a"], dtype=object)
    more = {"s": {"u": u, "n": np.int16([[1, 2]])}, "c": cells, "e": eye_array(4, format="csc")}
    more |= {"text": "volt", "z": u[:3] + 1j, "flag": np.array([True])}
    return [
        _saved(savemat, {"u": u} | more),
        _saved(savemat, {"u": u} | more, do_compression=True),
        _saved(savemat, {"u": u}, format="4"),
        _hdf5(userblock_size=512)[0],
    ]


def _hdf5(**options):
    import h5py

    file = io.BytesIO()
    with h5py.File(file, "w", **options) as content:
        content["g/u"] = np.arange(20.0)[None, :]
        content["g/u"].attrs["MATLAB_class"] = np.bytes_("double")
        content["g"].attrs["dt"] = 0.1
        content.create_dataset("z", data=np.arange(64, dtype=">i4"), chunks=(16,), compression=4)
        content["names"] = ["a", "b"]
        content["pairs"] = np.zeros(3, dtype=[("t", "f8"), ("u", "f4")])
    return [file.getvalue()]


def _table():
    import pyarrow

    columns = {"t": np.arange(20.0), "u": [1, None] * 10, "note": ["a", "b"] * 10}
    return pyarrow.table(columns | {"at": np.arange(20).astype("M8[ms]")})


def _parquet():
    from pyarrow.parquet import write_table

    return [
        _saved(lambda file, **own: write_table(_table(), file, **own), **options)
        for options in ({"compression": "none"}, {"compression": "zstd", "row_group_size": 7})
    ]


def _feather():
    from pyarrow.feather import write_feather

    return [
        _saved(lambda file, **own: write_feather(_table(), file, **own), **options)
        for options in ({"compression": "uncompressed"}, {"compression": "zstd"})
    ]


def _book(columns):
    """Return a workbook of Excel with names above columns."""
    import openpyxl

    book = openpyxl.Workbook()
    for row in (tuple(columns), *zip(*columns.values(), strict=True)):
        book.active.append(row)
    return book


def _xlsx():
    book = _book({"t": [0.0, 0.1, 0.2], "u": [1, None, -2.5], "note": ["a", "b", "c"]})
    book.create_sheet("second").append(["u", 1.5])
    return [_saved(lambda file: book.save(file))]


def _tdms():
    import nptdms

    said = {"wf_increment": 0.1, "unit_string": "V", "wf_start_time": np.datetime64("2024-05-31")}
    channels = [
        nptdms.ChannelObject("g", "u", np.arange(20.0), properties=said),
        nptdms.ChannelObject("g", "n", np.arange(20, dtype=np.int16)),
        nptdms.ChannelObject("g", "at", np.arange(3).astype("M8[us]")),
        nptdms.ChannelObject("g", "note", ["a", "bc"]),
    ]
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment([nptdms.RootObject({"rig": "7"}), *channels])
        writer.write_segment(channels[:2])
    return [file.getvalue()]


def _wav():
    from scipy.io import wavfile

    samples = (
        np.arange(40, dtype=np.int16).reshape(20, 2),
        np.linspace(-1.0, 1.0, 20, dtype=np.float32),
        np.arange(20, dtype=np.uint8),
    )
    return [_saved(wavfile.write, 1000, own) for own in samples]


def _fitted():
    from skhyst.compose import Cascade
    from skhyst.hysteresis import PrandtlIshlinskii
    from skhyst.linear import FirstOrderLag

    u = np.sin(0.1 * np.arange(100))
    model = PrandtlIshlinskii(3, dt=1e-3).fit(u[:, None], 2.0 * u)
    return [model, Cascade([("play", PrandtlIshlinskii(2)), ("lag", FirstOrderLag())])]


def _model_json():
    from skhyst.persistence import to_json

    return [to_json(model).encode() for model in _fitted()]


def _model_skops():
    from skhyst.persistence import save_model

    with TemporaryDirectory() as folder:
        path = Path(folder, "model.skops")
        save_model(_fitted()[0], path)
        return [path.read_bytes()]


def checkpoint(path):
    """Return a checkpoint at a path, and a state as searches have them, but small."""
    from skhyst.diagnosis import EffectSearchCV, _checkpoint
    from skhyst.linear import Gain, GainOperator

    search = EffectSearchCV(Gain(), random_state=0)
    state = {"base": GainOperator(2.0, 1.0), "history": [{"effect": "lag", "p": 0.001}]}
    state |= {"effects": ["lag"], "number": 1, "residual": np.arange(3.0)}
    return _checkpoint.Checkpoint(path, search, np.arange(5.0)), state


def _checkpoints():
    with TemporaryDirectory() as folder:
        path = Path(folder, "search.skops")
        kept, state = checkpoint(path)
        kept.save(state)
        return [path.read_bytes()]


def _saved(write, *arguments, **options):
    """Return the bytes that a function writes into a file, its first argument."""
    file = io.BytesIO()
    write(file, *arguments, **options)
    return file.getvalue()


_MAKERS = {
    ".csv": _texts,
    ".json": _json,
    ".npy": _npy,
    ".npz": _npz,
    ".mat": _mat,
    ".h5": _hdf5,
    ".parquet": _parquet,
    ".feather": _feather,
    ".xlsx": _xlsx,
    ".tdms": _tdms,
    ".wav": _wav,
    "model": _models,
    "model.json": _model_json,
    "model.skops": _model_skops,
    "checkpoint": _checkpoints,
}
