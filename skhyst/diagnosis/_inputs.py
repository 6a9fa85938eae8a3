"""The data as a search reads them: records, units, and the error on new data."""

from dataclasses import replace
from itertools import compress

import numpy as np

from ..base import read_data
from ..io import unit_of
from ..model_selection import stretches
from ..optimize import RecordData
from ..records import Units, fill_lost_rows
from ._black_box import drive_of
from ._candidates import held_out_residuals, root_mean_square
from ._reference import column_of, without_column


def units_of(search, response, slices):
    """Return the units in the names of the columns, and the unit of time."""
    drive, *_ = getattr(search, "feature_names_in_", [""])
    return Units(unit_of(drive), unit_of(response), slices[0].time_unit)


def with_others(drive, columns):
    """Return the input of the stages, and the further columns of X, None if it includes them."""
    return drive, columns[:, 1:] if drive.ndim == 1 and columns.shape[1] > 1 else None


def record_data(s, drive, others, response, segments, read=None):
    """Return the RecordData of a record; rows that were lost (not ``read``) have weight zero."""
    options = {"auxiliary": None if others is None else others[s.rows]}
    if read is not None and not read[s.rows].all():
        options["weights"] = read[s.rows].astype(float)
    return RecordData(drive[s.rows], response[s.rows], s.dt, segments=tuple(segments), **options)


def scoring_folds(slices, segments, folds):
    """Return for each row the number of the fold that scores it; -1 where no fold does."""
    fold_of_row = np.full(sum(s.n_samples for s in slices), -1)
    spans = [
        (s.rows.start + start, s.rows.start + stop)
        for s, segments_of_record in zip(slices, segments, strict=True)
        for start, stop in segments_of_record
    ]
    for number, (_, test) in enumerate(folds):
        for segment in np.flatnonzero(test):
            fold_of_row[slice(*spans[segment])] = number
    return fold_of_row


def first_row(search, record):
    """Return the first row of a record that is scored, by default the one after the washout.

    By default the washout is 5 % of a single record, and nothing of several records.
    """
    unknown = int(0.05 * record.n_samples) if len(search.records_) == 1 else 0
    return min(unknown if search.washout is None else search.washout, record.n_samples - 1)


def _continues_fit(search, slices):
    """Return for each record whether it continues a record of the fit."""
    # it starts within a record of the fit, or after a gap too short to separate two records
    return [
        any(
            record.label == s.label
            and 0.0 < s.start_time - record.start_time < (record.n_samples + 0.5) * record.dt
            for record in search.records_
        )
        for s in slices
    ]


def _with_estimated_history(structure, records, continues):
    """Return a structure with an input history of the records that continue one of the fit."""
    if not any(continues) or all(operator.memoryless for operator in structure.operators):
        return structure
    histories = iter(
        structure.with_estimated_history(list(compress(records, continues))).input_history
    )
    return replace(
        structure,
        input_history=tuple(next(histories) if continued else None for continued in continues),
    )


def held_out_error(search, X, y, declared):
    """Return the error of a fitted search on evenly sampled data; see ``EffectSearchCV``."""
    X, y, read = fill_lost_rows(X, y)
    slices, columns, response = read_data(search, X, y, reset=False)
    X, columns = (without_column(table, column_of(search)) for table in (X, columns))
    driver = search.declared_estimator_ if declared else search._driver
    continues, past = _continues_fit(search, slices), np.full(len(response), np.nan)
    for s, continued in zip(slices, continues, strict=True):
        # a model that continues the response may see it before the first scored row
        counted = s.rows.start + first_row(search, s)
        past[s.rows.start : counted] = response[s.rows.start : counted] if continued else np.nan
    drive = drive_of(driver, X, columns, past if np.isfinite(past).any() else None)
    inputs, records = with_others(drive, columns), []
    for s in slices:
        segments = stretches(first_row(search, s), s.n_samples)
        records.append(record_data(s, *inputs, response, segments, read))
    structure = search._declared_structure if declared else search._structure
    if structure.input_history:
        structure = structure.with_estimated_history(records)
    else:
        structure = _with_estimated_history(structure, records, continues)
    problem = structure.problem(records)
    no_segment = np.zeros(len(problem.segment_record), dtype=bool)
    predictions = problem.predictions(problem.x0, no_segment)
    residuals = held_out_residuals(problem, predictions, [r.segments[0][0] for r in records])
    return root_mean_square(residuals, [record.weights for record in records])
