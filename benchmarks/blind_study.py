"""The blind study of the effect search: what it names on plants that hide something.

Run from the root of the project::

    python benchmarks/blind_study.py [--plants 5] [--noise 0.0005,0.002,0.01] [--only lag,creep]
        [--declared cascade] [--kinds single,none,two,unknown,none_coloured] [--jobs 2]
        [--first-seed 5000] [--samples 6000] [--limit-seconds 3600] [--output blind_study.csv]

Each plant (see `plants`) hides one effect from the declared model, two, none, or a structure that
no effect expresses; a third of them carry a column that does nothing. The search sees the records
to fit on and the declared model, nothing else. Errors are those of the three held-out records, over
the sensor noise; `refitted` is that of the fit of a clone of the augmented model over its own fit.

A study has 1390 plants with `--plants 5`: 990 that hide one effect, 60 that hide two, 40 with an
unknown structure, and 300 that hide nothing. The noise of 100 of these is coloured and each drive
is recorded twice; all other noise is white. Constants are settled on some plants and results
reported on others: `--first-seed` chooses, see `SETTLING_SEEDS` and `REPORTED_SEEDS`.

With `--output` every plant is written as it is done, and a run that was stopped goes on where it
ended; the summary covers all rows of the plan.
"""

import argparse
import multiprocessing
import os
import sys
import time
import warnings
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from plants import (
    BASES,
    EFFECTS,
    MATRIX,
    UNKNOWN,
    effect_pairs,
    make_recording,
    unknown_structures,
)
from sklearn.base import clone

NOISES = (0.0005, 0.002, 0.01)  # of the range
PLAYS = {0.0005: 80, 0.002: 40, 0.01: 20}  # of a declared model: the noise hides their grid
KINDS = ("single", "none", "two", "unknown", "none_coloured")
COUNTS = {"none": 200, "none_coloured": 100, "two": 60, "unknown": 40}  # plants, with --plants 5
REPEATS = 2  # of each drive where the noise is coloured
NAMED = {0.0005: 0.98, 0.002: 0.98, 0.01: 0.96}  # bars: smallest share named rightly
BOTH, FALSE, UNEXPLAINED = 0.92, 1 / 300, 0.95
WITHIN, WITHIN_SHARE = 1.10, 0.95  # held-out error over the noise
SAME_FIT = 1.01  # error of the augmented model fitted anew over its own
VISIBLE = 2.0  # over the noise: smaller effects are reported, and not judged
# Values of --first-seed. The plants of the former have been looked at, and the constants of the
# search settled on them; each value of the latter is a study to report on, with plants of its own.
SETTLING_SEEDS = range(0, 1000)
REPORTED_SEEDS = range(5000, 9000)
STRIDE = 1_000_000  # seeds of plants that a reported study keeps to itself
MOST = 100  # --plants: as many seeds has each effect, model and noise
NOTHING, RAISED = "none", "error"  # in place of an effect
# columns of a row behind those of its case
TEXTS = ("column", "named", "claimed", "ambiguous", "p_values", "verdict", "warnings", "message")
NUMBERS = (
    "effect_over_noise",
    "before",
    "after",
    "floor",
    "ceiling",
    "refitted",
    "seconds",
    "processor_seconds",
)


class Case(NamedTuple):
    """What identifies a plant of the study."""

    kind: str
    effect: str  # two are joined by "+"
    declared: str
    noise: float
    seed: int
    samples: int


def declared_model(name, noise):
    """Return the model that the user of the plant declares, fine enough for the noise."""
    from skhyst.compose import Cascade
    from skhyst.hysteresis import BoucWen, PrandtlIshlinskii
    from skhyst.linear import SecondOrderMode, TransferFunction

    # twenty even thresholds leave up to 0.08 % of the range of a plant whose own lie between them
    plays = PrandtlIshlinskii(PLAYS[noise])
    if name == "prandtl_ishlinskii":
        return plays
    if name == "bouc_wen":
        return BoucWen(exponent="fit")
    if name == "second_order":
        return SecondOrderMode()
    return Cascade([("hysteresis", plays), ("dynamics", TransferFunction(2))])


