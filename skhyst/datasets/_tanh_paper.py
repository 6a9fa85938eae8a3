"""The 24 identified parameter sets of Xie et al. (2023), Tables 2 to 4, and the drive (4)."""

import numpy as np
import pandas as pd

from ..records import stack_records

# a row for each of Tables 2 to 4, drives of 20, 40 and 60 V, a column for each 10 Hz
_PARAMETERS = {
    "k0": [  # um/V
        [0.1276, 0.1260, 0.1253, 0.1201, 0.1238, 0.1238, 0.1227, 0.1203],
        [0.1517, 0.1487, 0.1482, 0.1461, 0.1447, 0.1424, 0.1397, 0.1451],
        [0.1693, 0.1647, 0.1644, 0.1647, 0.1629, 0.1628, 0.1539, 0.1600],
    ],
    "alpha": [  # um s/V
        [-4.5e-05, -6.1e-05, -3.0e-06, -1.4e-04, -1.2e-05, -7.0e-06, -3.9e-05, -5.9e-05],
        [-0.00017, -0.00016, -0.00006, -0.00009, -0.00009, -0.00010, -0.00010, -0.00003],
        [-0.00025, -0.00025, -0.00014, -0.00005, -0.00007, -0.00005, -0.00013, -0.00007],
    ],
    "beta": [  # um
        [0.1228, 0.1285, 0.1363, 0.1734, 0.1475, 0.1431, 0.1387, 0.1623],
        [0.3121, 0.3454, 0.3349, 0.3857, 0.4017, 0.4234, 0.4828, 0.4004],
        [0.5189, 0.6521, 0.6248, 0.6187, 0.6436, 0.6682, 0.9466, 0.7258],
    ],
    "gamma": [  # 1/V
        [47918, 41276, 49162, 44419, 16536, 29944, 47111, 36141],
        [113971, 976595, 499290, 500032, 54236, 888161, 988761, 187906],
        [401360, 863764, 1650301, 1709695, 1697321, 1350147, 1116387, 836609],
    ],
}
_INTERVAL = 0.000128  # s


def load_tanh_parameters() -> pd.DataFrame:
    """Return the published parameters of the hyperbolic tangent model.

    Returns
    -------
    DataFrame of shape (24, 6)
        ``voltage`` (V, the largest value of the drive), ``frequency`` (Hz), ``k0`` (um/V),
        ``alpha`` (um s/V), ``beta`` (um), ``gamma`` (1/V).

    References
    ----------
    Xie et al., *Smart Materials and Structures*, 2023, Tables 2 to 4.

    Examples
    --------
    >>> from skhyst.datasets import load_tanh_parameters
    >>> load_tanh_parameters().groupby("voltage")["k0"].mean().round(4).tolist()
    [0.1237, 0.1458, 0.1628]
    """
    settings = {
        "voltage": np.repeat([20, 40, 60], 8),
        "frequency": np.tile(np.arange(10.0, 90.0, 10.0), 3),
    }
    return pd.DataFrame(settings | {name: np.ravel(t) for name, t in _PARAMETERS.items()})


def make_tanh_recording(
    voltage=40, frequency=20.0, *, n_cycles=5, noise=0.0, random_state=None
) -> tuple[pd.DataFrame, pd.Series]:
    """Return what the published parameters generate: (4) into (3), evaluated at the samples.

    Parameters
    ----------
    voltage : {20, 40, 60}, default=40
        Largest value of the drive, V.
    frequency : {10, 20, ..., 80}, default=20.0
        Hz.
    n_cycles : int, default=5
        Periods of the drive.
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
        If no such experiment was published.

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
