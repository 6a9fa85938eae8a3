"""Every model that is not one of operators can be fed sample by sample too, or says why not."""

import shutil
import subprocess
from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.ensemble import HistGradientBoostingRegressor, RandomForestRegressor
from sklearn.linear_model import Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import FeatureUnion, Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from skhyst.autoregressive import NARMAXRegressor, NARXRegressor
from skhyst.base import ParametricModel
from skhyst.compose import (
    Cascade,
    Corrected,
    ModalFeedback,
    Modulated,
    OnColumn,
    ScheduledParameters,
    Sum,
)
from skhyst.control import InverseCompensator
from skhyst.diagnosis import EffectSearchCV
from skhyst.discovery import all_estimators
from skhyst.disturbance import Drift
from skhyst.exceptions import DivergenceWarning, ExtrapolationWarning
from skhyst.export import to_c
from skhyst.hysteresis import CoulombFriction, FreeMass, PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, Gain, ModalModel, TimeShift
from skhyst.neural import SCNRegressor
from skhyst.preprocessing import (
    GeneralizedInputGradient,
    LaggedFeatures,
    PlayOperators,
    StopOperators,
)

DT, N = 0.01, 120
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsanitize=address,undefined")
pytestmark = pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")


def recording(n_columns):
    """Two records of a device with a play and a lag, and further columns that change its gain."""
    rng, frames, responses = np.random.default_rng(5), [], []
    for label in "ab":
        waves = np.cumsum(rng.normal(size=(N, n_columns)), axis=0)
        waves *= 2.0 / np.abs(waves).max(axis=0)
        play, y = 0.0, np.zeros(N)
        for k, (u, *others) in enumerate(waves):
            play = min(max(play, u - 0.3), u + 0.3)
            y[k] = 0.7 * y[k - 1] + 0.3 * (u + play) * (1.0 + 0.1 * sum(others))
        names = ["drive", "load", "heat"][:n_columns]
        index = pd.MultiIndex.from_product([[label], DT * np.arange(N)], names=["record", "time"])
        frames.append(pd.DataFrame(waves, index, names))
        responses.append(pd.Series(y, index))
    return pd.concat(frames), pd.concat(responses)


def plays():
    return PrandtlIshlinskii(4)


def scn(**options):
    return SCNRegressor(12, random_state=0, **options)


def mlp():
    options = {"activation": "tanh", "max_iter": 60, "random_state": 0}
    return MLPRegressor(hidden_layer_sizes=(6, 5), **options)


