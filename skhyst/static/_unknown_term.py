r"""A term whose law is not known: a smooth function, to be learned.

.. math:: y = p\,u + f(a), \qquad f(a) = \sum_k c_k B_k(a), \qquad c = T w

Its argument :math:`a` is the input, its rate or a play of it, and :math:`p` is 1 where the input
passes. :math:`B_k` are cubic B-splines on even knots, with the penalty
:math:`\lambda \sum (\Delta^2 c_k)^2` (P-splines, Eilers and Marx [1]_).

**Smoothness.** Let :math:`G` be the Gram matrix of the response to each spline, with everything
projected out that the parameters of the rest of the model can reproduce (partial residuals, Frisch
and Waugh [2]_), and :math:`S` that of the penalty. With :math:`S v_j = d_j G v_j`, :math:`v_i' G
v_j = \delta_{ij}` (Demmler and Reinsch [3]_) the functions :math:`v_j` are uncorrelated, in order
of decreasing smoothness, and the penalty multiplies the coefficient of each by :math:`1 / (1 +
\lambda d_j)`. :math:`\lambda` is that of the restricted maximum likelihood. The columns of
:math:`T` are these functions, except those of which less than a hundredth remains. So the term is
linear in its weights, the penalty is diagonal, and both take part in a joint fit like any other
parameter.

**Orthogonality.** Functions that the parameters can reproduce, as a gain reproduces a linear
function of the drive, have almost no power in :math:`G`. They are left out: the parameters keep
their role, and the term shows what is missing.

References
----------
.. [1] Eilers and Marx, *Statistical Science*, 1996.
.. [2] Frisch and Waugh, *Econometrica*, 1933.
.. [3] Demmler and Reinsch, *Numerische Mathematik*, 1975; Wood, *Journal of the Royal Statistical
   Society B*, 2011, of the restricted maximum likelihood.
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

ARGUMENTS = ("input", "rate", "play")
_DOABLE = 0.05**2  # of a function's power: below, the parameters can do it to 5 % of its size
_GRID = np.logspace(-8.0, 8.0, 161)  # of the penalty, relative to the median of d_j
_LEAST = 0.01  # of a function that the penalty leaves
_PLAY = 0.1  # half gap of a play, relative to the range of its input


@jit
def unknown_term(u, c, s):
    """Return ``passed u + f(argument)``; ``s`` is the last input, or the play."""
    coefficients, low, width, kind, half_gap, passed, dt = c
    v = u
    if kind == 1:
        v = (u - s[0]) / dt
        s[0] = u
    elif kind == 2:
        v = min(max(s[0], u - half_gap), u + half_gap)
        s[0] = v
    if math.isnan(v):  # of a diverged run: it is no position in the table
        return v
    n = coefficients.size - 3
    t = min(max((v - low) / width, 0.0), float(n))
    i = min(math.floor(t), n - 1)
    x = t - i
    y = coefficients[i] * (1.0 - x) * (1.0 - x) * (1.0 - x)
    y += coefficients[i + 1] * (3.0 * x * x * x - 6.0 * x * x + 4.0)
    y += coefficients[i + 2] * (-3.0 * x * x * x + 3.0 * x * x + 3.0 * x + 1.0)
    y += coefficients[i + 3] * x * x * x
    return passed * u + y / 6.0


@jit
def _follow_play(u, half_gap, play, v, side):
    for k in range(u.size):
        side[k] = 0.0
        if play > u[k] + half_gap:
            play, side[k] = u[k] + half_gap, 1.0
        elif play < u[k] - half_gap:
            play, side[k] = u[k] - half_gap, 1.0
        v[k] = play
    return play


@dataclass(frozen=True)
class UnknownTermOperator(Operator):
    """Smooth function of the input, its rate or a play of it; see :class:`UnknownTerm`.

    Parameters
    ----------
    weights : ndarray of shape (n_functions,)
        Units of the output: those of functions whose root mean square is 1 where they were chosen.
    basis : ndarray of shape (n_intervals + 3, n_functions)
        Coefficients of the B-splines in each function. Fixed structure.
    low, high : float
        Range of the argument; beyond, the function is constant. Fixed structure.
    argument : {"input", "rate", "play"}, default="input"
        What it is a function of. Fixed structure.
    half_gap : float, default=0.0
        Of the play, units of the input. Fixed structure.
    passed : float, default=0.0
        What is added of the input itself, 1 at a joint of a series. Fixed structure.
    penalty : ndarray of shape (n_functions,) or float, default=0.0
        Of each squared weight, for each sample of a fit. Fixed structure.

    Notes
    -----
    The state is the last input, or the play. ``"rest"``: the rate is zero, the play that of a first
    loading.

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

    stage_order = 40

    def __post_init__(self):
        super().__post_init__()
        wanted = " or ".join(map(repr, ARGUMENTS))
        self._require("argument", self.argument in ARGUMENTS, f"be {wanted}")
        self._require("high", self.low < self.high < np.inf, "be finite, and above 'low'")
        self._require("half_gap", self.half_gap >= 0.0, "not be negative")

    @property
    def memoryless(self):
        """Whether it is a function of the input."""
        return self.argument == "input"

    @property
    def at_once(self):
        """Whether the output is monotone in the input of the same instant."""
        v = np.linspace(self.low, self.high, 10 * len(self.basis))
        slope = self.functions(v, derivative=True) @ self.weights
        return bool(self.argument != "rate" and slope.min() + self.passed > 0.0 < self.passed)

    def entries(self):
        """Return name and spec of each weight, with its penalty; see the base."""
        penalty = np.broadcast_to(self.penalty, np.shape(self.weights)).tolist()
        both = zip(super().entries(), penalty, strict=True)
        return [(name, replace(spec, penalty=own)) for (name, spec), own in both]

    @property
    def effective_number(self):
        """Number of functions, each as far as the penalty leaves it (degrees of freedom)."""
        penalty = np.broadcast_to(self.penalty, np.shape(self.weights))
        return float(np.sum(1.0 / (1.0 + penalty)))

    @property
    def width(self):
        """Distance of the knots."""
        return (self.high - self.low) / (len(self.basis) - 3)

    def init(self, u0, initial_state="rest"):
        """Return the state before the first sample; see the base."""
        if self.argument == "input":
            return ()
        if initial_state == "zero":
            return (0.0,)
        play = min(max(0.0, u0 - self.half_gap), u0 + self.half_gap)
        return (float(play if self.argument == "play" else u0),)

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
        v : ndarray of shape (n_samples,)
            Argument: units of the input, of a rate per s.
        state : tuple
            State after the last sample.
        """
        v, state, _ = self._followed(as_signal(u), dt, state)
        return v, state

    def _followed(self, u, dt, state):
        if not u.size or self.argument == "input":
            return u, () if self.argument == "input" else state or (0.0,), None
        (last,) = self.init(u[0]) if state is None else state
        if self.argument == "rate":
            return np.diff(u, prepend=last) / dt, (float(u[-1]),), None
        v, moves = np.empty(u.size), np.empty(u.size)
        last = _follow_play(u, self.half_gap, last, v, moves)
        return v, (float(last),), moves

    def functions(self, v, derivative=False):
        """Return the functions that the weights belong to, or their derivatives.

        Parameters
        ----------
        v : ndarray of shape (n_samples,)
            Argument.
        derivative : bool, default=False
            Whether the derivatives by the argument are returned.

        Returns
        -------
        ndarray of shape (n_samples, n_functions)
            At most constant outside of the range.
        """
        n = len(self.basis) - 3
        t = (v - self.low) / self.width
        i = np.clip(np.floor(np.nan_to_num(t)), 0, n - 1).astype(int)
        x = np.clip(t, 0.0, n) - i
        if derivative:
            powers = [-3.0 * (1.0 - x) ** 2, 9.0 * x**2 - 12.0 * x]
            powers += [-9.0 * x**2 + 6.0 * x + 3.0, 3.0 * x**2]
            scale = ((t >= 0.0) & (t <= n)) / (6.0 * self.width)
        else:
            powers = [(1.0 - x) ** 3, 3.0 * x**3 - 6.0 * x**2 + 4.0]
            powers += [-3.0 * x**3 + 3.0 * x**2 + 3.0 * x + 1.0, x**3]
            scale = np.full(len(x), 1.0 / 6.0)
        return sum((scale * p)[:, None] * self.basis[i + k] for k, p in enumerate(powers))

    def run(self, u, dt, state=None):
        """Return the output and the state after the last sample; see the base."""
        u = as_signal(u)
        v, state, _ = self._followed(u, dt, state)
        return self.passed * u + self.functions(v) @ self.weights, state

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Return the output and its derivatives; see the base."""
        u, du = as_signal(u), as_signal(du)
        if not u.size:
            return u.copy(), np.empty((0, du.shape[1] + self.n_parameters))
        state = self.init(u[0], initial_state)
        v, _, moves = self._followed(u, dt, state)
        dv = du
        if self.argument == "rate":
            before = du[:1] if initial_state == "rest" else 0.0 * du[:1]
            dv = np.diff(du, axis=0, prepend=before) / dt
        elif self.argument == "play":
            last = np.maximum.accumulate(np.where(moves > 0.0, np.arange(len(u)), -1))
            first = du[:1] * (initial_state == "rest" and state[0] != 0.0)
            dv = np.where(last[:, None] >= 0, du[last], first)
        own = self.functions(v)
        slope = self.functions(v, derivative=True) @ self.weights
        y = self.passed * u + own @ self.weights
        return y, np.concatenate([self.passed * du + slope[:, None] * dv, own], axis=1)

    def compiled_step(self, dt, state):
        """Return one step in plain arithmetic; see the base."""
        coefficients = np.asarray(self.basis @ self.weights, dtype=float)
        numbers = self.low, self.width, ARGUMENTS.index(self.argument), self.half_gap, self.passed
        law = (coefficients, *numbers, dt)
        # only some arguments have a state
        return CompiledLaw(unknown_term, law, state or (0.0,))


