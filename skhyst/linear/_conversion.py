"""Linear operators from and to the systems of other packages."""

import numpy as np
from scipy import signal

from ..optimize import sections
from ._dynamics import TransferFunctionOperator
from ._multi_input import MultiInputTransferFunctionOperator

__all__ = [
    "control_system",
    "operator_of_system",
    "refuse_delay",
    "scipy_system",
]

_EXACT = 1e-8  # relative error at which a numerator's degree suffices
_POINTS = 8  # on the frequency axis, a pole


def operator_of_system(system, hold):
    """Return the operator of a continuous-time system; see ``TransferFunctionOperator``."""
    poles, response = _poles_and_response(system)
    size = np.abs(poles)
    if not size.min() > 1e-12 * size.max():
        raise ValueError(
            "The 'system' must have no pole at zero, where the static gain is infinite. Got poles "
            f"{poles} instead."
        )
    n = len(poles)
    omega = np.geomspace(0.03 * size.min(), 30.0 * size.max(), _POINTS * (n + 2))
    frequency, gains = omega / (2.0 * np.pi), response(omega)
    parts = sections(poles)
    for n_zeros in range(n + 1):
        one = TransferFunctionOperator(*parts, np.zeros(n_zeros), hold=hold)
        linear = one.linear_mask()
        linear[-1] = False  # the intercept
        columns = one.frequency_tangents(frequency)[1][:, 0, linear]
        weight = 1.0 / np.abs(columns).max(axis=1, keepdims=True)
        rows = _real(columns * weight)
        targets = _real(gains * weight)
        found = np.linalg.lstsq(rows, targets, rcond=None)[0]
        if np.abs(rows @ found - targets).max() <= _EXACT * np.abs(targets).max():
            break
    if gains.shape[1] == 1:
        return TransferFunctionOperator(*parts, found[:-1, 0], float(found[-1, 0]), hold=hold)
    return MultiInputTransferFunctionOperator(*parts, found[:-1].T.copy(), found[-1], hold=hold)


def _real(values):
    return np.concatenate([values.real, values.imag])


def _poles_and_response(system):
    """Return the poles and a function of rad/s that gives the responses (n, n_inputs)."""
    if getattr(system, "dt", None):
        raise ValueError(
            f"The 'system' must be in continuous time. Got one with dt = {system.dt} instead."
        )
    plain = isinstance(system, signal.TransferFunction | signal.ZerosPolesGain)
    if not (plain or hasattr(system, "A")):
        if type(system).__module__.partition(".")[0] != "control":
            raise TypeError(
                "The 'system' must be one of scipy.signal.lti, control.StateSpace and "
                f"control.TransferFunction. Got {type(system).__name__} instead."
            )
        system = _control().ss(system)
    if plain:
        poles, n_responses = np.asarray(system.poles), system.outputs
    else:
        a, b, c, d = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
        poles, n_responses = np.linalg.eigvals(a), len(c)
    if n_responses != 1 or not len(poles):
        raise ValueError(
            "The 'system' must have one response and at least one pole. Got "
            f"{n_responses} response(s) and {len(poles)} pole(s) instead."
        )
    if plain:
        return poles, lambda omega: signal.freqresp(system, omega)[1][:, None]

    def response(omega):
        resolvent = 1j * omega[:, None, None] * np.eye(len(a)) - a
        return (c @ np.linalg.solve(resolvent, np.broadcast_to(b, (len(omega), *b.shape))) + d)[
            :, 0
        ]

    return poles, response


def refuse_delay(delays):
    """Refuse a delay, which no finite state space has."""
    if np.any(delays):
        raise ValueError(
            "A model with a delay has no finite state space. Fit one with delay=0, or convert its "
            "operator_ without the delay."
        )


def _full(operator):
    """Return two-dimensional matrices A, B, C, D."""
    refuse_delay(getattr(operator, "delays", 0.0))
    a, b, c, d = operator.state_space()
    return a, b.reshape(len(a), -1), c[None, :], np.atleast_2d(d)


def scipy_system(operator):
    """Return a ``scipy.signal.StateSpace``."""
    return signal.StateSpace(*_full(operator))


def control_system(operator):
    """Return a ``control.StateSpace``."""
    return _control().ss(*_full(operator))


def _control():
    try:
        import control
    except ImportError as error:
        raise ImportError(
            "The package 'control' is not installed. "
            'Install it with: python -m pip install "skhyst[control]"'
        ) from error
    return control
