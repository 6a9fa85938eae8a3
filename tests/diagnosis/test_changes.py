"""Where an effect can enter a model, and what it starts from."""

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import search_steps

from skhyst.compose import amplitude
from skhyst.diagnosis import EFFECTS
from skhyst.diagnosis._changes import _refitted_to
from skhyst.fluid import TankChain
from skhyst.hysteresis import (
    CoulombFriction,
    FreeMass,
    FreeMassOperator,
    MaxwellSlip,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    DynamicStiffness,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    KelvinVoigtOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.optimize import RecordData, variable_projection
from skhyst.static import SaturationOperator

DT = 0.01
LAG = FirstOrderLagOperator(0.05)
MODE = SecondOrderModeOperator(30.0, 0.1)


def recordings(columns=True):
    """Return two records of unlike amplitude, with a column of levels and one that moves."""
    found = []
    for seed, n in enumerate((90, 120)):
        u = (1.0 + 2.0 * seed) * np.cumsum(np.random.default_rng(seed).normal(size=n)) / 3.0
        x = np.c_[np.full(n, 1.0 + seed), np.cos(u)] if columns else None
        found.append(RecordData(u, u + 0.1 * np.sin(u), DT, auxiliary=x))
    return found


@cache
def trees():
    """Return declared models, by what they are made of."""
    plays = PrandtlIshlinskiiOperator([0.0, 0.5, 1.0], [0.4, 0.3, 0.2])
    found = {
        "gain": search_steps.tree_of(Gain(), GainOperator(1.0)),
        "lag": search_steps.tree_of(FirstOrderLag(), LAG),
        "mode": search_steps.tree_of(SecondOrderMode(), MODE),
        "plays": search_steps.tree_of(PrandtlIshlinskii(3), plays),
    }
    found["plays, mode"] = search_steps.with_stage(
        found["plays"], "further", SecondOrderMode(), MODE
    )
    found["lags"] = search_steps.with_stage(
        found["lag"], "further", FirstOrderLag(), FirstOrderLagOperator(0.2)
    )
    for name, model in (("poles", TransferFunction(2, n_zeros=0)), ("force", DynamicStiffness())):
        found[name] = search_steps.fitted(model, recordings())
    return {name: type(tree)(tree.root, tree.model) for name, tree in found.items()}


DYNAMIC = {"lag", "mode", "plays, mode", "lags", "poles"}
EVERY = DYNAMIC | {"gain", "plays", "force"}


def form(effect, text):
    """Return the first variant of an effect in whose description that text is."""
    return next(own for own in EFFECTS[effect].variants() if text in repr(own))


WITHOUT_COLUMNS = [  # effect, variant, and the models that it enters
    ("timing", "'zoh'", DYNAMIC),
    ("timing", "'bandlimited'", DYNAMIC),
    ("timing", "'foh'", set()),  # it is declared
    ("hysteresis", "FirstHysteresis", EVERY - {"plays", "plays, mode", "force"}),
    ("hysteresis", "behind=True", DYNAMIC - {"plays, mode"}),
    ("cubic_stiffness", "InMotion", {"mode", "poles"}),
    ("static_nonlinearity", "AtJoints", EVERY),
    ("static_nonlinearity", "inner=True", {"plays, mode", "lags"}),
    ("lag", "AtJoints", {"plays", "plays, mode"}),  # linear dynamics commute
    ("hysteresis", "MaxwellSlip", {"force"}),
    ("hysteresis", "with_gain=True", {"force", "gain"}),
    ("static_nonlinearity", "BesideHysteresis", {"force", "plays", "plays, mode"}),
    ("creep", "BesideHysteresis", {"force", "plays", "plays, mode"}),
    ("asymmetry", "BehindHysteresis", {"plays", "plays, mode"}),
    ("cubic_stiffness", "MoreTerms", set()),
    ("cubic_stiffness", "InFeedback", set()),
    ("rate_dependence", "slope", {"plays", "plays, mode"}),
    ("static_nonlinearity", "InStages", {"lag", "lags"}),
    ("amplitude_dependence", "dynamics", DYNAMIC),
    ("amplitude_dependence", "which='all'", EVERY),
    ("amplitude_dependence", "MovedModes", {"gain"}),
    ("amplitude_dependence", "Scaling", EVERY),
]
BY_A_COLUMN = [
    ("auxiliary_input", "Driven", EVERY),
    ("auxiliary_input", "to_drive=True", EVERY),
    ("auxiliary_input", "Scaling", EVERY),
    ("auxiliary_input", "FollowedWidth", {"plays", "plays, mode"}),
    ("auxiliary_input", "PerRecord", EVERY),
    ("friction", "LoadedForce", {"force"}),
    ("friction", "LoadedMotion", {"mode", "poles"}),
]


def found_by(change, name, records=None):
    return search_steps.entered(change, trees()[name], records or recordings())


@pytest.mark.parametrize(("effect", "text", "where"), WITHOUT_COLUMNS + BY_A_COLUMN)
def test_an_effect_enters_where_its_law_can_act(effect, text, where):
    """What is found has one effect more, and is the declared model without it."""
    change, of_column = form(effect, text), (effect, text, where) in BY_A_COLUMN
    for name, declared in trees().items():
        found = found_by(change, name)
        assert bool(found) == (name in where), name
        for tree in found:
            assert tree.effects == ("effect",)
            assert tree.without("effect").names == declared.names
            names = [own.problem(recordings()).names for own in (tree, declared)]
            assert names[0] != names[1] or effect == "timing"
        if of_column:
            assert found_by(change, name, recordings(columns=False)) == []
        elif effect == "amplitude_dependence":
            assert found_by(change, name, recordings()[:1]) == []  # there is one amplitude


@pytest.mark.parametrize("name", ["lag", "plays", "plays, mode"])
@pytest.mark.parametrize(
    ("effect", "text"),
    [
        ("amplitude_dependence", "which='all'"),
        ("auxiliary_input", "PerRecord"),
        ("auxiliary_input", "to_drive=True"),
    ],
)
def test_what_may_depend_on_a_number_starts_as_if_it_did_not(effect, text, name):
    records = recordings()
    for tree in found_by(form(effect, text), name):
        for own, declared in zip(tree.run(records), trees()[name].run(records), strict=True):
            np.testing.assert_allclose(own, declared, atol=1e-12)


def test_columns_are_numbered_from_one_and_those_that_rest_do_nothing():
    records = recordings()
    means = [np.concatenate([r.auxiliary[:, k] for r in records]).mean() for k in range(2)]

    def edits(change, name="plays"):
        return [edit for tree in found_by(change, name) for _, edit in tree.edits]

    assert [e.column for e in edits(form("auxiliary_input", "Driven"))] == [1, 2]
    shifted = edits(form("auxiliary_input", "to_drive=True"))
    assert [e.column for e in shifted] == [1, 2]
    for change in (form("auxiliary_input", "Scaling"), form("auxiliary_input", "FollowedWidth")):
        assert [e.column for e in edits(change)] == [1, 2]
        np.testing.assert_allclose([e.reference for e in edits(change)], means)
    still = [RecordData(r.u, r.y, DT, auxiliary=0.0 * r.auxiliary + 3.0) for r in records]
    for effect, text, where in BY_A_COLUMN:
        for name in where:
            assert found_by(form(effect, text), name, still) == []
    (of_records,) = edits(form("auxiliary_input", "PerRecord"))
    assert (of_records.by, of_records.low, of_records.high) == (1, 1.0, 2.0)
    for resting in range(2):  # the other one moves within a record
        moving = [
            replace(r, auxiliary=r.auxiliary[:, 1:] if k != resting else 0.0 * r.u[:, None])
            for k, r in enumerate(records)
        ]
        assert found_by(form("auxiliary_input", "PerRecord"), "plays", moving) == []
    sizes = [amplitude(r.u) for r in records]
    for change, name in (
        (form("amplitude_dependence", "which='all'"), "lag"),
        (form("amplitude_dependence", "MovedModes"), "gain"),
    ):
        for tree in found_by(change, name, records[::-1]):
            edit = tree.edits[-1][1]
            assert (edit.by, edit.low, edit.high) == ("amplitude", min(sizes), max(sizes))


def test_a_curve_comes_to_every_joint_but_its_own():
    """Its own is behind the dynamics."""
    names = [tree.names for tree in found_by(form("static_nonlinearity", "AtJoints"), "lags")]
    lags = trees()["lags"].names
    assert set(names) == {("effect", *lags), (lags[0], "effect", lags[1])}
    inner = [tree.names for tree in found_by(form("static_nonlinearity", "inner=True"), "lags")]
    assert set(inner) == {(lags[0], "effect", lags[1])}
    early = {tree.names for tree in found_by(form("creep", "AtJoints"), "plays, mode")}
    assert early == {("effect", *trees()["plays, mode"].names)}


def test_creep_of_the_drive_of_plays_is_found():
    u = 2.0 * np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 6), 20)
    creep = KelvinVoigtOperator(np.array([0.2]), np.array([0.15]))
    y = trees()["plays"].run([RecordData(creep.run(u, DT)[0], u, DT)])[0]
    records, costs = [RecordData(u, y, DT)], []
    for tree in found_by(form("creep", "AtJoints"), "plays", records):
        problem = tree.problem(records)
        costs.append(variable_projection(problem, problem.x0).cost)
    assert min(costs) < 1e-8 * np.sum(np.square(y))


