import json
import re
from importlib.resources import files

import numpy as np
import pytest
from scipy.signal import lti
from sklearn.linear_model import Ridge

from skhyst.autoregressive import NARMAXRegressor
from skhyst.compose import Cascade, Corrected, Modulated, OnColumn, ScheduledParameters, Sum
from skhyst.disturbance import DriftOperator, Offset
from skhyst.hysteresis import (
    DahlOperator,
    LuGreOperator,
    PrandtlIshlinskii,
    Preisach,
    SystemLevelOperator,
)
from skhyst.linear import (
    DelayOperator,
    DynamicStiffness,
    FirstOrderLag,
    FirstOrderLagOperator,
    Gain,
    KelvinVoigt,
    LogCreepOperator,
    TransferFunction,
)
from skhyst.neural import GrayBoxOperator, SCNRegressor
from skhyst.persistence import from_json, to_json
from skhyst.preprocessing import LaggedFeatures
from skhyst.static import FoldOperator, Saturation

U = np.sin(0.1 * np.arange(200.0))[:, None]
Y = 2.0 * U[:, 0] + 1.0


@pytest.mark.parametrize(
    "model",
    [
        Gain(),
        Cascade([("hysteresis", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())]),
        Sum([("hysteresis", PrandtlIshlinskii(3)), ("offset", Offset())]),
        ScheduledParameters(PrandtlIshlinskii(3)),
    ],
    ids=lambda model: type(model).__name__,
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_it_follows_the_schema_and_predicts_the_same(model):
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads(files("skhyst.persistence").joinpath("model.schema.json").read_text())
    fitted = model.fit(U, Y)
    text = to_json(fitted)
    jsonschema.Draft202012Validator(schema).validate(json.loads(text))
    np.testing.assert_array_equal(from_json(text).predict(U), fitted.predict(U))
    assert to_json(from_json(text)) == text


def test_what_is_not_of_skhyst_is_refused():
    with pytest.raises(TypeError, match=r"Ridge is not a public class of skhyst.*\.skops"):
        to_json(Corrected(Ridge(), FirstOrderLag()))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"format": "skhyst.model/2"}, "reads skhyst.model/1"),
        ({"format": "other/1"}, "of the format"),
        ({"versions": {}}, "not a model of skhyst"),
        ({"model": {"class": "os.system", "parameters": {}, "fitted": {}}}, "os.system"),
        ({"model": {"class": "skhyst.linear.Gain", "parameters": {"a": 1}, "fitted": {}}}, "'a'"),
        ({"model": {"class": "skhyst.linear.Gain"}}, "cannot be read"),
        ({"model": None}, "cannot be read"),
    ],
)
def test_other_texts_are_refused(change, match):
    content = json.loads(to_json(Gain())) | change
    with pytest.raises(ValueError, match=match):
        from_json(json.dumps(content))
    for text in ("", "[]", "[" * 100_000):
        with pytest.raises(ValueError, match="not a model"):
            from_json(text)


def test_what_an_earlier_version_has_written_is_read():
    model = Gain().fit(U, Y)
    content = json.loads(to_json(model)) | {"versions": {"skhyst": "0.0.1"}}
    np.testing.assert_array_equal(from_json(json.dumps(content)).predict(U), model.predict(U))
    content["model"]["class"] = "skhyst.linear.Amplifier"  # as it might have been called
    with pytest.raises(ValueError, match=r"written by skhyst 0\.0\.1, cannot be read.*Amplifier"):
        from_json(json.dumps(content))


def changed(model, path, value):
    """Return the text of a model with another value at a place of the operator."""
    content = json.loads(to_json(model))
    own = content["model"]["fitted"]["operator_"]["parameters"]
    assert path in own
    own[path] = value
    return json.dumps(content)


@pytest.fixture(scope="module")
def creep():
    return KelvinVoigt(2, dt=0.1).fit(U, Y)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("time_constants", {"array": [0.1], "dtype": "float64", "shape": [1]}),  # of two units
        ("compliances", {"array": [0.1] * 3, "dtype": "float64", "shape": [3]}),
        ("compliances", {"array": ["a", "b"], "dtype": "str", "shape": [2]}),
        ("gain", "1.0"),
        ("gain", None),
        ("gain", True),
        ("hold", 3),
    ],
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_what_an_operator_cannot_be_is_refused(creep, name, value):
    """Sizes that do not fit each other made compiled code read beyond an array."""
    with pytest.raises(ValueError, match="parameter of KelvinVoigtOperator must"):
        from_json(changed(creep, name, value))


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("gain", {"float": "nan"}, "be finite"),
        ("intercept", {"float": "inf"}, "be finite"),
        ("compliances", {"array": [0.1, -0.1], "dtype": "float64", "shape": [2]}, "be from 0 to"),
        ("time_constants", {"array": [-0.1, 1.0], "dtype": "float64", "shape": [2]}, "be from 0"),
    ],
)
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_values_that_no_fit_finds_are_refused(creep, name, value, wanted):
    with pytest.raises(
        ValueError, match=f"'{name}' parameter of KelvinVoigtOperator must {wanted}"
    ):
        from_json(changed(creep, name, value))


