"""What a search loses when the machine fails: `python tools/machine_faults.py [--times 10]`.

Each line is a fault that a search on the command line meets: Ctrl-C and SIGTERM at random times, a
worker process that is killed, a disk that is full, a folder that is read-only, a clock that jumps.
Nothing is lost if earlier files are unchanged, no half-written file remains, no process continues,
and a search that is resumed from the checkpoint ends like an undisturbed one. The disk is full at a
limit of the process on the size of files.
"""

import argparse
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

SOON = 2.0  # s in which a signal ends a command
OLD = "what was there before"
CLOCK = """
import itertools, sys, time
jumps, genuine = itertools.cycle((0.0, 3600.0, -86400.0)), time.time
time.time = lambda: genuine() + next(jumps)
from skhyst.cli import main
sys.exit(main(sys.argv[1:]))
"""


def write_recording(path):
    """Write a recording with a lag and a curve behind plays."""
    rng = np.random.default_rng(9802)
    t = 1e-3 * np.arange(4000)
    u = np.sin(2.0 * np.pi * (1.0 + 3.0 * t) * t) * (1.0 + 0.3 * np.sin(5.0 * t))
    play = np.zeros(len(u))
    for k in range(1, len(u)):
        play[k] = min(max(play[k - 1], u[k] - 0.3), u[k] + 0.3)
    lagged = np.zeros(len(u))
    for k in range(1, len(u)):
        lagged[k] = lagged[k - 1] + 0.05 * (u[k - 1] + play[k - 1] - lagged[k - 1])
    y = lagged + 0.1 * lagged**3 + 0.002 * rng.standard_normal(len(u))
    pd.DataFrame({"t": t, "u": u, "y": y}).to_csv(path, index=False)


class Search:
    """A search on the command line in a folder of its own."""

    def __init__(self, folder, recording, run=("-m", "skhyst")):
        self.folder, self.result = folder, folder / "result.json"
        self.checkpoint = folder / "search.skops"
        self.command = [sys.executable, *run, "diagnose", str(recording), "--drive", "u"]
        self.command += ["--response", "y", "--time", "t", "--jobs", "2", "--force"]
        self.command += ["--json", str(self.result), "--checkpoint", str(self.checkpoint)]

    def start(self, **options):
        """Return the running command."""
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        return subprocess.Popen(self.command, start_new_session=True, **quiet, **options)

    def run(self, **options):
        """Return the exit code, and what it said."""
        with self.start(**options) as process:
            said = process.stderr.read()
        return process.returncode, said

    def found(self):
        """Return what the result says of the search."""
        result = json.loads(self.result.read_text())
        return {name: result[name] for name in ("effects", "verdict", "error_after", "ranking")}

    def leftovers(self):
        """Return the names of files that are neither result nor checkpoint."""
        return [p.name for p in self.folder.iterdir() if p not in (self.result, self.checkpoint)]


def is_gone(session):
    """Whether no process of a session is left, two seconds later at most."""
    for _ in range(40):
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def by_signal(search, number, delay, expected):
    """Tell whether a signal after a time ends the search soon, and whether it then goes on."""
    search.result.write_text(OLD)
    with search.start() as process:
        try:
            process.wait(delay)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        begin = time.perf_counter()
        process.communicate()
        seconds = time.perf_counter() - begin
    there = search.result.read_text()
    finished = there != OLD and search.found() == expected  # whole, before the signal came
    kept = finished or there == OLD
    ended = finished or process.returncode == 128 + number
    whole = not search.leftovers() and is_gone(process.pid)
    code, _ = search.run()
    again = code == 0 and search.found() == expected
    asked = {"soon": seconds <= SOON, "kept": kept, "ended": ended, "whole": whole, "again": again}
    failed = "".join(f", not {name}" for name, good in asked.items() if not good)
    return not failed, f"ended in {seconds:.2f} s, code {process.returncode}{failed}"


def by_killed_worker(search, expected):
    """Kill one worker while it works; the search ends as ever."""
    with search.start() as process:
        victim = None
        while process.poll() is None and victim is None:
            time.sleep(1.0)
            victim = next(iter(workers_of(process.pid)), None)
        if victim is not None:
            os.kill(victim, signal.SIGKILL)
        process.communicate()
    good = victim is not None and process.returncode == 0 and search.found() == expected
    return good and not search.leftovers(), f"worker {victim}, code {process.returncode}"


def workers_of(pid):
    """Yield the process numbers of a process's workers that have worked."""
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            line = (path / "cmdline").read_text()
        except (OSError, ValueError):
            continue
        if parent == pid and "popen_loky" in line:
            yield int(path.name)


def by_full_disk(search, expected):
    """No file may grow beyond 1 kB: the old result stays, the command says so."""
    search.result.write_text(OLD)

    def fill():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    search.command[search.command.index("--jobs") + 1] = "1"  # pools write files too
    code, said = search.run(preexec_fn=fill)
    good = code == 1 and search.result.read_text() == OLD and not search.leftovers()
    return good and "cannot be written" in said, f"code {code}"


def by_read_only_folder(search, expected):
    """The command says at once that it may not write."""
    if os.geteuid() == 0:  # whom no permission stops
        search.folder.joinpath("file").touch()
        search.command[-3] = str(search.folder / "file" / "result.json")
    else:
        search.folder.chmod(0o500)
    begin = time.perf_counter()
    code, said = search.run()
    search.folder.chmod(0o700)
    seconds = time.perf_counter() - begin
    return code == 1 and "result.json" in said, f"code {code} after {seconds:.1f} s"


def by_jumping_clock(search, expected):
    """The time of day jumps by an hour forth and a day back at each look."""
    code, _ = search.run()
    return code == 0 and search.found() == expected, f"code {code}"


def main(arguments=None):
    """Print the table; the exit code is 1 where something is lost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=10, help="of Ctrl-C")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    draw, lost = random.Random(options.seed), 0
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder, "recording.csv")
        write_recording(recording)

        def search(name, **more):
            place = Path(folder, name)
            place.mkdir()
            return Search(place, recording, **more)

        undisturbed = search("undisturbed")
        begin = time.perf_counter()
        if undisturbed.run()[0] != 0:
            raise SystemExit("the undisturbed search failed")
        seconds, expected = time.perf_counter() - begin, undisturbed.found()
        print(f"undisturbed: {', '.join(expected['effects'])} in {seconds:.1f} s", flush=True)
        faults = []
        for k in range(options.times):
            delay = draw.uniform(0.0, seconds)
            own = search(f"interrupt{k}"), signal.SIGINT, delay, expected
            faults.append((f"Ctrl-C after {delay:.1f} s", by_signal, own))
        own = search("terminate"), signal.SIGTERM, 0.5 * seconds, expected
        faults.append(("SIGTERM half way", by_signal, own))
        faults.append(("a worker is killed", by_killed_worker, (search("kill"), expected)))
        faults.append(("full disk", by_full_disk, (search("full"), expected)))
        faults.append(("read-only folder", by_read_only_folder, (search("closed"), expected)))
        clock = search("clock", run=("-c", CLOCK))
        faults.append(("the clock jumps", by_jumping_clock, (clock, expected)))
        for name, fault, own in faults:
            good, told = fault(*own)
            lost += not good
            print(f"{name:24s}{'kept' if good else 'LOST':6s}{told}", flush=True)
    print(f"nothing lost: {len(faults) - lost} of {len(faults)}")
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
