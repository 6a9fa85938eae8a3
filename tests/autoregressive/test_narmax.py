"""NARMAX models: the terms, their coefficients and errors, the runs."""

from itertools import combinations

import narmax_structure as study
import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from skhyst.autoregressive import NARMAXRegressor
from skhyst.autoregressive._polynomial import candidate_terms
from skhyst.autoregressive._problems import FreeRunProblem, InnovationProblem
from skhyst.autoregressive._runs import Lags, Start
from skhyst.autoregressive._selection import Search, SelectionCriterion, condense, error_reduction
from skhyst.preprocessing import PlayOperators

LAGS = {"input_lags": (1, 2), "output_lags": (1, 2)}


def quadratic(n_samples=600, seed=0, **noise):
    return study.simulate(study.QUADRATIC, n_samples, np.random.default_rng(seed), **noise)


def coefficients(model):
    return dict(zip(model.terms_["term"], model.coef_, strict=True))


# -------------------------------------------------------------------------------------- the search


def test_condensed_data_give_the_same_regression():
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(9000, 6)), rng.normal(size=9000)
    factor = condense([np.column_stack([A, b])[:5000], np.column_stack([A, b])[5000:]])
    expected = np.linalg.lstsq(A, b, rcond=None)
    np.testing.assert_allclose(
        np.linalg.solve(factor[:6, :6], factor[:6, 6]), expected[0], rtol=1e-10
    )
    np.testing.assert_allclose(factor[6, 6] ** 2, expected[1][0])


@pytest.mark.parametrize("seed", range(4))
def test_search_finds_the_best_of_all_subsets(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(200, 9)) @ (np.eye(9) + 0.4 * rng.normal(size=(9, 9)))
    y = A[:, [1, 4, 7]] @ [1.0, -0.7, 0.4] + 0.3 * rng.normal(size=200)
    search = Search([condense([np.column_stack([A, y])])], SelectionCriterion("bic", 200, 9, y @ y))

    def bic(subset):
        rest = y - A[:, subset] @ np.linalg.lstsq(A[:, subset], y, rcond=None)[0]
        return 200 * np.log(rest @ rest / 200) + len(subset) * np.log(200)

    subsets = [list(s) for size in range(1, 6) for s in combinations(range(9), size)]
    best = min(subsets, key=bic)
    assert sorted(search.best()) == best
    np.testing.assert_allclose(search.value(best), bic(best))
    of_two = min((s for s in subsets if len(s) == 2), key=bic)
    assert sorted(search.best(2)) == of_two


def test_error_reduction_ratios_add_up():
    model = NARMAXRegressor(2, n_terms=None, **LAGS).fit(*quadratic(noise=0.1))
    X, y = quadratic(noise=0.1)
    residual = (y - model.predict_one_step(X, y))[2:]
    explained = 1.0 - residual @ residual / (y[2:] @ y[2:])
    np.testing.assert_allclose(model.error_reduction_ratio_.sum(), explained, rtol=1e-9)
    rng = np.random.default_rng(0)
    q = np.linalg.qr(rng.normal(size=(50, 3)))[0]
    order, parts = error_reduction(condense([np.column_stack([q, q @ [1.0, 3.0, 2.0]])]), [0, 1, 2])
    assert order == [1, 2, 0]
    np.testing.assert_allclose(parts, np.array([9.0, 4.0, 1.0]) / 14.0)


def test_candidates_are_all_products():
    table = candidate_terms([(range(3), 2), (range(3, 4), 1)], 2, True)
    products = {tuple(sorted(row[row >= 0])) for row in table}
    pairs = {(i, j) for i in range(3) for j in range(i, 3)}
    assert products == {(), (0,), (1,), (2,), (3,), *pairs}
    assert len(products) == len(table)


# ------------------------------------------------------------------------------- terms, structure


def test_terms_of_known_systems():
    rates = study.structure(1000, 1)
    assert sum(rates.values()) >= 9


