"""Every hysteresis model can be declared, and an effect beside or behind it is found.

The hysteresis of the recordings is the model's own, so that nothing else is missing; the effect is
made by NumPy alone.
"""

import warnings

import numpy as np
import pandas as pd
import pytest

from skhyst import hysteresis
from skhyst.compose import Cascade, ScheduledParameters, Sum
from skhyst.diagnosis import EffectSearchCV
from skhyst.disturbance import Offset
from skhyst.linear import DynamicStiffness, FirstOrderLag, Gain, LogCreep
from skhyst.records import stack_records

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
STAGES = {"BoucWenStage", "FrictionStage", "RestoringForce"}
MODELS = sorted(set(hysteresis.__all__) - STAGES)


LAWS = {  # what made-up loops are no model of
    "DynamicStiffness": DynamicStiffness,
    "Gain": Gain,
    "LogCreep": LogCreep,
}


def model(name):
    return LAWS[name]() if name in LAWS else getattr(hysteresis, name)(**OPTIONS.get(name, {}))


def drives(seed):
    rng = np.random.default_rng(seed)
    time = DT * np.arange(N)
    for _ in range(5):
        f = rng.uniform(0.3, 3.0, 4)
        waves = np.sin(2 * np.pi * np.outer(time, f) + rng.uniform(0, 6.28, 4)) / f
        yield rng.uniform(0.6, 1.0) * waves.sum(axis=1)


def recording(name, change, seed=3):
    """Return records of the model's own response to which an effect has been done."""
    u = list(drives(seed))
    loop = [np.tanh(v) + 0.2 * np.sign(np.gradient(v)) * (1 - np.exp(-np.abs(v))) for v in u]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # made-up loops determine few models
        fitted = model(name).fit(*stack_records(list(zip(u, loop, strict=True)), dt=DT))
    clean = [fitted.operator_.run(v, DT)[0] for v in u]
    size = np.ptp(np.concatenate(clean))
    rng = np.random.default_rng(seed)
    return stack_records(
        [
            (v, change(y, i, size) + 0.002 * size * rng.normal(size=N))
            for i, (v, y) in enumerate(zip(u, clean, strict=True))
        ],
        dt=DT,
    )


def offset(y, i, size):
    return y + 0.1 * size * (-1.0) ** i


def nothing(y, i, size):
    return y


def lag(y, i, size):
    """Integrate ``x' = (y - x) / 0.05`` between samples, in fine steps."""
    x, out = y[0], np.empty_like(y)
    fine = 50
    for k in range(len(y)):
        start = y[max(k - 1, 0)]
        for j in range(fine):
            x += (start + (y[k] - start) * (j + 0.5) / fine - x) * DT / 0.05 / fine
        out[k] = x
    return out


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize(
    ("name", "change"),
    [(name, offset) for name in MODELS]
    + [(name, lag) for name in ("BoucWen", "LuGre", "Preisach")],
)
def test_the_effect_is_found(name, change):
    X, y = recording(name, change)
    search = EffectSearchCV(
        model(name), effects=["offset", "lag", "output_saturation"], max_effects=1, random_state=0
    ).fit(X, y)
    assert search.effects_ == [change.__name__]
    assert search.error_after_ < 0.7 * search.error_before_
    assert search.evidence_[change.__name__].statement
    assert np.isfinite(search.predict(X)).all()


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("name", MODELS)
def test_in_a_cascade(name):
    X, y = recording(name, lag)
    cascade = Cascade([("hysteresis", model(name)), ("lag", FirstOrderLag())]).fit(X, y)
    assert cascade.fit_error_ < 0.01 * np.ptp(y)
    assert cascade.operators_["lag"].time_constant == pytest.approx(0.05, rel=0.1)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("change", [nothing, lag])
@pytest.mark.parametrize("name", LAWS)
def test_other_laws(name, change):
    search = EffectSearchCV(
        model(name), effects=["drift", "lag", "output_saturation"], max_effects=1, random_state=0
    ).fit(*recording(name, change))
    assert search.effects_ == ([] if change is nothing else ["lag"])


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
