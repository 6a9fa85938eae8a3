"""A regressor with effects behind it: what it learns, what it need not, and that nothing leaks."""

import pickle
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.tree import DecisionTreeRegressor

from skhyst.compose import (
    Backfitting,
    Cascade,
    Corrected,
    Modulated,
    Sum,
    Turn,
)
from skhyst.compose._backfitting import explained_change, fold_of_rows
from skhyst.disturbance import Offset
from skhyst.exceptions import ConvergenceWarning, ExtrapolationWarning
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import OnColumnOperator, Scaled, Series
from skhyst.optimize import OperatorProblem, RecordData
from skhyst.preprocessing import LaggedFeatures, PlayOperators
from skhyst.records import record_slices, stack_records
from skhyst.static import Saturation

DT = 0.01
N = 300


def drives(count, seed=0):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(N)
    for _ in range(count):
        f = rng.uniform(0.3, 4.0, 5)
        waves = (np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 6.28, 5)) / f**0.5).sum(1)
        yield 2.0 * waves / np.abs(waves).max()


def loops(u):
    """Return plays of widths 0.3 and 0.8 beside the drive."""
    y, plays = np.empty_like(u), np.zeros(2)
    for k, value in enumerate(u):
        plays = np.clip(plays, value - [0.3, 0.8], value + [0.3, 0.8])
        y[k] = value + plays @ [0.5, 0.4]
    return y


def low_pass(y, i):
    return FirstOrderLagOperator(0.05).run(y, DT)[0]


def recordings(change, count=6, seed=0, noise=0.005):
    rng = np.random.default_rng(seed + 99)
    parts = enumerate(drives(count, seed))
    records = [(u, change(loops(u), i) + noise * rng.normal(size=N)) for i, u in parts]
    return stack_records(records, dt=DT)


def pipeline():
    return make_pipeline(PlayOperators(8).set_output(transform="pandas"), Ridge(1e-3))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.slow
def test_a_lag_is_not_left_to_the_regressor():
    X, y = recordings(low_pass)
    X_new, y_new = recordings(low_pass, seed=5)
    alone = rms(pipeline().fit(X, y).predict(X_new) - y_new)
    once = Corrected(pipeline(), FirstOrderLag(), max_iter=0).fit(X, y)
    model = Corrected(pipeline(), FirstOrderLag()).fit(X, y)
    error = rms(model.predict(X_new) - y_new)
    assert error < 0.1 * alone
    assert error < 0.2 * rms(once.predict(X_new) - y_new)
    assert model.effects_.operator_.time_constant == pytest.approx(0.05, rel=0.03)
    assert once.n_iter_ == 1 < model.n_iter_
    copy = pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(copy.predict(X_new), model.predict(X_new))
    again = clone(model).fit(X, y)
    np.testing.assert_array_equal(again.predict(X_new), model.predict(X_new))


@pytest.mark.filterwarnings("ignore:Corrected has not separated")
def test_a_single_record_is_cut_without_jumps():
    """A lag would follow those between the predictions of two clones."""

    def recording(seed):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1.0, 1.0, 30), 20)
        y = FirstOrderLagOperator(0.4).run(2.0 * u, DT)[0]
        return u[:, None], y + 0.2 * np.std(y) * rng.normal(size=len(u))

    model = Corrected(LinearRegression(), FirstOrderLag(), dt=DT).fit(*recording(101))
    assert model.params_["time_constant"] == pytest.approx(0.4, abs=3.0 * 0.007)
    stepwise = Corrected(DecisionTreeRegressor(max_depth=4), FirstOrderLag(), dt=DT)
    with pytest.warns(ConvergenceWarning, match="Corrected has not separated"):
        stepwise.fit(*recording(107))
    both = Sum([("lag", FirstOrderLag()), ("offset", Offset())])
    with pytest.warns(ConvergenceWarning, match="The effects of Corrected follow jumps"):
        Corrected(LinearRegression(), both, dt=DT).fit(*recording(102))


def test_weights_and_what_is_not_read():
    """Both the regressor and the effects count a sample so much; a zero is not read at all."""
    X, y = recordings(low_pass, count=3)
    model, weights = Corrected(pipeline(), FirstOrderLag(), cv=3), np.ones(len(y))
    weights[[20, 350, 351, 700]] = 0.0
    wrong = y.where(weights > 0.0, 50.0)
    found, expected = (clone(model).fit(X, own, sample_weight=weights) for own in (wrong, y))
    assert found.effects_.operator_ == expected.effects_.operator_
    np.testing.assert_array_equal(found.predict(X), expected.predict(X))
    kept = np.arange(len(y)) != 100
    some = clone(model).fit(X[kept], wrong[kept], sample_weight=weights[kept])
    assert some.effects_.operator_.time_constant == pytest.approx(
        found.effects_.operator_.time_constant, rel=0.02
    )
    with pytest.raises(ValueError, match="'sample_weight' of Corrected must be None"):
        Corrected(KNeighborsRegressor(), cv=3).fit(X, y, sample_weight=weights)


