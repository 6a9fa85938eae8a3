"""`skhyst compensate`: the drive under which a fitted model follows a reference."""

import warnings

import numpy as np
import pandas as pd

from .._files import check_outputs, replacing
from ..control import InverseCompensator
from ..exceptions import ReachWarning
from ..persistence import load_model
from ..records import read_records


def compensate(options):
    """Write the drive, and tell how far the model stays from the reference."""
    check_outputs([options.output], [options.model, options.file], force=options.force)
    model = load_model(options.model, options.trust)
    columns = {"drive": options.reference, "time": options.time, "time_unit": options.time_unit}
    X, _ = read_records(options.file, **columns)
    reference = X.iloc[:, 0]
    compensator = InverseCompensator(
        model, bandwidth=options.bandwidth, drive_limits=options.limits
    ).fit(X, reference)  # the model is fitted: nothing is learned from the reference
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReachWarning)
        drive, residual = compensator.predict(X, return_residual=True)
    span = np.ptp(reference) / 100.0 or 1.0
    worst = np.abs(residual).max()
    print(f"largest residual of the model: {worst:.4g} ({worst / span:.3g} % of the range)")
    for message in dict.fromkeys(str(warning.message) for warning in caught):
        print(message)
    table = pd.DataFrame({"drive": drive}, X.index).reset_index()
    single = table["record"].nunique() == 1
    with replacing(options.output) as (part,):
        table.drop(columns="record" if single else []).to_csv(part, index=False)
    print(f"written: {options.output}")
