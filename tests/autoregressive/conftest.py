"""Records of a nonlinear second-order recursion of two inputs."""

import numpy as np
import pytest

from skhyst.records import stack_records


def columns(n, seed):
    rng = np.random.default_rng(seed)
    waves = np.sin(np.outer(np.arange(n), [0.11, 0.047]) + rng.uniform(0, 6, 2))
    return waves + 0.3 * rng.standard_normal((n, 2))


def plant(u, seed, noise):
    y = np.zeros(len(u))
    rng = np.random.default_rng(seed)
    for k in range(2, len(u)):
        y[k] = 0.9 * y[k - 1] - 0.2 * y[k - 2] + 0.2 * u[k - 1, 0] + 0.1 * u[k, 1]
        y[k] += 0.05 * y[k - 1] * u[k - 1, 0] + noise * rng.standard_normal()
    return 3.0 + y


def stacked(sizes=(150, 90, 120), noise=1e-3):
    inputs = [columns(n, seed) for seed, n in enumerate(sizes)]
    parts = [(u, plant(u, seed, noise)) for seed, u in enumerate(inputs)]
    return stack_records(parts, labels="abc", dt=0.01)


@pytest.fixture(scope="session")
def recordings():
    return stacked


@pytest.fixture(scope="session")
def drives():
    """A drive alone, by its length and its seed."""
    return lambda n, seed: stack_records([columns(n, seed)], dt=0.01)


@pytest.fixture(scope="session")
def data():
    return stacked()
