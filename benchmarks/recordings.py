"""Loaders of measured recordings, which are not part of the project and lie beside the checkout."""

from pathlib import Path

import numpy as np
import pandas as pd

__all__ = [
    "SHARED",
    "load_bouc_wen_benchmark",
    "load_cascaded_tanks",
    "load_piezo_fsm",
    "load_silverbox",
]

SHARED = Path(__file__).resolve().parents[1] / "../shared/data"
FSM_RATE = 6400.0  # Hz
SILVERBOX_PARTS = {
    "arrow": slice(0, 40_700),  # a Gaussian noise of growing size
    "multisine": slice(41_270, None),  # ten realisations, one after the other
}


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
