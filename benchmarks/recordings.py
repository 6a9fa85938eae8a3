"""Loaders of measured recordings, which are not part of the project: a folder next to it."""

import os
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from skhyst.records import read_records, resample_records, stack_records

__all__ = [
    "SHARED",
    "load_bh_loops",
    "load_bouc_wen_benchmark",
    "load_cascaded_tanks",
    "load_emps",
    "load_friction_damper",
    "load_mr_damper",
    "load_piezo_afm",
    "load_piezo_fsm",
    "load_piezo_pnzt",
    "load_pneumatic_cylinder",
    "load_silverbox",
    "load_wiener_hammerstein",
    "split_in_time",
]

BESIDE = Path(__file__).resolve().parents[2] / "shared/data"
SHARED = Path(os.environ.get("SKHYST_DATA", BESIDE))
FSM_RATE = 6400.0  # Hz
SILVERBOX_PARTS = {
    "arrow": slice(0, 40_700),  # a Gaussian noise of growing size
    "multisine": slice(41_270, None),  # ten realisations, one after the other
}
WIENER_HAMMERSTEIN_RATE = 51_200.0  # Hz
WIENER_HAMMERSTEIN_PARTS = {"train": slice(5_200, 105_200), "test": slice(105_200, 184_000)}
BH_FILES = {
    "ferrite": ("1_isotropic", "MnZn_ferrite"),
    "ferrite_hp": ("11_TwoStepSolver", "MnZn_HP_ferrite"),
    "steel": ("3_mixed", "M130_27s"),
}
PNZT = {0.8: "08kv", 1.0: "1kv", 1.1: "11kv", 1.5: "15kv", 1.9: "19kv"}  # level in kV, name


def split_in_time(X, y, part):
    """Cut a recording in time.

    Parameters
    ----------
    X, y : DataFrame, Series
    part : float
        Share of the samples that come first.

    Returns
    -------
    X_train, y_train, X_test, y_test
    """
    n = int(part * len(y))
    return X.iloc[:n], y.iloc[:n], X.iloc[n:], y.iloc[n:]


def _split_loops(loops, held_out, turns):
    """Stack loops, a dict of level to drive and response, without and with those held out."""
    unknown = sorted(set(held_out) - set(loops))
    if unknown:
        levels = ", ".join(map(str, loops))
        raise ValueError(f"The levels are {levels}. Got {', '.join(map(str, unknown))} instead.")
    parts = []
    for chosen in (
        [level for level in loops if level not in held_out],
        [level for level in loops if level in held_out],
    ):
        repeated = [tuple(np.tile(signal, turns) for signal in loops[level]) for level in chosen]
        parts += stack_records(repeated, labels=[str(level) for level in chosen])
    return tuple(parts)


def load_piezo_afm(axis="x", train_part=0.6, data=SHARED):
    """Load an axis of the scanner of a force microscope: slow triangles and sines, growing.

    Parameters
    ----------
    axis : {"x", "y", "z"}, default="x"
        The recordings of y and z contain lost readings.
    train_part : float, default=0.6
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X_train, y_train, X_test, y_test
        Voltage in V and reading of the strain gauge in counts, about one sample a second.
    """
    path = Path(data) / "piezo_afm/SG_data_triangle_sin_raw.mat"
    X, y = read_records(path, drive="V", response=f"SG[{'xyz'.index(axis)}]", sampling_rate=1.0)
    return split_in_time(X, y, train_part)


def load_piezo_pnzt(held_out=(1.5,), turns=2, data=SHARED):
    """Load the loops of a PNZT ceramic, one closed loop at each of five levels.

    Parameters
    ----------
    held_out : sequence of {0.8, 1.0, 1.1, 1.5, 1.9}, default=(1.5,)
        Levels in kV of the test records.
    turns : int, default=2
        How often each loop is gone through. The first turn only brings the memory into the loop,
        so that a test scores the last one alone.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X_train, y_train, X_test, y_test
        Voltage in V and displacement in nm, one record a level. There is no time base.
    """
    path, loops = Path(data) / "piezo_pnzt/MeasurementData.mat", {}
    for level, name in PNZT.items():
        X, y = read_records(
            path, drive=f"Vplus_{name}", response=f"Displacement_{name}", sampling_rate=1.0
        )
        loops[level] = X.to_numpy()[:, 0], y.to_numpy()
    return _split_loops(loops, held_out, turns)