@pytest.mark.parametrize("number", [0, 1, 2, 3, 4])
def test_lags_in_a_row_may_be_tanks(number):
    """A mode is none; what decays slowest comes last."""
    lags, modes = np.linspace(0.1, 0.4, number), np.ones(1 - min(number, 1))
    operator = TransferFunctionOperator(lags, 20.0 * modes, 0.1 * modes, np.empty(0))
    model = TransferFunction(max(number, 2), n_zeros=0)
    u = 1.0 + 0.5 * np.sign(np.sin(np.arange(200) * 2.0 * DT))
    records = [RecordData(u, operator.run(u, DT)[0], DT)]
    for effect in ("static_nonlinearity", "output_saturation"):  # whose tanks overflow
        tree = search_steps.tree_of(model, operator)
        found = search_steps.entered(form(effect, "InStages"), tree, records)
        assert bool(found) == (number > 0)
        for tree in found:
            assert len(tree.operators) == 1
            assert isinstance(tree.models[0], TankChain)
            assert np.ndim(tree.run(records)[0]) == 1
    if number == 1:  # nor is what follows a hysteresis
        behind = search_steps.with_stage(trees()["plays"], "further", FirstOrderLag(), LAG)
        assert search_steps.entered(form("static_nonlinearity", "InStages"), behind, records) == []


