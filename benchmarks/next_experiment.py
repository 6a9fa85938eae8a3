"""What one proposed record settles, and what a random one: figure 7 of the experiment proposals.

Run from the root of the project::

    python benchmarks/next_experiment.py [--plants 10] [--first-seed 5000] [--jobs 2]
        [--output next_experiment.csv]

The plants are those of the laboratory (see `plants.laboratory`), with noise of 1 % of the range, in
one record of a single sine, in one short record, or in one of 6000 samples. Each hides one effect,
which changes at least twice the noise. Those whose first search claims something that it cannot
tell from something else (`ambiguous_with`) count. For each of these `next_experiment` proposes a
record of 3000 samples, within the range that was recorded and at a rate that takes twenty samples
from end to end. The plant is driven with it, and both records are searched together. A random
signal of those that the proposal was chosen from takes its place in another search, and in a third
one a proposal that may go further than what was recorded, by half of the range at either end.
Settled means: the hidden effect is claimed, and no claim is ambiguous.

`--plants` is the number of plants for each condition and declared model, of which about a fifth
count. `--first-seed` chooses plants as in the blind study. With `--output` every plant is written
as it is done, and a run that was stopped goes on where it ended.
"""

import argparse
import sys
import warnings
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from blind_study import (
    REPORTED_SEEDS,
    VISIBLE,
    add_options_of_the_work,
    declared_model,
    provenance,
    run,
    seed_of_study,
    share,
)
from plants import BASES, MATRIX
from plants.laboratory import PER_RECORD, SLOW, record_in

NOISE = 0.01
HIDDEN = {"single_sine": PER_RECORD, "single_record": PER_RECORD, "short_record": PER_RECORD | SLOW}
SAMPLES = 3000  # of the record that is proposed
EDGE = 20  # samples from one end of the range to the other, at the least
SETTLED = 0.80  # bar
KINDS = ("proposed", "random", "further")


class Plant(NamedTuple):
    """What identifies a plant."""

    habit: str
    effect: str
    declared: str
    seed: int


def plan(plants=10, first_seed=REPORTED_SEEDS.start):
    """List the plants; seeds depend on nothing else that is chosen."""
    base = seed_of_study(first_seed) + 600 * (first_seed in REPORTED_SEEDS)
    found = []
    for k in range(plants):
        for i, (habit, hidden) in enumerate(HIDDEN.items()):
            for j, declared in enumerate(BASES):
                possible = sorted(set(MATRIX[declared]) - hidden)
                drawn = np.random.default_rng([base + k, 9, i, j]).choice(len(possible))
                found.append(Plant(habit, possible[drawn], declared, base + k))
    return found


def study(plant):
    """Search a plant; where it is ambiguous, record more and search again."""
    row = plant._asdict() | {"first": "", "message": ""}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            row |= _searched(plant)
    except Exception as error:  # a plant that fails is a result; the others still count
        row["message"] = f"{type(error).__name__}: {error}"
    return row


def _searched(plant):
    from skhyst.datasets import signals_within
    from skhyst.diagnosis import EffectSearchCV, next_experiment

    drawn = plant.habit, plant.effect, plant.declared, plant.seed
    recorded = partial(record_in, *drawn, noise=NOISE)
    recording, model = recorded(drive=np.zeros(SAMPLES)), declared_model(plant.declared, NOISE)
    if min(recording.truth["effect_over_noise"].values()) < VISIBLE:
        return {"first": "too faint"}
    X, y = recording.X_train, recording.y_train
    search = EffectSearchCV(model, random_state=0).fit(X, y)
    row = {"first": claims_text(search)}
    if not any(search.history_["ambiguous_with"]):
        return row
    first = recording.X_test.index.get_level_values("record") == len(X.index.unique("record"))
    dt, ends = recording.sampling_interval, (X["drive"].min(), X["drive"].max())
    limits = {"rate_limit": np.ptp(ends) / (EDGE * dt), "duration": SAMPLES * dt, "dt": dt}
    experiment = next_experiment(search, ends, **limits)
    signals = signals_within(ends, **limits)
    name = list(signals)[np.random.default_rng(plant.seed).integers(len(signals))]
    drives = {"proposed": experiment.drive.to_numpy(), "random": signals[name]}
    margin = 0.5 * np.ptp(ends) * np.array([-1.0, 1.0])
    limits["rate_limit"] *= 2.0  # the range is twice as large
    drives["further"] = next_experiment(search, ends + margin, **limits).drive.to_numpy()
    row |= {"reason": experiment.reason, "drawn": name}
    for kind, drive in drives.items():
        more = recorded(drive=drive)
        again = EffectSearchCV(model, random_state=0)
        again.fit(pd.concat([X, more.X_test[first]]), pd.concat([y, more.y_test[first]]))
        row[kind] = claims_text(again)
        alone = not any(again.history_["ambiguous_with"])
        row[f"{kind}_settled"] = alone and plant.effect in again.effects_
    return row


