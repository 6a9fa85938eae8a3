"""Starting values: in the right place, of unit gain, and near enough to the truth."""

import numpy as np
import plants
import pytest
import search_steps
from plants import make_recording

from skhyst.compose import Cascade
from skhyst.diagnosis import EFFECTS
from skhyst.diagnosis._edits import Divide, InsertAt, Schedule
from skhyst.diagnosis._starts import Scene, _distinct, _has_poles, starting_trees
from skhyst.hysteresis import (
    BoucWen,
    CoulombFriction,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
)
from skhyst.linear import (
    DynamicStiffness,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    GainOperator,
    LinearOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
    TransferFunction,
    TransferFunctionOperator,
)
from skhyst.operators import OnColumnOperator, Scaled, Series
from skhyst.optimize import RecordData
from skhyst.static import DeadBand, DeadBandOperator, SaturationOperator, SoftSaturation

KINDS = plants.EFFECTS[:11]  # those that are a stage of their own, or beside the model
SEED = 9000


def declared_model(kind):
    if kind == "prandtl_ishlinskii":
        return PrandtlIshlinskii(6)
    if kind == "bouc_wen":
        return BoucWen(exponent="fit")
    return Cascade([("hysteresis", PrandtlIshlinskii(6)), ("dynamics", TransferFunction(2))])


def declared(effect, kind, n_samples, seed=SEED):
    """Return a recording, its records and the tree of the declared model."""
    recording = make_recording(effect, kind, seed, n_samples=n_samples)
    y, dt = recording.y_train, recording.sampling_interval
    records = [
        RecordData(u.to_numpy(), y.loc[label].to_numpy(), dt)
        for label, u in recording.X_train["drive"].groupby(level="record")
    ]
    model = declared_model(kind)
    return recording, records, search_steps.fitted(model, records)


def started(effect, kind, name=None, n_samples=3000):
    """Return the recording, the declared structure and the starts of an effect on its plant."""
    recording, records, structure = declared(effect, kind, n_samples)
    found = list(starting_trees(EFFECTS[name or effect], structure, records))
    return recording, records, structure, found


@pytest.mark.parametrize("kind", ["prandtl_ishlinskii", "cascade"])
@pytest.mark.parametrize("name", KINDS)
def test_every_variant_has_starts_in_its_place(name, kind):
    _, records, structure, found = started("none", kind, name, n_samples=1500)
    effect = EFFECTS[name]
    plain = [variant for variant in effect.variants() if not hasattr(variant, "trees")]
    assert len(found) >= max(len(plain), 1)  # a change of another kind may not apply
    for candidates in found:
        assert candidates
        for candidate in candidates:
            if isinstance(candidate.edits[-1][1], InsertAt | Divide):  # at joints of their own
                continue
            ranks = [operator.stage_order for operator in candidate.operators]
            assert ranks == sorted(ranks)
            if effect.additive:
                assert candidate.names == structure.names
                for own, before in zip(candidate.operators, structure.operators, strict=True):
                    np.testing.assert_array_equal(own.pack(), before.pack())
                assert candidate.disturbance_names == (name,)
                assert len(candidate.disturbances) == 1
            else:
                added = [] if candidate.is_part(name) else [name]  # of a sum: the stage's own name
                assert sorted(candidate.names) == sorted([*structure.names, *added])
            problem = candidate.problem(records)
            assert np.isfinite(problem.x0).all()
            assert np.isfinite(problem.evaluate(problem.x0)).all()


@pytest.mark.parametrize("name", ["lag", "resonance", "creep", "delay"])
def test_a_stage_behind_a_hysteresis_leaves_the_gain_to_it(name):
    _, records, structure, found = started("none", "prandtl_ishlinskii", name, n_samples=1500)
    own = len(structure.problem(records).x0)
    for candidates in found:
        for candidate in candidates:
            if candidate.is_part(name):  # in parallel with the hysteresis
                continue
            stage = candidate.operators[candidate.names.index(name)]
            settled = stage.run(np.full(50, 3.0), 0.01)[0]
            prompt = 1.0 + np.sum(getattr(stage, "compliances", 0.0))  # creep counts from prompt
            np.testing.assert_allclose(settled, 3.0 * prompt, rtol=1e-9)
            gained = len(candidate.problem(records).x0) - own
            assert gained < stage.n_parameters + 1


