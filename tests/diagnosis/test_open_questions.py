"""What a record would tell of the models that a search has left open."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import search_steps

from skhyst.diagnosis import _open_questions
from skhyst.diagnosis._open_questions import Contrasts, Fitted, Intervals, _inverse, _noise
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.noise import NoiseModel
from skhyst.optimize import RecordData

DT = 0.01


def record(n, seed, gain=2.0, intercept=1.0):
    rng = np.random.default_rng(seed)
    u = rng.normal(size=n)
    return RecordData(u, gain * u + intercept + 0.1 * rng.normal(size=n), DT)


def basis_of(*records):
    u = np.concatenate([r.u for r in records])
    return np.c_[u, np.ones(len(u))]


def line(*records):
    model = Gain()
    return search_steps.fitted(model, list(records))


def searched(tree, records, verdict="noise", noise=0.1):
    return SimpleNamespace(
        _structure=tree,
        _records=records,
        noise_model_=NoiseModel("white", noise),
        response_=np.concatenate([r.y for r in records]),
        verdict_=verdict,
        min_improvement=0.5,
    )


def test_a_wrong_model_misses_what_least_squares_of_both_records_leave():
    """The old data hold its parameters back as far as they tell them."""
    old, new = record(40, 0), record(25, 1, gain=5.0)
    fitted = Fitted(line(old), [old])
    predicted = fitted.predict(new)
    coefficients = np.linalg.lstsq(basis_of(old), old.y, rcond=None)[0]
    np.testing.assert_allclose(predicted, basis_of(new) @ coefficients, rtol=1e-6)
    design = np.r_[basis_of(new), basis_of(old)]
    y = np.r_[new.y, basis_of(old) @ coefficients]
    left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    assert fitted.misses(new.y, new) == pytest.approx(left @ left, rel=1e-6)
    assert fitted.misses(predicted, new) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("units", [(1.0, 1.0), (1e-6, 1e6)])
def test_the_inverse_of_a_gram_matrix_is_large_where_it_tells_nothing(units):
    gram = np.array([[4.0, 1.0], [1.0, 3.0]])
    found = _inverse(gram * np.outer(units, units)) * np.outer(units, units)
    np.testing.assert_allclose(found @ gram, np.eye(2), atol=1e-8)
    silent = _inverse(np.diag([4.0, 0.0]))
    assert silent[0, 0] == pytest.approx(0.25)
    assert silent[1, 1] > 1e9


def pair(names, values, misses):
    """Return two models as they answer: what each predicts, and misses of what it is shown."""
    sides = []
    for value, missed in zip(values, misses, strict=True):
        models = [
            SimpleNamespace(predict=lambda r, v=value: v, misses=lambda y, r, m=m: m[y])
            for m in missed
        ]
        sides.append(models)
    return (*names, tuple(sides))


def test_a_wrong_model_is_found_out_where_its_error_grows_by_what_matters():
    """By a half: to four times the power of the noise, so three of all ten samples' beside it."""
    variance = 0.1**2
    pairs = [
        # the best variant counts; a model is shown what the other one predicts
        pair("ab", ("A", "B"), ([{"B": 29.0 * variance}], [{"A": 31.0 * variance}])),
        pair(
            "cd", ("C", "D"), ([{"D": 99.0}, {"D": 31.0 * variance}], [{"C": variance}, {"C": 9.0}])
        ),
    ]
    search = searched(None, [record(4, 0)])
    contrasts = Contrasts(search, pairs)
    found, enough = contrasts.evaluate(SimpleNamespace(u=np.zeros(6)))
    np.testing.assert_allclose(found, [[31.0, 29.0], [1.0, 31.0]])
    np.testing.assert_array_equal(enough, [[True, False], [False, True]])
    number, nats = contrasts.score((found, enough))
    assert number == 2  # either of two may be right: half of ln(1 + it) / 2 for each
    assert nats == pytest.approx(np.mean(np.log1p(found) / 2.0, axis=1).sum())


def test_what_is_told_apart_is_said_with_the_least_that_tells_it():
    search = searched(None, [record(4, 0)])
    contrasts = Contrasts(search, [pair(names, "xy", ([], [])) for names in ("ab", "cd", "ef")])
    found = np.array([[400.0, 100.0], [1.0, 900.0], [4.0, 1.0]])
    enough = found > 50.0
    said = contrasts.describe((found, enough), 100)
    assert said.startswith(
        "it distinguishes a from b (1.0 times the noise) and c from d if it is d (3.0 "
    )
    assert "but it hardly distinguishes e from f (0.20 times the noise)" in said
    contrasts = Contrasts(search, [pair("cd", "xy", ([], []))])
    said = contrasts.describe((found[1:2, ::-1], enough[1:2, ::-1]), 100)
    assert said.startswith("it distinguishes c from d if it is c (3.0 times the noise).")


