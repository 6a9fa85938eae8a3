"""Mutated files for every reader, the model grammar of the command line, and the model loader.

    python tests/fuzz/fuzzing.py [--minutes 60] [--mutants N] [--seed 0] [--formats .npy,.mat]

A mutant is a sound file with bytes flipped, cut, doubled or put in place of others, inside the
members of an archive too. It must be read or refused: with an exception of the documented family,
within ten seconds, in at most 1 GB, and nothing may be run, sent, or written elsewhere. The table
counts what broke that; each case is written to the folder `--keep`, and belongs, once it is mended,
into `tests/fuzz/corpus`, a folder a format. Each format runs in a process of its own, so that what
ends the interpreter is counted too. Mutant n of a seed is always the same.
"""

import argparse
import hashlib
import io
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
import zipfile
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

__all__ = ["CORPUS", "FORMATS", "attack", "seeds", "sound_files"]

CORPUS = Path(__file__).with_name("corpus")
_SECONDS, _BYTES = 10, 10**9
_FORBIDDEN = ("os.system", "os.exec", "os.posix_spawn", "os.spawn", "subprocess.Popen", "socket")
_INTEGERS = (0, 1, 2**7, 2**8 - 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**60, 2**63 - 1, 2**64 - 1)
_TEXTS = (
    "t;u\n0;1,5\n1;2,5\n2;-3,25e-1\n# end\n",
    "Rig 7\n\ntime,voltage\ns,V\n0.0,1.5\n0.1,2.5\n0.2,\n",
    '"t"\t"u"\n2024-05-31T12:00:00\t1.5\n2024-05-31T12:00:01\t2.5\n',
)
_MODELS = (
    "prandtl_ishlinskii+transfer_function(n_poles=2)",
    "BoucWen(method='differential_evolution', random_state=3)",
    "prandtl_ishlinskii(30, dt=1e-3) + kelvin_voigt",
)


def sound_files():
    """Return a sound file of each binary or structured format, of one column u."""
    import h5py
    import nptdms
    import openpyxl
    import pyarrow
    import pyarrow.feather
    import pyarrow.parquet
    from scipy.io import savemat

    values = np.arange(2000.0)
    binary = (".mat", ".npy", ".npz", ".h5", ".parquet", ".feather", ".tdms", ".xlsx")
    files = {suffix: io.BytesIO() for suffix in binary}
    savemat(files[".mat"], {"u": values})
    np.save(files[".npy"], values)
    np.savez(files[".npz"], u=values)
    with h5py.File(files[".h5"], "w") as file:
        file["u"] = values
    table = pyarrow.table({"u": values})
    pyarrow.parquet.write_table(table, files[".parquet"])
    pyarrow.feather.write_feather(table, files[".feather"])
    book = openpyxl.Workbook()
    for value in ("u", *values):
        book.active.append([value])
    book.save(files[".xlsx"])
    with nptdms.TdmsWriter(files[".tdms"]) as writer:
        writer.write_segment([nptdms.ChannelObject("g", "u", values)])
    content = {suffix: file.getvalue() for suffix, file in files.items()}
    return content | {".json": json.dumps({"u": values.tolist()}).encode()}


def seeds(form):
    """Return what is mutated for a format: a suffix of a recording, ``"model"``, ``".skops"``."""
    if form == "model":
        return [text.encode() for text in _MODELS]
    if form == ".csv":
        return [text.encode() for text in _TEXTS]
    if form == ".skops":
        return [_model_file()]
    found = [sound_files()[form]]
    if form == ".mat":
        from scipy.io import savemat

        for more in ({"do_compression": True}, {"format": "4"}):
            file = io.BytesIO()
            cells = {} if "format" in more else {"c": np.array([np.arange(3.0), "a"], dtype=object)}
            savemat(file, {"u": np.arange(20.0), **cells}, **more)
            found.append(file.getvalue())
    return found


def _model_file():
    from skhyst.hysteresis import PrandtlIshlinskii
    from skhyst.persistence import save_model

    u = np.sin(0.1 * np.arange(100))
    with TemporaryDirectory() as folder:
        path = Path(folder, "model.skops")
        save_model(PrandtlIshlinskii(3, dt=1e-3).fit(u[:, None], 2.0 * u), path)
        return path.read_bytes()


def mutant(data, others, rng):
    """Return a changed copy of a file; an archive is changed inside, every other time."""
    if data[:2] == b"PK" and rng.random() < 0.5:
        return _inside(data, rng)
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(data) + 1)
        length = rng.choice((1, 1, 2, 4, 8, 64))
        _EDITS[rng.randrange(len(_EDITS))](data, at, length, others, rng)
    return bytes(data)


def _flip(data, at, length, others, rng):
    for i in range(at, min(at + length, len(data))):
        data[i] ^= 1 << rng.randrange(8)


def _number(data, at, length, others, rng):
    size = rng.choice((2, 4, 8))
    value = rng.choice(_INTEGERS) % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))


def _cut(data, at, length, others, rng):
    del data[at : at + length if rng.random() < 0.9 else len(data)]


def _double(data, at, length, others, rng):
    data[at:at] = data[at : at + length] * rng.choice((1, 1, 100))


def _put(data, at, length, others, rng):
    data[at:at] = rng.randbytes(length)


def _splice(data, at, length, others, rng):
    other = rng.choice(others)
    start = rng.randrange(len(other) + 1)
    data[at : at + length] = other[start : start + length]


_EDITS = (_flip, _flip, _number, _number, _cut, _double, _put, _splice)


