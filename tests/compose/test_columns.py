"""Columns of X that drive models of their own, or scale those of the drive."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from skhyst.compose import (
    Cascade,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Sum,
)
from skhyst.disturbance import Offset
from skhyst.exceptions import ExtrapolationWarning
from skhyst.hysteresis import (
    BoucWenStageOperator,
    CoulombFrictionOperator,
    FreeMass,
    FreeMassOperator,
    FrictionStageOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    RestoringForceOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import (
    OnColumnOperator,
    Scaled,
    Scheduled,
    Stepper,
    SumOperator,
    check_operator,
)
from skhyst.persistence import from_json, to_json

DT, N = 0.01, 400


LAG = FirstOrderLagOperator(0.05, gain=1.2)
PLAYS = PrandtlIshlinskiiOperator([0.0, 0.3], [0.6, 0.4])
STAGE = FrictionStageOperator(60.0, 0.3, 0.3, 0.65, 4.0, 10.0, 0.2, 0.8, 0.1, n_substeps=3)
HYSTERETIC = BoucWenStageOperator(40.0, 0.3, 3.0, 0.3, 0.2, 1.7, 1.2, 0.1, n_substeps=2)
SLIPPING = RestoringForceOperator(
    40.0, 0.3, [0.4], [0.2], 3.0, 0.3, 0.1, 1.2, 0.1, scale=0.9, n_substeps=2
)
MASS = FreeMassOperator(0.02, 0.1, 0.3, 0.5, 0.2, 0.1, force_offset=0.1, intercept=0.2)
FRICTION = CoulombFrictionOperator(1.3, 0.8, 2.9, 0.3, 0.1, 0.3, 0.02, 0.1)


def plays(part):
    return PLAYS.run(part["drive"].to_numpy(), DT)[0]


@pytest.fixture
def X():
    rng = np.random.default_rng(1)
    t = DT * np.arange(N)
    parts = []
    for k in range(3):
        drive = (0.5 + 0.25 * k) * np.sin(2 * np.pi * (1 + k) * t) * np.linspace(0, 1, N)
        load = np.interp(t, np.linspace(0, t[-1], 9), rng.normal(size=9))
        index = pd.MultiIndex.from_product([[k], t], names=["record", "time"])
        parts.append(pd.DataFrame({"drive": drive, "load": load}, index=index))
    return pd.concat(parts)


def by_record(X, law):
    return np.concatenate([law(part) for _, part in X.groupby(level="record")])


def thresholds():
    return PrandtlIshlinskii(thresholds=[0.0, 0.3])


def test_tangents_are_those_of_the_drive():
    """What moves the drive does not move a further column."""
    u, along = np.random.default_rng(0).normal(size=(2, N, 2))
    along[:, 1] = 0.0
    both = SumOperator(
        ("drive", "load"), (OnColumnOperator(LAG, 0), OnColumnOperator(GainOperator(3.0), 1))
    )
    ends = [both.run(u + way * along, DT)[0] for way in (0.5, -0.5)]  # it is linear
    _, dy = both.sensitivities(u, along[:, :1], DT)
    np.testing.assert_allclose(dy[:, 0], ends[0] - ends[1], atol=1e-12)


@pytest.mark.parametrize(
    "around", [lambda: Modulated(Gain(), 1), lambda: Modulated(thresholds(), 1)]
)
def test_a_column_beyond_those_of_the_fit_is_told(around, recwarn):
    rng = np.random.default_rng(0)
    X = np.column_stack(
        [rng.normal(size=200).cumsum(), rng.uniform(1.0, 5.0, 200), rng.normal(size=200)]
    )
    model = around().fit(X, X[:, 0] * (1.0 + 0.1 * X[:, 1]))
    model.predict(X * [1.0, 1.0, 100.0])  # the last column is not read
    assert not recwarn
    low, high = X[:, 1].min(), X[:, 1].max()
    with pytest.warns(ExtrapolationWarning, match=f"column 1 from {low:g} to {high:g}. Got"):
        model.predict(X * [1.0, 10.0, 1.0])


def test_a_column_acts_through_a_lag_of_its_own(X):
    lag = FirstOrderLagOperator(0.1, 0.8)
    y = by_record(X, lambda part: plays(part) + lag.run(part["load"].to_numpy(), DT)[0])
    model = Sum([("drive", thresholds()), ("load", OnColumn(FirstOrderLag(), 1))]).fit(X, y)
    assert model.operators_["load"].operator.time_constant == pytest.approx(0.1, rel=1e-6)
    assert model.operators_["load"].operator.gain == pytest.approx(0.8, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-8)


@pytest.mark.parametrize("centered", [False, True])
def test_a_column_acts_on_what_goes_into_a_mode_behind_it(X, centered):
    """In a unit of its own, so that its reference is far from zero."""
    X = X.assign(load=20.0 + X["load"])
    reference = X["load"].mean() if centered else 0.0
    mode = SecondOrderModeOperator(9.0, 0.3, 2.0, 0.5)

    def law(part):
        bias = 0.3 * (part["load"].to_numpy() - reference)
        return mode.run(part["drive"].to_numpy() + bias, DT)[0]

    y = by_record(X, law)
    load = OnColumn(Gain(fit_intercept=False), 1, centered=centered)
    drive = Sum([("drive", Gain(fit_intercept=False)), ("load", load)])
    model = Cascade([("input", drive), ("mode", SecondOrderMode())]).fit(X, y)
    branch = model.operators_["input"].stages[1]
    assert branch.reference == pytest.approx(reference)
    assert branch.operator.gain == pytest.approx(0.3, rel=1e-6)
    assert model.operators_["mode"].gain == pytest.approx(2.0, rel=1e-6)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-8 * np.ptp(y))


def test_a_column_scales_the_response_beside_an_offset(X):
    y = by_record(X, lambda part: plays(part) * (1.0 + 0.2 * part["load"]) + part.index[0][0])
    model = Sum([("model", Modulated(thresholds(), 1)), ("offset", Offset())]).fit(X, y)
    operator = model.operators_["model"]
    slope = operator.sensitivity / (1.0 - operator.sensitivity * operator.reference)
    assert slope == pytest.approx(0.2, rel=1e-6)


def test_the_amplitude_and_a_column_scale_the_response(X):
    amplitude = X["drive"].groupby(level="record").transform(np.ptp) / 2
    factor = (1.0 + 0.3 * amplitude) * (1.0 - 0.2 * X["load"])
    y = by_record(X, plays) * factor
    for model in (
        Modulated(Modulated(thresholds(), "amplitude"), 1),
        Modulated(Modulated(thresholds(), 1), "amplitude"),
    ):
        model.fit(X, y)
        np.testing.assert_allclose(model.predict(X), y, atol=1e-8)
        np.testing.assert_allclose(model.predict(X.loc[[2]]), y.loc[[2]], atol=1e-8)
        assert {"sensitivity", "sensitivity_2"} <= set(model.params_)


def test_what_came_before_a_record_of_several_columns(X):
    """Where a column scales the response, the record begins as its known part says."""
    law = FirstOrderLagOperator(0.5)
    y = by_record(X, lambda part: law.run(part["drive"].to_numpy(), DT)[0] * (2.0 + part["load"]))
    noise = np.random.default_rng(0).normal(0.0, 0.01, len(y))
    model = Modulated(FirstOrderLag(), column=1).fit(X, y + noise)
    late, expected = X.loc[[2]][200:], y[-200:]
    known = np.where(np.arange(200) < 50, expected + noise[-200:], np.nan)
    found, std = model.predict(late, known, return_std=True)
    assert np.abs(found - expected).max() < 0.05 < np.abs(model.predict(late) - expected).max()
    assert np.mean(np.abs(noise[-200:] + expected - found) < 1.96 * std) > 0.9
    later = model.stepper_from(late[:50], known[:50]).run(late.to_numpy()[50:])
    np.testing.assert_allclose(later, found[50:], atol=1e-12)


def test_scheduled_parameters_beside_a_column_and_an_offset(X):
    def law(part):
        drive = part["drive"].to_numpy()
        gain = 1.0 + 0.5 * np.ptp(drive) / 2
        return gain * drive + 0.4 * part["load"].to_numpy()

    y = by_record(X, law)
    steps = [
        ("drive", ScheduledParameters(Gain(), parameters=["gain"])),
        ("load", OnColumn(Gain(), 1)),
    ]
    np.testing.assert_allclose(Sum(steps).fit(X, y).predict(X), y, atol=1e-8)
    both = Sum([*steps, ("offset", Offset())]).fit(X, y)
    np.testing.assert_allclose(both.predict(X), y, atol=1e-8)


@pytest.mark.parametrize("kind", [OnColumn, Modulated])
def test_wrong_columns_and_models(kind, X):
    y = X["drive"]
    for column in (2, "load"):
        with pytest.raises(ValueError, match="column"):
            kind(Gain(), column).fit(X, y)


# --------------------------------------------------------------------------------- the operators


OPERATORS = {
    "column": OnColumnOperator(LAG, 1),
    "modulated": Scaled(OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3),
    "modulated twice": Scaled(Scaled(OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3), 1, -0.1, 0.2),
    "modulated by a curve of a magnitude behind a lag": Scaled(
        OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3, LAG, (-0.1, 0.05), magnitude=True
    ),
    "friction of a load": Scaled(
        OnColumnOperator(FRICTION, 0),
        1,
        0.4,
        0.3,
        magnitude=True,
        scales=("coulomb_force", "stribeck_force"),
    ),
    "friction along the drive": Scaled(
        OnColumnOperator(FRICTION, 0), 0, 0.4, 0.3, curvature=(0.1,), scales=("coulomb_force",)
    ),
    "widths": Scaled(OnColumnOperator(PLAYS, 0), 2, 0.4, 0.3, scales=("thresholds",)),
    "widths of stops, behind a lag": Scaled(
        OnColumnOperator(replace(PLAYS, form="stop", drive_offset=0.1), 0),
        2,
        0.4,
        0.3,
        LAG,
        (-0.2,),
        scales=("thresholds",),
    ),
    "widths along the drive, down to none": Scaled(
        OnColumnOperator(PLAYS, 0), 0, 0.4, 1.3, magnitude=True, scales=("thresholds",)
    ),
    "friction of a load in motion": Scaled(
        OnColumnOperator(MASS, 0), 1, 0.4, 0.3, magnitude=True, scales=("friction",)
    ),
    "friction in motion, down to none, behind a lag": Scaled(
        OnColumnOperator(replace(MASS, stribeck_velocity=0.7, n_substeps=3), 0),
        2,
        0.4,
        0.9,
        LAG,
        (0.1,),
        scales=("friction",),
    ),
    "friction of a stage under a load": Scaled(
        OnColumnOperator(STAGE, 0), 1, 0.4, 0.3, magnitude=True, scales=("friction",)
    ),
    "hysteretic force of a stage under a load": Scaled(
        OnColumnOperator(HYSTERETIC, 0), 1, 0.4, 0.9, magnitude=True, scales=("friction",)
    ),
    "slip beside a curved spring under a load": Scaled(
        OnColumnOperator(SLIPPING, 0), 1, 0.4, 0.9, magnitude=True, scales=("friction",)
    ),
    "friction of a stage, along the way, too, down to none, behind a lag": Scaled(
        OnColumnOperator(replace(STAGE, friction_gradient=0.7, friction_center=0.037), 0),
        2,
        0.4,
        0.9,
        FirstOrderLagOperator(0.05),
        (0.1,),
        scales=("friction",),
    ),
    "sum": SumOperator(
        ("model", "load"),
        (
            Scaled(OnColumnOperator(LAG, 0), -1, 0.1, -0.2),
            OnColumnOperator(GainOperator(0.7), 1),
        ),
    ),
}


U = np.cumsum(np.random.default_rng(0).normal(size=(80, 3)), axis=0) / 5


def test_a_column_drives_the_operator():
    expected, _ = LAG.run(U[:, 1], DT, LAG.init(U[0, 1]))
    found = OnColumnOperator(LAG, 1)
    np.testing.assert_array_equal(found.run(U, DT, found.init(U[0]))[0], expected)


def test_modulation_scales_the_output():
    expected = PLAYS.run(U[:, 0], DT)[0] * (1.0 + 0.3 * (U[:, 2] - 0.4))
    found = OPERATORS["modulated"]
    np.testing.assert_allclose(found.run(U, DT, found.init(U[0]))[0], expected, rtol=1e-14)


@pytest.mark.parametrize("name", OPERATORS)
def test_derivatives_pieces_and_steps(name):
    operator = OPERATORS[name]
    check_operator(operator, U, DT)
    for initial_state in ("rest", "zero"):
        state = operator.init(U[0], initial_state)
        y, _ = operator.run(U, DT, state)
        stepper = Stepper(operator.compiled_step(DT, state))
        first = [stepper.step(row) for row in U[:30]]
        np.testing.assert_allclose([*first, *stepper.run(U[30:])], y, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in OPERATORS if "along the drive" in name])
def test_what_moves_the_drive_moves_the_column_that_it_is(name):
    operator, along, step = OPERATORS[name], np.cos(np.arange(len(U)) / 5), 1e-6
    ends = [operator.run(U + way * step * np.outer(along, [1, 0, 0]), DT)[0] for way in (1, -1)]
    _, dy = operator.sensitivities(U, along[:, None], DT)
    expected = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(dy[:, 0], expected, atol=1e-6 * np.ptp(dy[:, 0]))


def test_friction_grows_with_the_magnitude_of_the_load():
    """(F_c0 + mu |N|) tanh(v / v_0) alone follows the load; damping and spring do not."""
    friction = replace(FRICTION, stribeck_force=0.0, asymmetry=0.0)
    operator = Scaled(
        OnColumnOperator(friction, 0), 1, 0.0, 0.5, magnitude=True, scales=("coulomb_force",)
    )
    v = np.diff(U[:, 0], prepend=U[0, 0]) / DT
    expected = 0.8 * (1.0 + 0.5 * np.abs(U[:, 1])) * np.tanh(v / 1.3)
    expected += 0.3 * U[:, 0] + 0.02 * v + 0.1
    np.testing.assert_allclose(operator.run(U, DT)[0], expected, rtol=1e-12)


def loaded(mass, sensitivity, reference=0.0):
    on_drive = OnColumnOperator(mass, 0)
    return Scaled(on_drive, 1, reference, sensitivity, magnitude=True, scales=("friction",))


def test_a_load_at_rest_makes_a_mass_of_another_friction():
    """Of another Stribeck curve, too: all of the friction is that of the load."""
    mass = replace(MASS, stribeck_velocity=0.7, n_substeps=2)
    X = np.column_stack([U[:, 0], np.full(len(U), -5.0)])
    other = replace(mass, friction=1.5 * mass.friction, stribeck_force=1.5 * mass.stribeck_force)
    y = loaded(mass, 0.25, 3.0).run(X, DT)[0]
    np.testing.assert_allclose(y, other.run(U[:, 0], DT)[0], atol=1e-12)


@pytest.mark.parametrize("start", [0.5, -0.5])
@pytest.mark.parametrize(
    ("stage", "forces"),
    [
        (STAGE, ["static_level", "bristle_stiffness", "bristle_damping"]),
        (HYSTERETIC, ["level", "hysteresis_stiffness"]),
        (SLIPPING, ["slip_level", "hysteresis_stiffness"]),
    ],
    ids=["friction", "Bouc-Wen", "slip"],
)
def test_a_load_at_rest_makes_a_stage_of_another_friction(stage, forces, start):
    """All of it but the viscous one, and no curved spring, at rest, too; or there is none."""
    u = U[:, 0] - U[0, 0] + start

    def times(factor):
        return replace(stage, **{name: factor * getattr(stage, name) for name in forces})

    for load, factor in ((-5.0, 1.5), (1.0, 0.5), (-1.0, 0.5)):
        y = loaded(stage, 0.25, 3.0).run(np.column_stack([u, np.full(len(u), load)]), DT)[0]
        np.testing.assert_allclose(y, times(factor).run(u, DT)[0], atol=1e-12)
    y = loaded(stage, 0.25, 4.0).run(np.column_stack([u, np.zeros(len(u))]), DT)[0]
    np.testing.assert_allclose(y, replace(stage, **{forces[0]: 0.0}).run(u, DT)[0], atol=1e-12)


def test_friction_in_motion_that_grows_steadily_is_of_second_order():
    """A sliding mass whose load grows in proportion to time falls behind with its cube."""
    time, errors = np.linspace(0.0, 1.0, 11), []
    X = np.column_stack([np.full(11, 3.0), 4.0 * time])
    expected = (3.0 - 0.5) * time**2 / 2.0 - 0.5 * 0.3 * 4.0 * time**3 / 6.0
    for n_substeps in (1, 2):
        mass = FreeMassOperator(1.0, 1e-9, friction=0.5, n_substeps=n_substeps)
        errors.append(np.abs(loaded(mass, 0.3).run(X, 0.1)[0] - expected).max())
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.01)


def test_a_mass_under_a_load_is_identified_from_where_it_starts():
    """From a start in motion, too, whose derivatives are those of differences."""
    rng = np.random.default_rng(0)
    time = DT * np.arange(800)
    u = 4.0 * np.sin(2.1 * time) + 3.0 * np.sin(6.3 * time + 1.0)
    X = np.column_stack([u, 2.0 + 1.5 * np.sin(1.3 * time)])
    plant = loaded(FreeMassOperator(0.5, 0.8, friction=0.4, n_substeps=4), 0.6)
    start, step = np.array([0.3, -1.0]), 1e-6
    y = plant.run(X, DT, plant.init(X[0], start))[0]
    for k, slope in enumerate(plant.by_start(X, DT, start).T):
        ends = [start + way * step * np.eye(2)[k] for way in (1.0, -1.0)]
        ahead, behind = (plant.run(X, DT, plant.init(X[0], own))[0] for own in ends)
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=1e-6)
    y += 1e-3 * np.ptp(y) * rng.normal(size=800)
    mass = FreeMass(friction=True, fit_force_offset=False, initial_state="estimate", dt=DT)
    model = Modulated(mass, 1, scales=["friction"], magnitude=True, reference=0.0).fit(X, y)
    expected = {"mass": 0.5, "damping": 0.8, "friction": 0.4, "sensitivity": 0.6}
    for name, value in expected.items():
        assert abs(model.params_[name] - value) < 4.0 * model.params_std_[name]
    np.testing.assert_allclose(model.initial_values_, [start], atol=0.05)


@pytest.mark.parametrize("form", ["play", "stop"])
def test_a_column_at_rest_makes_plays_of_other_thresholds(form):
    """Rate-independent too: at another speed the same samples give the same response."""
    own = replace(PLAYS, form=form)
    widths = Scaled(OnColumnOperator(own, 0), 1, 20.0, 0.1, scales=("thresholds",))
    X = np.column_stack([U[:, 0], np.full(len(U), 25.0)])
    expected = replace(own, thresholds=1.5 * own.thresholds).run(U[:, 0], DT)[0]
    for dt in (DT, 10.0):
        np.testing.assert_allclose(widths.run(X, dt)[0], expected, atol=1e-12)


def test_a_play_stays_until_its_slack_takes_it_along():
    """While the drive rests, a wider slack moves nothing, and a narrower one its near end."""
    play = PrandtlIshlinskiiOperator([1.0], [1.0])
    widths = Scaled(OnColumnOperator(play, 0), 1, 0.0, 1.0, scales=("thresholds",))
    X = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [3.0, -0.5], [3.0, -9.0], [3.0, 0.0]])
    np.testing.assert_allclose(widths.run(X, DT)[0], [0.0, 2.0, 2.0, 2.5, 3.0, 3.0])


@pytest.mark.parametrize(
    ("model", "match"),
    [
        (Modulated(Gain(), 1, scales="thresholds"), "'thresholds' of a PrandtlIshlinskii"),
        (Modulated(FirstOrderLag(), 1, scales=["time_constant"]), "response is linear: gain"),
        (Modulated(Gain(), 1, scales=[]), "'scales' parameter"),
        (
            Modulated(FreeMass(hold="bandlimited"), 1, scales=["friction"]),
            r"\['friction'\] of a FreeMass",
        ),
        (Modulated(Gain(), 1, degree=0), "'degree' parameter"),
    ],
)
def test_what_cannot_be_scaled_is_refused(model, match, X):
    with pytest.raises(ValueError, match=match):
        model.fit(X, X["drive"])


def test_widths_in_front_of_a_lag_follow_a_column(X):
    """Within the records, linearly or by a curve; the residual is coloured by nothing else."""
    widths = Scaled(OnColumnOperator(PLAYS, 0), 1, 0.5, 0.3, None, (0.1,), scales=("thresholds",))

    def law(part):
        return LAG.run(widths.run(part.to_numpy(), DT)[0], DT)[0]

    y = by_record(X, law)
    model = Modulated(thresholds(), 1, scales="thresholds", reference=0.5, degree=2)
    model = Cascade([("plays", model), ("lag", FirstOrderLag())]).fit(X, y)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)
    assert model.params_["plays__sensitivity"] == pytest.approx(0.3, abs=1e-5)
    assert model.params_["plays__curvature[0]"] == pytest.approx(0.1, abs=1e-5)
    tree = model.tree(model.operator_)
    assert len(tree.keys()) == tree.n_parameters
    assert tree.estimator().get_params()["plays__scales"] == "thresholds"
    again = from_json(to_json(model))
    np.testing.assert_array_equal(again.predict(X), model.predict(X))


def test_a_scheduled_operator_within_takes_the_number_of_the_record():
    scheduled = Scheduled.constant(LAG, (1, 0, 0), 1.0, 3.0)
    x = scheduled.pack()
    x[:2] = 0.05, 0.15
    inside = SumOperator(
        ("model", "load"),
        (OnColumnOperator(scheduled.unpack(x), 0), OnColumnOperator(GainOperator(0.0), 1)),
    )
    own = inside.at(2.0)
    expected = FirstOrderLagOperator(0.1, gain=1.2).run(U[:, 0], DT)[0]
    np.testing.assert_allclose(own.run(U, DT, own.init(U[0]))[0], expected, rtol=1e-12)


def lagged_gain(n, noise=0.0, time_constant=0.4, seed=0):
    """Return X and y of a gain that a coil's current sets, behind the coil's voltage, (n, 2)."""
    rng = np.random.default_rng(seed)
    drive = np.sin(0.21 * np.arange(n)) + 0.3 * rng.normal(size=n)
    voltage = np.repeat(rng.uniform(1.0, 3.0, n // 50), 50)  # steps, each at one sample
    current, now = [], voltage[0]
    for before, after in zip(np.append(voltage[0], voltage[:-1]), voltage, strict=True):
        # exact for a straight line between the samples
        slope, fade = (after - before) / DT, np.exp(-DT / time_constant)
        now = after - slope * time_constant + (now - before + slope * time_constant) * fade
        current.append(now)
    y = (2.0 * drive + 0.5) * (1.0 + 0.25 * (np.array(current) - 2.0))
    return np.column_stack([drive, voltage]), y + noise * rng.normal(size=n)


def test_a_column_scales_behind_a_lag():
    X, y = lagged_gain(1000)
    model = Modulated(Gain(), 1, lag=True, dt=DT).fit(X, y)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-6)
    assert model.operator_.lag.time_constant == pytest.approx(0.4, rel=1e-4)
    assert model.params_["lag_time_constant"] == pytest.approx(0.4, rel=1e-4)
    at_two = 1.0 + model.operator_.sensitivity * (2.0 - model.operator_.reference)
    assert model.operator_.sensitivity / at_two == pytest.approx(0.25, rel=1e-4)
    check_operator(model.operator_, X[:60], DT)
    stepper = model.stepper(u0=X[0])
    np.testing.assert_allclose([stepper.step(row) for row in X], y, atol=1e-6)
    again = from_json(to_json(model))
    np.testing.assert_array_equal(again.predict(X), model.predict(X))
    assert Modulated(Gain(), 1, dt=DT).fit(X, y).fit_error_ > 0.02


def test_a_lag_of_the_column_is_a_part_of_the_tree():
    operator = Scaled(OnColumnOperator(GainOperator(2.0), 0), 1, 2.0, 0.25, LAG)
    tree = Modulated(Gain(), 1, lag=True).tree(operator)
    assert tree.estimator().lag is True
    keys = tree.keys()
    assert len(keys) == tree.n_parameters
    assert ("lag of column 1", "time_constant") in keys
