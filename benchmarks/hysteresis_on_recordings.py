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

import numpy as np
import pandas as pd
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline

from skhyst import hysteresis
from skhyst.compose import Cascade
from skhyst.metrics import nrmse
from skhyst.preprocessing import GeneralizedInputGradient
from skhyst.records import iter_records, read_records, resample_records, stack_records
from skhyst.static import SmoothCurve

SHARED = Path(__file__).resolve().parents[1] / "../shared/data"
STEP = 0.005  # s, of the damper's recordings, which come at two rates
PNZT = ("08kv", "1kv", "11kv", "15kv", "19kv")


def joined(recordings):
    """Stack recordings that are frames with a record index of their own."""
    parts = [part for X, y in recordings for _, *part in iter_records(X, y)]
    return stack_records([tuple(part) for part in parts], labels=range(len(parts)))


def later(X, y, part):
    """Cut a recording in time."""
    n = int(part * len(y))
    return X.iloc[:n], y.iloc[:n], X.iloc[n:], y.iloc[n:], 0


def around(loops, held_out):
    """Run each loop twice: the first turn only brings the memory into it, and is not scored."""
    turns = [(np.tile(u, 2), np.tile(y, 2)) for u, y in loops]
    first = len(loops[held_out][0])
    test = stack_records([turns.pop(held_out)])
    return *stack_records(turns), *test, first


def mr_damper(data, current, held_out):
    """Force (N) of a displacement (mm), one file an amplitude and frequency."""
    train = []
    for path in sorted((data / "mr_damper").glob(f"*Hz{current}A.txt")):
        X, y = read_records(path, time=0, drive=1, response=3)
        X, y = resample_records(X, y, dt=STEP)
        if path.stem.startswith(held_out):
            test = X, y
        else:
            train.append((X, y))
    return *joined(train), *test, 0


def mr_damper_in_time(data, current):
    """The 5 mm, 3 Hz recording alone, its second half held out."""
    X, y = read_records(data / f"mr_damper/5mm3Hz{current}A.txt", time=0, drive=1, response=3)
    return later(X, y, 0.5)


def bh_loops(data, held_out):
    """Flux density (T) of a field (A/m), one column an amplitude."""
    folder, loops = data / "bh_loops/1_isotropic", []
    for column in range(4):
        H, _ = read_records(
            folder / "H_MnZn_ferrite.mat",
            drive=f"HmeasT[{column}]",
            response=f"HmeasT[{column}]",
            sampling_rate=1.0,
        )
        _, B = read_records(
            folder / "B_MnZn_ferrite.mat",
            drive=f"BmeasT[{column}]",
            response=f"BmeasT[{column}]",
            sampling_rate=1.0,
        )
        loops.append((H.to_numpy()[:, 0], B.to_numpy()))
    return around(loops, held_out)


def friction_damper(data):
    """Force (kip) of a displacement (in) at 0.5 Hz, the last 40 % held out."""
    path = data / "friction_damper/dataset-1_0.5Hz20lbtension.json"
    X, y = read_records(path, time="data[0]", drive="data[1]", response="data[2]")
    return later(X, y, 0.6)


def pneumatic_cylinder(data):
    """Force (N) of a displacement (mm), the last 40 % held out."""
    X, y = read_records(data / "pneumatic_cylinder/KDN_1bar.csv", time=0, drive=4, response=6)
    X, y = resample_records(X, y, dt=10.0, max_gap=100.0)  # its clock is in ms, and jitters
    return later(X, y, 0.6)


def piezo_pnzt(data, held_out):
    """Displacement (nm) of a voltage (V), one loop an amplitude."""
    path, loops = data / "piezo_pnzt/MeasurementData.mat", []
    for name in PNZT:
        X, y = read_records(
            path, drive=f"Vplus_{name}", response=f"Displacement_{name}", sampling_rate=1.0
        )
        loops.append((X.to_numpy()[:, 0], y.to_numpy()))
    return around(loops, held_out)


def piezo_afm(data):
    """Strain gauge (counts) of a voltage (V), the last 40 % held out."""
    path = data / "piezo_afm/SG_data_triangle_sin_raw.mat"
    X, y = read_records(path, drive="V", response="SG[0]", sampling_rate=1.0)
    return later(X, y, 0.6)


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
    "mr_damper 0 A, 5 mm 3 Hz": (lambda d: mr_damper(d, "0", "5mm"), FORCE),
    "mr_damper 0.5 A, 5 mm 3 Hz": (lambda d: mr_damper(d, "0x5", "5mm"), FORCE),
    "mr_damper 1 A, 5 mm 3 Hz": (lambda d: mr_damper(d, "1", "5mm"), FORCE),
    "mr_damper 0 A, second half": (lambda d: mr_damper_in_time(d, "0"), FORCE),
    "mr_damper 0.5 A, second half": (lambda d: mr_damper_in_time(d, "0x5"), FORCE),
    "mr_damper 1 A, second half": (lambda d: mr_damper_in_time(d, "1"), FORCE),
    "friction_damper, last 40 %": (friction_damper, FORCE),
    "pneumatic_cylinder, last 40 %": (pneumatic_cylinder, FORCE),
    "bh_loops, second amplitude": (lambda d: bh_loops(d, 1), MAGNETIC),
    "bh_loops, third amplitude": (lambda d: bh_loops(d, 2), MAGNETIC),
    "piezo_pnzt, 1.5 kV": (lambda d: piezo_pnzt(d, 3), LOOPS),
    "piezo_afm, last 40 %": (piezo_afm, LOOPS),
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
