"""What the tests of several models share."""

import warnings

import numpy as np
import pytest


@pytest.fixture
def assert_recovered():
    """Return a check that fits noisy plants: drive, clean and noisy response, noise, parameters."""

    def check(model, plants):
        covered, excess = [], []
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for u, clean, y, noise, truth in plants:
                model.fit(u[:, None], y)
                rms = np.sqrt(noise**2 + np.mean((model.predict(u[:, None]) - clean) ** 2))
                excess.append(rms / noise)
                covered += [
                    abs(model.params_[name] - value) < 1.96 * model.params_std_[name]
                    for name, value in truth.items()
                ]
        assert max(excess) < 1.02
        assert 0.90 <= np.mean(covered) <= 0.99

    return check


@pytest.fixture
def assert_unit_free():
    """Return a check that a fit in other units of drive and response predicts the same."""

    def check(model, u, y, drive, response):
        expected = response * model.fit(u[:, None], y).predict(u[:, None])
        found = model.fit(drive * u[:, None], response * y).predict(drive * u[:, None])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4 * np.ptp(expected))

    return check
