import json
from importlib.resources import files

import numpy as np
import pytest
from sklearn.linear_model import Ridge

from skhyst.compose import Cascade, Corrected, ScheduledParameters, Sum
from skhyst.disturbance import Offset
from skhyst.hysteresis import PrandtlIshlinskii
from skhyst.linear import FirstOrderLag, Gain
from skhyst.persistence import from_json, to_json

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
    with pytest.raises(TypeError, match=r"Ridge is no public class of skhyst.*\.skops"):
        to_json(Corrected(Ridge(), FirstOrderLag()))


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"format": "skhyst.model/2"}, "reads skhyst.model/1"),
        ({"format": "other/1"}, "of the format"),
        ({"versions": {}}, "no model of skhyst"),
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
        with pytest.raises(ValueError, match="no model"):
            from_json(text)


def test_what_an_earlier_version_has_written_is_read():
    model = Gain().fit(U, Y)
    content = json.loads(to_json(model)) | {"versions": {"skhyst": "0.0.1"}}
    np.testing.assert_array_equal(from_json(json.dumps(content)).predict(U), model.predict(U))
    content["model"]["class"] = "skhyst.linear.Amplifier"  # as it might have been called
    with pytest.raises(ValueError, match=r"written by skhyst 0\.0\.1, cannot be read.*Amplifier"):
        from_json(json.dumps(content))
