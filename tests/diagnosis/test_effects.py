"""The catalogue of effects, and how users add to it."""

import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import plants
import pytest
from sklearn.base import clone

from skhyst.base import ParametricModel
from skhyst.diagnosis import EFFECTS, Effect, effect_names, register_effect, unregister_effect
from skhyst.disturbance import SinusoidOperator
from skhyst.linear import (
    DelayOperator,
    FirstOrderLag,
    FirstOrderLagOperator,
    SecondOrderModeOperator,
    TimeShiftOperator,
    TransferFunctionOperator,
)
from skhyst.operators import Series, split_disturbances
from skhyst.optimize import RecordData
from skhyst.static import SoftSaturationOperator

PROMISED = {*plants.EFFECTS, "end_stops", "initial_state", "rectification", "timing"}
PAGES = Path(__file__).parents[2] / "docs" / "user_guide" / "effects"


def my_effect(name="my_effect"):
    return Effect(name, lambda: [FirstOrderLag()], "A law.", "An experiment.")


@pytest.fixture
def registered():
    effect = my_effect()
    register_effect(effect)
    yield effect
    EFFECTS.pop(effect.name, None)


@pytest.fixture
def record():
    u = np.cumsum(np.random.default_rng(9000).standard_normal(300)) / 10.0
    return RecordData(u, np.sin(u), 0.01)


def test_all_promised_effects_are_there():
    assert set(effect_names()) >= PROMISED


@pytest.mark.parametrize("name", sorted(PROMISED))
def test_an_effect_says_what_it_is(name):
    effect = EFFECTS[name]
    assert effect.name == name
    for sentence in (effect.law, effect.experiment):
        assert re.fullmatch(r"[A-Z].*\.", sentence), sentence


def models_of(name):
    """Return the models among an effect's variants; others are changes of their own kind."""
    return [v for v in EFFECTS[name].variants() if isinstance(v, ParametricModel)]


@pytest.mark.parametrize("name", sorted(PROMISED))
def test_its_variants_are_unfitted_models_or_changes(name, record):
    effect = EFFECTS[name]
    variants = effect.variants()
    assert variants
    assert all(isinstance(v, ParametricModel) or callable(v.trees) for v in variants)
    for model in models_of(name):
        assert not hasattr(model, "operator_")
        clone(model)
        for operator, disturbances in map(split_disturbances, model.starting_values([record])):
            assert bool(disturbances) == effect.additive
            values = [operator, *disturbances][-1].pack()
            assert np.isfinite(values).all()
    again = effect.variants()
    assert all(a is not b for a, b in zip(variants, again, strict=True))  # no shared instances


def ranks(name, record):
    return {
        split_disturbances(model.starting_values([record])[0])[0].stage_order
        for model in models_of(name)
    }


@pytest.mark.parametrize("name", sorted(n for n in PROMISED if not EFFECTS[n].additive))
def test_all_variants_go_to_the_same_place(name, record):
    # but for play, which is in the drive's transmission or in the sensor's
    assert len(ranks(name, record)) <= 1 + (name == "backlash")


def test_places_follow_the_signal(record):
    order = {
        name: min(ranks(name, record))
        for name in PROMISED
        if not EFFECTS[name].additive and models_of(name)
    }
    for first in ("input_saturation", "dead_zone", "slew_limit", "backlash"):
        assert order[first] < order["lag"]
    assert order["lag"] == order["resonance"] == order["creep"]
    assert (
        order["creep"] < order["static_nonlinearity"] < order["output_saturation"] < order["timing"]
    )


def test_every_effect_has_its_page():
    pages = {page.stem for page in PAGES.glob("*.rst")} - {"index"}
    assert pages == PROMISED
    index = (PAGES / "index.rst").read_text(encoding="utf-8")
    for name in sorted(PROMISED):
        lines = (PAGES / f"{name}.rst").read_text(encoding="utf-8").splitlines()
        assert lines[0].lower().replace(" ", "_") == name
        assert f":doc:`{name}`" in index


def test_a_registered_effect_is_known_until_it_is_forgotten(registered):
    assert effect_names()[-1] == "my_effect"
    unregister_effect("my_effect")
    assert "my_effect" not in effect_names()


def test_a_name_is_taken_once(registered):
    with pytest.raises(ValueError, match="'my_effect' is registered already"):
        register_effect(my_effect())
    with pytest.raises(ValueError, match="'lag' is registered already"):
        register_effect(my_effect("lag"))
    assert EFFECTS["lag"].variants()[0].get_params() == FirstOrderLag().get_params()


def test_forgetting_the_unknown_lists_what_there_is():
    with pytest.raises(ValueError, match=r"No effect is named 'magic'.*creep"):
        unregister_effect("magic")


def test_the_list_of_names_is_a_copy():
    effect_names().clear()
    assert set(effect_names()) >= PROMISED


def test_an_effect_is_frozen():
    with pytest.raises(AttributeError):
        my_effect().name = "other"


