"""What a failing candidate costs, and how a search goes on from its checkpoint."""

import os
import signal

import numpy as np
import pandas as pd
import pytest
from joblib import delayed, parallel_config
from sklearn.exceptions import FitFailedWarning
from sklearn.linear_model import Ridge

from skhyst.diagnosis import (
    EFFECTS,
    Effect,
    EffectSearchCV,
    _candidates,
    _checkpoint,
    _contest,
    register_effect,
    unregister_effect,
)
from skhyst.diagnosis._jobs import side_by_side
from skhyst.hysteresis import PrandtlIshlinskii, PrandtlIshlinskiiOperator
from skhyst.persistence import load_model, save_model

N, DT = 600, 2e-3


@pytest.fixture(scope="module")
def recording():
    """A lag and a cubic curve behind plays."""
    rng = np.random.default_rng(9801)
    t = DT * np.arange(N)
    u = (1.0 + 0.4 * np.sin(7.0 * t)) * np.sin(2.0 * np.pi * (2.0 + 6.0 * t) * t)
    v = PrandtlIshlinskiiOperator([0.0, 0.3, 0.6], [0.6, 0.3, 0.3]).run(u, DT)[0]
    lagged = np.zeros(N)
    for k in range(1, N):
        lagged[k] = lagged[k - 1] + DT / 0.02 * (v[k - 1] - lagged[k - 1])
    y = lagged + 0.2 * lagged**3 + 0.002 * rng.standard_normal(N)
    index = pd.Index(t, name="time")
    return pd.DataFrame({"drive": u}, index), pd.Series(y, index, name="response")


def search(**options):
    effects = ["lag", "offset", "static_nonlinearity"]
    options = {"effects": effects, "cv": 3, "random_state": 0} | options
    return EffectSearchCV(PrandtlIshlinskii(3), **options)


def assert_same(one, other):
    assert one.effects_ == other.effects_
    assert one.verdict_ == other.verdict_
    pd.testing.assert_frame_equal(one.ranking_, other.ranking_)
    same = [own.history_.drop(columns="evidence") for own in (one, other)]
    pd.testing.assert_frame_equal(*same)
    np.testing.assert_array_equal(one.prediction_after_, other.prediction_after_)
    assert one.best_estimator_.params_.keys() == other.best_estimator_.params_.keys()


@pytest.fixture(scope="module")
def whole(recording):
    found = search().fit(*recording)
    assert set(found.effects_) == {"lag", "static_nonlinearity"}
    return found


@pytest.fixture
def broken_effect():
    lag = EFFECTS["lag"]
    own = {name: getattr(lag, name) for name in lag.__dataclass_fields__}

    def variants():
        raise RuntimeError("the user's own")

    register_effect(Effect(**own | {"name": "my_effect", "variants": variants}))
    yield "my_effect"
    unregister_effect("my_effect")


@pytest.mark.slow
def test_an_effect_that_raises_costs_itself(recording, whole, broken_effect):
    with pytest.warns(FitFailedWarning, match="my_effect is left out: RuntimeError: the user's"):
        found = search(effects=["lag", broken_effect], max_effects=1).fit(*recording)
    assert found.effects_ == ["lag"]
    assert set(found.failed_["effect"]) == {"my_effect"}
    report = found.report()
    assert report.failed == found.failed_.to_dict("records")
    assert "my_effect failed with RuntimeError: the user" in report.to_markdown().replace("\\", "")
    assert whole.failed_.empty
    assert "Not all effects were tried" not in whole.report().to_markdown()


@pytest.mark.parametrize("stage", ["refitted", "held_out", "completed"])
def test_a_candidate_that_raises_in_any_stage_costs_itself(recording, whole, stage, monkeypatch):
    place = _candidates if stage == "refitted" else _contest
    genuine = getattr(place, stage)

    def failing(candidate, *others):
        if candidate.effects == ("lag",):
            raise FloatingPointError("nan")
        return genuine(candidate, *others)

    monkeypatch.setattr(place, stage, failing)
    with pytest.warns(FitFailedWarning, match="lag is left out: FloatingPointError: nan"):
        found = search(max_effects=1).fit(*recording)
    assert "lag" in whole.effects_
    assert "lag" not in found.effects_
    assert set(found.failed_["effect"]) == {"lag"}


def lethal(effect):
    os.kill(os.getpid(), signal.SIGKILL)


