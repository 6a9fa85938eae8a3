"""Tables of a fitted estimator as plain columns: files without pickles have no word for frames."""

import pandas as pd

_FRAME = "frame of columns"


class WithTables:
    """Mixin whose state has the columns of each frame in its place."""

    def __getstate__(self):
        return {name: _plain(value) for name, value in super().__getstate__().items()}

    def __setstate__(self, state):
        super().__setstate__({name: _frame(value) for name, value in state.items()})


def _plain(value):
    if type(value) is not pd.DataFrame:
        return value
    columns = {name: (str(own.dtype), own.tolist()) for name, own in value.items()}
    return {_FRAME: columns, "index": (str(value.index.dtype), value.index.tolist())}


def _frame(value):
    if type(value) is not dict or _FRAME not in value:
        return value
    dtype, own = value["index"]
    index = pd.Index(own, dtype=dtype)
    columns = {
        name: pd.Series(own, index=index, dtype=dtype)
        for name, (dtype, own) in value[_FRAME].items()
    }
    return pd.DataFrame(columns, index=index)
