"""The effect search judged against an earlier one: a row a search, rows compared in pairs.

Run from the root of the project, for the tree as it is::

    python benchmarks/judge.py --output now.csv [--suites blind,laboratory,measured,small]
        [--plants 1] [--jobs 1] [--first-seed 0] [--row-seconds 100] [--data ../shared/data]

for the package of another checkout, with the plants of this one; and compared::

    PYTHONPATH=/path/of/the/checkout python benchmarks/judge.py --output then.csv
    python benchmarks/judge.py --output now.csv --against then.csv

The first line printed says which package was searched with, and its commit. Rows are written as
they are done, and a run that was stopped goes on; with ``--against`` nothing is searched.

Without ``--plants`` the plants are a balanced part of the two studies, half an hour of a core:
each effect with each declared model once, noises in turn; of everything else two plants for each
declared model; each condition of a laboratory with and without an effect; two seeds of
each small input. ``--plants N`` is the whole of `blind_study.py` and `laboratory.py` with N
plants, and N seeds. While something is developed the plants are those that constants are settled
on; ``--first-seed 5000`` and above are for reports, and the column `plants` says which they were.

Errors, floor and ceiling are in units of the true noise, but of measured recordings in % of the
held-out range. Rows depend on nothing but the code, except for seconds and for what
``--row-seconds`` (of the processor) cuts off, of which nothing but that is written: such rows count
as not ended, and are not compared otherwise.

What is counted, where the truth says something:

named
    All effects of the truth are claimed; of those at least twice as large as the noise.
or told as ambiguous
    The same with the names that a claim was not told apart from.
not claimed
    Nothing is claimed where nothing is missing, but names that are true of a condition.
no other name
    Where an effect is missing, each claim is of it or not told apart from it. (Simulated alone.)
right verdict
    `noise` where the library can express the plant, `unexplained` where it cannot; in the
    laboratory and of small inputs where that can be told.
no noise where there is more
    The verdict is not `noise` while more than 1.3 times the true noise is left.
floor at most 1.3
    Times the true noise.
ended
    The search has neither raised nor been cut off.
"""

import argparse
import signal
import subprocess
import sys
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import blind_study
import laboratory
import measured_recordings
import numpy as np
import pandas as pd
import small_inputs
from blind_study import NOISES, NOTHING, SETTLING_SEEDS, VISIBLE, attempt, names, result, timed
from laboratory import alternatives
from plants import BASES
from plants.laboratory import HABITS
from scipy import stats
from threadpoolctl import threadpool_limits

import skhyst

SUITES = ("blind", "laboratory", "measured", "small")
UNKNOWN = "unknown"  # truth: structure that no effect expresses
FIRST_ALONE = ", first record alone"
SEVERAL = ("mr_damper_currents", "piezo_pnzt", "bh_loops")  # records, few enough for seconds
EACH = 2 * len(BASES)  # plants of each further kind of the blind study
SEEDS = 2  # of each small input
MOST = 1.3  # times the true noise
CUT = "not within"
NOISE = "noise"  # unit of errors: its standard deviation
# conditions that add errors of the measurement to it
NOISE_ADDED = ("mains", "outliers", "quantised", "noisy_drive")
TRUTH = ("unit", "truth", "also", "asked")
TEXTS = (
    *("plants", *TRUTH),
    *("claimed", "ambiguous", "p_values", "verdict", "warnings", "message"),
)
NUMBERS = (
    *("effect_over_noise", "before", "after", "floor", "ceiling", "refitted"),
    *("seconds", "processor_seconds"),
)
RATIOS = ("after", "before", "floor", "ceiling", "processor_seconds")


class Search(NamedTuple):
    """What identifies a row."""

    suite: str
    case: str


COLUMNS = (*Search._fields, *TEXTS, *NUMBERS)
OF_THE_CLOCK = ("seconds", "processor_seconds")


class NotWithinError(BaseException):
    """A row takes longer than allowed; a search survives what candidates raise as `Exception`."""


# -------------------------------------------------------------------------------------- the plan


def _blind(plants, first_seed):
    cases = blind_study.plan(plants or 1, first_seed=first_seed)
    if plants:
        return cases
    kept, turns = [], {}
    for case in cases:
        if case.kind == "single":
            turn = turns.setdefault((case.effect, case.declared), len(turns))
            kept += [case] * (case.noise == NOISES[turn % len(NOISES)])
        else:
            turns[case.kind] = turns.get(case.kind, 0) + 1
            kept += [case] * (turns[case.kind] <= EACH)
    return kept


def _laboratory(plants, first_seed):
    cases = laboratory.plan(plants or 1, first_seed=first_seed)
    if plants:
        return cases
    turns = {habit: BASES[i % len(BASES)] for i, habit in enumerate(HABITS)}
    return [case for case in cases if case.declared == turns[case.kind]]


