import math

import numpy as np
import pytest
from skhyst.hysteresis._friction_stage_loops import decay, friction_run, friction_tangents

from skhyst.hysteresis import FrictionStageOperator

STAGE = FrictionStageOperator(90.0, 0.15, 0.3, 0.7, 3.0, 8.0, 0.1, n_substeps=3)
U = 0.25 * np.cumsum(np.random.default_rng(3).normal(size=60))


@pytest.mark.parametrize("a", [0.0, 1e-12, 1e-3, 0.0999999, 0.1, 0.3, 1.0, 30.0, 1e4, 1e100])
def test_decay(a):
    """Against the power series, or the closed form where that keeps its digits."""
    found = decay(a)
    if a < 1.0:
        expected = [sum((-a) ** j / math.factorial(j + k) for j in range(30)) for k in (1, 2, 3)]
        expected.insert(0, -math.expm1(-a))
    else:
        gone = 1.0 - math.exp(-a)
        phi = gone / a
        psi = (1.0 - phi) / a
        expected = [gone, phi, psi, (0.5 - psi) / a]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_compiled_run_equals_plain_python():
    h, mode = STAGE._substep(0.01)
    arguments = (mode, 90.0, STAGE._law(), 0.1, h, 3, U, U[0], 0.1, 0.0, 0.2)
    y, expected = np.empty((2, U.size))
    last = friction_run(*arguments, y)
    assert friction_run.py_func(*arguments, expected) == pytest.approx(last, rel=1e-12)
    np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-14)


def test_compiled_tangents_equal_plain_python():
    h, mode = STAGE._substep(0.01)
    mode_by = STAGE._substep_tangents(0.01)
    rng = np.random.default_rng(0)
    du, dbefore = rng.normal(size=(U.size, 2)), rng.normal(size=2)
    du.flags.writeable = dbefore.flags.writeable = False
    d = rng.normal(size=(3, 9))
    head = (mode, mode_by, 90.0, STAGE._law(), 0.1, h, 3, U, du, U[0], dbefore, 0.1, 0.0, 0.2)
    results = []
    for function in (friction_tangents, friction_tangents.py_func):
        y, dy = np.empty(U.size), np.empty((U.size, 9))
        function(*head, d.copy(), y, dy)
        results.append((y, dy))
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
