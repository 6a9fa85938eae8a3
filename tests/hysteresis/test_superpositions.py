"""Theorems of the weighted sums of plays, stops, relays and ramps; what is refused."""

import dataclasses
import pickle
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from skhyst.exceptions import ConvergenceWarning
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    CoulombFriction,
    Dahl,
    DahlOperator,
    Duhem,
    DuhemOperator,
    JilesAtherton,
    JilesAthertonOperator,
    KrasnoselskiiPokrovskii,
    KrasnoselskiiPokrovskiiOperator,
    MaxwellSlip,
    MaxwellSlipOperator,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    Preisach,
    PreisachOperator,
    RateDependentPrandtlIshlinskii,
    RateDependentPrandtlIshlinskiiOperator,
    TanhHysteresis,
    TanhHysteresisOperator,
)
from skhyst.operators import Series, check_operator
from skhyst.static import MonotoneDeadZoneOperator

ZONES = MonotoneDeadZoneOperator(np.array([0.4, 1.3, 2.0]), np.array([-5.0, 2.0, 9.0]), 1)
signals = arrays(float, st.integers(2, 40), elements=st.floats(-12, 12, width=32))


def make_plays(draw, **options):
    size = draw(st.integers(1, 12))
    gaps = draw(arrays(float, size, elements=st.floats(0.01, 5)))
    gaps[0] = draw(st.sampled_from([0.0, 0.7]))
    weights = draw(arrays(float, size, elements=st.floats(0, 10)))
    constants = draw(st.floats(-50, 50)), draw(st.floats(-5, 5))
    return PrandtlIshlinskiiOperator(np.cumsum(gaps), weights, *constants, **options)


def make_slips(draw):
    plays = make_plays(draw)
    return MaxwellSlipOperator(plays.thresholds + 0.1, plays.weights, draw(st.floats(0, 3)))


