"""Every hysteresis model can be declared, and an effect beside or behind it is found.

The hysteresis of the recordings is the model's own, so that nothing else is missing; the effect is
not that of the package.
"""

import warnings
from functools import cache

import numpy as np
import pandas as pd
import pytest
from plants import physics
from sklearn.base import clone

from skhyst import hysteresis, linear
from skhyst.base import ParametricModel
from skhyst.compose import Cascade, ScheduledParameters, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.disturbance import Offset
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, Gain
from skhyst.records import stack_records

pytestmark = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
DT = 0.01
N = 300
OPTIONS = {
    "PrandtlIshlinskii": {"n_operators": 5},
    "ModifiedPrandtlIshlinskii": {"n_operators": 5, "n_dead_zones": 1},
    "RateDependentPrandtlIshlinskii": {"n_operators": 4},
    "Preisach": {"n_levels": 6},
    "KrasnoselskiiPokrovskii": {"n_levels": 6},
    "MaxwellSlip": {"n_elements": 5},
    "LuGre": {"fit_stiffness": True},
}
# in the equation of motion: a position has no limit that would not act back on it
STAGES = {"BoucWenStage", "EndStops", "FrictionStage", "RestoringForce"}
MODELS = sorted(
    name
    for name in set(hysteresis.__all__) - STAGES
    if issubclass(getattr(hysteresis, name), ParametricModel)
)


BEHIND = {"BoucWen", "LuGre", "Preisach"}  # with an effect behind them, others with one beside
LAWS = ["DynamicStiffness", "Gain", "LogCreep"]  # what made-up loops are no model of


def model(name):
    return getattr(linear if name in LAWS else hysteresis, name)(**OPTIONS.get(name, {}))


def drives(seed):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(N)
    for _ in range(5):
        f = rng.uniform(0.3, 3.0, 4)
        waves = np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 6.28, 4)) / f
        yield rng.uniform(0.6, 1.0) * waves.sum(axis=1)


@cache
def plant(name, seed):
    """Return drives, and a model's own responses to them once it was fitted to made-up loops."""
    u = list(drives(seed))
    loop = [np.tanh(v) + 0.2 * np.sign(np.gradient(v)) * (1 - np.exp(-np.abs(v))) for v in u]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # made-up loops determine few models
        fitted = model(name).fit(*stack_records(list(zip(u, loop, strict=True)), dt=DT))
    return u, [fitted.operator_.run(v, DT)[0] for v in u]


def recording(name, change, seed=3):
    """Return records of the model's own response to which an effect has been done."""
    u, clean = plant(name, seed)
    size = np.ptp(np.concatenate(clean))
    changed = [change(y, i, size) for i, y in enumerate(clean)]
    X, y = stack_records(list(zip(u, changed, strict=True)), dt=DT)
    return X, y + 0.002 * size * np.random.default_rng(seed).normal(size=len(y))


def offset(y, i, size):
    return y + 0.1 * size * (-1.0) ** i


def nothing(y, i, size):
    return y


def lag(y, i, size):
    return physics.first_order(y, DT, 0.05)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        (name, lag) if name in BEHIND else pytest.param(name, offset, marks=pytest.mark.slow)
        for name in MODELS
    ],
)
def test_the_effect_is_found(name, change):
    X, y = recording(name, change)
    effects = ["offset", "lag"] if name in BEHIND else ["offset"]
    options = {"cv": 2, "max_effects": 1, "random_state": 0}
    search = EffectSearchCV(model(name), effects=effects, **options).fit(X, y)
    assert search.effects_ == [change.__name__]
    assert search.error_after_ < 0.7 * search.error_before_
    assert search.evidence_[change.__name__].statement
    assert np.isfinite(search.predict(X)).all()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=pytest.mark.slow) if n in ("FreeMass", "JilesAtherton") else n
        for n in MODELS
    ],
)
def test_in_a_cascade(name):
    X, y = recording(name, lag)
    cascade = Cascade([("hysteresis", model(name)), ("lag", FirstOrderLag())]).fit(X, y)
    assert cascade.fit_error_ < 0.01 * np.ptp(y)
    assert cascade.operators_["lag"].time_constant == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_other_laws(name):
    effects = ["drift", "lag", "output_saturation"]
    options = {"cv": 2, "max_effects": 1, "random_state": 0}
    search = EffectSearchCV(model(name), effects=effects, **options).fit(*recording(name, lag))
    assert search.effects_ == ["lag"]