@pytest.mark.parametrize("criterion", ["ebic", "bic", "aic", "aicc", "cv"])
def test_criteria_keep_what_matters(criterion):
    model = NARMAXRegressor(2, criterion=criterion, **LAGS).fit(*quadratic(noise=0.1))
    assert set(study.spelled(study.QUADRATIC)) <= set(model.terms_["term"])
    assert len(model.coef_) <= {"ebic": 5, "bic": 6, "cv": 8}.get(criterion, 10)


def test_without_noise_the_system_itself():
    model = NARMAXRegressor(3, **LAGS).fit(*quadratic(200))
    truth = study.spelled(study.QUADRATIC)
    found = coefficients(model)
    assert set(found) == set(truth)
    for name, value in truth.items():
        assert found[name] == pytest.approx(value, rel=1e-9)
    X, y = quadratic(300, seed=1)
    np.testing.assert_allclose(model.predict(X), y, atol=1e-9)


def test_number_of_terms():
    X, y = quadratic(noise=0.1)
    for wanted in (1, 4):
        assert len(NARMAXRegressor(2, n_terms=wanted, **LAGS).fit(X, y).coef_) == wanted
    model = NARMAXRegressor(2, n_terms=None, **LAGS).fit(X, y)
    assert len(model.coef_) == model.n_candidates_ == 15
    doubled = np.column_stack([X, 2.0 * X])
    twice = NARMAXRegressor(1, n_terms=None, **LAGS).fit(doubled, y)
    assert len(twice.coef_) == 5
    assert twice.n_candidates_ == 7


@pytest.mark.parametrize("options", [{}, {"objective": "simulation"}, {"noise_lags": (1,)}])
@pytest.mark.parametrize(("drive", "response"), [(1e-9, 1e3), (-3e5, -7e-12), (1e40, 1e-40)])
def test_units(options, drive, response):
    X, y = quadratic(noise=0.05, sensor=0.02)
    plain = NARMAXRegressor(2, **LAGS, **options).fit(X, y)
    other = NARMAXRegressor(2, **LAGS, **options).fit(drive * X, response * y)
    np.testing.assert_array_equal(other.term_factors_, plain.term_factors_)
    of_input = np.sum((plain.term_factors_ >= 0) & (plain.term_factors_ < 2), axis=1)
    of_output = np.sum((plain.term_factors_ >= 2) & (plain.term_factors_ < 5), axis=1)
    unit = response ** (1.0 - of_output) * drive ** (0.0 - of_input)
    np.testing.assert_allclose(other.coef_, plain.coef_ * unit, rtol=1e-6)
    np.testing.assert_allclose(other.coef_std_, plain.coef_std_ * np.abs(unit), rtol=1e-5)
    expected = response * plain.predict(X)
    np.testing.assert_allclose(other.predict(drive * X), expected, atol=1e-6 * abs(response))


# -------------------------------------------------------------------------- coefficients, errors


@pytest.mark.slow
@pytest.mark.parametrize("kind", study.NOISES)
def test_standard_errors_cover_the_truth(kind):
    rate, n_runs = study.coverage(kind, 500, 40)
    assert n_runs >= 35
    assert 0.90 <= rate <= 0.99


def test_sensor_noise_biases_one_step_and_not_simulation():
    X, y = quadratic(4000, sensor=0.3)
    errors = {}
    for objective in ("one_step", "simulation"):
        model = NARMAXRegressor(2, objective=objective, **LAGS).fit(X, y)
        errors[objective] = abs(coefficients(model)["y(k-1)"] - 0.5)
    assert errors["simulation"] < 0.02 < errors["one_step"]