def load_bh_loops(held_out=(2,), material="ferrite", turns=2, data=SHARED):
    """Load quasi-static magnetisation loops, one closed loop at each of several amplitudes.

    Parameters
    ----------
    held_out : sequence of int, default=(2,)
        Numbers of the amplitudes of the test records, in ascending order, from 0 on.
    material : {"ferrite", "ferrite_hp", "steel"}, default="ferrite"
        Four amplitudes each, three of the steel.
    turns : int, default=2
        How often each loop is gone through, see :func:`load_piezo_pnzt`.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X_train, y_train, X_test, y_test
        Field in A/m and flux density in T, one record an amplitude. There is no time base.
    """
    from scipy.io import loadmat

    folder, name = BH_FILES[material]
    H, B = (
        loadmat(Path(data) / "bh_loops" / folder / f"{kind}_{name}.mat")[f"{kind}measT"]
        for kind in "HB"
    )
    return _split_loops({i: (H[:, i], B[:, i]) for i in range(H.shape[1])}, held_out, turns)


def load_pneumatic_cylinder(train_part=0.6, data=SHARED):
    """Load the friction of a printed pneumatic cylinder at 1 bar.

    Parameters
    ----------
    train_part : float, default=0.6
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X_train, y_train, X_test, y_test
        Displacement in mm and force in N; the time is in ms.
    """
    path = Path(data) / "pneumatic_cylinder/KDN_1bar.csv"
    X, y = read_records(path, time=0, drive=4, response=6, time_unit="s")  # all is in ms
    X, y = resample_records(X, y, dt=10.0, max_gap=100.0)  # its clock jitters
    return split_in_time(X, y, train_part)


def load_emps(split="train", data=SHARED):
    """Load the electro-mechanical positioning system, a prismatic robot drive in closed loop.

    Parameters
    ----------
    split : {"train", "test"}, default="train"
        Two runs of the same axis along the same path; force pulses disturb the second.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : DataFrame of shape (n_samples, 1)
        Position in m, at 1 kHz.
    y : Series of shape (n_samples,)
        Force of the motor in N.
    """
    from scipy.io import loadmat

    name = {"train": "DATA_EMPS", "test": "DATA_EMPS_PULSES"}[split]
    file = loadmat(Path(data) / "emps" / f"{name}.mat")
    force = file["vir"].ravel() * file["gtau"].item()
    index = pd.Index(1e-3 * np.arange(len(force)), name="time")
    X = pd.DataFrame({"position": file["qm"].ravel()}, index)
    return X, pd.Series(force, index, name="force")


def load_mr_damper(tests=("5mm3Hz",), currents=(0.0, 0.5, 1.0), step=0.001, data=SHARED):
    """Load a magnetorheological damper on a press, in sines.

    Parameters
    ----------
    tests : sequence of str, default=("5mm3Hz",)
        Among 2mm5Hz, 5mm3Hz, 10mm1Hz, 25mm0x1Hz, 25mm0x25Hz, 25mm0x5Hz.
    currents : sequence of {0.0, 0.5, 1.0}, default=(0.0, 0.5, 1.0)
        In A.
    step : float, default=0.001
        Sampling interval in s; the slow tests come at 0.005 s.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : DataFrame of shape (n_samples, 2)
        Displacement in mm and current in A, one record a test and current.
    y : Series of shape (n_samples,)
        Force in N.
    """
    parts, labels = [], []
    for test, current in product(tests, currents):
        path = Path(data) / "mr_damper" / f"{test}{current:g}A.txt".replace("0.5", "0x5")
        X, y = read_records(path, time=0, drive=1, response=3)
        X, y = resample_records(X, y, dt=step)
        X = X.set_axis(["displacement"], axis=1).assign(current=current)
        parts.append((X, y.rename("force")))
        labels.append(f"{test} {current:g} A")
    return stack_records(parts, labels=labels)


def load_friction_damper(train_part=0.6, data=SHARED):
    """Load a full-scale banded rotary friction damper with backlash, in sines of 0.5 Hz.

    Parameters
    ----------
    train_part : float, default=0.6
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X_train, y_train, X_test, y_test
        Displacement in inches and force in kip, at 1024 Hz.
    """
    path = Path(data) / "friction_damper/dataset-1_0.5Hz20lbtension.json"
    X, y = read_records(path, time="data[0]", drive="data[1]", response="data[2]")
    return split_in_time(X, y, train_part)