def test_limits_that_cross_are_refused():
    limit = Saturation().fit(U, np.clip(U[:, 0], -0.4, 0.5))
    with pytest.raises(ValueError, match="'upper' parameter of SaturationOperator must not be"):
        from_json(changed(limit, "lower", 0.6))


@pytest.mark.parametrize("kind", [Modulated, OnColumn])
@pytest.mark.parametrize("name", ["column", "_drive_number"])
@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_a_column_that_is_not_there_is_refused(kind, name):
    model = kind(Gain(), 1).fit(np.column_stack([U, U**2]), Y)
    text, n = re.subn(rf'"{name}": -?\d+', f'"{name}": 2', to_json(model))
    assert n
    with pytest.raises(ValueError, match=f"{kind.__name__} must read columns of an X that has 2"):
        from_json(text)


@pytest.mark.parametrize("delay", [2.0**40, 1e300])
def test_a_delay_that_takes_all_memory_is_not_stepped(delay):
    """It is longer than any record, which rests before."""
    operator = DelayOperator(delay)
    np.testing.assert_array_equal(operator.run([1.0, 2.0, 3.0], 1.0)[0], np.ones(3))
    with pytest.raises(ValueError, match=r"'delay' parameter .* to be stepped"):
        operator.compiled_step(1.0, operator.init(0.0))


def test_values_that_an_operator_has_by_default_or_sign_are_read():
    """A limit that is not there is infinite, and an unstable plant has a negative time constant."""
    limit = Saturation(sides="upper").fit(U, np.minimum(U[:, 0], 0.5))
    assert from_json(to_json(limit)).operator_.lower == -np.inf
    plant = TransferFunction.from_system(lti([1.0], [-0.2, 1.0]))
    assert from_json(to_json(plant)).operator_.time_constants == [-0.2]


@pytest.mark.parametrize(
    ("kind", "values", "name"),
    [
        (
            DahlOperator,
            {"presliding_displacement": 1.0, "coulomb_force": 1.0, "exponent": -1.0},
            "exponent",
        ),
        (DriftOperator, {"coefficients": np.ones(2), "duration": 0.0}, "duration"),
        (DriftOperator, {"coefficients": np.ones((2, 2)), "duration": 1.0}, "coefficients"),
        (LogCreepOperator, {"creep": 0.1, "time_constant": 1.0, "shortest": 0.0}, "shortest"),
        (LogCreepOperator, {"creep": 0.1, "time_constant": 1.0, "longest": np.nan}, "longest"),
        (FoldOperator, {"level": 0.0, "side": 2}, "side"),
        (FirstOrderLagOperator, {"time_constant": 1.0, "hold": "auto"}, "hold"),
        (
            LuGreOperator,
            {
                "presliding_displacement": 0.0,
                "stribeck_velocity": 1.0,
                "coulomb_ratio": 0.5,
                "static_force": 1.0,
            },
            "presliding_displacement",
        ),
    ],
    ids=str,
)
def test_structure_that_no_operator_has_is_refused(kind, values, name):
    with pytest.raises(ValueError, match=f"'{name}' parameter of {kind.__name__} must"):
        kind(**values)


@pytest.mark.filterwarnings("ignore::skhyst.exceptions.ConvergenceWarning")
def test_parameters_are_those_that_fit_takes(creep):
    """Also those of a model within another, which is not fitted by itself."""
    for text in (to_json(creep), to_json(Cascade([("creep", creep)]))):
        other = text.replace('"hold": "foh"', '"hold": "second-order"', 1)
        with pytest.raises(ValueError, match="'hold' parameter of KelvinVoigt must"):
            from_json(other)
    content = json.loads(to_json(Cascade([("creep", creep)])))
    content["model"]["parameters"]["steps"] = [1.0]
    with pytest.raises(ValueError, match="cannot be read"):
        from_json(json.dumps(content))


