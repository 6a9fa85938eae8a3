"""Any regressor can be declared; what it lacks is found behind and beside its prediction."""

import pickle
import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from sklearn.dummy import DummyRegressor
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

from skhyst.autoregressive import NARXRegressor
from skhyst.compose import Cascade, Corrected, ScheduledParameters, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.diagnosis._black_box import declare
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain, TransferFunction
from skhyst.neural import SCNRegressor
from skhyst.optimize import RecordData
from skhyst.preprocessing import LaggedFeatures, PlayOperators
from skhyst.records import RecordSlice, stack_records

DT = 0.01
N = 250
RECORDS = 5
EFFECTS = ["lag", "offset", "drift", "output_saturation", "input_saturation"]


def drives(seed, count=RECORDS):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(N)
    for _ in range(count):
        f = rng.uniform(0.3, 4.0, 5)
        waves = (np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 6.28, 5)) / f**0.5).sum(1)
        yield 2.0 * waves / np.abs(waves).max()


def loops(u):
    """Return plays of widths 0.3 and 0.8 beside the drive."""
    y = u.copy()
    for width, weight in ((0.3, 0.5), (0.8, 0.4)):
        play = 0.0
        for k, value in enumerate(u.tolist()):
            play = min(max(play, value - width), value + width)
            y[k] += weight * play
    return y


def lag(y, i):
    """Integrate ``0.05 x' = y - x`` exactly, y straight between samples, from rest."""
    a = np.exp(-DT / 0.05)
    ramp = 1.0 - 5.0 * (1.0 - a)
    return y[0] + lfilter([ramp, 1.0 - a - ramp], [1.0, -a], y - y[0])


def offset(y, i):
    return y + 0.3 * (-1) ** i + 0.05 * i


def drift(y, i):
    return y + 0.3 * np.sin(np.linspace(0.0, 2.0 + 0.5 * i, N) + i)


def output_saturation(y, i):
    return np.minimum(y, 1.2)


def nothing(y, i):
    return y


def recording(plant, change, seed, noise=0.01):
    rng = np.random.default_rng(seed + 99)
    return stack_records(
        [(u, change(plant(u), i) + noise * rng.normal(size=N)) for i, u in enumerate(drives(seed))],
        dt=DT,
    )


def static(u):
    return 1.5 * np.tanh(u)


def second_order(u):
    """Discrete dynamics without noise in the loop, which ARX is exact for."""
    b = 1.0 - 1.6 + 0.68
    return u[0] + lfilter([0.0, b], [1.0, -1.6, 0.68], u - u[0])


def frame(transformer):
    return transformer.set_output(transform="pandas")


MODELS = {
    "plays": (lambda: make_pipeline(frame(PlayOperators(8)), Ridge(1e-3)), loops),
    "polynomial": (lambda: make_pipeline(PolynomialFeatures(7), Ridge(1e-3)), static),
    "forest": (lambda: RandomForestRegressor(5, min_samples_leaf=5), static),
    "network": (lambda: SCNRegressor(10), static),
    "narx": (lambda: NARXRegressor(input_lags=[1], output_lags=2), second_order),
}
# what the regressor can do itself is not missing: a forest clips, NARX has modes of its own
CASES = [
    ("plays", lag),
    pytest.param("plays", output_saturation, marks=pytest.mark.slow),
    ("forest", offset),
    pytest.param("narx", drift, marks=pytest.mark.slow),
]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def search_of(name, change):
    model, plant = MODELS[name]
    noise = 2e-5 if name == "narx" else 0.01  # a fit one step ahead is biased by output noise
    effects = [*EFFECTS, "resonance"] if change is nothing else EFFECTS
    search = EffectSearchCV(model(), effects=effects, max_effects=1, random_state=0)
    return search.fit(*recording(plant, change, 3, noise)), plant


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.DivergenceWarning")
@pytest.mark.parametrize(("name", "change"), CASES)
def test_the_missing_effect_is_named(name, change):
    search, plant = search_of(name, change)
    assert search.effects_ == [change.__name__]
    assert search.error_after_ < 0.6 * search.error_before_
    assert search.evidence_[change.__name__].statement
    assert isinstance(search.best_estimator_, Corrected)
    if change in (lag, output_saturation):  # of records that the search has not seen
        X, y = recording(plant, change, 11)
        before = rms(search.declared_estimator_.predict(X) - y)
        assert rms(search.best_estimator_.predict(X) - y) < 0.6 * before
        assert search.held_out_error(X, y) < 0.6 * search.held_out_error(X, y, declared=True)


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_found_where_nothing_is_missing(name):
    search, _ = search_of(name, nothing)
    assert search.effects_ == []
    assert search.best_estimator_ is search.declared_estimator_
    assert search.error_after_ == search.error_before_


