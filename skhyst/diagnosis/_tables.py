"""The tables of a search, pickled as plain columns, since skops cannot store frames."""

import numpy as np
import pandas as pd
from scipy.stats import rankdata

HISTORY = ["effect", "error_before", "error_after", "p_value", "ambiguous_with"]
HISTORY += ["provisional", "experiment", "evidence"]
RANKING = ["round", "with_effects", "effect", "screen", "error_before", "error_after"]
RANKING += ["p_value", "n_parameters", "claimed"]
PARAMETERS_WITHOUT = ["by", "record", "low", "high", "unit", "parameter", "value", "std"]
PARAMETERS_WITHOUT += ["value_without", "std_without", "moved"]
EXPLAINED = ["declared model", "effects", "unknown term", "black box", "nothing"]
SUSPECTS = ["effect", "error_before", "error_after", "folds_better", "p_value"]
_FRAME = "frame of columns"


class WithTables:
    """Mixin whose pickled state stores data frames as plain columns."""

    def __getstate__(self):
        return {name: _plain(value) for name, value in super().__getstate__().items()}

    def __setstate__(self, state):
        super().__setstate__({name: _frame(value) for name, value in state.items()})


def _plain(value):
    """Return a data frame as a dict of lists, any other value unchanged."""
    if type(value) is not pd.DataFrame:
        return value
    columns = {name: (str(column.dtype), column.tolist()) for name, column in value.items()}
    return {_FRAME: columns, "index": (str(value.index.dtype), value.index.tolist())}


def _frame(value):
    """Return what :func:`_plain` was given."""
    if type(value) is not dict or _FRAME not in value:
        return value
    dtype, values = value["index"]
    index = pd.Index(values, dtype=dtype)
    columns = {
        name: pd.Series(column, index=index, dtype=dtype)
        for name, (dtype, column) in value[_FRAME].items()
    }
    return pd.DataFrame(columns, index=index)


def cv_results(rows, n_folds):
    """Return scikit-learn's ``cv_results_`` from the rows of a ranking."""
    params = [{name: row[name] for name in ("round", "effect")} for row in rows]
    unknown = np.full(n_folds, np.nan)
    scores = [
        unknown if (errors := row["fold_errors"]) is None else np.negative(errors) for row in rows
    ]
    scores = np.reshape(scores, (len(rows), n_folds))
    mean = scores.mean(axis=1)
    rank = rankdata(np.where(np.isnan(mean), np.inf, -mean), method="min")
    return {
        "param_round": np.array([param["round"] for param in params], dtype=int),
        "param_effect": np.array([param["effect"] for param in params], dtype=object),
        "params": np.array(params, dtype=object),
        **{f"split{i}_test_score": scores[:, i] for i in range(n_folds)},
        "mean_test_score": mean,
        "std_test_score": scores.std(axis=1),
        "rank_test_score": rank.astype(np.int32),
    }
