"""The effect search under the conditions of laboratories.

Run from the root of the project::

    python benchmarks/laboratory.py [--plants 7] [--only late,flicker] [--declared cascade]
        [--hiding nothing] [--jobs 2] [--first-seed 5000] [--output laboratory.csv]

The plants are those of the blind study. Here each is driven and recorded under a condition that
its bench leaves out (see `plants.laboratory`): one record, short, of a single sine, cut in the
middle of a loop, coloured noise, mains, outliers, coarse readings, a response that is read late or
early or by another clock, a drive that is held, closed in a loop, or noisy. In three more the bench
is as it was and the plants are others: their effects follow other laws than those of the models,
have other forms, or are two, of which one changes a tenth of what the other does.

Of each condition and declared model so many plants (7) hide nothing, and as many hide one effect
that the condition leaves a trace of: 532 and 532 with `--plants 7`. A name is false where the plant
hides nothing, and wrong where it is another's; those that are true of the condition itself are
neither. Of two effects both must be named. Effects count where they are at least twice the noise.
`--first-seed` chooses plants as in the blind study: some to settle on, others to report.
"""

import argparse
import sys
from functools import partial

import numpy as np
from blind_study import (
    NOISES,
    NOTHING,
    RAISED,
    REPORTED_SEEDS,
    Case,
    add_options_of_the_work,
    hidden,
    judge,
    names,
    provenance,
    refits,
    seed_of_study,
    share,
    study,
    work_off,
)
from plants import BASES
from plants.laboratory import HABITS, record_in

FALSE, FALSE_IN_ONE = 0.01, 0.03  # bars: largest share of claims where nothing is missing
NAMED, NAMED_IN_ONE = 0.90, 0.80  # smallest share named rightly, or told as ambiguous
WRONG = 0.04  # largest share of wrong names


def plan(plants=7, habits=tuple(HABITS), first_seed=REPORTED_SEEDS.start, hiding=None):
    """List the cases: half hide nothing; seeds depend on nothing else that is chosen."""
    base = seed_of_study(first_seed) + 500_000  # the blind study stays below
    cases = []
    for i, habit in enumerate(HABITS):
        for j, declared in enumerate(BASES):
            for k in range(2 * plants):
                seed = base + 1000 * i + 200 * j + k
                effect, noise = NOTHING, NOISES[(k // 2 + j) % len(NOISES)]
                if k % 2:
                    possible = HABITS[habit].possible(declared)
                    drawn = np.random.default_rng([seed, 9]).choice(len(possible))
                    effect = "+".join(possible[drawn])
                if HABITS[habit].unequal:
                    noise = NOISES[0]  # of which the smaller one must be several times
                cases.append(Case(habit, effect, declared, noise, seed, 0))
    wanted = {None: (True, False), "nothing": (True,), "effects": (False,)}[hiding]
    return [c for c in cases if c.kind in habits and (c.effect == NOTHING) in wanted]


def recording_of(case):
    """Record the plant of a case."""
    effect = hidden(case) or NOTHING
    return record_in(case.kind, effect, case.declared, case.seed, noise=case.noise)


def judged(rows):
    """Return the table of the blind study with what counts here."""
    table = judge(rows)
    table["null"] = table["effect"] == NOTHING
    # of each claim all names that would do: those that are true of the condition are no news
    told = [
        [set(filter(None, names)) for names in alternatives(claimed, ambiguous)]
        for claimed, ambiguous in zip(table["claimed"], table["ambiguous"], strict=True)
    ]
    truth = [set(effect.split("+")) - {NOTHING} for effect in table["effect"]]
    makes = [HABITS[kind].makes for kind in table["kind"]]
    # of two, by a claim each
    table["right"] = [
        t <= set().union(*own) and len(own) >= len(t) for t, own in zip(truth, told, strict=True)
    ]
    others = [
        any(not names & (t | m) for names in own)
        for t, m, own in zip(truth, makes, told, strict=True)
    ]
    table["false"] = np.array(others) & table["null"]
    table["wrong"] = np.array(others) & ~table["null"] & ~table["right"]
    table["counts"] = ~table["null"] & table["visible"]
    table["raised"] = table["named"] == RAISED
    return table


def alternatives(claimed, ambiguous):
    """Yield the name of each claim with those that it was not told apart from."""
    others = ambiguous.split("+")
    for i, name in enumerate(claimed.split("+") if claimed else []):
        yield [name, *(others[i].split("|") if i < len(others) else [])]


def line(row):
    """Format what happened to one plant."""
    (row,) = judged([row._asdict()]).itertuples()
    start = (
        f"{row.kind:15s} {row.effect:21s} {row.declared:18s} {100 * row.noise:4g} % {row.seed:9d}"
    )
    if row.message:
        return f"{start} FAILED {row.message}"
    ok = not row.false if row.null else row.right
    mark = "ok" if ok else "FALSE" if row.null else "WRONG" if row.wrong else "missed"
    size = f"{row.effect_over_noise:5.1f} x" if np.isfinite(row.effect_over_noise) else ""
    also = f" (or {row.ambiguous})" if row.ambiguous.strip("+|") else ""
    return (
        f"{start} {mark:6s} {size:>8s} {row.before:7.2f} -> {row.after:7.2f} {row.seconds:5.1f} s "
        f"{row.verdict:11s} {row.claimed or 'nothing'}{also}"
    )


def summary(rows, first_seed):
    """Format every figure and its limit, with a line for each condition."""
    table = judged(rows)
    nulls, seen = table[table["null"]], table[table["counts"]]
    lines = [
        provenance(first_seed),
        f"claims where nothing is missing: {share(nulls['false'], FALSE, most=True)}",
        f"named rightly, or told as ambiguous with it: {share(seen['right'], NAMED)}",
        f"wrong names: {share(seen['wrong'], WRONG, most=True)}",
        refits(table),
        f"searches that raised: {table['raised'].sum()} of {len(table)}",
        "",
    ]
    for habit in HABITS:
        none, some = nulls[nulls["kind"] == habit], seen[seen["kind"] == habit]
        lines.append(
            f"{habit:15s} false {share(none['false'], FALSE_IN_ONE, most=True)}; named "
            f"{share(some['right'], NAMED_IN_ONE)}; wrong {some['wrong'].sum()}"
        )
    bad = table[table["false"] | (table["counts"] & ~table["right"]) | table["raised"]]
    lines += ["", f"not as asked: {len(bad)} of {len(table)}", *map(line, bad.itertuples())]
    return "\n".join(lines)


def main(arguments=None):
    """Run the study and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=7, help="with and without an effect")
    parser.add_argument(
        "--only", type=names(HABITS), default=tuple(HABITS), help="conditions, by commas"
    )
    parser.add_argument("--declared", type=names(BASES), default=BASES, help="by commas")
    parser.add_argument("--hiding", choices=("nothing", "effects"), help="only plants that do so")
    add_options_of_the_work(parser)
    options = parser.parse_args(arguments)
    cases = plan(options.plants, options.only, options.first_seed, options.hiding)
    cases = [case for case in cases if case.declared in options.declared]
    rows = work_off(cases, options, partial(study, record=recording_of), judged, line)
    if rows:
        print(f"\n{summary(rows, options.first_seed)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
