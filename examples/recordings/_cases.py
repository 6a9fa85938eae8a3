"""Load the cases of `benchmarks/measured_recordings.py` and print and draw their results."""

import sys
from copy import copy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from skhyst.inspection import EvidenceDisplay
from skhyst.records import stack_records

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

from measured_recordings import CASES
from recordings import SHARED

__all__ = ["fitted_models", "load_case", "print_errors", "print_findings", "show_evidence"]


def load_case(name, columns, response):
    """Return a case and its recording, with named columns; exit if the recording is missing.

    Parameters
    ----------
    name : str
        One of CASES.
    columns : list of str
        Names of the columns of X, with units.
    response : str
        Name of y, without a unit.

    Returns
    -------
    case : Case
    X, y : DataFrame, Series
        The part to search.
    X_test, y_test : DataFrame, Series
        The part that is held out.
    """
    case = CASES[name]
    data = SHARED.resolve()
    folder = data / (case.folder or name)
    if not folder.exists():
        print(f"{folder} is absent. Set the variable SKHYST_DATA to the folder of the recordings.")
        sys.exit()
    parts = list(case.load(data))
    if isinstance(parts[0], np.ndarray):
        dt = case.declared().dt
        parts = [part for i in (0, 2) for part in stack_records([tuple(parts[i : i + 2])], dt=dt)]
    for i in (0, 2):
        parts[i] = parts[i].set_axis(columns, axis=1)
        parts[i + 1] = case.scale * parts[i + 1].rename(f"{response} ({case.unit})")
    return case, *parts


def fitted_models(search):
    """Return the models of a search by name: as declared, and with the effects found, if any."""
    models = {"declared model": search.declared_estimator_}
    if search.effects_:
        models["with " + ", ".join(search.effects_)] = search.best_estimator_
    return models


def print_findings(search):
    """Print the verdict of a search, and the evidence of each claim."""
    report = search.report()
    print(f"{report.headline}\n{report.sentence}")
    for claim in search.history_.itertuples():
        print(f"\n{claim.effect}, p = {claim.p_value:.1g}: {claim.evidence.statement}")
        if claim.ambiguous_with:
            print(f"These data do not distinguish it from {', '.join(claim.ambiguous_with)}.")


def print_errors(case, search, X_test, y_test):
    """Print errors of the held-out part, and published figures."""
    scorer = copy(search)
    if case.lead is not None:
        scorer.set_params(washout=case.lead)
    for number, name in enumerate(fitted_models(search)):
        error = scorer.held_out_error(X_test, y_test, declared=number == 0)
        part = error / np.ptp(y_test)
        print(f"held out, {name}: {error:.4g} {case.unit}, {part:.2%} of the range")
    print(f"published figures: {case.reference or 'none'}")


def show_evidence(search):
    """Draw the picture of each claim, side by side."""
    n = len(search.effects_)
    if n:
        figure = plt.figure(figsize=(max(4.4 * n, 6.0), 4.0), layout="constrained")
        for number, effect in enumerate(search.effects_, 1):
            EvidenceDisplay.from_search(search, effect, ax=figure.add_subplot(1, n, number))
        plt.show()