def make_grid(draw, kind):
    n = draw(st.integers(2, 8))
    levels = np.cumsum(draw(arrays(float, n, elements=st.floats(0.1, 5)))) - draw(st.floats(0, 20))
    weights = [draw(arrays(float, n * (n - 1) // 2, elements=st.floats(0, 10)))]
    if kind is PreisachOperator:
        size = draw(st.sampled_from([0, n - 1]))
        weights.append(draw(arrays(float, size, elements=st.floats(0, 10))))
    centers = [0.0, -np.inf, np.inf, levels[0], 0.5 * (levels[0] + levels[-1])]
    return kind(levels, *weights, draw(st.floats(-50, 50)), draw(st.sampled_from(centers)))


MAKERS = {
    "plays": make_plays,
    "stops": lambda draw: make_plays(draw, form="stop"),
    "slip elements": make_slips,
    "plays, then zones": lambda draw: Series(("p", "z"), (make_plays(draw), ZONES)),
    "relays": lambda draw: make_grid(draw, PreisachOperator),
    "ramps": lambda draw: make_grid(draw, KrasnoselskiiPokrovskiiOperator),
}


@st.composite
def operators(draw, kind):
    return MAKERS[kind](draw)


def every(*left_out):
    return pytest.mark.parametrize("kind", sorted(MAKERS.keys() - set(left_out)))


def run(operator, u, state=None):
    return operator.run(u, 1.0, state)[0]


def close(a, b, tolerance=1e-9):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


@every()
@settings(deadline=None, max_examples=40)
@given(st.data(), signals, st.integers(0, 2**32 - 1))
def test_rate_independence(kind, data, u, seed):
    """Repeated samples, and samples on the way from one to the next, change nothing."""
    operator = data.draw(operators(kind))
    time = np.arange(u.size, dtype=float)
    extra = np.random.default_rng(seed).random(2 * u.size) * (u.size - 1)
    warped = np.sort(np.concatenate((time, time, extra)))
    slow = run(operator, np.interp(warped, time, u))
    close(slow[np.searchsorted(warped, time)], run(operator, u), 1e-8)


@every()
@settings(deadline=None, max_examples=40)
@given(st.data(), signals, signals)
def test_wiping_out(kind, data, u, loop):
    """An excursion that stays within the range of later ones leaves no trace."""
    operator = data.draw(operators(kind))
    direct = np.concatenate((u, [30.0, -30.0, 30.0, -30.0], u))
    detour = np.concatenate((u, [30.0, -30.0], loop, [30.0, -30.0], u))
    close(run(operator, detour)[-u.size :], run(operator, direct)[-u.size :])


@every("ramps", "plays, then zones")
@settings(deadline=None, max_examples=40)
@given(st.data(), signals, signals, st.floats(-12, 0), st.floats(0.5, 12))
def test_congruency(kind, data, first, second, low, width):
    """Loops between the same two values have one shape, whatever came before."""
    operator = data.draw(operators(kind))
    loop = np.concatenate((np.linspace(low, low + width, 9), np.linspace(low + width, low, 9)))
    shapes = []
    for history in (first, second):
        y = run(operator, np.concatenate((history, loop, loop)))[-loop.size :]
        shapes.append(y - y[0])
    close(shapes[0], shapes[1])


@every()
@settings(deadline=None, max_examples=40)
@given(st.data(), signals)
def test_monotone_branches(kind, data, u):
    y = run(data.draw(operators(kind)), u)
    assert np.all(np.diff(y) * np.sign(np.diff(u)) >= -1e-10)


@every("stops", "slip elements")
@settings(deadline=None, max_examples=40)
@given(st.data(), signals)
def test_order_is_preserved(kind, data, u):
    operator = data.draw(operators(kind))
    assert np.all(run(operator, u + 0.5) >= run(operator, u) - 1e-10)


@every()
@settings(deadline=None, max_examples=30)
@given(st.data(), signals)
def test_dissipation(kind, data, u):
    """The work of a closed loop is not negative; that of stops and slips is done by a force."""
    operator = data.draw(operators(kind))
    path = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(np.append(u, u[0]))])
    y = run(operator, np.concatenate((path, path)))[-path.size :]
    force = kind in {"stops", "slip elements"}
    work = np.trapezoid(y, path) if force else np.trapezoid(path, y)
    assert work >= -1e-3 * np.ptp(path) * (np.ptp(y) + 1e-9)


# One operator of each kind


def example(kind, n=7, **options):
    weights = np.random.default_rng(0).random(n * (n - 1) // 2)
    levels = np.linspace(-1.5, 2.0, n)
    if kind == "relays":
        return PreisachOperator(levels, weights, weights[: n - 1], 0.7, 0.2, **options)
    if kind == "ramps":
        return KrasnoselskiiPokrovskiiOperator(levels, weights, 0.7, 0.2, **options)
    thresholds, weights = np.linspace(0.0, 1.5, n), weights[:n] + 0.1
    if kind == "rate-dependent plays":
        rates = 1e-3 * np.cos(np.arange(n))
        return RateDependentPrandtlIshlinskiiOperator(
            thresholds, weights, rates, 0.7, 0.011, **options
        )
    if kind == "slip elements":
        return MaxwellSlipOperator(thresholds + 0.1, weights, 0.1, 0.01, 0.7, **options)
    return PrandtlIshlinskiiOperator(thresholds, weights, 0.7, -0.2, form=kind[:4], **options)


EXAMPLES = pytest.mark.parametrize(
    "kind", ["plays", "stops", "relays", "ramps", "rate-dependent plays", "slip elements"]
)


@EXAMPLES
def test_long_records_are_cut_and_differentiated(kind):
    check_operator(example(kind), np.cumsum(np.random.default_rng(6).normal(size=500)) * 0.3, 0.05)


@pytest.mark.parametrize("kind", ["plays", "stops", "relays", "ramps"])
@pytest.mark.parametrize("drive_unit", [1e-150, 1e-9, 1e9, 1e150])
@pytest.mark.parametrize("response_unit", [1e-100, 1e100])
def test_unit_equivariance(kind, drive_unit, response_unit):
    operator, u = example(kind), np.random.default_rng(7).normal(size=300)
    drives, responses = (
        ("thresholds", "drive_offset", "levels", "center"),
        ("intercept", "reversible"),
    )
    units = dict.fromkeys(drives, drive_unit) | dict.fromkeys(responses, response_unit)
    units["weights"] = response_unit / (1.0 if hasattr(operator, "levels") else drive_unit)
    scaled = {name: getattr(operator, name) * units[name] for name in vars(operator).keys() & units}
    other = dataclasses.replace(operator, **scaled)
    y = run(operator, u)
    found = run(other, u * drive_unit)
    if hasattr(operator, "basis"):
        close(found / response_unit, y, 1e-10)
        close(other.basis(u * drive_unit)[0], operator.basis(u)[0], 1e-10)
    else:
        close(found / response_unit, y, 1e-12 * np.ptp(y))
        close(run(other.inverse(), y * response_unit) / drive_unit, u, 3e-12)


@EXAMPLES
def test_weights_have_a_bound_unless_they_are_free(kind):
    bounded, free = example(kind), example(kind, non_negative=False)
    assert bounded.parameter_specs()["weights"].lower == 0.0
    assert free.parameter_specs()["weights"].lower == -np.inf
    assert list(bounded.parameter_specs()) == list(free.parameter_specs())


@EXAMPLES
def test_fields_are_copies_that_cannot_be_changed(kind):
    operator = example(kind)
    weights = np.array(operator.weights)
    again = dataclasses.replace(operator, weights=weights)
    weights[:] = 9.0
    np.testing.assert_array_equal(again.weights, operator.weights)
    with pytest.raises(ValueError, match="read-only"):
        operator.weights[0] = 3.0


@EXAMPLES
def test_no_samples(kind):
    operator = example(kind)
    y, state = operator.run([], 1.0, operator.init(0.4))
    assert operator.run([], 1.0)[0].shape == y.shape == (0,)
    assert run(operator, [0.4, 1.0], state) == pytest.approx(run(operator, [0.4, 1.0]))
    y, dy = operator.sensitivities(np.empty(0), np.empty((0, 2)), 1.0)
    assert dy.shape == (0, 2 + operator.n_parameters)


@pytest.mark.parametrize("kind", ["plays", "relays"])
def test_a_wiped_loop_is_forgotten_by_the_state(kind):
    operator = example(kind)
    _, short = operator.run([0.2, 1.4, -1.3, 1.1], 1.0)
    _, long = operator.run([0.2, 1.4, -1.3, 0.8, -1.0, 1.0, 1.1], 1.0)
    np.testing.assert_array_equal(short[0], long[0])
    assert short[1] == long[1]


@pytest.mark.parametrize("kind", ["relays", "ramps"])
@settings(deadline=None, max_examples=60)
@given(st.data(), signals)
def test_response_is_the_weighted_sum_of_the_cells(kind, data, u):
    operator = data.draw(operators(kind))
    rows, state = operator.basis(u)
    y, end = operator.run(u, 1.0)
    close(rows @ operator.pack(), y)
    assert np.abs(rows).max() <= 1.0 + 1e-12
    after = np.array([0.3, -0.2])
    np.testing.assert_array_equal(run(operator, after, state), run(operator, after, end))


@pytest.mark.parametrize("kind", ["relays", "ramps"])
@settings(deadline=None, max_examples=30)
@given(st.data(), signals)
def test_saturates_outside_the_levels(kind, data, u):
    operator = data.draw(operators(kind))
    low, high = operator.levels[[0, -1]]
    np.testing.assert_array_equal(run(operator, u), run(operator, np.clip(u, low, high)))


@pytest.mark.parametrize("kind", [PreisachOperator, KrasnoselskiiPokrovskiiOperator])
def test_drive_of_one_sign_starts_all_down(kind):
    """With the centre at the lowest level, the first loading is the rising major branch."""
    operator = kind(np.linspace(0, 150, 6), np.arange(15.0))
    up = np.linspace(0, 150, 40)
    y = run(operator, np.concatenate((up, [0.0], up)))
    assert y[0] == -operator.weights.sum()
    assert y[39] == pytest.approx(operator.weights.sum(), rel=1e-14)
    close(y[:40], y[41:], 1e-12)
    for center in (-np.inf, -20.0):
        close(run(dataclasses.replace(operator, center=center), up), y[:40], 1e-12)


@pytest.mark.parametrize(
    "operator",
    [
        PrandtlIshlinskiiOperator([0.0, 0.3, 0.9], [1.0, 0.5, 0.3]),
        RateDependentPrandtlIshlinskiiOperator([0.0, 0.3], [1.0, 0.5], [0.1, 0.2], dilation=4e-3),
        PreisachOperator(np.linspace(-1, 1, 4), [0.5, 0.3, 0.2, 0.9, 0.3, 0.5], [0.1, 0.4, 0.1]),
        KrasnoselskiiPokrovskiiOperator(np.linspace(-1, 1, 4), [0.5, 0.3, 0.2, 0.9, 0.3, 0.5]),
        *(DahlOperator(0.8, 1.3, damping=0.1, exponent=n) for n in (0.5, 1.0, 2.0)),
        TanhHysteresisOperator(k0=0.12, alpha=-4e-5, beta=0.4, gamma=0.3),
    ],
)
def test_odd_symmetry(operator):
    """Of all plays and of friction; of relays and ramps where the density is symmetric."""
    u = np.random.default_rng(3).normal(size=500)
    superposed = hasattr(operator, "weights")
    close(run(operator, -u), -run(operator, u), 1e-12 if superposed else 1e-14)
    assert run(operator, [0.0])[0] == pytest.approx(0.0, abs=1e-14)


# ------------------------------------------------------------------------------------- models

R, ZONED = np.array([0.0, 0.4, 0.9, 1.6]), [-2.0, -1.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("model", "tolerance"),
    [
        (PrandtlIshlinskii(thresholds=R), 1e-12),
        (PrandtlIshlinskii(thresholds=R, form="stop"), 1e-11),
        (ModifiedPrandtlIshlinskii(thresholds=R, dead_zone_thresholds=ZONED), 1e-12),
        (RateDependentPrandtlIshlinskii(thresholds=R, dt=1e-3), 1e-3),
        (RateDependentPrandtlIshlinskii(thresholds=R, variant="slope", dt=1e-3), 1e-3),
    ],
)
def test_inverse_and_attributes_after_pickling(model, tolerance):
    time = 1e-3 * np.arange(2500)
    u = 4.0 * np.sin(2 * np.pi * time * (1.0 + 1.5 * time)) * (0.5 + 0.5 * np.cos(0.7 * time) ** 2)
    rates = 1e-3 * np.array([3.0, -2.0, 1.0, 2.0]) * (getattr(model, "variant", "") == "slope")
    weights = (
        [1.0, -0.3, -0.2, -0.1] if getattr(model, "form", "") == "stop" else [1, 0.5, 0.4, 0.3]
    )
    y, _ = RateDependentPrandtlIshlinskiiOperator(R, weights, rates, 0.3, 4e-3).run(u, 1e-3)
    model = pickle.loads(pickle.dumps(model.fit(u[:, None], y)))
    plays = model.operator_.stages[0] if hasattr(model.operator_, "stages") else model.operator_
    for name in ("thresholds", "weights", "rate_weights", "dilation", "intercept"):
        if hasattr(plays, name):
            np.testing.assert_array_equal(getattr(model, f"{name}_"), getattr(plays, name))
    wanted = model.predict(u[:, None])
    again = model.predict(model.inverse_predict(wanted[:, None])[:, None])
    assert np.std(again - wanted) < tolerance * np.ptp(wanted)
    if tolerance < 1e-6:  # the inverse is exact
        close(model.inverse_predict(wanted[:, None]), u, tolerance * np.ptp(u))
        again = model.predict(model.inverse_predict(wanted[::-1, None])[:, None])
        close(again, wanted[::-1], tolerance * np.ptp(wanted))


# ----------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "model",
    [
        BoucWen("fit"),
        CoulombFriction(fit_damping=False, fit_intercept=False),
        JilesAtherton(fit_intercept=False),
        KrasnoselskiiPokrovskii(4),
        Preisach(4),
        TanhHysteresis(),
    ],
)
def test_parameters_that_a_drive_at_rest_does_not_show_are_named(model):
    X = np.full((20, 1), 3.0)
    with (
        pytest.warns(ConvergenceWarning, match="do not determine"),
        pytest.warns(ConvergenceWarning, match="The drive does not move"),
    ):
        model.fit(X, np.full(20, 5.0))
    assert model.identifiability_["undetermined"]
    assert np.isfinite(model.predict(np.linspace(-1.0, 3.0, 20)[:, None])).all()
    if isinstance(model, (KrasnoselskiiPokrovskii, Preisach)):
        np.testing.assert_allclose(model.predict(X), 5.0)


VALID = {
    BoucWenOperator: {"gain": 1.0, "alpha": 1.0, "limit": 1.0},
    DuhemOperator: {"alpha": 1.0, "curve": [1.0], "slope": [1.0]},
    JilesAthertonOperator: {"saturation": 1.0, "shape": 1.0, "pinning": 1.3}
    | {"coupling": 0.6, "reversibility": 0.2},
    KrasnoselskiiPokrovskiiOperator: {"levels": [0.0, 1.0, 2.0], "weights": np.ones(3)},
    MaxwellSlipOperator: {"thresholds": [0.5, 1.0], "weights": [1.0, 1.0]},
    PrandtlIshlinskiiOperator: {"thresholds": [0.0, 1.0], "weights": [1.0, 1.0]},
    PreisachOperator: {"levels": [0.0, 1.0, 2.0], "weights": np.ones(3)},
    RateDependentPrandtlIshlinskiiOperator: {"thresholds": [0.0, 1.0], "weights": [1.0, 1.0]},
}
PLAYS = {
    "thresholds": ([], [-1.0, 0.0], [1.0, 0.5], [0.0, np.nan], [[0.0, 1.0]]),
    "weights": ([1.0],),
}
GRID = {"levels": ([0.0], [0.0, 0.0, 1.0]), "weights": ([1.0, 2.0],)}
LEVELS = {"n_levels": (1,), "smoothness": (-1.0,), "levels": ("even",), "center": ("0",)}
WRONG = {
    BoucWenOperator: {"limit": (0.0, np.nan), "ratio": (-0.1,)}
    | {"exponent": (0.0,), "asymmetry": (1.0,)},
    DuhemOperator: {"curve": ([1.0, 2.0],)},
    JilesAthertonOperator: dict.fromkeys(("shape", "pinning", "max_step"), (0.0, -1.0))
    | {"coupling": (1.0,), "reversibility": (1.1,)},
    KrasnoselskiiPokrovskiiOperator: GRID,
    MaxwellSlipOperator: PLAYS | {"thresholds": (*PLAYS["thresholds"], [0.0, 1.0])},
    PrandtlIshlinskiiOperator: PLAYS | {"form": ("stops",)},
    PreisachOperator: GRID | {"reversible": ([1.0],)},
    RateDependentPrandtlIshlinskiiOperator: PLAYS
    | {"rate_weights": ([1.0],), "dilation": (-0.1,), "stretch": (-0.1,)}
    | {"smoothing": ("rate",), "time_constant": (0.1,)},
    BoucWen: {"exponent": (0.1, "free"), "asymmetry": (2,)},
    Dahl: {"exponent": (0.0, -1.0, "1")},
    Duhem: {"degree": (0, 10, 1.5)},
    JilesAtherton: {"gain": ("other",)},
    KrasnoselskiiPokrovskii: LEVELS,
    MaxwellSlip: {"thresholds": ([0.0, 1.0], [2.0, 1.0])},
    ModifiedPrandtlIshlinskii: {"dead_zone_thresholds": ([1.0, 0.0],), "n_dead_zones": (0,)},
    PrandtlIshlinskii: {"form": ("spring",)},
    Preisach: LEVELS | {"reversible": (2,)},
    RateDependentPrandtlIshlinskii: {"variant": ("speed",), "smoothing": ("threshold",)},
}
CASES = [(kind, *case) for kind, fields in WRONG.items() for case in fields.items()]
CASES = [(kind, name, value) for kind, name, values in CASES for value in values]


@pytest.mark.parametrize(("kind", "name", "value"), CASES)
def test_wrong_parameters(kind, name, value):
    def refuse():
        made = kind(**VALID.get(kind, {}) | {name: value})
        made.fit(np.arange(9.0)[:, None], np.zeros(9))

    with pytest.raises(ValueError, match=f"The '{name}' .*of {kind.__name__}"):
        refuse()


@pytest.mark.parametrize(("curve", "slope"), [([], []), ([[1.0]], [[1.0]]), np.ones((2, 10))])
def test_wrong_coefficients(curve, slope):
    with pytest.raises(ValueError, match="The 'curve' and 'slope' parameters of DuhemOperator"):
        DuhemOperator(1.0, curve, slope)
