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
from ._delay import DelayOperator
from ._linear import log_grid, time_span
from ._rational import MultiInputTransferFunctionOperator, TransferFunctionOperator

_PATIENCE = 3  # orders without improvement after which none is tried
_NOISELESS = 1e-20  # part of the response's power that counts as no residual
_WIDE = 3  # poles from which vector fitting of records is worth its time
_FEWEST_DELAYS, _MOST_DELAYS = 9, 60  # candidates of a delay that is fitted
_TURN = 0.4  # of the fastest line between two of them
_FOLLOWED = 6  # starts of the least squares


def choose_orders(fit, n_poles, n_zeros, max_poles):
    """Return the result of the orders that minimise Schwarz's criterion, if they are not given.

    Denominators ("auto") come first, with one zero less than poles unless the zeros are given; then
    the zeros (None). Of orders that leave nothing, the smallest wins. ``fit(n_poles, n_zeros)``
    returns a result, the number of real residuals and the sum of squares of the response.
    """
    tried = {}

    def criterion(order):
        if order not in tried:
            result, n, power = fit(*order)
            squares = max(result.error**2, _NOISELESS * power / n, np.finfo(float).tiny)
            tried[order] = n * np.log(squares) + len(result.params) * np.log(n), result
        return tried[order][0]

    def usual(n):
        return n, n - 1 if n_zeros is None else n_zeros

    if n_poles == "auto":
        best = lowest = max(n_zeros or 1, 1)
        for n in range(lowest, max(max_poles, lowest) + 1):
            if criterion(usual(n)) < criterion(usual(best)):
                best = n
            elif n - best >= _PATIENCE:
                break
        n_poles = best
    orders = [(n_poles, m) for m in (range(n_poles + 1) if n_zeros is None else [n_zeros])]
    result = tried[min(orders, key=criterion)][1]
    return replace(result, n_evaluations=sum(r.n_evaluations for _, r in tried.values()))


def _behind_delay(operator, delays):
    """Return the drive's own operator behind its delay, if it has one."""
    if not np.size(delays):
        return operator
    return SeriesOperator(
        ("delay", "transfer_function"), (DelayOperator(float(delays[0])), operator)
    )


def _several(parts, n_zeros, n_inputs, delays, hold):
    """Return an operator of several inputs with the sections ``parts``."""
    numerators, gains = np.zeros((n_inputs, n_zeros)), np.ones(n_inputs)
    return MultiInputTransferFunctionOperator(*parts, numerators, gains, delays, hold=hold)


def held_names(n_inputs, delay, fit_gain):
    """Return the entries of an operator of several inputs that are not fitted."""
    held = set() if fit_gain else {f"gains[{i}]" for i in range(n_inputs)}
    if not isinstance(delay, str):
        held |= {f"delays[{i}]" for i in range(np.size(delay))}
    return held


def record_starts(records, n_poles, n_zeros, delay, hold):
    """Return starting operators for records, whose ``u`` is (n_samples,) or of several inputs.

    ``delay`` is "fit", or the delays in s: one an input, or an empty array for none.
    """
    dt, span = time_span(records)
    several = records[0].u.ndim > 1
    n_inputs = records[0].u.shape[1] if several else 1
    data = [(record.u, record.y, record.dt) for record in records]
    found = [] if several else pole_starts(data, n_poles)
    if several or n_poles >= _WIDE:
        poles = record_poles(data, n_poles)
        found = found if poles is None else [poles, *found]
    candidates = [sections(poles) for poles in found]
    n_first, n_second = n_poles % 2, n_poles // 2
    for w in log_grid(6.0 / span, 1.5 / dt, 2):
        spread = w * 1.5 ** np.arange(n_second)
        candidates.append((np.full(n_first, 1.0 / w), spread, np.full(n_second, 0.2)))
    delays = np.full(n_inputs, dt) if isinstance(delay, str) else delay
    if several:
        return [_several(parts, n_zeros, n_inputs, delays, hold) for parts in candidates]
    return [
        _behind_delay(TransferFunctionOperator(*parts, np.zeros(n_zeros), hold=hold), delays)
        for parts in candidates
    ]


def fit_response(
    frequency, response, std, n_poles, n_zeros, *, delay, hold, stable, single, fit_gain, method
):
    """Return what :func:`choose_orders` asks for, of a frequency response (n, n_inputs).

    ``delay`` is as in :func:`record_starts`, ``single`` asks for the operator of the drive alone.
    """
    n_inputs = response.shape[1]
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
        found.append((cost, _several(sections(poles), n_zeros, n_inputs, delays, hold)))
    fixed = held_names(n_inputs, delay, fit_gain) | {"intercept"}
    problems = [
        FrequencyProblem(operator, frequency, response, weight, fixed=fixed)
        for _, operator in sorted(found, key=lambda start: start[0])[:_FOLLOWED]
    ]
    result = identify_response(problems, method=method)
    if single:
        result = _single(result)
    return result, 2 * response.size, float(np.sum(np.abs(weight * response) ** 2))


def _weight(response, std):
    """Return reciprocal standard deviations, 1 where none are known."""
    if std is None or not np.any(std > 0.0):
        return np.full(response.shape, 1.0 / np.sqrt(np.mean(np.abs(response) ** 2)))
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
    prefix = "transfer_function__" if np.size(many.delays) else ""

    def renamed(name):
        if name == "delays[0]":
            return "delay__delay"
        return prefix + name.replace("numerators[0,", "numerator[").replace("gains[0]", "gain")

    return replace(
        result,
        operator=_behind_delay(many.part(0), many.delays),
        params={renamed(name): value for name, value in result.params.items()},
        params_std={renamed(name): value for name, value in result.params_std.items()},
        params_std_white={renamed(n): value for n, value in result.params_std_white.items()},
        undetermined=tuple(map(renamed, result.undetermined)),
    )
