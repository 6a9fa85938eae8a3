"""The 24 identified parameter sets of the tanh paper, Tables 2 to 4, and its drive (4)."""

import numpy as np
import pandas as pd

from ..records import stack_records

__all__ = ["load_tanh_parameters", "make_tanh_recording"]

# by the peak of the drive (V), a row each 10 Hz: k0 (um/V), alpha (um s/V), beta (um), gamma (1/V)
_TABLES = {
    20: (
        (0.1276, -4.5e-05, 0.1228, 47918),
        (0.1260, -6.1e-05, 0.1285, 41276),
        (0.1253, -3.0e-06, 0.1363, 49162),
        (0.1201, -1.4e-04, 0.1734, 44419),
        (0.1238, -1.2e-05, 0.1475, 16536),
        (0.1238, -7.0e-06, 0.1431, 29944),
        (0.1227, -3.9e-05, 0.1387, 47111),
        (0.1203, -5.9e-05, 0.1623, 36141),
    ),
    40: (
        (0.1517, -0.00017, 0.3121, 113971),
        (0.1487, -0.00016, 0.3454, 976595),
        (0.1482, -0.00006, 0.3349, 499290),
        (0.1461, -0.00009, 0.3857, 500032),
        (0.1447, -0.00009, 0.4017, 54236),
        (0.1424, -0.00010, 0.4234, 888161),
        (0.1397, -0.00010, 0.4828, 988761),
        (0.1451, -0.00003, 0.4004, 187906),
    ),
    60: (
        (0.1693, -0.00025, 0.5189, 401360),
        (0.1647, -0.00025, 0.6521, 863764),
        (0.1644, -0.00014, 0.6248, 1650301),
        (0.1647, -0.00005, 0.6187, 1709695),
        (0.1629, -0.00007, 0.6436, 1697321),
        (0.1628, -0.00005, 0.6682, 1350147),
        (0.1539, -0.00013, 0.9466, 1116387),
        (0.1600, -0.00007, 0.7258, 836609),
    ),
}
_INTERVAL = 0.000128  # s


def load_tanh_parameters():
    """Return the published parameters of the hyperbolic tangent model.

    Returns
    -------
    DataFrame of shape (24, 6)
        ``voltage`` (V, the largest value of the drive), ``frequency`` (Hz), ``k0`` (um/V),
        ``alpha`` (um s/V), ``beta`` (um), ``gamma`` (1/V).

    References
    ----------
    Smart Mater. Struct. 32 (2023) 015013, Tables 2 to 4.

    Examples
    --------
    >>> from skhyst.datasets import load_tanh_parameters
    >>> load_tanh_parameters().groupby("voltage")["k0"].mean().round(4).tolist()
    [0.1237, 0.1458, 0.1628]
    """
    rows = [
        (voltage, 10.0 * (i + 1), *values)
        for voltage, table in _TABLES.items()
        for i, values in enumerate(table)
    ]
    return pd.DataFrame(rows, columns=["voltage", "frequency", "k0", "alpha", "beta", "gamma"])


def make_tanh_recording(voltage=40, frequency=20.0, *, n_cycles=5, noise=0.0, random_state=None):
    """Return what the published parameters generate: (4) into (3), evaluated at the samples.

    Parameters
    ----------
    voltage : {20, 40, 60}, default=40
        Largest value of the drive, V.
    frequency : {10, 20, ..., 80}, default=20.0
        Hz.
    n_cycles : int, default=5
    noise : float, default=0.0
        Standard deviation of white noise in the response, um.
    random_state : int or None, default=None
        Seed of the noise.

    Returns
    -------
    X : DataFrame of shape (n_samples, 1)
        Drive in V, at intervals of 0.000128 s.
    y : Series of shape (n_samples,)
        Displacement in um. The rate of the drive is the exact one.

    Raises
    ------
    ValueError
        If the paper has no such experiment.

    Examples
    --------
    >>> from skhyst.datasets import make_tanh_recording
    >>> X, y = make_tanh_recording(20, 10.0)
    >>> len(X), round(float(X["drive"].max()), 3)
    (3906, 20.0)
    """
    table = load_tanh_parameters().set_index(["voltage", "frequency"])
    if (voltage, frequency) not in table.index:
        raise ValueError(
            "make_tanh_recording needs a voltage among 20, 40, 60 V and a frequency among 10, 20, "
            f"..., 80 Hz. Got {voltage!r} and {frequency!r} instead."
        )
    k0, alpha, beta, gamma = table.loc[(voltage, frequency)]
    time = _INTERVAL * np.arange(int(n_cycles / frequency / _INTERVAL))
    phase = 2.0 * np.pi * frequency * time - 0.5 * np.pi
    u = 0.5 * voltage * (np.sin(phase) + 1.0)
    rate = np.pi * voltage * frequency * np.cos(phase)
    y = k0 * u + alpha * rate + beta * np.tanh(gamma * u)
    y = y + noise * np.random.default_rng(random_state).normal(size=len(y))
    return stack_records([(u, y)], dt=_INTERVAL)