@pytest.mark.slow
def test_what_stands_beside_a_declared_model_stays_there():
    X, y = recording("PrandtlIshlinskii", lambda y, i, size: offset(lag(y, i, size), i, size))
    declared = Sum([("hysteresis", model("PrandtlIshlinskii")), ("constant", Offset())])
    options = {"effects": ["drift", "lag", "offset"], "random_state": 0}
    search = EffectSearchCV(declared, **options).fit(X, y)
    assert search.effects_ == ["lag"]
    names = [name for name, _ in search.best_estimator_.steps]
    assert names == ["model", "constant"]
    again = EffectSearchCV(search.best_estimator_, **options).fit(X, y)
    assert again.effects_ == []
    assert again.error_before_ == pytest.approx(search.error_after_, rel=0.01)


def test_a_disturbance_alone_is_not_searched():
    with pytest.raises(ValueError, match=r"'estimator' parameter.*Sum"):
        EffectSearchCV(Offset()).fit(*recording("PrandtlIshlinskii", nothing))


@pytest.mark.parametrize("by", [1, "load"])
def test_a_model_scheduled_by_a_column_is_declared_beside_an_offset(by):
    records = []
    for k in range(4):
        u = np.cumsum(np.random.default_rng(k).normal(size=N)) / 5
        frame = pd.DataFrame({"drive": u, "load": float(k), "other": (3.0, 1.0, 0.0, 2.0)[k]})
        records.append((frame, u * (1.0 + 0.2 * k) + 0.3 * k))
    X, y = stack_records(records, dt=DT)
    y += 0.01 * np.random.default_rng(9).normal(size=len(y))
    model = Sum([("gain", ScheduledParameters(Gain(), by=by)), ("offset", Offset())])
    for _ in range(2):  # what the search has found is a declared model again
        search = EffectSearchCV(model, effects=["lag"], cv=2, max_effects=1).fit(X, y)
        assert search.effects_ == []
        model = search.best_estimator_
        assert search.error_after_ == pytest.approx(0.01, rel=0.2)
        assert model.fit_error_ == pytest.approx(0.01, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["added", "scaled"])
def test_what_a_column_does_is_declared_again(effect):
    rng = np.random.default_rng(5)
    records = []
    for _ in range(4):
        u, load = np.cumsum(rng.normal(size=(2, N)), axis=1) / 5
        y = u + 0.3 * load if effect == "added" else u * (1.0 + 0.1 * load)
        frame = pd.DataFrame({"drive": u, "load": load})
        records.append((frame, y + 0.01 * rng.normal(size=N)))
    X, y = stack_records(records, dt=DT)
    options = {"effects": ["auxiliary_input", "lag"], "cv": 2, "random_state": 0}
    search = EffectSearchCV(PrandtlIshlinskii(3), **options).fit(X, y)
    assert search.effects_ == ["auxiliary_input"]
    again = EffectSearchCV(search.best_estimator_, **options).fit(X, y)
    assert again.effects_ == []
    assert again.error_before_ == pytest.approx(search.error_after_, rel=0.01)
    assert again.held_out_error(X, y) == pytest.approx(0.01, rel=0.1)
    refitted = clone(search.best_estimator_).fit(X, y)
    assert refitted.fit_error_ == pytest.approx(search.best_estimator_.fit_error_, rel=1e-3)
