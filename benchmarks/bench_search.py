"""Time a search over all effects, and the memory that it takes.

Run from the root of the project::

    python benchmarks/bench_search.py [--long] [--declared cascade] [--effects none,creep]
        [--samples 20000] [--repeats 3] [--jobs 2] [--seed 8000]

Without `--long`, recordings of 20,000 samples in five records; the first search of each declared
model compiles the kernels and is not counted. Each is followed by the processor time of its report
in HTML. With `--long`, 1,000,000 samples in five records, and
in one. Each line names the plant's missing effect, what was named, the wall-clock time and its
limit, the processor time of all processes (what the search would take of one core that nobody
shares), the most memory that they held together (each shared page counted once), and the time of
every stage.
"""

import argparse
import gc
import os
import statistics
import threading
import time
from pathlib import Path

from plants import MATRIX, make_recording

from skhyst.compose import Cascade
from skhyst.diagnosis import EffectSearchCV, Report
from skhyst.hysteresis import BoucWen, PrandtlIshlinskii
from skhyst.linear import SecondOrderMode, TransferFunction

SHORT, LONG = 20_000, 1_000_000  # samples
SHORT_LIMIT, LONG_LIMIT = 10.0, 300.0  # s on two cores
REPORT_LIMIT = 5.0  # s of one processor, for a report
MEMORY_LIMIT = 4.0  # GiB
DECLARED = {
    "prandtl_ishlinskii": lambda: PrandtlIshlinskii(),
    "bouc_wen": lambda: BoucWen(exponent="fit"),
    "second_order": lambda: SecondOrderMode(),
    "cascade": lambda: Cascade(
        [("hysteresis", PrandtlIshlinskii()), ("dynamics", TransferFunction(2))]
    ),
}
MISSING = {
    "prandtl_ishlinskii": ("none", "creep", "resonance"),
    "bouc_wen": ("none", "creep", "resonance"),
    "second_order": ("none", "friction", "cubic_stiffness"),
    "cascade": ("none", "creep", "resonance"),
}


class Meter:
    """Processor time and memory of this process and all below it, where /proc tells."""

    def __enter__(self):
        self.peak, self.seconds = 0.0, 0.0
        self._before = self._used()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()
        after = self._used()
        self.seconds = sum(used - self._before.get(pid, 0.0) for pid, used in after.items())

    def _watch(self):
        while not self._done.wait(0.25):
            self.peak = max(self.peak, sum(map(_resident, _family())) / 2**30)

    def _used(self):
        return {pid: _processor_time(pid) for pid in _family()}


def _family():
    """Return the numbers of this process and of all below it."""
    found, below = [], [os.getpid()]
    while below:
        pid = below.pop()
        found.append(pid)
        for listed in Path(f"/proc/{pid}/task").glob("*/children"):
            below += [int(child) for child in _read(listed).split()]
    return found


def _read(path):
    try:
        return Path(path).read_text()
    except OSError:  # the process is gone, or this is no Linux
        return ""


def _resident(pid):
    """Return the bytes that a process holds, shared pages by its part."""
    for line in _read(f"/proc/{pid}/smaps_rollup").splitlines():
        if line.startswith("Pss:"):
            return 1024 * int(line.split()[1])
    return 0


def _processor_time(pid):
    fields = _read(f"/proc/{pid}/stat").rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK") if fields else 0.0


def one_record(effect, declared, seed):
    """Return X and y of one record of a million samples."""
    recording = make_recording(effect, declared, seed, n_samples=5 * LONG, substeps=8)
    for _, y in recording.y_train.groupby(level="record"):
        if len(y) >= LONG:
            X = recording.X_train.loc[y.index]
            return X[:LONG], y[:LONG]
    raise RuntimeError("no record is long enough")


def measure(declared, X, y, jobs):
    """Return the fitted search, its wall-clock time, and the meter."""
    search = EffectSearchCV(DECLARED[declared](), n_jobs=jobs, random_state=0)
    gc.collect()
    with Meter() as meter:
        start = time.perf_counter()
        search.fit(X, y)
        seconds = time.perf_counter() - start
    return search, seconds, meter


def describe(declared, effect, y, search, walls, limit, meter):
    """Print one line about runs, of which the last is given."""
    n_records = y.index.get_level_values("record").nunique()
    stages = ", ".join(f"{name} {value:.2f}" for name, value in search.seconds_.items())
    middle = statistics.median(walls)
    print(
        f"{declared}, {effect} missing, {', '.join(search.effects_) or '-'} named, "
        f"{search.verdict_}; {len(y)} samples in {n_records} records: {middle:.1f} s "
        f"(limit {limit:g} s: {'met' if middle <= limit else 'MISSED'}); "
        f"processor {meter.seconds:.1f} s; {meter.peak:.2f} GiB (limit {MEMORY_LIMIT:g} GiB: "
        f"{'met' if meter.peak <= MEMORY_LIMIT else 'MISSED'}); stages (s): {stages}",
        flush=True,
    )


def time_report(search):
    """Print the processor time of a report."""
    start = time.process_time()
    page = Report.from_search(search).to_html()
    seconds = time.process_time() - start
    met = "met" if seconds <= REPORT_LIMIT else "MISSED"
    print(
        f"  report: {seconds:.1f} s (limit {REPORT_LIMIT:g} s: {met}), {len(page) / 2**20:.1f} MiB"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--long", action="store_true", help="1,000,000 samples")
    parser.add_argument("--declared", default=",".join(DECLARED))
    parser.add_argument("--effects", default="", help="missing ones; by default three a model")
    parser.add_argument("--samples", type=int, default=SHORT, help="of short searches")
    parser.add_argument("--repeats", type=int, default=3, help="of short searches")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=8000)
    options = parser.parse_args()
    for declared in options.declared.split(","):
        wanted = options.effects.split(",") if options.effects else MISSING[declared]
        effects = [e for e in wanted if e == "none" or e in MATRIX[declared]]
        for number, effect in enumerate(effects):
            recording = make_recording(effect, declared, options.seed, n_samples=options.samples)
            X, y = recording.X_train, recording.y_train
            if not number:
                measure(declared, X, y, options.jobs)  # compiles
            if not options.long:
                runs = [measure(declared, X, y, options.jobs) for _ in range(options.repeats)]
                walls = [seconds for _, seconds, _ in runs]
                describe(declared, effect, y, runs[-1][0], walls, SHORT_LIMIT, runs[-1][2])
                time_report(runs[-1][0])
                continue
            for records in (5, 1):
                if records == 1:
                    X, y = one_record(effect, declared, options.seed)
                else:
                    recording = make_recording(
                        effect, declared, options.seed, n_samples=LONG, substeps=8
                    )
                    X, y = recording.X_train, recording.y_train
                    del recording
                search, seconds, meter = measure(declared, X, y, options.jobs)
                describe(declared, effect, y, search, [seconds], LONG_LIMIT, meter)


if __name__ == "__main__":
    main()