@pytest.mark.parametrize("saturates", [True, False])
def test_a_saturation_between_two_lags_shows_in_what_the_linear_model_leaves(saturates):
    u = np.cumsum(np.random.default_rng(0).normal(size=600)) / 2.0
    inner = FirstOrderLagOperator(0.05).run(u, DT)[0]
    if saturates:
        inner = np.clip(inner, -0.2 * np.ptp(inner), 0.2 * np.ptp(inner))
    y = FirstOrderLagOperator(0.3).run(inner, DT)[0]
    y = y + 1e-3 * np.random.default_rng(1).normal(size=600)
    records = [RecordData(u, y, DT)]
    model = TransferFunction(2, n_zeros=0)
    tree = search_steps.fitted(model, records)
    found = search_steps.entered(
        form("static_nonlinearity", "InBetween(model=Saturation"), tree, records
    )
    assert bool(found) == saturates
    for own in found:
        assert len(own.operators) == 3
        assert isinstance(own.operators[1], SaturationOperator)
        assert all(len(own.operators[k].poles()) == 1 for k in (0, 2))
    one = search_steps.tree_of(FirstOrderLag(), LAG)  # cannot be divided
    assert (
        search_steps.entered(
            form("static_nonlinearity", "InBetween(model=Saturation"), one, records
        )
        == []
    )


@pytest.mark.parametrize(("rough", "asked"), [((), 0), ((0,), 1), ((1,), 1), ((0, 1), 1)])
def test_a_drive_without_high_frequencies_is_the_same_however_it_is_interpolated(rough, asked):
    records = []
    for k in range(2):
        u = np.sin(np.arange(200) / 30.0)
        u += np.random.default_rng(k).normal(size=200) if k in rough else 0.0
        records.append(RecordData(u, u, DT))
    assert len(found_by(form("timing", "'bandlimited'"), "lag", records)) == asked
    assert len(found_by(form("timing", "'zoh'"), "lag", records)) == 1


