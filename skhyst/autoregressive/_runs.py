"""Runs of any one-step model in lock-step: one call of the model per time step, for all runs.

A model gets rows of lagged inputs followed by lagged outputs. A call costs much more than an
additional row does, so runs that do not depend on each other advance together: records in a free
run, and all samples of all records in a prediction several steps ahead.
"""

from typing import NamedTuple

import numpy as np

from .._jit import jit
from ..preprocessing import lagged_columns


class Lags(NamedTuple):
    """The signals of a model: lagged inputs, then lagged outputs."""

    inputs: tuple  # (column, lag) each
    outputs: tuple
    n_columns: int


class Start(NamedTuple):
    """The start of the run over a record, and the measured signals."""

    inputs: np.ndarray  # (n_samples, n_columns), those of the record
    n_past: int  # samples of the record before the first one that the run predicts
    history: np.ndarray  # (start,): outputs before that sample, the latest last
    measured: np.ndarray = None  # measured outputs from that sample on, if known
    weights: np.ndarray = None  # of their squared errors; None: one each

    def weighted(self, tangents, error):
        """Return rows of derivatives and of errors, multiplied by the roots of the weights."""
        if self.weights is None:
            return tangents, error
        root = np.sqrt(self.weights)
        return tangents * root[:, None], error * root

    def counts(self):
        """Return the weight of each measured output."""
        return np.ones(len(self.measured)) if self.weights is None else self.weights


def bounded(values, bound):
    """Return values cut off at ``bound``, and whether none had to be; NaN becomes ``bound``."""
    values = np.asarray(values, dtype=float).reshape(-1)
    good = np.abs(values) <= bound
    if good.all():
        return values, True
    return np.clip(np.where(np.isnan(values), bound, values), -bound, bound), False


@jit
def clipped(value, bound):
    """Return a value cut off at ``bound``; NaN becomes ``bound``."""
    return max(-bound, min(bound, value))


def free_runs(one_step, starts, lags, bound):
    """Return the free run from each start, and whether all stayed within the bound.

    ``one_step`` maps rows (n, n_inputs + n_outputs) of lagged signals to the next outputs (n,).
    """
    rows = [lagged_columns(start.inputs, lags.inputs, start.n_past) for start in starts]
    sizes = np.array([len(part) for part in rows])
    if not lags.outputs and sizes.any():
        y, good = bounded(one_step(np.concatenate(rows)), bound)
        return np.split(y, np.cumsum(sizes)[:-1]), good
    # longest runs first, so that those still active are the first rows
    order = np.argsort(-sizes, kind="stable")
    offsets = (np.cumsum(sizes) - sizes)[order]
    n_active = np.searchsorted(-sizes[order], -np.arange(sizes.max()))
    inputs = np.concatenate(rows)
    n_inputs, before = inputs.shape[1], len(starts[0].history)
    y = np.empty((len(starts), before + sizes.max()))
    y[:, :before] = [starts[i].history for i in order]
    Z = np.empty((len(starts), n_inputs + len(lags.outputs)))
    past, all_good = np.array(lags.outputs, dtype=int), True
    for step, active in enumerate(n_active):
        Z[:active, :n_inputs] = inputs[offsets[:active] + step]
        Z[:active, n_inputs:] = y[:active, before + step - past]
        y[:active, before + step], good = bounded(one_step(Z[:active]), bound)
        all_good &= good
    runs = [None] * len(starts)
    for row, i in enumerate(order):
        runs[i] = y[row, before : before + sizes[i]]
    return runs, all_good


def runs_ahead(one_step, starts, horizon, lags, bound):
    """Return the prediction ``horizon`` steps ahead over each record, as :func:`free_runs` does.

    Sample ``k`` is predicted from the outputs measured up to ``k - horizon`` and from the inputs.
    The first samples, where ``k - horizon`` is before the record, are those of the free run.
    """
    sizes = [len(start.measured) for start in starts]
    if not lags.outputs or not any(sizes):
        return free_runs(one_step, starts, lags, bound)
    before, ends = len(starts[0].history), np.cumsum(sizes)
    # one run starts at each sample that is followed by `horizon` samples, and one at the first
    n_runs = [min(max(size - horizon + 1, 1), size) for size in sizes]
    windows = [
        np.lib.stride_tricks.sliding_window_view(
            np.concatenate([start.history, start.measured])[: before + n - 1], before
        )
        for start, n in zip(starts, n_runs, strict=True)
        if n
    ]
    inputs = np.concatenate([lagged_columns(s.inputs, lags.inputs, s.n_past) for s in starts])
    lead = np.concatenate([np.arange(n) for n in n_runs])
    last, past = np.repeat(ends, n_runs), np.concatenate(windows)
    first = np.repeat(ends - sizes, n_runs) + lead
    y, all_good = np.empty(len(inputs)), True
    for step in range(min(horizon, max(sizes))):
        active = first + step < last
        if not active.all():
            first, last, lead, past = first[active], last[active], lead[active], past[active]
        at = first + step
        Z = np.concatenate([inputs[at], past[:, [before - lag for lag in lags.outputs]]], axis=1)
        value, good = bounded(one_step(Z), bound)
        all_good &= good
        final = (lead == 0) | (step == horizon - 1)
        y[at[final]] = value[final]
        past = np.concatenate([past[:, 1:], value[:, None]], axis=1)
    return np.split(y, ends[:-1]), all_good
