"""Several recordings in one call, as records of one frame."""

from collections import Counter
from pathlib import Path

import pandas as pd

from ..exceptions import RecordError
from ._frames import stack_records


def labelled(sources):
    """Return a dict of the sources by file name without suffix, or by path where names repeat.

    Tables without a name are labelled by their number.
    """
    if not sources:
        raise RecordError("The 'path' parameter of read_records must name a file. Got [] instead.")
    is_frame = [hasattr(source, "columns") for source in sources]
    paths = [
        None if is_table else Path(one) for one, is_table in zip(sources, is_frame, strict=True)
    ]
    stems = Counter(path.stem for path in paths if path)
    labels = [
        number if path is None else path.stem if stems[path.stem] == 1 else str(path)
        for number, path in enumerate(paths)
    ]
    if len(set(labels)) < len(labels):
        raise RecordError("The 'path' parameter of read_records must name each file once.")
    return dict(zip(labels, sources, strict=True))


def together(parts):
    """Stack parts, a dict of (X, y) by label; return X and y with the labels in the index."""
    if len(parts) == 1:
        return next(iter(parts.values()))
    first, known = None, None
    for label, (X, y) in parts.items():
        names = [*map(str, X.columns), *([] if y is None else [y.name])]
        first, known = (first, known) if known else (label, names)
        if names != known:
            raise RecordError(
                "Recordings that are read together must have the same columns in the same units. "
                f"Got {', '.join(known)} in {first!r} and {', '.join(names)} in {label!r} instead."
            )
    relabelled = [_relabelled(label, X, y) for label, (X, y) in parts.items()]
    if relabelled[0][1] is None:
        return stack_records([X for X, _ in relabelled]), None
    return stack_records(relabelled)


def _relabelled(label, X, y):
    """Return X and y with the label of a part: ``label/record``, or ``label`` for one record."""
    given, times = (X.index.get_level_values(level) for level in ("record", "time"))
    labels = [label] * len(X) if given.nunique() == 1 else [f"{label}/{name}" for name in given]
    index = pd.MultiIndex.from_arrays([labels, times], names=X.index.names)
    return X.set_axis(index), None if y is None else y.set_axis(index)
