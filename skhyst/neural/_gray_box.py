"""Gray-box network: quasi-static hysteresis plus a network of its dynamics.

It is a recursion that adds a polynomial of past signals to a known output. With the window
``z = [w(k), ..., w(k - n_w), y(k - 1), ..., y(k - n_y)]`` and ``x = mix z``

    y(k) = level(k) + sum_t weights[t] prod_j x[terms[t, j]]

where -1 among the ``terms`` is the factor one. ``w`` and ``y`` begin with their past.
"""

import dataclasses
import math
import warnings
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import combinations_with_replacement
from numbers import Integral
from typing import Literal, overload

import numpy as np
from scipy.linalg import block_diag

from .._jit import bind, jit
from .._sklearn import Interval, StrOptions
from ..base import ParametricModel
from ..exceptions import DivergenceWarning
from ..hysteresis import SystemLevelHysteresis, SystemLevelOperator
from ..operators import CompiledLaw, Operator, ParameterSpec, as_signal, sum_of_products
from ..optimize import IdentificationResult, identify

_LARGEST = 1e100  # largest output; squares of larger ones may overflow


@jit(inline=True)
def _signals(mix, w, at_w, n_w, y, at_y, x, at_x):
    """Write a sample's signals from ``x[at_x]`` on; its w and y are ``w[at_w]`` and ``y[at_y]``."""
    for i in range(mix.shape[0]):
        value = 0.0
        for j in range(n_w + 1):
            value += mix[i, j] * w[at_w - j]
        for j in range(1, mix.shape[1] - n_w):
            value += mix[i, n_w + j] * y[at_y - j]
        x[at_x + i] = value


@jit(inline=True)
def _sample(level, mix, terms, weights, w, at_w, n_w, y, at_y, x, at_x):
    """Write y of a sample, NaN once the recursion has diverged; see :func:`_signals`."""
    _signals(mix, w, at_w, n_w, y, at_y, x, at_x)
    total = level + sum_of_products(weights, terms, x, at_x)
    y[at_y] = total if abs(total) <= _LARGEST else math.nan


@jit
def gray_box_run(level, w, mix, terms, weights, y):
    """Fill ``y``, (n_y + n_samples,), after its past of n_y samples."""
    n_w, n_y = w.size - level.size, y.size - level.size
    x = np.empty(mix.shape[0])
    for k in range(level.size):
        _sample(level[k], mix, terms, weights, w, n_w + k, n_w, y, n_y + k, x, 0)


def step(u, c, s):
    """Placeholder of the compiled step of the quasi-static sub-model."""
    raise NotImplementedError


def gray_box(u, c, s):
    """Return the response at one sample.

    ``c`` is (n_w, constant, whether ``w`` is the level, mix, terms, weights, *those of the
    sub-model); ``s`` is the state of the sub-model, the last n_w + 1 of ``w``, the last n_y + 1 of
    ``y``, and work space for the signals.
    """
    level = step(u, c[6:], s)
    level -= c[1]
    n_w, mix = int(c[0]), c[3]
    at_x = s.size - mix.shape[0]
    at_y = at_x - 1
    at_w = at_y - (mix.shape[1] - n_w)
    for j in range(at_w - n_w, at_y):
        s[j] = s[j + 1]
    s[at_w] = level if c[2] > 0.0 else u
    _sample(level, mix, c[4], c[5], s, at_w, n_w, s, at_y, s, at_x)
    return s[at_y] + c[1]


@cache
def _compiled_step(law):
    return bind(gray_box, law, allocates=False)


