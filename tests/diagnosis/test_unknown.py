"""A term without a name: it is found where it is, shows what it is, and is not claimed of noise."""

import numpy as np
import pytest
import search_steps
from scipy.signal import lfilter
from sklearn.linear_model import Ridge

from skhyst import diagnosis
from skhyst.compose import Cascade
from skhyst.control import InverseCompensator
from skhyst.diagnosis import EffectSearchCV, LawAt, next_experiment, unregister_effect
from skhyst.diagnosis._starts import Scene
from skhyst.diagnosis._unknown import _at_other_starts, _sites, _started, _started_again
from skhyst.exceptions import ExtrapolationWarning
from skhyst.hysteresis import (
    BoucWen,
    BoucWenOperator,
    PrandtlIshlinskii,
    PrandtlIshlinskiiOperator,
    RestoringForceOperator,
)
from skhyst.linear import (
    FirstOrderLag,
    FirstOrderLagOperator,
    SecondOrderMode,
    SecondOrderModeOperator,
)
from skhyst.operators import FeedbackOperator
from skhyst.optimize import RecordData
from skhyst.persistence import from_json, to_json
from skhyst.static import UnknownTermOperator

N, DT, NOISE = 1500, 1e-3, 0.02
MODE, DECLARED = SecondOrderModeOperator(100.0, 0.3), SecondOrderMode(dt=DT)


def smooth_noise(seed):
    u = np.random.default_rng(seed).normal(size=N)
    for pole in (0.9, 0.8):
        u = lfilter([1.0], [1.0, -pole], u)
    return u / u.std()


U = smooth_noise(1)
NOTCH = 0.3 * np.exp(-(((U - 0.5) / 0.3) ** 2))
RATE = np.diff(U, prepend=U[0]) / DT
DAMPING = 3e-6 * np.abs(RATE) * RATE


def search(y, X=U[:, None], declared=DECLARED, **params):
    params = {"max_effects": 0, "cv": 3, "unknown": True, "random_state": 0} | params
    return EffectSearchCV(declared, **params).fit(X, y)


def noise(seed):
    return NOISE * np.random.default_rng(seed).normal(size=N)


@pytest.fixture(scope="module")
def notched():
    return search(MODE.run(U + NOTCH, DT)[0] + noise(2))


def test_place_and_curve(notched):
    found = notched.unknown_
    assert notched.verdict_ == "unexplained"
    assert notched.effects_ == []
    assert (found.place, found.argument) == ("drive", "drive")
    assert not found.structure_left
    assert found.second is None
    # a prediction at the floor, where the declared model's was more than twice that
    assert found.error_before == notched.error_after_ > 2.5 * NOISE
    assert found.error_after < 1.15 * NOISE
    # up to a straight line, which the mode's gain and intercept have
    v = found.curve["argument"].to_numpy()
    truth = 0.3 * np.exp(-(((v - 0.5) / 0.3) ** 2))
    line = np.stack([v, np.ones_like(v)], axis=1)
    left = truth - found.curve["value"]
    left -= line @ np.linalg.lstsq(line, left, rcond=None)[0]
    assert np.sqrt(np.mean(left**2)) < 0.015
    assert np.all(found.curve["low"] < found.curve["high"])
    assert found.curve["density"].sum() == pytest.approx(0.99, abs=0.006)


def test_the_parameters_stay(notched):
    params = notched.unknown_.estimator.params_
    std = notched.unknown_.estimator.params_std_
    name = "second_order_mode__natural_frequency"
    assert abs(params[name] - 100.0) < 4.0 * std[name]


def test_the_model_with_the_term_is_a_model(notched):
    model = notched.unknown_.estimator
    fresh = smooth_noise(5) * 0.5
    truth, _ = MODE.run(fresh + 0.3 * np.exp(-(((fresh - 0.5) / 0.3) ** 2)), DT)
    predicted = model.predict(fresh[:, None])
    assert np.sqrt(np.mean((predicted - truth) ** 2)) < 0.5 * NOISE
    stepped = model.stepper(u0=fresh[0]).run(fresh)
    np.testing.assert_allclose(stepped, predicted, atol=1e-12)
    np.testing.assert_array_equal(from_json(to_json(model)).predict(fresh[:, None]), predicted)
    inverse = InverseCompensator(model).fit(U[:, None], truth)
    reference = 0.3 * np.hanning(N) * predicted
    again = model.predict(inverse.predict(reference[:, None]).reshape(-1, 1))
    np.testing.assert_allclose(again, reference, atol=1e-6)
    with pytest.warns(ExtrapolationWarning, match="fitted to drives from"):
        model.predict(2.0 * U[:, None])