def plan(suites=SUITES, plants=None, first_seed=SETTLING_SEEDS.start):
    """List the searches; without a number of plants a balanced part of the studies."""
    seeds = blind_study.seed_of_study(first_seed) + np.arange(plants or SEEDS)
    cases = {
        "blind": [" ".join(map(str, case)) for case in _blind(plants, first_seed)],
        "laboratory": [" ".join(map(str, case)) for case in _laboratory(plants, first_seed)],
        "measured": [*measured_recordings.CASES, *(name + FIRST_ALONE for name in SEVERAL)],
        "small": [f"{name}; {seed}" for name in small_inputs.CASES for seed in seeds],
    }
    return [Search(suite, case) for suite in SUITES if suite in suites for case in cases[suite]]


def plant_of(case):
    """Return the case of a study that a row is of."""
    kinds = blind_study.Case.__annotations__.values()
    return blind_study.Case(*(kind(text) for kind, text in zip(kinds, case.split(), strict=True)))


def truth_of(search):
    """Return the columns that are known before the search."""
    if search.suite == "measured":
        case = measured_recordings.CASES[search.case.removesuffix(FIRST_ALONE)]
        return {"unit": "% of range", "truth": "+".join(map("|".join, case.expected))}
    if search.suite == "small":
        case = small_inputs.CASES[search.case.split("; ")[0]]
        return {
            "truth": case.truth,
            "also": case.also,
            "asked": case.verdict,
            "unit": NOISE,
        }
    case = plant_of(search.case)
    if search.suite == "laboratory":  # a condition may leave what is neither noise nor an effect
        unit = "noise before the condition" if case.kind in NOISE_ADDED else NOISE
        also = "|".join(sorted(HABITS[case.kind].makes))
        asked = "" if case.effect != NOTHING else "noise"
        if asked and case.kind == "flicker":  # which is hard to tell from a drift
            asked = "noise|undetermined"
        return {"truth": case.effect, "also": also, "asked": asked, "unit": unit}
    if case.kind == "unknown":
        return {"truth": UNKNOWN, "asked": "unexplained", "unit": NOISE}
    return {"truth": case.effect, "asked": "noise", "unit": NOISE}


# ----------------------------------------------------------------------------------- the searches


@contextmanager
def within(seconds):
    """Raise `NotWithinError` after so many seconds of the processor."""

    def stop(*_):
        raise NotWithinError

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 1.0)  # again where a callback has swallowed it
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _measured(case, data):
    name = case.removesuffix(FIRST_ALONE)
    recording = measured_recordings.CASES[name]
    X, y, X_test, y_test = measured_recordings.parts(recording, data, name != case)
    fitted, seconds = timed(measured_recordings.searched, recording, X, y)
    return result(fitted, X_test, y_test, np.ptp(np.asarray(y_test)) / 100.0) | seconds


def _small(case, data):
    name, seed = case.split("; ")
    (X, y, noise), (X_test, y_test, _) = small_inputs.records(name, int(seed))
    fitted, seconds = timed(small_inputs.CASES[name].search().fit, X, y)
    return result(fitted, X_test, y_test, noise) | seconds


def row_of(search, first_seed, row_seconds, data):
    """Search a row."""
    plants = "settling" if first_seed in SETTLING_SEEDS else "reported"
    row = search._asdict() | dict.fromkeys(TEXTS, "") | truth_of(search)
    row["plants"] = "measured" if search.suite == "measured" else plants
    studies = {"blind": blind_study.recording_of, "laboratory": laboratory.recording_of}
    try:
        with threadpool_limits(1), within(row_seconds):
            if search.suite in studies:
                found = blind_study.study(plant_of(search.case), studies[search.suite])
            else:
                work = {"measured": _measured, "small": _small}[search.suite]
                found = attempt(partial(work, search.case, data))
    except NotWithinError:
        found = {"message": f"{CUT} {row_seconds:g} s"}
    return row | {name: found[name] for name in found if name in COLUMNS[len(Search._fields) :]}


# -------------------------------------------------------------------------------------- the rows


