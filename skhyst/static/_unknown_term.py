r"""A term whose law is not known: a smooth function, to be learned.

.. math:: y = p\,u + f(a), \qquad f(a) = \sum_k c_k B_k(a), \qquad c = T w

Its argument :math:`a` is the input, its rate, a play of it or the time since it has turned, and
:math:`p` is 1 where the input passes. :math:`B_k` are cubic B-splines on even knots, with the
penalty :math:`\lambda \sum (\Delta^2 c_k)^2` (P-splines, Eilers and Marx [1]_). Of two arguments it
is a surface,

.. math:: f(a, b) = \sum_{kl} c_{kl} B_k(a) B_l(b), \qquad
   \lambda \sum (\Delta_k^2 c_{kl})^2 + \lambda \rho \sum (\Delta_l^2 c_{kl})^2 .

A coefficient that depends on a signal, :math:`f(a, b) = a\,g(b)` (Hastie and Tibshirani [4]_), is a
surface that is a straight line through zero in the other one, such as a gain, a stiffness or a
damping: :math:`c_{kl} = a_k g_l`, with :math:`a_k` at the knots, which a straight line needs.

**Smoothness.** Let :math:`G` be the Gram matrix of the derivatives of the response by the spline
coefficients, after everything that the other parameters of the model can reproduce has been
projected out (partial regression, Frisch and Waugh [2]_), and :math:`S` the matrix of the penalty.
With :math:`S v_j = d_j G v_j`, :math:`v_i' G v_j = \delta_{ij}` (Demmler and Reinsch [3]_) the
functions :math:`v_j` are uncorrelated, in order of decreasing smoothness, and the penalty
multiplies the coefficient of each by :math:`1 / (1 + \lambda d_j)`. :math:`\lambda`, and
:math:`\rho` of a surface, are found by restricted maximum likelihood. The columns of :math:`T` are
these functions, without those whose coefficient is reduced to less than a hundredth. So the term is
linear in its weights, the penalty is diagonal, and both enter a joint fit like any other
parameters.

**Orthogonality.** Functions that the parameters can reproduce, as a gain reproduces a linear
function of the drive, have almost no power in :math:`G`. They are left out: the parameters keep
their meaning, and the term shows only what is missing.

**Beyond the range** of the fit, the function is held constant, or it fades: its value at the
end is multiplied by :math:`\exp(-\delta / \ell)` at the distance :math:`\delta` from it.

References
----------
.. [1] Eilers and Marx, *Statistical Science*, 1996.
.. [2] Frisch and Waugh, *Econometrica*, 1933.
.. [3] Demmler and Reinsch, *Numerische Mathematik*, 1975; Wood, *Journal of the Royal Statistical
   Society B*, 2011, of the restricted maximum likelihood.
.. [4] Hastie and Tibshirani, *Journal of the Royal Statistical Society B*, 1993.
"""

import math
from dataclasses import dataclass, replace
from numbers import Integral, Real

import numpy as np
from scipy.linalg import eigh

from .._jit import jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..operators import CompiledLaw, Operator, as_signal, parameter

ARGUMENTS = ("input", "rate", "play", "turn")
_DOABLE = 0.05**2  # fraction of a function's power below which the parameters reproduce it (5 %)
_GRID = np.logspace(-8.0, 8.0, 161)  # penalties, times the median of d_j
_RATIOS = np.logspace(-4.0, 4.0, 5)  # ratios rho of the two penalties
_LEAST = 0.01  # smallest factor 1 / (1 + penalty) of a function that is kept
_PLAY = 0.1  # half gap of a play, relative to the range of its input
_MEMORY = 3  # state values of an argument, see `follow`
_INTERVALS = {1: 40, 2: 7}  # by number of arguments: 43 B-splines, or 100
_COEFFICIENT = 20  # of a coefficient: 23 functions, but a table of 529 numbers
_LINEAR_IN = ("argument", "second")


