"""Lists of the estimators and operators of the package, and models by their names."""

import ast
import difflib
import importlib
import inspect
import pkgutil

from sklearn.base import BaseEstimator

from .base import ParametricModel
from .compose import Cascade
from .operators import Operator, snake_case

__all__ = ["all_estimators", "all_operators", "declarable_models", "parse_model"]


def all_estimators() -> list[tuple[str, type]]:
    """Return every public estimator of skhyst.

    Returns
    -------
    list of (str, type)
        Name and class, each class once, sorted by name.

    Examples
    --------
    >>> from skhyst.discovery import all_estimators
    >>> dict(all_estimators())["Cascade"]
    <class 'skhyst.compose._cascade.Cascade'>
    """
    return _public_subclasses(BaseEstimator)


def all_operators() -> list[tuple[str, type]]:
    """Return every public operator of skhyst.

    Returns
    -------
    list of (str, type)
        Name and class, each class once, sorted by name.

    Examples
    --------
    >>> from skhyst.discovery import all_operators
    >>> dict(all_operators())["DahlOperator"]
    <class 'skhyst.hysteresis._dahl.DahlOperator'>
    """
    return _public_subclasses(Operator)


def declarable_models() -> dict[str, type]:
    """Return the models that can be declared by their name alone.

    Returns
    -------
    dict of str to type
        Classes by their names in snake case, sorted: those that need no other model and respond to
        the drive.

    Examples
    --------
    >>> from skhyst.discovery import declarable_models
    >>> "prandtl_ishlinskii" in declarable_models(), "offset" in declarable_models()
    (True, False)
    """
    return {
        snake_case(name): model
        for name, model in all_estimators()
        if issubclass(model, ParametricModel) and _is_complete(model)
    }


def parse_model(text) -> BaseEstimator:
    """Return the declared model that a text names.

    Parameters
    ----------
    text : str
        Class name or its snake case, with simple options in parentheses; ``+`` puts models in
        series. Nothing is evaluated but literals.

    Returns
    -------
    estimator

    Raises
    ------
    ValueError
        If the text names no model or an option is not a literal.

    Examples
    --------
    >>> from skhyst.discovery import parse_model
    >>> parse_model("prandtl_ishlinskii+transfer_function(n_poles=2)").named_steps.keys()
    dict_keys(['prandtl_ishlinskii', 'transfer_function'])
    """
    try:
        parts = _addends(ast.parse(text, mode="eval").body)
        models = [_model(part) for part in parts]
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise ValueError(
            f"The model {text!r} is not understood: give a name that skhyst models lists, with "
            "options in parentheses, and + between models in series."
        ) from error
    if len(models) == 1:
        return models[0]
    steps = []
    for model in models:
        name = snake_case(type(model).__name__)
        same = sum(step.rstrip("0123456789") == name for step, _ in steps)
        steps.append((f"{name}{same + 1}" if same else name, model))
    return Cascade(steps)


def _public_subclasses(base):
    """Return the concrete subclasses among the names that public modules list in ``__all__``."""
    package = importlib.import_module(__package__)
    found = set()
    for module in pkgutil.iter_modules(package.__path__):
        if module.name.startswith("_") or module.name == "base":  # no models, their base
            continue
        public = importlib.import_module(f"{__package__}.{module.name}")
        for name in getattr(public, "__all__", ()):
            member = getattr(public, name)
            if (
                inspect.isclass(member)
                and issubclass(member, base)
                and not inspect.isabstract(member)
            ):
                found.add((name, member))
    return sorted(found, key=lambda pair: pair[0])


def _addends(node):
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [*_addends(node.left), *_addends(node.right)]
    return [node]


def _model(node):
    call = isinstance(node, ast.Call)
    name = node.func if call else node
    found = declarable_models().get(snake_case(getattr(name, "id", "")))
    if found is None:
        text = ast.unparse(name)
        raise ValueError(f"There is no model {text!r}: {_nearest(text)}")
    if not call:
        return found()
    try:
        positional = [ast.literal_eval(value) for value in node.args]
        named = {keyword.arg: ast.literal_eval(keyword.value) for keyword in node.keywords}
        return found(*positional, **named)
    except (ValueError, TypeError) as error:
        raise ValueError(f"The options of {ast.unparse(node)!r} do not fit: {error}") from error


def _is_complete(model):
    """Whether a model needs no other, and responds to the drive."""
    parameters = inspect.signature(model).parameters.values()
    complete = all(parameter.default is not parameter.empty for parameter in parameters)
    return complete and not model.operator_class.is_disturbance


def _nearest(name):
    """Return the names of models that are closest to one."""
    near = difflib.get_close_matches(snake_case(name), declarable_models(), cutoff=0.0)
    return f"did you mean {', '.join(near)}? skhyst models lists all."