def test_a_hysteresis_before_a_curve_leaves_the_curve_what_it_has_seen():
    """Without any weight it would respond nothing, and the curve would follow that."""
    u = np.interp(np.arange(500), [0, 60, 180, 300, 420, 499], [0.0, 1.0, -1.0, 1.0, -1.0, 0.0])
    play = PrandtlIshlinskiiOperator([0.3], [1.0])
    y = np.tanh(2.0 * play.run(u, 0.01)[0])
    records = [RecordData(u, y, 0.01)]
    model = Cascade([("gain", Gain()), ("curve", SoftSaturation(fit_center=False))])
    tree = search_steps.fitted(model, records)
    found = starting_trees(EFFECTS["hysteresis"], tree, records)
    ((start,),) = (own for own in found if own[0].names == ("hysteresis", "gain", "curve"))
    np.testing.assert_allclose(start.respond(records)[0], tree.respond(records)[0], atol=1e-9)
    with_curve, with_both = (
        search_steps.refit(search_steps.candidate(own), records).cost for own in (tree, start)
    )
    assert with_both < 1e-3 * with_curve


def nearest(found, name, parameter, truth):
    """Return the smallest ratio, above one, between a start's parameter and the truth."""
    ratios = []
    for candidates in found:
        for candidate in candidates:
            stage = candidate.operators[candidate.names.index(name)]
            values = np.atleast_1d(getattr(stage, parameter))
            ratios.append(np.exp(np.min(np.abs(np.log(np.abs(values / truth))))))
    return min(ratios)


@pytest.mark.parametrize("kind", ["prandtl_ishlinskii", "cascade"])
@pytest.mark.parametrize(
    ("name", "parameter", "key", "factor"),
    [
        ("lag", "time_constant", "tau", 3.0),
        ("delay", "delay", "delay", 2.0),
        ("resonance", "natural_frequency", "frequency", 1.3),
    ],
)
def test_a_start_is_near_the_truth(name, parameter, key, factor, kind):
    recording, _, _, found = started(name, kind)
    truth = recording.truth["parameters"][key]
    if name == "resonance":
        truth *= 2.0 * np.pi
    if name in {"lag", "resonance"}:
        found = found[:1]  # the variant that states this number
    assert nearest(found, name, parameter, truth) < factor


@pytest.mark.parametrize("name", ["input_saturation", "output_saturation"])
def test_a_starting_level_is_near_the_truth(name):
    recording, _, _, found = started(name, "prandtl_ishlinskii")
    signal = recording.X_train["drive"] if name == "input_saturation" else recording.y_train
    truth = recording.truth["parameters"]
    for side, level in (("lower", truth["low"]), ("upper", truth["high"])):
        if np.isfinite(level):
            levels = [
                getattr(candidate.operators[candidate.names.index(name)], side)
                for candidates in found
                for candidate in candidates
                if hasattr(candidate.operators[candidate.names.index(name)], side)
            ]
            assert np.min(np.abs(np.array(levels) - level)) < 0.15 * np.ptp(signal)


@pytest.mark.parametrize("name", ["lag", "resonance", "creep"])
def test_dynamics_that_start_anew_keep_their_number_of_poles(name):
    _, _, structure, found = started(name, "cascade")
    declared = structure.operators[structure.names.index("dynamics")]
    for candidates in found:
        for candidate in candidates:
            dynamics = candidate.operators[candidate.names.index("dynamics")]
            assert isinstance(dynamics, LinearOperator)
            assert dynamics.n_poles == declared.n_poles
        first = candidates[0]  # what is behind it stays, unless it is added behind all
        if first.names[0] != "hysteresis" or first.is_part(name):
            continue
        # a declared model that lacks a pole has bent its own: one start at least is not bent
        assert any(
            not np.allclose(
                candidate.operators[candidate.names.index("dynamics")].pack(), declared.pack()
            )
            for candidate in candidates
        )


def test_what_a_start_is_fitted_to_is_what_the_model_leaves():
    _, records, structure = declared("lag", "prandtl_ishlinskii", 3000)
    scene = Scene(structure, records)
    for own, record, output in zip(
        scene.residuals, records, structure.respond(records), strict=True
    ):
        np.testing.assert_allclose(own.y + output, record.y)


def test_distinct_pole_sets_are_apart_and_every_other_is_near_one():
    rng = np.random.default_rng(9000)
    sets = [-np.exp(rng.uniform(0.0, 0.3, 2)) for _ in range(60)]
    kept = _distinct(sets)
    assert 1 < len(kept) < 60

    def apart(a, b):
        return np.max(np.abs(np.sort_complex(a) / b - 1.0))

    for i, poles in enumerate(kept):
        assert all(apart(poles, other) > 0.05 for other in kept[:i])
    assert all(min(apart(poles, other) for other in kept) <= 0.05 for poles in sets)


def test_a_variant_that_breaks_its_promise_does_not_hide_the_others():
    """A knee cannot harden, whatever one linear step from its starting values promises."""
    recording, records, tree = declared("static_nonlinearity", "bouc_wen", 6000, 9151)
    found = search_steps.variants("static_nonlinearity", tree, records)
    bar = 4.0 * recording.noise_std**2 * sum(len(record.y) for record in records)
    assert min(search_steps.refit(c, records, max_evaluations=9).cost for c in found) < bar


