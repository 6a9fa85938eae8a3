"""Compiled step of a model of past inputs and past outputs.

The state holds the rows of inputs and of features computed from them, the latest first, then the
outputs, the latest first, then the signals of the model and its work space. A regressor without
memory is such a model of the latest row alone.
"""

from functools import cache

import numpy as np
import pandas as pd

from .._jit import bind, jit
from ..operators import CompiledCall, CompiledLaw, as_constant
from ..preprocessing import SampleRules, follow_rules
from ._extract import extract_step
from ._runs import Lags, clipped

_DECADES = 10.0 ** np.arange(-9, 10, 3)  # magnitudes of the rows on which a regressor is tested
_TRIES = 16  # rows per magnitude
_SAME = 1e-9  # largest difference of predictions by rounding, relative to the largest prediction


@jit(inline=True)
def _moved(s, at, size, by):
    """Shift ``s[at : at + size]`` back by ``by``, which frees as many numbers at its beginning."""
    for i in range(at + size - 1, at + by - 1, -1):
        s[i] = s[i - by]


@jit
def signals_of(c, s):
    """Write the signals of a sample whose inputs are set, and return their position in ``s``.

    ``c`` begins with (n_columns, size of a row, size of all rows, n_outputs, bound, places, rules):
    ``bound`` cuts off outputs, ``places`` are the positions of the signals in the state, ``rules``
    the table by which the features of a row are computed.
    """
    places, at = c[5], int(c[2]) + int(c[3])
    follow_rules(s, int(c[1]), int(c[0]), c[6])
    for j in range(places.size):
        s[at + j] = s[int(places[j])]
    return at


@jit
def store_output(y, c, s):
    """Return an output, cut off at the bound, after storing it among the past outputs."""
    y = clipped(y, c[4])
    first, n_outputs = int(c[2]), int(c[3])
    if n_outputs > 0:
        _moved(s, first, n_outputs, 1)
        s[first] = y
    return y


def step(x, at, c):
    """Placeholder of a model's law, see ``_steps``."""
    raise NotImplementedError


def of_number(u, c, s):
    """Return the output at one sample of a model of one input; see :func:`signals_of`."""
    _moved(s, 0, int(c[2]), int(c[1]))
    s[0] = u
    at = signals_of(c, s)
    return store_output(step(s, at, c[7:]), c, s)


def of_row(u, c, s):
    """Return the output at one sample of a model of several inputs."""
    _moved(s, 0, int(c[2]), int(c[1]))
    for j in range(int(c[0])):
        s[j] = u[j]
    at = signals_of(c, s)
    return store_output(step(s, at, c[7:]), c, s)


@cache
def _bound(loop, law):
    return bind(loop, law, allocates=False)


def n_stored_rows(inputs, rules):
    """Return the number of rows in the state; the past outputs follow them."""
    deepest = max([lag for _, lag in inputs], default=0)
    return 1 + max(deepest, 1 if rules.table else 0)


