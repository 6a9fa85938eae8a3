"""Weights of samples: zero is cutting out, two is there twice, and the gradient is that of both."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skhyst.disturbance import OffsetOperator, SinusoidOperator
from skhyst.hysteresis import Preisach
from skhyst.linear import FirstOrderLagOperator, SecondOrderModeOperator
from skhyst.optimize import DifferentialEvolution, OperatorProblem, RecordData, identify

DT, N = 0.02, 240
TRUTH = SecondOrderModeOperator(30.0, 0.2, gain=2.0, intercept=0.5)
START = SecondOrderModeOperator(26.0, 0.3)
DISTURBANCES = {
    "none": (),
    "offset": (OffsetOperator(np.zeros(1)),),
    "sinusoid": (SinusoidOperator(np.zeros(2), np.array([3.0])),),
}


def record(seed=0, **kwargs):
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.normal(size=N)) / 4
    return RecordData(u, TRUTH.run(u, DT)[0] + 0.1 * rng.normal(size=N), DT, **kwargs)


def problem(records, kind):
    fixed = ("intercept",) if kind != "none" else ()
    return OperatorProblem(START, records, disturbances=DISTURBANCES[kind], fixed=fixed)


def total(records, kind):
    own = problem(records, kind)
    return own.total(own.evaluate(own.x0))


@pytest.mark.parametrize("kind", DISTURBANCES)
@pytest.mark.parametrize("before", [None, 0.7])
def test_zero_and_one_cut_segments(kind, before):
    kept = ((20, 70), (90, 91), (150, 230))
    weights = np.isin(np.arange(N), np.r_[20:70, 90, 150:230]).astype(float)
    cut = record(segments=kept, before=before)
    spoilt = np.where(weights == 0.0, np.nan, cut.y)
    weighted = dataclasses.replace(cut, y=spoilt, segments=((0, N),), weights=weights)
    np.testing.assert_allclose(
        total([weighted, record(1)], kind), total([cut, record(1)], kind), rtol=1e-9, atol=1e-9
    )
    fixed = ("intercept",) if kind == "offset" else ()
    if kind != "sinusoid":
        a, b = (
            identify([(START, DISTURBANCES[kind])], [r, record(1)], fixed=fixed)
            for r in (weighted, cut)
        )
        assert a.params == pytest.approx(b.params, rel=1e-6)
        assert a.params_std == pytest.approx(b.params_std, rel=1e-6)
        assert a.error == pytest.approx(b.error, rel=1e-9)
        np.testing.assert_allclose(a.record_coefficients, b.record_coefficients, rtol=1e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_a_long_record_is_the_sum_of_its_segments(weighted):
    n = 70_000
    rng = np.random.default_rng(0)
    whole = RecordData(
        *rng.normal(size=(2, n)), DT, weights=rng.uniform(size=n) if weighted else None
    )
    cut = dataclasses.replace(whole, segments=tuple((i, i + 2) for i in range(0, n, 2)))
    np.testing.assert_allclose(total([whole], "none"), total([cut], "none"), rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize("kind", ["none", "offset"])
def test_two_is_there_twice(kind):
    once = record()
    heavy = dataclasses.replace(once, weights=np.full(N, 2.0))
    single, double = problem([heavy], kind), problem([once, once], kind)
    assert single.scale == pytest.approx(double.scale)
    assert single.segment_weight.sum() == double.segment_weight.sum() == 2 * N
    np.testing.assert_allclose(
        total([heavy], kind), total([once, once], kind), rtol=1e-9, atol=1e-9
    )
    if kind == "none":
        a, b = identify([(START, ())], [heavy]), identify([(START, ())], [once, once])
        assert a.params == pytest.approx(b.params)
        assert a.params_std == pytest.approx(b.params_std)
        assert a.error == pytest.approx(b.error)


@pytest.mark.parametrize("kind", DISTURBANCES)
@settings(deadline=None, max_examples=5)
@given(seed=st.integers(0, 1000))
def test_gradient_against_differences(kind, seed):
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.0, 2.0, N) * (rng.random(N) < 0.8)
    own = problem([record(seed, weights=weights), record(seed + 1)], kind)
    gradient = own.total(own.evaluate(own.x0))[:-1, -1]
    for i in range(len(own.x0)):
        h = 1e-5 * max(1.0, abs(own.x0[i]))
        ends = [own.x0 + step * np.eye(len(own.x0))[i] for step in (-h, h)]
        costs = [own.total(own.evaluate(x, jacobian=False))[-1, -1] for x in ends]
        slope = 0.5 * (costs[1] - costs[0]) / (2.0 * h)
        assert gradient[i] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(gradient).max())


def test_disturbances_of_a_prediction_obey_the_weights():
    """An offset is the weighted mean of what is left."""
    weights = np.random.default_rng(3).uniform(0.0, 1.0, N)
    own = problem([record(weights=weights)], "offset")
    y = own.simulate(own.operator, own.records[0])
    offset = own.predictions(own.x0, np.ones(1, dtype=bool))[0] - y
    np.testing.assert_allclose(offset, np.average(own.records[0].y - y, weights=weights))


@pytest.mark.slow
def test_the_error_of_a_weighted_fit_is_that_of_generalised_least_squares():
    """Standard errors cover where weights of mean one are as inverse variances."""
    rng, hits, count = np.random.default_rng(5), 0, 120
    u = np.cumsum(rng.normal(size=N)) / 4
    truth = FirstOrderLagOperator(0.1, gain=2.0)
    clean, sigma = truth.run(u, DT)[0], np.where(np.arange(N) % 3, 0.1, 0.5)
    weights = sigma**-2 / np.mean(sigma**-2)
    errors = {False: [], True: []}
    for _ in range(count):
        y = clean + sigma * rng.normal(size=N)
        for weighted in errors:
            own = RecordData(u, y, DT, weights=weights if weighted else None)
            result = identify([(truth, ())], [own], fixed=("intercept",))
            errors[weighted].append(result.params["time_constant"] - 0.1)
        hits += abs(errors[True][-1]) < 1.96 * result.params_std["time_constant"]
    assert 0.9 <= hits / count <= 0.99
    assert np.std(errors[True]) < 0.6 * np.std(errors[False])


@pytest.mark.parametrize("method", ["exact", "population"])
def test_every_way_to_a_model_sees_the_weights(method):
    """Gross errors of weight zero change nothing, in Gram matrices of weights neither."""
    weights = np.where(np.arange(N) % 40, 1.0, 0.0)
    clean = record(weights=weights)
    spoilt = dataclasses.replace(clean, y=clean.y + 1e6 * (weights == 0.0))
    if method == "exact":
        found = [Preisach(n_levels=6).identify([r]) for r in (spoilt, clean)]
    else:
        method = DifferentialEvolution(population=6, max_iterations=4)
        found = [identify([START], [r], method=method) for r in (spoilt, clean)]
    assert found[0].params == found[1].params
    assert found[0].error == found[1].error < 1.0


def test_a_sample_of_no_weight_is_no_reading():
    """Starting values see a line between its neighbours; the given response stays as it is."""
    y = np.array([0.0, np.nan, 2.0, -99.0, 4.0, 1e9])
    mended = RecordData(np.zeros(6), y, 1.0, weights=np.array([1.0, 0.0, 0.5, 0.0, 1.0, 0.0]))
    np.testing.assert_array_equal(mended.y, [0.0, 1.0, 2.0, 3.0, 4.0, 4.0])
    assert y[3] == -99.0
    np.testing.assert_array_equal(RecordData(y, y, 1.0, weights=np.zeros(6)).y, 0.0)


@pytest.mark.parametrize(
    "weights", [np.ones(3), -np.ones(N), np.full(N, np.nan), np.full(N, np.inf)]
)
def test_bad_weights(weights):
    with pytest.raises(ValueError, match="'weights' parameter of RecordData must be"):
        record(weights=weights)


def test_nothing_of_weight():
    with pytest.raises(ValueError, match="must be above zero for some samples"):
        identify([(START, ())], [record(weights=np.zeros(N))])
