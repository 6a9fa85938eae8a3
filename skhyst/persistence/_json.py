"""Parametric models as JSON: names of public classes and plain values, by ``model.schema.json``.

Values that JSON has no type for are objects with one key: ``{"tuple": [...]}``, ``{"array": ...}``.
Reading looks classes up among those in ``__all__`` of the public modules of skhyst, calls their
constructors with the parameters, and sets the fitted attributes: no name in a file is imported, and
no code in it is executed.
"""

import dataclasses
import importlib
import json
import math
import pkgutil
import warnings
from contextlib import suppress
from functools import cache, partial
from importlib.metadata import version
from numbers import Integral, Real

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from .._sklearn import HasMethods, Interval, StrOptions, validate_parameter_constraints
from .._validation import finite_numbers, shortened
from ..exceptions import RecordError
from ..operators import MOST_STEPS, Operator, is_array, split_disturbances
from ..optimize import places_in_sum

FORMAT = 1
_VERSION = version("skhyst")
_RENAMED = {  # classes of skhyst, present names by earlier ones
    "SeriesOperator": "Series",
    "ModulatedOperator": "Scaled",
    "ColumnOperator": "OnColumnOperator",
    "ScheduledOperator": "Scheduled",
}
_FIELDS = {  # and fields
    "histories": "input_history",
    "promise": "predicted_cost",
    "covariance": "joint_covariance",
    "_not_told": "_undistinguished",
}
_ABOVE_ZERO = Interval(Real, 0, None, closed="neither")
_FITTED = {  # constraints in the form of scikit-learn
    "bound_": [_ABOVE_ZERO],
    "columns_": [tuple],
    "drive_range_": [tuple],
    "drive_rate_": [Interval(Real, 0, None, closed="left")],
    "dt_": [_ABOVE_ZERO, None],
    "fit_error_": [Interval(Real, 0, None, closed="left")],
    "has_rest_": ["boolean"],
    "n_features_in_": [Interval(Integral, 1, None, closed="left")],
    "operator_": [HasMethods(["run"])],
    "output_range_": [tuple],
    "params_": [dict],
    "records_": [tuple],
    "time_unit_": [StrOptions({"s", "sample"})],
}
_NUMBERS = (  # arrays and tuples of finite numbers
    *("drive_range_", "input_range_", "output_range_", "_response_range", "coef_", "intercept_"),
    *("hidden_weights_", "hidden_biases_", "centers_", "widths_", "scaling_"),
)
_DTYPES = ("bool", "int32", "int64", "float64", "complex128", "str", "object")


def to_json(model) -> str:
    """Return a model, fitted or not, as JSON text, which :func:`from_json` reads.

    Parameters
    ----------
    model : estimator
        A parametric model of skhyst, a composition of them, a polynomial
        (:class:`~skhyst.autoregressive.NARMAXRegressor`), or another estimator that consists of
        public classes of skhyst, numbers and names only.

    Returns
    -------
    str
        Valid under ``skhyst/persistence/model.schema.json``. Numbers are exact to the last bit.

    Raises
    ------
    TypeError
        If a part is not a public class of skhyst, such as an estimator of scikit-learn: skops can
        save these, see :func:`save_model`.

    See Also
    --------
    from_json : The inverse.
    save_model : Files of any fitted estimator.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import Gain
    >>> from skhyst.persistence import from_json, to_json
    >>> u = np.arange(20.0).reshape(-1, 1)
    >>> model = Gain().fit(u, 2.0 * u[:, 0] + 1.0)
    >>> bool(np.all(from_json(to_json(model)).predict(u) == model.predict(u)))
    True
    """
    versions = {"skhyst": _VERSION, "numpy": np.__version__}
    content = {"format": f"skhyst.model/{FORMAT}", "versions": versions, "model": _plain(model)}
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def from_json(text) -> BaseEstimator:
    """Return the model in a text that :func:`to_json` has written.

    Parameters
    ----------
    text : str
        JSON.

    Returns
    -------
    estimator

    Raises
    ------
    ValueError
        If the text is not such a model, has a later format, names a class that skhyst lacks, or
        contains parameters of invalid types, sizes or ranges.

    See Also
    --------
    to_json : Write such a text.

    Examples
    --------
    >>> from skhyst.linear import Gain
    >>> from skhyst.persistence import from_json, to_json
    >>> model = Gain().fit([[0.0], [1.0], [2.0]], [0.0, 2.0, 4.0])
    >>> from_json(to_json(model)).predict([[3.0]])
    array([6.])
    """
    try:
        content = json.loads(text)
        name, _, number = content["format"].partition("/")
        written = content["versions"]["skhyst"]
        known = name == "skhyst.model" and 1 <= int(number) <= FORMAT
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ValueError(f"The text is not a model of skhyst as JSON ({error!r}).") from error
    if not known:
        raise ValueError(
            f"The model is of the format {content['format']!r}, written by skhyst {written}; "
            f"skhyst {_VERSION} reads skhyst.model/1 to {FORMAT}."
        )
    try:
        return tried(_object(content["model"]))
    except Exception as error:  # a broken text may raise an exception of any type
        raise ValueError(
            f"The model, written by skhyst {written}, cannot be read by skhyst {_VERSION}: "
            f"{error!r}."
        ) from error


