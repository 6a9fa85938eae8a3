"""Standard errors whatever the colour of the noise."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from skhyst.exceptions import ShortRecordWarning
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator
from skhyst.optimize import RecordData, coloured_covariance, identify, penalised_covariance

DT, A = 0.01, 0.9
TRUTH = FirstOrderLagOperator(0.1, gain=2.0, intercept=0.5)


def coloured(rng, n, a=A):
    """Return autoregressive noise of unit variance."""
    return lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], rng.normal(size=n + 300))[300:]


def record(seed, n=1000, level=0.3, a=A):
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(size=n)) / 4
    return RecordData(u, TRUTH.run(u, DT)[0] + level * coloured(rng, n, a), DT)


def design(n, counts, seed=0):
    """Return a slow Jacobian and its residual, zero where nothing counts, and the root."""
    rng = np.random.default_rng(seed)
    jacobian = np.cumsum(rng.normal(size=(n, 3)), axis=0) * counts[:, None]
    gram = jacobian.T @ jacobian
    noise = coloured(rng, n) * counts
    residual = noise - jacobian @ np.linalg.solve(gram, jacobian.T @ noise)
    return jacobian, residual, np.linalg.inv(np.linalg.cholesky(gram)).T


@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_the_covariance_is_that_of_the_noise_between_the_jacobians(missing):
    n = 6000
    counts = (np.random.default_rng(1).uniform(size=n) >= missing).astype(float)
    jacobian, residual, root = design(n, counts)
    own = jacobian, residual, np.empty((n, 0)), counts > 0.0, DT
    found = coloured_covariance(lambda: [own], root, counts.sum())
    exact = root @ root.T @ jacobian.T @ toeplitz(A ** np.arange(n)) @ jacobian @ root @ root.T
    # of an estimated spectrum, at low frequencies
    np.testing.assert_allclose(np.diag(found), np.diag(exact), rtol=0.35)
    assert np.all(np.diag(found) > 8.0 * np.diag(root @ root.T))


def test_the_bias_of_a_penalty_is_an_error():
    n, level = 500, 0.09
    jacobian, _, _ = design(n, np.ones(n))
    problem = SimpleNamespace(segment_weight=np.array([n]), penalty=np.array([0.0, 3.0, 900.0]))
    inverse = np.linalg.inv(jacobian.T @ jacobian + n * np.diag(problem.penalty))
    white = level * inverse

    def sandwich(correlation):
        return level * inverse @ jacobian.T @ correlation @ jacobian @ inverse

    found, independent = penalised_covariance(problem, white, sandwich(np.eye(n)), level, [1, 2])
    assert independent == pytest.approx(1.0)
    np.testing.assert_allclose(found, white)
    own = sandwich(toeplitz(A ** np.arange(n)))
    found, independent = penalised_covariance(problem, white, own, level, [1, 2])
    assert 0.01 < independent < 0.5
    # of weights with the variance that the penalty stands for
    prior = np.diag([0.0, 1.0 / 3.0, 1.0 / 900.0]) * level / (n * independent)
    left = inverse * n * problem.penalty  # fraction of the weights that the penalty removes
    np.testing.assert_allclose(found, own + left @ prior @ left.T)


def test_records_are_independent_of_each_other():
    n = 4000
    jacobian, residual, root = design(n, np.ones(n))
    own = jacobian, residual, np.empty((n, 0)), np.ones(n, dtype=bool), DT
    once = coloured_covariance(lambda: [own], root, n)
    twice = coloured_covariance(lambda: [own, own], root / np.sqrt(2.0), 2 * n)
    np.testing.assert_allclose(twice, once / 2.0, rtol=0.05, atol=0.01 * np.abs(once).max())


def test_white_noise_has_the_errors_of_the_textbook():
    """Mostly to the last digit; Akaike's criterion takes a lag too many now and then."""
    equal = 0
    for seed in range(40):
        result = identify([TRUTH], [record(seed, 400, a=0.0)])
        white, std = (
            np.array(list(s.values())) for s in (result.params_std_white, result.params_std)
        )
        np.testing.assert_allclose(std, white, rtol=0.5)
        equal += np.array_equal(std, white)
    assert equal >= 20


@pytest.mark.slow
@pytest.mark.parametrize("n_records", [1, 4])
def test_intervals_hold_under_coloured_noise(n_records):
    hits, white = [], []
    for seed in range(100):
        data = [record(100 * seed + i, 1200 // n_records) for i in range(n_records)]
        result = identify([TRUTH], data)
        for name, value in result.params.items():
            error = abs(value - getattr(TRUTH, name))
            hits.append(error < 1.96 * result.params_std[name])
            white.append(error < 1.96 * result.params_std_white[name])
    assert 0.9 <= np.mean(hits) <= 0.99
    assert np.mean(white) < 0.7


def test_a_record_that_is_too_short_for_its_noise_is_said_to_be():
    rng = np.random.default_rng(0)
    u = np.sin(0.3 * np.arange(300))
    y = TRUTH.run(u, DT)[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FirstOrderLag(dt=DT).fit(u[:, None], y + 0.1 * rng.normal(size=300))
    drift = 0.003 * np.arange(300)
    with pytest.warns(ShortRecordWarning, match="few independent samples.*intercept"):
        model = FirstOrderLag(dt=DT).fit(u[:, None], y + drift + 0.1 * rng.normal(size=300))
    assert model.params_std_["intercept"] > 8.0 * model.params_std_white_["intercept"]


@pytest.mark.parametrize("unit", [1e-40, 1e30])
def test_the_unit_of_the_response_does_not_matter(unit):
    own = record(0)
    other = RecordData(own.u, unit * own.y, DT)
    plain, scaled = identify([TRUTH], [own]), identify([TRUTH], [other])
    assert scaled.params_std["gain"] == pytest.approx(unit * plain.params_std["gain"], rel=1e-4)
    assert scaled.params_std["gain"] > 1.5 * scaled.params_std_white["gain"]