def test_coloured_noise_needs_noise_terms():
    X, y = quadratic(4000, noise=0.3, colour=0.9)
    plain = NARMAXRegressor(2, n_terms=6, **LAGS).fit(X, y)
    model = NARMAXRegressor(2, noise_lags=2, **LAGS).fit(X, y)
    assert coefficients(model)["e(k-1)"] == pytest.approx(0.9, abs=0.05)
    assert model.noise_std_ == pytest.approx(0.3, rel=0.05)
    assert abs(coefficients(plain)["y(k-1)"] - 0.5) > 0.03
    assert coefficients(model)["y(k-1)"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("kind", ["given", "rest", "free", "innovation"])
def test_jacobians_are_exact(kind):
    rng = np.random.default_rng(0)
    inputs, measured = rng.normal(size=(30, 1)), rng.normal(size=30)
    parts = [
        Start(inputs[:20], 2, np.array([0.3, 0.1]), measured[2:20]),
        Start(inputs[20:], 2, np.array([0.2, -0.1]), measured[22:]),
    ]
    terms = candidate_terms([(range(4), 2), (range(4, 5), 1)], 2, True)[:, :2]
    lags = Lags(((0, 1), (0, 2)), (1, 2), 1)
    if kind == "innovation":
        problem = InnovationProblem(terms, lags, (1,), parts, 1e6)
    else:
        terms = terms[~np.any(terms >= 4, axis=1)]
        line = (0.1, np.array([0.2])) if kind == "rest" else None
        problem = FreeRunProblem(terms, lags, parts, 1e6, line=line, free=kind == "free")
    theta = problem.unknowns(rng.uniform(-0.1, 0.1, len(terms)))
    subset = range(len(terms))
    tangents = np.concatenate([block[0] for block in problem.blocks(subset, theta)[0]])
    for q in range(len(theta)):
        step = 1e-6 * (np.arange(len(theta)) == q)
        ends = [
            np.concatenate([block[1] for block in problem.blocks(subset, theta + move)[0]])
            for move in (step, -step)
        ]
        np.testing.assert_allclose(tangents[:, q], (ends[1] - ends[0]) / 2e-6, atol=1e-7)


def test_simulation_from_an_unstable_start():
    """One-step coefficients of a noisy resonance may run away; the fit leads them back."""
    rng = np.random.default_rng(2)
    terms = {"y1": 1.9, "y2": -0.98, "u1": 0.08, "y1 y1 y1": -0.02}
    X, y = study.simulate(terms, 2000, rng, sensor=0.02)
    model = NARMAXRegressor(3, n_terms=4, objective="simulation", **LAGS).fit(X, y)
    assert model.score(X, y) > 0.95
    assert coefficients(model)["y(k-1)"] == pytest.approx(1.9, abs=0.01)


@pytest.mark.slow
def test_a_common_factor_is_taken_out():
    """The equation times a combination of itself and its past has the same free run."""
    lags = {"input_lags": (1, 2, 3), "output_lags": (1, 2, 3)}
    right = 0
    for name in ("linear, second order", "Hammerstein, cubic"):
        terms, _, degree = study.SYSTEMS[name]
        for seed in range(8):
            rng = np.random.default_rng(seed)
            X, y = study.simulate(terms, 1000, rng)
            y += 0.1 * np.std(y) * rng.normal(size=1000)
            model = NARMAXRegressor(degree, objective="simulation", **lags).fit(X, y)
            right += set(model.terms_["term"]) == set(study.spelled(terms))
    assert right >= 14


@pytest.mark.parametrize("initial_output", [0.0, "estimate"])
def test_errors_of_simulation_hold_under_coloured_noise(initial_output):
    inside, white = [], []
    truth = study.spelled(study.QUADRATIC)
    for seed in range(25):
        X, y = quadratic(1000, seed)
        noise = lfilter([1.0], [1.0, -0.9], np.random.default_rng(seed + 100).normal(size=1000))
        options = {"objective": "simulation", "initial_output": initial_output, "n_terms": 5}
        model = NARMAXRegressor(2, **LAGS, **options).fit(X, y + 0.02 * noise)
        table = model.terms_.set_index("term")
        assert set(table.index) == set(truth)
        error = np.abs(table["coefficient"] - [truth[name] for name in table.index])
        inside += list(error < 1.96 * table["standard_error"])
        white += list(error < 1.96 * model.coef_std_white_)
    assert 0.9 <= np.mean(inside) <= 0.99
    assert not 0.9 <= np.mean(white) <= 0.99


def test_initial_outputs_are_estimated():
    X, y = quadratic(400, sensor=0.01)
    late = X[100:], y[100:]
    for kind in ("estimate", "measured"):
        model = NARMAXRegressor(2, objective="simulation", initial_output=kind, **LAGS).fit(*late)
        assert set(model.terms_["term"]) == set(study.spelled(study.QUADRATIC))
        assert np.std(model.predict(*late) - late[1]) < 0.02


# ----------------------------------------------------------------------------------- runs, records


def by_hand(model, X, y, horizon):
    """Predict every sample anew from its own past."""

    def evaluate(k, outputs, errors):
        past = [signal[[k - 1, k - 2]] for signal in (X[:, 0], outputs, errors)]
        signals = np.append(past, 1.0)  # -1 is one
        return model.coef_ @ np.prod(signals[model.term_factors_], axis=1)

    errors = np.zeros(len(y))
    for k in range(2, len(y)):
        errors[k] = y[k] - evaluate(k, y, errors)
    result = np.full(len(y), np.nan)
    for k in range(2 + horizon, len(y)):
        outputs, known = y.copy(), errors.copy()
        known[k - horizon + 1 :] = 0.0
        for j in range(k - horizon + 1, k + 1):
            outputs[j] = evaluate(j, outputs, known)
        result[k] = outputs[k]
    return result


@pytest.mark.parametrize("options", [{}, {"noise_lags": (1, 2), "noise_degree": 2}])
@pytest.mark.parametrize("horizon", [1, 4])
def test_predictions_ahead(options, horizon):
    X, y = quadratic(150, noise=0.2, colour=0.9)
    model = NARMAXRegressor(2, initial_output="measured", **LAGS, **options).fit(X, y)
    assert any("e(" in name for name in model.terms_["term"]) == bool(options)
    expected = by_hand(model, X, y, horizon)
    known = np.isfinite(expected)
    np.testing.assert_allclose(model.predict(X, y, horizon=horizon)[known], expected[known])


def test_two_inputs_with_lags_of_their_own():
    terms, noise, _ = study.SYSTEMS["two inputs and a constant"]
    X, y = study.simulate(terms, 800, np.random.default_rng(0), noise=noise)
    frame = pd.DataFrame(X, columns=["force", "load"])
    model = NARMAXRegressor(2, input_lags={"force": [1], "load": [1, 2]}, output_lags=1)
    model.fit(frame, y)
    found = {"1", "y(k-1)", "force(k-1)", "load(k-2)", "force(k-1) load(k-1)"}
    assert set(model.terms_["term"]) == found


def test_features_carry_the_direction():
    rng = np.random.default_rng(0)
    u = np.sin(np.arange(800) / 9.0) * (1.0 + 0.3 * np.sin(np.arange(800) / 70.0))
    y = np.zeros(800)
    for k in range(2, 800):
        sign = np.sign(u[k - 1] - u[k - 2])
        y[k] = 0.6 * y[k - 1] + 0.4 * u[k - 1] - 0.1 * sign + 0.05 * sign * u[k - 1] ** 2
    y += 1e-6 * rng.normal(size=800)
    options = {"input_lags": (1,), "output_lags": (1,)}
    model = NARMAXRegressor(3, features=["rate_sign"], **options).fit(u[:, None], y)
    assert set(model.terms_["term"][:2]) <= {"u(k-1)", "y(k-1)", "rate_sign(k-1)"}
    assert model.score(u[:, None], y) > 0.999
    plain = NARMAXRegressor(3, **options).fit(u[:, None], y)
    assert plain.noise_std_ > 100.0 * model.noise_std_
    own = NARMAXRegressor(1, features=[PlayOperators(thresholds=[0.1, 0.4])], **options)
    own.fit(u[:, None], y)
    assert own.lag_names_[1:3] == ["PlayOperators0(k-1)", "PlayOperators1(k-1)"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise_lags": (1,), "objective": "simulation"}, "'noise_lags' parameter"),
        ({"degree": 9, "input_lags": 9}, "'degree' parameter"),
        ({"features": ["speed"]}, "'features' parameter"),
        ({"criterion": "mdl"}, "'criterion' parameter"),
        ({"noise_lags": (0,)}, "'noise_lags' parameter"),
    ],
)
def test_wrong_parameters(options, message):
    with pytest.raises(ValueError, match=message):
        NARMAXRegressor(**options).fit(*quadratic())
