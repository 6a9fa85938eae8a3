"""A newcomer with fifty files of laboratories: each is read or searched, and the truth is found.

    python tests/newcomer/newcomer.py [--fresh] [--files NAME,...] [--folder DIR] [--jobs N]

Each file has a trap, as files have: milliseconds, decimal commas, units with a µ in latin-1,
sheets, structs, groups, no time at all, readings that are codes, uneven times. The device behind it
is integrated here, by numpy alone, and has hysteresis and one effect more, or none. The newcomer
calls `skhyst diagnose FILE`, which compares models and declares one. What that model has and what
the search finds missing must be the hysteresis of the device and its effect, nothing else, and the
effect's frequency within 2 %; or a refusal that names the one option that mends it, and the truth
with that option. Of the files in `readings.py` it is tried whether `skhyst inspect FILE` shows
drive, response, units, interval and records as they are. `--fresh` makes a virtual environment
first, installs skhyst into it as the README says, and runs the command that the README shows.
Prints a table; exits with 1 where one fails.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
import venv
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from readings import READINGS

__all__ = ["CASES", "Outcome", "inspected", "run"]

ROOT = Path(__file__).resolve().parents[2]
_DT = 1e-3  # s
_MODE = 40.0  # Hz
_TOLERANCE = 0.02
_DECLARED = {  # what a model that may be declared has
    "gain": "",
    "prandtl_ishlinskii": "hysteresis",
    "first_order_lag": "lag",
    "second_order_mode": "resonance",
}


def plays(drive):
    """Return the sum of play operators: hysteresis that does not depend on the rate."""
    total = np.zeros_like(drive)
    for width, weight in ((0.0, 10.0), (4.0, 3.0), (10.0, 3.0), (20.0, 2.0)):
        state = 0.0
        for k, u in enumerate(drive):
            state = min(max(state, u - width), u + width)
            total[k] += weight * state
    return 1e-3 * total


def resonance(path, dt, frequency=_MODE, damping=0.05, n_substeps=10):
    """Return the motion of a mass on a spring that follows a path, by symplectic Euler steps."""
    omega, step = 2.0 * np.pi * frequency, dt / n_substeps
    x, v, before, motion = path[0], 0.0, path[0], np.empty_like(path)
    for k, now in enumerate(path):
        for j in range(n_substeps):
            at = before + (now - before) * (j + 0.5) / n_substeps
            v += step * (omega**2 * (at - x) - 2.0 * damping * omega * v)
            x += step * v
        before, motion[k] = now, x
    return motion


def creep(path, dt, share=0.25, tau=0.15):
    """Return the path with a unit that relaxes beside it."""
    state, motion = path[0], np.empty_like(path)
    for k, now in enumerate(path):
        motion[k] = now + share * state
        state += (1.0 - np.exp(-dt / tau)) * (now - state)
    return motion


def lag(path, dt, tau=8e-3):
    """Return the path behind a first-order low-pass."""
    state, motion, before = path[0], np.empty_like(path), path[0]
    for k, now in enumerate(path):
        state += (1.0 - np.exp(-dt / tau)) * (0.5 * (now + before) - state)
        before, motion[k] = now, state
    return motion


def clipped(path, dt):
    """Return the path as a sensor at its end of range reads it."""
    return np.minimum(path, np.quantile(path, 0.9))


def nothing(path, dt):
    """Return the path."""
    return path


def drive_signal(rng, n):
    """Return a drive in V that starts at zero: a sine that swells, and steps of random height."""
    t = _DT * np.arange(n)
    swell = 0.3 + 0.7 * np.abs(np.sin(2.0 * np.pi * 0.2 * t))
    steps = np.repeat(rng.uniform(-1.0, 1.0, n // 100 + 1), 100)[:n]
    return 30.0 * np.sin(2.0 * np.pi * 2.0 * t) * swell + 15.0 * steps * (t > 0.05)


def recorded(law, seed, n=3000, noise=2e-3):
    """Return time (s), drive (V) and response (um) of a recording."""
    rng = np.random.default_rng(seed)
    u = drive_signal(rng, n)
    y = law(plays(u), _DT)
    return _DT * np.arange(n), u, y + noise * np.ptp(y) * rng.normal(size=n)


def write_milliseconds(path, law):
    t, u, y = recorded(law, 1)
    frame = pd.DataFrame({"time_ms": np.round(1e3 * t), "voltage": u, "position": y})
    frame.astype({"time_ms": int}).to_csv(path, index=False)


def write_spreadsheet_text(path, law):
    t, u, y = recorded(law, 2)
    frame = pd.DataFrame({"Zeit [s]": t, "Spannung [V]": u, "Weg [um]": y})
    frame.to_csv(path, index=False, sep=";", decimal=",", encoding="utf-8-sig")


def write_instrument_text(path, law):
    rows = zip(*recorded(law, 3), strict=True)
    lines = ["Controller E-625", "Operator: Müller", "Rate: 1000 Hz", "", "t\tU\tx", "s\tV\tµm"]
    lines += ["\t".join(f"{value:.7g}" for value in row) for row in rows]
    path.write_bytes("\r\n".join([*lines, ""]).encode("latin-1"))


def write_workbook(path, law):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.title = "Notes"
    book.active.append(["Operator", "Smith"])
    sheet = book.create_sheet("Data")
    for head in (["Time", "Command", "Position"], ["s", "V", "µm"]):
        sheet.append(head)
    for row in zip(*recorded(law, 4), strict=True):
        sheet.append([float(value) for value in row])
    book.save(path)


def write_struct(path, law):
    from scipy.io import savemat

    t, u, y = recorded(law, 5)
    savemat(path, {"rig": {"t": t, "u": u, "y": y, "operator": "Smith"}, "version": 3.0})


def write_matlab_groups(path, law):
    import h5py

    names = ("t", "drive", "sensor")
    with h5py.File(path, "w", userblock_size=512) as file:
        for run, seed in (("run1", 6), ("run2", 16)):
            for name, values in zip(names, recorded(law, seed, n=2000), strict=True):
                file[f"{run}/{name}"] = values[None, :]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def write_tdms(path, law):
    import nptdms

    _, u, y = recorded(law, 7)
    channels = [
        nptdms.ChannelObject("Log", name, values, {"wf_increment": _DT, "unit_string": unit})
        for name, values, unit in (("Dev1/ao0", u, "V"), ("Dev1/ai0", y, "V"))
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def write_without_time(path, law):
    _, u, y = recorded(law, 8)
    pd.DataFrame({"input": u, "output": y}).to_csv(path, index=False)


def write_wav(path, law):
    from scipy.io import wavfile

    _, u, y = recorded(law, 9)
    channels = [values / np.abs(values).max() for values in (u, y)]
    wavfile.write(path, round(1.0 / _DT), np.column_stack(channels).astype(np.float32))


def write_twice(path, law):
    t, u, _ = recorded(law, 10)
    pd.DataFrame({"time": t, "drive": u, "response": u}).to_csv(path, index=False)


def write_uneven(path, law):
    rng = np.random.default_rng(11)
    t, u, y = recorded(law, 11, n=4000)
    kept = np.sort(rng.choice(len(t), 3200, replace=False))
    frame = pd.DataFrame({"timestamp": t, "voltage": u, "displacement": y})
    frame.iloc[kept].to_csv(path, index=False)


def write_coded(path, law):
    t, u, y = recorded(law, 12)
    y[np.random.default_rng(12).choice(len(y), 40, replace=False)] = -9999.0
    pd.DataFrame({"time": t, "voltage": u, "position": y}).to_csv(path, index=False)


def write_two_runs(path, law):
    runs = [(label, recorded(law, seed, n=2000)) for label, seed in (("up", 13), ("down", 23))]
    frames = [pd.DataFrame({"run": label, "t": t, "u": u, "y": y}) for label, (t, u, y) in runs]
    pd.concat(frames).to_csv(path, index=False)


def write_small_units(path, law):
    t, u, y = recorded(law, 14)
    columns = {"t (ms)": 1e3 * t, "amplifier (mV)": 1e3 * u, "interferometer (nm)": 1e3 * y}
    pd.DataFrame(columns).to_csv(path, index=False)


@dataclass(frozen=True)
class Case:
    """A file: what writes it, the law of its device, and what the newcomer may have to add."""

    write: callable
    law: callable
    effect: str  # "" where nothing is missing, "refused" where there is nothing to search
    option: tuple = ()  # the option that a refusal names
    unit: str = "um"  # of the response, as it is reported


CASES = {
    "milliseconds.csv": Case(write_milliseconds, resonance, "resonance", unit=""),
    "spreadsheet.csv": Case(write_spreadsheet_text, creep, "creep"),
    "instrument.txt": Case(write_instrument_text, resonance, "resonance", unit="µm"),
    "workbook.xlsx": Case(write_workbook, lag, "lag", unit="µm"),
    "struct.mat": Case(write_struct, nothing, "", unit=""),
    "groups.mat": Case(write_matlab_groups, resonance, "resonance", unit=""),
    "waveform.tdms": Case(write_tdms, resonance, "resonance", unit="V"),
    "no_time.csv": Case(
        write_without_time, resonance, "resonance", ("--sampling-rate", "1000"), unit=""
    ),
    "channels.wav": Case(write_wav, resonance, "resonance", ("--drive", "0"), unit=""),
    "twice.csv": Case(write_twice, nothing, "refused"),
    "uneven.csv": Case(write_uneven, resonance, "resonance", ("--resample", "auto"), unit=""),
    "coded.csv": Case(
        write_coded, clipped, "output_saturation", ("--on-missing", "interpolate"), unit=""
    ),
    "two_runs.csv": Case(write_two_runs, creep, "creep", unit=""),
    "small_units.csv": Case(write_small_units, resonance, "resonance", unit="nm"),
}


@dataclass(frozen=True)
class Outcome:
    """What a newcomer saw: what was written, the exit code, and the seconds that it took."""

    text: str
    code: int
    seconds: float


def shell(python, jobs):
    """Return functions that run `skhyst diagnose` and `skhyst inspect` as from a shell."""

    def ran(*words):
        start = time.perf_counter()
        command = [str(python), "-m", "skhyst", *map(str, words)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=900, check=False)
        return Outcome(done.stdout + done.stderr, done.returncode, time.perf_counter() - start)

    def diagnose(path, *options):
        return ran("diagnose", path, "--quiet", "--jobs", jobs, *options)

    return diagnose, lambda *words: ran("inspect", *words)


def inspected(name, folder, inspect):
    """Write the files of a reading, and return (what is wrong or "", the outcome).

    Parameters
    ----------
    name : str
        Of the reading.
    folder : Path
        Where the files are written.
    inspect : callable
        Of paths and options, that returns an Outcome.
    """
    case = READINGS[name]
    paths = case.write(Path(folder))
    outcome = inspect(*paths, *["--join"] * (len(paths) > 1), *case.option)
    return case.fault(outcome.code, outcome.text), outcome


def run(name, folder, diagnose):
    """Write a file, search it as a newcomer would, and return (what is wrong or "", outcomes).

    Parameters
    ----------
    name : str
        Of the case.
    folder : Path
        Where the file is written.
    diagnose : callable
        Of a path and options, that returns an Outcome.
    """
    case, path = CASES[name], Path(folder, name)
    case.write(path, case.law)
    kept = path.with_name(f"{name}.json")
    written = ["--json", str(kept), "--force"]
    outcomes = [diagnose(path, *written)]
    if case.effect == "refused":
        told = outcomes[0].code == 1 and "another signal" in outcomes[0].text
        return "" if told else "not refused", outcomes
    if case.option:
        if case.option[0] not in outcomes[0].text:
            return f"{case.option[0]} is not named", outcomes
        outcomes.append(diagnose(path, *case.option, *written))
    return _fault(case, outcomes[-1], kept), outcomes


def _fault(case, outcome, found):
    """Return what is wrong in what was told, or an empty text."""
    if outcome.code:
        return f"exit code {outcome.code}"
    found = json.loads(found.read_text(encoding="utf-8"))
    declared = found["comparison"]["taken"]
    told = {*found["effects"], _DECLARED.get(declared, declared)} - {""}
    if told != {"hysteresis", case.effect} - {""}:
        return f"{declared}, missing: {', '.join(found['effects'])}"
    if case.effect == "resonance":
        frequencies = [
            own["value"] * (1.0 if own["unit"] == "Hz" else 0.5 / np.pi)
            for own in found["parameters"]["augmented"]
            if "natural_frequenc" in own["name"]
        ]
        if not frequencies or abs(frequencies[0] / _MODE - 1.0) > _TOLERANCE:
            return f"frequencies {frequencies}"
    return "" if found["units"]["response"] == case.unit else f"unit {found['units']['response']}"


def fresh_python(folder):
    """Install skhyst into a new environment as the README says, and run the command it shows."""
    venv.create(folder, with_pip=True)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    command = re.search(r"^python -m pip install .* && skhyst demo$", text, re.MULTILINE)[0]
    command = f"{command} --output {folder}/demo --force && python -m pip install -e '.[io]'"
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(["bash", "-ec", command], cwd=ROOT, env=os.environ | {"PATH": path}, check=True)
    return folder / "bin" / "python"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fresh", action="store_true", help="in a new virtual environment")
    parser.add_argument("--files", help="comma-separated names")
    parser.add_argument("--folder", type=Path, help="where the files are kept")
    parser.add_argument("--jobs", default="-1", help="processes of a search")
    options = parser.parse_args()
    faults = 0
    with TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary, "files")
        folder.mkdir(parents=True, exist_ok=True)
        python = fresh_python(Path(temporary, "env")) if options.fresh else sys.executable
        diagnose, inspect = shell(python, options.jobs)
        print(f"{'file':26s} {'truth':18s} {'option':36s} {'seconds':>8s}  outcome", flush=True)
        names = options.files.split(",") if options.files else [*READINGS, *CASES]
        for name in names:
            if name in READINGS:
                case = READINGS[name]
                truth = f"refused: {case.refused}" if case.refused else f"{case.drive}"
                fault, outcome = inspected(name, folder, inspect)
                outcomes = [outcome]
            else:
                case = CASES[name]
                truth = case.effect or "nothing"
                fault, outcomes = run(name, folder, diagnose)
            faults += bool(fault)
            seconds, option = sum(one.seconds for one in outcomes), " ".join(case.option)
            print(f"{name:26s} {truth[:18]:18s} {option:36s} {seconds:8.1f}  {fault or 'right'}")
            sys.stdout.write(f"{outcomes[-1].text}\n" if fault else "")
            sys.stdout.flush()
    print(f"{len(names) - faults} right, {faults} wrong")
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())