def test_what_is_scored_was_never_learned():
    """A regressor that remembers every sample predicts noise no better for it."""
    X, y = recording(static, nothing, 3, noise=0.1)
    forest = RandomForestRegressor(5, bootstrap=False)
    search = EffectSearchCV(forest, effects=["offset"], random_state=0).fit(X, y)
    assert rms(search.declared_estimator_.predict(X) - y) < 0.02
    assert search.error_before_ > 0.1


def test_a_single_record_is_cut_into_blocks():
    u = np.concatenate(list(drives(3)))
    rng = np.random.default_rng(0)
    y = lag(2.0 * u, 0) + 0.01 * rng.normal(size=len(u))
    search = EffectSearchCV(LinearRegression(), effects=EFFECTS, max_effects=1, random_state=0)
    search.fit(u.reshape(-1, 1), y)
    assert search.effects_ == ["lag"]
    assert search.error_after_ < 0.011
    assert np.isnan(search.residual_before_[:5]).all()
    assert rms(search.predict(u.reshape(-1, 1)) - y) < 0.012


def test_records_are_driven_by_a_fit_to_the_others():
    """A regression through the mean of the rows that each was fitted to, and once so far."""
    sizes = 4, 6, 5
    y = np.concatenate([np.full(n, 10.0 * i) for i, n in enumerate(sizes)])
    X, columns, stops = np.zeros((15, 1)), np.zeros((15, 1)), np.cumsum(sizes)
    slices = [
        RecordSlice(i, slice(stop - n, stop), DT, 0.0, n)
        for i, (stop, n) in enumerate(zip(stops, sizes, strict=True))
    ]
    records = [
        RecordData(X[s.rows, 0], y[s.rows], DT, segments=((0, s.n_samples),)) for s in slices
    ]
    of = np.arange(3)
    folds = [(of != k, of == k) for k in range(3)] + [(of >= 0, of >= 0)]
    stands_for = declare(DummyRegressor(), X, columns, y, slices, 0)
    driven, scored = stands_for.prepare(records, folds)
    assert len(scored) == 3  # what is trained on everything scores nothing
    for k, record in enumerate(driven):
        np.testing.assert_allclose(record.u, y[np.repeat(of, sizes) != k].mean())
        np.testing.assert_array_equal(record.y, records[k].y)
    assert stands_for.measured(driven) is records
    box = stands_for._declared
    assert box.turns == 0
    np.testing.assert_array_equal(box.targets, [y] * 3)


def test_columns_by_name_are_found_in_a_composition_by_their_place():
    X = pd.DataFrame({"time": np.arange(9.0), "volt": np.arange(9.0), "warm": np.ones(9)})
    slices = [RecordSlice(0, slice(0, 9), DT, 0.0, 9)]
    data = X, X.to_numpy(), np.arange(9.0), slices, 0
    named = declare(TransferFunction(1, inputs=["warm", "volt"]), *data)
    assert named.model.inputs == [2, 1]
    assert declare(TransferFunction(1, inputs="all"), *data).model.inputs == "all"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_search():
    X, y = recording(static, offset, 3)
    forest = RandomForestRegressor(5, min_samples_leaf=5)
    found = [EffectSearchCV(forest, effects=["offset"], random_state=0).fit(X, y) for _ in range(2)]
    assert found[0].error_after_ == found[1].error_after_
    np.testing.assert_array_equal(found[0].predict(X), found[1].predict(X))
    copy = pickle.loads(pickle.dumps(found[0]))
    np.testing.assert_array_equal(copy.predict(X), found[0].predict(X))


