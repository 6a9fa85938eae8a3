"""A signal between its samples."""

from .._jit import jit


@jit
def cubic_weights(s):
    """Return the weights of four samples, at 0 to 3, for the value and the slope at ``s``."""
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
