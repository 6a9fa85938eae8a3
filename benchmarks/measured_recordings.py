"""Search measured recordings for missing effects: `python benchmarks/measured_recordings.py`.

Each recording comes with a declared model that lacks what its makers, or others, know to be there.
The search sees the part to fit and the declared model, nothing else; errors before and after are
those of the part that is held out. The recordings are not part of the project: their folder lies
next to the checkout or is named by --data, and what is absent is left out.

Targets are errors of the held-out part after the search. References are figures of others, or
rough fits, for the same recording.

What is held out: the later part in time; a level of drive (loops, which are gone through twice:
the first turn brings the memory into the loop and is not scored); or the test record of the
benchmark. Both records of the tanks begin in the same unknown state: the test is led in by the
drive at which the linear model rests before the record of the fit.

piezo_afm is also searched from the command line, and both must agree.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from recordings import (
    SHARED,
    load_bh_loops,
    load_bouc_wen_benchmark,
    load_cascaded_tanks,
    load_emps,
    load_friction_damper,
    load_mr_damper,
    load_piezo_afm,
    load_piezo_fsm,
    load_piezo_pnzt,
    load_silverbox,
)

from skhyst.diagnosis import EffectSearchCV
from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import CoulombFriction, PrandtlIshlinskii
from skhyst.linear import DynamicStiffness, Gain, ModalModel, SecondOrderMode, TransferFunction
from skhyst.optimize._problem import path_of
from skhyst.records import iter_records, stack_records

BOUC_WEN_PERIOD, BOUC_WEN_RATE = 8192, 750.0  # samples, Hz
EMPS_LEAD = 2  # samples
FSM_PERIOD, FSM_RATE = 8192, 6400.0
FSM_STATES = 28
SILVERBOX_RATE = 610.35  # Hz
SILVERBOX_PART = 0.9
TANKS_INTERVAL, TANKS_LEAD = 4.0, 512  # s, samples


@dataclass(frozen=True)
class Case:
    """A recording and what is known about it.

    Parameters
    ----------
    load : callable
        Of the folder of the recordings; returns X, y to search and X, y held out.
    declared : callable
        Returns the unfitted declared model.
    expected : tuple of tuple of str
        Effects that should be named, one of them first; any of each entry.
    unit : str
        Of the errors.
    scale : float, default=1.0
        Errors in that unit over those of the response.
    target : float, optional
        Largest error after, in the unit, or in % of the range where ``relative``.
    relative : bool, default=False
    reference : str
        Figures of others.
    washout : int, optional
        Samples at the start of each record of the fit that are not scored.
    lead : int, optional
        The same of each record held out; that of the fit where None.
    folder : str, optional
        Of the recording; the name of the case where empty.
    """

    load: Callable
    declared: Callable
    expected: tuple
    unit: str
    scale: float = 1.0
    target: float | None = None
    relative: bool = False
    reference: str = ""
    washout: int | None = None
    lead: int | None = None
    folder: str = ""

    def search(self, **options):
        """Return the unfitted search."""
        return EffectSearchCV(self.declared(), washout=self.washout, random_state=0, **options)


def relabelled(records):
    """Return records, a dict by their labels, without the labels that they had."""
    return {
        label: (X.droplevel("record"), y.droplevel("record")) for label, (X, y) in records.items()
    }


def piezo_fsm(data):
    """First displacement of the mirror at 100 and 200 mV; tested at 200 mV.

    The linear model of 28 states fitted at 100 mV is held: its free run is the drive.
    """
    levels = {level: load_piezo_fsm(level, data=data) for level in (100, 200)}
    linear = ModalModel(FSM_STATES, transient_periods=0, dt=1.0 / FSM_RATE)
    with warnings.catch_warnings():  # of so many states some go on moving, by less than matters
        warnings.simplefilter("ignore", ConvergenceWarning)
        linear.fit(*levels[100])

    def foreseen(level, X, Y):
        drive = np.asarray(linear.predict(X))[:, :1]
        X = pd.DataFrame(drive, X.index, ["linear"])
        return {f"{level} mV, {label}": part for label, *part in iter_records(X, Y["y0"])}

    records = foreseen(100, *levels[100]) | foreseen(200, *levels[200])
    test = foreseen(200, *load_piezo_fsm(200, "test", data=data))
    return *stack_records(relabelled(records)), *stack_records(relabelled(test))


def emps(data):
    """Each force with the position two samples later.

    The acceleration is taken over the last samples of the position, whose encoder shows through in
    less; so shifted it is that of the instant of the force.
    """

    def lead(X, y):
        return (
            pd.DataFrame({"position": X["position"].to_numpy()[EMPS_LEAD:]}, y.index[:-EMPS_LEAD]),
            y[:-EMPS_LEAD],
        )

    return *lead(*load_emps("train", data)), *lead(*load_emps("test", data))


def mr_damper(data, currents=(0.5,)):
    """Sine of 5 mm and 3 Hz, the second half of each record held out."""
    X, y = load_mr_damper(currents=currents, data=data)
    if len(currents) == 1:
        X = X[["displacement"]]
    groups = y.groupby(level="record", sort=False)
    first = (groups.cumcount() < 0.5 * groups.transform("size")).to_numpy()
    return X[first], y[first], X[~first], y[~first]


def silverbox(data):
    """Nine tenths of the multisines; the last tenth held out."""
    X, y = load_silverbox("multisine", data)
    cut = int(SILVERBOX_PART * len(X))
    return X[:cut], y[:cut], X[cut:], y[cut:]


def bouc_wen_benchmark(data):
    """Five periods from rest; the test period, which is in steady state, is gone through twice."""
    X, y = load_bouc_wen_benchmark("train", data=data)
    X_test, y_test = load_bouc_wen_benchmark("test", data=data)
    return X, y, np.tile(X_test, (2, 1)), np.tile(y_test, 2)


def cascaded_tanks(data):
    """1024 samples each; the test is led in by what came before the record to fit on."""
    X, y = load_cascaded_tanks("train", data)
    X_test, y_test = load_cascaded_tanks("test", data)
    linear = TransferFunction(2, dt=TANKS_INTERVAL, initial_state="estimate").fit(X, y)
    before = path_of(linear.initial_drive_[0])[:, None]
    lead = np.full(TANKS_LEAD, y_test[0])
    return X, y, np.concatenate([before, X_test]), np.concatenate([lead, y_test])


CASES = {
    "piezo_afm": Case(
        lambda data: load_piezo_afm(data=data),
        PrandtlIshlinskii,
        (("asymmetry",),),
        "counts",
        target=0.7,
        relative=True,
        reference="rough fits: linear 4.0 %, PI 2.6 %, with asymmetry 0.9 %",
    ),
    "emps": Case(
        emps,
        lambda: DynamicStiffness(fit_stiffness=False, smoothing=EMPS_LEAD),
        (("friction",),),
        "N",
    ),
    "silverbox": Case(
        silverbox,
        lambda: SecondOrderMode(dt=1.0 / SILVERBOX_RATE),
        (("cubic_stiffness",),),
        "mV",
        scale=1e3,
        target=1.0,
        reference="NARX 7.7 mV, best published well under 1 mV",
    ),
    "cascaded_tanks": Case(
        cascaded_tanks,
        lambda: TransferFunction(2, dt=TANKS_INTERVAL, initial_state="estimate"),
        (("static_nonlinearity", "input_saturation", "output_saturation"),),
        "V",
        target=0.35,
        reference="linear 0.757 V, PNLSS 0.450 V, NLSS2 0.343 V",
        lead=TANKS_LEAD,
    ),
    "bouc_wen_benchmark": Case(
        bouc_wen_benchmark,
        lambda: SecondOrderMode(dt=1.0 / BOUC_WEN_RATE),
        (("hysteresis",),),
        "1e-5 m",
        scale=1e5,
        target=2.0,
        reference="NFIR 16.3, dynoNet 4.5, PNLSS 1.87 (1e-5 m)",
        lead=BOUC_WEN_PERIOD,
    ),
    "mr_damper": Case(
        mr_damper,
        lambda: DynamicStiffness(fit_mass=False, fit_stiffness=False),
        (("friction",), ("hysteresis",)),
        "N",
        target=3.5,
        relative=True,
        reference="viscous 20.2 %, Coulomb 12.0 %, stop operators 4.3 %",
    ),
    "mr_damper_currents": Case(
        lambda data: mr_damper(data, (0.0, 0.5, 1.0)),
        lambda: DynamicStiffness(fit_mass=False, fit_stiffness=False),
        (("friction", "auxiliary_input"), ("friction", "auxiliary_input")),
        "N",
        folder="mr_damper",
    ),
    "friction_damper": Case(
        lambda data: load_friction_damper(data=data),
        CoulombFriction,
        (("backlash", "hysteresis"),),
        "kip",
        reference="viscous 18.5 %, Coulomb 17.8 %, stop operators 6.1 %",
    ),
    "piezo_pnzt": Case(
        lambda data: load_piezo_pnzt(data=data),
        PrandtlIshlinskii,
        (("asymmetry", "static_nonlinearity"),),
        "nm",
        reference="1.9 kV, in sample: PI 9.9 %, with an even term 2.9 %",
        washout=401,
    ),
    "piezo_fsm": Case(
        piezo_fsm,
        Gain,
        (("amplitude_dependence", "hysteresis"),),
        "um",
        scale=1e6,
        target=0.15,
        reference="linear of 100 mV 0.555 um, of all levels 0.179 um, nonlinear 0.131 um",
        washout=FSM_PERIOD,
    ),
    "bh_loops": Case(
        lambda data: load_bh_loops(data=data),
        PrandtlIshlinskii,
        (("output_saturation", "input_saturation"),),
        "mT",
        scale=1e3,
        washout=129,
    ),
}


def first_alone(X, y, X_test, y_test):
    """Return the first record, and all others held out."""

    def bare(own):
        several = getattr(getattr(own, "index", None), "nlevels", 1) > 1
        return own.droplevel("record") if several else own

    parts = [
        tuple(map(bare, part)) for _, *part in [*iter_records(X, y), *iter_records(X_test, y_test)]
    ]
    (X, y), *rest = parts
    return X, y, *stack_records(dict(enumerate(rest)))


def parts(case, data, alone=False):
    """Return X, y to search and X, y held out."""
    return first_alone(*case.load(data)) if alone else case.load(data)


def searched(case, X, y, jobs=None):
    """Return the fitted search, which leaves out of held-out errors what the case says."""
    search = case.search(n_jobs=jobs).fit(X, y)
    return search if case.lead is None else search.set_params(washout=case.lead)


def search_one(case, data, jobs, again, alone):
    """Return the row of the table."""
    X, y, X_test, y_test = parts(case, data, alone)
    start = time.perf_counter()
    search = searched(case, X, y, jobs)
    seconds = time.perf_counter() - start
    claims = list(search.history_.itertuples())
    span = np.ptp(np.asarray(y_test)) / 100.0
    errors = [
        search.held_out_error(X_test, y_test, declared=declared) for declared in (True, False)
    ]
    after = errors[1] / span if case.relative else errors[1] * case.scale
    target = "-"
    if case.target is not None:
        verdict = "met" if after <= case.target else "missed"
        target = f"{case.target:g} {'%' if case.relative else case.unit}, {verdict}"
    row = {
        "declared": type(case.declared()).__name__,
        "named": "; ".join(map(described, claims)) or "nothing",
        "as written": as_written(case.expected, claims),
        "verdict": search.verdict_,
        "before": f"{errors[0] * case.scale:.4g} {case.unit} ({errors[0] / span:.3f} %)",
        "after": f"{errors[1] * case.scale:.4g} {case.unit} ({errors[1] / span:.3f} %)",
        "target": target,
        "reference": case.reference or "-",
        "seconds": round(seconds, 1),
    }
    if again:
        try:
            second = case.search(n_jobs=jobs).set_params(estimator=search.best_estimator_)
            second.fit(X, y)
            row["searched again"] = f"{', '.join(second.effects_) or 'nothing'}; {second.verdict_}"
        except ValueError as error:  # a model with constants of each record is not declared
            row["searched again"] = f"refused: {error}"
    return row


def described(claim):
    """Return the name of an effect and of those that the data do not tell from it."""
    others = ", ".join(claim.ambiguous_with)
    return f"{claim.effect} (or {others})" if others else claim.effect


def as_written(expected, claims):
    """Tell whether the effects that are known to be missing are named, one of them first.

    "among those told": the search names others, and says that it cannot tell these from them.
    """
    if len(claims) < len(expected):
        return "no"
    known = {name for names in expected for name in names}
    claimed = {claim.effect for claim in claims}
    told = claimed.union(*(claim.ambiguous_with for claim in claims))
    if claims[0].effect in known and all(claimed & set(names) for names in expected):
        return "yes"
    if all(told & set(names) for names in expected):
        return "among those told"
    return "no"


def by_command_line(data, jobs):
    """Return what the command line says about the held-out part of piezo_afm."""
    path = Path(data) / "piezo_afm/SG_data_triangle_sin_raw.mat"
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder, "result.json")
        command = [sys.executable, "-m", "skhyst", "diagnose", str(path), "--drive", "V"]
        command += ["--response", "SG[0]", "--sampling-rate", "1", "--train-fraction", "0.6"]
        command += ["--model", "prandtl_ishlinskii", "--seed", "0", "--jobs", str(jobs), "--quiet"]
        subprocess.run([*command, "--json", str(output)], check=True)
        return json.loads(output.read_text())["held_out"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED)
    parser.add_argument("--only", default="", help=f"of {', '.join(CASES)}, by commas")
    parser.add_argument("--jobs", type=int, default=2, help="processes of a search")
    parser.add_argument("--again", action="store_true", help="search each augmented model again")
    alone = "search the first record of each alone, all others held out"
    parser.add_argument("--alone", action="store_true", help=alone)
    parser.add_argument("--output", type=Path, help="CSV file of the table")
    options = parser.parse_args()
    names = [name for name in options.only.split(",") if name] or list(CASES)
    unknown = sorted(set(names) - set(CASES))
    if unknown:
        parser.error(f"--only: there is no {', '.join(unknown)}; there are {', '.join(CASES)}")
    rows, failed = {}, False
    for name in names:
        folder = options.data / (CASES[name].folder or name)
        if not folder.exists():
            print(f"{name}: left out, {folder} is absent")
            continue
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what data do not determine is not the matter here
                row = search_one(
                    CASES[name], options.data, options.jobs, options.again, options.alone
                )
        except Exception as error:  # one recording does not keep the others from the table
            print(f"{name}: failed, {type(error).__name__}: {error}", flush=True)
            failed = True
            continue
        rows[name] = row
        print(f"{name}\n" + "\n".join(f"  {k}: {v}" for k, v in row.items()), flush=True)
    table = pd.DataFrame.from_dict(rows, orient="index").rename_axis("recording")
    print("\n" + table.to_string())
    if rows:
        right = sum(row["as written"] == "yes" for row in rows.values())
        print(f"\nnamed as written: {right} of {len(rows)}")
    if "piezo_afm" in rows:
        held_out = by_command_line(options.data, options.jobs)
        print(f"piezo_afm by the command line: {held_out}")
    if options.output:
        table.to_csv(options.output)
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
