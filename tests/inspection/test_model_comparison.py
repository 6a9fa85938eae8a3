"""Comparison of models: which one is taken of devices whose law is known, and what is refused."""

import numpy as np
import pandas as pd
import pytest

from skhyst.discovery import parse_model
from skhyst.exceptions import RecordError
from skhyst.hysteresis import BacklashOperator, PrandtlIshlinskii
from skhyst.inspection import ModelComparisonDisplay, compare_models
from skhyst.inspection._model_comparison import (
    _FROM_ZERO,
    _IN_MOTION,
    _JOINED,
    _PARTS,
    _SINGLE,
    _difference,
    _taken,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.records import stack_records

QUICK = {
    "gain": Gain(),
    "lag": FirstOrderLag(),
    "plays": PrandtlIshlinskii(),
    "mode": SecondOrderMode(),
}
DT = 1e-3
RNG = np.random.default_rng(0)
DRIVE = np.cumsum(RNG.normal(size=800)) * np.hanning(800)
NOISE = 1e-3 * np.ptp(DRIVE) * RNG.normal(size=800)
LAWS = {
    "gain": lambda u: 2.0 * u,
    "plays": lambda u: BacklashOperator(0.2 * np.ptp(DRIVE)).run(u, DT)[0] + u,
    "mode": lambda u: SecondOrderModeOperator(2.0 * np.pi * 30.0, 0.1).run(u, DT)[0],
}


def recording(law, scale=1.0):
    y = scale * (LAWS[law](DRIVE) + NOISE)
    return stack_records([(DRIVE, y)], dt=DT)


@pytest.mark.parametrize("law", LAWS)
def test_the_law_of_the_device_is_taken(law):
    found = compare_models(*recording(law), QUICK)
    assert found.taken == law
    if law != "plays":  # which the default thresholds only approximate
        assert found.table.loc[law, "error"] == pytest.approx(np.std(NOISE), rel=0.2)


@pytest.mark.parametrize("scale", [1e-9, 1e9])
def test_units_of_the_response_change_no_choice(scale):
    one, other = (compare_models(*recording("mode", own), QUICK) for own in (1.0, scale))
    assert other.taken == one.taken
    ratio = other.table["error"] / one.table["error"]
    np.testing.assert_allclose(ratio, scale, rtol=1e-3)


def test_every_default_model_is_one_that_can_be_declared_by_its_name():
    for name, (model, about) in (_SINGLE | _FROM_ZERO | _IN_MOTION | _JOINED).items():
        assert repr(parse_model(name)) == repr(model)
        assert about
    assert _PARTS.keys() == _JOINED.keys()
    assert {part for parts in _PARTS.values() for part in parts} <= _SINGLE.keys()


@pytest.mark.parametrize(
    ("start", "taken"), [(0.0, "(initial_state='zero')"), (9.0, "(initial_state='estimate')")]
)
def test_a_device_that_has_not_rested_is_compared_from_its_start(monkeypatch, start, taken):
    """Its drive begins at a value under which it has not rested: switched on, or after a larger."""
    kept = ("first_order_lag", "second_order_mode")
    for own in ("_SINGLE", "_FROM_ZERO", "_IN_MOTION", "_JOINED"):
        models = {n: m for n, m in globals()[own].items() if n.startswith(kept)}
        monkeypatch.setattr(f"skhyst.inspection._model_comparison.{own}", models)
    u = np.repeat([5.0, 1.0, 4.0, 2.0, 3.0, 5.0, 0.5, 4.0], 50)
    device = FirstOrderLagOperator(60.0)
    state = device.init(start, "rest" if start else "zero")
    y = device.run(u, 1.0, state)[0]
    y = y + 1e-3 * np.random.default_rng(0).normal(size=u.size)
    assert compare_models(u[:, None], y).taken == kept[0] + taken
    rested = device.run(u - 5.0, 1.0)[0] + y - device.run(u, 1.0, state)[0]
    assert compare_models(u[:, None] - 5.0, rested).table.index.tolist() == [*kept]


def test_a_model_of_two_mechanisms_is_shown_and_not_taken():
    table = pd.DataFrame(
        {"about": "", "single": [True, False], "error": [0.9, 0.1], "n_parameters": 1},
        index=["one", "two"],
    )
    display = ModelComparisonDisplay(table, "one", None, 10.0)
    assert display.best == "two"
    assert display.worse("one") == pytest.approx(9.0)
    assert "9 times smaller" in display.reason
    assert str(display).splitlines()[1].split() == [">", "one", "9", "%"]
    assert len(display.plot().ax_.lines) == 2


def test_of_two_models_that_are_as_good_the_one_with_fewer_parameters_is_taken():
    table = pd.DataFrame(
        {"about": "", "single": True, "error": [0.100, 0.101], "n_parameters": [21, 4]},
        index=["plays", "mode"],
    )
    _, taken, as_good = _taken(table, {"plays": [0.1, 0.2], "mode": [0.3, 0.3]})
    assert (taken, as_good) == ("mode", "plays")
    assert "4 parameters instead of 21" in ModelComparisonDisplay(table, taken, as_good, 1.0).reason
    # one standard error above the least: the sentence has the figures that decide
    table.loc["mode", "error"], squares = 0.140, {"plays": [0.01, 0.01], "mode": [0.008, 0.032]}
    assert _taken(table, squares) == (None, taken, as_good)
    difference = _difference(squares[taken], squares[as_good])
    assert difference == pytest.approx((1.0, 1.2))
    reason = ModelComparisonDisplay(table, taken, as_good, 1.0, difference=difference).reason
    assert "14 %, is not distinguished from that of plays, 10 %" in reason
    assert "larger by 100 ± 120 % in the folds" in reason


@pytest.mark.parametrize(
    ("tanks", "taken"),
    [
        (2.3, ("prandtl_ishlinskii+first_order_lag", "first_order_lag", None)),
        (0.5, (None, "tank_chain", None)),
    ],
)
def test_a_part_is_taken_of_two_mechanisms_that_explain_far_more(tanks, taken):
    """From another model that comes nearer alone a search would have to find both."""
    errors = dict.fromkeys(_SINGLE, 6.9) | dict.fromkeys(_JOINED, 0.6)
    errors |= {"prandtl_ishlinskii": 3.2, "first_order_lag": 2.5, "tank_chain": tanks}
    errors |= {
        "prandtl_ishlinskii+first_order_lag": 0.2,
        "prandtl_ishlinskii+second_order_mode": 0.199,
    }
    table = pd.Series(errors).to_frame("error")
    table["single"] = table.index.isin(list(_SINGLE))
    table["n_parameters"] = [21 if "prandtl" in name else 4 for name in table.index]
    assert _taken(table, {name: 5 * [error**2] for name, error in errors.items()}) == taken


def test_a_model_that_cannot_be_fitted_has_no_error():
    class Broken(Gain):
        def identify(self, data):
            raise RecordError("no")

    seen, models = [], {"broken": Broken(), "gain": Gain()}
    found = compare_models(*recording("gain"), models, on_progress=seen.append)
    assert found.taken == "gain"
    assert np.isnan(found.table.loc["broken", "error"])
    assert str(found).splitlines()[1].split() == ["broken", "failed"]
    assert [(step.trying, step.done, step.total) for step in seen] == [
        ("broken", 0, 2),
        ("gain", 1, 2),
        ("", 2, 2),
    ]
    assert str(seen[0]) == "comparing models: broken (0 of 2)"
    with pytest.raises(RecordError, match="no"):
        compare_models(*recording("gain"), {"broken": Broken()})


def test_several_records_and_a_limit_of_samples():
    X, y = stack_records([(DRIVE, LAWS["plays"](DRIVE)), (-DRIVE, LAWS["plays"](-DRIVE))], dt=DT)
    found = compare_models(X, y, {"gain": Gain(), "plays": PrandtlIshlinskii()}, max_samples=600)
    first = compare_models(
        X.groupby(level=0).head(300), y.groupby(level=0).head(300), {"gain": Gain()}
    )
    assert found.taken == "plays"
    assert found.table.loc["gain", "error"] == first.table.loc["gain", "error"]


def test_a_constant_response_is_refused_and_an_exact_one_is_not():
    with pytest.raises(RecordError, match="response must move"):
        compare_models(DRIVE[:, None], np.ones(800), QUICK)
    with pytest.raises(RecordError, match="drive must move"):
        compare_models(np.ones((800, 1)), DRIVE, QUICK)
    with pytest.raises(RecordError, match="must be another signal"):
        compare_models(DRIVE[:, None], DRIVE, QUICK)
    found = compare_models(DRIVE[:, None], 2.0 * DRIVE, {"line": Gain(), "lag": FirstOrderLag()})
    assert found.taken == "line"
    assert "line" in str(found.plot())


@pytest.mark.parametrize("models", [{}, {"line": object()}])
def test_what_is_no_model_is_refused(models):
    with pytest.raises(ValueError, match="'models' parameter of compare_models"):
        compare_models(*recording("gain"), models)