# -------------------------------------------------------------------------------------- the plan


def seed_of_study(first_seed):
    """Return what is added to the seeds of all plants, which count from 0 to below 500,000.

    Reported studies have the multiples of a million below 2^32: one word of the generator's seed.
    """
    if first_seed in SETTLING_SEEDS:
        return first_seed
    if first_seed not in REPORTED_SEEDS:
        raise ValueError(
            f"The first seed must be in {SETTLING_SEEDS} or in {REPORTED_SEEDS}. "
            f"Got {first_seed!r} instead."
        )
    return STRIDE * (1 + first_seed - REPORTED_SEEDS.start)


def plan(plants=5, noises=NOISES, kinds=KINDS, first_seed=REPORTED_SEEDS.start, samples=6000):
    """List the cases; seeds depend on nothing else that is chosen, so a part is a part."""
    if not 1 <= plants <= MOST:
        raise ValueError(f"The number of plants must be from 1 to {MOST}. Got {plants!r} instead.")
    base = seed_of_study(first_seed)
    cases = []
    for i, effect in enumerate(EFFECTS, start=1):
        for declared in BASES:
            for j, noise in enumerate(NOISES):
                seeds = [base + 1000 * i + 100 * j + k for k in range(plants)]
                if effect in MATRIX[declared]:
                    cases += [Case("single", effect, declared, noise, s, samples) for s in seeds]
    for kind, count in COUNTS.items():
        for k in range(int(np.ceil(count * plants / 5))):
            # every declared model with every noise once in twelve
            declared, noise = BASES[k % len(BASES)], NOISES[k // len(BASES) % len(NOISES)]
            seed = base + 100_000 * KINDS.index(kind) + k
            rng = np.random.default_rng([seed, 5])
            effect = NOTHING
            if kind == "two":
                effect = "+".join(rng.permutation(rng.permutation(effect_pairs(declared))[0]))
            elif kind == "unknown":  # every structure in turn
                effect = UNKNOWN[k % len(UNKNOWN)]
                possible = [d for d in BASES if effect in unknown_structures(d)]
                declared = possible[k // len(UNKNOWN) % len(possible)]
                noise = NOISES[k % len(NOISES)]
            cases.append(Case(kind, effect, declared, noise, seed, samples))
    return [case for case in cases if case.kind in kinds and case.noise in noises]


def hidden(case):
    """Return the names of what the plant hides."""
    return () if case.effect == NOTHING else tuple(case.effect.split("+"))


# -------------------------------------------------------------------------------------- a search


def recording_of(case):
    """Record the plant of a case."""
    return make_recording(
        hidden(case) or NOTHING,
        case.declared,
        case.seed,
        noise=case.noise,
        n_samples=case.samples,
        distract=True,
        coloured=case.kind == "none_coloured",
        repeats=REPEATS if case.kind == "none_coloured" else 1,
    )


def study(case, record=recording_of):
    """Search one plant.

    Returns
    -------
    dict
        The case, what was claimed, held-out errors over the noise, seconds; `message` when the
        search raised.
    """
    row = case._asdict()

    def searched():
        recording = record(case)
        sizes = recording.truth["effect_over_noise"]
        row["effect_over_noise"] = min(sizes.values(), default=np.nan)
        row["column"] = recording.truth["column"]
        return search(recording, declared_model(case.declared, case.noise))

    return attempt(searched) | row


def attempt(searched):
    """Return what a function returns, or what it raised, and its warnings."""
    row, caught = {"named": RAISED, "claimed": "", "ambiguous": "", "message": ""}, []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            row |= searched()
    except Exception as error:  # a plant that fails is a result; the others still count
        row["message"] = f"{type(error).__name__}: {error}"
    return row | {"warnings": "; ".join(sorted({w.category.__name__ for w in caught}))}


def timed(fit, *data):
    """Return what a fit returns, and its seconds."""
    wall, processor = time.perf_counter(), time.process_time()
    fitted = fit(*data)
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    return fitted, {"seconds": wall, "processor_seconds": processor}


def search(recording, model):
    """Search for what a declared model lacks and measure that on the held-out records."""
    from skhyst.diagnosis import EffectSearchCV

    X, y = recording.X_train, recording.y_train
    fitted, seconds = timed(EffectSearchCV(model, random_state=0).fit, X, y)
    row = result(fitted, recording.X_test, recording.y_test, recording.noise_std)
    again = clone(fitted.best_estimator_).fit(X, y)
    return row | {"refitted": again.fit_error_ / fitted.best_estimator_.fit_error_} | seconds


def result(search, X, y, unit):
    """Return what a search claims and its errors on held-out data, in a unit of the response."""
    claimed, history = list(search.effects_), search.history_[: len(search.effects_)]
    return {
        "named": claimed[0] if claimed else NOTHING,
        "claimed": "+".join(claimed),
        "ambiguous": "+".join("|".join(names) for names in history["ambiguous_with"]),
        "p_values": "+".join(f"{p:.3g}" for p in history["p_value"]),
        "verdict": search.verdict_,
        "before": search.held_out_error(X, y, declared=True) / unit,
        "after": search.held_out_error(X, y) / unit,
        "floor": search.noise_floor_ / unit,
        "ceiling": getattr(search, "noise_ceiling_", np.nan) / unit,
    }


def run(cases, jobs, limit=np.inf, work=None):
    """Yield a row for each plant as it is done; start none once the limit has passed."""
    work = work or study
    start = time.perf_counter()
    if jobs == 1:
        for case in cases:
            if time.perf_counter() - start > limit:
                return
            yield work(case)
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by the workers when they start
    context = multiprocessing.get_context("spawn")
    left, running = list(reversed(cases)), set()
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        while left or running:
            while left and len(running) < jobs and time.perf_counter() - start <= limit:
                running.add(pool.submit(work, left.pop()))
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                yield future.result()


# ----------------------------------------------------------------------------------- the results


def judge(rows):
    """Return a frame of the rows with what was right in each."""
    table = pd.DataFrame(rows)
    for name in TEXTS:
        table[name] = table[name].fillna("") if name in table else ""
    for name in NUMBERS:
        table[name] = table[name].astype(float) if name in table else np.nan
    truth = [set(effect.split("+")) for effect in table["effect"]]
    claims = [list(filter(None, text.split("+"))) for text in table["claimed"]]
    # of each claim, the names that would do as well
    others = [
        [set(filter(None, part.split("|"))) for part in text.split("+")] if text else []
        for text in table["ambiguous"]
    ]
    first = [set(c[:1]) | (o[0] if o else set()) for c, o in zip(claims, others, strict=True)]
    table["right"] = [bool(set(c[:1]) & t) for c, t in zip(claims, truth, strict=True)]
    table["right_or_ambiguous"] = [bool(f & t) for f, t in zip(first, truth, strict=True)]
    table["all"] = [t <= set(c) for c, t in zip(claims, truth, strict=True)]
    told = [set(c).union(*o) for c, o in zip(claims, others, strict=True)]
    table["all_or_ambiguous"] = [
        t <= names and len(c) >= len(t) for t, names, c in zip(truth, told, claims, strict=True)
    ]
    table["more"] = [bool(set(c) - t) for c, t in zip(claims, truth, strict=True)]
    table["within"] = table["after"] <= WITHIN
    table["visible"] = table["effect_over_noise"] >= VISIBLE
    return table


def line(row):
    """Format what happened to one plant."""
    start = (
        f"{row.kind:13s} {row.effect:37s} {row.declared:18s} {100 * row.noise:4g} % "
        f"{row.seed:10d}  "
    )
    if row.message:
        return f"{start}FAILED {row.message}"
    ok = {
        "single": row.right,
        "none": row.named == NOTHING,
        "none_coloured": row.named == NOTHING,
        "two": row.all,
        "unknown": row.verdict == "unexplained",
    }[row.kind]
    told = {"single": row.right_or_ambiguous, "two": row.all_or_ambiguous}.get(row.kind, False)
    mark = "ok" if ok else "ambiguous" if told else "WRONG"
    size = f"{row.effect_over_noise:5.1f} x" if np.isfinite(row.effect_over_noise) else ""
    errors = f"{row.before:6.2f} -> {row.after:5.2f}{'' if row.within else ' !'}"
    also = f" (or {row.ambiguous})" if row.ambiguous.strip("+|") else ""
    warned = f"  [{row.warnings}]" if row.warnings else ""
    return (
        f"{start}{mark:9s} {size:>7s} {errors:18s} {row.seconds:6.1f} s  {row.verdict:11s} "
        f"{row.claimed or 'nothing'}{also}{warned}"
    )


def share(right, bar, most=False):
    """Format how many of a boolean series, and the share that is asked for."""
    if not len(right):
        return "no plants"
    share = right.mean()
    kept = share <= bar if most else share >= bar
    return (
        f"{right.sum()} of {len(right)} = {100 * share:.1f} % "
        f"({'at most' if most else 'at least'} {100 * bar:.3g} %: {'kept' if kept else 'MISSED'})"
    )


def confusion(table):
    """Format the confusion matrix: what single plants hide against the first claim."""
    part = table[table["kind"].isin(["single", "none", "none_coloured"])]
    order = [*EFFECTS, NOTHING, "none_coloured", RAISED]
    hidden_ones = part["effect"].where(part["kind"] == "single", part["kind"])
    counts = pd.crosstab(hidden_ones.rename("effect"), part["named"])
    counts = counts.reindex([e for e in order if e in counts.index])
    columns = [e for e in order if e in counts.columns]
    columns += [c for c in counts.columns if c not in columns]
    numbers = {name: str(i) for i, name in enumerate(columns, start=1)}
    legend = ", ".join(f"{number} {name}" for name, number in numbers.items())
    counts = counts[columns].rename(columns=numbers).rename_axis(index="plant", columns=None)
    text = counts.to_string().replace(" 0", " .")
    return f"first claim: {legend}\n{text}"


def provenance(first_seed):
    """Format which plants constants were settled on, and whether these are others."""
    text = f"settled on the plants of first seeds below {SETTLING_SEEDS.stop} / "
    if first_seed in SETTLING_SEEDS:
        return f"{text}these, of {first_seed}, are among them: no report"
    return f"{text}reported on those of {first_seed}, which are others"


def _claims(single, two, none, coloured, unknown):
    """Format what was named and claimed, with its limits."""
    seen, faint = single[single["visible"]], single[~single["visible"]]
    lines = [f"first effect named rightly, where it is at least {VISIBLE:g} times the noise:"]
    for noise, bar in NAMED.items():
        at = seen[seen["noise"] == noise]
        lines.append(f"  {100 * noise:g} % noise, strict: {share(at['right'], bar)}")
        lines.append(f"    or told as ambiguous: {share(at['right_or_ambiguous'], bar)}")
    for declared, group in seen.groupby("declared", sort=False):
        lines.append(f"  {declared}: {group['right'].sum()} of {len(group)}")
    lines.append(
        f"  fainter effects, not judged: {faint['right'].sum()} of {len(faint)} named rightly, "
        f"{(faint['named'] == NOTHING).sum()} not claimed"
    )
    more = single["more"] & single["right"]
    lines.append(f"  further claims behind a right one: {more.sum()} of {single['right'].sum()}")
    lines.append(f"both of two effects named: {share(two['all'], BOTH)}")
    lines.append(f"  or told as ambiguous: {share(two['all_or_ambiguous'], BOTH)}")
    lines.append(f"  where both are visible: {share(two['all'][two['visible']], BOTH)}")
    false = [~part["named"].isin([NOTHING, RAISED]) for part in (none, coloured)]
    lines.append(f"claims where nothing is missing: {share(pd.concat(false), FALSE, most=True)}")
    lines.append(f"  white noise: {share(false[0], FALSE, most=True)}")
    lines.append(f"  coloured noise, drives repeated: {share(false[1], FALSE, most=True)}")
    called = unknown["verdict"] == "unexplained"
    lines.append(f"unknown structure called unexplained: {share(called, UNEXPLAINED)}")
    lines.append(f"  where it is visible: {share(called[unknown['visible']], UNEXPLAINED)}")
    lines += [
        f"  {name}: {part.sum()} of {len(part)}"
        for name, part in called.groupby(unknown["effect"], sort=True)
    ]
    return lines


def _errors(known, none, coloured):
    """Format the held-out errors; the noise is white but in what is counted last."""
    lines, after = [], known["after"].dropna()
    if len(after):
        quantiles = ", ".join(f"{q:g}: {after.quantile(q):.3f}" for q in (0.5, 0.9, 0.95, 0.99))
        lines.append(f"held-out error after, over the noise, quantiles: {quantiles}")
    lines.append(f"  within {WITHIN:.2f}: {share(known['within'], WITHIN_SHARE)}")
    alone = none.groupby(["declared", "noise"], sort=False)["before"]
    lines += [
        f"    declared model where nothing is missing, {declared}, {100 * noise:g} %: "
        f"median {part.median():.3f}, most {part.max():.3f}"
        for (declared, noise), part in alone
    ]
    for noise, group in known.groupby("noise"):
        lines.append(f"    {100 * noise:g} % noise: {group['within'].sum()} of {len(group)}")
    lines.append(f"    coloured noise, not judged: {coloured['within'].sum()} of {len(coloured)}")
    return lines


def refits(table):
    """Format how many augmented models a clone of them is fitted as well as."""
    found = table["refitted"].dropna()
    return f"fitted again to the same error, within 1 %: {share(found <= SAME_FIT, 1.0)}"


def summary(rows, first_seed=REPORTED_SEEDS.start):
    """Format the confusion matrix, every figure with its limit, and the failures."""
    table = judge(rows)
    single, none, two, unknown, coloured = (table[table["kind"] == kind] for kind in KINDS)
    known = table[~table["kind"].isin(["unknown", "none_coloured"])]
    parts = [provenance(first_seed)]
    if len(single) + len(none) + len(coloured):
        parts.append(confusion(table))
    lines = _claims(single, two, none, coloured, unknown)
    idle = (table["column"] == "temperature") & ~table["effect"].str.contains("auxiliary_input")
    idly = table["claimed"].str.contains("auxiliary_input")[idle]
    lines.append(
        f"claims of an idle column, in all plants that carry one: {idly.sum()} of {len(idly)}"
    )
    lines += _errors(known, none, coloured)
    lines.append(refits(table))
    lines.append(f"searches that raised: {(table['named'] == RAISED).sum()} of {len(table)}")
    seconds, processor = table["seconds"].dropna(), table["processor_seconds"].sum()
    if len(seconds):
        lines.append(
            f"seconds a search: median {seconds.median():.1f}, 0.95: {seconds.quantile(0.95):.1f}, "
            f"most {seconds.max():.1f}; processor hours in all {processor / 3600:.2f}"
        )
    parts.append("\n".join(lines))
    failed = table[
        (table["kind"].isin(["single"]) & table["visible"] & ~table["right"])
        | (table["kind"].isin(["none", "none_coloured"]) & (table["named"] != NOTHING))
        | ((table["kind"] == "two") & ~table["all"])
        | ((table["kind"] == "unknown") & (table["verdict"] != "unexplained"))
        | (~table["kind"].isin(["unknown", "none_coloured"]) & ~table["within"])
        | (table["named"] == RAISED)
    ]
    listed = map(line, failed.itertuples())
    parts.append("\n".join([f"not as asked: {len(failed)} of {len(table)}", *listed]))
    return "\n\n".join(parts)


def read_rows(path, cases, texts=TEXTS, numbers=NUMBERS):
    """Return the rows of earlier runs that belong to the cases, by case."""
    if not path or not Path(path).exists() or not Path(path).stat().st_size:
        return {}
    kind, wanted = type(cases[0]), set(cases)
    table = read_table(path, (*kind._fields, *texts, *numbers), texts, numbers)
    rows = {kind(*(row[name] for name in kind._fields)): row for row in table.to_dict("records")}
    return {case: row for case, row in rows.items() if case in wanted}


def read_table(path, columns, texts=TEXTS, numbers=NUMBERS):
    """Return the frame of a file, which must have these columns."""
    table = pd.read_csv(
        path,
        dtype=dict.fromkeys(texts, str) | dict.fromkeys(numbers, float),
        keep_default_na=False,
        na_values=dict.fromkeys(numbers, ""),
    )
    if list(table) != list(columns):
        other = sorted(set(table) ^ set(columns)) or "their order"
        raise ValueError(f"The columns of {path} are not those of these rows: {other}.")
    return table


def names(allowed, convert=str):
    def parse(text):
        chosen = [convert(part) for part in text.split(",")]
        unknown = sorted(set(chosen) - set(allowed))
        if unknown:
            raise argparse.ArgumentTypeError(f"{unknown} not among {', '.join(map(str, allowed))}")
        return chosen

    return parse


def main(arguments=None):
    """Run the study and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = (*EFFECTS, *UNKNOWN, NOTHING)
    parser.add_argument(
        "--plants", type=int, default=5, help="for each effect, model and noise; others in step"
    )
    parser.add_argument("--noise", type=names(NOISES, float), default=NOISES, help="by commas")
    parser.add_argument("--only", type=names(choices), help="effects, by commas: each plant of it")
    parser.add_argument("--declared", type=names(BASES), default=BASES, help="models, by commas")
    parser.add_argument("--kinds", type=names(KINDS), default=KINDS, help="by commas")
    parser.add_argument("--samples", type=int, default=6000, help="of the five records to fit on")
    add_options_of_the_work(parser)
    options = parser.parse_args(arguments)
    first = options.first_seed
    try:
        cases = plan(options.plants, options.noise, options.kinds, first, options.samples)
    except ValueError as error:
        parser.error(str(error))
    only = set(options.only or choices)
    cases = [
        c for c in cases if c.declared in options.declared and set(c.effect.split("+")) <= only
    ]
    if not cases:
        parser.error("no plants are left to search")
    done = work_off(cases, options)
    if done:
        print(f"\n{summary(done, first)}", flush=True)
    return 0


def add_options_of_the_work(parser):
    """Add the options that say which plants are searched, how, and where rows are written."""
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument(
        "--first-seed",
        type=int,
        default=REPORTED_SEEDS.start,
        help=f"other plants: in {REPORTED_SEEDS} to report on, in {SETTLING_SEEDS} to settle on",
    )
    parser.add_argument("--output", help="CSV file, a row a plant, which a later run goes on with")
    parser.add_argument(
        "--limit-seconds", type=float, default=np.inf, help="start no plant after these"
    )


def work_off(cases, options, work=None, judge=judge, line=line, texts=TEXTS, numbers=NUMBERS):
    """Search the plants that are not in the file of an earlier run; return the rows of all."""
    rows, kind = read_rows(options.output, cases, texts, numbers), type(cases[0])
    left = [case for case in cases if case not in rows]
    if rows:
        print(f"{len(rows)} of {len(cases)} plants are in {options.output} already", flush=True)
    for row in run(left, options.jobs, options.limit_seconds, work):
        rows[kind(*(row[name] for name in kind._fields))] = row
        (judged,) = judge([row]).itertuples()
        print(f"{len(rows):4d}/{len(cases)} {line(judged)}", flush=True)
        if options.output:
            path = Path(options.output)
            new = not path.exists() or not path.stat().st_size
            frame = pd.DataFrame([row]).reindex(columns=[*kind._fields, *texts, *numbers])
            frame.to_csv(path, mode="a", header=new, index=False, float_format="%.6g")
    if len(rows) < len(cases):
        print(f"\n{len(cases) - len(rows)} of {len(cases)} plants are still to be searched")
    return [rows[case] for case in cases if case in rows]


if __name__ == "__main__":
    sys.exit(main())
