"""Whether the tests notice faults: `python tools/faults.py [--drawn 64] [--seed 0]`.

Copies the package and its tests to a temporary folder, applies one fault of ``fault_table`` at a
time, and runs the tests that should notice it: those of the default run, and, if these pass, the
slow ones, which ``--tier default`` skips. A fault is killed if one of these fails, or if they do
not terminate, and the failing test passes without the fault. Numba's cache does not track functions
called by a compiled loop, so with a fault in a file of loops the files that import it are compiled
again, too. With ``--drawn``, that many ``mutants`` replace the table.

Limits, in all and in each area: the default run kills at least 85 % of the faults, with the slow
tests at least 90 %.
"""

import argparse
import ast
import compileall
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
from functools import cache
from pathlib import Path
from py_compile import PycInvalidationMode

import numba
import pytest
from fault_table import FAULTS
from mutants import draw_mutants

ROOT = Path(__file__).resolve().parents[1]
LEAST = {"default": 0.85, "all": 0.9}  # part of the faults that tests notice
TIERS = {"default": ("not slow",), "all": ("not slow", "slow")}
LIMIT = 100  # s of processor time of the tests of one fault, however busy the machine is
_SERVER = multiprocessing.get_context("forkserver")
_SERVER.set_forkserver_preload(["numba", "pandas", "pytest", "scipy.signal", "sklearn.ensemble"])


def sources(root):
    """Return the files of the package and what they say."""
    return {path: path.read_text() for path in sorted((root / "skhyst").rglob("*.py"))}


def places(fault, texts):
    """Return the files in which a fault can be put, once for each place."""
    return [path for path, text in texts.items() for _ in range(text.count(fault.original))]


def imports(texts):
    """Return which files of a package each of its files imports something from.

    A name that a package's ``__init__`` imports is looked up where it comes from.
    """
    modules = {path.with_suffix(""): path for path in texts}
    modules |= {path.parent: path for path in texts if path.name == "__init__.py"}

    @cache
    def names(path):
        found = {}
        for node in ast.walk(ast.parse(texts[path])):
            if isinstance(node, ast.ImportFrom) and node.level:
                module = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
                for alias in node.names:
                    source = modules.get(module / alias.name, modules.get(module))
                    if source in texts and source.name == "__init__.py" and source != path:
                        source = names(source).get(alias.name, source)
                    found[alias.asname or alias.name] = source
        return found

    return {path: set(names(path).values()) for path in texts}


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
        self._imports = imports(self.texts)
        # bytecode by what a file says: by its time it would be trusted within one second
        mode = PycInvalidationMode.CHECKED_HASH
        compileall.compile_dir(self.root / "skhyst", quiet=2, invalidation_mode=mode)

    def judge(self, fault, tier="all"):
        """Return what became of a fault, the seconds, and the test that noticed it."""
        found = places(fault, self.texts)
        if len(found) != 1:
            return "not found" if not found else f"found {len(found)} times", 0.0, None
        tests = self._arguments(fault.tests)
        if tests is None:
            return "no tests", 0.0, None
        (path,) = found
        text, outcomes, seconds = self.texts[path], [], 0.0
        times = {user: user.stat().st_mtime_ns for user in self._users(path)}
        path.write_text(text.replace(fault.original, fault.faulty))
        for user in times:
            os.utime(user)  # Numba compiles what is newer than its cache
        for marks in TIERS[tier]:
            outcome, took, failed = self._run(("-m", marks, *tests))
            seconds += took
            outcomes.append(outcome)
            if outcome != "survived" and outcome != "none":
                break
        path.write_text(text)
        for user, time_ns in times.items():
            os.utime(user, ns=(time_ns, time_ns))
        if outcome == "killed":
            alone = (failed,) if failed else ("-m", marks, *tests)
            if alone not in self._clean:
                self._clean[alone] = self._run(alone)[0]
            if self._clean[alone] != "survived":
                return "fails without it", seconds, failed
            return f"killed{', slow' * (len(outcomes) - 1)}", seconds, failed
        if set(outcomes) == {"none"}:
            return "no tests", seconds, None
        return outcomes[0] if outcome == "none" else outcome, seconds, None

    def _users(self, path):
        """Return the files whose compiled loops may hold what a file says, itself included."""
        if "bind(" in self.texts[path]:  # templates of loops, for laws that do not import them
            return set(self.texts)
        found, new = set(), {path}
        while new:
            found |= new
            new = {user for user, used in self._imports.items() if used & new} - found
        return found

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

    def _run(self, tests):
        """Run tests; return what became of the fault, the seconds, and the test that failed."""
        output = self.root.parent / "output"
        begin = time.perf_counter()
        process = _SERVER.Process(target=_test, args=(self.root, self.cache, tests, output))
        process.start()
        process.join()
        seconds = time.perf_counter() - begin
        if process.exitcode == -signal.SIGXCPU:
            return "killed", seconds, None
        said = output.read_text()
        # what cannot be imported tells nothing
        broken = "ERROR collecting" in said or process.exitcode in (2, 3, 4)
        outcome = "broken" if broken else "killed" if process.exitcode else "survived"
        if process.exitcode == 5:
            outcome = "none"  # of the tests has this mark
        failed = re.search(r"^(?:FAILED|ERROR) ((?:tests|skhyst)/.*?)(?: - |$)", said, re.MULTILINE)
        return outcome, seconds, failed and failed[1]


def _test(root, cache, tests, output):
    """Run tests of a copy of the project in a process of their own."""
    resource.setrlimit(resource.RLIMIT_CPU, (LIMIT, LIMIT + 9))  # told, then ended
    os.chdir(root)
    sys.path.insert(0, str(root))
    sys.dont_write_bytecode = True
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
    parser.add_argument("--tier", choices=TIERS, default="all", help="tests to run")
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
    outcomes = {}
    with tempfile.TemporaryDirectory() as folder:
        laboratory = Laboratory(root, Path(folder))
        for fault in faults:
            outcome, seconds, noticed = laboratory.judge(fault, options.tier)
            print(f"{fault.area:13} {outcome:16} {seconds:6.1f} s  {fault.name}", flush=True)
            if noticed:
                print(f"{'':40}{noticed}", flush=True)
            if outcome == "survived" or outcome.startswith("killed"):
                for area in (fault.area, "all"):
                    outcomes.setdefault(area, []).append(outcome)
    print()
    too_few = False
    for area, found in outcomes.items():
        count, told = len(found), []
        killed = {"default": found.count("killed"), "all": count - found.count("survived")}
        for tier in LEAST:
            if tier in ("default", options.tier):
                told.append(f"{tier} {killed[tier]} of {count}, {killed[tier] / count:.0%}")
                too_few |= killed[tier] < LEAST[tier] * count
        print(f"{area:13} killed by {'; by '.join(told)}")
    return int(too_few)


if __name__ == "__main__":
    sys.exit(main())