@pytest.mark.slow
def test_a_force_of_the_velocity_is_found_in_the_equation_of_motion():
    # of p = q' / w the force is 0.1 p^3 / 0.5^2, and the response 2 q
    plant = RestoringForceOperator(100.0, 0.2, [], [0.1], 0.0, 1.0, gain=2.0, scale=0.5)
    searched = search(plant.run(U, DT)[0] + noise(9))
    found = searched.unknown_
    assert (found.place, found.argument) == ("motion of second_order_mode", "velocity")
    assert found.share > 0.99
    assert str(found).startswith("a force in the equation of motion of second_order_mode that")
    cube = found.laws.set_index("law").loc["cube"]
    assert found.to_dict()["laws"][0]["formula"] == "c v^3"
    assert "odd" in found.shape
    expected = 0.1 / 0.5**2 / (2.0 * 100.0) ** 3
    assert abs(cube["c"] - expected) < 4.0 * cube["c_std"] < 0.2 * expected
    # registered, it is an effect as any other
    exec(found.code, vars(diagnosis).copy())
    records = searched._records
    (named,) = search_steps.variants("cube_of_velocity", searched._structure, records)
    unregister_effect("cube_of_velocity")
    assert search_steps.refit(named, records).cost < 1.1 * N * NOISE**2


def test_a_term_that_has_led_the_mode_away_starts_again():
    y = MODE.run(U, DT)[0] + 3.0 * DAMPING + noise(3)
    records = [RecordData(U[:500], y[:500], DT)]
    # beyond the sampling, where the response hardly depends on the frequency
    scene = Scene(search_steps.tree_of(DECLARED, SecondOrderModeOperator(2900.0, 0.01)), records)
    sites = {(site.place, site.argument): site for site in _sites(scene)}
    site = sites["response", "rate of the drive"]
    (start,) = _started(site, records)
    found = search_steps.refit(start, records)
    assert found.cost > 20.0 * 500 * NOISE**2
    _, again = _started_again(site, found, _at_other_starts(scene), records)
    assert search_steps.refit(again, records).cost < 1.1 * 500 * NOISE**2


@pytest.mark.slow
def test_a_sum_of_two_functions_of_different_signals():
    searched = search(MODE.run(U + 1.5 * NOTCH, DT)[0] + 0.3 * DAMPING + noise(3))
    first = searched.unknown_
    second = first.second
    places = [(own.place, own.argument) for own in (first, second)]
    assert places == [("drive", "drive"), ("response", "rate of the drive")]
    assert second.second is None
    assert "quadratic with sign" in set(second.laws["law"])
    assert not second.structure_left
    assert second.error_before == first.error_after > 1.15 * NOISE > second.error_after
    assert "; in addition, a term" in str(first)
    report = searched.report()
    assert report.unknown["second"]["argument"] == second.argument
    assert "The second function" in report.to_html()
    left = sum(searched.explained_[name] for name in ("black box", "nothing"))
    scored = searched.response_[np.isfinite(searched.residual_before_)]
    assert left == pytest.approx(second.error_after**2 / np.var(scored))


def test_the_power_of_the_response_is_shared_out(notched):
    own, found, power = notched.explained_, notched.unknown_, np.var(notched.response_)
    assert sum(own.values()) == pytest.approx(1.0)
    assert own["declared model"] == pytest.approx(1.0 - notched.error_before_**2 / power, abs=1e-3)
    left = 1.0 - own["declared model"]
    assert own["unknown term"] == pytest.approx(found.share * left)
    assert own["effects"] == own["black box"] == 0.0
    # the residual is the noise
    assert own["nothing"] == pytest.approx(NOISE**2 / power, rel=0.3)