@cache
def _classes():
    """Return the public estimators and dataclasses of skhyst by their public names."""
    package, classes = __package__.partition(".")[0], {}
    for module in pkgutil.iter_modules(importlib.import_module(package).__path__):
        if not module.name.startswith("_"):
            name = f"{package}.{module.name}"
            public = importlib.import_module(name)
            for public_name in getattr(public, "__all__", ()):
                member = getattr(public, public_name)
                if isinstance(member, type) and (
                    issubclass(member, BaseEstimator) or dataclasses.is_dataclass(member)
                ):
                    classes[f"{name}.{public_name}"] = member
    return classes


def class_named(name):
    """Return the class of a present or earlier public name, None if there is none."""
    package, _, last = name.rpartition(".")
    moved = {public_name.rpartition(".")[2]: kind for public_name, kind in _classes().items()}
    is_own = package.partition(".")[0] == __package__.partition(".")[0]
    return _classes().get(name, moved.get(_RENAMED.get(last, last)) if is_own else None)


def field_named(name, kind) -> str:
    """Return the present name of a parameter or attribute of a class by its earlier name."""
    if name == "rank":  # stage order of an operator, place of an estimator
        return "stage_order" if kind.endswith("Operator") else "place"
    if name == "beside":  # eliminated signals of a record, additivity of an effect
        return "eliminated" if kind == "RecordData" else "additive"
    return _FIELDS.get(name, name)


@cache
def _names():
    return {member: name for name, member in _classes().items()}


