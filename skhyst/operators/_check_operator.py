"""A check of the protocol of operators, for the author of one."""

import numpy as np

_STEP = 1e-6  # step of a difference, relative to the value
_TOLERANCE = 1e-6  # error of a derivative, relative to the largest one, or to 1
_ROUNDING = 1e-9
_PLACES = (1.0, 2.0, -1.0, -2.0)  # steps, and weights, of one-sided differences of second order
_FORWARD = np.array([-1.5, 2.0, -0.5])


def check_operator(operator, u, dt):
    """Check an operator's derivatives against differences, and a run in pieces against one run.

    A noncausal operator is not run in pieces.

    Parameters
    ----------
    operator : Operator
        With parameters inside their bounds. At a kink of the law, derivatives have to lie between
        the one-sided derivatives.
    u : ndarray of shape (n_samples,) or (n_samples, n_inputs)
        Input, of at least three samples.
    dt : float
        Sampling interval in s.

    Raises
    ------
    AssertionError
        If ``sensitivities``, ``run``, ``step`` and ``unpack`` disagree; the message names them, and
        the parameter of a wrong derivative.

    See Also
    --------
    Operator : The protocol.
    OneStateOperator : The shortest way to an operator.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator
    >>> from skhyst.operators import check_operator
    >>> u = np.random.default_rng(0).normal(size=100)
    >>> check_operator(SecondOrderModeOperator(60.0, 0.1), u, dt=0.01)
    """
    u = np.asarray(u, dtype=float)
    for initial_state in ("rest", "zero"):
        if operator.causal:
            _check_pieces(operator, u, dt, initial_state)
        _check_derivatives(operator, u, dt, initial_state)


def _check_pieces(operator, u, dt, initial_state):
    first = operator.init(u[0], initial_state)
    whole, _ = operator.run(u, dt, first)
    half = len(u) // 2
    start, state = operator.run(u[:half], dt, first)
    rest, _ = operator.run(u[half:], dt, state)
    _agree(np.concatenate([start, rest]), whole, f"A run cut at sample {half} and the whole")
    state, steps = first, np.empty(len(u))
    for k, value in enumerate(u):
        state, steps[k] = operator.step(state, value, dt)
    _agree(steps, whole, "'step' from sample to sample and 'run'")


def _check_derivatives(operator, u, dt, initial_state):
    def output(vector, signal):
        moved = operator.unpack(vector)
        return moved.run(signal, dt, moved.init(signal[0], initial_state))[0]

    direction = np.random.default_rng(0).normal(size=(len(u), 1 if u.ndim == 1 else 0))
    vector = operator.pack()
    y, dy = operator.sensitivities(u, direction, dt, initial_state)
    _agree(y, output(vector, u), "The output of 'sensitivities' and that of 'run'")
    names = ["the input"] * direction.shape[1] + [name for name, _ in operator.entries()]
    expected = (len(u), len(names))
    if dy.shape != expected:
        raise AssertionError(
            f"The tangents of 'sensitivities' must be (n_samples, m + n_parameters) = {expected}, "
            f"those of the input first. Got {dy.shape} instead."
        )
    for j, name in enumerate(names):
        if j < direction.shape[1]:
            size = _STEP
            outputs = [output(vector, u + k * size * direction[:, j]) for k in _PLACES]
        else:
            move = np.arange(len(vector)) == j - direction.shape[1]
            size = _STEP * max(abs(vector[move][0]), 1e-2)
            outputs = [output(vector + k * size * move, u) for k in _PLACES]
        sides = [_FORWARD @ [y, *outputs[:2]] / size, _FORWARD @ [y, *outputs[2:]] / -size]
        sides.append((outputs[0] - outputs[2]) / (2.0 * size))
        # at a kink, as where a drive turns, any value between the one-sided derivatives is right
        between = np.clip(dy[:, j], np.min(sides, axis=0), np.max(sides, axis=0))
        _agree(dy[:, j], between, f"The derivative by {name} and its difference", _TOLERANCE)


def _agree(found, expected, subject, tolerance=_ROUNDING):
    error = np.abs(found - expected).max()
    if not error <= tolerance * max(np.abs(expected).max(), 1.0):
        raise AssertionError(f"{subject} do not agree: they are up to {error:.3g} apart.")
