"""Several responses to the same inputs: a search for each, and the effects they share."""

import numpy as np
import pandas as pd
from scipy.stats import chi2

SHARED = ["effect", "responses", "number", "value", "std", "unit", "p_value"]


def response_columns(y):
    """Return the responses by name or number if there are several, else {}.

    Parameters
    ----------
    y : DataFrame or array-like of shape (n_samples, n_outputs) or (n_samples,)
        Responses.

    Returns
    -------
    dict of str or int to Series or ndarray
        Each of shape (n_samples,).
    """
    columns = np.asarray(y)
    if columns.ndim != 2 or columns.shape[1] < 2:
        return {}
    if hasattr(y, "iloc"):
        return {name: y.iloc[:, i] for i, name in enumerate(y.columns)}
    return dict(enumerate(columns.T))


def shared_claims(searches):
    """Return the effects that are claimed for several responses, and their parameters.

    A number with standard errors, such as a resonance frequency, is averaged over the responses,
    weighted by inverse variances; the p-value tests that it is the same in all of them, by the
    scatter around the mean (chi-squared, independent noise).

    Parameters
    ----------
    searches : dict of str to EffectSearchCV
        Fitted, by response.

    Returns
    -------
    DataFrame
        One row per effect and number; ``number`` is None where an effect has none.
    """
    claimed = dict.fromkeys(name for search in searches.values() for name in search.effects_)
    rows = []
    for effect in claimed:
        by_response = {
            key: s.evidence_[effect] for key, s in searches.items() if effect in s.effects_
        }
        if len(by_response) < 2:
            continue
        common = set.intersection(*(set(evidence.numbers) for evidence in by_response.values()))
        names = [name for name in next(iter(by_response.values())).numbers if name in common]
        for name in names or [None]:
            numbers = [evidence.numbers[name] for evidence in by_response.values()] if name else []
            rows.append((effect, list(by_response), name, *_agreed(numbers)))
    return pd.DataFrame(rows, columns=SHARED)


def _agreed(numbers):
    """Return the weighted mean, its standard error, the unit, and the p-value of the scatter.

    ``numbers`` are tuples of value, standard error and unit.
    """
    with_errors = [(v, s) for v, s, _ in numbers if np.isfinite(v) and np.isfinite(s) and s > 0.0]
    unit = numbers[0][2] if numbers else ""
    if len(with_errors) < 2:
        return np.nan, np.nan, unit, np.nan
    values, std = np.transpose(with_errors)
    weights = std**-2.0
    mean = weights @ values / weights.sum()
    scatter = weights @ (values - mean) ** 2
    return mean, weights.sum() ** -0.5, unit, float(chi2.sf(scatter, len(values) - 1))
