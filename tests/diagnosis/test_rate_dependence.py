"""Rate dependence by laws of other textbooks, in plants that share nothing with the models."""

import pytest
from blind_study import declared_model
from plants.laboratory import record_in

from skhyst.diagnosis import EffectSearchCV

NOISE = 0.002


@pytest.mark.slow
def test_it_is_named_and_little_is_left():
    recording = record_in("other_laws", "rate_dependence", "prandtl_ishlinskii", 1, noise=NOISE)
    assert recording.truth["parameters"][0]["law"] == "filtered_thresholds"
    model = declared_model("prandtl_ishlinskii", NOISE)
    effects = ["rate_dependence", "creep", "lag"]
    search = EffectSearchCV(model, effects=effects, cv=2, random_state=0)
    search.fit(recording.X_train, recording.y_train)
    assert search.effects_ == ["rate_dependence"]
    held_out = recording.X_test, recording.y_test
    assert search.held_out_error(*held_out) < 1.1 * recording.noise_std
    assert search.held_out_error(*held_out, declared=True) > 1.5 * recording.noise_std