def test_a_mode_has_a_peak_or_a_notch():
    u = np.random.default_rng(0).normal(size=500)  # which excites it throughout

    def of(damping, numerator):
        frequency = np.array([100.0])
        return TransferFunctionOperator(np.array([]), frequency, np.array([damping]), numerator)

    def rings(operator, dt=1e-3):
        record = RecordData(u, np.zeros(500), dt)
        return EFFECTS["resonance"].plausible(operator, np.ones(1), [record]) > 0.0

    assert rings(of(0.05, np.array([])))
    assert rings(of(0.05, np.array([0.0, 0.9])))
    assert not rings(of(0.9, np.array([])))
    assert not rings(of(0.9, np.array([0.3, 0.3])))
    assert rings(of(0.5, np.array([9.0, 0.0])))
    assert not rings(of(0.9, np.array([9.0, 0.0])))
    assert not rings(of(0.3, np.array([0.01, 1.0])))  # its zeros are about its poles
    assert rings(SecondOrderModeOperator(100.0, 0.5))
    assert not rings(SecondOrderModeOperator(100.0, 0.8))
    # half the sampling rate lies within its half-power band, or below
    assert rings(SecondOrderModeOperator(100.0, 0.1), dt=0.028)
    assert not rings(SecondOrderModeOperator(100.0, 0.1), dt=0.029)


def test_a_shift_below_an_interval_is_the_readings_and_a_longer_one_the_devices():
    records = [RecordData(np.zeros(2), np.zeros(2), dt) for dt in (0.1, 0.3)]

    def margin(name, operator):
        return EFFECTS[name].plausible(operator, np.ones(1), records)

    for late in (-0.7, -0.01, 0.09):
        assert margin("timing", TimeShiftOperator(late)) > 0.0
    assert margin("timing", TimeShiftOperator(0.11)) < 0.0 < margin("delay", DelayOperator(0.11))
    assert margin("delay", DelayOperator(0.09)) < 0.0


def test_creep_takes_longer_than_an_interval_whatever_its_drive():
    """Behind the integrator of a velocity, too."""
    none = np.empty(0)
    integrator = TransferFunctionOperator(none, none, none, none, integrators=1)
    records = [RecordData(np.zeros(50), np.zeros(50), 0.1)]
    for time_constant, sign in ((0.05, -1.0), (1.0, 1.0)):
        lag = FirstOrderLagOperator(time_constant)
        for operator in (lag, Series(("displacement", "lag"), (integrator, lag))):
            assert sign * EFFECTS["creep"].plausible(operator, np.ones(1), records) > 0.0


@pytest.mark.parametrize("knee", [1.0, 2.5, 40.0])
def test_what_saturates_goes_beyond_its_knee_point(knee):
    """There the slope is a fifth of the chord's."""
    saturates = EFFECTS["output_saturation"].plausible
    operator = SoftSaturationOperator(0.7, knee, center=0.1)
    drive = np.linspace(-3.0, 3.0, 6001)
    response = operator.run(drive, 0.1, operator.init(drive[0], "rest"))[0]
    flat = np.gradient(response, drive) * (drive - 0.1) / (response - 0.1 + 1e-300)
    for end in (0.2, 0.3, 0.45, 0.6, 0.9, 1.5, 2.9):
        seen = abs(drive) <= end
        if abs(flat[seen][0] - 0.2) > 0.02:  # the lower end is further from the centre
            assert (saturates(operator, response[seen], []) > 0.0) == (flat[seen][0] < 0.2)


@pytest.mark.parametrize(
    ("frequencies", "own"),
    [
        ([5.3], True),
        ([6.0], False),
        ([5.3, 5.35], False),
        ([5.3, 7.7], True),
        ([0.15, 5.3], False),
        ([0.25, 5.3], True),
    ],
)
def test_lines_repeat_are_apart_and_not_those_of_a_drive_that_repeats_itself_roughly(
    frequencies, own
):
    time = 0.001 * np.arange(10_000)
    wander = 0.02 * np.sin(0.37 * time)  # a motion in a loop is never quite periodic
    drive = np.sin(4.0 * np.pi * time) + 0.3 * np.sin(8.0 * np.pi * time) + wander
    operator = SinusoidOperator(np.zeros(2 * len(frequencies)), np.array(frequencies))
    for u in (drive, np.column_stack([drive, np.ones_like(drive)])):
        record = RecordData(u, drive, 0.001)
        margin = EFFECTS["periodic_disturbance"].plausible(operator, np.nan, [record])
        assert (margin > 0.0) == own


def test_a_hold_is_changed_where_the_operator_has_one():
    """A user's own linear operator need not."""

    @dataclass(frozen=True)
    class Own:
        n_poles = (1, 0)
        hold = "foh"

    held = EFFECTS["timing"].variants()[1]
    stage = SimpleNamespace(name="own", operator=Own(), model=FirstOrderLag())
    assert held.trees("timing", SimpleNamespace(tree=SimpleNamespace(stages=[stage]))) == []
