"""The test of whiteness keeps its level, and sees what is coloured."""

import numpy as np
import pytest
from scipy.signal import lfilter

from skhyst.noise import whiteness_p_value


def test_level():
    """A tenth of white series are below 0.1: within four standard errors of the binomial."""
    rng = np.random.default_rng(0)
    below = [
        whiteness_p_value([rng.normal(size=300), rng.normal(size=200)]) < 0.1 for _ in range(1000)
    ]
    assert abs(np.mean(below) - 0.1) < 4 * np.sqrt(0.1 * 0.9 / 1000)


@pytest.mark.parametrize(
    "filtered", [([1.0], [1.0, -0.3]), ([1.0, 1.0], [1.0]), ([1.0, -0.5], [1.0])]
)
def test_colour_is_seen(filtered):
    white = np.random.default_rng(1).normal(size=1000)
    assert whiteness_p_value([lfilter(*filtered, white)]) < 1e-9


def test_nothing_to_be_tested():
    assert whiteness_p_value([np.zeros(50)]) == 1.0
    assert whiteness_p_value([np.array([1.0, -1.0])]) == 1.0
