"""Mutated files for every reader, the model grammar of the command line, and all loaders.

    python tests/fuzz/fuzzing.py [--minutes 60] [--mutants N] [--seed 0] [--formats .npy,.mat]

A mutant is a sound file with bytes flipped, cut, doubled or put in place of others, inside the
members of an archive too; one that is refused for a reason that was not seen before is changed in
turn. It must be read or refused: with an exception of the documented family, within ten seconds of
computing, in at most 1 GB, and nothing may be run, sent, written, or read elsewhere. What asks for
more memory is tried again without the limit, for it is often never used. The table counts what
broke that; each case is written to the folder `--keep`, and belongs, once it is mended,
into `tests/fuzz/corpus`, a folder a format, beside a few of those that were refused in a new way.
Each format runs in a process of its own, so that what ends the interpreter is counted too. A seed
makes the same mutants each time.

What a library in C opens or starts, no audit hook sees: `tests/io/test_hostile_files.py` asks
for that with files made for it.
"""

import argparse
import ast
import hashlib
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections import Counter
from contextlib import redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory

from mutation import mutant
from sound import checkpoint, seeds

__all__ = ["CORPUS", "FORMATS", "attack", "main", "run"]

CORPUS = Path(__file__).with_name("corpus")
SECONDS, BYTES = 10, 10**9
_MEMORY = Path("/dev/shm")  # where files cost nothing
_GROWN, _LONGEST = 500, 2**16  # files that are mutated in turn, and bytes of one
_FORBIDDEN = (
    *("os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "subprocess.Popen", "pty."),
    *("socket", "urllib", "ftplib", "http.", "smtplib", "webbrowser", "pickle.find_class"),
    *("os.remove", "os.rename", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"),
    *("os.chmod", "os.chown", "os.utime", "shutil", "tempfile", "ctypes"),
)
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_LIBRARIES = tuple(
    {
        str(Path(path).resolve())
        for path in (*sys.path, *sysconfig.get_paths().values(), "/usr/share/zoneinfo", "/proc")
        if path
    }
)


def _read(path):
    from skhyst.exceptions import RecordError
    from skhyst.records import read_records

    errors = []
    for columns in ({"drive": 0}, {"drive": 1}, {"drive": 2}, {"drive": 1, "time": 0}):
        try:
            read_records(path, **columns)
        except RecordError as error:
            errors.append(error)
    if errors:
        raise max(errors, key=_is_of_memory)


def _parse(path):
    from skhyst.discovery import parse_model

    parse_model(path.read_bytes().decode("utf-8", "replace"))


def _load_json(path):
    from skhyst.persistence import from_json

    from_json(path.read_bytes().decode("utf-8", "replace"))


def _load_skops(path):
    from skhyst.persistence import load_model

    load_model(path)


def _resume(path):
    kept, state = checkpoint(path)
    kept.load(state)


_READERS = (
    *(".csv", ".json", ".npy", ".npz", ".mat", ".h5", ".parquet", ".feather", ".tdms", ".wav"),
    ".xlsx",
)
FORMATS = dict.fromkeys(_READERS, _read) | {
    "model": _parse,
    "model.json": _load_json,
    "model.skops": _load_skops,
    "checkpoint": _resume,
}


def attack(form, path):
    """Give one file to its reader; return what it broke, in words, and why it was refused."""
    broken, reason = [], ""
    _WATCHED[:] = [broken, str(path.parent.resolve())]
    try:
        with redirect_stdout(io.StringIO()):
            FORMATS[form](path)
    except Exception as error:
        _WATCHED.clear()
        reason = _reason(list(_chain(error)))
        if _is_of_memory(error):
            broken.append("memory")
        elif not _is_documented(form, error):
            broken.append(f"{type(error).__name__}: {error}"[:80])
    finally:
        _WATCHED.clear()
    return "; ".join(dict.fromkeys(broken)), reason


def _is_documented(form, error):
    if form not in _READERS:
        return isinstance(error, ValueError)
    from skhyst.exceptions import RecordError

    return isinstance(error, RecordError)


def _chain(error):
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _is_of_memory(error):
    # CPython's parser raises the same for what nests too deeply, whatever the memory.
    return any(
        isinstance(own, MemoryError) and _place(own)[0] != ast.__file__ for own in _chain(error)
    )


def _reason(chain):
    """Return what tells refusals apart: where each was raised, and the words of the first."""
    words = re.sub(r"'.*?'|[^a-z ]", "", str(chain[-1]))[:40]
    return f"{[_place(error) for error in chain]} {words}"


def _place(error):
    """Return the file and the line where an exception was raised."""
    trace = error.__traceback__
    while trace and trace.tb_next:
        trace = trace.tb_next
    return (trace.tb_frame.f_code.co_filename, trace.tb_lineno) if trace else ("", 0)


_WATCHED = []  # of the file that is read: what it did, and the folder that it lies in


def _watch(event, arguments):
    """Note what reading a file must not do; an audit hook, which stays."""
    if not _WATCHED:
        return
    broken, folder = _WATCHED
    if event.startswith(_FORBIDDEN):
        broken.append(event)
    elif event == "exec" and not _is_library(arguments[0].co_filename):
        broken.append(f"runs {arguments[0].co_filename}")
    elif event == "open" and isinstance(arguments[0], (str, bytes)):
        path, _, flags = arguments
        path = os.path.realpath(os.fsdecode(path))
        if flags & _WRITING:
            broken.append(f"writes {path}")
        elif not path.startswith(folder + os.sep) and not _is_library(path):
            broken.append(f"reads {path}")


def _is_library(path):
    if path.startswith("<"):
        return path.startswith("<frozen")
    return os.path.realpath(path).startswith(_LIBRARIES)


def _work(form, folder, seed, first, count, seconds):
    """Attack with mutants; print how many, and a line for each that broke something."""
    path = _warm(form, folder)
    _guard()
    grown = sorted(Path(folder, "grown").iterdir())
    seen = {file.name.partition("-")[2] for file in grown}
    own = [*seeds(form), *map(Path.read_bytes, (*_corpus(form), *grown))]
    end = time.monotonic() + seconds
    for number in range(first, first + count):
        if time.monotonic() > end:
            break
        rng = random.Random(f"{form} {seed} {number}")
        data = mutant(rng.choice(own), own, rng)
        name = _strike(form, path, data, number)
        if name not in seen and len(seen) < _GROWN and len(data) < _LONGEST:
            seen.add(name)
            own.append(data)
            Path(folder, "grown", f"{number:09d}-{name}").write_bytes(data)
    print(json.dumps(["end"]), flush=True)


def _replay(forms, folder):
    """Attack with what is in the corpus."""
    paths = {form: _warm(form, folder) for form in forms}
    _guard()
    for form in forms:
        for file in _corpus(form):
            _strike(form, paths[form], file.read_bytes(), f"{form}: {file.name}")
    print(json.dumps(["end"]), flush=True)


def _warm(form, folder):
    """Import and compile what a format needs; return where its files are put."""
    path = Path(folder, f"rig{form if form[0] == '.' else '.skops'}")
    for data in seeds(form):
        path.write_bytes(data)
        attack(form, path)
    return path


def _in_time(form, path):
    """Attack with a file; what takes too long ends the process."""
    signal.setitimer(signal.ITIMER_PROF, SECONDS)  # of computing
    signal.alarm(10 * SECONDS)  # of waiting
    told = attack(form, path)
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    signal.alarm(0)
    return told


def _in_all_memory(form, path):
    """Return what a file breaks without a limit: what is asked for in vain may never be used."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    Path("/proc/self/clear_refs").write_text("5")  # the peak counts from now on
    before = _peak()
    found, _ = _in_time(form, path)
    resource.setrlimit(resource.RLIMIT_AS, limits)
    found = "" if found == "memory" else found
    return "memory" if _peak() - before > BYTES else found


def _peak():
    """Return the most bytes of real memory so far."""
    (kilobytes,) = re.findall(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())
    return 1024 * int(kilobytes)


def _guard():
    """Watch from now on, and take no more memory than there is leave for."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + BYTES, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sys.addaudithook(_watch)


def _corpus(form):
    return sorted((CORPUS / form.lstrip(".")).glob("*"))


def _strike(form, path, data, number):
    """Attack with one file, print what it broke, and return a short name of the refusal."""
    path.write_bytes(data)
    print(json.dumps(["at", number]), flush=True)
    found, reason = _in_time(form, path)
    if found == "memory":
        found = _in_all_memory(form, path)
    if found:
        print(json.dumps(["broken", number, found]), flush=True)
        Path(path.parent, "broken", str(number)).write_bytes(data)
    return hashlib.sha256(reason.encode()).hexdigest()[:12]


def run(form, seed=0, count=10**9, seconds=3600.0, keep=None, program=__file__):
    """Attack one format from outside; return the mutants and a list of (number, what it broke)."""
    first, broken, end = 0, [], time.monotonic() + seconds
    with TemporaryDirectory(dir=_MEMORY if _MEMORY.is_dir() else None) as folder:
        for name in ("grown", "broken"):
            Path(folder, name).mkdir()
        while first < count and time.monotonic() < end:
            work = [form, folder, seed, first, count - first, end - time.monotonic()]
            call = [sys.executable, str(program), "--work", json.dumps(work)]
            done = subprocess.run(call, capture_output=True, text=True)
            lines = [json.loads(line) for line in done.stdout.splitlines() if line[:2] == '["']
            numbers = [line[1] for line in lines if line[0] == "at"]
            broken += [(line[1], line[2]) for line in lines if line[0] == "broken"]
            if not lines:
                raise RuntimeError(f"The attack on {form} does not begin: {done.stderr[-500:]}")
            first = numbers[-1] + 1 if numbers else count
            if lines[-1][0] == "end":
                break
            hung = done.returncode in (-signal.SIGALRM, -signal.SIGPROF)
            broken.append((numbers[-1], "hang" if hung else f"ends with {done.returncode}"))
            (last,) = Path(folder).glob("rig.*")
            last.rename(Path(folder, "broken", str(numbers[-1])))
        for name in ("grown", "broken") if keep else ():
            shutil.copytree(Path(folder, name), Path(keep, name, form.lstrip(".")))
    return first, broken


def main(arguments=None):
    """Print the table; the exit code is 1 where something was broken."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--minutes", type=float, default=60.0, help="for all formats together")
    add("--mutants", type=int, default=100_000, help="of each format at the most")
    add("--seed", type=int, default=0)
    add("--formats", default=",".join(FORMATS))
    add("--keep", default="fuzz_cases", help="new folder for what is found")
    add("--work", type=json.loads, help=argparse.SUPPRESS)
    add("--replay", metavar="FOLDER", help="attack with the corpus alone; a folder to write to")
    options = parser.parse_args(arguments)
    forms = options.formats.split(",")
    if options.work:
        return _work(*options.work)
    if options.replay:
        return _replay(forms, options.replay)
    if Path(options.keep).exists():
        parser.error(f"{options.keep} is there already: name a new folder with --keep")
    total, end = 0, time.monotonic() + 60.0 * options.minutes
    columns = ("mutants", "exceptions", "hangs", "memory", "died", "acted", "seconds")
    print(f"{'format':12s}" + "".join(f"{name:>11s}" for name in columns), flush=True)
    for k, form in enumerate(forms):
        begin = time.monotonic()
        share = (end - begin) / (len(forms) - k)
        count, broken = run(form, options.seed, options.mutants, share, options.keep)
        kinds = Counter(_kind(told) for _, told in broken)
        numbers = [count, *(kinds[name] for name in columns[1:-1]), round(time.monotonic() - begin)]
        print(f"{form:12s}" + "".join(f"{number:11d}" for number in numbers), flush=True)
        for number, told in broken[:10]:
            print(f"    mutant {number}: {told}")
        total += len(broken)
    return int(total > 0)


def _kind(told):
    """Return the column of the table that a fault belongs to."""
    if told in ("hang", "memory"):
        return {"hang": "hangs"}.get(told, told)
    if told.startswith("ends with"):
        return "died"
    return "exceptions" if re.match(r"\w+: ", told) else "acted"


if __name__ == "__main__":
    sys.exit(main())