def test_constants_of_the_records_are_taken_out():
    X, y = recordings(lambda y, i: y + 0.5 * (-1) ** i + 0.1)
    X_new, y_new = recordings(lambda y, i: y, seed=5)
    model = Corrected(pipeline(), Sum([("gain", Gain()), ("offset", Offset())])).fit(X, y)
    moved = y_new - model.predict(X_new)
    assert rms(moved - moved.mean()) < 0.05
    assert model.fit_error_ < 0.02


def test_a_clipped_linear_regression():
    u = np.concatenate(list(drives(4)))
    X, y = u.reshape(-1, 1), np.minimum(3.0 * u + 1.0, 2.5)
    effects = Cascade([("gain", Gain()), ("limit", Saturation(sides="upper", place="sensor"))])
    model = Corrected(LinearRegression(), effects, cv=4).fit(X, y)
    np.testing.assert_allclose(model.predict(X), y, atol=0.01)
    assert model.params_["limit__upper"] == pytest.approx(2.5, abs=0.01)
    assert set(model.params_std_) == set(model.params_)


def test_further_columns_reach_the_effects_by_number():
    rng = np.random.default_rng(0)
    records = []
    for i, u in enumerate(drives(5)):
        warm = np.full(N, 20.0 + 5.0 * i)
        y = 2.0 * u * (1.0 + 0.02 * (warm - 30.0)) + 0.001 * rng.normal(size=N)
        records.append((np.column_stack([u, warm]), y))
    X, y = stack_records(records, dt=DT)
    model = Corrected(LinearRegression(), Modulated(Gain(), 1)).fit(X, y)
    assert rms(model.predict(X) - y) < 0.005
    assert model.effects_.n_features_in_ == X.shape[1] == 2


def test_what_came_before_is_that_of_the_effects():
    """The lag of a record that begins in motion is estimated behind the regressor."""
    u = np.random.default_rng(0).normal(size=400).cumsum()
    y, _ = FirstOrderLagOperator(0.05).run(2.0 * u + 1.0, 0.01)
    model = Corrected(LinearRegression(), FirstOrderLag(), dt=0.01).fit(u[:, None], y)
    late, known = u[200:, None], np.where(np.arange(200) < 10, y[200:], np.nan)
    error = [np.abs(own - y[200:])[10] for own in (model.predict(late), model.predict(late, known))]
    assert error[1] < 0.01 * error[0]
    with pytest.raises(ValueError, match=r"'return_std' parameter of Corrected\.predict"):
        model.predict(late, return_std=True)


def test_a_gain_by_default():
    u = np.concatenate(list(drives(2))).reshape(-1, 1)
    model = Corrected(LinearRegression(), cv=3).fit(u, 3.0 * u[:, 0] + 1.0)
    np.testing.assert_allclose(model.predict(u), 3.0 * u[:, 0] + 1.0)
    assert model.n_iter_ <= 2


def test_rows_of_an_array_are_no_neighbours_across_a_fold():
    """As those of a frame, whose index tells where a fold has been cut out."""
    rng = np.random.default_rng(0)
    u = rng.uniform(-1.0, 1.0, 120)
    X = pd.DataFrame({"u": u}, DT * np.arange(120))
    y = np.convolve([u[0], u[0], *u], [0.5, 0.3, 0.2], "valid") + 0.01 * rng.normal(size=120)
    regressor = make_pipeline(LaggedFeatures([0, 1, 2]), Ridge(1e-6))
    model = Corrected(regressor, Gain(), cv=4, dt=DT)
    found, expected = clone(model).fit(u[:, None], y), clone(model).fit(X, y)
    np.testing.assert_allclose(found.predict(u[:, None]), expected.predict(X), rtol=1e-9)
    assert found.fit_error_ == pytest.approx(expected.fit_error_)
    assert found.fit_error_ < 0.015


def test_inputs_beyond_those_of_a_regressor_are_told():
    """A tree answers with a constant there; what is linear throughout goes on a long way."""
    u = next(iter(drives(1)))[:, None]
    for regressor, factor in ((DecisionTreeRegressor(max_depth=5), 2.0), (LinearRegression(), 1e3)):
        model = Corrected(regressor, cv=3).fit(u, u[:, 0])
        model.predict(u)  # warnings are errors
        with pytest.warns(ExtrapolationWarning, match="Corrected was fitted to drives from"):
            model.predict(factor * u)
    model.predict(2.0 * u)