def load_piezo_fsm(level, split="train", data=SHARED):
    """Load the fine steering mirror: three piezo stacks, three displacements, in steady state.

    Parameters
    ----------
    level : {100, 200, 300}
        Excitation in mV rms.
    split : {"train", "test"}, default="train"
        Six realisations, or three (none at 300 mV): orthogonal random-phase multisines, three
        realisations in a row make one orthogonal group.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X, Y : DataFrame of shape (n_samples, 3)
        Voltages ``u0`` to ``u2`` in V and displacements ``y0`` to ``y2`` in m. Each realisation is
        one record of two periods of 8192 samples; the index has the levels record ("train0", ...)
        and time (s).
    """
    folder = Path(data) / "piezo_fsm"
    parts = []
    for name in "uy":
        values = np.load(folder / f"{name}_{level}mV_{split}.npy")
        n, channels, records, periods = values.shape
        stacked = values.transpose(2, 3, 0, 1).reshape(records * periods * n, channels)
        labels = [f"{split}{record}" for record in range(records)]
        index = pd.MultiIndex.from_product(
            [labels, np.arange(periods * n) / FSM_RATE], names=["record", "time"]
        )
        columns = [f"{name}{channel}" for channel in range(channels)]
        parts.append(pd.DataFrame(stacked, index=index, columns=columns))
    return tuple(parts)


def load_silverbox(part, data=SHARED):
    """Load a part of the silverbox, an electronic Duffing oscillator sampled at 610.35 Hz.

    Parameters
    ----------
    part : {"arrow", "multisine"}
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : ndarray of shape (n_samples, 1)
        Drive in V.
    y : ndarray of shape (n_samples,)
        Response in V.
    """
    table = pd.read_csv(Path(data) / "silverbox" / "SNLS80mV.csv")[SILVERBOX_PARTS[part]]
    return table[["V1"]].to_numpy(), table["V2"].to_numpy()


def load_wiener_hammerstein(split="train", data=SHARED):
    """Load the circuit of two filters of third order with a diode in between, sampled at 51.2 kHz.

    Parameters
    ----------
    split : {"train", "test"}, default="train"
        100,000 or 78,800 samples, of which the first 50 are not scored.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : ndarray of shape (n_samples, 1)
        Drive in V.
    y : ndarray of shape (n_samples,)
        Response in V.
    """
    from scipy.io import loadmat

    recording = loadmat(Path(data) / "wiener_hammerstein" / "WienerHammerBenchMark.mat")
    rows = WIENER_HAMMERSTEIN_PARTS[split]
    return recording["uBenchMark"][rows], recording["yBenchMark"][rows, 0]


def load_cascaded_tanks(split="train", data=SHARED):
    """Load the two tanks, sampled every 4 s: 1024 samples for the fit, 1024 for the test.

    Parameters
    ----------
    split : {"train", "test"}, default="train"
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : ndarray of shape (n_samples, 1)
        Voltage of the pump in V.
    y : ndarray of shape (n_samples,)
        Level of the lower tank in V; the sensor ends at 10 V.
    """
    table = pd.read_csv(Path(data) / "cascaded_tanks" / "dataBenchmark.csv")
    name = {"train": "Est", "test": "Val"}[split]
    return table[[f"u{name}"]].to_numpy(), table[f"y{name}"].to_numpy()


def load_bouc_wen_benchmark(split="train", signal="multisine", data=SHARED):
    """Load the simulated Bouc-Wen oscillator of the benchmark, sampled at 750 Hz.

    Parameters
    ----------
    split : {"train", "test"}, default="train"
        Five periods of 8192 samples with noise, which begin at rest; or the test records without
        noise.
    signal : {"multisine", "sinesweep"}, default="multisine"
        The test multisine is one period in steady state, the sweep (test only) begins at rest.
    data : path, default=SHARED
        Folder of the recordings.

    Returns
    -------
    X : ndarray of shape (n_samples, 1)
        Force in N.
    y : ndarray of shape (n_samples,)
        Displacement in m.
    """
    import h5py

    with h5py.File(Path(data) / "bouc_wen_benchmark" / f"{split}.h5") as file:
        return file[f"{signal}/u"][:], file[f"{signal}/y"][:, 0]
