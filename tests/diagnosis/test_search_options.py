"""What the search makes of its options and of single records, and what it refuses."""

import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from plants import make_recording
from sklearn.preprocessing import StandardScaler

from skhyst.diagnosis import EFFECTS, EffectSearchCV
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import Gain
from skhyst.model_selection import RecordKFold
from skhyst.records import stack_records

SEED = 9000
FEW = ["lag", "delay", "offset", "output_saturation"]


def small(effect, n_samples=1250):
    return make_recording(effect, "prandtl_ishlinskii", SEED, n_samples=n_samples)


def few(**options):
    options = {"effects": FEW, "cv": 2, "random_state": 0} | options
    return EffectSearchCV(options.pop("estimator", PrandtlIshlinskii()), **options)


# ------------------------------------------------------------------------------------- one record


def one_record(effect="lag", n_samples=6000):
    """Return the first record alone: arrays of the drive and the response, and the interval."""
    recording = make_recording(effect, "prandtl_ishlinskii", SEED, n_samples=n_samples)
    X, y = recording.X_train.loc[0], recording.y_train.loc[0]
    return X.to_numpy(), y.to_numpy(), recording


@pytest.mark.parametrize("washout", [0, 23])
def test_what_is_washed_out_counts_nowhere(washout):
    X, y, recording = one_record()
    model = PrandtlIshlinskii(dt=recording.sampling_interval)
    search = EffectSearchCV(model, effects=FEW, cv=4, washout=washout, random_state=0).fit(X, y)
    assert search.effects_ == ["lag"]
    washed = np.arange(len(y)) < washout
    for stage in ("before", "after"):
        residual = getattr(search, f"residual_{stage}_")
        prediction = getattr(search, f"prediction_{stage}_")
        np.testing.assert_array_equal(np.isnan(residual), washed)
        np.testing.assert_array_equal(residual, y - prediction)
        scored = np.flatnonzero(~washed)
        error = np.sqrt(np.average(residual[scored] ** 2, weights=search.weights_[scored]))
        assert getattr(search, f"error_{stage}_") == pytest.approx(error, rel=1e-9)
    assert search.error_after_ < 1.3 * recording.noise_std  # blocks of 300 samples


@pytest.mark.slow
def test_arrays_with_an_interval_are_frames_with_a_time_index():
    X, y, recording = one_record()
    dt = recording.sampling_interval
    array = few(estimator=PrandtlIshlinskii(dt=dt), effects=["lag"]).fit(X, y)
    index = pd.Index(dt * np.arange(len(y)), name="time")
    frame = few(effects=["lag"]).fit(pd.DataFrame(X, index=index), pd.Series(y, index))
    assert array.effects_ == frame.effects_ == ["lag"]
    assert array.records_[0].dt == pytest.approx(frame.records_[0].dt)
    assert array.error_after_ == pytest.approx(frame.error_after_, rel=1e-6)
    tau = recording.truth["parameters"]["tau"]
    value, std, unit = array.evidence_["lag"].numbers["time constant"]
    assert abs(value - tau) < max(5.0 * std, 0.01 * tau)
    assert unit == "s"


def test_repeated_periods_give_the_noise_floor():
    rng = np.random.default_rng(SEED)
    t = np.arange(4000)
    drive = np.sin(2.0 * np.pi * t / 400) + 0.4 * np.sin(2.0 * np.pi * 3 * t / 400 + 1.0)
    y = np.clip(drive, -1.0, 0.9) + 0.01 * rng.standard_normal(4000)
    search = few(effects=["output_saturation"]).fit(drive.reshape(-1, 1), y)
    assert search.effects_ == ["output_saturation"]
    assert search.noise_floor_ == pytest.approx(0.01, rel=0.05)


@pytest.mark.slow
def test_repeated_records_give_the_noise_floor():
    recording, rng = small("lag", 2500), np.random.default_rng(SEED)
    X, y = recording.X_train, recording.y_train_clean
    pairs = [(X.loc[k].to_numpy(), y.loc[k].to_numpy()) for k in (0, 1, 2, 0, 1, 2)]
    X, y = stack_records(pairs, dt=recording.sampling_interval)
    y += recording.noise_std * rng.standard_normal(len(y))
    search = few(effects=["lag"]).fit(X, y)
    assert search.noise_floor_ == pytest.approx(recording.noise_std, rel=0.06)


@pytest.mark.slow
def test_data_without_noise_end_the_search():
    recording = make_recording("lag", "prandtl_ishlinskii", SEED, n_samples=1250, noise=0.0)
    search = few().fit(recording.X_train, recording.y_train)
    assert search.effects_[0] == "lag"
    assert search.error_after_ < 0.05 * search.error_before_


@pytest.mark.slow
def test_blocks_of_records_that_predict_nothing_of_each_other():
    rng = np.random.default_rng(SEED)
    drives = [level * np.sin(np.linspace(0.0, 40.0, 600)) for level in (1.0, 3.0)]
    X, y = stack_records([(u, u + 0.05 * u**2) for u in drives], dt=0.01)
    y += 0.005 * rng.standard_normal(len(y))
    effects = ["static_nonlinearity", "lag", "drift"]
    search = few(estimator=PrandtlIshlinskii(3), effects=effects).fit(X, y)
    assert search.effects_ == ["static_nonlinearity"]
    assert search.error_after_ < 0.006
    assert search.extrapolated_ < 0.05
    whole = few(estimator=PrandtlIshlinskii(3), cv=RecordKFold(2), effects=["lag"]).fit(X, y)
    assert whole.extrapolated_ > 0.2
    assert np.isfinite(search.residual_after_).all()  # each sample is scored once


