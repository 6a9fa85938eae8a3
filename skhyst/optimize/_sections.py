"""Poles as sections of first and second order."""

import numpy as np

__all__ = [
    "sections",
]


def sections(poles):
    """Split poles (rad/s) into time constants, natural frequencies and damping ratios.

    Complex poles and pairs of real ones make second-order sections; a real pole that is left over,
    the slowest, makes a first-order one, and so does each real pole of the right half plane.
    """
    poles = np.asarray(poles, dtype=complex)
    upper = poles[poles.imag > 1e-9 * np.abs(poles)]
    real = np.sort(-poles[np.abs(poles.imag) <= 1e-9 * np.abs(poles)].real)
    frequencies, dampings = list(np.abs(upper)), list(-upper.real / np.abs(upper))
    constants, real = list(1.0 / real[real < 0.0]), real[real >= 0.0]
    if len(real) % 2:
        constants.append(1.0 / real[0])
        real = real[1:]
    for a, b in zip(real[::2], real[1::2], strict=True):
        frequencies.append(np.sqrt(a * b))
        dampings.append((a + b) / (2.0 * np.sqrt(a * b)))
    return np.array(constants), np.array(frequencies), np.array(dampings)
