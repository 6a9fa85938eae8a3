import numpy as np
import pytest
from scipy.integrate import quad

from skhyst.hysteresis import RestoringForceOperator
from skhyst.hysteresis._restoring_force_loops import restoring_run, restoring_tangents, slide

STAGE = RestoringForceOperator(
    90.0, 0.15, [0.2, 0.05], [0.1], 2.0, 0.1, 0.07, scale=0.9, n_substeps=3
)
U = 0.25 * np.cumsum(np.random.default_rng(3).normal(size=60))


@pytest.mark.parametrize("z", [-0.3, -0.1, 0.0, 0.2, 0.3])
@pytest.mark.parametrize("c", [-2.0, -0.3, -0.01, 0.01, 0.05, 0.4, 3.0])
def test_slide_solves_its_equation(c, z):
    b, k, limit = 0.4, 2.5, 0.3
    delta, mean, new, slips, _ = slide(c, b, z, k, limit)

    def force(part):
        return np.clip(z + k * part * delta, -limit, limit)

    average = quad(force, 0.0, 1.0, limit=200)[0]
    assert mean == pytest.approx(average, abs=1e-7)
    assert delta == pytest.approx(c - b * mean, abs=1e-14)
    assert new == pytest.approx(force(1.0), abs=1e-14)
    assert slips == (abs(z + k * delta) > limit)


@pytest.mark.parametrize("c", [-2.0, 0.05, 0.4])
def test_derivatives_of_slide(c):
    point = np.array([c, 0.4, 0.1, 2.5, 0.3])
    derivatives = slide(*point)[4]
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6
        expected = (slide(*(point + step))[0] - slide(*(point - step))[0]) / 2e-6
        assert derivatives[i] == pytest.approx(expected, abs=1e-8)


def test_compiled_run_equals_plain_python():
    h, mode = STAGE._substep(0.01)
    arguments = (
        mode, STAGE._law(U), *STAGE._coefficients(), h, 3, U, U[0], 0.1, 0.0, 0.05,
    )  # fmt: skip
    y, expected = np.empty((2, U.size))
    last = restoring_run(*arguments, y)
    assert restoring_run.py_func(*arguments, expected) == pytest.approx(last, rel=1e-12)
    np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-14)


def test_compiled_tangents_equal_plain_python():
    h, mode = STAGE._substep(0.01)
    rng = np.random.default_rng(0)
    du, dbefore = rng.normal(size=(U.size, 2)), rng.normal(size=2)
    du.flags.writeable = dbefore.flags.writeable = False
    d = rng.normal(size=(3, 10))
    head = (mode, STAGE._substep_tangents(0.01), STAGE._law(U), *STAGE._coefficients())
    tail = (h, 3, U, du, U[0], dbefore, 0.1, 0.0, 0.05)
    results = []
    for function in (restoring_tangents, restoring_tangents.py_func):
        y, dy = np.empty(U.size), np.empty((U.size, 10))
        function(*head, *tail, d.copy(), y, dy)
        results.append((y, dy))
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-12)