@jit
def follow(u, kind, half_gap, dt, longest, s, at):
    """Return the argument of the function at one sample.

    ``kind`` is its index in ARGUMENTS. Its state, ``s[at : at + 3]``, is the last input (or the
    play), the last direction of motion, and the time since the last turn.
    """
    if kind == 1:
        v = (u - s[at]) / dt
        s[at] = u
    elif kind == 2:
        v = min(max(s[at], u - half_gap), u + half_gap)
        s[at] = v
    elif kind == 3:
        sign = 1.0 if u > s[at] else -1.0 if u < s[at] else 0.0
        v = 0.0 if sign * s[at + 1] < 0.0 else min(s[at + 2] + dt, longest)
        s[at + 1] = sign if sign != 0.0 else s[at + 1]
        s[at] = u
        s[at + 2] = v
    else:
        v = u
    return v


@jit
def bump(k, x):
    """Return the k-th of the four cubic B-splines that are not zero at ``x`` of an interval."""
    if k == 0:
        y = (1.0 - x) * (1.0 - x) * (1.0 - x)
    elif k == 1:
        y = 3.0 * x * x * x - 6.0 * x * x + 4.0
    elif k == 2:
        y = -3.0 * x * x * x + 3.0 * x * x + 3.0 * x + 1.0
    else:
        y = x * x * x
    return y / 6.0


@jit
def _bump_slope(k, x):
    if k == 0:
        y = -3.0 * (1.0 - x) * (1.0 - x)
    elif k == 1:
        y = 9.0 * x * x - 12.0 * x
    elif k == 2:
        y = -9.0 * x * x + 6.0 * x + 3.0
    else:
        y = 3.0 * x * x
    return y / 6.0


@jit
def spline_value(first, second, c):
    """Return the function at its arguments; ``c`` is that of :func:`unknown_term`.

    The second argument is ignored if the function has only one.
    """
    coefficients, intervals, fading = c[0], c[1], c[5]
    low, width, other, low_2, width_2 = c[7], c[8], c[9], c[10], c[11]
    n = int(intervals)
    a = (first - low) / width
    b = (second - low_2) / width_2 if other >= 0 else 0.0
    if math.isnan(a) or math.isnan(b):  # of a run that has diverged: it is no place in the table
        return a + b
    t = min(max(a, 0.0), float(n))
    z = min(max(b, 0.0), float(n))
    i = min(math.floor(t), n - 1)
    j = min(math.floor(z), n - 1)
    y = 0.0
    if other >= 0:
        for k in range(4):
            for m in range(4):
                y += bump(k, t - i) * bump(m, z - j) * coefficients[(i + k) * (n + 3) + j + m]
    else:
        for k in range(4):
            y += bump(k, t - i) * coefficients[i + k]
    if fading > 0.0:
        y *= math.exp(-fading * (abs(a - t) + abs(b - z)))
    return y


@jit
def unknown_term(u, c, s):
    """Return ``passed u + f(arguments)``; ``s`` are the states of the arguments.

    ``c`` is (spline coefficients, number of intervals, passed, dt, half gap, 1 / fading distance in
    intervals), then, for each of two arguments, (index in ARGUMENTS or -1, low end of the range,
    width of an interval).
    """
    n, passed, dt, half_gap = c[1], c[2], c[3], c[4]
    kind, low, width, other, low_2, width_2 = c[6], c[7], c[8], c[9], c[10], c[11]
    a = follow(u, kind, half_gap, dt, low + n * width, s, 0)
    b = 0.0
    if other >= 0:
        b = follow(u, other, half_gap, dt, low_2 + n * width_2, s, 3)
    return passed * u + spline_value(a, b, c)


@jit
def unknown_surface(u, c, s):
    """Do :func:`unknown_term` for a row of arguments, the first of which is the input."""
    return c[2] * u[0] + spline_value(u[0], u[1], c)


@jit
def _follow_all(u, kind, half_gap, dt, longest, s, at, v):
    for k in range(u.size):
        v[k] = follow(u[k], kind, half_gap, dt, longest, s, at)