@jit
def gray_box_tangents(w, mix, terms, weights, y, dlevel, dw, dy):
    """Fill ``dy``, (n_y + n_samples, m), after its past of n_y samples.

    ``dlevel`` (n_samples, m) and ``dw`` (n_w + n_samples, m) are the tangents of the known output
    and of ``w``; the last columns of ``dy`` are those of the weights. Returns the number of samples
    before the tangents overflow.
    """
    n_samples, m = dlevel.shape
    n_w, n_y = w.size - n_samples, y.size - n_samples
    first = m - weights.size
    x, slopes = np.empty(mix.shape[0]), np.empty(mix.shape[0])
    for k in range(n_samples):
        now = n_y + k
        row = dy[now]
        for q in range(m):
            row[q] = dlevel[k, q]
        _signals(mix, w, n_w + k, n_w, y, now, x, 0)
        slopes[:] = 0.0
        for t in range(weights.size):
            product = 1.0
            for j in range(terms.shape[1]):
                if terms[t, j] < 0:
                    continue
                product *= x[terms[t, j]]
                others = weights[t]
                for i in range(terms.shape[1]):
                    if i != j and terms[t, i] >= 0:
                        others *= x[terms[t, i]]
                slopes[terms[t, j]] += others
            row[first + t] += product
        for j in range(mix.shape[1]):
            slope = 0.0
            for i in range(x.size):
                slope += slopes[i] * mix[i, j]
            if slope == 0.0:
                continue
            past = dw[n_w + k - j] if j <= n_w else dy[now - (j - n_w)]
            for q in range(m):
                row[q] += slope * past[q]
        for q in range(m):
            if not abs(row[q]) <= _LARGEST:
                return k
    return n_samples