@pytest.mark.slow
def test_a_force_that_is_nonlinear_in_displacement_and_velocity():
    # splines of k^2 |l| l are next to x^2 |v| v
    c, knots = 1e-4, np.arange(-31.0, 32.0)
    term = UnknownTermOperator(
        np.array([c]),
        np.outer(np.square(0.3 * knots), 30.0**2 * np.abs(knots) * knots).reshape(-1, 1),
        *(-9.0, 9.0),
        second="rate",
        second_low=-900.0,
        second_high=900.0,
        passed=1.0,
    )
    own = {"n_substeps": 8, "argument": "both"}
    plant = FeedbackOperator(("linear", "curve"), (MODE, term), **own)
    u = U[:1000]
    searched = search(plant.run(u, DT)[0] + noise(3)[:1000], u[:, None])
    found = searched.unknown_
    told = found.place, found.argument, found.second_argument
    assert told == ("motion of second_order_mode", "displacement", "velocity")
    assert found.error_after < 1.3 * NOISE < found.error_before
    fresh = 0.7 * smooth_noise(5)
    error = found.estimator.predict(fresh[:, None]) - plant.run(fresh, DT)[0]
    assert np.sqrt(np.mean(np.square(error))) < 0.5 * NOISE
    first = found.laws.iloc[0]
    assert first["formula"] == "c v^2 |w| w"
    assert first["error"] < 1.15 * NOISE
    assert abs(first["c"] - c) < 0.15 * c
    x, y, values, _ = found.picture().surface
    assert values.shape == (len(y), len(x))
    assert "beyond a sum of two functions" in searched.report().to_html()
    exec(found.code, vars(diagnosis).copy())
    name = "square_times_quadratic_with_sign_of_displacement_and_velocity"
    (named,) = search_steps.variants(name, searched._structure, searched._records)
    unregister_effect(name)
    assert search_steps.refit(named, searched._records).cost < 1.25 * len(u) * NOISE**2


@pytest.mark.slow
def test_a_gain_that_depends_on_a_rate():
    rate = np.diff(U[:1000], prepend=U[0]) / DT
    gain = 0.3 * np.tanh(rate / 150.0)
    searched = search(MODE.run(U[:1000] * (1.0 + gain), DT)[0] + noise(3)[:1000], U[:1000, None])
    found = searched.unknown_
    assert (found.place, found.argument) == ("gain of the drive", "rate of the drive")
    assert str(found).startswith("a change of the gain of the drive that depends on the rate")
    assert found.error_after < 1.1 * NOISE < found.error_before
    v, value, low, high, _ = found.curve.to_numpy().T
    left = 0.3 * np.tanh(v / 150.0) - value
    assert np.mean(np.abs(left - left.mean()) < 0.5 * (high - low)) > 0.9
    law = found.laws.set_index("law").loc["smooth saturation"]
    assert abs(law["c"] - 0.3) < 4.0 * law["c_std"] < 0.15
    exec(found.code, vars(diagnosis).copy())
    name = found.code.split("'")[1]
    (named,) = search_steps.variants(name, searched._structure, searched._records)
    unregister_effect(name)
    assert search_steps.refit(named, searched._records).cost < 1.1 * 1000 * NOISE**2


@pytest.mark.slow
def test_of_the_memory_of_a_hysteresis():
    loop = BoucWenOperator(gain=0.6, alpha=1.0, limit=0.8)
    u = U[:800]
    z = loop.elastic_and_memory()[1].run(u, DT)[0]
    y = 0.6 * u + z + 0.4 * np.exp(-np.square((z - 0.3) / 0.2)) + noise(3)[:800]
    found = search(y, u[:, None], BoucWen(dt=DT)).unknown_
    assert (found.place, found.argument) == ("response", "memory of bouc_wen")
    assert found.error_after < 1.1 * NOISE < found.error_before
    model = found.estimator
    np.testing.assert_array_equal(model.stepper(u0=u[0]).run(u), model.predict(u[:, None]))


@pytest.mark.slow
def test_of_the_drive_behind_the_stage_that_it_moves():
    u = U[:1000]
    y = MODE.run(u, DT)[0] + 0.1 * np.abs(u) * u
    y = FirstOrderLagOperator(0.004).run(y, DT)[0] + noise(3)[:1000]
    declared = Cascade([("mode", SecondOrderMode()), ("lag", FirstOrderLag())], dt=DT)
    found = search(y, u[:, None], declared).unknown_
    assert (found.place, found.argument) == ("behind mode", "drive")
    assert found.error_after < 1.15 * NOISE < found.error_before
    assert abs(found.estimator.params_["lag__time_constant"] - 0.004) < 5e-4