def test_what_depends_on_the_record_depends_on_nothing_else_yet():
    """One straight line at a time, and none for what is added in front of the declared model."""
    lines = found_by(form("amplitude_dependence", "which='all'"), "lag")[0]
    for change in (
        form("amplitude_dependence", "which='all'"),
        form("amplitude_dependence", "MovedModes"),
        form("static_nonlinearity", "InBetween(model=Saturation"),
        form("auxiliary_input", "to_drive=True"),
        form("rectification", "Folded"),
    ):
        assert search_steps.entered(change, lines, recordings(), "more") == []
    assert search_steps.entered(form("auxiliary_input", "Driven"), lines, recordings(), "more")
    scaled = found_by(form("auxiliary_input", "Scaling"), "lag")[0]
    edits = [
        tree.edits[-1][1]
        for tree in search_steps.entered(
            form("auxiliary_input", "Scaling"), scaled, recordings(), "more"
        )
    ]
    assert [edit.column for edit in edits] == [2]  # it is scaled by the first one


def test_friction_that_is_declared_follows_the_load_itself():
    """Where there is none, it is added for each column; its levels alone grow with the load."""
    records = recordings()
    (first, second) = found_by(form("friction", "LoadedForce"), "force")
    assert first.is_part("effect")
    assert second.is_part("effect")
    model = CoulombFriction()
    tree = search_steps.fitted(model, records)
    found = search_steps.entered(form("friction", "LoadedForce"), tree, records)
    loads = [np.abs(np.concatenate([r.auxiliary[:, k] for r in records])).mean() for k in range(2)]
    for number, (own, load) in enumerate(zip(found, loads, strict=True), start=1):
        ((_, edit),) = own.edits
        assert (edit.column, edit.reference) == (number, pytest.approx(load))
        assert edit.magnitude
        assert set(edit.scales) == {"coulomb_force", "stribeck_force", "asymmetry"}
        assert not own.is_part("effect")


def test_forces_of_a_free_mass_are_added_that_it_has_not():
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.normal(size=150))
    records = [RecordData(u, np.cumsum(np.cumsum(u)) * DT**2, DT)]
    tree = search_steps.fitted(FreeMass(), records)
    cubic = form("cubic_stiffness", "MoreTerms")
    found = search_steps.entered(cubic, tree, records)
    assert found
    assert all(own.models[0].cubic_stiffness for own in found)
    assert search_steps.entered(cubic, found[0], records, "more") == []


@pytest.mark.parametrize("name", ["offset", "drift"])
def test_a_force_beside_the_drive_is_a_parameter_and_tried_as_one(name):
    """It helps a new record, as a function of time beside the response does not."""
    effect = EFFECTS[name]
    mass, mode = (
        search_steps.tree_of(model, operator)
        for model, operator in (
            (FreeMass(fit_force_offset=False), FreeMassOperator(1.0, 0.1)),
            (SecondOrderMode(), SecondOrderModeOperator(30.0, 0.1)),
        )
    )
    within, additive = effect.tried(mass, additive=False), effect.tried(mass, additive=True)
    assert [within.additive, additive.additive] == [False, True]
    forms = [*within.variants(), *additive.variants()]
    assert sorted(map(repr, forms)) == sorted(map(repr, effect.variants()))
    assert all(form.places(mass) for form in within.variants())
    assert effect.tried(mode, additive=False) is None
    again = effect.tried(mode, additive=True).variants()
    assert list(map(repr, again)) == list(map(repr, additive.variants()))
    assert pickle.loads(pickle.dumps(within)).variants()[0].places(mass)


def test_a_spring_bends_in_the_feedback_of_more_poles_than_those_of_a_mode():
    """In front of all that has a gain of its own, and once; what feeds through at once has none."""
    records, bent = recordings(), form("cubic_stiffness", "InFeedback")
    poles = TransferFunctionOperator([0.05], [30.0], [0.2], [0.3, 0.1], 1.4)
    tree = search_steps.tree_of(TransferFunction(3, n_zeros=2), poles)
    found = search_steps.entered(bent, tree, records)
    assert found
    for own in found:
        assert own.without("effect").operators[0].pack().tolist() == poles.pack().tolist()
        assert own.operators[0].linear.pack().tolist() == poles.pack().tolist()
        assert search_steps.entered(bent, own, records, "more") == []
    straight = replace(poles, numerator=np.append(poles.numerator, 0.01))
    assert (
        search_steps.entered(bent, search_steps.tree_of(TransferFunction(3), straight), records)
        == []
    )
    behind = search_steps.in_front(
        tree, "front", PrandtlIshlinskii(3), trees()["plays"].operators[0]
    )
    assert search_steps.entered(bent, behind, records) == []


