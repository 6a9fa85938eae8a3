"""Disturbances: functions of time, whatever the drive."""

import numpy as np
import pytest

from skhyst.disturbance import DriftOperator, OffsetOperator, SinusoidOperator

DT, N = 0.05, 40
TIME = DT * np.arange(N)
OPERATORS = {
    "offset": OffsetOperator(np.array([0.7])),
    "drift": DriftOperator(np.array([0.3, -0.5, 0.2]), 1.5),
    "sinusoid": SinusoidOperator(np.array([0.5, 0.1, -0.2, 0.3]), np.array([3.0, 11.0])),
}


@pytest.fixture(params=OPERATORS)
def operator(request):
    return OPERATORS[request.param]


def test_formulas():
    zeros = np.zeros(N)
    np.testing.assert_array_equal(OPERATORS["offset"].run(zeros, DT)[0], 0.7)
    z = np.minimum(2 * TIME / 1.5 - 1, 1.0)
    drift = 0.3 - 0.5 * z + 0.2 * (3 * z**2 - 1) / 2
    np.testing.assert_allclose(OPERATORS["drift"].run(zeros, DT)[0], drift, atol=1e-14)
    phase = 2 * np.pi * np.outer([3.0, 11.0], TIME)
    lines = np.array([0.5, 0.1]) @ np.cos(phase) + np.array([-0.2, 0.3]) @ np.sin(phase)
    np.testing.assert_allclose(OPERATORS["sinusoid"].run(zeros, DT)[0], lines, atol=1e-13)


def test_drive_does_not_matter(operator):
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(
        operator.run(rng.normal(size=N), DT)[0], operator.run(np.zeros(N), DT)[0]
    )
    _, dy = operator.sensitivities(rng.normal(size=N), np.ones((N, 2)), DT)
    np.testing.assert_array_equal(dy[:, :2], 0.0)


def test_basis_is_what_the_coefficients_weigh(operator):
    basis = operator.basis(TIME)
    _, dy = operator.sensitivities(np.zeros(N), np.empty((N, 0)), DT)
    np.testing.assert_allclose(dy[:, : basis.shape[1]], basis, atol=1e-13)
    assert np.linalg.matrix_rank(basis) == np.size(operator.coefficients)
