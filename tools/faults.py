"""Whether the tests notice faults: `python tools/faults.py [--drawn 64] [--seed 0]`.

Copies the package and its tests to a temporary folder, puts one fault of ``fault_table`` in at a
time, and runs the tests that should notice it. A fault is killed if one of these fails, or if they
do not come to an end, and the one that fails passes without the fault. Numba's cache does not see
what a compiled loop calls, so with a fault in a file of loops everything is compiled anew. With
``--drawn`` so many ``mutants`` take the place of the table.

Limits: at least 90 % of the faults are killed, in all and in each area.
"""

import argparse
import multiprocessing
import os
import re
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import numba
import pytest
from fault_table import FAULTS
from mutants import draw_mutants

ROOT = Path(__file__).resolve().parents[1]
LEAST = 0.9  # part of the faults that tests notice
LIMIT = 100  # s of processor time of the tests of one fault, however busy the machine is
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["numba", "pandas", "pytest", "scipy.signal", "sklearn.ensemble"])


def sources(root):
    """Return the files of the package and what they say."""
    return {path: path.read_text() for path in sorted((root / "skhyst").rglob("*.py"))}


def places(fault, texts):
    """Return the files in which a fault can be put, once for each place."""
    return [path for path, text in texts.items() for _ in range(text.count(fault.original))]


class Laboratory:
    """A copy of the package and its tests, in which one fault at a time is tried."""

    def __init__(self, root, folder):
        self.root, self.cache, self._clean = folder / "copy", folder / "cache", {}
        self.root.mkdir()
        for name in ("skhyst", "tests", "benchmarks", "tools", "docs"):
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(root / name, self.root / name, ignore=ignored)
        shutil.copy(root / "pyproject.toml", self.root)
        self.texts = sources(self.root)

    def judge(self, fault):
        """Return what became of a fault and the seconds that its tests took."""
        found = places(fault, self.texts)
        if len(found) != 1:
            return "not found" if not found else f"found {len(found)} times", 0.0
        tests = self._arguments(fault.tests)
        if tests is None:
            return "no tests", 0.0
        (path,) = found
        text = self.texts[path]
        path.write_text(text.replace(fault.original, fault.faulty))
        with tempfile.TemporaryDirectory() as empty:
            compiled = "jit" in text or "step=" in text
            outcome, seconds, failed = self._run(tests, Path(empty) if compiled else self.cache)
        path.write_text(text)
        if outcome == "killed":
            alone = (failed,) if failed else tests
            if alone not in self._clean:
                self._clean[alone] = self._run(alone, self.cache)[0]
            if self._clean[alone] != "survived":
                outcome = "fails without it"
        return outcome, seconds

    def _arguments(self, tests):
        """Return the arguments of pytest, patterns replaced by paths; None without a path."""
        found, n_paths = [], 0
        for word in shlex.split(tests):
            if not word.startswith("tests/"):
                found.append(word)
                continue
            paths = sorted(str(path.relative_to(self.root)) for path in self.root.glob(word))
            n_paths += len(paths)
            found += paths
        return tuple(found) if n_paths else None

    def _run(self, tests, cache):
        """Run tests; return what became of the fault, the seconds, and the test that failed."""
        output = self.root.parent / "output"
        begin = time.perf_counter()
        process = _SERVER.Process(target=_test, args=(self.root, cache, tests, output))
        process.start()
        process.join()
        seconds = time.perf_counter() - begin
        if process.exitcode == -signal.SIGXCPU:
            return "killed", seconds, None
        said = output.read_text()
        # what cannot be imported or selects no test tells nothing
        broken = "ERROR collecting" in said or process.exitcode in (2, 3, 4, 5)
        outcome = "broken" if broken else "killed" if process.exitcode else "survived"
        failed = re.search(r"^(?:FAILED|ERROR) (tests/.*?)(?: - |$)", said, re.MULTILINE)
        return outcome, seconds, failed and failed[1]


def _test(root, cache, tests, output):
    """Run tests of a copy of the project in a process of their own."""
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 9))  # told, then ended
    os.chdir(root)
    sys.path.insert(0, str(root))
    sys.dont_write_bytecode = True  # it would be trusted within one second
    numba.config.CACHE_DIR = str(cache)
    with output.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    sys.exit(int(pytest.main([*options, *tests])))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", help="part of the names of faults to try")
    parser.add_argument("--area", action="append", help="an area to try")
    parser.add_argument("--drawn", type=int, help="as many mutants, in place of the table")
    parser.add_argument("--seed", type=int, default=0, help="of the mutants that are drawn")
    parser.add_argument("--root", type=Path, default=ROOT, help="checkout to put faults in")
    options = parser.parse_args()
    root, faults = options.root.resolve(), FAULTS
    if options.drawn:
        faults = draw_mutants(sources(root), options.drawn, options.seed)
    faults = [
        fault
        for fault in faults
        if any(part in fault.name for part in options.only or [""])
        and fault.area in (options.area or [fault.area])
    ]
    killed, tried = {}, {}
    with tempfile.TemporaryDirectory() as folder:
        laboratory = Laboratory(root, Path(folder))
        for fault in faults:
            outcome, seconds = laboratory.judge(fault)
            print(f"{fault.area:13} {outcome:10} {seconds:6.1f} s  {fault.name}", flush=True)
            if outcome in ("killed", "survived"):
                tried[fault.area] = tried.get(fault.area, 0) + 1
                killed[fault.area] = killed.get(fault.area, 0) + (outcome == "killed")
    tried["all"], killed["all"] = sum(tried.values()), sum(killed.values())
    print()
    for area, count in tried.items():
        print(f"{area:13} {killed[area]} of {count} killed, {killed[area] / max(count, 1):.0%}")
    return int(any(killed[area] < LEAST * count for area, count in tried.items()))


if __name__ == "__main__":
    sys.exit(main())