def test_friction_of_a_mass_follows_each_load():
    """Friction that is added, or that is there; not that of a mass behind another stage."""
    u, rng = np.cumsum(np.random.default_rng(0).normal(size=150)), np.random.default_rng(1)
    loads = np.column_stack([rng.normal(size=150), np.full(150, 2.0)])
    y = np.cumsum(np.cumsum(u)) * DT**2
    records = [RecordData(u, y, DT, auxiliary=loads)]
    change = form("friction", "LoadedMotion")
    for model in (FreeMass(), FreeMass(friction=True)):
        tree = search_steps.fitted(model, records)
        found = search_steps.entered(change, tree, records)
        assert found
        for own in found:
            assert own.models[0].estimator.friction
            scaled = own.operators[0]
            assert (scaled.column, scaled.magnitude, scaled.scales) == (1, True, ("friction",))
            assert scaled.reference == pytest.approx(np.abs(loads[:, 0]).mean())
            assert search_steps.entered(change, own, records, "more") == []
        behind = search_steps.in_front(tree, "front", FirstOrderLag(), LAG)
        assert search_steps.entered(change, behind, records) == []


@pytest.mark.parametrize("declared", [DynamicStiffness(drive="velocity"), CoulombFriction()])
def test_a_force_beside_one_of_a_velocity_is_of_that_velocity(declared):
    """Behind an integrator, or with the motion as the model has it."""
    if isinstance(declared, CoulombFriction):
        declared.set_params(motion="velocity")
    tree = search_steps.fitted(declared, recordings())
    [found] = search_steps.entered(form("hysteresis", "MaxwellSlip"), tree, recordings())[:1]
    place, friction = found.models[0].steps[1][1].steps
    assert isinstance(place[1], TransferFunction)
    assert isinstance(friction[1], MaxwellSlip)
    if isinstance(declared, DynamicStiffness):
        sliding = search_steps.entered(
            form("friction", "ParallelForce(model=CoulombFriction"), tree, recordings()
        )
        assert {own.models[0].steps[1][1].motion for own in sliding} == {"velocity"}


def test_what_is_there_is_not_added_again():
    records = recordings()
    for additive in (
        form("hysteresis", "MaxwellSlip"),
        form("friction", "ParallelForce(model=CoulombFriction"),
    ):
        found = found_by(additive, "force")
        assert found
        assert search_steps.entered(additive, found[0], records, "more") == []
    friction = search_steps.entered(form("friction", "LoadedForce"), found[0], records, "more")
    assert [own.is_part("more") for own in friction] == [False, False]  # it follows the load


def test_the_stage_that_is_meant_may_stand_anywhere():
    """Behind another one, too; and one that has an offset of its own drive is not widened."""
    records, plays = recordings(), trees()["plays"]
    behind = search_steps.in_front(plays, "front", FirstOrderLag(), LAG)
    assert behind.names[0] == "front"
    assert search_steps.entered(form("rate_dependence", "slope"), behind, records, "more")
    assert (
        search_steps.entered(form("auxiliary_input", "FollowedWidth"), behind, records, "more")
        == []
    )  # they are not in front
    for own in ({"drive_offset": 0.3}, {"form": "stop"}):
        other = plays.with_stage(0, operator=replace(plays.operators[0], **own))
        assert search_steps.entered(form("rate_dependence", "slope"), other, records, "more") == []


@pytest.mark.parametrize("unit", [1e-6, 1.0])
@pytest.mark.parametrize("weighted", [False, True])
def test_linear_parameters_are_those_of_least_squares(unit, weighted):
    """Of records with weights, whatever a part is that does not move."""
    u = np.cumsum(np.random.default_rng(0).normal(size=200)) / 3.0
    y = unit * (2.0 * u + 0.3 * np.sin(5.0 * u) + 1.0)
    weights = np.linspace(0.1, 3.0, 200) if weighted else np.ones(200)
    records = [RecordData(u, y, DT, weights=weights if weighted else None)]
    basis = np.sqrt(weights)[:, None] * np.c_[u, np.ones(200)]
    expected = np.linalg.lstsq(basis, np.sqrt(weights) * y, rcond=None)[0]
    tree = search_steps.tree_of(Gain(), GainOperator(0.1 * unit, 3.0))
    (operator,) = _refitted_to(records, tree).operators
    np.testing.assert_allclose([operator.gain, operator.intercept], expected, rtol=1e-6)
    still = [replace(records[0], u=np.zeros(200))]
    (operator,) = _refitted_to(still, tree).operators
    mean = np.average(y, weights=weights)
    assert (operator.gain, operator.intercept) == (0.1 * unit, pytest.approx(mean))