def test_poles_are_put_elsewhere_in_stages_that_have_some_of_their_own():
    lag, mode = FirstOrderLagOperator(0.1), SecondOrderModeOperator(21.0, 0.04)
    constant = TransferFunctionOperator(np.empty(0), np.empty(0), np.empty(0), np.empty(0), 2.0)
    both = Series(("lag", "mode"), (lag, mode))
    stages = [lag, mode, constant, both, SaturationOperator(upper=0.8)]
    assert [_has_poles(stage) for stage in stages] == [True, True, False, False, False]


def test_poles_that_no_record_shows_are_moved_to_the_edge_of_what_is_seen():
    """Decay by e over the longest record, and half the sampling rate of the finest one."""
    lengths = [(100, 0.1), (500, 0.01)]  # 10 s and 5 s
    records = [RecordData(np.zeros(n), np.zeros(n), dt) for n, dt in lengths]
    poles = np.array([-1e-3 + 5.0j, -1e-3 - 5.0j, 3.0, -7.0 + 1.0j, -1e4])
    expected = [-0.1 + 5.0j, -0.1 - 5.0j, -0.1, -7.0 + 1.0j, -np.pi / 0.01]
    np.testing.assert_allclose(Scene(None, records).seen(poles), expected)


@pytest.mark.parametrize("lost", [(20.0, 1e-10), (4e4, 400.0)])
@pytest.mark.parametrize("name", ["input_saturation", "output_saturation"])
def test_no_effect_is_put_beside_lost_poles_alone(name, lost):
    """A mode that never decays, or faster than the samples tell, has no gradient back."""
    rng, dt, noise = np.random.default_rng(9000), 0.02, 0.01
    mode, drive = SecondOrderModeOperator(21.0, 0.04), np.repeat(rng.normal(size=60), 50)
    stages = [SaturationOperator(upper=0.8), mode]
    y = drive
    for stage in stages if name == "input_saturation" else stages[::-1]:
        y, _ = stage.run(y, dt)
    records = [RecordData(drive, y + noise * rng.normal(size=len(y)), dt)]
    tree = search_steps.tree_of(SecondOrderMode(dt=dt), SecondOrderModeOperator(*lost))
    found = search_steps.variants(name, tree, records)
    cost = min(search_steps.refit(c, records, max_evaluations=9).cost for c in found)
    assert cost < 1.2 * noise**2 * len(y)


def test_parameters_follow_the_column_that_they_are_said_to():
    rng, levels = np.random.default_rng(0), [(1.0, 30.0), (2.0, 10.0), (3.0, 20.0)]
    records = [
        RecordData(u, u.copy(), 0.1, auxiliary=np.tile(own, (200, 1)))
        for u, own in zip(rng.normal(size=(3, 200)).cumsum(axis=1), levels, strict=True)
    ]
    model = PrandtlIshlinskii(3)
    tree = search_steps.fitted(model, records)
    found = starting_trees(EFFECTS["auxiliary_input"], tree, records)
    edits = [edit for variant in found for one in variant for _, edit in one.edits]
    scheduled = {(e.by, e.low, e.high) for e in edits if isinstance(e, Schedule)}
    assert scheduled == {(1, 1.0, 3.0), (2, 10.0, 30.0)}


DRIVE = np.convolve(np.random.default_rng(0).normal(size=600), [0.3, 0.4, 0.3], "same")
FIRST, BEHIND = FirstOrderLagOperator(0.02), SecondOrderModeOperator(60.0, 0.3)


def in_series(*steps):
    """Return the tree of steps in series, fitted to a lag, a dead zone and a mode behind it."""
    dead_zone = DeadBandOperator(0.2)
    y = Series(("first", "dead_zone", "behind"), (FIRST, dead_zone, BEHIND)).run(DRIVE, 0.01)[0]
    records = [RecordData(DRIVE, y, 0.01)]
    model = Cascade(list(steps), dt=0.01) if len(steps) > 1 else steps[0][1]
    return records, search_steps.fitted(model, records)


def test_a_dead_zone_is_tried_at_every_joint_of_a_declared_series():
    records, tree = in_series(("first", FirstOrderLag()), ("behind", SecondOrderMode()))
    places = {
        candidate.names.index("dead_zone")
        for candidates in starting_trees(EFFECTS["dead_zone"], tree, records)
        for candidate in candidates
    }
    assert places == {0, 1, 2}


def test_a_stage_at_a_joint_moves_no_stage_that_follows_its_order():
    _, tree = in_series(("first", FirstOrderLag()), ("behind", SecondOrderMode()))
    edit = InsertAt("first", DeadBand(), DeadBandOperator(0.2))
    edited = tree.edited("dead_zone", edit)
    assert edited.names == ("first", "dead_zone", "behind")
    for order in (0, 10, 30, 50):
        behind = order >= FIRST.stage_order
        assert edited.position(order) == (3 if behind else 0)
    assert edited.without("dead_zone").names == tree.names