def harmless(effect):
    return effect


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL")
def test_a_worker_that_dies_costs_what_it_was_at():
    jobs = [delayed(lethal if k == 0 else harmless)(EFFECTS["lag"]) for k in range(2)]
    with pytest.warns(FitFailedWarning, match="lag is left out: its worker process has died"):
        done, failures = side_by_side(jobs, 2)
    assert [own is None for own in done] == [True, False]
    assert [name for name, _ in failures] == ["lag"]


class Stopped(BaseException):
    """As Ctrl-C comes: no exception that anyone catches."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "declared",
    [pytest.param(PrandtlIshlinskii(3), id="model"), pytest.param(Ridge(), id="black box")],
)
def test_a_search_goes_on_where_it_was_interrupted(
    recording, whole, declared, tmp_path, monkeypatch
):
    pytest.importorskip("skops.io")
    X, y = recording
    own = {"checkpoint": str(tmp_path / "search.skops")}
    uninterrupted = whole
    if isinstance(declared, Ridge):
        own["max_effects"] = 1
        uninterrupted = search(max_effects=1).set_params(estimator=declared).fit(X, y)
    assert uninterrupted.effects_
    save, done = _checkpoint.Checkpoint.save, []

    def interrupted(self, steps):
        save(self, steps)
        done.append(len(steps))
        if len(steps) in (1, 4):
            raise Stopped

    monkeypatch.setattr(_checkpoint.Checkpoint, "save", interrupted)
    for _ in range(100):
        try:
            found = search(**own).set_params(estimator=declared).fit(X, y)
            break
        except Stopped:
            assert [path.name for path in tmp_path.iterdir()] == ["search.skops"]
    assert done == list(range(1, len(done) + 1))
    assert_same(found, uninterrupted)
    tried = []
    monkeypatch.setattr(_checkpoint.Checkpoint, "save", lambda self, steps: tried.append(steps))
    with parallel_config("threading"):
        found = search(**own, n_jobs=2).set_params(estimator=declared).fit(X, y)
    assert not tried  # all steps are there
    assert_same(found, uninterrupted)


@pytest.mark.slow
def test_checkpoints_of_other_searches_are_refused(recording, tmp_path):
    skops = pytest.importorskip("skops.io")
    X, y = recording
    path = tmp_path / "search.skops"
    search(checkpoint=path, max_effects=1).fit(X, y)
    for changed, others in (((X, 2.0 * y), {}), ((X, y), {"alpha": 0.02})):
        with pytest.raises(ValueError, match="is the checkpoint of another search"):
            search(checkpoint=path, max_effects=1, **others).fit(*changed)
    skops.dump({"state": 1}, path)
    with pytest.raises(ValueError, match="is the checkpoint of another search"):
        search(checkpoint=path).fit(X, y)
    skops.dump({"run": os.system}, path)
    with pytest.raises(
        ValueError, match=r"is not a checkpoint of a search .*posix\.system|nt\.system"
    ):
        search(checkpoint=path).fit(X, y)
    path.write_bytes(b"PK and no more")
    with pytest.raises(ValueError, match="is not a checkpoint of a search"):
        search(checkpoint=path).fit(X, y)


@pytest.mark.slow
def test_a_checkpoint_that_cannot_be_written_ends_nothing(recording, whole, tmp_path):
    pytest.importorskip("skops.io")
    path = tmp_path / "missing" / "search.skops"
    with pytest.warns(RuntimeWarning, match="The checkpoint cannot be written"):
        found = search(checkpoint=path).fit(*recording)
    assert_same(found, whole)


def test_a_search_is_the_same_in_a_file_that_runs_nothing(recording, whole, tmp_path):
    pytest.importorskip("skops.io")
    save_model(whole, tmp_path / "search.skops")
    again = load_model(tmp_path / "search.skops")
    assert_same(again, whole)
    for name, value in vars(whole).items():
        if isinstance(value, pd.DataFrame):
            frames = [
                frame.drop(columns="evidence", errors="ignore")
                for frame in (getattr(again, name), value)
            ]
            pd.testing.assert_frame_equal(*frames)
    np.testing.assert_array_equal(again.predict(recording[0]), whole.predict(recording[0]))
    assert again.held_out_error(*recording) == whole.held_out_error(*recording)
    assert again.report().to_markdown() == whole.report().to_markdown()
