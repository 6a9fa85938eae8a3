"""The private names of scikit-learn that the package uses; no other module imports any."""

from collections.abc import Callable
from typing import TypeVar

from sklearn.base import _fit_context
from sklearn.pipeline import FeatureUnion, Pipeline
from sklearn.utils._param_validation import (
    HasMethods,
    Interval,
    StrOptions,
    validate_parameter_constraints,
    validate_params,
)
from sklearn.utils.metaestimators import _BaseComposition as BaseComposition
from sklearn.utils.validation import _check_feature_names_in as check_feature_names_in
from sklearn.utils.validation import _check_sample_weight as check_sample_weight

__all__ = [
    "BaseComposition",
    "HasMethods",
    "Interval",
    "StrOptions",
    "check_feature_names_in",
    "check_sample_weight",
    "diagram_of",
    "fit_context",
    "validate_parameter_constraints",
    "validate_params",
]


_Method = TypeVar("_Method", bound=Callable)


def fit_context(*, prefer_skip_nested_validation) -> Callable[[_Method], _Method]:
    """Return scikit-learn's decorator of `fit`, typed so that the method keeps its type."""
    return _fit_context(prefer_skip_nested_validation=prefer_skip_nested_validation)


def diagram_of(steps, *, parallel):
    """Return scikit-learn's diagram of named steps, in series or in parallel."""
    kind = FeatureUnion if parallel else Pipeline
    return kind(list(steps.items()))._sk_visual_block_()