@dataclass(frozen=True)
class GrayBoxOperator(Operator):
    r"""Quasi-static hysteresis plus a polynomial of past signals.

    .. math:: y(k) = d_H(k) + \sum_i \theta_i x_i(k) + \sum_{i \le j} \theta_{ij} x_i(k) x_j(k)

    where :math:`d_H` is the response of the system-level model to the drive. With
    ``dynamics="rate"`` the signals x are

    .. math:: \Delta d_H(k), \ldots, \Delta d_H(k - n_f + 1), \quad y(k - 1) - d_H(k), \quad
        \Delta y(k - 1), \ldots, \Delta y(k - n_y + 1), \qquad \Delta s(k) = s(k) - s(k - 1)

    and products may also have :math:`d_H(k)` minus its constant as a factor. All terms vanish at
    rest, so that the static response is that of :math:`d_H` alone. With ``degree=1`` and two lags
    each, this is the quasi-static model followed by any linear dynamics of second order with unit
    gain. With ``dynamics="printed"`` the signals are those of Ahmed and Yan (2021),
    :math:`u(k - 1), \ldots, u(k - n_f), y(k - 1), \ldots, y(k - n_y)`.

    Parameters
    ----------
    static : SystemLevelOperator
        The quasi-static sub-model.
    weights : ndarray of shape (n_terms,)
        The weights theta, by degree; see :meth:`term_names`.
    input_lags, output_lags : int, default=2
        The numbers :math:`n_f` and :math:`n_y`.
    degree : {1, 2}, default=1
        Highest degree of a product.
    dynamics : {"rate", "printed"}, default="rate"

    Raises
    ------
    ValueError
        If ``dynamics`` or ``degree`` is unknown, a number of lags is negative, or the number of
        weights is not that of the terms.

    See Also
    --------
    GrayBoxHysteresis : Its estimator.

    Notes
    -----
    Lags are in samples: the weights hold for one sampling interval. The tangents of
    :meth:`sensitivities` are NaN where the linear terms alone are unstable or the tangents
    overflow; identification rejects such weights. A run that diverges is NaN from there on.

    The state is the tuple (state of the static sub-model, last inputs, last outputs), the latest
    last. Where the printed form has no equilibrium at a drive, ``"rest"`` starts at :math:`d_H`.

    References
    ----------
    "Modeling and identification of rate dependent hysteresis in piezoelectric actuated nano-stage:
    a gray box neural network based approach", equations (15) to (22) and (30) to (38).

    Examples
    --------
    >>> from skhyst.neural import GrayBoxOperator
    >>> from skhyst.hysteresis import SystemLevelOperator
    >>> operator = GrayBoxOperator(SystemLevelOperator(1.0, 0.0, 0.0), [0.5], 0, 1)
    >>> operator.run([0.0, 1.0, 1.0, 1.0], dt=0.1)[0]
    array([0.   , 0.5  , 0.75 , 0.875])
    """

    static: SystemLevelOperator
    weights: np.ndarray
    input_lags: int = 2
    output_lags: int = 2
    degree: int = 1
    dynamics: str = "rate"

    owns_gain = True
    stage_order = 10
    moves_at_rest = True

    def __post_init__(self):
        super().__post_init__()
        for name, fine, wanted in (
            ("dynamics", self.dynamics in ("rate", "printed"), "be 'rate' or 'printed'"),
            ("degree", self.degree in (1, 2), "be 1 or 2"),
            ("input_lags", self.input_lags >= 0, "not be negative"),
            ("output_lags", self.output_lags >= 0, "not be negative"),
        ):
            if not fine:
                raise ValueError(
                    f"The '{name}' parameter of GrayBoxOperator must {wanted}. "
                    f"Got {getattr(self, name)!r} instead."
                )
        rate = self.dynamics == "rate"  # see _terms, which lists them
        n_signals = self.input_lags + self.output_lags + rate
        n_terms = math.comb(n_signals + self.degree, self.degree) - 1 - rate * self.degree
        if np.shape(self.weights) != (n_terms,):
            raise ValueError(
                f"The 'weights' parameter of GrayBoxOperator must have {n_terms} values, "
                f"one per term. Got shape {np.shape(self.weights)} instead."
            )

    @classmethod
    def at_rest(cls, static, **structure):
        """Return an operator with zero weights.

        Parameters
        ----------
        static : SystemLevelOperator
            The hysteresis.
        **structure : object
            Its other parameters.

        Returns
        -------
        GrayBoxOperator
            Whose response is that of the static part.
        """
        fields = [field for field in dataclasses.fields(cls) if not field.kw_only]
        given = {field.name: field.default for field in fields[2:]} | structure
        return cls(static, np.zeros(len(_terms(**given))), **given)

    # ---------------------------------------------------------------------------- the parameters

    @cached_property
    def _terms(self):
        return _terms(self.input_lags, self.output_lags, self.degree, self.dynamics)

    def term_names(self):
        """Return the name of each term, such as ``"dy(k-1)"``; ``e(k)`` is y(k-1) minus d(k).

        ``d`` is the response of the static sub-model; ``dd`` and ``dy`` are changes per sample.
        """
        n_f, n_y = self.input_lags, self.output_lags
        if self.dynamics == "printed":
            names = [f"u(k-{j})" for j in range(1, n_f + 1)]
            names += [f"y(k-{j})" for j in range(1, n_y + 1)]
        else:
            names = ["d(k)", *(f"dd(k-{j})" if j else "dd(k)" for j in range(n_f))]
            names += ["e(k)", *(f"dy(k-{j})" for j in range(1, n_y))][:n_y]
        return [" ".join(names[i] for i in factors if i >= 0) for factors in self._terms]

    def parameter_specs(self):
        return dict(self.entries())

    def entries(self):
        # with degree 1 the recursion is linear, so that what is linear in the static sub-model
        # stays linear in the output
        linear = self.degree == 1
        static_entries = [
            (name, dataclasses.replace(spec, linear=spec.linear and linear))
            for name, spec in self.static.entries()
        ]
        return static_entries + [(f"theta[{name}]", ParameterSpec()) for name in self.term_names()]

    @cached_property
    def n_parameters(self):
        return self.static.n_parameters + len(self.weights)

    def pack(self):
        return np.concatenate([self.static.pack(), np.asarray(self.weights, dtype=float)])

    def unpack(self, vector):
        vector, n = np.asarray(vector, dtype=float), self.static.n_parameters
        return self._with_values(
            {"static": self.static.unpack(vector[:n]), "weights": vector[n:].copy()}
        )

    # --------------------------------------------------------------------------------- the runs

    @cached_property
    def _mix(self):
        """The matrix (n_signals, n_window) that maps the window z to the signals x."""
        n_f, n_y = self.input_lags, self.output_lags
        if self.dynamics == "printed":
            return np.eye(n_f + n_y, n_f + n_y + 1, 1)
        mix = np.zeros((1 + n_f + n_y, 1 + n_f + n_y))
        mix[0, 0] = 1.0
        for j in range(n_f):
            mix[1 + j, j], mix[1 + j, j + 1] = 1.0, -1.0
        if n_y:
            mix[1 + n_f, 0], mix[1 + n_f, 1 + n_f] = -1.0, 1.0
        for j in range(1, n_y):
            mix[1 + n_f + j, n_f + j], mix[1 + n_f + j, n_f + j + 1] = 1.0, -1.0
        return mix

    def poles(self):
        """Return the poles of the linear terms alone, in the z-plane, shape (output_lags,)."""
        n_f, n_y = self.input_lags, self.output_lags
        linear = self._terms[:, 1] < 0 if self.degree == 2 else slice(None)
        gains = np.asarray(self.weights)[linear] @ self._mix[self._terms[linear, 0]][:, n_f + 1 :]
        if not n_y:
            return np.empty(0, dtype=complex)
        return np.linalg.eigvals(np.vstack([gains, np.eye(n_y - 1, n_y)])).astype(complex)

    @property
    def _constant(self):
        """The constant that is subtracted from the recursion's signals and added to its output."""
        return float(self.static.intercept) if self.dynamics == "rate" else 0.0

    def init(self, u0, initial_state="rest"):
        static = self.static.init(u0, initial_state)
        w, y = np.zeros(self.input_lags), np.zeros(self.output_lags)
        if initial_state == "rest":
            level = self.static.run(np.array([u0], dtype=float), 1.0, static)[0][0]
            w[:] = level - self._constant if self.dynamics == "rate" else u0
            y[:] = self._rest(float(u0), level)[0] - self._constant
        return static, w, y

    def _rest(self, u0, level):
        """Return the output at rest and its derivatives by level, drive and weights."""
        by_weights = np.zeros(len(self._terms))
        if self.dynamics == "rate" or not len(self._terms):
            return level, 1.0, 0.0, by_weights
        # level + c0 - (1 - c1) y + c2 y^2 = 0; the root that becomes the level at zero weights
        weights, is_output = np.asarray(self.weights, dtype=float), self._terms >= self.input_lags
        outputs = is_output.sum(axis=1)
        inputs = (self._terms >= 0).sum(axis=1) - outputs
        parts = weights * u0**inputs
        c0, c1, c2 = (float(parts[outputs == power].sum()) for power in range(3))
        square = (1.0 - c1) * (1.0 - c1) - 4.0 * c2 * (level + c0)
        if not (c1 < 1.0 and square > 0.0):
            return level, 1.0, 0.0, by_weights
        root = np.sqrt(square)
        y = 2.0 * (level + c0) / (1.0 - c1 + root)
        by_weights = u0**inputs * y**outputs / root
        by_drive = np.sum(weights * inputs * u0 ** np.maximum(inputs - 1, 0) * y**outputs) / root
        return y, 1.0 / root, by_drive, by_weights

    def run(self, u, dt, state=None):
        """Map a drive of shape (n_samples,) to the response; see :meth:`Operator.run`."""
        u = as_signal(u)
        if state is None:
            state = self.init(u[0] if u.size else 0.0)
        static, w, y = state
        level, static = self.static.run(u, dt, static)
        level = level - self._constant
        w = np.concatenate([w, level if self.dynamics == "rate" else u])
        y = np.concatenate([y, np.empty(u.size)])
        gray_box_run(level, w, self._mix, self._terms, as_signal(self.weights), y)
        start = y.size - u.size
        last = w[w.size - self.input_lags :].copy(), y[y.size - start :].copy()
        return y[start:] + self._constant, (static, *last)

    def compiled_step(self, dt, state):
        static, (_, w, y) = self.static.compiled_step(dt, state[0]), state
        options = self.input_lags, self._constant, self.dynamics == "rate"
        constants = *options, self._mix, self._terms, self.weights, *static.constants
        work_space = np.zeros(len(self._mix))
        state = np.concatenate([static.state, [0.0], w, [0.0], y, work_space])
        return CompiledLaw(_compiled_step(static.step), constants, state)

    def regressors(self, u, y, dt, initial_state="rest"):
        """Return the terms of measured outputs, and the residual that they are to explain.

        Parameters
        ----------
        u, y : ndarray of shape (n_samples,)
            Drive and measured response; before the record both are at rest at their first value.
        dt : float
            Sampling interval in s.
        initial_state : {"rest", "zero"}

        Returns
        -------
        columns : ndarray of shape (n_samples, n_terms)
        rest : ndarray of shape (n_samples,)
            Measured response minus that of the static sub-model.
        """
        u, y = as_signal(u), as_signal(y)
        level, _ = self.static.run(u, dt, self.static.init(u[0], initial_state))
        w = level - self._constant if self.dynamics == "rate" else u
        shifted = [np.append(np.full(j, w[0]), w)[: w.size] for j in range(self.input_lags + 1)]
        past = y - self._constant
        for j in range(1, self.output_lags + 1):
            shifted.append(np.append(np.full(j, past[0]), past)[: w.size])
        # the factor -1 refers to the row of ones at the end
        x = np.vstack([self._mix @ np.array(shifted), np.ones(w.size)])
        return np.prod(x[self._terms], axis=1).T, y - level

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Return the response and its tangents; see :meth:`Operator.sensitivities`."""
        u, du = as_signal(u), as_signal(du)
        n, m, n_known = u.size, du.shape[1], du.shape[1] + self.static.n_parameters
        level, dlevel = self.static.sensitivities(u, du, dt, initial_state)
        state = self.init(u[0] if n else 0.0, initial_state)
        y, _ = self.run(u, dt, state)
        known = np.zeros((n, n_known + len(self._terms)))
        known[:, :n_known] = dlevel
        rate = self.dynamics == "rate"
        if rate:
            constant = m + [name for name, _ in self.static.entries()].index("intercept")
            known[:, constant] = 0.0
            w, driven = level - self._constant, known
        else:
            w, driven = u, np.zeros_like(known)
            driven[:, :m] = du
        past_w = np.zeros((self.input_lags, known.shape[1]))
        past_y = np.zeros((self.output_lags, known.shape[1]))
        if initial_state == "rest" and n:
            past_w[:] = driven[0]
            _, by_level, by_drive, by_weights = self._rest(u[0], level[0])
            past_y[:] = by_level * known[0] + by_drive * driven[0]
            past_y[:, n_known:] += by_weights
        dw, dy = np.concatenate([past_w, driven]), np.concatenate([past_y, np.zeros_like(known)])
        w, full = np.concatenate([state[1], w]), np.concatenate([state[2], y - self._constant])
        n_finite = 0  # number of samples whose tangents are finite
        if np.isfinite(y).all() and np.all(np.abs(self.poles()) < 1.0):
            model = self._mix, self._terms, as_signal(self.weights)
            n_finite = gray_box_tangents(w, *model, full, known, dw, dy)
        dy = np.ascontiguousarray(dy[self.output_lags :])
        if n_finite < n:
            dy[:] = np.nan
        elif rate:
            dy[:, constant] = 1.0
        return y, dy


def _terms(input_lags, output_lags, degree, dynamics):
    """Return the factors of each term, (n_terms, degree), by degree; -1 for none."""
    rate = dynamics == "rate"
    signals = range(input_lags + output_lags + rate)
    rows = [
        (*factors, *[-1] * (degree - size))
        for size in range(1, degree + 1)
        for factors in combinations_with_replacement(signals, size)
        # with rates the first signal is the level: a term of it alone would not vanish at rest
        if not rate or any(factors)
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, degree)


_DIVERGED = 100.0  # an output this many ranges of the response beyond its largest has diverged
_SAME_INTERVAL = 1e-2  # largest relative difference of sampling intervals that count as equal
_SLOW = 2.0  # largest speed, relative to the slowest record, that trains the static sub-model


class GrayBoxHysteresis(ParametricModel):
    r"""Gray-box network: system-level hysteresis and a NARMAX sub-model of its dynamics.

    .. math:: y(k) = d_H(k) + \sum_i \theta_i x_i(k) + \sum_{i \le j} \theta_{ij} x_i(k) x_j(k),
        \qquad \frac{d d_H}{du} = p + \kappa \frac{1 - e^{-\lambda |u - V_{shift}|}}{\lambda}

    where :math:`V_{shift}` is the drive at its last turning point. The weights of the network are
    the parameters of this model. They are trained by Levenberg-Marquardt on the error of the free
    run, with the exact Jacobian of the whole recursion. The signals :math:`x_i` are changes of
    :math:`d_H` and of past outputs, which vanish at rest, or as printed the past drives and outputs
    themselves; see :class:`~skhyst.neural.GrayBoxOperator`.

    Parameters
    ----------
    training : {"staged", "joint"}, default="staged"
        ``"staged"``, as in Ahmed and Yan (2021): the quasi-static sub-model from the slowest
        records, then the dynamic one from all records, with the first fixed. ``"joint"``: after
        these two stages all weights are trained together on all records.
    n_static_records : int or None, default=None
        Number of records, the slowest ones, that train the quasi-static sub-model. The speed is the
        travel of the drive per second, relative to its range. None: those at most twice as fast as
        the slowest.
    variant : {"integral", "printed"}, default="integral"
        Quasi-static sub-model, as in :class:`~skhyst.hysteresis.SystemLevelHysteresis`.
    dynamics : {"rate", "printed"}, default="rate"
        Signals of the dynamic sub-model.
    input_lags, output_lags : int, default=2
        Lags of the dynamic sub-model in samples.
    degree : {1, 2}, default=1
        Highest degree of its products. Ahmed and Yan (2021) use 2; 1 is any linear dynamics of
        ``output_lags`` poles after the hysteresis.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record, with all weights.
    method : str or Method, default="levenberg_marquardt"
        How the weights are trained, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : GrayBoxOperator
    params_, params_std_ : dict
        ``slope`` p in response/drive, ``curvature`` kappa in response/drive^2, ``decay`` lambda in
        1/drive, ``intercept`` and, with the printed variant, ``rate_gain`` in response s/drive;
        ``theta[...]``, named by its product. Standard errors of the staged training are those
        of each stage, with the parameters of the other fixed.
    history_ : dict of str to ndarray
        A value for each epoch, the start of a stage being its epoch 0: ``stage`` (``"static"``,
        ``"dynamic"``, ``"joint"``), ``epoch``, ``loss`` (mean square of the error, response^2)
        and ``mu``, the damping (NaN with methods that have none).
    n_epochs_ : dict of str to int
        Epochs of each stage.
    dt_ : float
        Sampling interval of the fit in s.
    bound_ : float
        Magnitude beyond which a run has diverged: the largest response plus 100 times its range.

    Raises
    ------
    RecordError
        If ``predict`` gets records of another sampling interval than ``fit``: lags are in samples.

    See Also
    --------
    skhyst.hysteresis.SystemLevelHysteresis : The hysteresis alone.
    skhyst.autoregressive.NARMAXRegressor : The dynamics alone.

    References
    ----------
    Ahmed and Yan, *IEEE Access*, 2021, equations (15) to (22), (27) and (30) to (43).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.neural import GrayBoxHysteresis
    >>> from skhyst.neural import GrayBoxOperator
    >>> from skhyst.hysteresis import SystemLevelOperator
    >>> from skhyst.records import stack_records
    >>> plant = GrayBoxOperator(SystemLevelOperator(0.1, 0.002, 0.03), [0.3], 0, 1)
    >>> time = 0.01 * np.arange(1000)
    >>> drives = [50.0 - 50.0 * np.cos(2 * np.pi * f * time) for f in (0.1, 1.0, 2.5)]
    >>> records = [(u.reshape(-1, 1), plant.run(u, 0.01)[0]) for u in drives]
    >>> X, y = stack_records(records, dt=0.01)
    >>> model = GrayBoxHysteresis("joint", input_lags=0, output_lags=1).fit(X, y)
    >>> print(f"{model.params_['decay']:.4f} {model.params_['theta[e(k)]']:.4f}")
    0.0300 0.3000
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "training": [StrOptions({"staged", "joint"})],
        "n_static_records": [Interval(Integral, 1, None, closed="left"), None],
        "variant": [StrOptions({"integral", "printed"})],
        "dynamics": [StrOptions({"rate", "printed"})],
        "input_lags": [Interval(Integral, 0, None, closed="left")],
        "output_lags": [Interval(Integral, 0, None, closed="left")],
        "degree": [Interval(Integral, 1, 2, closed="both")],
        "fit_intercept": ["boolean"],
    }

    largest_value = 1e30  # products of several values are squared
    operator_class = GrayBoxOperator
    one_interval = True

    def __init__(
        self,
        training="staged",
        *,
        n_static_records=None,
        variant="integral",
        dynamics="rate",
        input_lags=2,
        output_lags=2,
        degree=1,
        fit_intercept=True,
        initial_state="rest",
        dt=None,
        drive=None,
        method="levenberg_marquardt",
    ):
        self.training = training
        self.n_static_records = n_static_records
        self.variant = variant
        self.dynamics = dynamics
        self.input_lags = input_lags
        self.output_lags = output_lags
        self.degree = degree
        self.fit_intercept = fit_intercept
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @overload
    def predict(self, X, y_start=None, return_std: Literal[False] = False) -> np.ndarray: ...
    @overload
    def predict(
        self, X, y_start=None, *, return_std: Literal[True]
    ) -> tuple[np.ndarray, np.ndarray]: ...
    def predict(
        self, X, y_start=None, return_std=False
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray]:
        """Return the free run: the response to the drive alone, each record from its own start.

        Outputs beyond ``bound_`` are cut off there, and a run that overflows is zero from there on,
        with a :class:`~skhyst.exceptions.DivergenceWarning`.
        """
        std = None
        if return_std:
            y, std = super().predict(X, y_start, return_std=True)
        else:
            y = super().predict(X, y_start)
        if np.abs(y).max() > self.bound_:
            warnings.warn(
                "The simulation diverged; outputs far beyond the range of the response in fit were "
                "cut off.",
                DivergenceWarning,
                stacklevel=2,
            )
            y = np.clip(y, -self.bound_, self.bound_)
        return y if std is None else (y, std)

    def starting_values(self, records):
        return [self.identify(records).operator]

    def identify(self, data):
        largest = max(np.abs(record.y).max() for record in data)
        span = max(r.y.max() for r in data) - min(r.y.min() for r in data)
        n_samples = sum(len(r.u) for r in data)
        self.bound_ = float(largest + _DIVERGED * (span or largest or 1.0))
        options = {"initial_state": self.free_run_state, "method": self.method}
        slow = self._slow_records(data)
        first = SystemLevelHysteresis(self.variant).starting_values(slow)
        static = identify(first, slow, fixed=self.held_parameters(), **options)
        stages = [_stage("static", static, sum(len(r.u) for r in slow))]
        network = GrayBoxOperator.at_rest(
            static.operator,
            input_lags=self.input_lags,
            output_lags=self.output_lags,
            degree=self.degree,
            dynamics=self.dynamics,
        )
        held = frozenset(name for name, _ in static.operator.entries())
        if network.n_parameters > len(held):
            starts = [network, *self._one_step_starts(network, data)]
            dynamic = identify(starts, data, fixed=held, **options)
            stages.append(_stage("dynamic", dynamic, n_samples))
            result = _merged(static, dynamic)
        else:
            result = dataclasses.replace(static, operator=network)
        if self.training == "joint":
            joint = identify([result.operator], data, fixed=self.held_parameters(), **options)
            stages.append(_stage("joint", joint, n_samples))
            n_evaluations = result.n_evaluations + joint.n_evaluations
            result = dataclasses.replace(joint, n_evaluations=n_evaluations)
        return _TrainingResult(**vars(result), stages=stages)

    def _slow_records(self, data):
        """Return the records that train the static sub-model."""
        ranges = np.array([np.ptp(record.u) for record in data])
        travels = np.array([np.abs(np.diff(r.u)).sum() / (r.dt * len(r.u)) for r in data])
        moving = np.flatnonzero(ranges > 0.0)
        if not len(moving):
            return data
        speeds = travels[moving] / ranges[moving]
        order = moving[np.argsort(speeds, kind="stable")]
        count = self.n_static_records
        if count is None:
            count = int(np.sum(speeds <= _SLOW * speeds.min()))
        return [data[i] for i in sorted(order[:count])]

    def _one_step_starts(self, network, data):
        """Return a list of the network fitted one step ahead, empty if that is unstable."""
        parts = [
            network.regressors(record.u, record.y, record.dt, self.free_run_state)
            for record in data
        ]
        columns = np.concatenate([part for part, _ in parts])
        residual = np.concatenate([part for _, part in parts])
        scale = np.abs(columns).max(axis=0)
        scale[scale == 0.0] = 1.0
        weights = np.linalg.lstsq(columns / scale, residual, rcond=None)[0] / scale
        start = dataclasses.replace(network, weights=weights)
        return [start] if np.all(np.abs(start.poles()) < 1.0) else []

    def adopt(self, result):
        if isinstance(result, _TrainingResult):
            stages = result.stages
        else:  # all weights were refined together
            stages = [_stage("joint", result, sum(record.n_samples for record in self.records_))]
        self.history_ = {key: np.concatenate([s[key] for s in stages]) for key in stages[0]}
        self.n_epochs_ = {s["stage"][0]: int(s["epoch"][-1]) for s in stages}
        return super().adopt(result)


@dataclass(frozen=True)
class _TrainingResult(IdentificationResult):
    stages: list = ()


def _stage(name, result, n_samples):
    """Return the history of a stage of the training."""
    count = len(result.history)
    return {
        "stage": [name] * count,
        "epoch": np.arange(count),
        "loss": [cost / n_samples for _, cost in result.history],
        "mu": result.damping or np.full(count, np.nan),
    }


def _merged(static, dynamic):
    """Return the results of the two stages as one."""
    return dataclasses.replace(
        dynamic,
        params=static.params | dynamic.params,
        params_std=static.params_std | dynamic.params_std,
        params_std_white=static.params_std_white | dynamic.params_std_white,
        undetermined=(*static.undetermined, *dynamic.undetermined),
        condition_number=max(static.condition_number, dynamic.condition_number),
        n_evaluations=static.n_evaluations + dynamic.n_evaluations,
        seconds=static.seconds + dynamic.seconds,
        x=np.concatenate([static.x, dynamic.x]),
        joint_covariance=block_diag(static.joint_covariance, dynamic.joint_covariance),
    )
