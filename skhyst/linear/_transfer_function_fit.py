"""How a transfer function is started, fitted to a frequency response, and how long it gets."""

from dataclasses import replace

import numpy as np

from ..operators import SeriesOperator
from ..optimize import (
    FrequencyProblem,
    RationalBlock,
    identify_response,
    pole_starts,
    record_poles,
    sections,
    vector_fit,
)
from ._base import log_grid, time_span
from ._delay import DelayOperator
from ._dynamics import TransferFunctionOperator
from ._multi_input import MultiInputTransferFunctionOperator

__all__ = ["choose_orders", "fit_response", "held_names", "record_starts"]

_PATIENCE = 3  # orders without improvement after which none is tried
_NOISELESS = 1e-20  # part of the response's power that counts as no residual
_WIDE = 3  # poles from which vector fitting of records is worth its time
_FEWEST_DELAYS, _MOST_DELAYS = 9, 60  # candidates of a delay that is fitted
_TURN = 0.4  # of the fastest line between two of them
_FOLLOWED = 6  # starts of the least squares


def choose_orders(fit, n_poles, n_zeros, max_poles):
    r"""Choose the orders that minimise Schwarz's criterion.

    .. math:: \text{BIC} = N \ln(\text{SSE} / N) + p \ln N

    Denominators come first, with one zero less than poles unless the zeros are given; then the
    zeros. Of orders that leave nothing, the smallest wins.

    Parameters
    ----------
    fit : callable
        ``fit(n_poles, n_zeros)`` returns an ``IdentificationResult``, the number N of real
        residuals and the sum of squares of the response.
    n_poles : int or "auto"
    n_zeros : int or None
        None chooses.
    max_poles : int

    Returns
    -------
    IdentificationResult
        With the evaluations of all that were tried.
    """
    tried = {}

    def criterion(order):
        if order not in tried:
            result, n, power = fit(*order)
            squares = max(result.error**2, _NOISELESS * power / n)
            tried[order] = n * np.log(squares) + len(result.params) * np.log(n), result
        return tried[order][0]

    if n_poles == "auto":
        lowest = max(n_zeros or 1, 1)
        best = lowest
        for n in range(lowest, max(max_poles, lowest) + 1):
            zeros = n - 1 if n_zeros is None else n_zeros
            best_zeros = best - 1 if n_zeros is None else n_zeros
            if criterion((n, zeros)) < criterion((best, best_zeros)):
                best = n
            elif n - best >= _PATIENCE:
                break
        n_poles = best
    orders = [(n_poles, m) for m in (range(n_poles + 1) if n_zeros is None else [n_zeros])]
    result = tried[min(orders, key=criterion)][1]
    return replace(result, n_evaluations=sum(r.n_evaluations for _, r in tried.values()))


def _operator(poles, n_zeros, n_inputs, delays, hold, *, gain=1.0):
    """Return an operator with the sections of ``poles``; ``n_inputs`` 0 for the drive alone."""
    if n_inputs == 0:
        operator = TransferFunctionOperator(*poles, np.zeros(n_zeros), gain, hold=hold)
        if np.size(delays):
            names = "delay", "transfer_function"
            return SeriesOperator(names, (DelayOperator(float(delays[0])), operator))
        return operator
    return MultiInputTransferFunctionOperator(
        *poles, np.zeros((n_inputs, n_zeros)), np.full(n_inputs, gain), delays, hold=hold
    )


def held_names(n_inputs, delay, fit_gain):
    """Return the entries of an operator of several inputs that are not fitted."""
    held = set() if fit_gain else {f"gains[{i}]" for i in range(n_inputs)}
    if not isinstance(delay, str):
        held |= {f"delays[{i}]" for i in range(np.size(delay))}
    return held


def record_starts(records, n_poles, n_zeros, delay, hold):
    """Return starting operators for records.

    Parameters
    ----------
    records : sequence of RecordData
        ``u`` is (n_samples,), or (n_samples, n_inputs).
    n_poles, n_zeros : int
    delay : "fit" or ndarray of shape (n_inputs,) or (0,)
        Delays in s; empty for none.
    hold : {"foh", "zoh"}

    Returns
    -------
    list of Operator
    """
    dt, span = time_span(records)
    n_inputs = 0 if records[0].u.ndim == 1 else records[0].u.shape[1]
    data = [(record.u, record.y, record.dt) for record in records]
    found = [] if n_inputs else pole_starts(data, n_poles)
    if n_inputs or n_poles >= _WIDE:
        poles = record_poles(data, n_poles)
        found = found if poles is None else [poles, *found]
    candidates = [sections(poles) for poles in found]
    n_first, n_second = n_poles % 2, n_poles // 2
    for w in log_grid(6.0 / span, 1.5 / dt, 2):
        spread = w * 1.5 ** np.arange(n_second)
        candidates.append((np.full(n_first, 1.0 / w), spread, np.full(n_second, 0.2)))
    delays = [np.full(max(n_inputs, 1), dt)] if isinstance(delay, str) else [delay]
    return [_operator(c, n_zeros, n_inputs, d, hold) for c in candidates for d in delays]