@jit
def _tabulate(t, n, fading, table, slope, out):
    """Add functions, given by their spline coefficients, at ``t`` to ``out`` (n, n_columns).

    ``table`` (n_splines, n_columns) are the coefficients of a function per column; ``t`` (n,
    n_arguments) are arguments in intervals from the low end. ``slope`` is the number of the
    argument by which they are differentiated, -1 for none.
    """
    n_places, n_arguments = t.shape
    stride, n_columns = 1 if n_arguments == 1 else n + 3, table.shape[1]
    for r in range(n_places):
        if math.isnan(t[r].sum()):
            out[r] = math.nan
            continue
        j, z, outside, factor = 0, 0.0, 0.0, 1.0
        x = min(max(t[r, 0], 0.0), float(n))
        beyond = t[r, 0] - x
        outside = abs(beyond)
        i = min(math.floor(x), n - 1)
        x -= i
        if n_arguments == 2:
            z = min(max(t[r, 1], 0.0), float(n))
            outside += abs(t[r, 1] - z)
            if slope == 1:
                beyond = t[r, 1] - z
            j = min(math.floor(z), n - 1)
            z -= j
        if fading > 0.0:
            factor = math.exp(-fading * outside)
        by = slope
        if slope >= 0 and beyond != 0.0:  # the value alone, which fades or is constant
            factor *= -fading if beyond > 0.0 else fading
            by = -1
        for k in range(4):
            first = factor * (_bump_slope(k, x) if by == 0 else bump(k, x))
            for m in range(4 if n_arguments == 2 else 1):
                weight = first
                if n_arguments == 2:
                    weight *= _bump_slope(m, z) if by == 1 else bump(m, z)
                row = (i + k) * stride + j + m
                for column in range(n_columns):
                    out[r, column] += weight * table[row, column]


