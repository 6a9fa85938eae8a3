"""How often the effect search names the effect that a plant hides, and how near the noise it gets.

Run from the root of the project::

    python benchmarks/effect_study.py [--seeds 3] [--none 20] [--jobs 2] [--first-seed 0]
        [--only lag,creep] [--declared cascade] [--output FILE.csv]

Each plant (see `plants.py`) hides one effect from the declared model, or none. The search sees the
records to fit on and the declared model, nothing else. An effect is named rightly when it is the
first that the search claims. Errors are those of the three held-out records, over the sensor noise.
"""

import argparse
import multiprocessing
import os
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed

import numpy as np
import pandas as pd
from plants import BASES, EFFECTS, make_recording

LIMIT = 1.10  # largest accepted held-out error over the noise
LIMITS = {"delay": 1.25}
NOTHING, RAISED = "none", "error"  # in place of an effect


def declared_model(name):
    """Return the model that the user of the plant declares."""
    from skhyst.compose import Cascade
    from skhyst.hysteresis import PrandtlIshlinskii
    from skhyst.linear import TransferFunction

    if name == "prandtl_ishlinskii":
        return PrandtlIshlinskii()
    return Cascade(
        [
            ("hysteresis", PrandtlIshlinskii()),
            ("dynamics", TransferFunction(n_poles=2, n_zeros=0)),
        ]
    )


def study(effect, declared, seed):
    """Search one plant.

    Returns
    -------
    dict
        What was claimed, held-out errors over the noise, seconds; `message` when the search raised.
    """
    row = {"effect": effect, "declared": declared, "seed": seed, "named": RAISED}
    caught = []
    try:
        recording = make_recording(effect, declared, seed)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            row |= search(recording, declared)
    except Exception as error:  # a plant that fails is a result; the others still count
        row["message"] = f"{type(error).__name__}: {error}"
    row["warnings"] = "; ".join(sorted({w.category.__name__ for w in caught}))
    row["right"] = row["named"] == effect
    row["right_or_ambiguous"] = row["right"] or effect in row.get("ambiguous_with", ())
    row["within"] = bool(row.get("after", np.inf) <= LIMITS.get(effect, LIMIT))
    return row


def search(recording, declared):
    """Fit the search to a recording and measure it on the held-out records."""
    from skhyst.diagnosis import EffectSearchCV

    model = declared_model(declared)
    start = time.perf_counter()
    fitted = EffectSearchCV(model, random_state=0).fit(recording.X_train, recording.y_train)
    seconds = time.perf_counter() - start
    claimed = tuple(fitted.effects_)
    held_out = recording.X_test, recording.y_test
    return {
        "named": claimed[0] if claimed else NOTHING,
        "claimed": claimed,
        "ambiguous_with": tuple(fitted.history_["ambiguous_with"].iloc[0]) if claimed else (),
        "verdict": fitted.verdict_,
        "before": fitted.held_out_error(*held_out, declared=True) / recording.noise_std,
        "after": fitted.held_out_error(*held_out) / recording.noise_std,
        "noise_std": recording.noise_std,
        "seconds": seconds,
    }