def test_one_transfer_function_is_divided_around_a_dead_zone():
    records, tree = in_series(("dynamics", TransferFunction(3, dt=0.01)))
    found = [
        candidate
        for candidates in starting_trees(EFFECTS["dead_zone"], tree, records)
        for candidate in candidates
        if isinstance(candidate.edits[-1][1], Divide)
    ]
    fits = [search_steps.refit(search_steps.candidate(own), records) for own in found]
    best = min(fits, key=lambda c: c.cost).structure
    assert best.names == ("transfer_function", "dead_zone", "transfer_function_2")
    first, dead_zone, behind = best.operators
    np.testing.assert_allclose(dead_zone.half_width, 0.2, rtol=1e-3)
    np.testing.assert_allclose(first.poles(), FIRST.poles(), rtol=1e-3)
    np.testing.assert_allclose(
        np.sort_complex(behind.poles()), np.sort_complex(BEHIND.poles()), rtol=1e-3
    )
    whole = best.without("dead_zone")
    assert whole.names == tree.names
    np.testing.assert_array_equal(whole.root.pack(), tree.root.pack())


def with_a_column(seed):
    """Return a drive and a column that moves within the record, in other times than the drive."""
    rng, t = np.random.default_rng(seed), np.arange(800) / 800
    column = np.interp(t, np.linspace(0.0, 1.0, 9), rng.normal(size=9))
    return np.sin(80.0 * t) + 0.7 * np.sin(131.0 * t), column


def least_cost(name, model, drive, column, y):
    """Return the sum of squares of a model and the best variant of an effect, as a candidate."""
    records = [RecordData(drive, y, 0.01, auxiliary=column[:, None])]
    tree = search_steps.fitted(model, records)
    found = [search_steps.refit(c, records) for c in search_steps.variants(name, tree, records)]
    return min(found, key=lambda candidate: candidate.cost)


@pytest.mark.parametrize(
    "model", [DynamicStiffness(fit_mass=False), CoulombFriction(fit_stiffness=True)]
)
def test_friction_that_grows_with_a_load_is_found(model):
    """Where no friction is declared, and where one is declared that does not follow the load."""
    drive, load = with_a_column(0)
    v = np.diff(drive, prepend=drive[0]) / 0.01
    y = (0.5 + 0.3 * np.abs(load)) * np.tanh(v / 0.4) + 0.2 * drive + 0.03 * v
    best = least_cost("friction", model, drive, load, y)
    assert best.cost < 1e-6 * y @ y
    scaled = best.structure.root
    while scaled.structure_of != "Modulated":
        scaled = scaled.stages[-1]
    at_zero = 1.0 - scaled.sensitivity * scaled.reference
    assert scaled.sensitivity / at_zero == pytest.approx(0.6, rel=1e-3)


@pytest.mark.parametrize("behind", [False, True])
def test_widths_that_follow_a_column_are_found(behind):
    """Also where dynamics come behind the plays."""
    drive, warm = with_a_column(1)
    plays, lag = PrandtlIshlinskiiOperator([0.0, 0.2, 0.5], [0.5, 0.4, 0.7]), FirstOrderLag()
    widths = Scaled(OnColumnOperator(plays, 0), 1, warm.mean(), 0.3, scales=("thresholds",))
    y, _ = widths.run(np.column_stack([drive, warm]), 0.01)
    model = PrandtlIshlinskii(thresholds=plays.thresholds)
    if behind:
        y, _ = FirstOrderLagOperator(0.05).run(y, 0.01)
        model = Cascade([("plays", model), ("lag", lag)])
    best = least_cost("auxiliary_input", model, drive, warm, y)
    assert best.cost < 1e-6 * y @ y
    estimator = best.structure.estimator
    scales = "plays__scales" if behind else "scales"
    assert estimator.get_params()[scales] == "thresholds"


def test_what_a_column_adds_starts_from_that_column():
    rng = np.random.default_rng(0)
    u, *columns = np.linalg.qr(rng.normal(size=(500, 3)))[0].T * 20.0  # none is seen in another
    y = u + 2.0 * columns[0] - 3.0 * columns[1]
    records = [RecordData(u, y, 0.1, auxiliary=np.stack(columns, axis=1))]
    tree = search_steps.tree_of(Gain(), GainOperator(1.0))
    found = starting_trees(EFFECTS["auxiliary_input"], tree, records)
    first, *_ = found  # it is added to the response
    edits = [edit for tree in first for _, edit in tree.edits]
    gains = {(edit.column, round(edit.operator.gain, 1)) for edit in edits}
    assert {(1, 2.0), (2, -3.0)} <= gains