def _plain(value):
    """Return the representation of a value in JSON."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": str(value)}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if isinstance(value, tuple) and type(value) is tuple:
        return {"tuple": [_plain(item) for item in value]}
    if isinstance(value, slice):
        return {"slice": [_plain(item) for item in (value.start, value.stop, value.step)]}
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {"dict": {key: _plain(item) for key, item in value.items()}}
    if isinstance(value, dict):
        return {"pairs": [[_plain(key), _plain(item)] for key, item in value.items()]}
    if isinstance(value, np.ndarray):
        return _plain_array(value)
    return _plain_object(value)


def _plain_array(array):
    dtype = "str" if array.dtype.kind == "U" else str(array.dtype)
    if dtype not in _DTYPES:
        raise TypeError(f"An array of {dtype} cannot be written as JSON: save it as .skops.")
    flat = array.ravel()
    values = flat.view(float) if dtype == "complex128" else flat
    return {"array": [_plain(v) for v in values], "dtype": dtype, "shape": list(array.shape)}


def _plain_object(value):
    name = _names().get(type(value))
    if name is None:
        kind = type(value)
        raise TypeError(
            f"{kind.__module__}.{kind.__qualname__} is not a public class of skhyst, and cannot be "
            "written as JSON: save the model as .skops."
        )
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.compare]
        values = {name: _plain(getattr(value, name)) for name in fields}
        return {"class": name, "parameters": values, "fitted": {}}
    state = {k: v for k, v in value.__getstate__().items() if k != "_sklearn_version"}
    parameters = {k: _plain(state.pop(k)) for k in value.get_params(deep=False)}
    fitted = {k: _plain(v) for k, v in state.items()}
    return {"class": name, "parameters": parameters, "fitted": fitted}


def _value(plain):
    """Return the value of a representation; the inverse of :func:`_plain`."""
    if isinstance(plain, list):
        return [_value(item) for item in plain]
    if not isinstance(plain, dict):
        return plain
    if "class" in plain:
        return _object(plain)
    if "array" in plain:
        return _array(plain)
    ((kind, content),) = plain.items()
    if kind == "dict":
        return {key: _value(item) for key, item in content.items()}
    if kind == "pairs":
        return {_value(key): _value(item) for key, item in content}
    return {"float": float, "tuple": _tuple, "slice": lambda parts: slice(*parts)}[kind](content)


def refuse_values(operator):
    """Refuse values that a file may contain but no fit finds: not finite, or out of bounds.

    A field may have its default value in any case. Nested operators are not checked.
    """
    for name, is_right, wanted in _values_required(operator):
        if not is_right:
            raise ValueError(
                f"The '{name}' parameter of {type(operator).__name__} must {wanted}. "
                f"Got {getattr(operator, name)!r} instead."
            )


def _values_required(operator):
    """Yield (name of a field, whether it is right, requirement); stop at the first that is not."""
    # a signed parameter is searched on a logarithmic scale, apart from its sign
    specs, signed = operator.parameter_specs(), getattr(operator, "signed", ())
    for field in dataclasses.fields(operator):
        name, value = field.name, getattr(operator, field.name)
        number = isinstance(value, Real) and not isinstance(value, bool)
        yield name, number or value is None or name not in specs or np.ndim(value), "be a number"
        if not (number or (name in specs and value is not None) or is_array(value)):
            continue
        usual = field.default
        if number and (value == usual or (value != value and usual != usual)):  # or both NaN
            continue
        yield name, np.isfinite(value).all(), "be finite"
        if name in specs and name not in signed:
            low, high = specs[name].lower, specs[name].upper
            is_right = np.all((low <= np.asarray(value)) & (np.asarray(value) <= high))
            yield name, is_right, f"be from {low:g} to {high:g}"
    if hasattr(operator, "lower"):  # of two limits, or stops
        yield "upper", operator.lower <= operator.upper, f"not be below 'lower', {operator.lower:g}"


def refuse_wrong(fitted, kind):
    """Refuse fitted attributes of an estimator that are invalid or contradict each other."""
    name = kind.__name__
    known = {attribute: value for attribute, value in fitted.items() if attribute in _FITTED}
    validate_parameter_constraints(
        {attribute: _FITTED[attribute] for attribute in known}, known, name
    )
    for attribute in _NUMBERS:
        if attribute in fitted:
            finite_numbers(fitted[attribute], name, attribute, "finite numbers")
    for attribute, is_right, wanted, got in _requirements(fitted, kind):
        if not is_right:
            raise ValueError(f"The '{attribute}' of {name} must {wanted}. Got {got} instead.")
    n, operator = fitted.get("n_features_in_"), fitted.get("operator_")
    positions, columns = fitted.get("columns_", (0,)), {fitted.get("_drive_number", 0)}
    columns |= operator.acting_columns if isinstance(operator, Operator) else set()
    if n is not None and not (
        positions and all(map(partial(_is_position, n), (*positions, *columns)))
    ):
        raise ValueError(
            f"{name} must read columns of an X that has {n}, as that of its fit. Got the column(s) "
            f"{sorted({*positions, *columns}, key=repr)} instead."
        )


def _requirements(fitted, kind):
    """Yield what attributes have to be to each other: name, whether it holds, what, and value."""
    for attribute in ("drive_range_", "output_range_"):
        low, high = fitted.get(attribute, (0.0, 0.0))
        yield attribute, low <= high, "ascend", f"{low}, {high}"
    noise = fitted.get("noise_std_")  # NaN for a resampled polynomial, an array for several outputs
    is_right = noise is None or (np.asarray(noise).dtype.kind in "if" and not np.any(noise < 0))
    yield "noise_std_", is_right, "be a number from 0", repr(noise)
    records, dt = fitted.get("records_", ()), fitted.get("dt_")
    if records and "dt_" in fitted:
        dts, units = ({getattr(record, k) for record in records} for k in ("dt", "time_unit"))
        is_right = fitted.get("_records_dt", dt) == (dts.pop() if len(dts) == 1 else None)
        yield "dt_", is_right, "be that of its records", repr(dt)
        unit = fitted.get("time_unit_", "s")  # which earlier versions lack
        yield "time_unit_", units == {unit}, "be that of its records", repr(unit)
    if hasattr(kind, "operator_class") and "operator_" in fitted:
        yield from _requirements_of_operator(fitted, kind)


def _requirements_of_operator(fitted, kind):
    needed = ["n_features_in_", "params_", "records_"]
    for one, other in (("time_unit_", "dt_"), ("covariance_", "noise_std_")):
        needed += [other] if one in fitted else []  # earlier versions lack both
    for attribute in needed:
        yield attribute, attribute in fitted, "be in the file", "nothing"
    operator, wanted = fitted["operator_"], kind.operator_class
    driven, additive = split_disturbances(operator)
    is_right = _contains(operator, wanted)
    yield "operator_", is_right, f"be of {wanted.__name__}", type(operator).__name__
    places, values = places_in_sum(driven, additive)[0], operator.pack()
    for key, value in fitted["params_"].items():
        own = values[places[key]] if key in places else "missing"
        wanted = f"be the values of its 'operator_', in which {key} is {own}"
        yield "params_", value == own, wanted, repr(value)
    errors = fitted.get("params_std_", {})
    is_right = errors.keys() == fitted["params_"].keys()
    yield "params_std_", is_right, "be of the same parameters as 'params_'", [*errors]
    is_right = all(isinstance(error, Real) and not error < 0 for error in errors.values())
    yield "params_std_", is_right, "be numbers from 0, or NaN", errors
    covariance, noise = fitted.get("covariance_"), fitted.get("noise_std_")
    if noise is not None:
        yield "noise_std_", np.all(np.isfinite(noise)), "be finite", repr(noise)
        yield "covariance_", covariance is not None, "be there, as there is a noise", None
    if covariance is not None:
        n, name = operator.n_parameters, "covariance_"
        finite_numbers(covariance, kind.__name__, name, "an array of finite numbers", ndim=2)
        wanted, shape = f"have the shape ({n}, {n}), for its 'operator_'", np.shape(covariance)
        yield name, shape == (n, n), wanted, shape
        std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        is_right = np.all(np.abs(covariance) <= np.outer(std, std) * (1.0 + 1e-6))  # rounded
        yield name, is_right, "have variances from 0 and correlations to 1", shortened(covariance)
        determined = [key for key, error in errors.items() if np.isfinite(error)]
        own = [std[places[key]] for key in determined]
        is_right = np.allclose([errors[key] for key in determined], own, rtol=1e-6, atol=0.0)
        yield "params_std_", is_right, "be those of 'covariance_'", errors


def _contains(operator, kind):
    """Return whether an operator, or a part of it, is of a class."""
    return isinstance(operator, kind) or any(_contains(part, kind) for part in operator.children)


def _is_position(n, column):
    return type(column) is not bool and isinstance(column, Integral) and 0 <= column < n


def tried(model):
    """Return a model after a trial prediction of three rows of zeros.

    The parts of a broken or manipulated file may be inconsistent, which shows when they are used. A
    RecordError is ignored: it only says that three rows are no record for this model.
    """
    use = getattr(model, "predict", getattr(model, "transform", None))
    if use is None or getattr(model, "n_features_in_", 0) not in range(1, MOST_STEPS):
        return model  # a forged number of columns could exhaust the memory
    names = getattr(model, "feature_names_in_", None)
    X = np.zeros((3, model.n_features_in_))
    with warnings.catch_warnings(), np.errstate(all="ignore"), suppress(RecordError):
        warnings.simplefilter("ignore")
        use(X if names is None else pd.DataFrame(X, columns=names))
    return model


def _tuple(items):
    return tuple(_value(item) for item in items)


def _array(plain):
    dtype = plain["dtype"]
    if dtype not in _DTYPES:
        raise ValueError(f"There is no array of {dtype!r}.")
    values = [_value(item) for item in plain["array"]]
    if dtype == "complex128":
        return np.array(values, dtype=float).view(complex).reshape(plain["shape"])
    if dtype == "object":  # item by item: np.array would turn sequences into further dimensions
        array = np.empty(len(values), dtype=object)
        array[:] = values
        return array.reshape(plain["shape"])
    return np.array(values, dtype=dtype).reshape(plain["shape"])


def _object(plain):
    kind = class_named(plain["class"])
    if kind is None:
        raise ValueError(f"skhyst has no public class {plain['class']!r}")
    parameters, fitted = (
        {field_named(name, kind.__name__): _value(item) for name, item in plain[part].items()}
        for part in ("parameters", "fitted")
    )
    instance = kind(**parameters)  # a dataclass checks its fields
    if isinstance(instance, Operator):
        refuse_values(instance)
    if hasattr(instance, "_parameter_constraints"):
        instance._validate_params()  # as `fit` has done
    if fitted:
        refuse_wrong(fitted, kind)
        instance.__setstate__(fitted)
    return instance