def fit_response(
    frequency, response, std, n_poles, n_zeros, *, delay, hold, stable, single, fit_gain, method
):
    """Fit a continuous-time transfer function to a frequency response.

    Parameters
    ----------
    frequency : ndarray of shape (n,)
        Hz.
    response : ndarray of shape (n, n_inputs), complex
    std : ndarray of shape (n, n_inputs) or None
    n_poles, n_zeros : int
    delay : "fit" or ndarray of shape (n_inputs,) or (0,)
    hold : {"foh", "zoh"}
    stable : bool
    single : bool
        Whether the operator is that of the drive alone.
    fit_gain : bool
    method : str or Method

    Returns
    -------
    result : IdentificationResult
    n_residuals : int
        Real ones.
    power : float
        Weighted sum of squares of the response.
    """
    n_inputs = response.shape[1]
    fixed = held_names(n_inputs, delay, fit_gain) | {"intercept"}
    weight = _weight(response, std)
    s = 2j * np.pi * frequency
    candidates = [delay] if not isinstance(delay, str) else _delays(frequency, response, weight)
    found = []
    for delays in candidates:
        turned = response * np.exp(s[:, None] * delays) if np.size(delays) else response
        blocks = [
            RationalBlock(turned[:, i], np.ones((len(s), 1)), weight[:, i]) for i in range(n_inputs)
        ]
        poles, cost = vector_fit(s, blocks, n_poles, feedthrough=n_zeros >= n_poles, stable=stable)
        found.append((cost, sections(poles), delays))
    found = sorted(found, key=lambda start: start[0])[:_FOLLOWED]
    problems = [
        FrequencyProblem(
            _operator(parts, n_zeros, n_inputs, delays, hold),
            frequency,
            response,
            weight,
            fixed=fixed,
        )
        for _, parts, delays in found
    ]
    result = identify_response(problems, method=method)
    if single:
        result = _single(result)
    return result, 2 * response.size, float(np.sum(np.abs(weight * response) ** 2))


def _weight(response, std):
    """Return reciprocal standard deviations, 1 where none are known."""
    if std is None:
        return np.full(response.shape, 1.0 / np.sqrt(np.mean(np.abs(response) ** 2)))
    if not np.any(std > 0.0):
        return _weight(response, None)
    # no line may count for more than a hundred of the others: a scatter of zero is chance
    return 1.0 / np.maximum(std, 0.1 * np.median(std[std > 0.0]))


def _delays(frequency, response, weight):
    """Return candidates: parts of the largest delay that the slope of the phase allows."""
    steps = np.angle(response[1:] * response[:-1].conj())
    power = (weight[1:] * np.abs(response[1:])) ** 2
    slopes = -steps / (2.0 * np.pi * np.diff(frequency)[:, None])
    most = max(float(np.max(np.sum(power * slopes, axis=0) / np.sum(power, axis=0))), 0.0)
    most, shortest = 1.2 * most, 0.01 / frequency.max()
    count = int(np.clip(most * frequency.max() / _TURN, _FEWEST_DELAYS, _MOST_DELAYS))
    parts = np.linspace(0.0, most, count)
    return [np.full(response.shape[1], max(part, shortest)) for part in parts]


def _single(result):
    """Return the result of one input with the names of the drive's own operator."""
    many = result.operator
    operator = many.part(0)
    prefix = ""
    if np.size(many.delays):
        prefix = "transfer_function__"
        operator = SeriesOperator(
            ("delay", "transfer_function"), (DelayOperator(float(many.delays[0])), operator)
        )

    def renamed(name):
        if name == "delays[0]":
            return "delay__delay"
        return prefix + name.replace("numerators[0,", "numerator[").replace("gains[0]", "gain")

    return replace(
        result,
        operator=operator,
        params={renamed(name): value for name, value in result.params.items()},
        params_std={renamed(name): value for name, value in result.params_std.items()},
        undetermined=tuple(renamed(name) for name in result.undetermined),
    )