def compiled_lags(step, inputs, outputs, bound, rules, history, call=None, name=None):
    """Return a model as a compiled step.

    Parameters
    ----------
    step : Step or None
        The model; None where it has to be called.
    inputs : sequence of (int, int)
        Position in a row, and lag, of each input signal.
    outputs : sequence of int
        Lags of the output signals, which follow the input signals.
    bound : float
        Magnitude at which outputs are cut off.
    rules : SampleRules
        Rules of the features of a row, and the row before the first sample.
    history : ndarray of shape (n_outputs,)
        Outputs before the first sample, the latest last.
    call : callable, optional
        Maps rows of signals (n, n_signals) to outputs (n,), where there is no step.
    name : str, optional
        Name of the called function.
    """
    size, n_outputs = len(rules.row), len(history)
    n_columns = size - len(rules.table)
    n_rows = n_stored_rows(inputs, rules)
    positions = [lag * size + place for place, lag in inputs]
    positions += [n_rows * size + lag - 1 for lag in outputs]
    table = np.reshape(np.array(rules.table, dtype=float), (-1, 4))
    sizes = (n_columns, size, n_rows * size, n_outputs, bound, as_constant(positions), table)
    work_space = np.zeros(len(positions) + (step.room if step else 0))
    state = np.concatenate([np.tile(rules.row, n_rows), history[::-1], work_space])
    n_inputs = n_columns if n_columns > 1 else None
    if step is not None:
        law, constants = step.plain_law()
        law = _bound(of_row if n_inputs else of_number, law)
        return CompiledLaw(law, (*sizes, *constants), state, n_inputs)
    sizes = (*map(float, sizes[:5]), *sizes[5:])

    def called(u, s):
        s[size : n_rows * size] = s[: (n_rows - 1) * size]
        s[:n_columns] = u if n_columns == 1 else u[:n_columns]
        at = signals_of(sizes, s)
        return store_output(float(np.ravel(call(s[None, at:]))[0]), sizes, s)

    return CompiledCall(called, state, name, n_inputs)


def compiled_regressor(estimator, n_columns, dt=1.0, u0=0.0):
    """Return a fitted regressor, or a pipeline after transformers of skhyst, as a compiled step.

    It is plain arithmetic where the regressor can be extracted, as in the free run of a
    :class:`NARXRegressor`; any other is called.

    Parameters
    ----------
    estimator : estimator
        Its prediction for a row must be one number that depends on that row alone, apart from the
        memory of transformers such as :class:`~skhyst.preprocessing.PlayOperators` at the beginning
        of a pipeline.
    n_columns : int
        Number of columns of its input.
    dt : float, default=1.0
        Sampling interval in s.
    u0 : float or array-like of shape (n_columns,), default=0.0
        Inputs at which the device is at rest before the first sample.

    Returns
    -------
    CompiledStep

    Raises
    ------
    NotImplementedError
        If a prediction depends on other rows, or there are several outputs.

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn.linear_model import LinearRegression
    >>> from skhyst.autoregressive import compiled_regressor
    >>> from skhyst.operators import Stepper
    >>> x = np.arange(5.0)[:, None]
    >>> Stepper(compiled_regressor(LinearRegression().fit(x, 2.0 * x[:, 0]), 1)).step(3.0)
    6.0
    """
    name = type(estimator).__name__
    rules, places = (
        SampleRules(np.broadcast_to(u0, (n_columns,))),
        [(j, 0) for j in range(n_columns)],
    )
    while hasattr(estimator, "steps") and hasattr(estimator.steps[0][1], "sample_rules"):
        places = estimator.steps[0][1].sample_rules(rules, places, dt)
        estimator = estimator[1:]
    n_signals = len(places)

    def predict(Z):
        names = getattr(estimator, "feature_names_in_", None)
        return estimator.predict(Z if names is None else pd.DataFrame(Z, columns=names))

    rng = np.random.default_rng(0)
    blocks = [decade * rng.standard_normal((_TRIES, n_signals)) for decade in _DECADES]
    with np.errstate(all="ignore"):
        for Z in blocks:
            forward, backward = predict(Z), predict(Z[::-1])[::-1]
            if np.size(forward) != len(Z):
                raise NotImplementedError(
                    f"{name} cannot be stepped: a step returns one number, it has several outputs."
                )
            size = np.abs(forward).max()
            if not np.allclose(forward, backward, rtol=0.0, atol=_SAME * size, equal_nan=True):
                raise NotImplementedError(
                    f"{name} cannot be stepped: its prediction for a row depends on the rows "
                    "before, and its memory of them is not known."
                )
        lags = Lags(tuple((j, 0) for j in range(n_signals)), (), n_signals)
        step = extract_step(estimator, lags, blocks, predict)
    return compiled_lags(step, places, (), np.inf, rules, np.empty(0), predict, name)