@pytest.mark.parametrize("verdict", ["noise", "unexplained"])
def test_a_record_narrows_intervals_as_a_regression_says(verdict):
    old, new = record(40, 0, intercept=0.001), record(25, 1, intercept=0.001)
    intervals = Intervals(searched(line(old), [old], verdict, noise=0.2))
    answer = intervals.evaluate(new)
    right = [0.2**2 * np.linalg.inv(b.T @ b) for b in (basis_of(old), basis_of(old, new))]
    np.testing.assert_allclose(answer, right, rtol=1e-6)
    before, after = (own if verdict != "noise" else own[:1, :1] for own in right)
    nats = 0.5 * np.log(np.linalg.det(before) / np.linalg.det(after))
    assert intervals.score(answer) == (pytest.approx(nats, rel=1e-6),)
    gain = np.polyfit(old.u, old.y, 1)[0]
    wide, narrow = (100.0 * np.sqrt(own[0, 0]) / gain for own in right)
    said = intervals.describe(answer, 25)
    assert f"gain (from ±{wide:.1f} to ±{narrow:.1f} %)" in said
    assert "intercept" not in said  # it may be zero: its interval over its value says nothing
    lead = "nothing is ambiguous" if verdict == "noise" else "no effect is near to a claim"
    assert said.startswith(lead)


def test_the_widest_intervals_come_first():
    for intercept, first in ((-0.5, "intercept"), (50.0, "gain")):
        old = record(40, 0, intercept=intercept)
        intervals = Intervals(searched(line(old), [old]))
        said = intervals.describe(intervals.evaluate(old), 40)
        assert f"the widest confidence intervals: {first} (from" in said


def test_a_logarithm_is_its_own_measure():
    """The interval of a time constant in per cent is that of its logarithm."""
    u = np.random.default_rng(0).normal(size=300)
    operator = FirstOrderLagOperator(0.05, gain=3.0)
    records = [RecordData(u, operator.run(u, DT)[0], DT)]
    tree = search_steps.tree_of(FirstOrderLag(fit_intercept=False), operator)
    intervals = Intervals(searched(tree, records))
    near = [FirstOrderLagOperator(0.05 * np.exp(h), gain=3.0).run(u, DT)[0] for h in (-1e-5, 1e-5)]
    design = np.c_[(near[1] - near[0]) / 2e-5, records[0].y / 3.0]
    right = 0.1**2 * np.linalg.inv(design.T @ design)
    errors = 100.0 * np.sqrt(np.diag(right)) / [1.0, 3.0]
    said = intervals.describe(intervals.evaluate(records[0]), 300)
    for name, error in zip(("time constant", "gain"), errors, strict=True):
        assert f"{name} (from ±{error:.2g} to ±{error / np.sqrt(2.0):.2g} %)" in said


@pytest.mark.parametrize(("noise", "expected"), [(1e-3, 1e-3), (0.0, 5e-7), (1e-7, 5e-7)])
def test_noise_is_no_less_than_a_ten_millionth_of_the_range(noise, expected):
    response = np.array([-2.0, 3.0, 1.0])
    search = SimpleNamespace(noise_model_=NoiseModel("white", noise), response_=response)
    assert _noise(search) == pytest.approx(expected)


def test_where_the_rest_is_noise_nothing_came_near_a_claim():
    assert list(_open_questions._near_claims(SimpleNamespace(verdict_="noise"))) == []
    search = SimpleNamespace(verdict_="unexplained", ranking_=SimpleNamespace(empty=True))
    assert list(_open_questions._near_claims(search)) == []
    for name, effects in (("no such effect", ()), ("lag", ("lag",))):
        tree = SimpleNamespace(effects=effects)
        assert _open_questions._with_effect(name, tree, None) == []


def test_a_parameter_at_its_bound_has_no_interval():
    """Weights of plays are not negative; those of a straight line but the first are zero."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=400)) / 5.0
    model, records = PrandtlIshlinskii(4), [RecordData(u, 2.0 * u - 0.01 * np.cos(u), 0.01)]
    tree = search_steps.fitted(model, records)
    problem = tree.problem(records)
    at_bound = (problem.x0 <= problem.lower) | (problem.x0 >= problem.upper)
    assert 0 < np.count_nonzero(at_bound) < len(at_bound)
    search = SimpleNamespace(
        _structure=tree,
        _records=records,
        noise_model_=NoiseModel("white", 0.01),
        response_=u,
        verdict_="noise",
    )
    np.testing.assert_array_equal(Intervals(search)._inner, np.flatnonzero(~at_bound))


def test_what_came_near_a_claim_is_of_the_last_round(monkeypatch):
    ranking = pd.DataFrame(
        [
            (1, "lag", 0.5, 1.0),
            (2, "creep", 0.5, 1.1),
            (2, "delay", 0.5, 0.9),
            (2, "drift", 0.0, 1),
        ],
        columns=["round", "effect", "screen", "error_after"],
    )
    search = SimpleNamespace(
        verdict_="unexplained",
        ranking_=ranking,
        min_improvement=0.05,
        _structure=SimpleNamespace(effects=("lag",)),
        _records=[],
    )
    monkeypatch.setattr(_open_questions, "_with_effect", lambda name, tree, search: [name])
    monkeypatch.setattr(_open_questions, "Fitted", lambda tree, records: "as it is")
    found = [(name, other) for name, other, _ in _open_questions._near_claims(search)]
    assert found == [("delay", "none"), ("creep", "none")]
    search._structure.effects = ()
    found = [name for name, *_ in _open_questions._near_claims(search)]
    assert found == ["delay", "creep"]