def claims_text(search):
    """Format the claims of a search, each with what it was not told from."""
    rows = search.history_.itertuples()
    claims = ["|".join([row.effect, *row.ambiguous_with]) for row in rows]
    return "+".join(claims) or "nothing"


def line(row):
    """Format what happened to one plant."""
    start = f"{row['habit']:14s}{row['effect']:21s}{row['declared']:19s}{row['seed']:9d}  "
    if row["message"]:
        return f"{start}FAILED {row['message']}"
    if "|" not in row["first"]:
        return f"{start}{row['first']}"
    then = (f"{kind}: {'ok ' * row[f'{kind}_settled']}{row[kind]}" for kind in KINDS)
    return f"{start}{row['first']} -> {'; '.join(then)}\n    {row['reason']}"


def summary(rows, first_seed):
    """Format the figures, one of them with its limit."""
    table = pd.DataFrame(rows)
    counted = table[table["first"].str.contains("|", regex=False)]
    lines = [
        provenance(first_seed),
        f"plants: {len(table)}, of which {(table['first'] == 'too faint').sum()} hide too little; "
        f"searches that raised: {(table['message'] != '').sum()}",
        f"first search ambiguous: {len(counted)}",
    ]
    if len(counted):
        proposed, drawn, further = (counted[f"{kind}_settled"].astype(bool) for kind in KINDS)
        lines.append(f"settled by the proposed record: {share(proposed, SETTLED)}")
        lines.append(f"settled by a random record: {drawn.sum()} of {len(drawn)}")
        lines.append(f"settled by a proposed record of twice the range: {share(further, SETTLED)}")
        names = counted[["first", *KINDS]].map(lambda claims: claims.count("|")).mean()
        lines.append(
            f"names that were not told apart, on average: {names['first']:.2f} at first, "
            f"{names['proposed']:.2f} with the proposed record, {names['random']:.2f} with a "
            f"random one, {names['further']:.2f} with one of twice the range"
        )
        sure = ~counted["reason"].str.contains("hardly|if it is")
        lines.append(
            f"where the proposal says that it tells all apart: {proposed[sure].sum()} of "
            f"{sure.sum()}, random {drawn[sure].sum()}"
        )
    return "\n".join(lines)


def read_rows(path):
    """Return the rows of an earlier run, by plant."""
    if not path or not Path(path).exists():
        return {}
    rows = pd.read_json(path, lines=True, dtype=False).to_dict("records")
    return {Plant(*(row[name] for name in Plant._fields)): row for row in rows}


def main(arguments=None):
    """Run the study and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plants", type=int, default=10, help="for each condition and model")
    add_options_of_the_work(parser)
    options = parser.parse_args(arguments)
    cases, rows = plan(options.plants, options.first_seed), read_rows(options.output)
    left = [case for case in cases if case not in rows]
    for row in run(left, options.jobs, options.limit_seconds, study):
        rows[Plant(*(row[name] for name in Plant._fields))] = row
        print(line(row), flush=True)
        if options.output:
            with Path(options.output).open("a", encoding="utf-8") as file:
                file.write(pd.Series(row).to_json() + "\n")
    done = [rows[case] for case in cases if case in rows]
    print(f"\n{len(done)} of {len(cases)} plants\n{summary(done, options.first_seed)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