def test_lags_and_further_columns():
    """A column that nobody told the regressor of acts beside its prediction."""
    rng = np.random.default_rng(0)
    records = []
    for u in drives(3):
        warm = np.cumsum(rng.normal(size=N)) / 10.0
        records.append(
            (np.column_stack([u, warm]), 2.0 * u + 0.3 * warm + 0.01 * rng.normal(size=N))
        )
    X, y = stack_records(records, dt=DT)
    drive_alone = make_pipeline(frame(LaggedFeatures(2, columns=[X.columns[0]])), Ridge(1e-6))
    search = EffectSearchCV(
        drive_alone, effects=["auxiliary_input", "drift", "lag"], random_state=0
    ).fit(X, y)
    assert search.effects_[:1] == ["auxiliary_input"]
    assert rms(search.predict(X) - y) < 0.02


# ------------------------------------------------------------------------- parametric, but special


def scheduled(u):
    return u * (1.0 + 0.3 * np.ptp(u))


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize(
    ("declared", "change"),
    [
        (ScheduledParameters(Gain()), nothing),
        (ScheduledParameters(Cascade([("hysteresis", PrandtlIshlinskii(3))])), lag),
        (Sum([("direct", Gain()), ("plays", PrandtlIshlinskii(3))]), offset),
    ],
    ids=["scheduled", "scheduled cascade", "sum"],
)
def test_compositions_are_taken_apart(declared, change):
    rng = np.random.default_rng(0)
    law = scheduled if isinstance(declared, ScheduledParameters) else static_sum
    records = []
    for i, u in enumerate(drives(3)):
        u = u * (0.4 + 0.1 * i)
        y = change(law(u), i)
        records.append((u, y + 0.002 * np.ptp(y) * rng.normal(size=N)))
    X, y = stack_records(records, dt=DT)
    effects = ["lag", "offset", "output_saturation"]
    search = EffectSearchCV(declared, effects=effects, cv=3, max_effects=1, random_state=0)
    search.fit(X, y)
    assert search.effects_ == ([] if change is nothing else [change.__name__])
    assert not isinstance(search.best_estimator_, Corrected)
    assert np.isfinite(search.predict(X)).all()


def static_sum(u):
    return 2.0 * u + 0.1


@pytest.mark.slow
def test_polynomials_of_degree_two_are_a_black_box():
    X, y = recording(static_sum, offset, 3)
    search = EffectSearchCV(
        ScheduledParameters(Gain(), degree=2), effects=["offset", "lag"], max_effects=1
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # equal amplitudes determine no polynomial
        search.fit(X, y)
    assert search.effects_ == ["offset"]
    assert isinstance(search.best_estimator_, Corrected)


@pytest.mark.slow
def test_several_inputs():
    rng = np.random.default_rng(0)
    records = []
    for i, (a, b) in enumerate(zip(drives(3), drives(4), strict=True)):
        y = drift(lag(a + 0.5 * b, 0), i) + 0.01 * rng.normal(size=N)
        records.append((np.column_stack([a, b]), y))
    X, y = stack_records(records, dt=DT)
    X.columns = ["drive", "other"]
    search = EffectSearchCV(
        TransferFunction(1, inputs=["drive", "other"]),
        effects=["drift", "offset", "input_saturation"],
        max_effects=1,
        random_state=0,
    ).fit(X, y)
    assert search.effects_ == ["drift"]
    assert np.isfinite(search.predict(X)).all()
