"""Loaders of measured recordings, which are not part of the project and lie beside the checkout."""

from pathlib import Path

import numpy as np
import pandas as pd

__all__ = ["SHARED", "load_piezo_fsm"]

SHARED = Path(__file__).resolve().parents[1] / "../shared/data"
FSM_RATE = 6400.0  # Hz


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
