"""Long records are searched in their first parts, and decided on the whole."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import search_steps
from plants import make_recording

from skhyst.diagnosis import EFFECTS, EffectSearchCV, _shortened
from skhyst.diagnosis._edits import Modulate
from skhyst.diagnosis._shortened import shortened, suffices
from skhyst.disturbance import PeriodicDisturbance
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import SecondOrderMode
from skhyst.optimize import RecordData


@pytest.fixture
def short_is_long(monkeypatch):
    monkeypatch.setattr(_shortened, "ENOUGH", 1000)


def some_records(count=3, n=900, segments=6):
    rng = np.random.default_rng(4100)
    time, found = 0.01 * np.arange(n), []
    for _ in range(count):
        u = np.sin(4.0 * time + rng.uniform(0, 6)) + 0.5 * np.sin(9.0 * time + rng.uniform(0, 6))
        y = u + 0.2 * np.tanh(3.0 * u) + 0.05 * rng.standard_normal(n)
        edges = np.linspace(0, n, segments + 1).astype(int).tolist()
        found.append(RecordData(u, y, 0.01, segments=tuple(pairwise(edges))))
    return found


def test_a_first_part_is_the_record_up_to_where_it_shows_as_much(short_is_long):
    records = some_records()
    level = [np.ones(900), np.r_[np.zeros(450), np.ones(450)], np.r_[np.ones(450), np.zeros(450)]]
    parts = shortened(records, level)
    assert [len(part.u) for part in parts] == [333, 900, 333]
    for part, record in zip(parts, records, strict=True):
        np.testing.assert_array_equal(part.y, record.y[: len(part.y)])
        assert len(part.segments) == len(record.segments)
        assert (part.segments[0][0], part.segments[-1][1]) == (0, len(part.u))
    assert shortened(records[:1], level[:1]) is None  # 900 samples in all


def test_a_part_shows_dependence_on_the_amplitude_where_it_has_this_amplitude(short_is_long):
    records = some_records()
    structure = search_steps.fitted(PrandtlIshlinskii(3), records)
    scaled = structure.edited("amplitude_dependence", Modulate("amplitude", 1.0))
    parts = shortened(records, [np.ones(900)] * 3)
    rising = [replace(r, u=r.u * np.linspace(0.1, 1.0, 900)) for r in records]
    small = shortened(rising, [np.ones(900)] * 3)
    creep, dependence = EFFECTS["creep"], EFFECTS["amplitude_dependence"]
    assert suffices(creep, structure, rising, small)
    assert not suffices(dependence, structure, rising, small)
    assert not suffices(creep, scaled, rising, small)
    assert suffices(dependence, structure, records, records)
    assert not suffices(EFFECTS["drift"], structure, records, parts)


@pytest.mark.parametrize("additive", [(), (PeriodicDisturbance(1),)])
def test_folds_of_long_records_are_those_of_short_ones(additive, monkeypatch):
    """One Gauss-Newton step of each fold finds what the search for its minimum finds."""
    records = some_records()
    mode = SecondOrderMode()
    structure = search_steps.fitted(mode, records)
    for model in additive:
        structure = search_steps.with_disturbance(
            structure, "line", model, model.starting_values(records)[0]
        )
    problem = structure.problem(records)
    contestant = search_steps.candidate(structure, records)
    fold = problem.segment_record
    folds = [(fold != k, fold == k) for k in range(len(records))]
    thorough = search_steps.refit(contestant, records, folds)
    monkeypatch.setattr(_shortened, "ENOUGH", 1000)
    quick = search_steps.refit(contestant, records, folds)
    assert quick.error != thorough.error  # the records are long now
    assert quick.error == pytest.approx(thorough.error, rel=2e-3)
    for own, slow in zip(quick.residuals, thorough.residuals, strict=True):
        parts = zip(np.array_split(own, 6), np.array_split(slow, 6), strict=True)
        for a, b in parts:
            assert a @ a == pytest.approx(b @ b, rel=0.05)


@pytest.mark.slow
def test_a_long_search_names_what_a_short_one_names(short_is_long):
    recording = make_recording("creep", "prandtl_ishlinskii", 9000, n_samples=5000)
    tried = ["creep", "drift", "lag", "amplitude_dependence"]
    search = EffectSearchCV(PrandtlIshlinskii(), effects=tried, cv=2, random_state=0)
    search.fit(recording.X_train, recording.y_train)
    assert search.effects_ == ["creep"]
    assert search.held_out_error(recording.X_test, recording.y_test) < 1.1 * recording.noise_std