def right_of(row):
    """Yield what was right in a row, where the truth says something about it."""
    cut, failed = row.message.startswith(CUT), bool(row.message)
    yield "ended", not failed
    if cut:
        return
    truth = (
        [] if row.truth in (NOTHING, UNKNOWN) else [set(n.split("|")) for n in row.truth.split("+")]
    )
    known = set().union(*truth, filter(None, row.also.split("|")))
    claimed = list(filter(None, row.claimed.split("+")))
    told = [set(filter(None, own)) for own in alternatives(row.claimed, row.ambiguous)]
    if truth and not row.effect_over_noise < VISIBLE:
        enough, all_told = len(claimed) >= len(truth), set().union(*told)
        yield "named", enough and all(names & set(claimed) for names in truth)
        yield "or told as ambiguous", enough and all(names & all_told for names in truth)
    if row.asked:
        yield "right verdict", row.verdict in row.asked.split("|")
    if failed:
        return
    only_known = all(own & known for own in told)
    if row.truth == NOTHING:
        yield "not claimed", only_known
    if truth and row.suite != "measured":
        yield "no other name", only_known
    if row.unit == NOISE:
        yield "no noise where there is more", not (row.verdict == "noise" and row.after > MOST)
        yield "floor at most 1.3", row.floor <= MOST


MEASURES = (
    *("named", "or told as ambiguous", "not claimed", "no other name", "right verdict"),
    *("no noise where there is more", "floor at most 1.3", "ended"),
)


def judged(rows):
    """Return the table of the rows, with what was right in each: 1 or 0, NaN where not judged."""
    table = pd.DataFrame(rows).reindex(columns=COLUMNS)
    table = table.astype(dict.fromkeys(NUMBERS, float)).fillna(dict.fromkeys(TEXTS, ""))
    # of this file, also where an earlier one has written it: what is mended needs no new search
    searches = map(Search, table["suite"], table["case"])
    truths = [dict.fromkeys(TRUTH, "") | truth_of(search) for search in searches]
    table[[*TRUTH]] = pd.DataFrame(truths, table.index)[[*TRUTH]]
    right = pd.DataFrame([dict(right_of(row)) for row in table.itertuples()], columns=MEASURES)
    return table.join(right.astype(float))


def line(row):
    """Format a row."""
    start = f"{row.suite} {row.case:60s}"
    if row.message:
        return f"{start} {row.message}"
    values = zip(MEASURES, row[-len(MEASURES) :], strict=True)
    bad = [name for name, value in values if value == 0.0]
    also = f" (or {row.ambiguous})" if row.ambiguous.strip("+|") else ""
    return (
        f"{start} {row.before:7.3g} -> {row.after:7.3g}, floor {row.floor:5.3g}, "
        f"{row.seconds:5.1f} s  {row.verdict}: {row.claimed or 'nothing'}{also}"
        f"{'; not: ' + ', '.join(bad) if bad else ''}"
    )


def summary(table):
    """Format how many rows are right, by suite."""
    lines = []
    for suite, part in _parts(table):
        seconds = part["processor_seconds"]
        lines.append(
            f"{suite}: {len(part)} rows; seconds of the processor: {seconds.sum():.0f}, median "
            f"{seconds.median():.1f}, most {seconds.max():.1f}"
        )
        for name in MEASURES:
            asked = part[name].dropna()
            if len(asked):
                lines.append(f"  {name:30s} {asked.sum():4.0f} of {len(asked)}")
    return "\n".join(lines)


def _parts(table):
    groups = [(suite, table[table["suite"] == suite]) for suite in SUITES]
    groups = [(suite, part) for suite, part in groups if len(part)]
    return [*groups, ("all suites", table)] if len(groups) > 1 else groups


# --------------------------------------------------------------------------------- the comparison


def read(path):
    """Return the judged rows of a file."""
    return judged(blind_study.read_table(path, COLUMNS, TEXTS, NUMBERS))


def discordant(better, worse):
    """Return the share of better ones among those that differ, its 95 % interval, and p.

    McNemar's exact test: where nothing is better or worse but by chance, each that differs is as
    likely better as worse. The interval is that of Clopper and Pearson; p has two sides.
    """
    if not better + worse:
        return np.nan, (0.0, 1.0), 1.0
    test = stats.binomtest(better, better + worse)
    interval = test.proportion_ci(0.95, "exact")
    return test.statistic, (interval.low, interval.high), test.pvalue


def ratio(new, old):
    """Return the geometric mean of new over old, its 95 % interval by pairs, and their number."""
    logs = np.log(new / old)[(new > 0) & (old > 0) & np.isfinite(new) & np.isfinite(old)]
    if not len(logs):
        return np.nan, (np.nan, np.nan), 0
    mean, half = logs.mean(), np.nan
    if len(logs) > 1:
        half = stats.t.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs))
    return np.exp(mean), (np.exp(mean - half), np.exp(mean + half)), len(logs)


def _shown(value):
    """Format a value of a row as it is written, and nothing as a dash."""
    if isinstance(value, str):
        return value or "-"
    return f"{value:.6g}" if np.isfinite(value) else "-"


