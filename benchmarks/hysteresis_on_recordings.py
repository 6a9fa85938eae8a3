"""Held-out errors of hysteresis models on measured recordings.

    python benchmarks/hysteresis_on_recordings.py [--data ../shared/data] [--only mr_damper,...]

Each recording is held out by amplitude, by frequency or by its later part; every model that applies
is fitted to the rest. Errors are the root mean square over the range of the
held-out response. Folders that are absent are named and left out.
"""

import argparse
import time
import warnings
from pathlib import Path

import pandas as pd
from recordings import (
    SHARED,
    load_bh_loops,
    load_friction_damper,
    load_mr_damper,
    load_piezo_afm,
    load_piezo_pnzt,
    load_pneumatic_cylinder,
    split_in_time,
)
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from skhyst import hysteresis
from skhyst.compose import Cascade
from skhyst.metrics import nrmse
from skhyst.preprocessing import GeneralizedInputGradient
from skhyst.static import SmoothCurve

STEP = 0.005  # s, of the damper's recordings, which come at two rates
MR_TESTS = ("10mm1Hz", "25mm0x1Hz", "25mm0x25Hz", "25mm0x5Hz", "2mm5Hz")


def whole(recording):
    """Return a recording whose test is scored from its first sample on."""
    return *recording, 0


def looped(recording):
    """Return a recording whose test is a loop gone through twice, of which the second counts."""
    return *recording, len(recording[3]) // 2


def mr_damper(data, current):
    """Force (N) of a displacement (mm) at one current; the test of 5 mm and 3 Hz held out."""
    options = {"currents": (current,), "step": STEP, "data": data}
    X, y = load_mr_damper(MR_TESTS, **options)
    X_test, y_test = load_mr_damper(("5mm3Hz",), **options)
    return whole((X[["displacement"]], y, X_test[["displacement"]], y_test))


def mr_damper_in_time(data, current):
    """The 5 mm, 3 Hz recording alone, its second half held out."""
    X, y = load_mr_damper(("5mm3Hz",), (current,), data=data)
    return whole(split_in_time(X[["displacement"]], y, 0.5))


def viscous():
    """Return the linear model of displacement and velocity."""
    return make_pipeline(
        GeneralizedInputGradient().set_output(transform="pandas"), LinearRegression()
    )


def curved(model):
    """Return a model whose response goes through a smooth curve."""
    return Cascade([("hysteresis", model), ("curve", SmoothCurve(5))])


FORCE = {
    "viscous": viscous,
    "PrandtlIshlinskii, stops": lambda: hysteresis.PrandtlIshlinskii(form="stop"),
    "MaxwellSlip": hysteresis.MaxwellSlip,
    "MaxwellSlip, curve": lambda: curved(hysteresis.MaxwellSlip()),
    "Dahl": lambda: hysteresis.Dahl(fit_stiffness=True),
    "LuGre": hysteresis.LuGre,
    "LuGre, curve": lambda: curved(hysteresis.LuGre()),
    "Duhem": hysteresis.Duhem,
    "BoucWen": hysteresis.BoucWen,
    "BoucWen, asymmetric": lambda: hysteresis.BoucWen(asymmetry=True),
}
LOOPS = {
    "PrandtlIshlinskii": hysteresis.PrandtlIshlinskii,
    "PrandtlIshlinskii, curve": lambda: curved(hysteresis.PrandtlIshlinskii()),
    "ModifiedPrandtlIshlinskii": hysteresis.ModifiedPrandtlIshlinskii,
    "Preisach": hysteresis.Preisach,
    "KrasnoselskiiPokrovskii": hysteresis.KrasnoselskiiPokrovskii,
    "BoucWen": hysteresis.BoucWen,
    "BoucWen, asymmetric": lambda: hysteresis.BoucWen(asymmetry=True),
    "Duhem": hysteresis.Duhem,
    "SystemLevelHysteresis": hysteresis.SystemLevelHysteresis,
}
MAGNETIC = {**LOOPS, "JilesAtherton": hysteresis.JilesAtherton}
CASES = {
    "mr_damper 0 A, 5 mm 3 Hz": (lambda d: mr_damper(d, 0.0), FORCE),
    "mr_damper 0.5 A, 5 mm 3 Hz": (lambda d: mr_damper(d, 0.5), FORCE),
    "mr_damper 1 A, 5 mm 3 Hz": (lambda d: mr_damper(d, 1.0), FORCE),
    "mr_damper 0 A, second half": (lambda d: mr_damper_in_time(d, 0.0), FORCE),
    "mr_damper 0.5 A, second half": (lambda d: mr_damper_in_time(d, 0.5), FORCE),
    "mr_damper 1 A, second half": (lambda d: mr_damper_in_time(d, 1.0), FORCE),
    "friction_damper, last 40 %": (lambda d: whole(load_friction_damper(data=d)), FORCE),
    "pneumatic_cylinder, last 40 %": (
        lambda d: whole(load_pneumatic_cylinder(data=d)),
        FORCE,
    ),
    "bh_loops, second amplitude": (lambda d: looped(load_bh_loops((1,), data=d)), MAGNETIC),
    "bh_loops, third amplitude": (lambda d: looped(load_bh_loops((2,), data=d)), MAGNETIC),
    "piezo_pnzt, 1.5 kV": (lambda d: looped(load_piezo_pnzt((1.5,), data=d)), LOOPS),
    "piezo_afm, last 40 %": (lambda d: whole(load_piezo_afm(data=d)), LOOPS),
}


def table(cases, data):
    """Return one row a case and model: error in the fit and held out, seconds, evaluations."""
    rows = []
    for case, (load, models) in cases.items():
        try:
            X, y, X_test, y_test, first = load(data)
        except FileNotFoundError as error:
            print(f"{case}: left out, {error}")
            continue
        print(f"{case}: {len(y)} samples to fit, {len(y_test)} held out", flush=True)
        for name, make in models.items():
            start = time.perf_counter()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what data do not determine is not the matter here
                model = make().fit(X, y)
            seconds = time.perf_counter() - start
            errors = [
                100 * nrmse(y, model.predict(X)),
                100 * nrmse(y_test[first:], model.predict(X_test)[first:]),
            ]
            rows.append((case, name, *errors, seconds, getattr(model, "n_evaluations_", 0)))
            print(
                f"  {name:<26} fit {errors[0]:6.2f} %  held out {errors[1]:6.2f} %  "
                f"{seconds:5.1f} s  {rows[-1][-1]} evaluations",
                flush=True,
            )
    return pd.DataFrame(
        rows, columns=["case", "model", "fit_percent", "held_out_percent", "seconds", "evaluations"]
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED)
    parser.add_argument("--only", default="", help="cases whose name starts so, by commas")
    parser.add_argument("--output", type=Path, help="CSV file of the table")
    options = parser.parse_args()
    starts = tuple(options.only.split(","))
    cases = {name: case for name, case in CASES.items() if name.startswith(starts)}
    found = table(cases, options.data)
    if options.output:
        found.to_csv(options.output, index=False)
    wide = found.pivot_table("held_out_percent", "model", "case", sort=False)
    print("\nheld-out error, % of range\n" + wide.round(2).to_string(na_rep="-"))


if __name__ == "__main__":
    main()
