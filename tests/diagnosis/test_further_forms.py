"""Forms of effects that laboratories have, in plants that share nothing with the models."""

import pickle

import numpy as np
import pytest
from blind_study import declared_model
from plants.laboratory import record_in
from sklearn.base import clone

from skhyst.diagnosis import EFFECTS, EffectSearchCV
from skhyst.hysteresis import EndStopsOperator
from skhyst.linear import Gain

pytestmark = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
NOISE = 0.002
# of each the rivals that come nearest
FEW = {
    "auxiliary_input": ["dead_zone", "drift", "lag"],
    "end_stops": ["cubic_stiffness"],
    "rectification": ["static_nonlinearity"],
    "backlash": ["dead_zone", "lag", "asymmetry"],
}


def searched(habit, effect, declared, seed, names):
    recording = record_in(habit, effect, declared, seed, noise=NOISE)
    model = declared_model(declared, NOISE)
    search = EffectSearchCV(model, effects=names, cv=2, random_state=0)
    return recording, search.fit(recording.X_train, recording.y_train)


@pytest.mark.parametrize(
    ("effect", "declared", "seed"),
    [
        pytest.param("auxiliary_input", "second_order", 1, marks=pytest.mark.slow),
        pytest.param("end_stops", "second_order", 5, marks=pytest.mark.slow),
        pytest.param("rectification", "second_order", 0, marks=pytest.mark.slow),
        ("backlash", "bouc_wen", 1),
    ],
)
def test_it_is_named_and_little_is_left(effect, declared, seed):
    names = [effect, *FEW[effect]]
    recording, search = searched("further_forms", effect, declared, seed, names)
    assert search.effects_ == [effect]
    held_out = recording.X_test, recording.y_test
    assert search.held_out_error(*held_out) < 1.1 * recording.noise_std
    assert search.held_out_error(*held_out, declared=True) > 1.5 * recording.noise_std
    assert search.evidence_[effect].numbers
    best = search.best_estimator_
    again = clone(best).fit(recording.X_train, recording.y_train)
    assert again.fit_error_ == pytest.approx(best.fit_error_, rel=0.01)
    found = pickle.loads(pickle.dumps(best)).predict(recording.X_test)
    np.testing.assert_array_equal(found, best.predict(recording.X_test))


@pytest.mark.parametrize(
    ("habit", "effect", "seed", "right"),
    [
        ("bench", "none", 0, []),
        pytest.param(  # a second spring, softer
            *("other_laws", "cubic_stiffness", 1, ["cubic_stiffness"]), marks=pytest.mark.slow
        ),
    ],
)
def test_no_name_is_taken_from_others(habit, effect, seed, right):
    names = [*right, "end_stops", "rectification"]
    _, search = searched(habit, effect, "second_order", seed, names)
    assert search.effects_[:1] == right


def stop(u, reach):
    """Return a spring that slips when it is deflected by ``reach``."""
    found = np.zeros(len(u))
    for k in range(1, len(u)):
        found[k] = np.clip(found[k - 1] + u[k] - u[k - 1], -reach, reach)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reach", "curve", "right"),
    [
        (0.1, 0.0, ["friction"]),
        (1.5, 0.0, ["hysteresis"]),
        (1.5, 0.02, ["hysteresis", "static_nonlinearity"]),
    ],
)
def test_a_force_of_a_displacement_slips_beside_a_spring(reach, curve, right):
    """A spring that slips within a twentieth of the motion is friction."""
    t = np.arange(450)
    u = np.sin(t / 9.0) * np.linspace(1.0, 5.0, len(t))
    y = 0.5 * u + 2.0 * stop(u, reach) / reach + curve * u**3 + 7.0
    y += 0.02 * np.random.default_rng(5).standard_normal(len(t))
    names = ["hysteresis", "friction", "backlash", "static_nonlinearity"]
    search = EffectSearchCV(Gain(), effects=names, random_state=0).fit(u[:, None], y)
    assert sorted(search.effects_) == right
    assert search.error_after_ < 0.026


@pytest.mark.slow
def test_a_bias_counts_in_units_of_the_drive_and_acts_before_the_model():
    recording, search = searched(
        "further_forms", "auxiliary_input", "second_order", 1, ["auxiliary_input"]
    )
    (truth,) = recording.truth["parameters"]
    numbers = search.evidence_["auxiliary_input"].numbers
    value, std, unit = numbers["gain"]
    assert value == pytest.approx(truth["gain"], rel=0.03, abs=3.0 * std)
    assert unit.startswith("drive/")
    assert numbers["time constant"][0] == pytest.approx(truth["tau"], rel=0.05)
    assert search.best_estimator_.steps[0][0] == "auxiliary_input"


@pytest.mark.parametrize(
    ("changes", "is_one"),
    [
        ({}, True),
        ({"stop_stiffness": 0.7}, False),  # softer than the spring
        ({"upper": 1.2}, False),  # never reached
        ({"lower": -0.95, "upper": -0.9}, False),  # never left
    ],
)
def test_a_stop_is_stiff_and_is_reached_and_left(changes, is_one):
    stage = EndStopsOperator(30.0, 0.3, **{"stop_stiffness": 20.0, "upper": 0.6} | changes)
    motion = 2.0 * np.linspace(-0.8, 0.63, 100) + 0.3
    found = EndStopsOperator(**{**vars(stage), "gain": 2.0, "intercept": 0.3})
    assert (EFFECTS["end_stops"].plausible(found, motion, []) > 0.0) == is_one
