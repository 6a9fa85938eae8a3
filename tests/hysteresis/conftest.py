"""What the tests of several models share."""

import warnings

import numpy as np
import pytest


@pytest.fixture
def assert_recovered():
    """Return a check that fits noisy plants, to the noise and with standard errors that are true.

    Plants are drive, clean and noisy response, noise, and parameters by name or in their order,
    then, where they differ from plant to plant, parameters of the model.
    """

    def check(model, plants):
        covered, excess, evaluations = [], [], []
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for u, clean, y, noise, truth, *options in plants:
                model.set_params(**(options[0] if options else {})).fit(u[:, None], y)
                rms = np.sqrt(noise**2 + np.mean((model.predict(u[:, None]) - clean) ** 2))
                excess += [rms / noise, model.fit_error_ / np.sqrt(np.mean((y - clean) ** 2))]
                if not isinstance(truth, dict):
                    truth = dict(zip(model.params_, truth, strict=True))
                assert set(model.params_) == set(truth)
                covered += [
                    abs(model.params_[name] - value) < 1.96 * model.params_std_[name]
                    for name, value in truth.items()
                ]
                evaluations.append(model.n_evaluations_)
        assert max(excess) < 1.02
        assert 0.90 <= np.mean(covered) <= 0.99
        return evaluations

    return check


@pytest.fixture
def assert_unit_free():
    """Return a check that a fit in other units of drive and response predicts the same."""

    def check(model, u, y, drive, response, tolerance=1e-4, **units):
        expected = response * model.fit(u[:, None], y).predict(u[:, None])
        model.set_params(**units).fit(drive * u[:, None], response * y)
        found = model.predict(drive * u[:, None])
        np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * np.ptp(expected))

    return check
