"""Each row of the page on meta-estimators: what works in which, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from sklearn.compose import TransformedTargetRegressor
from sklearn.ensemble import (
    AdaBoostRegressor,
    BaggingRegressor,
    StackingRegressor,
    VotingRegressor,
)
from sklearn.exceptions import ConvergenceWarning
from sklearn.feature_selection import RFE, RFECV, SequentialFeatureSelector
from sklearn.frozen import FrozenEstimator
from sklearn.linear_model import LinearRegression, RANSACRegressor
from sklearn.model_selection import GridSearchCV, train_test_split
from sklearn.multioutput import MultiOutputRegressor, RegressorChain
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skhyst.compose import Cascade
from skhyst.exceptions import RecordError
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.model_selection import RecordKFold
from skhyst.preprocessing import LaggedFeatures
from skhyst.records import stack_records
from skhyst.static import SmoothCurve

DT, SECONDS = 0.001, 0.02
RNG = np.random.default_rng(0)
DRIVES = [np.cumsum(RNG.normal(size=300)) for _ in range(4)]
RECORDS = [(u[:, None], FirstOrderLagOperator(SECONDS).run(u, DT)[0]) for u in DRIVES]
X, Y = stack_records(RECORDS, dt=DT)
TWO = pd.concat([Y, 2.0 * Y], axis=1, keys=["one", "two"])
ONE = X.loc[[0]], Y.loc[[0]]
LAG = FirstOrderLag()

# all, with the frame that they are given, and the models that they have fitted
KEEP = {
    "Pipeline": (make_pipeline(LAG), Y, lambda found: [found[-1]]),
    "GridSearchCV": (
        GridSearchCV(LAG, {"hold": ["foh", "zoh"]}, cv=RecordKFold(2)),
        Y,
        lambda found: [found.best_estimator_],
    ),
    "TransformedTargetRegressor": (
        TransformedTargetRegressor(LAG, transformer=StandardScaler()),
        Y,
        lambda found: [found.regressor_],
    ),
    "VotingRegressor": (VotingRegressor([("lag", LAG)]), Y, lambda found: found.estimators_),
    "StackingRegressor": (
        StackingRegressor([("lag", LAG)], LinearRegression(), cv=RecordKFold(2)),
        Y,
        lambda found: found.estimators_,
    ),
    "MultiOutputRegressor": (MultiOutputRegressor(LAG), TWO, lambda found: found.estimators_),
}
ARRAYS = {
    "RegressorChain": (RegressorChain, lambda y: np.column_stack([y, 2.0 * y])),
    "BaggingRegressor": (lambda lag: BaggingRegressor(lag, 3, random_state=0), lambda y: y),
}
REFUSED = {
    "AdaBoostRegressor": (AdaBoostRegressor(LAG, random_state=0), RecordError, "draws them"),
    "RFE": (RFE(LAG), ValueError, "coef_"),
    "RFECV": (RFECV(LAG), ValueError, "coef_"),
    "SequentialFeatureSelector": (
        SequentialFeatureSelector(LAG, n_features_to_select=1, cv=RecordKFold(2)),
        RecordError,
        "The index of X must carry",
    ),
}


def test_the_page_has_these_rows():
    page = Path(__file__).parents[1] / "docs" / "howto" / "meta_estimators.rst"
    named = re.findall(r"^   \* - (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)[1:]
    names = [name.strip("`") for row in named for name in row.split(", ")]
    assert sorted(names) == sorted([*KEEP, *ARRAYS, *REFUSED, "RANSACRegressor"])


@pytest.mark.parametrize("name", KEEP)
def test_records_are_kept(name):
    """The index comes through: four records, in seconds."""
    estimator, y, models_of = KEEP[name]
    found = estimator.fit(X, y)
    for model in models_of(found):
        assert [(s.n_samples, s.dt) for s in model.records_] == [(300, DT)] * 4
        assert model.params_["time_constant"] == pytest.approx(SECONDS)
    np.testing.assert_allclose(found.predict(X), y, atol=1e-9)


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_are_one_record_in_samples(name):
    """Unless an interval is said; what came of it is in the records of the fit."""
    kind, response = ARRAYS[name]
    X, y = ONE[0], response(ONE[1])
    for model in kind(FirstOrderLag()).fit(X, y).estimators_:
        assert (len(model.records_), model.dt_, model.time_unit_) == (1, 1.0, "sample")
        assert model.params_["time_constant"] == pytest.approx(SECONDS / DT)
    found = kind(FirstOrderLag(dt=DT)).fit(X, y)
    for model in found.estimators_:
        assert model.params_["time_constant"] == pytest.approx(SECONDS)
    np.testing.assert_allclose(found.predict(X), y, atol=1e-9)


@pytest.mark.parametrize("name", REFUSED)
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.FitFailedWarning")
def test_what_is_refused(name):
    estimator, error, told = REFUSED[name]
    with pytest.raises(error, match=told):
        estimator.fit(X.assign(temperature=20.0), Y)


@pytest.mark.parametrize("steps", [(), (StandardScaler(),)], ids=["model", "pipeline"])
def test_a_pipeline_is_bagged_by_drawing_rows(steps):
    """A pipeline takes no weights by itself, so that rows are drawn for it, and refused."""
    model = make_pipeline(*steps, LAG) if steps else LAG
    bagging = BaggingRegressor(model, 3, random_state=0)
    if not steps:
        assert bagging.fit(*ONE).score(*ONE) > 1.0 - 1e-12
        return
    with pytest.raises(RecordError, match="as sample_weight"):
        bagging.fit(*ONE)


def test_rows_in_another_order_are_told():
    """Of data without noise, the time constant of the shuffled array is another."""
    lag = FirstOrderLag(dt=DT)
    ransac = RANSACRegressor(lag, min_samples=100, max_trials=2, random_state=0)
    with pytest.warns(ConvergenceWarning, match="shuffled.*order of time"):
        model = ransac.fit(*ONE)
    assert model.estimator_.params_["time_constant"] != pytest.approx(SECONDS, rel=0.01)
    shuffled = train_test_split(np.asarray(ONE[0]), np.asarray(ONE[1]), random_state=0)[::2]
    with pytest.warns(ConvergenceWarning, match="shuffled.*order of time"):
        lag.fit(*shuffled)
    held = Cascade([("gain", FrozenEstimator(Gain().fit(*shuffled))), ("curve", SmoothCurve(3))])
    held.fit(*shuffled)  # nothing of them has a memory, and warnings are errors


def test_an_array_from_a_step_is_refused_where_y_has_the_index():
    with pytest.raises(RecordError, match="set_output"):
        make_pipeline(StandardScaler(), LAG).fit(X, Y)
    inside = make_pipeline(StandardScaler(), LAG)
    found = VotingRegressor([("lag", inside)]).fit(*ONE).estimators_[0][-1]
    assert found.time_unit_ == "sample"  # there y is an array too
    assert found.params_["time_constant"] == pytest.approx(SECONDS / DT)
    inside.set_output(transform="pandas")
    found = VotingRegressor([("lag", inside)]).fit(*ONE).estimators_[0][-1]
    assert found.params_["time_constant"] == pytest.approx(SECONDS)


# --------------------------------------------------------------------------------- drawn rows

UNDETERMINED = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")


def recording(kind, n=500):
    rng = np.random.default_rng(1)
    u = rng.normal(size=n)
    if kind == "random walk, 12 bit":
        u = np.cumsum(u)
    y = FirstOrderLagOperator(3.0).run(u, 1.0)[0]
    if kind == "random walk, 12 bit":
        u, y = (np.round(4096 * own / np.ptp(own)) for own in (u, y))
    return u[:, None], y


@UNDETERMINED
@pytest.mark.parametrize("share", [0.3, 1.0])
@pytest.mark.parametrize("kind", ["white noise", "random walk, 12 bit"])
def test_drawn_rows_are_refused(kind, share):
    u, y = recording(kind)
    rows = np.random.default_rng(2).integers(len(y), size=int(share * len(y)))
    LAG.fit(u, y)
    with pytest.raises(RecordError, match="repeated, in random order"):
        Cascade([("lag", LAG)]).fit(u[rows], y[rows])
    with pytest.raises(RecordError, match="repeated, in random order"):
        make_pipeline(LaggedFeatures([0, 1]), LinearRegression()).fit(u[rows], y[rows])
    if share == 1.0:
        with pytest.raises(RecordError, match="a sorted random sample with replacement"):
            LAG.fit(u[np.sort(rows)], y[np.sort(rows)])
    SmoothCurve(3).fit(u[rows], y[rows])  # without a memory, rows have no order
    time = pd.Index(DT * np.arange(len(rows)), name="time")
    LAG.fit(pd.DataFrame({"u": u[rows, 0]}, time), y[rows])  # says that they are in order


@UNDETERMINED
@pytest.mark.parametrize("kind", ["periods", "quantised", "levels", "rests", "polled", "slow"])
def test_rows_that_are_equal_in_a_recording_are_not_drawn(kind):
    rng, n = np.random.default_rng(3), 600
    u = rng.normal(size=n)
    if kind == "periods":
        u = np.tile(u[: n // 2], 2)
    if kind == "quantised":
        u = rng.integers(1000, size=n).astype(float)
    if kind == "levels":
        u = rng.choice([-1.0, 0.0, 2.0], size=n)
    if kind == "rests":
        u = np.repeat(u[: n // 2], 2)
    if kind == "polled":  # by a clock that jitters, 1.6 times as often as there are values
        u = u[((np.arange(n) + rng.uniform(-0.5, 0.5, n)) / 1.6 + 1.0).astype(int)]
    if kind == "slow":  # of 6 bit
        u = np.round(32.0 * np.sin(np.arange(n) / 40.0))
    y = np.round(u + 3.0 * rng.normal(size=n)) if kind == "quantised" else 2.0 * u
    LAG.fit(u[:, None], y)
