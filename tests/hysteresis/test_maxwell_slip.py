"""Maxwell-slip friction: its laws, and what a fit finds."""

import numpy as np
import pytest

from skhyst.hysteresis import MaxwellSlip, MaxwellSlipOperator
from skhyst.operators import play_thresholds

R, K = np.array([0.5, 1.3, 4.0, 20.0]), np.array([2.0, 0.7, 0.2, 0.05])


def test_every_element_follows_its_definition():
    u = np.cumsum(np.random.default_rng(0).normal(size=400))
    operator = MaxwellSlipOperator(R, K, stiffness=0.1, damping=0.02, intercept=5.0)
    y, state = operator.run(u, 0.01)
    element, expected = np.clip(u[0], -R, R), np.empty(400)
    for k in range(400):
        before = u[max(k - 1, 0)]
        element = np.clip(element + u[k] - before, -R, R)
        expected[k] = K @ element + 0.1 * u[k] + 0.02 * (u[k] - before) / 0.01 + 5.0
    np.testing.assert_allclose(y, expected, atol=1e-11)
    np.testing.assert_allclose(operator.elements(state), element, atol=1e-12)
    again = operator.state_from_elements(element, u[-1])
    more = np.cumsum(np.random.default_rng(1).normal(size=50))
    np.testing.assert_allclose(
        operator.run(more, 0.01, again)[0], operator.run(more, 0.01, state)[0], atol=1e-10
    )


def test_state_that_no_history_gives_is_refused():
    with pytest.raises(ValueError, match="must be reachable"):
        MaxwellSlipOperator(R, K).state_from_elements([0.6, 0.6, 0.6, 0.6], 1.0)


DT = 0.01
U = np.sin(np.linspace(0, 20, 800)) * np.linspace(0, 1, 800)


@pytest.mark.parametrize("spacing", ["grid", "quantile"])
def test_thresholds_are_those_of_plays_less_the_zero(spacing):
    force = MaxwellSlipOperator([0.1, 0.3], [3.0, 0.5]).run(U, DT)[0]
    model = MaxwellSlip(6, thresholds=spacing).fit(U[:, None], force)
    np.testing.assert_array_equal(model.thresholds_, play_thresholds(U, 7, spacing)[1:])


def test_sign_of_the_weights():
    y, _ = MaxwellSlipOperator([0.1, 0.3], [3.0, -0.5], intercept=7.0).run(U, DT)
    bounded = MaxwellSlip(thresholds=[0.1, 0.3], dt=DT).fit(U[:, None], y)
    free = MaxwellSlip(thresholds=[0.1, 0.3], non_negative=False, dt=DT).fit(U[:, None], y)
    assert bounded.weights_.min() == 0.0
    np.testing.assert_allclose(free.weights_, [3.0, -0.5], rtol=1e-6)
    np.testing.assert_allclose(free.saturation_forces_, [0.3, -0.15], rtol=1e-6)
    assert free.intercept_ == pytest.approx(7.0)
    assert free.n_evaluations_ <= 2


def test_approximates_smooth_friction():
    y = 2.0 * np.tanh(5.0 * U)
    errors = [MaxwellSlip(n, dt=DT).fit(U[:, None], y).fit_error_ for n in (1, 4, 16)]
    assert errors == sorted(errors, reverse=True)
