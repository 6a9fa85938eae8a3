"""Interpolation of a signal between its samples."""

from .._jit import jit


@jit
def delay_step(u, c, s):
    """Return the delayed signal; ``c`` (4,) are the weights of the four oldest samples in ``s``.

    ``s`` is a ring buffer: the index at which the next sample is written, then the samples.
    """
    n = s.size - 1
    at = int(s[0])
    s[1 + at] = u
    at = (at + 1) % n
    s[0] = at
    y = 0.0
    for k in range(4):
        y += c[k] * s[1 + (at + k) % n]
    return y


@jit
def cubic_weights(s):
    """Return the weights of the samples at 0, 1, 2, 3 for the cubic's value and slope at ``s``."""
    values = (
        -(s - 1) * (s - 2) * (s - 3) / 6,
        s * (s - 2) * (s - 3) / 2,
        -s * (s - 1) * (s - 3) / 2,
        s * (s - 1) * (s - 2) / 6,
    )
    slopes = (
        -(3 * s * s - 12 * s + 11) / 6,
        (3 * s * s - 10 * s + 6) / 2,
        -(3 * s * s - 8 * s + 3) / 2,
        (3 * s * s - 6 * s + 2) / 6,
    )
    return values, slopes