@pytest.mark.parametrize("columns", [[], [1], [-1], [0.0], [True], ["u"]])
def test_features_are_of_columns_that_are_there(columns):
    content = json.loads(to_json(LaggedFeatures([0, 1]).fit(U)))
    content["model"]["fitted"]["columns_"] = {"tuple": columns}
    with pytest.raises(ValueError, match="LaggedFeatures must read columns of an X that has 1"):
        from_json(json.dumps(content))


def test_columns_that_are_not_there_take_no_memory():
    text = to_json(Gain(dt=0.1).fit(U, Y)).replace(
        '"n_features_in_": 1', '"n_features_in_": 10000000000'
    )
    with pytest.raises(ValueError, match="10000000000 features"):
        from_json(text).predict(U)


@pytest.mark.parametrize("lags", [3, {"tuple": [0]}, {"tuple": [{"tuple": [0, -1]}]}])
def test_what_raises_for_any_rows_is_refused(lags):
    content = json.loads(to_json(LaggedFeatures([0, 1]).fit(U)))
    content["model"]["fitted"]["lags_"] = lags
    with pytest.raises(ValueError, match="cannot be read"):
        from_json(json.dumps(content))


@pytest.mark.parametrize("value", [10**6, 2**40, 1.5, "1"])
def test_steps_and_windows_that_take_for_ever_are_refused(value):
    model = DynamicStiffness(fit_mass=False, dt=0.1).fit(U, Y)
    with pytest.raises(ValueError, match="'smoothing' parameter of DynamicStiffnessOperator must"):
        from_json(changed(model, "smoothing", value))


@pytest.mark.parametrize("name", ["input_lags", "output_lags"])
@pytest.mark.parametrize("value", [4096, 2**40, -1])
def test_lags_are_refused_before_their_terms_are_listed(name, value):
    """2^40 lags asked for 16 TiB."""
    static = SystemLevelOperator(1.0, 0.1, 0.5)
    options = {"input_lags": 2, "output_lags": 2, "degree": 2} | {name: value}
    with pytest.raises(ValueError, match=r"parameter of GrayBoxOperator must"):
        GrayBoxOperator(static, np.zeros(18), **options)
    assert len(GrayBoxOperator(static, np.zeros(18), 2, 2, 2).pack())  # 5 signals, less the level


def places(plain, at=()):
    """Yield where the numbers and names of a model stand."""
    if isinstance(plain, dict | list):
        parts = plain.items() if isinstance(plain, dict) else enumerate(plain)
        for key, part in parts:
            yield from places(part, (*at, key))
    else:
        yield at


WRONG = [-1, 7, 50, 2**40, -(2**40), 1.5, -1.5, 1e300, "x", None, {"float": "nan"}, []]


@pytest.mark.parametrize(
    "model",
    [
        Cascade([("hysteresis", PrandtlIshlinskii(3)), ("lag", FirstOrderLag())]),
        ScheduledParameters(PrandtlIshlinskii(3)),
        Preisach(4),
        TransferFunction(1, n_zeros=1, inputs="all"),
        NARMAXRegressor(2, n_terms=4),
        NARMAXRegressor(1, noise_lags=(1,), n_terms=4),
        SCNRegressor(max_nodes=5, random_state=0),
    ],
    ids=lambda model: type(model).__name__,
)
@pytest.mark.filterwarnings("ignore")
def test_numbers_that_no_fit_has_made_reach_no_compiled_code(model):
    """A broken file is refused, or read as another model: no index leaves its array."""
    noise = 0.01 * np.random.default_rng(0).normal(size=200)
    text = to_json(model.fit(U, Y + noise))
    rng, at = np.random.default_rng(1), list(places(json.loads(text)["model"]["fitted"]))
    refused = 0
    for place in rng.permutation(len(at))[:60]:
        content = json.loads(text)
        plain = content["model"]["fitted"]
        for key in at[place][:-1]:
            plain = plain[key]
        plain[at[place][-1]] = WRONG[rng.integers(len(WRONG))]
        try:
            predicted = from_json(json.dumps(content)).predict(U)
        except ValueError:
            refused += 1
        else:
            assert predicted.shape == (200,)
            assert np.isfinite(predicted).all()
    assert refused > 10


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("_n_columns", 0),
        ("_n_columns", 2**40),
        ("input_lags_", {"tuple": [{"tuple": [0, 2**40]}]}),
        ("input_lags_", {"tuple": [{"tuple": [5, 1]}]}),
        ("output_lags_", {"tuple": [0]}),
        ("term_factors_", {"array": [99], "dtype": "int64", "shape": [1, 1]}),
        ("_output_scale", 0.0),
        ("dt_", -1.0),
        ("bound_", {"float": "nan"}),
        ("output_range_", {"tuple": [0.0, "x"]}),
    ],
)
def test_a_polynomial_that_no_fit_has_made_is_refused(name, value):
    content = json.loads(to_json(NARMAXRegressor(1, dt=0.1).fit(U, Y)))
    content["model"]["fitted"][name] = value
    with pytest.raises(ValueError, match="cannot be read"):
        from_json(json.dumps(content))