# -------------------------------------------------------------------------- parameters and refusals


@pytest.mark.slow
def test_budget_of_effects():
    recording = small("output_saturation", 2500)
    none = few(max_effects=0, cv=5).fit(recording.X_train, recording.y_train)
    assert none.effects_ == []
    assert len(none.ranking_) == 0
    assert none.error_after_ == none.error_before_
    one = few(max_effects=1, cv=5).fit(recording.X_train, recording.y_train)
    assert one.effects_ == ["output_saturation"]
    assert one.ranking_["round"].max() <= 2  # of the declared model, and as fine as it then asks
    assert set(one.ranking_["effect"]) == set(FEW)


@pytest.mark.slow
def test_an_improvement_of_no_practical_size_is_not_claimed():
    X, y = small("lag").X_train, small("lag").y_train
    fitted = few(effects="lag").fit(X, y)
    assert fitted.effects_ == ["lag"]
    gain = 1.0 - fitted.error_after_ / fitted.error_before_
    modest = few(effects=["lag"], min_improvement=min(1.05 * gain, 0.999))
    assert modest.fit(X, y).effects_ == []


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("effects", ["asymetry", "lag"], r".*such as asymmetry,.*'asymetry' instead"),
        ("effects", "magic", r".*'magic' instead"),
        ("estimator", StandardScaler(), " of EffectSearchCV"),
        ("estimator", 3, " of EffectSearchCV"),
        ("cv", 1, " of EffectSearchCV"),
        ("cv", "rows", " must be an int, a splitter or an iterable"),
        ("alpha", 0.0, " of EffectSearchCV"),
        ("max_effects", -1, " of EffectSearchCV"),
        ("min_improvement", 1.0, " of EffectSearchCV"),
        ("washout", -1, " of EffectSearchCV"),
    ],
)
def test_wrong_parameters_are_refused_by_name(name, value, message):
    x = np.linspace(0.0, 1.0, 100)
    with pytest.raises(ValueError, match=f"'{name}' parameter{message}"):
        EffectSearchCV(**{"estimator": PrandtlIshlinskii(2)} | {name: value}).fit(x[:, None], x)


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("which", [0, 1])
def test_readings_that_are_no_numbers_are_refused(value, which):
    data = np.sin(np.arange(200.0))[:, None], np.sin(np.arange(200.0))
    data[which][17] = value
    with pytest.raises(ValueError, match=r"NaN|infinity"):
        few().fit(*data)


def test_too_few_samples_are_refused_with_the_number_that_is_enough():
    X, y = np.arange(6.0).reshape(-1, 1), np.arange(6.0)
    message = r"at least 12 samples behind the washout for 5 folds. Got 6"
    with pytest.raises(ValueError, match=message):
        EffectSearchCV(PrandtlIshlinskii(2), effects=["lag"]).fit(X, y)


def test_a_constant_drive_claims_nothing():
    rng = np.random.default_rng(SEED)
    y = 2.0 + 0.1 * rng.standard_normal(400)
    search = EffectSearchCV(PrandtlIshlinskii(2), effects=["lag", "offset"], random_state=0)
    search.fit(np.ones((400, 1)), y)
    assert search.effects_ == []
    assert search.error_before_ == pytest.approx(0.1, rel=0.15)
    said, *_ = search.warnings_
    assert said.startswith("The drive does not move: it is 1 in every sample.")


def test_an_unfitted_search_says_so():
    for call in (lambda: few().predict(np.zeros((3, 1))), few().report):
        with pytest.raises(ValueError, match="not fitted"):
            call()


@pytest.mark.slow
def test_progress_goes_to_the_standard_error_stream(capsys):
    recording = small("lag")
    few(estimator=Gain(), verbose=1, effects=["lag"]).fit(recording.X_train, recording.y_train)
    written = capsys.readouterr()
    assert written.out == ""
    assert "round 1: lag: held-out error" in written.err
    few(estimator=Gain(), effects=["lag"]).fit(recording.X_train, recording.y_train)
    assert capsys.readouterr().err == ""
    few(estimator=Gain(), verbose=1, effects=["offset"]).fit(recording.X_train, recording.y_train)
    written = capsys.readouterr().err
    assert "declared model: held-out error" in written
    assert "offset: held-out error" not in written  # no effect was put in


@pytest.mark.slow
def test_folds_of_records_are_taken_as_a_splitter_gives_them():
    recording = small("lag")
    X, y = recording.X_train, recording.y_train
    search = few(estimator=Gain(), cv=RecordKFold(3), effects=["lag"]).fit(X, y)
    cv = list(RecordKFold(3).split(X))
    given = few(estimator=Gain(), cv=cv, effects=["lag"]).fit(X, y)
    assert search.effects_ == given.effects_ == ["lag"]
    assert search.error_after_ == given.error_after_


def test_built_in_effects_go_to_other_processes_by_name():
    own = replace(EFFECTS["lag"], name="lag of my own")  # its variants have no name to go by
    for effect in EFFECTS.values():
        assert pickle.loads(pickle.dumps(effect)) is effect
    with pytest.raises((AttributeError, pickle.PicklingError)):
        pickle.dumps(own)