@pytest.mark.slow
def test_what_a_black_box_predicts_beside_the_term_is_told():
    # a product of two signals, which no function of one of them is
    y = MODE.run(U + NOTCH, DT)[0] + 0.12 * np.roll(U, 40) * np.tanh(RATE / 60.0) + noise(2)
    searched = search(y)
    found, own = searched.unknown_, searched.explained_
    assert found.structure_left
    assert NOISE < found.noise_ceiling < 0.9 * found.error_after
    assert own["black box"] > 0.1 * (1.0 - own["declared model"])
    assert own["nothing"] < found.error_after**2 / np.var(y)
    assert "black box" in searched.report().to_text().split("in power: ")[1]


@pytest.mark.slow
def test_a_force_in_the_motion_of_a_mode_behind_a_hysteresis():
    mode = RestoringForceOperator(100.0, 0.2, [], [4e-4], 0.0, 1.0, scale=0.5)
    plays = PrandtlIshlinskiiOperator([0.0, 0.3, 0.8], [1.0, 0.4, 0.3])
    y = mode.run(plays.run(U, DT)[0], DT)[0]
    hysteresis = PrandtlIshlinskii(thresholds=plays.thresholds)
    declared = Cascade([("plays", hysteresis), ("mode", SecondOrderMode())], dt=DT)
    found = search(y + noise(9), declared=declared).unknown_
    assert (found.place, found.argument) == ("motion of mode", "velocity")
    assert found.error_after < 1.2 * NOISE < found.error_before
    assert "odd" in found.shape


def test_report(notched):
    report = notched.report()
    assert report.unknown["place"] == "drive"
    assert len(report.unknown["curve"]["low"]) == len(notched.unknown_.curve)
    assert "unexplained: a term added to the drive that depends on" in report.to_text()
    assert "Unexplained: a term added to the drive that depends on" in report.to_markdown()
    assert "simultaneous 95 % band" in report.to_html()


def test_of_noise_there_is_none():
    coloured = lfilter([1.0], [1.0, -0.8], noise(10))
    assert search(MODE.run(U, DT)[0] + coloured).unknown_ is None


@pytest.mark.slow
def test_a_record_that_begins_under_way():
    y = MODE.run(U + NOTCH, DT)[0] + noise(2)
    declared = SecondOrderMode(dt=DT, initial_state="estimate")
    found = search(y[700:], U[700:, None], declared).unknown_
    assert (found.place, found.argument) == ("drive", "drive")
    assert found.error_after < 1.2 * NOISE < found.error_before


@pytest.mark.slow
def test_the_drive_that_tells_places_apart():
    # a drive so slow that a small play of it is next to it
    u = lfilter([1.0], np.convolve([1.0, -0.99], [1.0, -0.99]), smooth_noise(1))
    u = u / u.std()
    curve = 0.3 * np.exp(-(((u - 0.5) / 0.3) ** 2))
    y = MODE.run(u + curve, DT)[0] + noise(2)
    searched = search(y, u[:, None])
    found = searched.unknown_
    places = [f"{found.place}: a function of the {found.argument}", *found.ambiguous_with]
    assert len(places) > 1
    experiment = next_experiment(searched, (-3.0, 3.0))
    assert "it distinguishes " in experiment.reason
    assert places[0] in experiment.reason
    assert places[1] in experiment.reason


def test_a_law_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="'law' parameter of LawAt must be one of 'proportional'"):
        LawAt("cubic", "motion", "velocity")


def test_a_named_effect_comes_first():
    y = np.minimum(MODE.run(U, DT)[0], 0.8) + noise(4)
    found = search(y, effects=["output_saturation"], max_effects=1)
    assert found.effects_ == ["output_saturation"]
    assert found.unknown_ is None


@pytest.mark.slow
def test_of_a_further_column():
    u, column = U[:1000], smooth_noise(7)[:1000]  # so fast that the mode does not follow
    y = MODE.run(u + 0.4 * np.abs(column), DT)[0] + noise(5)[:1000]
    found = search(y, np.stack([u, column], axis=1)).unknown_
    assert (found.place, found.argument) == ("drive", "column 1 of X")
    assert "absolute value" in set(found.laws["law"])


def test_a_black_box_has_no_places():
    y = np.tanh(2.0 * U) + noise(6)
    found = EffectSearchCV(Ridge(), max_effects=0, cv=3, unknown=True).fit(U[:, None], y)
    assert found.unknown_ is None


def test_it_is_not_sought_unasked():
    u = U[:700]
    found = search((MODE.run(U, DT)[0] + DAMPING + noise(3))[:700], u[:, None], unknown=False)
    assert found.verdict_ == "unexplained"
    assert found.unknown_ is None