def _inside(data, rng):
    """Change one member of an archive, which stays an archive."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        names = old.namelist()
        chosen = rng.choice(names)
        for name in names:
            content = old.read(name)
            new.writestr(name, mutant(content, [content], rng) if name == chosen else content)
    return out.getvalue()


def _read(path):
    from skhyst.records import read_records

    read_records(path, drive=0)


def _parse(path):
    from skhyst.discovery import parse_model

    parse_model(path.read_bytes().decode("utf-8", "replace"))


def _load(path):
    from skhyst.persistence import load_model

    load_model(path)


_READERS = (".csv", ".json", ".npy", ".npz", ".mat", ".h5", ".parquet", ".tdms")
FORMATS = dict.fromkeys(_READERS, _read) | {"model": _parse, ".skops": _load}


def attack(form, path):
    """Give one file to its reader; return what it broke, in words, or an empty text."""
    broken = []
    _WATCHED[:] = [broken, path.parent]
    try:
        with redirect_stdout(io.StringIO()):
            FORMATS[form](path)
    except (ValueError, ImportError) as error:  # RecordError is a ValueError
        if isinstance(error.__cause__, MemoryError):
            broken.append("memory")
    except MemoryError:
        broken.append("memory")
    except Exception as error:
        broken.append(f"{type(error).__name__}: {error}"[:80])
    finally:
        _WATCHED.clear()
    return "; ".join(broken)


_WATCHED = []  # of the file that is read: what it did, and the folder that it may write to


def _watch(event, arguments):
    """Note what reading a file must not do; an audit hook, which stays."""
    if not _WATCHED:
        return
    if event.startswith(_FORBIDDEN) or event == "pickle.find_class":
        _WATCHED[0].append(event)
    elif event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        _WATCHED[0].append(f"writes {arguments[0]}")


def _work(form, seed, first, count, seconds, keep):
    """Run mutants; print how many, and a line for each that broke something."""
    own = seeds(form)
    rng = random.Random(f"warm {seed}")
    with TemporaryDirectory() as folder:
        path = Path(folder, f"rig{form if form[0] == '.' else '.txt'}")
        path.write_bytes(own[0])
        attack(form, path)  # imports and compiles what there is
        sys.addaudithook(_watch)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + _BYTES, resource.RLIM_INFINITY))
        end = time.monotonic() + seconds
        for number in range(first, first + count):
            if time.monotonic() > end:
                break
            rng = random.Random(f"{form} {seed} {number}")
            data = mutant(rng.choice(own), own, rng)
            path.write_bytes(data)
            print(json.dumps(["at", number]), flush=True)
            signal.alarm(_SECONDS)  # its default action ends the process
            found = attack(form, path)
            signal.alarm(0)
            if found:
                _keep(keep, form, data)
                print(json.dumps(["broken", number, found]), flush=True)
    print(json.dumps(["end"]), flush=True)


def _keep(keep, form, data):
    if keep:
        folder = Path(keep, form.lstrip("."))
        folder.mkdir(parents=True, exist_ok=True)
        (folder / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data)


def run(form, seed=0, count=10**9, seconds=3600.0, keep=None):
    """Attack one format from outside; return the mutants and a list of (number, what it broke)."""
    first, broken, end = 0, [], time.monotonic() + seconds
    while first < count and time.monotonic() < end:
        left = [seed, first, count - first, end - time.monotonic(), str(keep or "")]
        call = [sys.executable, __file__, "--work", json.dumps([form, *left])]
        done = subprocess.run(call, capture_output=True, text=True, env=os.environ)
        lines = [json.loads(line) for line in done.stdout.splitlines() if line[:1] == "["]
        numbers = [line[1] for line in lines if line[0] == "at"]
        broken += [(line[1], line[2]) for line in lines if line[0] == "broken"]
        if not numbers:
            if lines:
                break  # no time was left
            raise RuntimeError(f"The attack on {form} does not begin: {done.stderr[-500:]}")
        first = numbers[-1] + 1
        if lines[-1][0] == "end":
            break
        hung = done.returncode == -signal.SIGALRM
        broken.append((numbers[-1], "hang" if hung else f"ends with {done.returncode}"))
    return first, broken


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--minutes", type=float, default=60.0, help="for all formats together")
    add("--mutants", type=int, default=100_000, help="of each format at the most")
    add("--seed", type=int, default=0)
    add("--formats", default=",".join(FORMATS))
    add("--keep", default="fuzz_cases", help="folder for what is found")
    add("--work", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.work:
        return _work(*json.loads(options.work))
    forms, total = options.formats.split(","), 0
    print(
        f"{'format':9s}{'mutants':>9s}{'exceptions':>11s}{'hangs':>7s}{'memory':>8s}{'other':>7s}"
    )
    for form in forms:
        seconds = 60.0 * options.minutes / len(forms)
        count, broken = run(form, options.seed, options.mutants, seconds, options.keep)
        kinds = [kind for _, kind in broken]
        memory, hangs = kinds.count("memory"), kinds.count("hang")
        exceptions = sum(": " in kind for kind in kinds)
        other = len(kinds) - memory - hangs - exceptions
        print(f"{form:9s}{count:9d}{exceptions:11d}{hangs:7d}{memory:8d}{other:7d}", flush=True)
        for number, kind in broken[:10]:
            print(f"    mutant {number}: {kind}")
        total += len(broken)
    return int(total > 0)


if __name__ == "__main__":
    sys.exit(main())
