"""Runs of any one-step model in lock-step: one call of the model a time step, for all runs.

A model sees rows of lagged inputs followed by lagged outputs. Calling it costs much more than one
more row does, so runs that do not depend on each other advance together: records in a free run, and
all samples of all records in a prediction several steps ahead.
"""

from dataclasses import dataclass

import numpy as np

from ..preprocessing._lagged_features import write_lags

__all__ = ["Start", "bounded", "free_runs", "lagged", "runs_ahead"]


@dataclass(frozen=True)
class Start:
    """Where the run over one record begins.

    Parameters
    ----------
    inputs : ndarray of shape (n_samples, n_columns)
        Inputs of the record.
    n_past : int
        Samples of the record before the first one that the run predicts.
    history : ndarray of shape (start,)
        Outputs before that sample, the latest last.
    """

    inputs: np.ndarray
    n_past: int
    history: np.ndarray

    @property
    def n_samples(self):
        """Number of samples to be predicted."""
        return len(self.inputs) - self.n_past


def lagged(inputs, table, first=0):
    """Return rows ``first`` and on of the lagged inputs of a record."""
    out = np.empty((len(inputs) - first, len(table)))
    write_lags(inputs, table, out, first)
    return out


def bounded(values, bound):
    """Return values no larger than ``bound``, and whether all of them were; NaN becomes it."""
    values = np.asarray(values, dtype=float).reshape(-1)
    good = np.abs(values) <= bound
    if good.all():
        return values, True
    return np.clip(np.where(np.isnan(values), bound, values), -bound, bound), False


def free_runs(one_step, starts, input_lags, output_lags, bound):
    """Return the free run from each start, and whether all stayed within the bound.

    Parameters
    ----------
    one_step : callable
        Maps rows (n, n_inputs + n_outputs) of lagged signals to the next outputs (n,).
    starts : sequence of Start
        Longest histories are those of the longest output lag.
    input_lags : sequence of (int, int)
        Column and lag of each lagged input.
    output_lags : sequence of int
        Lags of the output.
    bound : float
        Magnitude beyond which outputs are cut off.
    """
    rows = [lagged(start.inputs, input_lags, start.n_past) for start in starts]
    sizes = np.array([len(part) for part in rows])
    if not output_lags and sizes.any():
        y, good = bounded(one_step(np.concatenate(rows)), bound)
        return np.split(y, np.cumsum(sizes)[:-1]), good
    order = np.argsort(-sizes, kind="stable")
    offsets = (np.cumsum(sizes) - sizes)[order]
    n_active = np.searchsorted(-sizes[order], -np.arange(sizes.max()))
    inputs = np.concatenate(rows)
    n_inputs, before = inputs.shape[1], len(starts[0].history)
    y = np.empty((len(starts), before + sizes.max()))
    y[:, :before] = [starts[i].history for i in order]
    Z = np.empty((len(starts), n_inputs + len(output_lags)))
    lags, all_good = np.array(output_lags), True
    for step, active in enumerate(n_active):
        Z[:active, :n_inputs] = inputs[offsets[:active] + step]
        Z[:active, n_inputs:] = y[:active, before + step - lags]
        y[:active, before + step], good = bounded(one_step(Z[:active]), bound)
        all_good &= good
    runs = [None] * len(starts)
    for place, i in enumerate(order):
        runs[i] = y[place, before : before + sizes[i]]
    return runs, all_good


def runs_ahead(one_step, starts, measured, horizon, input_lags, output_lags, bound):
    """Return the prediction ``horizon`` steps ahead over each record.

    Sample ``k`` is predicted from the outputs measured up to ``k - horizon`` and from the inputs.
    The first samples, for which that is before the record, are those of the free run.

    Parameters
    ----------
    measured : sequence of ndarray
        Measured outputs of each record from the first predicted sample on.
    horizon : int
        Number of steps, at least 1.
    one_step, starts, input_lags, output_lags, bound
        As in :func:`free_runs`.
    """
    if not output_lags or not any(len(y) for y in measured):
        return free_runs(one_step, starts, input_lags, output_lags, bound)
    before = len(starts[0].history)
    rows, windows, firsts, n_samples = [], [], [], 0
    for start, y in zip(starts, measured, strict=True):
        # A run from each sample that has `horizon` samples ahead; the first one always.
        n_runs = min(max(len(y) - horizon + 1, 1), len(y))
        past = np.concatenate([start.history, y])[: before + n_runs - 1]
        if n_runs:
            windows.append(np.lib.stride_tricks.sliding_window_view(past, before))
        firsts.append(n_samples + np.arange(n_runs))
        rows.append(lagged(start.inputs, input_lags, start.n_past))
        n_samples += len(y)
    inputs, first = np.concatenate(rows), np.concatenate(firsts)
    leads = np.concatenate([np.arange(len(part)) == 0 for part in firsts])
    last = np.repeat(np.cumsum([len(y) for y in measured]), [len(part) for part in firsts])
    past = np.concatenate(windows)
    y, all_good = np.empty(n_samples), True
    for step in range(min(horizon, max(len(part) for part in measured))):
        active = first + step < last
        if not active.all():
            first, last, leads, past = first[active], last[active], leads[active], past[active]
        at = first + step
        Z = np.concatenate([inputs[at], past[:, [before - lag for lag in output_lags]]], axis=1)
        value, good = bounded(one_step(Z), bound)
        all_good &= good
        final = leads | (step == horizon - 1)
        y[at[final]] = value[final]
        past = np.concatenate([past[:, 1:], value[:, None]], axis=1)
    return np.split(y, np.cumsum([len(part) for part in measured])[:-1]), all_good
