"""How a search decides: it grows, prunes by one test, names, and throws nothing better away."""

from dataclasses import replace
from itertools import pairwise
from math import comb
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import search_steps

from skhyst.diagnosis import EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain
from skhyst.optimize import RecordData
from skhyst.records import stack_records

COUNT, N, DT = 4, 400, 0.01


def lagged(u, time_constant):
    """Return the drive behind a first-order lag, exactly for straight lines between samples."""
    y, state, rho = np.empty(len(u)), u[0], np.exp(-DT / time_constant)
    slope = time_constant / DT * (1.0 - rho)
    for k, value in enumerate(u):
        before = u[max(k - 1, 0)]
        state = rho * state + (slope - rho) * before + (1.0 - slope) * value if k else value
        y[k] = state
    return y


def recording(y_of, count=COUNT, seed=9500, noise=5e-3):
    """Return records of random walks and of what a device makes of them."""
    rng = np.random.default_rng(seed)
    drives = [np.cumsum(rng.standard_normal(N)) / 10.0 for _ in range(count)]
    time = pd.Index(DT * np.arange(N), name="time")
    X = stack_records([pd.DataFrame({"drive": u}, time) for u in drives])
    y = np.concatenate([y_of(i, u) for i, u in enumerate(drives)])
    return X, y + noise * rng.standard_normal(len(y))


def with_offsets(i, u):
    return lagged(u, 0.05) + (0.8, -1.1, 0.4, -0.2)[i]


@pytest.fixture(scope="module")
def two_found():
    X, y = recording(with_offsets)
    effects = ["lag", "creep", "offset", "static_nonlinearity", "dead_zone"]
    return EffectSearchCV(Gain(), effects=effects, cv=2, random_state=0).fit(X, y)


def test_what_is_missing_is_named_and_nothing_else(two_found):
    assert set(two_found.effects_) == {"lag", "offset"}
    assert two_found.verdict_ == "noise"
    assert two_found.best_estimator_.params_["model__lag__time_constant"] == pytest.approx(
        0.05, rel=0.02
    )
    assert two_found.error_after_ == pytest.approx(5e-3, rel=0.05)


def test_history_is_a_chain_of_nested_models(two_found):
    history = two_found.history_
    assert (history["p_value"] < 0.01).all()
    errors = [history["error_before"].iloc[0], *history["error_after"]]
    assert all(after < 0.95 * before for before, after in pairwise(errors))
    assert history["error_before"].iloc[1] == history["error_after"].iloc[0]
    removed = history["error_before"] - history["error_after"]
    assert removed.is_monotonic_decreasing


def test_a_rival_that_has_become_what_was_named_is_none(two_found):
    """A creep without a prompt part is a lag, and leaves no doubt about it."""
    row = two_found.history_.set_index("effect").loc["lag"]
    assert "creep" not in row["ambiguous_with"]


def test_what_stood_in_for_another_effect_is_taken_out_again(two_found):
    """Functions of time alone come last, so that others stand in for the offset."""
    assert two_found.dropped_
    assert not set(two_found.dropped_) & set(two_found.effects_)


def test_the_error_is_of_whole_records_where_there_are_several(two_found):
    folds = two_found.folds_.reshape(COUNT, N)
    assert (folds == folds[:, :1]).all()
    X, y = recording(with_offsets, seed=9501)
    assert two_found.held_out_error(X, y) == pytest.approx(two_found.error_after_, rel=0.1)


def test_a_record_that_is_stored_twice_is_a_fault_and_proves_nothing():
    X, y = recording(with_offsets)
    twice = stack_records([X.loc[label] for label in (0, 1, 2, 3, 0)])
    y = np.concatenate([y, y[:N]])
    search = EffectSearchCV(Gain(), effects=["lag", "offset"], random_state=0).fit(twice, y)
    assert search.data_quality_["fault"].tolist() == ["repeated_record"]
    assert search.data_quality_["record"].tolist() == [4]
    first, last = search.folds_[:N], search.folds_[-N:]
    np.testing.assert_array_equal(first, last)


def test_a_drift_is_not_named_for_what_responds_to_the_drive():
    """A ramp beside a gain: a slow mode does as much, and has more parameters."""
    rng = np.random.default_rng(9502)
    t = DT * np.arange(1500)
    u = np.sin(2.0 * np.pi * 1.3 * t)
    y = u + 0.5 * t / t[-1] + 0.01 * rng.standard_normal(len(t))
    effects = ["drift", "resonance", "lag", "offset"]
    X = pd.DataFrame({"drive": u}, pd.Index(t, name="time"))
    search = EffectSearchCV(Gain(), effects=effects, random_state=0).fit(X, y)
    assert search.effects_ == ["drift"]