FEATURES = ("rate_sign", "generalized_gradient", "play")
LAGS = {"input_lags": (0, 1), "output_lags": (1, 3)}
IN_C = {  # models of plain arithmetic, by the number of columns
    "ARX": (1, lambda: NARXRegressor()),
    "ARX of three inputs": (3, lambda: NARXRegressor(input_lags={0: 2, "heat": [3]})),
    "ARX from given outputs": (1, lambda: NARXRegressor(initial_output=0.7)),
    "static": (2, lambda: NARXRegressor(output_lags=())),
    "polynomial": (
        2,
        lambda: NARXRegressor(make_pipeline(PolynomialFeatures(2), Ridge()), **LAGS),
    ),
    "NARMAX": (1, lambda: NARMAXRegressor(2, n_terms=6)),
    "NARMAX with noise": (1, lambda: NARMAXRegressor(1, noise_lags=1, n_terms=6)),
    "NARMAX of features": (1, lambda: NARMAXRegressor(2, features=[*FEATURES], n_terms=9)),
    "NARMAX of many features": (
        2,
        lambda: NARMAXRegressor(
            1,
            input_lags=(1, 2),
            features=[GeneralizedInputGradient(turning_points=3), StopOperators(3)],
            n_terms=8,
        ),
    ),
    "layers": (2, lambda: NARXRegressor(make_pipeline(StandardScaler(), mlp()), **LAGS)),
    "trees": (1, lambda: NARXRegressor(RandomForestRegressor(4, random_state=0))),
    "histograms": (
        2,
        lambda: NARXRegressor(HistGradientBoostingRegressor(max_iter=9), **LAGS),
    ),
    "sigmoid nodes": (1, lambda: NARXRegressor(scn(), **LAGS)),
    "Gaussian nodes": (2, lambda: NARXRegressor(scn(activation="rbf", scaling="whiten"))),
    "network": (1, scn),
    "network of two inputs": (2, lambda: scn(activation="rbf")),
    "corrected": (1, lambda: Corrected(Ridge(), FirstOrderLag(), cv=2, max_iter=1, dt=DT)),
    "corrected network": (
        2,
        lambda: Corrected(scn(), FirstOrderLag(), cv=2, max_iter=0, dt=DT),
    ),
    "corrected recursion": (1, lambda: Corrected(NARXRegressor(), Gain(), cv=2, max_iter=0)),
    "corrected plays": (1, lambda: Corrected(plays(), FirstOrderLag(), cv=2, max_iter=0)),
    "corrected by a column": (
        2,
        lambda: Corrected(Ridge(), Modulated(Gain(), 1), cv=2, max_iter=0, dt=DT),
    ),
    "plays corrected by a column": (
        2,
        lambda: Corrected(
            plays(),
            Sum([("lag", FirstOrderLag()), ("load", OnColumn(Gain(), 1))]),
            cv=2,
            max_iter=0,
        ),
    ),
    "corrected pipeline": (
        1,
        lambda: Corrected(make_pipeline(PlayOperators(4), Ridge()), Gain(), cv=2, max_iter=0),
    ),
    "corrected lags of plays": (
        2,
        lambda: Corrected(
            make_pipeline(
                PlayOperators(2, columns=[0, 1], include_drive=True),
                LaggedFeatures({0: 2, 4: 1}),
                StandardScaler(),
                Ridge(),
            ),
            FirstOrderLag(),
            cv=2,
            max_iter=0,
        ),
    ),
    "modulated": (2, lambda: Modulated(Cascade([("h", plays()), ("l", FirstOrderLag())]), 1)),
    "friction of a load": (
        2,
        lambda: Modulated(CoulombFriction(), 1, scales=["coulomb_force"], magnitude=True),
    ),
    "friction of a load in motion": (
        2,
        lambda: Modulated(FreeMass(friction=True), 1, scales=["friction"], magnitude=True),
    ),
    "widths of a column": (
        2,
        lambda: Cascade(
            [
                ("h", Modulated(plays(), 1, scales="thresholds", degree=2)),
                ("l", FirstOrderLag()),
            ]
        ),
    ),
    "on columns": (3, lambda: Sum([("h", plays()), ("load", OnColumn(FirstOrderLag(), 2))])),
    "held and drifting": (1, lambda: Sum([("h", plays()), ("drift", Drift(1))])),
    "modes": (1, lambda: ModalModel(1)),
    "modes of two inputs": (2, lambda: ModalModel(1)),
    "modes with a loop": (2, lambda: ModalFeedback(1, max_evaluations=10)),
    "search": (
        1,
        lambda: EffectSearchCV(plays(), effects=["lag"], cv=2, max_effects=1),
    ),
}
NOT_IN_SINGLE = (  # some of them, as the fit falls out
    "friction of a load in motion",  # a mass adds up what every sample is rounded by
    *("trees", "histograms"),  # a rounded number may fall on the other side of a threshold
    *("network", "network of two inputs", "sigmoid nodes"),  # weights of nodes that cancel
    *("NARMAX with noise", "NARMAX of many features"),  # recursions that carry rounding on
)
CALLED = {
    "neighbours": (2, lambda: NARXRegressor(KNeighborsRegressor(3), **LAGS)),
    "corrected neighbours": (
        1,
        lambda: Corrected(KNeighborsRegressor(3), FirstOrderLag(), cv=2, max_iter=0),
    ),
    "a compiled recursion behind": (
        2,
        lambda: Corrected(KNeighborsRegressor(3), Modulated(Gain(), 1), cv=2, max_iter=0),
    ),
}