@dataclass(frozen=True)
class UnknownTermOperator(Operator):
    """Smooth function of one or two signals derived from the input; see :class:`UnknownTerm`.

    Parameters
    ----------
    weights : ndarray of shape (n_functions,)
        Units of the output: each function has a root mean square of 1 over the records that it was
        chosen from.
    basis : ndarray of shape (n_splines, n_functions)
        Coefficients of the B-splines in each function, of ``n_splines = n_intervals + 3``, or the
        square of that where there are two arguments, those of the second counted first. Fixed
        structure.
    low, high : float
        Range of the argument. Fixed structure.
    argument : {"input", "rate", "play", "turn"}, default="input"
        What it is a function of. Fixed structure.
    half_gap : float, default=0.0
        Of the play, units of the input. Fixed structure.
    passed : float, default=0.0
        Multiple of the input that is added, 1 for a stage of a series. Fixed structure.
    penalty : ndarray of shape (n_functions,) or float, default=0.0
        Of each squared weight, for each sample of a fit. Fixed structure.
    second : {"rate", "play", "turn"} or None, default=None
        The second argument, another than the first. Fixed structure.
    second_low, second_high : float
        Its range. Fixed structure.
    fade : float, default=inf
        Distance from the range over which the function fades to 1/e, as a part of the range of the
        argument; above 0. Fixed structure.
    linear_in : {"argument", "second"} or None, default=None
        The argument in which each function is a straight line through zero. Fixed structure.

    Raises
    ------
    ValueError
        If an argument is unknown or given twice, a range is empty, ``half_gap`` is negative,
        ``fade`` is not above 0, or ``basis`` has not one row per spline.

    Notes
    -----
    The state is, for each argument, the last input or the play, the direction and the time since
    the last turn. ``"rest"``: the rate is zero, the play that of a first loading, and the last turn
    so long ago that a later one gives the same value.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import UnknownTermOperator
    >>> line = UnknownTermOperator(np.array([1.0]), np.arange(-1.0, 3.0)[:, None], 0.0, 1.0)
    >>> line.run([0.0, 0.5, 2.0], dt=1.0)[0].round(6).tolist()
    [0.0, 0.5, 1.0]
    """

    weights: np.ndarray = parameter(linear=True)
    basis: np.ndarray
    low: float
    high: float
    argument: str = "input"
    half_gap: float = 0.0
    passed: float = 0.0
    penalty: np.ndarray | float = 0.0
    second: str | None = None
    second_low: float = 0.0
    second_high: float = 1.0
    fade: float = math.inf
    linear_in: str | None = None

    stage_order = 40

    def __post_init__(self):
        super().__post_init__()
        wanted = " or ".join(map(repr, ARGUMENTS))
        self._require("argument", self.argument in ARGUMENTS, f"be {wanted}")
        is_other = self.second is None or self.second in set(ARGUMENTS[1:]) - {self.argument}
        wanted = " or ".join(map(repr, ARGUMENTS[1:]))
        self._require("second", is_other, f"be None, or {wanted}, and not the argument")
        for prefix in ("", "second_"):
            low, high = getattr(self, f"{prefix}low"), getattr(self, f"{prefix}high")
            wanted = f"be finite, and above '{prefix}low'"
            self._require(f"{prefix}high", low < high < np.inf, wanted)
        is_straight = self.linear_in in (None, *_LINEAR_IN[: 2 * len(self.names) - 2])
        wanted = "be None, or of two arguments " + " or ".join(map(repr, _LINEAR_IN))
        self._require("linear_in", is_straight, wanted)
        self._require("half_gap", self.half_gap >= 0.0, "not be negative")
        self._require("fade", self.fade > 0.0, "be above 0")
        is_table = self.n_intervals > 0
        is_table = is_table and (self.n_intervals + 3) ** len(self.names) == len(self.basis)
        self._require("basis", is_table, "have as many rows as there are splines")

    @property
    def names(self):
        """The arguments."""
        return (self.argument,) if self.second is None else (self.argument, self.second)

    @property
    def free(self):
        """Numbers of the arguments in which the functions are no straight lines."""
        numbers = range(len(self.names))
        return [i for i in numbers if _LINEAR_IN[i] != self.linear_in]

    @property
    def n_intervals(self):
        """Intervals of the knots of each argument."""
        return round(len(self.basis) ** (1.0 / len(self.names))) - 3

    @property
    def memoryless(self):
        """Whether it is a function of the input."""
        return self.names == ("input",)

    @property
    def moves_at_rest(self):
        """Whether it is a function of the time since a turn."""
        return "turn" in self.names

    @property
    def of_rate(self):
        """Whether it is a function of the input and its rate."""
        return self.names == ("input", "rate")

    @property
    def at_once(self):
        """Whether the output is monotone in the input of the same instant, at any interval."""
        if "turn" in self.names or not self.passed > 0.0:
            return False
        # one point just beyond each end stands for all arguments there, where the slope is steepest
        # if the function fades
        n, out = 10 * (self.n_intervals + 3), np.inf
        sides = [
            [np.nextafter(low, -out), *np.linspace(low, high, n), np.nextafter(high, out)]
            for low, high in self.ranges
        ]
        v = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
        by = dict(zip(self.names, self.slopes(v).T, strict=True))
        least = self.passed + by.get("input", 0.0)  # a play stands, or follows
        least = np.minimum(least, least + by.get("play", 0.0))
        return bool(np.all(least > 0.0) and np.all(by.get("rate", 0.0) >= 0.0))

    def entries(self):
        """Return name and spec of each weight, with its penalty; see the base."""
        penalty = np.broadcast_to(self.penalty, np.shape(self.weights)).tolist()
        pairs = zip(super().entries(), penalty, strict=True)
        return [(name, replace(spec, penalty=value)) for (name, spec), value in pairs]

    @property
    def effective_number(self):
        """Effective degrees of freedom: the sum of the factors that the penalty leaves."""
        penalty = np.broadcast_to(self.penalty, np.shape(self.weights))
        return float(np.sum(1.0 / (1.0 + penalty)))

    @property
    def ranges(self):
        """Low and high of each argument, (n_arguments, 2)."""
        both = (self.low, self.high), (self.second_low, self.second_high)
        return np.array(both[: len(self.names)], dtype=float)

    @property
    def widths(self):
        """Distances of the knots of each argument, (n_arguments,)."""
        return np.diff(self.ranges)[:, 0] / self.n_intervals

    def knots(self):
        """Return the knots in the middle of the splines of each argument.

        Splines with a straight line's values at these knots as coefficients are this line.

        Returns
        -------
        list of ndarray of shape (n_intervals + 3,)
        """
        places = np.arange(self.n_intervals + 3) - 1.0
        return [
            low + places * width for low, width in zip(self.ranges[:, 0], self.widths, strict=True)
        ]

    def spread(self, basis):
        """Return coefficients of the splines, of functions of the free arguments.

        Parameters
        ----------
        basis : ndarray of shape (n_coefficients, n_functions)
            Coefficients of the splines of the free arguments.

        Returns
        -------
        ndarray of shape (n_splines, n_functions)
        """
        if self.linear_in is None:
            return basis
        line = self.knots()[_LINEAR_IN.index(self.linear_in)][:, None]
        return np.kron(line, basis) if self.free == [1] else np.kron(basis, line)

    @property
    def _fading(self):
        return 1.0 / (self.fade * self.n_intervals)

    def bends(self, ratio=1.0):
        """Return the second differences of the coefficients of each function.

        Parameters
        ----------
        ratio : float, default=1.0
            Weight of the differences along the second argument, relative to the first.

        Returns
        -------
        ndarray of shape (n_differences, n_functions)
        """
        n_functions = self.basis.shape[1]
        table = self.basis.reshape(*[self.n_intervals + 3] * len(self.names), n_functions)
        bends = [np.diff(table, 2, axis=i).reshape(-1, n_functions) for i in range(len(self.names))]
        bends[1:] = [np.sqrt(ratio) * second for second in bends[1:]]
        return np.concatenate(bends)

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample; see the base."""
        if self.memoryless:
            return ()
        if initial_state == "zero":
            return (0.0,) * (_MEMORY * len(self.names))
        play = min(max(0.0, u0 - self.half_gap), u0 + self.half_gap)
        last = [float(play if name == "play" else u0) for name in self.names]
        both = zip(last, self.ranges[:, 1].tolist(), strict=True)
        return tuple(value for start, longest in both for value in (start, 0.0, longest))

    def arguments(self, u, dt, state=None):
        """Return the argument of the function.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Input.
        dt : float
            Sampling interval in s.
        state : tuple, default=None
            State before; None is rest.

        Returns
        -------
        v : ndarray of shape (n_samples,), or (n_samples, 2) of two arguments
            Argument: units of the input, of a rate per s, of a time s.
        state : tuple
            State after the last sample.
        """
        v, state = self._followed(as_signal(u), dt, state)
        return v[:, 0] if self.second is None else v, state

    def _followed(self, u, dt, state):
        if self.memoryless or not u.size:
            return u[:, None] * np.ones(len(self.names)), state or ()
        s = np.array(self.init(u[0]) if state is None else state, dtype=float)
        v = np.empty((len(self.names), u.size))
        for i, name in enumerate(self.names):
            kind, longest = ARGUMENTS.index(name), self.ranges[i, 1]
            _follow_all(u, kind, self.half_gap, dt, longest, s, _MEMORY * i, v[i])
        return np.ascontiguousarray(v.T), tuple(s.tolist())

    def _at(self, v, table, slope=-1):
        """Return the splines of a table at arguments, or their slopes by one argument."""
        v = np.asarray(v, dtype=float).reshape(-1, len(self.names))
        places = (v - self.ranges[:, 0]) / self.widths
        out = np.zeros((len(v), table.shape[1]))
        table = np.ascontiguousarray(table, dtype=float)
        _tabulate(places, self.n_intervals, self._fading, table, slope, out)
        return out if slope < 0 else out / self.widths[slope]

    def functions(self, v):
        """Return the functions that the weights belong to.

        Parameters
        ----------
        v : ndarray of shape (n_samples,) or (n_samples, n_arguments)
            Arguments.

        Returns
        -------
        ndarray of shape (n_samples, n_functions)
        """
        return self._at(v, self.basis)

    def slopes(self, v):
        """Return the derivatives of the term by its arguments.

        Parameters
        ----------
        v : ndarray of shape (n_samples,) or (n_samples, n_arguments)
            Arguments.

        Returns
        -------
        ndarray of shape (n_samples, n_arguments)
        """
        table = (self.basis @ self.weights)[:, None]
        return np.concatenate([self._at(v, table, i) for i in range(len(self.names))], axis=1)

    def run(self, u, dt, state=None):
        """Return the output and the state after the last sample; see the base."""
        u = as_signal(u)
        v, state = self._followed(u, dt, state)
        return self.passed * u + self._at(v, (self.basis @ self.weights)[:, None])[:, 0], state

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Return the output and its derivatives; see the base."""
        u, du = as_signal(u), as_signal(du)
        if not u.size:
            return u.copy(), np.empty((0, du.shape[1] + self.n_parameters))
        state = self.init(u[0], initial_state)
        v, _ = self._followed(u, dt, state)
        functions = self.functions(v)
        y, dy = self.passed * u + functions @ self.weights, self.passed * du
        if du.shape[1]:
            for i, slope in enumerate(self.slopes(v).T):
                dy = dy + slope[:, None] * self._moved(i, v, du, dt, initial_state, state)
        return y, np.concatenate([dy, functions], axis=1)

    def _moved(self, i, v, du, dt, initial_state, state):
        """Return the tangents of an argument."""
        name, is_rest = self.names[i], initial_state == "rest"
        if name == "rate":
            return np.diff(du, axis=0, prepend=du[:1] if is_rest else 0.0 * du[:1]) / dt
        if name == "play":
            play = state[_MEMORY * i]
            moves = np.diff(v[:, i], prepend=play) != 0.0
            last = np.maximum.accumulate(np.where(moves, np.arange(len(v)), -1))
            return np.where(last[:, None] >= 0, du[last], du[:1] * (is_rest and play != 0.0))
        return du if name == "input" else np.zeros_like(du)

    def surface(self, v):
        """Return the output, its derivatives by its arguments, and by the weights.

        Parameters
        ----------
        v : ndarray of shape (n_samples, n_arguments)
            Arguments, the first of which is the input.

        Returns
        -------
        y : ndarray of shape (n_samples,)
            Output.
        slopes : ndarray of shape (n_samples, n_arguments)
            By the arguments.
        own : ndarray of shape (n_samples, n_functions)
            By the weights.
        """
        functions, slopes = self.functions(v), self.slopes(v)
        slopes[:, 0] += self.passed
        return self.passed * v[:, 0] + functions @ self.weights, slopes, functions

    def compiled_surface(self):
        """Return one step, of a row of the arguments, in plain arithmetic."""
        return CompiledLaw(unknown_surface, self.compiled_step(1.0, ()).constants, (0.0,))

    def compiled_step(self, dt, state):
        """Return one step in plain arithmetic; see the base."""
        coefficients = np.asarray(self.basis @ self.weights, dtype=float)
        law = [coefficients, self.n_intervals, self.passed, dt, self.half_gap, self._fading]
        places = [*self.ranges[:, 0], 0.0][:2], [*self.widths, 1.0][:2]
        kinds = [*map(ARGUMENTS.index, self.names), -1][:2]
        for argument in zip(kinds, *places, strict=True):
            law += argument
        # the law has a place for what only some arguments remember
        exact = "the time since a turn, which rounding of a slow drive shifts"
        precision = exact if "turn" in self.names else ""
        return CompiledLaw(unknown_term, tuple(law), state or (0.0,), double_only=precision)


