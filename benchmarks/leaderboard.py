"""Errors on public benchmarks beside the best published: `python benchmarks/leaderboard.py`.

Each row is one benchmark: the split and the metric that its makers ask for, the best published
figure with its source, the error of a model built by hand, that of a model found by a search, and
the seconds that both took. Structures, starts and orders are chosen on the estimation data; the
test record is predicted once. The recordings are not part of the project: their folder lies beside
the checkout or is named by --data, and what is absent is left out. --only names some benchmarks,
--by-hand leaves the searches out.
"""

import argparse
import time
import warnings
from dataclasses import dataclass

import numpy as np
from recordings import SHARED, load_emps

from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning, ExtrapolationWarning
from skhyst.hysteresis import FreeMass

EMPS_KNOWN = 20  # samples of a test record from which its initial state may be estimated


@dataclass(frozen=True)
class Row:
    """A benchmark: what is asked, the best published figure, and ours."""

    split: str
    metric: str
    published: float
    source: str
    by_hand: object
    searched: object = None


# ---------------------------------------------------------------------------------------- EMPS


def _emps(split, data):
    """Return force and position of a run of the axis."""
    X, force = load_emps(split, data)
    return force.to_frame("force"), X["position"]


def _emps_error(model, data):
    """Return the error of the free run of the test record in mm, started from its first samples."""
    X, y = _emps("test", data)
    known = y.where(np.arange(len(y)) < EMPS_KNOWN)
    return 1e3 * float(np.sqrt(np.mean((model.predict_from(X, known) - y) ** 2)))


def emps_by_hand(data=SHARED):
    """Return the error in mm of a mass with friction that differs forward and backward.

    In the estimation record the force at constant speed shows what there is: it rises with the
    speed by 154 N s/m forward and by 230 N s/m backward, and what it is more forward than backward
    falls by half a newton in the course of the record.
    """
    model = FreeMass(
        friction=True, damping_asymmetry=True, fit_force_drift=True, initial_state="estimate"
    )
    return _emps_error(model.fit(*_emps("train", data)), data)


def emps_searched(data=SHARED):
    """Return the error in mm of what a search adds to a mass with a damper, and what it names."""
    search = EffectSearchCV(FreeMass(fit_force_offset=False), random_state=0)
    search.fit(*_emps("train", data))
    return _emps_error(search.best_estimator_, data), search.effects_


BENCHMARKS = {
    "EMPS": Row(
        "official",
        "RMSE of position, mm",
        2.65,
        "nonlinearbenchmark.org",
        emps_by_hand,
        emps_searched,
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--data", default=SHARED)
    parser.add_argument("--only", default=",".join(BENCHMARKS))
    parser.add_argument("--by-hand", action="store_true")
    options = parser.parse_args()
    print("benchmark | split | metric | best published | source | by hand | searched | seconds")
    for name in options.only.split(","):
        row, begin, searched = BENCHMARKS[name], time.perf_counter(), ""
        try:
            with warnings.catch_warnings():
                for kind in (ConvergenceWarning, ExtrapolationWarning):
                    warnings.simplefilter("ignore", kind)
                by_hand = f"{row.by_hand(options.data):.3g}"
                if row.searched is not None and not options.by_hand:
                    error, effects = row.searched(options.data)
                    searched = f"{error:.3g} ({', '.join(effects)})"
        except FileNotFoundError:
            continue
        seconds = time.perf_counter() - begin
        ours = row.published, row.source, by_hand, searched, f"{seconds:.0f}"
        print(" | ".join(map(str, (name, row.split, row.metric, *ours))), flush=True)


if __name__ == "__main__":
    main()
