"""Shift in time of either sign between two instruments, with a skew where their clocks differ.

Between samples a smooth signal is close to the cubic through four of them. The response of a
hysteresis to a drive that is linear between samples has corners at the samples and is nearly linear
in between: a cubic would round the corners.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from .._jit import jit
from .._sklearn import StrOptions
from ..base import ParametricModel
from ..operators import CompiledLaw, Operator, in_ring, parameter
from ._interpolation import cubic_weights, delay_step
from ._linear import log_grid, time_span
from ._shift_inverse import InverseShiftOperator

LONGEST = 10**9 // 4 // 8  # longest shift of a step in samples: its memory is a quarter of a GB


def _read_at(signal, places, is_straight):
    """Return a signal (n_samples,) or (n_samples, m) interpolated at ``places``, and its slope.

    ``places`` are in samples; outside the record the signal has its first or last value.
    """
    columns = np.ascontiguousarray(signal.reshape(len(signal), -1))
    shape = (len(places), *signal.shape[1:])
    return tuple(part.reshape(shape) for part in _interpolated(columns, places, is_straight))


@jit
def _line_weights(s):
    """Return the weights of linear interpolation, as :func:`cubic_weights` does for a cubic."""
    return (0.0, 2.0 - s, s - 1.0, 0.0), (0.0, -1.0, 1.0, 0.0)


@jit
def _interpolated(columns, places, is_straight):
    last, m = len(columns) - 1, columns.shape[1]
    values, slopes = np.empty((len(places), m)), np.empty((len(places), m))
    for k in range(len(places)):
        place = min(max(places[k], -4.0), last + 4.0)  # outside, the signal is constant
        first = int(np.floor(place)) - 1
        w, v = _line_weights(place - first) if is_straight else cubic_weights(place - first)
        a, b = columns[min(max(first, 0), last)], columns[min(max(first + 1, 0), last)]
        c, d = columns[min(max(first + 2, 0), last)], columns[min(max(first + 3, 0), last)]
        for i in range(m):
            values[k, i] = w[0] * a[i] + w[1] * b[i] + w[2] * c[i] + w[3] * d[i]
            slopes[k, i] = v[0] * a[i] + v[1] * b[i] + v[2] * c[i] + v[3] * d[i]
    return values, slopes


@dataclass(frozen=True)
class TimeShiftOperator(Operator):
    """``y(t) = u(t - shift - skew t)``, t from the record's start; it is not causal.

    The output reads the input up to two samples beyond the shifted time. After the end of a signal
    its last value is used, so that a record run in pieces differs at the cuts. A constant shift can
    be stepped with a preview.

    Parameters
    ----------
    shift : float
        In s, of either sign.
    skew : float, default=0.0
        Relative difference of two clocks.
    between : {"curve", "line"}, default="curve"
        Signal between samples: a cubic polynomial or a straight line. Fixed structure.
    stage_order : int, default=60
        Place in a series. Fixed structure.

    Examples
    --------
    >>> from skhyst.linear import TimeShiftOperator
    >>> TimeShiftOperator(-1.0).run([0.0, 1.0, 2.0, 3.0], dt=1.0)[0].round(6).tolist()
    [1.0, 2.0, 3.0, 3.0]
    """

    shift: float = parameter(unit="s")
    skew: float = parameter(default=0.0)
    between: str = "curve"
    stage_order: int = 60
    signal_linear = True
    causal = False

    def init(self, u0, initial_state="rest"):
        """Return the past inputs and the time since the start; see the base."""
        return np.array([u0 if initial_state == "rest" else 0.0], dtype=float), 0.0

    def run(self, u, dt, state=None):
        """Return the output and the state after it; see the base."""
        u = np.asarray(u, dtype=float)
        if not u.size:
            return np.empty(0), state
        past, start = self.init(u[0]) if state is None else state
        whole = np.concatenate([past, u])
        time = start + dt * np.arange(len(u))
        places = len(past) + np.arange(len(u)) - self._delay_at(time) / dt
        y, _ = _read_at(whole, places, self.between == "line")
        return y, (whole, start + dt * len(u))

    def inverse(self):
        """Return the inverse of the interpolation."""
        return InverseShiftOperator(self)

    def read_at(self, n, dt):
        """Return the samples that each output reads.

        Parameters
        ----------
        n : int
            Number of samples.
        dt : float
            Sampling interval in s.

        Returns
        -------
        first : ndarray of shape (n,)
            The first of the four samples.
        weights : ndarray of shape (n, 4)
            Their weights.
        """
        places = np.clip(np.arange(n) - self._delay_at(dt * np.arange(n)) / dt, -4.0, n + 3.0)
        first = np.floor(places).astype(int) - 1
        weights = _line_weights if self.between == "line" else cubic_weights
        values, _ = weights(places - first)
        return first, np.stack(np.broadcast_arrays(*values), axis=1)

    def opposite(self):
        """Return the shift that inverts the map of the times, with the same interpolation."""
        rate = 1.0 - self.skew
        return replace(self, shift=-self.shift / rate, skew=-self.skew / rate)

    def ahead(self, dt, u0, tol=1e-9):
        """Return a step with preview of the input, and the preview in samples.

        Raises
        ------
        ValueError
            If the shift is too long to be stepped.
        NotImplementedError
            If there is a skew.
        """
        if self.skew:
            return super().ahead(dt, u0, tol)
        is_right = abs(self.shift) / dt < LONGEST
        self._require("shift", is_right, f"be within {LONGEST} samples to be stepped")
        samples = max(math.floor(-self.shift / dt) + 2, 0)
        late = samples + self.shift / dt
        back = max(math.ceil(late) + 1, 3)
        weights = _line_weights if self.between == "line" else cubic_weights
        ring = np.full(back + 1, u0, dtype=float)
        weights, _ = weights(back - late)
        return CompiledLaw(delay_step, weights, [0.0, *ring], possible=in_ring), samples

    def _delay_at(self, time):
        return self.shift + self.skew * time

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Return the output and its tangents; see the base."""
        rest, is_straight = float(initial_state == "rest"), self.between == "line"
        time = dt * np.arange(len(u))
        places = 1 + np.arange(len(u)) - self._delay_at(time) / dt
        y, slopes = _read_at(np.concatenate([rest * u[:1], u]), places, is_straight)
        du, _ = _read_at(np.concatenate([rest * du[:1], du]), places, is_straight)
        by_parameters = -slopes[:, None] / dt * np.stack([np.ones_like(time), time], axis=1)
        return y, np.concatenate([du, by_parameters], axis=1)