def test_what_is_refused():
    u = np.concatenate(list(drives(1))).reshape(-1, 1)
    with pytest.raises(TypeError, match="'effects' parameter of Corrected"):
        Corrected(LinearRegression(), LinearRegression()).fit(u, u[:, 0])
    with pytest.raises(ValueError, match="at least 5 samples for 5 folds"):
        Corrected(LinearRegression()).fit(u[:4], u[:4, 0])


# ------------------------------------------------------------------------------- out of fold


@pytest.mark.parametrize("count", [1, 6])
def test_nothing_is_learned_from_the_scored_fold(count):
    """Other responses in one fold change no prediction of it, nor what its clone is taught."""
    X, y = recordings(low_pass, count=count)
    y = y.to_numpy()
    slices = record_slices(X)
    fold = fold_of_rows(slices, 3)
    other = np.where(fold == 1, np.random.default_rng(1).normal(size=len(y)), y)
    operator = Series(("gain", "lag"), (GainOperator(), FirstOrderLagOperator(0.05)))
    segments = []
    for own in (fold[s.rows] for s in slices):
        edges = np.flatnonzero(np.diff(own, prepend=-1, append=-1)).tolist()
        segments.append(tuple(pairwise(edges)))
    starts = [s.rows.start + a for s, own in zip(slices, segments, strict=True) for a, _ in own]
    train = [fold[starts] != k for k in range(3)]

    def taught_and_predicted(response):
        backfitting = Backfitting(KNeighborsRegressor(3), X, slices, fold)

        def problem_of(effects, p):
            data = [
                RecordData(p[s.rows], response[s.rows], s.dt, segments=own)
                for s, own in zip(slices, segments, strict=True)
            ]
            return OperatorProblem(operator, data)

        targets = np.tile(response, (3, 1))
        start = Turn(targets, backfitting.predict(targets), None, 1.0)
        last = backfitting.alternate(start, problem_of, lambda e, p: (None, 0.5), train, 1)
        return last.targets[1][fold != 1], backfitting.out_of_fold(last.predictions)[fold == 1]

    for a, b in zip(taught_and_predicted(y), taught_and_predicted(other), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_folds():
    X, _ = recordings(lambda y, i: y, count=6)
    whole = fold_of_rows(record_slices(X), 4)
    np.testing.assert_array_equal(whole, np.repeat([0, 1, 2, 3, 0, 1], N))
    single = fold_of_rows(record_slices(X.iloc[:N]), 4)
    assert np.all(np.diff(single) >= 0)
    assert set(np.bincount(single)) == {N // 4}


@pytest.mark.parametrize(
    "operator",
    [
        GainOperator(2.0, 1.0),
        FirstOrderLagOperator(0.03),
        SecondOrderModeOperator(60.0, 0.1),
        Series(("gain", "lag"), (GainOperator(0.5), FirstOrderLagOperator(0.02))),
        Scaled(
            OnColumnOperator(GainOperator(2.0), 0), 1, 0.3, 0.1, FirstOrderLagOperator(0.05), (1.0,)
        ),
    ],
)
def test_the_change_is_that_of_damped_least_squares(operator):
    """Against the dense solution, with L from differences."""
    rng = np.random.default_rng(0)
    n = 60
    u, residual = rng.normal(size=n), np.r_[np.zeros(5), rng.normal(size=n - 5)]
    u[0], units = 0.0, np.eye(n)
    if operator.reads_columns:
        u = np.column_stack([u, rng.normal(size=n)])
        units = np.stack([units, np.zeros((n, n))], axis=-1)
    base = operator.run(u, DT)[0]
    start = operator.init(u[0])
    L = np.stack([operator.run(u + one, DT, start)[0] - base for one in units], axis=1)
    expected = np.linalg.solve(L.T @ L + 0.1 * np.eye(n), L.T @ residual)
    found = explained_change(operator, RecordData(u, base, DT), residual)

    def cost(change):
        return np.sum((residual - L @ change) ** 2) + 0.1 * change @ change

    assert cost(found) < 1.02 * cost(expected)


def test_a_forest_behind_which_there_is_a_mode():
    rng = np.random.default_rng(0)
    mode = SecondOrderModeOperator(2 * np.pi * 10, 0.05)
    records = [(u, mode.run(np.tanh(u), DT)[0] + 0.005 * rng.normal(size=N)) for u in drives(8)]
    known, (X, y) = stack_records(records[:6], dt=DT), stack_records(records[6:], dt=DT)
    forest = RandomForestRegressor(15, min_samples_leaf=5, random_state=0)
    model = Corrected(forest, SecondOrderMode(), max_iter=3).fit(*known)
    alone = forest.fit(*known)
    assert rms(model.predict(X) - y) < 0.5 * rms(alone.predict(X) - y)
    assert model.params_["natural_frequency"] == pytest.approx(2 * np.pi * 10, rel=0.02)