def changes(new, old):
    """List what changed of rows with the same index, a line a row; seconds are no change."""
    lines = []
    for key in new.index:
        told = []
        for name in (*TEXTS, *NUMBERS):
            here, there = new.at[key, name], old.at[key, name]
            if name not in OF_THE_CLOCK and _shown(here) != _shown(there):
                told.append(f"{name} {_shown(there)} -> {_shown(here)}")
        if told:
            lines.append(f"{' '.join(key)}: {'; '.join(told)}")
    return lines


def comparison(new, old):
    """Format what changed from the old to the new rows, and the paired counts and ratios."""
    new, old = (table.set_index([*Search._fields], drop=False) for table in (new, old))
    lines, alone = [], new.index.symmetric_difference(old.index, sort=False)
    if len(alone):
        lines.append(f"in one of the files alone, not compared: {len(alone)} rows")
    both = new.index.intersection(old.index, sort=False)
    new, old = new.loc[both], old.loc[both]
    cut = new["message"].str.startswith(CUT) | old["message"].str.startswith(CUT)
    if cut.any():  # how much a processor does in a second depends on what else runs
        lines.append(f"cut off in one of the files, rows not compared: {cut.sum()}")
    changed = changes(new[~cut], old[~cut])
    lines += [f"changed: {len(changed)} of {len(both)} rows", *changed, ""]
    for suite, part in _parts(new):
        was = old.loc[part.index]
        lines.append(f"{suite}, {len(part)} rows")
        for name in MEASURES:
            pair = pd.DataFrame({"new": part[name], "old": was[name]}).dropna()
            if not len(pair):
                continue
            better, worse = ((pair["new"] - pair["old"]) == sign for sign in (1.0, -1.0))
            share, (low, high), p = discordant(int(better.sum()), int(worse.sum()))
            lines.append(
                f"  {name:30s} {pair['old'].sum():4.0f} -> {pair['new'].sum():4.0f} of {len(pair)}"
                f"; better {better.sum()}, worse {worse.sum()}"
                + (f": share {share:.2f} ({low:.2f} to {high:.2f}), p = {p:.2g}" * (share == share))
            )
        for name in RATIOS:
            mean, (low, high), count = ratio(part[name], was[name])
            if count:
                lines.append(f"  {name:30s} x {mean:.4f} ({low:.4f} to {high:.4f}), {count} pairs")
    if not changed:
        lines.append("no row that both have differs" if len(alone) else "no row differs")
    return "\n".join(lines)


def package():
    """Format which package is searched with."""
    folder = Path(skhyst.__file__).parent
    git = ["git", "-C", str(folder)]
    try:
        run = partial(subprocess.run, capture_output=True, text=True, check=True)
        commit = run([*git, "rev-parse", "--short", "HEAD"]).stdout.strip()
        commit += " with changes" * bool(run([*git, "status", "--porcelain", "."]).stdout)
    except (OSError, subprocess.CalledProcessError):
        commit = "of no checkout"
    return f"{skhyst.__file__}, {skhyst.__version__}, commit {commit}"


def main(arguments=None):
    """Search and print, or compare two files."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--suites", type=names(SUITES), default=SUITES, help="by commas")
    parser.add_argument("--plants", type=int, help="whole studies with so many; a part without it")
    parser.add_argument("--only", default="", help="rows whose case contains this")
    parser.add_argument("--row-seconds", type=float, default=100.0, help="of the processor")
    parser.add_argument("--data", type=Path, default=measured_recordings.SHARED)
    parser.add_argument("--against", help="CSV file to compare that of --output with; no search")
    blind_study.add_options_of_the_work(parser)
    parser.set_defaults(first_seed=SETTLING_SEEDS.start, jobs=1)
    options = parser.parse_args(arguments)
    if options.against:
        if not options.output:
            parser.error("--against needs --output, the file that is compared")
        print(comparison(read(options.output), read(options.against)))
        return 0
    try:
        cases = plan(options.suites, options.plants, options.first_seed)
    except ValueError as error:
        parser.error(str(error))
    absent = [
        name
        for name, case in measured_recordings.CASES.items()
        if not (options.data / (case.folder or name)).exists()
    ]
    cases = [
        case
        for case in cases
        if options.only in case.case and case.case.removesuffix(FIRST_ALONE) not in absent
    ]
    if not cases:
        parser.error("no rows are left to search")
    print(f"{package()}; {len(cases)} rows")
    if absent and "measured" in options.suites:
        print(f"left out, absent from {options.data}: {', '.join(absent)}")
    print(blind_study.provenance(options.first_seed), flush=True)
    chosen = {name: getattr(options, name) for name in ("first_seed", "row_seconds", "data")}
    work = partial(row_of, **chosen)
    rows = blind_study.work_off(cases, options, work, judged, line, TEXTS, NUMBERS)
    if rows:
        print(f"\n{summary(judged(rows))}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