class TimeShift(ParametricModel):
    r"""Shift in time of either sign, by any fraction of a sample, between two instruments.

    .. math:: y(t) = u(t - \theta - \kappa t)

    It is a property of a recording, not of a device: the channels of a data logger are read one
    after another, the filters of two amplifiers differ, two instruments start at different times,
    or the rates of their clocks differ by a fraction :math:`\kappa`. Where the response leads the
    drive, the model reads future samples of the drive, which is not possible in real time.

    Parameters
    ----------
    fit_skew : bool, default=False
        Whether the clocks may differ.
    between : {"curve", "line"}, default="curve"
        Interpolation between samples: cubic, or linear, which suits the response of a hysteresis to
        a drive that is linear between samples.

    Attributes
    ----------
    operator_ : TimeShiftOperator
        ``shift`` in s, the delay of the response at the start of a record, negative if it leads;
        ``skew``, the increase of the delay in s per s.

    See Also
    --------
    Delay : Delay of a device, never negative.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import TimeShift
    >>> time = np.arange(300) * 0.01
    >>> drive, y = np.sin(time), np.sin(time + 0.003)
    >>> print(f"{TimeShift(dt=0.01).fit(drive.reshape(-1, 1), y).operator_.shift:.4f} s")
    -0.0030 s
    """

    operator_class = TimeShiftOperator
    any_interval = True

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_skew": ["boolean"],
        "between": [StrOptions({"curve", "line"})],
    }

    def __init__(
        self,
        *,
        fit_skew=False,
        between="curve",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.fit_skew = fit_skew
        self.between = between
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def starting_values(self, records):
        """Return starting operators; see the base."""
        dt, span = time_span(records)
        if self.fit_skew:  # by half an interval and by two at the end of a record
            ends = [sign * size * dt for size in (0.5, 2.0) for sign in (-1.0, 1.0)]
            return [TimeShiftOperator(0.0, end / span, self.between) for end in ends]
        sizes = [0.5 * dt, *log_grid(2.0 * dt, max(0.02 * span, 4.0 * dt), 3)]
        return [
            TimeShiftOperator(float(sign * size), between=self.between)
            for size in sizes
            for sign in (-1.0, 1.0)
        ]
