"""Conversion of linear systems to and from SciPy and python-control, as arrays."""

import numpy as np
from scipy import signal

from ._linear import complex_gain


def poles_and_response(system):
    """Return the poles in rad/s and a function of rad/s (n,) that gives the gains (n, n_inputs)."""
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
        matrices = [np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D)]
        poles, n_responses = np.linalg.eigvals(matrices[0]), len(matrices[2])
    if n_responses != 1 or not len(poles):
        raise ValueError(
            "The 'system' must have one response and at least one pole. Got "
            f"{n_responses} response(s) and {len(poles)} pole(s) instead."
        )
    size = np.abs(poles)
    if not size.min() > 1e-12 * size.max():
        raise ValueError(
            "The 'system' must have no pole at zero, where the static gain is infinite. Got poles "
            f"{poles} instead."
        )
    if plain:
        return poles, lambda omega: signal.freqresp(system, omega)[1][:, None]
    return poles, lambda omega: complex_gain(*matrices, 1j * omega)[:, 0]


def scipy_system(operator, delays=0.0):
    """Return an operator as a ``scipy.signal.StateSpace``."""
    return signal.StateSpace(*_matrices(operator, delays))


def control_system(operator, delays=0.0):
    """Return an operator as a ``control.StateSpace``."""
    return _control().ss(*_matrices(operator, delays))


def _matrices(operator, delays):
    """Return two-dimensional matrices A, B, C, D; refuse a delay, which they cannot represent."""
    if np.any(delays):
        raise ValueError(
            "A model with a delay has no finite state space. Fit one with delay=0, or convert its "
            "operator_ without the delay."
        )
    a, b, c, d = operator.state_space()
    return a, b.reshape(len(a), -1), c[None, :], np.atleast_2d(d)


def _control():
    try:
        import control
    except ImportError as error:
        raise ImportError(
            "The package 'control' is not installed. "
            'Install it with: python -m pip install "skhyst[control]"'
        ) from error
    return control