def plan(options):
    """List the plants to search: (effect, declared, seed), every effect on seeds of its own."""
    plants = [
        (effect, declared, options.first_seed + 100 * i + k)
        for i, effect in enumerate(EFFECTS, start=1)
        for declared in BASES
        for k in range(options.seeds)
    ]
    shared = len(BASES)
    plants += [
        (NOTHING, BASES[k % shared], options.first_seed + k // shared) for k in range(options.none)
    ]
    return [p for p in plants if p[0] in options.only and p[1] in options.declared]


def run(plants, jobs):
    """Yield a row for each plant as it is done."""
    if jobs == 1:
        yield from (study(*plant) for plant in plants)
        return
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # read by the workers when they start
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        futures = [pool.submit(study, *plant) for plant in plants]
        for future in as_completed(futures):
            yield future.result()


def line(row):
    """Format what happened to one plant."""
    start = f"{row['effect']:21s} {row['declared']:19s} {row['seed']:5d}  "
    if "message" in row:
        return f"{start}FAILED {row['message']}"
    mark = "ok" if row["right"] else "ambiguous" if row["right_or_ambiguous"] else "WRONG"
    claimed = list(row["claimed"]) or ["nothing"]
    if row["ambiguous_with"]:
        claimed[0] += f" (or {', '.join(row['ambiguous_with'])})"
    errors = f"{row['before']:6.2f} -> {row['after']:5.2f} x noise{'' if row['within'] else ' !'}"
    warned = f"  [{row['warnings']}]" if row["warnings"] else ""
    return (
        f"{start}{mark:9s} {errors:25s} {row['seconds']:6.1f} s  {row['verdict']:11s} "
        f"{' + '.join(claimed)}{warned}"
    )


def summary(rows):
    """Format the confusion tables, the totals and the failures."""
    table = pd.DataFrame(rows)
    order = [*EFFECTS, NOTHING]
    parts = []
    for declared, group in table.groupby("declared", sort=False):
        confusion = pd.crosstab(group["effect"], group["named"])
        confusion = confusion.reindex([e for e in order if e in confusion.index])
        columns = [e for e in order if e in confusion.columns]
        columns += [c for c in confusion.columns if c not in columns]
        text = confusion[columns].rename_axis(index="plant", columns="first claim").to_string()
        parts.append(f"{declared}\n{text}")
    hidden, bare = table[table["effect"] != NOTHING], table[table["effect"] == NOTHING]
    false = bare[~bare["named"].isin([NOTHING, RAISED])]
    totals = [
        f"named rightly: {hidden['right'].sum()} of {len(hidden)}"
        f" ({hidden['right_or_ambiguous'].sum()} when told as ambiguous counts)",
        f"held-out error within {LIMIT:.2f} of the noise (delay {LIMITS['delay']:.2f}): "
        f"{hidden['within'].sum()} of {len(hidden)}",
        f"claims where nothing is missing: {len(false)} of {len(bare)}",
        f"searches that raised: {(table['named'] == RAISED).sum()} of {len(table)}",
    ]
    if "seconds" in table:
        totals.append(f"seconds a search, median: {table['seconds'].median():.1f}")
    parts.append("\n".join(totals))
    failed = [row for row in rows if not row["right"] or not row["within"]]
    parts.append("\n".join(["failures:" if failed else "failures: none", *map(line, failed)]))
    return "\n\n".join(parts)


def _names(allowed):
    def parse(text):
        names = text.split(",")
        unknown = sorted(set(names) - set(allowed))
        if unknown:
            raise argparse.ArgumentTypeError(f"{unknown} not among {', '.join(allowed)}")
        return names

    return parse


def main(arguments=None):
    """Run the study and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    choices = (*EFFECTS, NOTHING)
    parser.add_argument("--seeds", type=int, default=3, help="plants per effect and model")
    parser.add_argument("--none", type=int, default=20, help="plants with nothing missing")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--first-seed", type=int, default=0, help="shift all seeds: other plants")
    parser.add_argument("--only", type=_names(choices), default=choices, help="effects, by commas")
    parser.add_argument("--declared", type=_names(BASES), default=BASES, help="models, by commas")
    parser.add_argument("--output", help="CSV file, a row a plant")
    options = parser.parse_args(arguments)
    plants = plan(options)
    if not plants:
        parser.error("no plants are left to search")
    rows = []
    for row in run(plants, options.jobs):
        rows.append(row)
        print(f"{len(rows):3d}/{len(plants)} {line(row)}", flush=True)
    rows.sort(key=lambda row: plants.index((row["effect"], row["declared"], row["seed"])))
    print(f"\n{summary(rows)}", flush=True)
    if options.output:
        pd.DataFrame(rows).to_csv(options.output, index=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