@cache
def fitted(name):
    """Return a fitted model, a drive and the free run under it."""
    n_columns, make = (IN_C | CALLED)[name]
    X, y = recording(n_columns)
    model = make().fit(X, y)
    rows = X.loc[["b"]]
    u = rows.to_numpy() if n_columns > 1 else rows["drive"].to_numpy()
    return model, u, np.asarray(model.predict(rows))


@pytest.mark.parametrize("name", [*IN_C, *CALLED])
def test_steps_are_the_free_run(name):
    model, u, whole = fitted(name)
    stepper = model.stepper(u0=u[0])
    cut, allowed = N // 3, 1e-12 * np.ptp(whole)
    other, first = stepper.copy(), stepper.state
    steps = [stepper.step(row) for row in u[:cut]]
    kept = stepper.state
    rest = stepper.run(u[cut:])
    np.testing.assert_allclose([*steps, *rest], whole, rtol=0, atol=allowed)
    stepper.state = kept
    for wrong in (np.nan, np.inf):
        with pytest.raises(ValueError, match="must be finite"):
            stepper.step(u[0] + wrong)
        with pytest.raises(ValueError, match="must be finite"):
            stepper.run(np.append(u[:3], u[:1] + wrong, axis=0))
    np.testing.assert_array_equal(stepper.state, kept)
    np.testing.assert_array_equal(stepper.run(u[cut:]), rest)
    elsewhere = model.stepper(u0=u[0] + 0.7)  # the state is all that is remembered
    elsewhere.state = kept
    np.testing.assert_array_equal(elsewhere.run(u[cut:]), rest)
    np.testing.assert_array_equal(other.state, first)  # whatever the one it was copied from did
    np.testing.assert_allclose(other.run(u), whole, rtol=0, atol=allowed)


def test_every_model_is_stepped():
    """Here, or in the acceptance suites of operators and of parametric models."""
    models = {name for name, cls in all_estimators() if hasattr(cls, "predict")}
    with_a_stepper = {name for name, cls in all_estimators() if hasattr(cls, "stepper")}
    # that of a device, of a response is stepped
    assert models - {"PerDevice", "SharedParameters"} <= with_a_stepper
    here = {type(fitted(name)[0]).__name__ for name in IN_C}
    others = {name for name, cls in all_estimators() if issubclass(cls, ParametricModel)}
    rows = {"InverseCompensator", "Observer"}  # of a reference; of drive and reading
    assert with_a_stepper - others - here == rows


