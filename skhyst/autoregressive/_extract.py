"""Extraction of fitted estimators of scikit-learn as one-step models with compiled loops.

Scalers before an estimator, and one around its target, are folded in: ``x' = (x - centre) / scale``
for each signal, ``y = shift + gain y'`` for the output. The extracted model is compared with the
estimator on data before it is used: an estimator that predicts differently from its class is called
instead.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ._network_step import ACTIVATIONS, GaussianStep, NetworkStep
from ._polynomial import PolynomialStep
from ._steps import LinearStep
from ._tree_step import TreesStep, flatten_boosting, flatten_histograms, flatten_trees

_TOLERANCE = 1e-10  # largest difference from the estimator, relative to the largest output


@dataclass(frozen=True)
class Scaling:
    """Affine scaling of the signals before a model, and of its output."""

    centre: np.ndarray
    scale: np.ndarray
    shift: float = 0.0
    gain: float = 1.0

    def before(self, centre, scale):
        """Return the scaling with a further scaler between it and the model."""
        return Scaling(self.centre + centre * self.scale, self.scale * scale, self.shift, self.gain)

    def behind(self, centre, scale):
        """Return the scaling around a model whose target is ``(y - centre) / scale``."""
        shift = self.shift + self.gain * float(centre)
        return Scaling(self.centre, self.scale, shift, self.gain * float(scale))


def extract_step(estimator, lags, blocks, predict):
    """Return a fitted estimator as a :class:`Step`, None where it cannot be extracted.

    The extracted step and the estimator's ``predict`` are compared on each block of signals
    (n_samples, n_signals).
    """
    n_signals = len(lags.inputs) + len(lags.outputs)
    try:
        step = _extract(estimator, lags, Scaling(np.zeros(n_signals), np.ones(n_signals)))
    except AttributeError:  # another version of scikit-learn
        return None
    if step is None:
        return None
    for Z in blocks:
        expected = np.asarray(predict(Z), dtype=float).reshape(-1)
        if not np.abs(step.rows(Z) - expected).max() <= _TOLERANCE * np.abs(expected).max():
            return None
    return step


def _extract(estimator, lags, scaling):
    for kind in type(estimator).__mro__:  # by name: none of the classes has to be imported
        if kind.__name__ in EXTRACTORS and kind.__module__.split(".")[0] in {"sklearn", "skhyst"}:
            return EXTRACTORS[kind.__name__](estimator, lags, scaling)
    if np.ndim(getattr(estimator, "intercept_", None)) <= 1 and hasattr(estimator, "coef_"):
        return _linear(estimator, lags, scaling)
    return None


def _pipeline(estimator, lags, scaling):
    *steps, (_, last) = estimator.steps
    for place, (_, step) in enumerate(steps):
        if type(step).__name__ == "PolynomialFeatures":
            return _polynomial(step, [s for _, s in steps[place + 1 :]], last, lags, scaling)
        affine = _affine(step)
        if affine is None:
            return None
        scaling = scaling.before(*affine)
    return _extract(last, lags, scaling)


def _affine(step):
    """Return (centre, scale) of a scaler, or None for any other step."""
    if step is None or (isinstance(step, str) and step == "passthrough"):
        return 0.0, 1.0
    name = type(step).__name__
    if name in {"StandardScaler", "RobustScaler", "MaxAbsScaler"}:
        centre = getattr(step, "mean_" if name == "StandardScaler" else "center_", None)
        if name == "StandardScaler" and not step.with_mean:
            centre = None
        scale = step.scale_
        return 0.0 if centre is None else centre, 1.0 if scale is None else scale
    if name == "MinMaxScaler" and not step.clip:
        return -step.min_ / step.scale_, 1.0 / step.scale_
    return None


def _target(estimator, lags, scaling):
    transformer = estimator.transformer_
    known = type(transformer).__name__
    if known == "FunctionTransformer" and transformer.inverse_func is None:
        affine = 0.0, 1.0
    else:
        affine = _affine(transformer)
    if affine is None:
        return None
    centre, scale = (np.ravel(value)[0] for value in affine)
    return _extract(estimator.regressor_, lags, scaling.behind(centre, scale))


def _linear_parts(estimator):
    coefficients = np.ravel(np.asarray(estimator.coef_, dtype=float))
    return coefficients, float(np.ravel(estimator.intercept_)[0])


def _linear(estimator, lags, scaling):
    coefficients, intercept = _linear_parts(estimator)
    if len(coefficients) != len(scaling.centre):
        return None
    weights = coefficients / scaling.scale
    intercept -= weights @ scaling.centre
    return LinearStep(lags, scaling.gain * weights, scaling.shift + scaling.gain * intercept)


def _polynomial(features, scalers, last, lags, scaling):
    """Expand a linear model of scaled monomials of scaled signals into monomials of the signals."""
    if not hasattr(last, "coef_"):
        return None
    coefficients, intercept = _linear_parts(last)
    for scaler in reversed(scalers):
        affine = _affine(scaler)
        if affine is None:
            return None
        coefficients = coefficients / affine[1]
        intercept -= np.sum(coefficients * affine[0])
    total = Counter({(): scaling.shift + scaling.gain * intercept})
    for powers, coefficient in zip(features.powers_, scaling.gain * coefficients, strict=True):
        product = {(): coefficient}
        for signal in np.repeat(np.arange(len(powers)), powers):
            scale, centre = scaling.scale[signal], scaling.centre[signal]
            grown = Counter()
            for factors, value in product.items():
                grown[(*factors, int(signal))] += value / scale
                if centre:
                    grown[factors] -= value * centre / scale
            product = grown
        for factors, value in product.items():
            total[factors] += value
    kept = {factors: value for factors, value in total.items() if value != 0.0} or {(): 0.0}
    terms = np.full((len(kept), max(1, *map(len, kept))), -1, dtype=np.int64)
    for row, factors in zip(terms, kept, strict=True):
        row[: len(factors)] = factors
    return PolynomialStep(lags, terms, np.array(list(kept.values())))


def _network(estimator, lags, scaling):
    if estimator.out_activation_ != "identity" or estimator.activation not in ACTIVATIONS:
        return None
    matrices = [np.array(matrix, dtype=float) for matrix in estimator.coefs_]
    biases = [np.array(bias, dtype=float) for bias in estimator.intercepts_]
    if len(matrices) < 2 or matrices[-1].shape[1] != 1:
        return None
    matrices[0] /= scaling.scale[:, None]
    biases[0] -= scaling.centre @ matrices[0]
    matrices[-1] *= scaling.gain
    biases[-1] = scaling.shift + scaling.gain * biases[-1]
    return NetworkStep.from_layers(lags, matrices, biases, estimator.activation)


def _configured(estimator, lags, scaling):
    """Extract a stochastic configuration network."""
    if np.ndim(estimator.coef_) != 1:
        return None
    if not estimator.n_nodes_:
        zeros = np.zeros(len(scaling.centre))
        return LinearStep(lags, zeros, scaling.shift + scaling.gain * estimator.intercept_)
    last = np.append(scaling.gain * estimator.coef_, estimator.intercept_ * scaling.gain)
    last[-1] += scaling.shift
    if estimator.activation == "sigmoid":
        first = estimator.hidden_weights_.T / scaling.scale[:, None]
        bias = estimator.hidden_biases_ - scaling.centre @ first
        layers = [first, last[:-1, None]], [bias, last[-1:]]
        return NetworkStep.from_layers(lags, *layers, "logistic")
    matrix = estimator.scaling_ / scaling.scale[:, None]
    centers = estimator.centers_ @ estimator.scaling_ + scaling.centre @ matrix
    rates = -0.5 / np.square(estimator.widths_)
    return GaussianStep(
        lags, np.ascontiguousarray(matrix), np.ascontiguousarray(centers.T), rates, last
    )


def _trees(flatten):
    """Return the extractor of a tree ensemble, whose nodes ``flatten`` puts into one array."""

    def read(estimator, lags, scaling):
        flat = flatten(estimator)
        if flat is None:
            return None
        *trees, offset, factor = flat
        offset, factor = scaling.shift + scaling.gain * offset, scaling.gain * factor
        return TreesStep(lags, scaling.centre, scaling.scale, *trees, float(offset), float(factor))

    return read


EXTRACTORS = {
    "Pipeline": _pipeline,
    "TransformedTargetRegressor": _target,
    "BaseSearchCV": lambda search, *rest: _extract(search.best_estimator_, *rest),
    "MLPRegressor": _network,
    "SCNRegressor": _configured,
    "DecisionTreeRegressor": _trees(lambda tree: flatten_trees([tree])),
    "ForestRegressor": _trees(lambda forest: flatten_trees(forest.estimators_)),
    "GradientBoostingRegressor": _trees(flatten_boosting),
    "HistGradientBoostingRegressor": _trees(flatten_histograms),
}