class UnknownTerm(ParametricModel):
    r"""A term of unknown law: a smooth function of the input, its rate or a play of it.

    .. math:: y = p\,u + \sum_k c_k B_k(a)

    with cubic B-splines of the argument :math:`a`, whose smoothness is found by restricted maximum
    likelihood, and p = 1 where the input passes. Beyond the range of the fit, the function is
    constant.

    Parameters
    ----------
    argument : {"input", "rate", "play"}, default="input"
        Argument of the function: the input, its rate (backward differences, per s), or a play of
        it.
    half_gap : float or None, default=None
        Half gap of the play, units of the input. None: a tenth of the range of the input.
    passes : bool, default=False
        Whether the input itself is added, as at a joint of a series.
    n_intervals : int, default=40
        Number of evenly spaced knot intervals. The smoothness hardly depends on it if it is large
        enough.

    Attributes
    ----------
    operator_ : UnknownTermOperator
        ``weights``, and the ``functions`` that they belong to.

    See Also
    --------
    SmoothCurve : A polynomial.
    skhyst.diagnosis.EffectSearchCV : Finds where such a term is missing, and of what (``unknown``).

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
        "n_intervals": [Interval(Integral, 1, None, closed="left")],
    }

    operator_class = UnknownTermOperator

    def __init__(
        self,
        argument="input",
        *,
        half_gap=None,
        passes=False,
        n_intervals=40,
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        super().__init__(initial_state=initial_state, dt=dt, drive=drive, method=method)
        self.argument = argument
        self.half_gap = half_gap
        self.passes = passes
        self.n_intervals = n_intervals

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
        half_gap = 0.0
        if self.argument == "play":
            drives = np.concatenate([record.u for record in records])
            half_gap = _PLAY * np.ptp(drives) if self.half_gap is None else self.half_gap
        n = self.n_intervals + 3
        own = self.argument, float(half_gap), float(self.passes)
        operator = UnknownTermOperator(np.zeros(n), np.eye(n), 0.0, 1.0, *own)
        seen = [operator.arguments(record.u, record.dt)[0] for record in records]
        low, high = min(map(np.min, seen)), max(map(np.max, seen))
        if not high - low > np.spacing(max(abs(low), abs(high))):
            low, high = low - 0.5, low + 0.5
        return replace(operator, low=float(low), high=float(high))

    def starting_values(self, records):
        operator, total = self.flexible(records), 0.0
        for record in records:
            own = operator.functions(operator.arguments(record.u, record.dt)[0])
            columns = np.c_[own, operator.passed * record.u - record.y]
            columns *= np.sqrt(record.counts())[:, None]
            total = total + columns.T @ columns
        n_samples = sum(record.counts().sum() for record in records)
        return [smooth(operator, total, slice(0, len(total) - 1), n_samples)]


def smooth(operator, gram, own, n_samples, independent=1.0):
    """Return a flexible operator with the smoothness of the restricted maximum likelihood.

    Parameters
    ----------
    operator : UnknownTermOperator
        Its functions are the B-splines.
    gram : ndarray of shape (n + 1, n + 1)
        Gram matrix of the Jacobian of the whole model and of prediction minus response.
    own : slice or ndarray of int
        Which columns of the Jacobian are those of the B-splines.
    n_samples : float
        How many samples it is a sum over.
    independent : float, default=1.0
        Number of independent samples that those are worth, relative to theirs: below 1 where the
        noise is coloured.

    Returns
    -------
    UnknownTermOperator
        With weights at zero; with no functions where the parameters can do all of them.
    """
    k = np.arange(len(gram) - 1)[own]
    rest = np.setdiff1d(np.arange(len(gram) - 1), k)
    both = np.append(k, len(gram) - 1)
    left = gram[np.ix_(both, both)]
    if rest.size:  # the complement of what the other parameters can reproduce
        scale = np.sqrt(np.diag(gram)[rest])
        scale[scale == 0.0] = 1.0
        inner = gram[np.ix_(rest, rest)] / np.outer(scale, scale)
        outer = gram[np.ix_(rest, both)] / scale[:, None]
        left = left - outer.T @ np.linalg.pinv(inner, rcond=1e-10, hermitian=True) @ outer
    # directions in which the B-splines have power that the parameters cannot reproduce
    every = gram[np.ix_(k, k)]
    bends = np.diff(np.eye(len(operator.basis)), 2, axis=0) @ operator.basis
    power, axes = np.linalg.eigh(every)
    seen = power > 1e-10 * power.max(initial=0.0)
    axes, unseen = axes[:, seen] / np.sqrt(power[seen]), axes[:, ~seen]
    # in a gap between samples a function is continued as smoothly as possible
    axes = axes - unseen @ np.linalg.lstsq(bends @ unseen, bends @ axes, rcond=None)[0]
    part, turned = np.linalg.eigh(axes.T @ left[:-1, :-1] @ axes)
    axes = axes @ turned[:, part > _DOABLE]
    basis, penalty = np.empty((len(k), 0)), np.empty(0)
    if axes.shape[1]:
        inner = axes.T @ left[:-1, :-1] @ axes
        roughness, turned = eigh(axes.T @ bends.T @ bends @ axes, inner)
        axes = axes @ turned
        found, n_left = axes.T @ left[:-1, -1], n_samples - rest.size
        penalty = _smoothing(roughness, found, left[-1, -1], independent * n_left)
        kept = 1.0 / (1.0 + penalty) >= min(_LEAST, 1.0 / (1.0 + penalty.min()))
        basis, penalty = np.sqrt(n_samples) * axes[:, kept], penalty[kept]
    weights = np.zeros(basis.shape[1])
    return replace(operator, weights=weights, basis=operator.basis @ basis, penalty=penalty)


def _smoothing(roughness, found, power, n_samples):
    """Return the penalty of each function by the restricted maximum likelihood.

    ``found`` are the least-squares coefficients of orthonormal functions, ``power`` the total sum
    of squares. With the penalty as a prior, each coefficient has the variance ``s^2 (1 + 1 /
    (lambda d))``, the rest of ``n_samples`` independent samples ``s^2``.
    """
    # a linear function has a roughness of rounding; the roughest are seen by hardly any sample
    rounding = len(roughness) * np.finfo(float).eps
    bent = roughness > 10.0 * rounding * roughness.max(initial=0.0)
    if not bent.any():
        return np.zeros(len(roughness))
    d, z = roughness[bent], np.square(found[bent])
    white = max(power - np.square(found).sum(), np.finfo(float).tiny)
    n = max(n_samples - np.count_nonzero(~bent), 1.0)
    penalties = _GRID / np.median(d)
    ratio = 1.0 + 1.0 / np.multiply.outer(penalties, d)
    deviance = np.log(ratio).sum(axis=1) + n * np.log(white + (z / ratio).sum(axis=1))
    return np.where(bent, penalties[np.argmin(deviance)] * roughness, 0.0)