def test_zero():
    """Inputs and outputs were zero, wherever the device is said to have rested."""
    model, u, _ = fitted("ARX")
    stepper = model.stepper(u0=5.0, initial_state="zero")
    first = model.intercept_ + model.coef_[0] * u[0]
    second = model.intercept_ + model.coef_ @ [u[1], u[0], first]
    np.testing.assert_allclose([stepper.step(u[0]), stepper.step(u[1])], [first, second])
    model, u, whole = fitted("modes")
    rest, zero = model.stepper(), model.stepper(u0=u[0], initial_state="zero")
    np.testing.assert_allclose(zero.run(u), rest.run(u), rtol=0, atol=1e-12 * np.ptp(whole))


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize("dtype", ["float64", "float32"])
def test_c(tmp_path, dtype):
    names, lines, calls = [], [], ""
    for k, name in enumerate(IN_C):
        model, u, _ = fitted(name)
        try:
            to_c(model, tmp_path, f"m{k}", dtype, u0=u[0], drive=u)
        except ValueError as error:
            known = "Single precision cannot hold", "must be 'float64'"
            if name not in NOT_IN_SINGLE or not any(own in str(error) for own in known):
                raise
            continue
        names.append(name)
        lines += [f"#define main m{k}_main", f'#include "m{k}.c"', f'#include "m{k}_test.c"']
        lines += ["#undef main"]
        calls += f"    failed += m{k}_main();\n"
    lines += [f"int main(void)\n{{\n    int failed = 0;\n{calls}    return failed;\n}}\n"]
    (tmp_path / "all.c").write_text("\n".join(lines))
    command = ["cc", *FLAGS, "all.c", "-o", "program", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run("./program", cwd=tmp_path, capture_output=True, text=True)
    said = dict(zip(names, done.stdout.splitlines(), strict=True))
    assert done.returncode == 0, said
    assert not done.stderr


def test_what_is_called_is_not_written(tmp_path):
    model, u, _ = fitted("neighbours")
    with pytest.raises(NotImplementedError, match="NARXRegressor has no step in plain arithmetic"):
        to_c(model, tmp_path, "m", u0=u[0])


def test_what_cannot_be_stepped():
    X, y = recording(1)
    ahead = GeneralizedInputGradient("forward")
    for first, why in (
        (FeatureUnion([("plays", PlayOperators(3))]), "depends on the rows before"),
        (ahead, "it looks ahead"),
        (LaggedFeatures(2, before="zero"), "must be 'rest'"),
        (Pipeline([("lags", LaggedFeatures(2)), ("plays", PlayOperators(2))]), "rows before"),
    ):
        model = Corrected(make_pipeline(first, Ridge()), Gain(), cv=2, max_iter=0).fit(X, y)
        with pytest.raises(NotImplementedError, match=why):
            model.stepper()
    with pytest.raises(NotImplementedError, match="it looks ahead"):
        NARMAXRegressor(1, features=[ahead], n_terms=3).fit(X, y).stepper()
    several = SCNRegressor(3, random_state=0).fit(X.to_numpy(), np.column_stack([y, -y]))
    with pytest.raises(NotImplementedError, match="it has several outputs"):
        several.stepper()
    with pytest.raises(NotImplementedError, match="A model of 2 responses cannot be stepped"):
        ModalModel(1).fit(X, np.column_stack([y, -y])).stepper()
    late = Corrected(Ridge(), TimeShift(), max_iter=0).fit(X, y)
    with pytest.raises(NotImplementedError, match="looks ahead"):
        late.stepper()
    with pytest.raises(ValueError, match=r"must be 0\.01 s, that of the records of the fit"):
        NARXRegressor().fit(X, y).stepper(dt=0.02)
    scheduled = ScheduledParameters(Gain()).fit(X, y)
    with pytest.raises(ValueError, match="as the 'schedule' of a stepper"):
        scheduled.stepper()


def test_scheduled_parameters():
    X, y = recording(1)
    drive = X["drive"].loc["b"].to_numpy()
    model = ScheduledParameters(plays()).fit(X, y)
    stepper = model.stepper(u0=drive[0], schedule=0.5 * np.ptp(drive))
    np.testing.assert_allclose(stepper.run(drive), model.predict(X)[N:], rtol=1e-12)


def test_intervals_that_differ(tmp_path):
    """One refusal, of whatever steps a model."""
    time = np.append(0.01 * np.arange(60), 0.02 * np.arange(60))
    index = pd.MultiIndex.from_arrays([np.repeat([0, 1], 60), time], names=["record", "time"])
    X = pd.DataFrame({"drive": np.sin(3.0 * time)}, index)
    y = X["drive"]
    model = Gain().fit(X, y)
    compensator = InverseCompensator(model).fit(X, y)
    for name, call in (
        ("Gain.stepper", model.stepper),
        ("InverseCompensator.stepper", compensator.stepper),
        ("Gain.stepper", lambda dt=None: to_c(model, tmp_path, "m", dt=dt)),
    ):
        with pytest.raises(ValueError, match=f"'dt' parameter of {name} must be given"):
            call()
        call(dt=0.01)


def test_outputs_are_cut_off_as_in_the_free_run():
    X, y = recording(1)
    model = NARXRegressor().fit(X, y)
    rows = 1e6 * X.loc[["b"]]
    u = rows["drive"].to_numpy()
    with pytest.warns(ExtrapolationWarning, match="same unit"), pytest.warns(DivergenceWarning):
        whole = model.predict(rows)
    np.testing.assert_allclose(model.stepper(u0=u[0]).run(u), whole, rtol=1e-12)
