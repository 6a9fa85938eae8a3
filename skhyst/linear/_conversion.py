r"""Conversion of linear systems to and from SciPy and python-control, as arrays.

A system in discrete time is that of the samples of one in continuous time whose input is held.
With :math:`A_d = e^{A h}` at the interval h and

.. math:: \Gamma_1 = \int_0^h e^{A t} dt, \qquad
   \Gamma_2 = \frac{1}{h} \int_0^h (h - t) e^{A t} dt ,

it has :math:`B_d = \Gamma_1 B` for a constant input, and for a straight line between samples
:math:`B_d = (\Gamma_1 - \Gamma_2 + A_d \Gamma_2) B` and :math:`D_d = D + C \Gamma_2 B` [1]_, which
are solved for A, B and D. Poles at z = 0 are those of delays. With :math:`A_1, B_1, C_1` of the
other poles, the impulse response is :math:`h_k = C_1 A_1^{k - 1} B_1` after a delay of d samples
and zero before it, so that :math:`A_1, A_1^d B_1, C_1, h_d` is the system without the delay.

References
----------
.. [1] Franklin, Powell and Workman, *Digital Control of Dynamic Systems*, 1990, chapter 4.
"""

import numpy as np
from scipy import signal
from scipy.linalg import block_diag, expm, logm, schur, solve_sylvester

from ._linear import complex_gain, refuse_open_hold

_NO_POLE = 1e-12  # relative coefficient of the characteristic polynomial that counts as zero
_NOTHING = 1e-9  # value of an impulse response that counts as zero, relative to its largest


def without_sampling(system, hold="foh"):
    """Return a system in continuous time, and the delays of its inputs in s, empty for none.

    That is the system itself or, for one in discrete time, the continuous system of which it has
    the samples under a hold.
    """
    dt = getattr(system, "dt", None)
    if not dt:
        return system, np.empty(0)
    refuse_open_hold(hold)
    if dt is True:
        raise ValueError(
            "The 'system' must have a sampling interval if it is in discrete time. Got one with "
            "dt = True instead."
        )
    if not hasattr(system, "A"):
        system = system.to_ss() if isinstance(system, signal.dlti) else _control().ss(system)
    matrices = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
    a, b, c, d, delays = _without_delays(*matrices)
    poles = np.linalg.eigvals(a)
    if np.any((np.abs(poles.imag) <= 1e-9 * np.abs(poles)) & (poles.real <= 0.0)):
        raise ValueError(
            "The 'system' must have no negative real pole if it is in discrete time: no system in "
            f"continuous time of its order has one. Got poles {poles} instead."
        )
    n, eye = len(a), np.eye(len(a))
    continuous = np.real(logm(a)) / dt
    block = np.zeros((3 * n, 3 * n))
    block[:n, : 2 * n] = dt * np.concatenate([continuous, eye], axis=1)
    block[n : 2 * n, 2 * n :] = eye
    e = expm(block)
    first, second = e[:n, n : 2 * n], e[:n, 2 * n :]
    if hold == "zoh":
        b = np.linalg.solve(first, b)
    else:
        b = np.linalg.solve(first - second + a @ second, b)
        d = d - c @ second @ b
    return signal.StateSpace(continuous, b, c, d), delays * dt


def _without_delays(a, b, c, d):
    """Return a system in discrete time without its poles at zero, and its delays in samples."""
    coefficients = np.abs(np.poly(a)) if len(a) else np.ones(1)
    n = int(np.flatnonzero(coefficients > _NO_POLE * coefficients.max())[-1])
    n_zero = len(a) - n
    if not n_zero:
        return a, b, c, d, np.empty(0)
    size = np.sort(np.abs(np.linalg.eigvals(a)))[::-1]
    limit = 0.5 * size[n - 1] if n else np.inf  # rounding moves k poles from zero by eps^(1 / k)
    t, z, n_kept = schur(a, output="real", sort=lambda re, im: np.hypot(re, im) > limit)
    if n_kept != n:
        raise ValueError(
            "The 'system' must have its poles at z = 0 apart from the others. Got poles "
            f"{np.linalg.eigvals(a)} instead."
        )
    # block-diagonal: the states of the other poles, decoupled from those at zero
    x = solve_sylvester(t[:n, :n], -t[n:, n:], -t[:n, n:])
    a1, b1, c1 = t[:n, :n], (z.T @ b)[:n] - x @ (z.T @ b)[n:], (c @ z)[:, :n]
    powers = [np.linalg.matrix_power(a, k) @ b for k in range(n_zero)]
    pulse = np.array([d, *(c @ response for response in powers)])
    response = [c1 @ np.linalg.matrix_power(a1, k) @ b1 for k in range(n_zero)]
    fir = np.abs(pulse - np.array([0.0 * d, *response])) > _NOTHING * np.abs(pulse).max()
    delays, b, d = np.zeros(b.shape[1]), b1.copy(), d.copy()
    for i in range(b.shape[1]):
        delay = int(np.max(np.flatnonzero(fir[:, :, i].any(axis=1)), initial=0))
        if np.any(np.abs(pulse[:delay, :, i]) > _NOTHING * np.abs(pulse).max()):
            raise ValueError(
                "The 'system' must have no pole at z = 0 but those of delays of whole samples. Got "
                f"one that responds {delay} sample(s) before that instead."
            )
        delays[i] = delay
        b[:, i] = np.linalg.matrix_power(a1, delay) @ b1[:, i]
        d[:, i] = pulse[delay, :, i]
    return a1, b, c1, d, delays if delays.any() else np.empty(0)


def poles_and_response(system):
    """Return the poles in rad/s and a function of rad/s (n,) that gives the gains (n, n_inputs)."""
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
        if n_responses == 1 and np.size(system.zeros) > len(poles):
            raise ValueError(
                "The 'system' must have no more zeros than poles: it would differentiate its "
                f"drive. Got {np.size(system.zeros)} and {len(poles)} instead."
            )
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


def control_system(operator, delays=0.0, pade=None):
    """Return an operator as a ``control.StateSpace``, delays by approximants of this order."""
    control = _control()
    if pade is None or not np.any(delays):
        return control.ss(*_matrices(operator, delays))
    approximants = [
        control.ss(control.tf(*control.pade(delay, pade))) for delay in np.ravel(delays)
    ]
    parts = [
        tuple(np.asarray(m) for m in (system.A, system.B, system.C, system.D))
        for system in approximants
    ]
    return control.ss(*_matrices(operator, 0.0)) * control.ss(*map(block_diag, *parts))


def _matrices(operator, delays):
    """Return two-dimensional matrices A, B, C, D; refuse a delay, which they cannot represent."""
    if np.any(delays):
        raise ValueError(
            "A model with a delay has no finite state space in continuous time: approximate the "
            "delay, to_control(pade=3), or go to discrete time, skhyst.export.to_control(model, "
            "dt), which is exact."
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
