"""Models as discrete-time systems of python-control, from their compiled steps."""

from functools import reduce
from operator import add, mul

import numpy as np

from ..operators import (
    FrozenOperator,
    Operator,
    Series,
    Stepper,
    SumOperator,
    split_disturbances,
)
from ._content import stepper_of

_ROUNDING = 1e-9  # largest relative error of the matrices of a linear step
_CHANGE = 2.0**-10  # step of differences: so small that integers in the state, as indices, stay


def to_control(model, dt=None, *, u0=0.0, initial_state=None):
    """Return a model as a system of python-control, in discrete time.

    A linear model, such as a cascade of linear stages and delays, becomes a ``control.StateSpace``
    from drive to response, both relative to their values at rest. Any other model becomes a
    nonlinear system by ``control.nlsys``, in the units of the model. Systems of both kinds can be
    interconnected.

    Parameters
    ----------
    model : estimator, Operator, CompiledStep or Stepper
        A fitted model or any other object with ``stepper``; or an operator, a compiled step or a
        stepper.
    dt : float, optional
        Sampling interval in s; that of the records of the fit by default. Needed for an operator.
    u0 : float or array-like of shape (n_inputs,), default=0.0
        Input at which the device rests, in units of the drive, for nonlinear models.
    initial_state : {"rest", "zero"}, default=None
        State before the first sample; by default that of ``predict``, of an operator that of rest.

    Returns
    -------
    control.StateSpace or control.NonlinearIOSystem
        The state of a nonlinear system is that of the stepper minus its initial state, so that a
        simulation from the state zero begins there.

    Raises
    ------
    ImportError
        If the package ``control`` is not installed.
    ValueError
        If the interval is missing.
    NotImplementedError
        If the output of the model depends on later input.

    See Also
    --------
    to_c : A program for a controller.

    Notes
    -----
    A linear system does not contain additive disturbances and intercepts. Its response to a sampled
    drive is that of the model. Systems in continuous time are returned by
    :meth:`~skhyst.linear.TransferFunction.to_control`.

    Examples
    --------
    >>> import control
    >>> import numpy as np
    >>> from skhyst.export import to_control
    >>> from skhyst.linear import DelayOperator, SecondOrderModeOperator
    >>> from skhyst.operators import Series
    >>> stages = DelayOperator(2e-4), SecondOrderModeOperator(300.0, 0.5)
    >>> stage = to_control(Series(("delay", "mode"), stages), dt=1e-4)
    >>> integral = control.ss([[1.0]], [[1.0]], [[20.0 * 1e-4]], [[0.0]], 1e-4)
    >>> loop = control.frd(integral * stage, np.geomspace(1.0, 3e3, 500), smooth=True)
    >>> gain_margin, phase_margin, *_ = control.margin(loop)
    >>> print(f"{gain_margin:.0f}, {phase_margin:.0f} degrees")
    14, 86 degrees
    """
    try:
        import control
    except ImportError as error:
        raise ImportError(
            "to_control needs the package 'control'. "
            'Install it with: python -m pip install "skhyst[control]"'
        ) from error
    if hasattr(model, "init") and dt is None:
        raise ValueError("The 'dt' parameter of to_control must be given, in s, for an operator.")
    stepper, dt = stepper_of(model, dt, initial_state, u0)
    operator = model if hasattr(model, "init") else getattr(model, "operator_", None)
    if isinstance(operator, Operator):
        operator, _ = split_disturbances(operator)
    system = None if operator is None else _linear(operator, dt, control)
    return _stepped(stepper, dt, control) if system is None else system


def _linear(operator, dt, control):
    """Return the state space of an operator; None if it is not linear or has none."""
    if not operator.signal_linear:
        return None
    if isinstance(operator, FrozenOperator):
        return _linear(operator.operator, dt, control)
    if isinstance(operator, Series | SumOperator):
        parts = [_linear(stage, dt, control) for stage in operator.stages]
        if any(part is None for part in parts):
            return None
        join, none = (add, 0.0) if isinstance(operator, SumOperator) else (mul, 1.0)
        return reduce(join, parts[::-1], control.ss([], [], [], [[none]], dt))
    if not operator.has_matrices:
        return _by_its_step(operator, dt, control)
    # with the state x - b1 u instead of x, only the present input is needed
    a, b0, b1, c, d = operator.discrete(dt)
    return control.ss(a, (b0 + a @ b1)[:, None], c[None], [[d + c @ b1]], dt)


def _by_its_step(operator, dt, control):
    """Return the state space of a step: by differences, or by a finite impulse response; or None.

    None is returned if neither reproduces the step's response to noise.
    """
    n_inputs = getattr(operator, "n_inputs", 1)
    compiled_step = operator.compiled_step(
        dt, operator.init(np.zeros(n_inputs) if n_inputs > 1 else 0.0)
    )
    n = len(compiled_step.state)
    u = np.random.default_rng(0).normal(size=(2 * n + 2, n_inputs))
    u = u if compiled_step.n_inputs else u[:, 0]

    def answer(u):
        return Stepper(compiled_step).run(u) - Stepper(compiled_step).run(0.0 * u)

    def moved(change):
        s = compiled_step.state + change[:n]
        y = compiled_step.stepping(s)(change[n:] if compiled_step.n_inputs else float(change[n]))
        return np.append(s - compiled_step.state, y)

    changes = _CHANGE * np.eye(n + n_inputs)
    still = moved(0.0 * changes[0])
    matrix = np.stack([moved(change) - still for change in changes], axis=1) / _CHANGE
    # columns of zeros are work space, not states
    read = np.flatnonzero(np.any(matrix[:, :n], axis=0))
    inputs = np.arange(n, n + n_inputs)
    blocks = (matrix[np.ix_(i, j)] for i in (read, [n]) for j in (read, inputs))
    system, expected = control.ss(*blocks, dt), answer(u)
    found = control.forced_response(system, dt * np.arange(len(u)), u.T).outputs
    if np.allclose(found, expected, rtol=0.0, atol=_ROUNDING * np.ptp(expected)):
        return system
    # A delay keeps the index into its buffer in the state, so its step is linear in the input only.
    # The pulse comes after the buffer has filled, since until then another rule may apply.
    if compiled_step.n_inputs:
        return None
    pulse = answer(np.eye(1, 3 * n + 3, k=n + 1)[0])[n + 1 :]
    if np.any(pulse[n + 1 :]):
        return None
    n = np.flatnonzero(pulse)[-1]
    return control.ss(np.eye(n, k=-1), np.eye(n, 1), pulse[None, 1 : n + 1], [pulse[:1]], dt)


def _stepped(stepper, dt, control):
    """Return a compiled step as a nonlinear system."""
    compiled_step, rest = stepper.compiled_step, stepper.state
    s = rest.copy()
    step = compiled_step.stepping(s)

    def after(x, u):
        s[:] = rest + x
        y = step(u if compiled_step.n_inputs else float(u[0]))
        return s - rest, y

    return control.nlsys(
        lambda t, x, u, params: after(x, u)[0],
        lambda t, x, u, params: np.array([after(x, u)[1]]),
        inputs=compiled_step.n_inputs or 1,
        outputs=1,
        states=len(rest),
        dt=dt,
    )