def test_a_drift_is_as_significant_as_the_course_of_the_noise_says():
    """It moves once in a record, which is one block in a test of blocks."""
    t = 0.01 * np.arange(800)
    u, y = np.sin(1.4 * np.pi * t) + 0.5 * np.sin(4.2 * np.pi * t), np.zeros(800)
    for k in range(1, len(t)):  # a held drive: the residual of the declared lag is no noise
        y[k] = y[k - 1] + (1.0 - np.exp(-0.2)) * (u[k] - y[k - 1])
    y += 0.3 * u**2 + 0.05 * t**1.5 + 0.01 * np.random.default_rng(0).standard_normal(800)
    search = EffectSearchCV(FirstOrderLag(dt=0.01), effects=["drift", "static_nonlinearity"])
    search.fit(u[:, None], y)
    assert search.effects_ == ["drift", "static_nonlinearity"]
    assert search.error_after_ < 0.2 * search.error_before_
    assert search.history_["p_value"].max() < search.alpha


def test_what_helps_but_is_not_significant_is_a_suspect():
    """The level asked for is beyond what sixty samples can show."""
    rng = np.random.default_rng(9503)
    u = np.cumsum(rng.standard_normal(60))
    y = lagged(u, 0.05) + 0.5 * rng.standard_normal(60)
    effects, X = ["lag", "static_nonlinearity"], pd.DataFrame(u, DT * pd.RangeIndex(60))
    search = EffectSearchCV(Gain(), effects=effects, alpha=1e-30, random_state=0)
    search.fit(X.rename_axis("time"), y)
    assert search.effects_ == []
    suspect = search.suspects_.iloc[0]
    assert suspect["effect"] == "lag"
    assert suspect["error_before"] == search.error_before_ == search.error_after_
    assert suspect["error_after"] < 0.6 * suspect["error_before"]
    assert suspect["folds_better"] >= 5
    assert suspect["p_value"] >= 1e-30


# ---------------------------------------------------------------------------------- single steps


@pytest.fixture(scope="module")
def missing_two():
    """Records of plays behind which are a lag and an offset, and the declared plays."""
    rng = np.random.default_rng(9400)
    lag = FirstOrderLagOperator(0.05)
    segments = tuple(pairwise(np.linspace(0, N, 7).astype(int).tolist()))
    drives = [np.cumsum(rng.standard_normal(N)) / 5.0 for _ in range(COUNT)]
    model = PrandtlIshlinskii(4)
    records = [RecordData(u, u + 0.3 * np.sin(u), DT, segments=segments) for u in drives]
    tree = search_steps.fitted(model, records)
    found = []
    for record, v, offset in zip(records, tree.run(records), (0.8, -1.1, 0.4, -0.2), strict=True):
        y = lag.run(v, DT)[0] + offset
        found.append(replace(record, y=y + 0.005 * rng.standard_normal(N)))
    tree = search_steps.fitted(model, found)
    record_of = np.concatenate([np.full(len(r.segments), i) for i, r in enumerate(found)])
    folds = [(record_of != k, record_of == k) for k in range(COUNT)]
    problem = tree.problem(found)
    cost = problem.total(problem.evaluate(problem.x0))[-1, -1]
    return found, folds, search_steps.candidate(tree, found, folds, cost=cost)


def contest_of(records, folds, *names, structured=True, **options):
    judge = {"judge": lambda _: SimpleNamespace(structured=structured)}
    return search_steps.contest(records, folds, *names, **judge | options)


class NotAlone(type(search_steps.USUAL)):
    """One for which each effect hides the other."""

    def improves_enough(self, worse, better):
        alone = len(better.structure.effects) == 1
        return not alone and super().improves_enough(worse, better)


def test_two_effects_are_found_together_where_neither_helps(missing_two):
    records, folds, base = missing_two
    names = "lag", "offset", "static_nonlinearity"
    found = {}
    for structured in (True, False):
        criterion = NotAlone(0.01, 0.05)
        contest = contest_of(records, folds, *names, structured=structured, criterion=criterion)
        ends = contest.grow(base)
        found[structured] = set(min(ends, key=lambda c: c.error).structure.effects)
        alone = [row for row in contest.ranking if not row["with_effects"]]
        assert len(alone) == len(names)
        assert all(0.0 <= row["screen"] < 1.0 for row in alone)  # parts of the cost
    assert found[True] >= {"lag", "offset"}
    assert not found[False]  # where only noise is left, no pair is tried


def test_the_family_is_all_that_was_screened_and_the_pairs_that_were_possible(missing_two):
    records, folds, base = missing_two
    names = "lag", "delay", "dead_zone", "offset"
    contest = contest_of(
        records, folds, *names, criterion=replace(search_steps.USUAL, min_improvement=1.0 - 1e-9)
    )
    assert contest.grow(base) == [base]
    screening = [search_steps.variants(name, base.structure, records) for name in names[:-1]]
    variants = sum(map(len, screening))  # the offset is not screened: it comes last
    assert contest.n_tried == variants + comb(len(names), 2)


def test_a_finished_step_is_not_done_again(missing_two, monkeypatch):
    records, folds, base = missing_two
    kept = []
    contest = contest_of(records, folds, "lag", "offset", keep=lambda steps: kept.append(steps))
    ends = contest.grow(base)
    again = contest_of(records, folds, "lag", "offset", steps=dict(kept[-1]))
    monkeypatch.setattr(type(again), "_screened", None)
    assert [c.structure.effects for c in again.grow(base)] == [c.structure.effects for c in ends]