class UnknownTerm(ParametricModel):
    r"""A term whose law is not known: a smooth function of one or two signals of its input.

    .. math:: y = p\,u + \sum_k c_k B_k(a) \qquad \text{or} \qquad
       y = p\,u + \sum_{kl} c_{kl} B_k(a) B_l(b) \qquad \text{or} \qquad
       y = p\,u + a \sum_l c_l B_l(b)

    with cubic B-splines of the arguments :math:`a` and :math:`b`, whose smoothness is found by
    restricted maximum likelihood, and p = 1 where the input passes. Beyond the range that it has
    seen, the function is constant, or fades.

    Parameters
    ----------
    argument : {"input", "rate", "play", "turn"}, default="input"
        What it is a function of: the input, its rate (backward differences, per s), the play
        operator of it, or the time in s since the input last turned.
    second : {"rate", "play", "turn"} or None, default=None
        A second argument, another than the first.
    half_gap : float or None, default=None
        Half gap of the play, units of the input. None: a tenth of the range of the input.
    passes : bool, default=False
        Whether the input itself is added, as at a joint of a series.
    n_intervals : int or None, default=None
        Intervals of the knots of each argument, evenly spaced. The smoothness hardly depends on
        their number, where it is large enough. None: 40, or 7 of two arguments, 20 with
        ``linear_in``.
    fade : float or None, default=None
        Distance over which the function fades to 1/e beyond the range of the fit, as a fraction
        of that range. None: it is held constant.
    linear_in : {"argument", "second"} or None, default=None
        Of two arguments, the one that a coefficient multiplies, which is a function of the other
        one: a gain that depends on the rate with ``second="rate", linear_in="argument"``.

    Attributes
    ----------
    operator_ : UnknownTermOperator
        ``weights``, and the ``functions`` that they belong to.

    See Also
    --------
    SmoothCurve : A polynomial.
    skhyst.diagnosis.EffectSearchCV : Finds where such a term is missing, and of what (``unknown``).

    Notes
    -----
    In a composition, the term contains what its neighbours can reproduce as well, such as a linear
    function beside a gain: then the gain is not determined, and ``fit`` warns of it. In a search
    the term contains only what the parameters of the whole model cannot reproduce.

    References
    ----------
    .. [1] Eilers and Marx, *Statistical Science*, 1996.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.static import UnknownTerm
    >>> rng = np.random.default_rng(0)
    >>> u = np.sin(np.arange(2000) / 30)
    >>> y = np.abs(u) * u + 0.05 * rng.normal(size=2000)
    >>> model = UnknownTerm().fit(u.reshape(-1, 1), y)
    >>> bool(np.sqrt(np.mean((model.predict(u.reshape(-1, 1)) - np.abs(u) * u) ** 2)) < 0.01)
    True
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "argument": [StrOptions(set(ARGUMENTS))],
        "half_gap": [Interval(Real, 0, None, closed="left"), None],
        "passes": ["boolean"],
        "second": [StrOptions(set(ARGUMENTS[1:])), None],
        "n_intervals": [Interval(Integral, 1, None, closed="left"), None],
        "fade": [Interval(Real, 0, None, closed="neither"), None],
        "linear_in": [StrOptions(set(_LINEAR_IN)), None],
    }

    operator_class = UnknownTermOperator

    def __init__(
        self,
        argument="input",
        *,
        second=None,
        half_gap=None,
        passes=False,
        n_intervals=None,
        fade=None,
        linear_in=None,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.argument = argument
        self.second = second
        self.half_gap = half_gap
        self.passes = passes
        self.n_intervals = n_intervals
        self.fade = fade
        self.linear_in = linear_in

    def flexible(self, records):
        """Return the operator with all B-splines, at zero, over the range of its argument.

        Parameters
        ----------
        records : sequence of RecordData
            With its input as their drive.

        Returns
        -------
        UnknownTermOperator
        """
        half_gap, names = 0.0, [name for name in (self.argument, self.second) if name]
        if "play" in names:
            drives = np.concatenate([record.u for record in records])
            half_gap = _PLAY * np.ptp(drives) if self.half_gap is None else self.half_gap
        n = _INTERVALS[len(names)] if self.linear_in is None else _COEFFICIENT
        n = (n if self.n_intervals is None else self.n_intervals) + 3
        n = n ** len(names)
        longest = max(len(record.u) * record.dt for record in records)
        operator = UnknownTermOperator(
            np.zeros(1),
            np.zeros((n, 1)),
            0.0,
            longest,
            self.argument,
            float(half_gap),
            float(self.passes),
            second=self.second,
            second_high=longest,
            fade=np.inf if self.fade is None else float(self.fade),
            linear_in=self.linear_in,
        )
        seen, ends = [operator.arguments(record.u, record.dt)[0] for record in records], []
        for name, values in zip(names, np.concatenate(seen).reshape(-1, len(names)).T, strict=True):
            if name == "turn":
                values = values[
                    values < longest
                ]  # before the first turn it is as long ago as can be
            low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
            still = not high - low > np.spacing(max(abs(low), abs(high)))
            ends += [low - 0.5, low + 0.5] if still else [low, high]
        names = "low", "high", "second_low", "second_high"
        operator = replace(operator, **dict(zip(names, ends, strict=False)))
        basis = operator.spread(np.eye((operator.n_intervals + 3) ** len(operator.free)))
        return replace(operator, basis=basis, weights=np.zeros(basis.shape[1]))

    def starting_values(self, records):
        operator, total = self.flexible(records), 0.0
        for record in records:
            functions = operator.functions(operator.arguments(record.u, record.dt)[0])
            columns = np.c_[functions, operator.passed * record.u - record.y]
            columns *= np.sqrt(record.counts())[:, None]
            total = total + columns.T @ columns
        n_samples = sum(record.counts().sum() for record in records)
        return [smooth(operator, total, slice(0, len(total) - 1), n_samples)]


def smooth(operator, gram, columns, n_samples, independent=1.0):
    """Return a flexible operator with the smoothness of the restricted maximum likelihood.

    Parameters
    ----------
    operator : UnknownTermOperator
        Its functions are the B-splines.
    gram : ndarray of shape (n + 1, n + 1)
        Gram matrix of the Jacobian of the whole model and of prediction minus response.
    columns : slice or ndarray of int
        Which columns of the Jacobian are those of the B-splines.
    n_samples : float
        How many samples it is a sum over.
    independent : float, default=1.0
        Number of independent samples that those are worth, relative to theirs: below 1 where the
        noise is coloured.

    Returns
    -------
    UnknownTermOperator
        With weights at zero; without functions if the parameters can reproduce all of them.
    """
    k = np.arange(len(gram) - 1)[columns]
    rest = np.setdiff1d(np.arange(len(gram) - 1), k)
    both = np.append(k, len(gram) - 1)
    partial = gram[np.ix_(both, both)]
    if rest.size:  # the complement of what the other parameters can reproduce
        scale = np.sqrt(np.diag(gram)[rest])
        scale[scale == 0.0] = 1.0
        inner = gram[np.ix_(rest, rest)] / np.outer(scale, scale)
        outer = gram[np.ix_(rest, both)] / scale[:, None]
        partial = partial - outer.T @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ outer
    # directions in which the B-splines have power that the parameters cannot reproduce
    splines = gram[np.ix_(k, k)]
    power, vectors = np.linalg.eigh(splines)
    has_power = power > 1e-10 * power.max(initial=0.0)
    n_left, fits = n_samples - rest.size, []
    for ratio in _RATIOS if len(operator.free) > 1 else [1.0]:
        bends = operator.bends(ratio)
        axes, unseen = vectors[:, has_power] / np.sqrt(power[has_power]), vectors[:, ~has_power]
        # where there are no samples, the functions continue as smoothly as the penalty allows
        axes = axes - unseen @ np.linalg.lstsq(bends @ unseen, bends @ axes, rcond=None)[0]
        part, turned = np.linalg.eigh(axes.T @ partial[:-1, :-1] @ axes)
        axes = axes @ turned[:, part > _DOABLE]
        if not axes.shape[1]:
            return replace(operator, weights=np.empty(0), basis=operator.basis[:, :0], penalty=0.0)
        inner = axes.T @ partial[:-1, :-1] @ axes
        bent = bends @ axes
        roughness, turned = eigh(bent.T @ bent, inner)
        axes = axes @ turned
        projected, power_left = axes.T @ partial[:-1, -1], partial[-1, -1]
        fits.append((*_smoothing(roughness, projected, power_left, independent * n_left), axes))
    _, penalty, axes = min(fits, key=lambda fit: fit[0])
    kept = 1.0 / (1.0 + penalty) >= min(_LEAST, 1.0 / (1.0 + penalty.min()))
    basis, penalty = np.sqrt(n_samples) * axes[:, kept], penalty[kept]
    weights = np.zeros(basis.shape[1])
    return replace(operator, weights=weights, basis=operator.basis @ basis, penalty=penalty)


def _smoothing(roughness, coefficients, power, n_samples):
    """Return the deviance and the penalty of each function by the restricted maximum likelihood.

    ``found`` are the least-squares coefficients of orthonormal functions, ``power`` the total sum
    of squares. With the penalty as a prior, each coefficient has the variance ``s^2 (1 + 1 /
    (lambda d))``, the rest of ``n_samples`` independent samples ``s^2``.
    """
    # a linear function has a roughness of rounding; the roughest are seen by hardly any sample
    rounding = len(roughness) * np.finfo(float).eps
    bent = roughness > 10.0 * rounding * roughness.max(initial=0.0)
    white = max(power - np.square(coefficients).sum(), np.finfo(float).tiny)
    n = max(n_samples - np.count_nonzero(~bent), 1.0)
    if not bent.any():
        return n * np.log(white), np.zeros(len(roughness))
    d, z = roughness[bent], np.square(coefficients[bent])
    penalties = _GRID / np.median(d)
    ratio = 1.0 + 1.0 / np.multiply.outer(penalties, d)
    deviance = np.log(ratio).sum(axis=1) + n * np.log(white + (z / ratio).sum(axis=1))
    best = np.argmin(deviance)
    return deviance[best], np.where(bent, penalties[best] * roughness, 0.0)