@pytest.mark.parametrize(
    ("name", "value"), [("dt_", -0.1), ("has_rest_", "no"), ("operator_", 3), ("time_unit_", "h")]
)
def test_fitted_attributes_are_what_a_fit_makes(name, value):
    content = json.loads(to_json(Gain(dt=0.1).fit(U, Y)))
    content["model"]["fitted"][name] = value
    with pytest.raises(ValueError, match=f"'{name}' parameter of Gain must"):
        from_json(json.dumps(content))


def array(*values, shape):
    return {"array": values, "dtype": "float64", "shape": shape}


GONE = object()


@pytest.mark.parametrize(
    ("at", "value", "named"),
    [
        ("dt_", 2.0, "dt_"),
        ("dt_", True, "dt_"),
        ("dt_", GONE, "dt_"),
        ("drive_range_", {"tuple": [1.0, -1.0]}, "drive_range_"),
        ("time_unit_", "sample", "time_unit_"),
        ("n_features_in_", GONE, "n_features_in_"),
        ("noise_std_", -1.0, "noise_std_"),
        ("noise_std_", "1", "noise_std_"),
        ("noise_std_", {"float": "nan"}, "noise_std_"),
        ("noise_std_", GONE, "noise_std_"),
        ("params_", GONE, "params_"),
        ("params_ dict gain", None, "params_"),
        ("params_ dict gain", -2.0, "params_"),
        ("params_ dict pole", 1.0, "params_"),
        ("params_ dict gain", GONE, "params_std_"),
        ("params_std_ dict gain", None, "params_std_"),
        ("params_std_ dict gain", -1.0, "params_std_"),
        ("params_std_ dict gain", 1.0, "params_std_"),
        ("fit_error_", -1.0, "fit_error_"),
        ("_response_range tuple 0", None, "_response_range"),
        ("operator_ parameters gain", GONE, "params_"),  # which would be 1 then
        ("operator_ class", "skhyst.static.FoldOperator", "operator_"),
        ("covariance_", None, "covariance_"),
        ("covariance_", array(1.0, shape=[1, 1]), "covariance_"),
        ("covariance_", array(-1.0, 0.0, 0.0, 1.0, shape=[2, 2]), "covariance_"),
        ("covariance_", array(1.0, 2.0, 2.0, 1.0, shape=[2, 2]), "covariance_"),
        ("records_ tuple 0 parameters n_samples", None, "n_samples"),
        ("records_ tuple 0 parameters n_samples", -1, "n_samples"),
        ("records_ tuple 0 parameters rows slice 0", None, "n_samples"),
    ],
)
def test_fitted_attributes_do_not_contradict_each_other(at, value, named):
    content = json.loads(to_json(Gain(dt=0.1).fit(U, Y)))
    plain = content["model"]["fitted"]
    *path, last = (int(key) if key.isdigit() else key for key in at.split())
    for key in path:
        plain = plain[key]
    if value is GONE:
        del plain[last]
    else:
        plain[last] = value
    if at == "operator_ class":
        plain["parameters"] = {"level": 0.0}
    with pytest.raises(ValueError, match=f"'{named}' (parameter )?of (Gain|RecordSlice) must"):
        from_json(json.dumps(content))


@pytest.mark.parametrize("model", [Gain(dt=0.1), NARMAXRegressor(1, input_lags={0: [1]}, dt=0.1)])
def test_a_resampled_model_is_read(model, tmp_path):
    """Its records are those of the fit; a later fit has an interval of its own."""
    resampled = model.fit(U, Y).resampled(0.2).resampled(0.3)
    again = from_json(to_json(resampled))
    assert again.dt_ == 0.3
    np.testing.assert_array_equal(again.predict(U), resampled.predict(U))
    assert from_json(to_json(again.fit(U, Y))).dt_ == again.dt_


def test_keys_of_dictionaries_are_kept():
    model = NARMAXRegressor(input_lags={0: [0, 1]}).fit(U, Y)
    text = to_json(model)
    assert from_json(text).input_lags == {0: [0, 1]}
    assert to_json(from_json(text)) == text
