"""Kernel of the system-level model against plain Python and against quadrature."""

import math
from unittest.mock import patch

import numpy as np
import pytest

from skhyst.hysteresis import _system_level
from skhyst.hysteresis._system_level import (
    saturation_terms,
    system_level_run,
    system_level_tangents,
)

NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)
T, WEIGHTS = 0.5 * (NODES + 1.0), 0.5 * WEIGHTS


@pytest.mark.parametrize("x", [0.0, 1e-300, 1e-8, 1e-3, 0.1, 0.4999999, 0.5, 0.7, 2.0, 10.0, 40.0])
def test_terms_are_integrals(x):
    """E = int exp(-x t) dt, H = int (1 - t) exp(-x t) dt over [0, 1], and their derivatives."""
    f = np.exp(-x * T)
    expected = [WEIGHTS @ g for g in (f, -T * f, (1.0 - T) * f, -T * (1.0 - T) * f)]
    np.testing.assert_allclose(saturation_terms(x), expected, rtol=3e-13)
    np.testing.assert_allclose(saturation_terms.py_func(x), saturation_terms(x), rtol=1e-14)


def test_terms_of_a_far_distance():
    e, de, h, dh = saturation_terms(1e6)
    np.testing.assert_allclose([e, de, h, dh], [1e-6, -1e-12, 1e-6, -1e-12], rtol=1e-5)
    assert all(map(math.isfinite, saturation_terms(1e300)))


@pytest.mark.parametrize("printed", [False, True])
def test_compiled_equals_python(printed):
    rng = np.random.default_rng(1)
    u, du, dlast = np.cumsum(rng.normal(size=60)), rng.normal(size=(60, 2)), rng.normal(size=2)
    outputs = []
    for plain in (False, True):
        run, tangents = system_level_run, system_level_tangents
        terms = saturation_terms
        if plain:
            run, tangents, terms = run.py_func, tangents.py_func, terms.py_func
        y, dy = np.empty(60), np.full((60, 6 + printed), np.nan)
        with patch.object(_system_level, "saturation_terms", terms):
            state = run(u, 1.1, 0.3, 0.4, 0.2, 0.05, printed, 0.3, 0.2, 0.5, 1.0, y)
            tangents(u, du, 1.1, 0.3, 0.4, 0.05, 0.1, printed, 0.5, 1.0, dlast, dy)
        outputs.append((y, dy, state))
    for compiled, plain in zip(*outputs, strict=True):
        np.testing.assert_allclose(compiled, plain, rtol=1e-12, atol=1e-13)
