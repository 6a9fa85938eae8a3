"""Rate dependence by laws of other textbooks, in plants that share nothing with the models."""

import pytest
from blind_study import declared_model
from plants.laboratory import record_in

from skhyst.diagnosis import EffectSearchCV

NOISE = 0.002


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "law"), [(0, "proportional"), (1, "filtered_thresholds")])
def test_it_is_named_and_little_is_left(seed, law):
    recording = record_in("other_laws", "rate_dependence", "prandtl_ishlinskii", seed, noise=NOISE)
    assert recording.truth["parameters"][0]["law"] == law
    model = declared_model("prandtl_ishlinskii", NOISE)
    search = EffectSearchCV(model, effects=["rate_dependence", "creep", "lag"], random_state=0)
    search.fit(recording.X_train, recording.y_train)
    assert search.effects_ == ["rate_dependence"]
    held_out = recording.X_test, recording.y_test
    assert search.held_out_error(*held_out) < 1.1 * recording.noise_std
    assert search.held_out_error(*held_out, declared=True) > 1.5 * recording.noise_std
