r"""Rational transfer functions of one input and of several.

The poles are those of sections in series: first-order lags (``time_constants``), then second-order
ones (``natural_frequencies``, ``damping_ratios``, above 1 for two real poles), stable as long as
those numbers are positive. With L_0 = u, L_i the output of section i and L the last one,

    y = gain L + numerator . (L'/w, L_{m-1} - L, L_{m-1}'/w, L_{m-2} - L_{m-1}, ...) + intercept

where a first-order section gives no derivative term. The first ``n_zeros`` of these terms span
every numerator of that degree, and all of them vanish at rest, so ``gain`` is the static gain.

Several inputs share the denominator. Their state is that of the observable form, the transposed
matrices of one input, so there are as many states as poles, plus the past of delayed inputs.
"""

import warnings
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress, product
from numbers import Integral, Real
from typing import Self

import numpy as np
from scipy.linalg import eig
from sklearn.utils.validation import check_array, check_is_fitted

from .._jit import jit
from .._sklearn import Interval, StrOptions
from .._validation import known_response, read_data, read_slices, refuse_std
from ..base import one_thread, refine, with_params
from ..exceptions import DivergenceWarning, RecordError
from ..operators import (
    CompiledColumn,
    CompiledLaw,
    CompiledSeries,
    CompiledSum,
    HeldInput,
    Series,
    parameter,
    state_space_begin,
    state_space_step,
)
from ..optimize import (
    FrequencyProblem,
    RationalBlock,
    identify_from_own_starts,
    identify_response,
    pole_starts,
    record_poles,
    sections,
    vector_fit,
)
from ..records import with_lost_rows
from ._conversion import (
    control_system,
    poles_and_response,
    scipy_system,
    without_sampling,
)
from ._delay import DelayOperator
from ._estimate_response import chosen_columns
from ._linear import (
    LinearModel,
    LinearOperator,
    decay_of,
    discretize,
    log_grid,
    refuse_open_hold,
    time_span,
)
from ._modes import ModesMixin, section_poles
from ._prediction_error import identify_one_step, one_step, one_step_starts
from ._second_order_mode import SecondOrderModeOperator, count_ringing, rates_of_sections

_EXACT = 1e-8  # relative error below which a degree of the numerator suffices
_POINTS = 8  # frequencies per pole at which responses are compared
_MOST_GROUPS = 8  # most groups of roots that a division keeps together: at most 256 divisions


@jit
def state_space_run_many(ad, b0, b1, c, d, u, x, u_previous):
    """Return the outputs (n, p) for inputs ``u`` (n, m), and the last state.

    ``b0`` and ``b1`` are (n_states, m), ``c`` is (p, n_states), ``d`` (p, m), ``u_previous`` (m,);
    the state ``x`` is not modified.
    """
    n_states, m = b0.shape
    p = c.shape[0]
    old = x.copy()
    new = np.empty(n_states)
    y = np.empty((u.shape[0], p))
    for k in range(u.shape[0]):
        for i in range(n_states):
            value = 0.0
            for j in range(m):
                last = u_previous[j] if k == 0 else u[k - 1, j]
                value += b0[i, j] * last + b1[i, j] * u[k, j]
            for j in range(n_states):
                value += ad[i, j] * old[j]
            new[i] = value
        for i in range(p):
            output = 0.0
            for j in range(m):
                output += d[i, j] * u[k, j]
            for j in range(n_states):
                output += c[i, j] * new[j]
            y[k, i] = output
        old, new = new, old
    return y, old


@dataclass(frozen=True)
class TransferFunctionOperator(LinearOperator):
    """Rational transfer function, poles as stable sections in series, numerator linear.

    The sections are first-order lags, then second-order ones. The numerator weighs slopes and
    differences of their outputs, last section first, which vanish at rest and are added to ``gain``
    times the last output.

    Parameters
    ----------
    time_constants : ndarray of shape (n_real,)
        In s.
    natural_frequencies : ndarray of shape (n_pairs,)
        In rad/s.
    damping_ratios : ndarray of shape (n_pairs,)
        Above 1 for two real poles.
    numerator : ndarray of shape (n_zeros,)
        Weights, at most one per pole.
    integrators : int, default=0
        Poles at zero behind the sections, not negative. Fixed structure. ``gain`` is then that of
        the first derivative, or of the second, of the response.

    Raises
    ------
    ValueError
        If there is not one damping ratio per natural frequency, or ``integrators`` is negative.

    Notes
    -----
    Integrators have no state of rest. With them, in ``"rest"`` the sections are at rest and the
    integrators at zero at the first sample of a record, and ``init`` also takes the states at the
    first sample (see ``n_start`` of :class:`~skhyst.operators.Operator`).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import TransferFunctionOperator
    >>> lag = TransferFunctionOperator(np.array([1.0]), np.empty(0), np.empty(0), np.empty(0))
    >>> lag.run([0.0, 1.0, 1.0], dt=1.0)[0].round(3).tolist()
    [0.0, 0.368, 0.767]
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerator: np.ndarray = parameter(linear=True, unit="response/drive")
    gain: float = parameter(linear=True, gauge=1.0, unit="response/drive", default=1.0)
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    integrators: int = 0
    signed = ("time_constants", "damping_ratios")

    def __post_init__(self):
        super().__post_init__()
        self._require_size("damping_ratios", np.size(self.natural_frequencies), "natural frequency")
        self._require("integrators", self.integrators >= 0, "not be negative")

    def parameter_specs(self):
        specs = super().parameter_specs()
        if self.integrators:
            unit = "response/(drive s)" if self.integrators == 1 else "response/(drive s^2)"
            for name in ("numerator", "gain"):
                specs[name] = replace(specs[name], unit=unit)
        return specs

    @classmethod
    def from_scipy(cls, system, *, hold="foh"):
        """Convert a system of SciPy or python-control.

        Parameters
        ----------
        system : scipy.signal.lti, dlti, control.StateSpace or control.TransferFunction
            One response, one input or several, no pole at zero, no more zeros than poles. One in
            discrete time is converted exactly to the one in continuous time that it samples under
            the hold; its poles at z = 0 become delays.
        hold : {"foh", "zoh"}, default="foh"
            Input between samples.

        Returns
        -------
        TransferFunctionOperator
            For several inputs a :class:`MultiInputTransferFunctionOperator`, for one with a delay a
            series of the delay and the transfer function.

        Raises
        ------
        ValueError
            If the system has several responses, no pole, a pole at zero, or more zeros than poles;
            or is in discrete time and samples none in continuous time under the hold, with delays
            of whole samples.
        """
        system, delays = without_sampling(system, hold)
        poles, response = poles_and_response(system)
        size = np.abs(poles)
        count = _POINTS * (len(poles) + 2)
        omega = np.geomspace(0.03 * size.min(), 30.0 * size.max(), count)
        gains, parts = response(omega), sections(poles)
        # the smallest degree of the numerator that reproduces the response
        for n_zeros in range(len(poles) + 1):
            one = cls(*parts, np.zeros(n_zeros), hold=hold)
            linear = [spec.linear for _, spec in one.entries()]
            linear[-1] = False  # the intercept
            columns = one.frequency_tangents(omega / (2.0 * np.pi))[1][:, 0, linear]
            weight = 1.0 / np.abs(columns).max(axis=1, keepdims=True)
            rows, targets = (
                np.concatenate([part.real, part.imag])
                for part in (columns * weight, gains * weight)
            )
            solution = np.linalg.lstsq(rows, targets, rcond=None)[0]
            if np.abs(rows @ solution - targets).max() <= _EXACT * np.abs(targets).max():
                break
        if gains.shape[1] == 1:
            return _behind_delay(
                cls(*parts, solution[:-1, 0], float(solution[-1, 0]), hold=hold), delays
            )
        numerators = solution[:-1].T.copy()
        return MultiInputTransferFunctionOperator(
            *parts, numerators, solution[-1], delays, hold=hold
        )

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        return scipy_system(self)

    def zeros(self):
        """Return the zeros in rad/s, complex, shape (n_zeros,)."""
        if not np.size(self.numerator):
            return np.empty(0, dtype=complex)
        a, b, c, d = self.state_space()
        unit = float(np.abs(self.poles()).max())
        pencil = np.block([[a / unit, b[:, None] / unit], [c[None, :], np.array([[d]])]])
        roots = eig(pencil, np.diag(np.r_[np.ones(len(b)), 0.0]), right=False)
        roots = roots[np.isfinite(roots)]
        # zeros at infinity become finite but large, by rounding: keep the smallest ones
        return unit * roots[np.argsort(np.abs(roots))[: np.size(self.numerator)]]

    def in_order(self):
        """Return the equivalent operator with its second-order sections by ascending frequency."""
        order = np.argsort(self.natural_frequencies, kind="stable")
        return self if np.all(np.diff(order) > 0) else self.with_modes(order)

    def with_modes(self, order):
        """Return the operator with its second-order sections in another order.

        The numerator then weighs the outputs of other sections. Its weights are those that give the
        same response, by least squares over more frequencies than there are weights.

        Parameters
        ----------
        order : ndarray of shape (n_pairs,)
            Numbers of the sections.

        Returns
        -------
        TransferFunctionOperator
        """
        moved = replace(
            self,
            natural_frequencies=self.natural_frequencies[order],
            damping_ratios=self.damping_ratios[order],
        )
        if not np.size(self.numerator):
            return moved
        return moved._with_response(self.frequency_response)

    def _with_response(self, response):
        """Return the operator with the numerator of a response, a function of frequencies in Hz."""
        size = np.concatenate([self.natural_frequencies, np.abs(1.0 / self.time_constants)])
        count = _POINTS * (sum(self.n_poles) + 2)
        frequency = np.geomspace(0.1 * size.min(), 10.0 * size.max(), count) / (2.0 * np.pi)
        first, n = len(size) + np.size(self.natural_frequencies), np.size(self.numerator)
        columns = self.frequency_tangents(frequency)[1][:, 0, first : first + n]
        plain = replace(self, numerator=np.zeros(n)).frequency_response(frequency)
        target = response(frequency) - plain
        rows, target = (np.concatenate([part.real, part.imag]) for part in (columns, target))
        scale = np.abs(rows).max(axis=0)
        numerator = np.linalg.lstsq(rows / scale, target, rcond=None)[0] / scale
        return replace(self, numerator=numerator)

    def divisions(self):
        """Return the ways to divide the operator in two in series, each with a pole at least.

        Poles and zeros go to either part, conjugate pairs together, and no part has more zeros than
        poles: these are all places where a stage may stand between the two (Sjöberg and Schoukens,
        *Automatica*, 2012). If there are more than 256 divisions, neighbours in size stay together,
        zeros first.

        Returns
        -------
        list of (TransferFunctionOperator, TransferFunctionOperator)
            The first part has unit static gain, the second one the gain and the intercept. None
            where the operator is unstable.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import TransferFunctionOperator
        >>> modes = np.array([20.0, 50.0]), np.array([0.1, 0.1])
        >>> whole = TransferFunctionOperator(np.array([0.5]), *modes, np.empty(0))
        >>> [len(first.poles()) for first, _ in whole.divisions()]
        [3, 3, 1, 4, 2, 2]
        """
        poles, zeros = self.poles(), self.zeros() if np.size(self.numerator) else np.empty(0)
        if np.any(poles.real >= 0.0) or np.any(zeros == 0.0):
            return []
        pole_groups, zero_groups = _together(poles), _together(zeros)
        while len(pole_groups) + len(zero_groups) > _MOST_GROUPS:
            groups = zero_groups if len(zero_groups) > 1 else pole_groups
            size = np.log([np.abs(group[0]) for group in groups])
            at = int(np.argmin(np.diff(size)))
            groups[at : at + 2] = [np.concatenate(groups[at : at + 2])]
        parts_in_series = []
        for own_poles in _halves(pole_groups):
            for own_zeros in _halves(zero_groups):
                sizes = [(len(p), len(z)) for p, z in zip(own_poles, own_zeros, strict=True)]
                if all(n_poles and n_zeros <= n_poles for n_poles, n_zeros in sizes):
                    parts = zip(own_poles, own_zeros, strict=True)
                    first, second = (_of_roots(*part, self.hold) for part in parts)
                    scaled = replace(
                        second,
                        gain=self.gain,
                        numerator=self.gain * second.numerator,
                        intercept=self.intercept,
                        hold="foh",  # the output of the first part is smooth
                    )
                    parts_in_series.append((first, scaled))
        return parts_in_series

    @property
    def n_poles(self):
        return np.size(self.time_constants), np.size(self.natural_frequencies)

    def with_poles(self, rates, pairs):
        frequencies, dampings = np.array(pairs, dtype=float).reshape(-1, 2).T
        return replace(
            self,
            time_constants=1.0 / np.array(rates, dtype=float),
            natural_frequencies=frequencies,
            damping_ratios=dampings,
        )

    def n_ringing(self):
        return count_ringing(self.damping_ratios)

    def lag_rates(self):
        if np.size(self.numerator) or self.integrators:
            return []
        return rates_of_sections(self.time_constants, self.natural_frequencies, self.damping_ratios)

    def linear_mode(self):
        if self.n_poles != (0, 1) or np.size(self.numerator) or self.integrators:
            return None
        pair = float(self.natural_frequencies[0]), float(self.damping_ratios[0])
        return SecondOrderModeOperator(*pair, self.gain, self.intercept, self.hold)

    def _matrices(self, p):
        n_first, n_second = self.n_poles
        lengths = n_first, n_second, n_second, np.size(self.numerator)
        tau, w, zeta, numerator, (gain, _) = np.split(p, np.cumsum(lengths))
        n = n_first + 2 * n_second
        # rows over (states, u): derivatives of the states, and outputs of the sections
        system = np.zeros((n, n + 1, p.shape[1]), dtype=p.dtype)
        unit = np.eye(n + 1, dtype=p.dtype)[..., None]
        level, terms = unit[n], []
        for i in range(n_first):
            system[i] = (level - unit[i]) / tau[i]
            terms.append([level - unit[i]])
            level = unit[i]
        for j in range(n_second):
            row = n_first + 2 * j
            after, velocity = unit[row], unit[row + 1]
            system[row] = w[j] * velocity
            system[row + 1] = w[j] * (level - after - 2.0 * zeta[j] * velocity)
            terms.append([velocity, level - after])
            level = after
        output = gain * level
        columns = [column for section in reversed(terms) for column in section]
        for weight, column in zip(numerator, columns, strict=False):
            output = output + weight * column
        return _integrated(system[:, :n], system[:, n], output[:n], output[n], self.integrators)


def _integrated(a, b, c, d, count):
    """Return the matrices of a system with integrators behind it, their states last."""
    for _ in range(count):
        a = np.pad(np.concatenate([a, c[None]]), ((0, 0), (0, 1), (0, 0)))
        b, c, d = (
            np.append(b, d[None], axis=0),
            np.append(0.0 * c, 0.0 * d[None] + 1.0, axis=0),
            0.0 * d,
        )
    return a, b, c, d


def _together(roots):
    """Return the pairs of conjugate roots, and the real ones, by size."""
    real = np.abs(roots.imag) <= 1e-9 * np.abs(roots)
    groups = [np.array([root, root.conj()]) for root in roots[~real & (roots.imag > 0.0)]]
    groups += [np.array([root.real + 0j]) for root in roots[real]]
    return sorted(groups, key=lambda group: float(np.abs(group[0])))


def _halves(groups):
    """Yield the two parts of groups of roots, each in one or the other."""
    for chosen in product((True, False), repeat=len(groups)):
        yield tuple(
            np.concatenate([np.empty(0, dtype=complex), *compress(groups, selected)])
            for selected in (chosen, [not is_chosen for is_chosen in chosen])
        )


def _of_roots(poles, zeros, hold):
    """Return the operator of unit static gain with these poles and zeros (rad/s)."""

    def response(frequency):
        s = 2j * np.pi * frequency[:, None]
        return np.prod(1.0 - s / zeros, axis=1) / np.prod(1.0 - s / poles, axis=1)

    operator = TransferFunctionOperator(*sections(poles), np.zeros(len(zeros)), hold=hold)
    return operator._with_response(response) if len(zeros) else operator


@dataclass(frozen=True)
class MultiInputTransferFunctionOperator(HeldInput):
    r"""Transfer functions of several inputs with a common denominator, added.

    .. math:: y = \sum_i e^{-\theta_i s} \frac{N_i(s)}{D(s)} u_i + \text{intercept}

    Poles and numerators are those of :class:`TransferFunctionOperator`. There are as many states as
    poles, for any number of inputs. Inputs are ``(n_samples, n_inputs)``. In a series it must be
    the first stage.

    Parameters
    ----------
    time_constants : ndarray of shape (n_real,)
        In s.
    natural_frequencies : ndarray of shape (n_pairs,)
        In rad/s.
    damping_ratios : ndarray of shape (n_pairs,)
        Above 1 for two real poles.
    numerators : ndarray of shape (n_inputs, n_zeros)
        One row per input.
    gains : ndarray of shape (n_inputs,)
        Static gains, response/drive.
    delays : ndarray of shape (n_inputs,), default=()
        In s; empty if there are none.
    intercept : float, default=0.0
        Units of the response.
    hold : {"foh", "zoh", "bandlimited"}, default="foh"
        Inputs between samples: straight lines, constant, or without content above half the sampling
        rate. Fixed structure.

    Raises
    ------
    ValueError
        If there is not one damping ratio per natural frequency, or one row of ``numerators`` and
        one delay (or none) per gain.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import MultiInputTransferFunctionOperator
    >>> lag = MultiInputTransferFunctionOperator(
    ...     np.array([1.0]), np.empty(0), np.empty(0), np.empty((2, 0)), np.array([1.0, 2.0])
    ... )
    >>> lag.run(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]), dt=1.0)[0].round(3).tolist()
    [0.0, 0.368, 0.767]
    """

    time_constants: np.ndarray = parameter(log=True, lower=0.0, unit="s")
    natural_frequencies: np.ndarray = parameter(log=True, lower=0.0, unit="rad/s")
    damping_ratios: np.ndarray = parameter(log=True, lower=0.0)
    numerators: np.ndarray = parameter(linear=True, unit="response/drive")
    gains: np.ndarray = parameter(linear=True, unit="response/drive")
    delays: np.ndarray = parameter(log=True, lower=0.0, unit="s", default=())
    intercept: float = parameter(linear=True, gauge=0.0, unit="response", default=0.0)
    hold: str = "foh"
    signal_linear = True
    reads_columns = True
    signed = ("time_constants", "damping_ratios")

    def __post_init__(self):
        super().__post_init__()
        self._require_size("damping_ratios", np.size(self.natural_frequencies), "natural frequency")
        is_right = np.shape(self.numerators)[:1] == (self.n_inputs,)
        self._require("numerators", is_right, f"have {self.n_inputs} row(s), one per gain")
        if np.size(self.delays):
            self._require_size("delays", self.n_inputs, "gain")

    def in_order(self):
        """Return the operator with its modes by frequency; see the base."""
        order = np.argsort(self.natural_frequencies, kind="stable")
        if np.all(np.diff(order) > 0):
            return self
        return replace(
            self,
            natural_frequencies=self.natural_frequencies[order],
            damping_ratios=self.damping_ratios[order],
            numerators=np.stack([part.with_modes(order).numerator for part in self._parts()]),
        )

    @property
    def n_inputs(self):
        """Number of inputs."""
        return np.size(self.gains)

    def entries(self):
        names = iter([f"numerators[{i},{j}]" for i, j in np.ndindex(np.shape(self.numerators))])
        return [
            (next(names) if name.startswith("numerators[") else name, spec)
            for name, spec in super().entries()
        ]

    @property
    def strictly_proper(self):
        return all(part.strictly_proper for part in self._parts())

    def part(self, i):
        """Return the transfer function of one input, without its delay and the intercept.

        Parameters
        ----------
        i : int
            Number of the input.

        Returns
        -------
        TransferFunctionOperator
            With the common poles.
        """
        return TransferFunctionOperator(
            self.time_constants,
            self.natural_frequencies,
            self.damping_ratios,
            self.numerators[i],
            float(self.gains[i]),
            hold=self.hold,
        )

    def _parts(self):
        return [self.part(i) for i in range(self.n_inputs)]

    def poles(self):
        """Return the poles in rad/s, complex, shape (n_states,)."""
        return self.part(0).poles()

    def slowest_decay(self):
        return decay_of(self.poles())

    def zeros(self):
        """Return the zeros of each input in rad/s: a list of complex arrays."""
        return [part.zeros() for part in self._parts()]

    def n_ringing(self):
        return count_ringing(self.damping_ratios)

    def state_space(self):
        """Return the continuous-time matrices A (n, n), B (n, n_inputs), C (n,), D (n_inputs,)."""
        a, b, c, d = zip(*(part.state_space() for part in self._parts()), strict=True)
        return np.ascontiguousarray(a[0].T), np.stack(c, axis=1), b[0], np.array(d)

    def to_scipy(self):
        """Return the continuous-time ``scipy.signal.StateSpace``, without the intercept."""
        return scipy_system(self, self.delays)

    def frequency_response(self, frequency):
        """Return the complex gains of the inputs.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        ndarray of shape (n, n_inputs)
            A column for each input.
        """
        frequency = np.asarray(frequency, dtype=float)
        gains = [part.frequency_response(frequency) for part in self._parts()]
        return np.stack(gains, axis=-1) * self._shift(frequency)

    def _shift(self, frequency):
        if not np.size(self.delays):
            return np.ones(self.n_inputs)
        return np.exp(-2j * np.pi * frequency[:, None] * self.delays)

    def frequency_tangents(self, frequency):
        """Return the complex gains of the inputs and their derivatives by the parameters.

        Parameters
        ----------
        frequency : ndarray of shape (n,)
            Hz.

        Returns
        -------
        gain : ndarray of shape (n, n_inputs)
            The complex gain of each input.
        tangents : ndarray of shape (n, n_inputs, n_parameters)
            Derivatives in the order of :meth:`pack`.
        """
        tangents = np.zeros((len(frequency), self.n_inputs, self.n_parameters), dtype=complex)
        gain = np.empty(tangents.shape[:2], dtype=complex)
        for i, part in enumerate(self._parts()):
            g, dg = part.frequency_tangents(frequency)
            gain[:, i] = g[:, 0]
            self._place(tangents[:, i], i, dg[:, 0])
        shift = self._shift(frequency)
        gain, tangents = gain * shift, tangents * shift[..., None]
        for i in range(np.size(self.delays)):
            tangents[:, i, self._delay_column(i)] = -2j * np.pi * frequency * gain[:, i]
        return gain, tangents

    def _delay_column(self, i):
        return self.n_parameters - 1 - np.size(self.delays) + i  # the intercept is last

    def _place(self, tangents, i, by_part):
        """Add the derivatives by the parameters of ``part(i)``, without its intercept, in place."""
        n_poles = sum(self.part(i).n_poles) + np.size(self.damping_ratios)
        n_inputs, n_zeros = np.shape(self.numerators)
        first = n_poles + i * n_zeros
        tangents[:, :n_poles] += by_part[:, :n_poles]
        tangents[:, first : first + n_zeros] += by_part[:, n_poles : n_poles + n_zeros]
        tangents[:, n_poles + n_inputs * n_zeros + i] += by_part[:, n_poles + n_zeros]

    def _discrete(self, dt):
        if dt not in self._memory:
            a, b, c, d = self.state_space()
            stacked = np.broadcast_to(a, (self.n_inputs, *a.shape))
            ad, b0, b1 = discretize(stacked, b.T, dt, self.hold)
            self._memory[dt] = tuple(
                np.ascontiguousarray(part) for part in (ad[0], b0.T, b1.T, c[None], d[None])
            )
        return self._memory[dt]

    def _delays(self):
        return [DelayOperator(float(delay)) for delay in self.delays]

    def init(self, u0, initial_state="rest"):
        u0 = np.asarray(u0, dtype=float)
        a, b, _, _ = self.state_space()
        at_rest = initial_state == "rest"
        x = -np.linalg.solve(a, b @ u0) if at_rest else np.zeros(len(a))
        pasts = (o.init(v, initial_state) for o, v in zip(self._delays(), u0, strict=False))
        previous = None if self.hold == "foh" and not at_rest else u0 * at_rest
        return x, previous, tuple(pasts)

    def run(self, u, dt, state=None):
        u = np.ascontiguousarray(u, dtype=float)
        x, previous, pasts = self.init(u[0]) if state is None else state
        if pasts:
            delayed = [
                delay.run(signal, dt, past)
                for delay, signal, past in zip(self._delays(), u.T, pasts, strict=True)
            ]
            u = np.stack([signal for signal, _ in delayed], axis=1)
            pasts = tuple(past for _, past in delayed)
        discrete = self._discrete(dt)
        if previous is None:
            first = discrete[-2] @ x + discrete[-1] @ u[0]
            y, x = state_space_run_many(*discrete, u[1:], x, u[0])
            y = np.vstack([first, y])
        else:
            y, x = state_space_run_many(*discrete, u, x, previous)
        return y[:, 0] + self.intercept, (x, u[-1].copy(), pasts)

    def compiled_step(self, dt, state):
        # the responses to the inputs add up, so the first can carry the whole state
        x, previous, pasts = state
        ad, b0, b1, (c,), (d,) = self._discrete(dt)
        branches = []
        for i in range(self.n_inputs):
            constants = ad, b0[:, i], b1[:, i], c, d[i], self.intercept if i == 0 else 0.0
            start = x if i == 0 else np.zeros_like(x)
            if self.hold == "foh":
                begun = previous is not None
                state = [*start, previous[i] if begun else 0.0, *start, float(begun)]
                law = CompiledLaw(state_space_begin, constants, state)
            else:
                law = CompiledLaw(state_space_step, constants, [*start, previous[i], *start])
            stages = (law,)
            if pasts:
                stages = self._delays()[i].compiled_step(dt, pasts[i]), *stages
            branches.append(CompiledColumn((CompiledSeries(stages),), i, 0.0))
        return CompiledSum(tuple(branches))

    def sensitivities(self, u, du, dt, initial_state="rest"):
        if du.ndim == 2 and du.shape[1]:
            raise ValueError(
                "A model of several inputs must come first: it cannot be driven by another one."
            )
        u, m = np.ascontiguousarray(u, dtype=float), du.shape[-1]
        propagated, tangents = np.zeros((len(u), m)), np.zeros((len(u), self.n_parameters))
        total, delays = np.zeros(len(u)), self._delays()
        for i, part in enumerate(self._parts()):
            signal, dsignal = np.ascontiguousarray(u[:, i]), np.empty((len(u), 0))
            if m:
                dsignal = np.ascontiguousarray(du[:, i])
            if delays:
                signal, dsignal = delays[i].sensitivities(signal, dsignal, dt, initial_state)
            y, by_part = part.sensitivities(signal, dsignal, dt, initial_state)
            total += y
            propagated += by_part[:, :m]
            self._place(tangents, i, by_part[:, dsignal.shape[1] :])
            if delays:
                tangents[:, self._delay_column(i)] = by_part[:, m]
        tangents[:, -1] = 1.0
        return total + self.intercept, np.hstack([propagated, tangents])


_PATIENCE = 3  # orders without improvement after which the search for an order ends
_NOISELESS = 1e-20  # fraction of the response's power below which a residual counts as zero
_WIDE = 3  # poles from which on vector fitting of records is worth its time
_FEWEST_DELAYS, _MOST_DELAYS = 9, 60  # number of candidates of a fitted delay
_TURN = 0.4  # largest step between two candidates, in periods of the highest line
_FOLLOWED = 6  # number of best starts that are refined by least squares


def choose_orders(fit, n_poles, n_zeros, max_poles):
    """Return the fit with the orders that minimise Schwarz's criterion (BIC), where not given.

    The number of poles ("auto") is chosen first, with one zero less than poles unless the zeros are
    given; then the number of zeros (None). Of orders without residual, the smallest is chosen.
    ``fit(n_poles, n_zeros)`` returns a result, the number of real residuals and the sum of squares
    of the response.
    """
    tried = {}

    def criterion(order):
        if order not in tried:
            result, n, power = fit(*order)
            squares = max(result.error**2, _NOISELESS * power / n, np.finfo(float).tiny)
            tried[order] = n * np.log(squares) + len(result.params) * np.log(n), result
        return tried[order][0]

    def usual(n):
        return n, n - 1 if n_zeros is None else n_zeros

    if n_poles == "auto":
        best = lowest = max(n_zeros or 1, 1)
        for n in range(lowest, max(max_poles, lowest) + 1):
            if criterion(usual(n)) < criterion(usual(best)):
                best = n
            elif n - best >= _PATIENCE:
                break
        n_poles = best
    orders = [(n_poles, m) for m in (range(n_poles + 1) if n_zeros is None else [n_zeros])]
    result = tried[min(orders, key=criterion)][1]
    return replace(result, n_evaluations=sum(r.n_evaluations for _, r in tried.values()))


def _behind_delay(operator, delays):
    """Return the operator of a single input after its delay, if it has one."""
    if not np.size(delays):
        return operator
    return Series(("delay", "transfer_function"), (DelayOperator(float(delays[0])), operator))


def _several(parts, n_zeros, n_inputs, delays, hold):
    """Return an operator of several inputs with the sections ``parts`` and zero numerators."""
    numerators, gains = np.zeros((n_inputs, n_zeros)), np.ones(n_inputs)
    return MultiInputTransferFunctionOperator(*parts, numerators, gains, delays, hold=hold)


def held_names(n_inputs, delay, fit_gain):
    """Return the entries of an operator of several inputs that are not fitted."""
    held = set() if fit_gain else {f"gains[{i}]" for i in range(n_inputs)}
    if not isinstance(delay, str):
        held |= {f"delays[{i}]" for i in range(np.size(delay))}
    return held


def record_starts(records, n_poles, n_zeros, delay, hold):
    """Return starting operators for records, whose ``u`` is (n_samples,) or of several inputs.

    ``delay`` is "fit", or the delays in s: one per input, or an empty array for none.
    """
    dt, span = time_span(records)
    several = records[0].u.ndim > 1
    n_inputs = records[0].u.shape[1] if several else 1
    data = [(record.u, record.y, record.dt) for record in records]
    pole_sets = [] if several else pole_starts(data, n_poles)
    if several or n_poles >= _WIDE:
        poles = record_poles(data, n_poles)
        pole_sets = pole_sets if poles is None else [poles, *pole_sets]
    candidates = [sections(poles) for poles in pole_sets]
    n_first, n_second = n_poles % 2, n_poles // 2
    for w in log_grid(6.0 / span, 1.5 / dt, 2):
        spread = w * 1.5 ** np.arange(n_second)
        candidates.append((np.full(n_first, 1.0 / w), spread, np.full(n_second, 0.2)))
    delays = np.full(n_inputs, dt) if isinstance(delay, str) else delay
    if several:
        return [_several(parts, n_zeros, n_inputs, delays, hold) for parts in candidates]
    return [
        _behind_delay(TransferFunctionOperator(*parts, np.zeros(n_zeros), hold=hold), delays)
        for parts in candidates
    ]


def _through(record, count):
    """Return a record with its drive integrated ``count`` times, without polynomial trends."""
    u, rows = record.u, np.arange(len(record.u))
    for _ in range(count):
        u = record.dt * np.append(0.0, np.cumsum(0.5 * (u[1:] + u[:-1])))
    # the unknown state at the start, and a constant of the drive, add a polynomial of this degree
    u, y = (
        part - np.polynomial.Polynomial.fit(rows, part, min(count, len(rows) - 1))(rows)
        for part in (u, record.y)
    )
    return replace(record, u=u, y=y)


def _with_integrators(operator, count):
    """Return an operator with integrators behind it, or behind its delay."""
    if hasattr(operator, "stages"):
        delay, rational = operator.stages
        return replace(operator, stages=(delay, replace(rational, integrators=count)))
    return replace(operator, integrators=count)


def fit_response(
    frequency, response, std, n_poles, n_zeros, *, delay, hold, stable, single, fit_gain, method
):
    """Fit a frequency response (n, n_inputs) with given orders; see :func:`choose_orders`.

    ``delay`` is as in :func:`record_starts`; ``single`` asks for the operator of a single input.
    """
    n_inputs = response.shape[1]
    weight = _weight(response, std)
    s = 2j * np.pi * frequency
    candidates = [delay] if not isinstance(delay, str) else _delays(frequency, response, weight)
    starts = []
    for delays in candidates:
        undelayed = response * np.exp(s[:, None] * delays) if np.size(delays) else response
        blocks = [
            RationalBlock(undelayed[:, i], np.ones((len(s), 1)), weight[:, i])
            for i in range(n_inputs)
        ]
        poles, cost = vector_fit(s, blocks, n_poles, feedthrough=n_zeros >= n_poles, stable=stable)
        starts.append((cost, _several(sections(poles), n_zeros, n_inputs, delays, hold)))
    fixed = held_names(n_inputs, delay, fit_gain) | {"intercept"}
    problems = [
        FrequencyProblem(operator, frequency, response, weight, fixed=fixed)
        for _, operator in sorted(starts, key=lambda start: start[0])[:_FOLLOWED]
    ]
    result = identify_response(problems, method=method)
    if single:
        result = _single(result)
    return result, 2 * response.size, float(np.sum(np.abs(weight * response) ** 2))


def _weight(response, std):
    """Return reciprocal standard deviations, or 1 / RMS of the response where none are known."""
    if std is None or not np.any(std > 0.0):
        return np.full(response.shape, 1.0 / np.sqrt(np.mean(np.abs(response) ** 2)))
    # the weight of a line is limited: a standard deviation near 0 is chance
    return 1.0 / np.maximum(std, 0.1 * np.median(std[std > 0.0]))


def _delays(frequency, response, weight):
    """Return candidate delays in s, up to the largest one that the slope of the phase allows."""
    steps = np.angle(response[1:] * response[:-1].conj())
    power = (weight[1:] * np.abs(response[1:])) ** 2
    slopes = -steps / (2.0 * np.pi * np.diff(frequency)[:, None])
    most = max(float(np.max(np.sum(power * slopes, axis=0) / np.sum(power, axis=0))), 0.0)
    most, shortest = 1.2 * most, 0.01 / frequency.max()
    count = int(np.clip(most * frequency.max() / _TURN, _FEWEST_DELAYS, _MOST_DELAYS))
    parts = np.linspace(0.0, most, count)
    return [np.full(response.shape[1], max(part, shortest)) for part in parts]


def _single(result):
    """Return the result of one input with the operator and the names of a single input."""
    many = result.operator
    prefix = "transfer_function__" if np.size(many.delays) else ""

    def renamed(name):
        if name == "delays[0]":
            return "delay__delay"
        return prefix + name.replace("numerators[0,", "numerator[").replace("gains[0]", "gain")

    return replace(
        result,
        operator=_behind_delay(many.part(0), many.delays),
        params={renamed(name): value for name, value in result.params.items()},
        params_std={renamed(name): value for name, value in result.params_std.items()},
        params_std_white={renamed(n): value for n, value in result.params_std_white.items()},
        undetermined=tuple(map(renamed, result.undetermined)),
    )


class TransferFunction(ModesMixin, LinearModel):
    r"""Rational transfer functions of one input or several, with a delay.

    .. math:: y = \sum_i G_i\, u_i, \qquad G_i(s) = e^{-\theta_i s} \frac{N_i(s)}{D(s)}

    All inputs share the denominator: as many states as poles. The poles are stable by
    construction, the numerators are solved exactly for given poles.

    :meth:`fit` identifies the free run over records, starting from the iteration of Steiglitz and
    McBride [1]_ and from vector fitting [2]_ of the records' transforms;
    :meth:`fit_frequency_response` identifies :math:`G(j \omega)` itself, weighted by its
    uncertainty.

    Parameters
    ----------
    n_poles : int or "auto", default=2
        Degree of the denominator. ``"auto"`` tries 1, 2, ... ``max_poles`` and takes the one with
        the smallest BIC of the residual, which is assumed white: a residual of other effects raises
        the order.
    n_zeros : int or None, default=0
        Degree of the numerators, at most ``n_poles``; None chooses it by the same criterion.
    max_poles : int, default=8
        Largest degree that ``"auto"`` tries.
    inputs : {"drive", "all"} or list of int or str, default="drive"
        The columns of X that are inputs: the first, all, or those with these positions or names. A
        model of several inputs must come first in a composition; there, inputs go by position.
    delay : float, array-like of shape (n_inputs,) or "fit", default=0.0
        Delay in s, fixed, for all inputs or one for each; or fitted, one for each.
    integrators : int, default=0
        Poles at zero, in addition to the ``n_poles``, which may then be 0; only with
        ``inputs="drive"``. They are known, so that only the others have standard errors. A record
        starts at its own response: with ``initial_state="estimate"`` all states at its first sample
        are fitted.
    stable : bool, default=True
        False allows poles in the right half-plane, as for a plant that is stabilised by feedback.
        :meth:`fit` then minimises the errors of predictions one step ahead instead of the free run,
        with the gain of the predictor and the state at each record's start (prediction-error method
        [4]_), for one input without a delay, a given number of poles and one sampling interval. The
        noise is modelled by white innovations. Within another model, which is fitted by its free
        run, the poles are stable.

    Attributes
    ----------
    operator_ : TransferFunctionOperator, behind a DelayOperator where there is a delay
        ``time_constants`` (s), ``natural_frequencies`` (rad/s), ``damping_ratios``, ``numerator``,
        ``gain``, ``intercept``; ``poles()``, ``frequency_response(frequency)``. With ``inputs``
        other than "drive" a MultiInputTransferFunctionOperator.
    zeros_ : ndarray of shape (n_zeros,), complex, or list of such
        rad/s; a list, one array per input, unless ``inputs="drive"``.
    fit_error_ : float
        Root mean square of the residual; with ``stable=False`` that of predictions one step ahead;
        after :meth:`fit_frequency_response` that of real and imaginary parts in units of their
        standard deviation.
    predictor_gain_ : ndarray of shape (n_states,)
        With ``stable=False`` and :meth:`fit`: the gain from the prediction error to the states of
        ``operator_`` (of its ``state_space()``), see :meth:`predict_one_step`.

    Raises
    ------
    ValueError
        If ``n_zeros`` exceeds ``n_poles``, or an input does not exist.

    See Also
    --------
    ModalModel : Several inputs and responses with common modes.
    SecondOrderMode : A single mode.
    frequency_response : The response without a model.

    References
    ----------
    .. [1] Steiglitz and McBride, *IEEE Transactions on Automatic Control*, 1965.
    .. [2] Gustavsen and Semlyen, *IEEE Transactions on Power Delivery*, 1999.
    .. [3] Pintelon and Schoukens, *System Identification*, 2012, ch. 6, 9 and 11.
    .. [4] Ljung, *System Identification*, 1999, sections 7.2 and 13.4.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import SecondOrderModeOperator, TransferFunction
    >>> drive = np.random.default_rng(0).normal(size=500)
    >>> y, _ = SecondOrderModeOperator(60.0, 0.05, gain=3.0).run(drive, 0.01)
    >>> model = TransferFunction(n_poles=2, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.gain:.3f}")
    3.000
    """

    operator_class = TransferFunctionOperator
    _parameter_constraints = {
        **LinearModel._parameter_constraints,
        "n_poles": [Interval(Integral, 0, None, closed="left"), StrOptions({"auto"})],
        "n_zeros": [Interval(Integral, 0, None, closed="left"), None],
        "max_poles": [Interval(Integral, 1, None, closed="left")],
        "integrators": [Interval(Integral, 0, 2, closed="both")],
        "inputs": [StrOptions({"drive", "all"}), list, tuple],
        "delay": [Interval(Real, 0, None, closed="left"), StrOptions({"fit"}), "array-like"],
        "stable": ["boolean"],
    }

    def __init__(
        self,
        n_poles=2,
        *,
        n_zeros=0,
        max_poles=8,
        integrators=0,
        inputs="drive",
        delay=0.0,
        stable=True,
        fit_gain=True,
        fit_intercept=True,
        hold="foh",
        initial_state="rest",
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.n_poles = n_poles
        self.n_zeros = n_zeros
        self.max_poles = max_poles
        self.integrators = integrators
        self.inputs = inputs
        self.delay = delay
        self.stable = stable
        self.fit_gain = fit_gain
        self.fit_intercept = fit_intercept
        self.hold = hold
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    @property
    def reads_columns(self):
        """Whether further columns of X are read."""
        return not (isinstance(self.inputs, str) and self.inputs == "drive")

    def operator_input(self, X, slices):
        if hasattr(self, "_response_inputs"):
            return X if self.reads_columns else X[:, 0], [None] * len(slices)
        signal, schedules = super().operator_input(X, slices)
        return X[:, self.input_positions(X.shape[1])] if self.reads_columns else signal, schedules

    def input_positions(self, n_columns, names=None) -> list[int]:
        """Return the positions of the inputs among the columns of X.

        Parameters
        ----------
        n_columns : int
            Number of columns of X.
        names : sequence of str, default=None
            Their names; by default those of the fit.

        Returns
        -------
        list of int
        """
        if isinstance(self.inputs, str):
            return list(range(n_columns if self.inputs == "all" else 1))
        if names is None:
            names = getattr(self, "feature_names_in_", ())
        return chosen_columns(self.inputs, names, n_columns, "TransferFunction")

    def _delay_of(self, n_inputs):
        """Return "fit", or the delays in s: one per input, or an empty array for none."""
        if isinstance(self.delay, str):
            return self.delay
        delays = np.asarray(self.delay)
        possible = delays.ndim <= 1 and delays.size in (1, n_inputs) and delays.dtype != bool
        if not (possible and np.all(delays >= 0.0)):
            raise ValueError(
                "The 'delay' parameter of TransferFunction must be 'fit', a number that is not "
                f"negative, or one for each of {n_inputs} input(s). Got {self.delay!r} instead."
            )
        delays = np.broadcast_to(delays, n_inputs).astype(float)
        return delays if delays.any() else np.empty(0)

    def held_parameters(self) -> frozenset[str]:
        fixed = super().held_parameters()
        if self.integrators and self.initial_state == "estimate":  # each record has its own
            fixed |= {"intercept"}
        if self.reads_columns:
            n_inputs = getattr(self, "_n_inputs", 1)
            held = held_names(n_inputs, self._delay_of(n_inputs), self.fit_gain)
            return frozenset(held | (fixed & {"intercept"}))
        delay = self._delay_of(1)
        if not np.size(delay):
            return fixed
        held = set() if isinstance(delay, str) else {"delay__delay"}
        return frozenset(held | {f"transfer_function__{name}" for name in fixed})

    def _check_orders(self):
        if self.n_poles == 0 and not self.integrators:
            raise ValueError(
                "The 'n_poles' parameter of TransferFunction must be above 0 without integrators. "
                "Got 0 instead."
            )
        if self.integrators and self.reads_columns:
            raise ValueError(
                "The 'integrators' parameter of TransferFunction must be 0 unless 'inputs' is "
                f"'drive'. Got {self.integrators!r} instead."
            )
        n_poles = self.max_poles if self.n_poles == "auto" else self.n_poles
        if self.n_zeros is not None and self.n_zeros > n_poles:
            name = "max_poles" if self.n_poles == "auto" else "n_poles"
            raise ValueError(
                f"The 'n_zeros' parameter of TransferFunction must be at most '{name}' = "
                f"{n_poles}. Got {self.n_zeros} instead."
            )

    def _check_free_run(self):
        self._check_orders()
        if not self.stable:  # alone it is fitted by predictions one step ahead
            raise ValueError(
                "The 'stable' parameter of TransferFunction must be True as a part of another "
                "model, which is fitted by its free run. Got False instead; a fitted one takes "
                "part in a FrozenEstimator."
            )

    def record_data(self, slices, X, y):
        self.__dict__.pop("_response_inputs", None)  # of an earlier fit to a frequency response
        records = super().record_data(slices, X, y)
        if self.reads_columns:
            self._n_inputs = records[0].u.shape[1]
        return records

    def starting_values(self, records):
        self._check_free_run()
        if self.n_poles == "auto" or self.n_zeros is None:
            return [self._choose(records).operator]
        return self._starts_of(records, self.n_poles, self.n_zeros)

    def _starts_of(self, records, n_poles, n_zeros):
        n_inputs = records[0].u.shape[1] if self.reads_columns else 1
        options = n_poles, n_zeros, self._delay_of(n_inputs), self.hold
        if not self.integrators:
            return record_starts(records, *options)
        # in series the order is irrelevant: the integrated drive passes stable dynamics
        starts = record_starts([_through(r, self.integrators) for r in records], *options)
        return [_with_integrators(start, self.integrators) for start in starts]

    def identify(self, data):
        self._check_free_run()
        return self._choose(data)

    def fit_from(self, operator, X, y, *, records=None, method=None) -> Self:
        if not self.stable:
            raise ValueError(
                "The 'stable' parameter of TransferFunction must be True in 'fit_from', which "
                "refines a free run. Got False instead: 'fit' needs no starting values."
            )
        return super().fit_from(operator, X, y, records=records, method=method)

    def fit_records(self, records) -> Self:
        self.__dict__.pop("predictor_gain_", None)  # of an earlier fit
        if self.stable:
            return super().fit_records(records)
        model = self.with_hold("foh") if self.hold == "auto" else self
        result, self.predictor_gain_ = model._one_step(records)
        return self.finish(result, records)

    def _one_step(self, records):
        """Return the identification result and the gain of the predictor, one step ahead."""
        self._check_orders()
        requirements = {
            "inputs": (not self.reads_columns, "be 'drive'"),
            "delay": (not np.size(self._delay_of(1)), "be 0"),
            "hold": (self.hold != "bandlimited", "be 'foh' or 'zoh'"),
            "n_poles": (self.n_poles != "auto" and self.n_zeros is not None, "be a number, as"),
            "initial_state": (self.initial_state != "estimate", "be 'rest'"),
        }
        for name, (is_right, wanted) in requirements.items():
            if not is_right:
                more = " 'n_zeros'" if name == "n_poles" else ""
                raise ValueError(
                    f"The '{name}' parameter of TransferFunction must {wanted}{more} where "
                    f"stable=False is fitted to records. Got {getattr(self, name)!r} instead."
                )
        if len({record.dt for record in records}) > 1:
            raise ValueError(
                "Records must have one sampling interval where stable=False is fitted to them. Got "
                f"{sorted({record.dt for record in records})} s instead."
            )

        def make(*parts):
            numerator = np.zeros(self.n_zeros)
            one = TransferFunctionOperator(*parts, numerator, hold=self.hold)
            return _with_integrators(one, self.integrators)

        starts = one_step_starts(records, self.n_poles, make, self.integrators)
        # with an integrator, the fitted start of each record takes the place of the constant
        held = self.held_parameters() | ({"intercept"} if self.integrators else set())
        identified = identify_one_step(starts, records, held)
        if identified is None:
            raise RecordError(
                "TransferFunction has found no predictor of these records that is stable: they are "
                "too short, or the drive moves too little."
            )
        return identified

    def _choose(self, records):
        n_samples = sum(record.segment_weights().sum() for record in records)
        power = sum(record.power() for record in records)

        def fit(n_poles, n_zeros):
            starts = self._starts_of(records, n_poles, n_zeros)
            if self.integrators and self.initial_state == "estimate":
                options = {"fixed": self.held_parameters(), "method": self.method}
                return identify_from_own_starts(starts, records, **options), n_samples, power
            return refine(self, starts, records), n_samples, power

        return choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)

    def in_series_with(self, other):
        """Return the model of this one followed by another, or None if there is none of one kind.

        Parameters
        ----------
        other : estimator
            What follows this model.

        Returns
        -------
        TransferFunction or None
            Unfitted. None unless both have one input, no delay and orders that are known.
        """
        models = self, other
        if not isinstance(other, TransferFunction) or any(
            m.reads_columns
            or np.size(m._delay_of(1))
            or not (isinstance(m.n_poles, Integral) and isinstance(m.n_zeros, Integral))
            for m in models
        ):
            return None
        orders = {key: sum(getattr(m, key) for m in models) for key in ("n_poles", "n_zeros")}
        return with_params(self, **orders, fit_gain=True, fit_intercept=True)

    def resolved(self, operator) -> Self:
        """Return the model, unfitted, with the orders of an operator; see the base."""
        orders = {"n_poles": len(operator.poles()), "n_zeros": np.size(operator.numerator)}
        return with_params(self, **orders, hold=operator.hold)

    def adapted(self, operator):
        """Return an operator as one of this model: with its hold, and zeros at infinity.

        Parameters
        ----------
        operator : TransferFunctionOperator
            Of any order.

        Returns
        -------
        TransferFunctionOperator or None
            None if it has another number of poles, or more zeros.
        """
        missing = self.n_zeros - np.size(operator.numerator)
        if len(operator.poles()) != self.n_poles or missing < 0:
            return None
        numerator = np.append(operator.numerator, np.zeros(missing))
        return replace(operator, numerator=numerator, hold=self.hold)

    def fit_frequency_response(self, response) -> Self:
        r"""Identify the model from a frequency response.

        Minimises :math:`\sum_{k,i} |\hat G_i(f_k) - G_i(f_k)|^2 / \sigma_i(f_k)^2` over
        continuous-time G, which assumes that inputs are band-limited between samples. There is no
        intercept.

        Parameters
        ----------
        response : FrequencyResponse
            With ``std``, the lines are weighted by it.

        Returns
        -------
        self

        Raises
        ------
        ValueError
            If there are fewer lines than the parameters need, or several inputs while ``inputs``
            is "drive".
        """
        self._validate_params()
        refuse_open_hold(self.hold, HeldInput.holds)
        self._check_orders()
        g, std = response.response, response.std
        if g.shape[1] > 1 and not self.reads_columns:
            raise ValueError(
                "The 'inputs' parameter of TransferFunction must be 'all' or a list for a "
                f"frequency response of {g.shape[1]} inputs. Got 'drive' instead."
            )
        columns = self.input_positions(g.shape[1], response.input_names)
        used = response.frequency > 0.0
        frequency, g = response.frequency[used], g[used][:, columns]
        std = None if std is None else std[used][:, columns]
        fewest = (self.n_zeros or 1) if self.n_poles == "auto" else self.n_poles
        n_unknowns = fewest + len(columns) * ((self.n_zeros or 0) + 1)
        if 2 * g.size <= n_unknowns or not np.any(g):
            raise ValueError(
                f"The 'response' must have more than {n_unknowns // (2 * len(columns)) + 1} lines "
                f"above zero, and not be zero at all of them. Got {len(frequency)} lines instead."
            )

        # the response and its uncertainty with the integrators divided out: the same sum of squares
        slopes = ((2j * np.pi * frequency) ** self.integrators)[:, None]
        g, std = g * slopes, None if std is None else std * np.abs(slopes)
        fit = partial(
            fit_response,
            frequency,
            g,
            std,
            delay=self._delay_of(len(columns)),
            hold=self.hold,
            stable=self.stable,
            single=not self.reads_columns,
            fit_gain=self.fit_gain,
            method=self.method,
        )
        with one_thread():
            result = choose_orders(fit, self.n_poles, self.n_zeros, self.max_poles)
        if self.integrators:
            operator = _with_integrators(result.operator, self.integrators)
            result = replace(result, operator=operator)
        self._response_inputs = tuple(response.input_names[i] for i in columns)
        self._n_inputs = self.n_features_in_ = len(columns)
        self.records_, self.time_unit_ = (), response.time_unit
        self.dt_ = response.dt if self.dt is None else None  # it is in continuous time
        return self.adopt(result)

    def adopt(self, result):
        super().adopt(result)
        names = list(result.params)
        wanted = [
            i
            for field in ("time_constants", "natural_frequencies", "damping_ratios")
            for i, name in enumerate(names)
            if name.removeprefix("transfer_function__").startswith(f"{field}[")
        ]
        self._adopt_poles(result.covariance[np.ix_(wanted, wanted)])
        return self

    def _adopt_poles(self, covariance):
        rational, _ = self._rational()
        parts = rational.time_constants, rational.natural_frequencies, rational.damping_ratios
        self._set_modes(*section_poles(*parts), covariance)
        if self.integrators:
            self._add_integrators(self.integrators)
        self.zeros_ = rational.zeros()

    def _rational(self):
        """Return the fitted operator without the delay of a single input, and the delays."""
        operator = self.operator_
        if hasattr(operator, "stages"):
            return operator.stages[1], operator.stages[0].delay
        return operator, getattr(operator, "delays", 0.0)

    @classmethod
    def from_system(cls, system, **params) -> Self:
        """Make a fitted model from a system, for example of a data sheet.

        Parameters
        ----------
        system : scipy.signal.lti, dlti, control.StateSpace or control.TransferFunction
            One response, no pole at zero, no more zeros than poles. One in discrete time is
            converted exactly to the one in continuous time that it samples under the ``hold``; its
            poles at z = 0 become delays.
        **params
            Parameters of the model, such as ``hold``, ``initial_state``, ``dt``, which is by
            default that of a system in discrete time, and ``delay``, which is added.

        Returns
        -------
        TransferFunction
            With ``operator_``, poles and zeros; standard errors are zero.

        Raises
        ------
        ValueError
            If the system has several responses, a pole at zero, or more zeros than poles, or is in
            discrete time and samples none in continuous time under the hold; or if ``hold`` is
            "auto" or ``delay`` is "fit".

        Examples
        --------
        >>> from scipy.signal import lti
        >>> from skhyst.linear import TransferFunction
        >>> model = TransferFunction.from_system(lti([2.0], [0.5, 1.0]), dt=0.1)
        >>> model.predict([[1.0], [1.0]]).round(6)
        array([2., 2.])
        """
        model = cls(**params)
        refuse_open_hold(model.hold, HeldInput.holds)
        if isinstance(model.delay, str):
            raise ValueError(
                "The 'delay' parameter of TransferFunction.from_system must be in s, one number or "
                f"one per input. Got {model.delay!r} instead."
            )
        model.operator_ = TransferFunctionOperator.from_scipy(system, hold=model.hold)
        rational, delays = model._rational()
        single = isinstance(rational, TransferFunctionOperator)
        n_inputs = 1 if single else rational.n_inputs
        delays = np.zeros(n_inputs) + (delays if np.size(delays) else 0.0)
        model.delay = model.delay + delays if np.any(delays) else model.delay
        delays = model._delay_of(n_inputs)
        operator = _behind_delay(rational, delays) if single else replace(rational, delays=delays)
        shape = np.shape(rational.numerator if single else rational.numerators)
        model.set_params(
            n_poles=len(rational.poles()),
            n_zeros=shape[-1],
            inputs="drive" if single else "all",
            dt=model.dt or getattr(system, "dt", None) or None,
        )
        model._validate_params()
        entries = [name for name, _ in operator.entries()]
        model._n_inputs = model.n_features_in_ = n_inputs
        model._response_inputs = tuple(f"input{i}" for i in range(n_inputs))
        model.operator_, model.records_ = operator, ()
        model.dt_, model.time_unit_ = None, "s"
        model.params_ = dict(zip(entries, operator.pack().tolist(), strict=True))
        model.params_std_ = dict.fromkeys(entries, 0.0)
        model.params_std_white_ = dict.fromkeys(entries, 0.0)
        model._adopt_poles(np.zeros((model.n_poles, model.n_poles)))
        return model

    def to_scipy(self):
        """Return the fitted model as a continuous-time ``scipy.signal.StateSpace``.

        The intercept is left out.

        Raises
        ------
        ValueError
            If the model has a delay, which no finite state space has.
        """
        check_is_fitted(self)
        return scipy_system(*self._rational())

    def to_control(self, *, pade=None):
        """Return the fitted model as a continuous-time ``control.StateSpace``.

        The intercept is left out. :func:`skhyst.export.to_control` gives a system in discrete time,
        in which delays are exact.

        Parameters
        ----------
        pade : int, default=None
            Order of the Padé approximants of delays; by default these are refused.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ImportError
            If the package ``control`` is not installed.
        ValueError
            If the model has a delay and ``pade`` is not given.

        Examples
        --------
        >>> import control
        >>> from skhyst.linear import TransferFunction
        >>> model = TransferFunction.from_system(control.tf([1.0], [0.01, 1.0]), delay=0.002)
        >>> model.to_control(pade=2).nstates
        3
        """
        check_is_fitted(self)
        if pade is not None and not (isinstance(pade, Integral) and pade > 0):
            raise ValueError(
                "The 'pade' parameter of TransferFunction.to_control must be a positive integer or "
                f"None. Got {pade!r} instead."
            )
        return control_system(*self._rational(), pade)

    def predict_one_step(self, X, y) -> np.ndarray:
        """Return predictions one step ahead, of a model that was fitted by them.

        Parameters
        ----------
        X : DataFrame or array-like of shape (n_samples, n_inputs)
            As for :meth:`fit`.
        y : array-like of shape (n_samples,)
            Response. Where it is NaN, as behind the known part of a record, the model runs on
            freely.

        Returns
        -------
        ndarray of shape (n_samples,)
            Each from the responses before it; a record starts from the state estimated from its
            response.

        Raises
        ------
        AttributeError
            If the model was not fitted with ``stable=False``.

        Examples
        --------
        >>> import numpy as np
        >>> from skhyst.linear import TransferFunction
        >>> rng, y, u = np.random.default_rng(0), np.zeros(500), np.zeros(500)
        >>> for k in range(1, 500):  # an unstable plant y' = y + u, held by a proportional feedback
        ...     y[k] = np.exp(0.1) * y[k - 1] + np.expm1(0.1) * u[k - 1] + 0.01 * rng.normal()
        ...     u[k] = -3.0 * y[k] + rng.normal()
        >>> model = TransferFunction(1, stable=False, hold="zoh", dt=0.1).fit(u[:, None], y)
        >>> bool(abs(model.poles_[0] - 1.0) < 0.1)
        True
        >>> error = y - model.predict_one_step(u[:, None], y)
        >>> bool(error.std() < 0.011)
        True
        """
        check_is_fitted(self)
        if not hasattr(self, "predictor_gain_"):
            raise AttributeError(
                "TransferFunction has a predictor only after a fit to records with stable=False."
            )
        y = known_response(self, X, y)
        slices, X, _ = read_data(self, X, reset=False, bridge=True)
        slices, X, y, read = with_lost_rows(slices, X, y)
        y = y if read is None else np.where(read, y, np.nan)
        signal, _ = self.operator_input(X, slices)
        predictions = [
            one_step(self.operator_, self.predictor_gain_, signal[s.rows], y[s.rows], s.dt)
            for s in slices
        ]
        predictions = np.concatenate(predictions)
        return predictions if read is None else predictions[read]

    def predict(self, X, y_start=None, return_std=False):
        """Return the free run: the response to the inputs alone, each record from its own start.

        After :meth:`fit_frequency_response` the inputs are taken by name from a DataFrame that has
        these names, otherwise by position. An unstable model gives a
        :class:`~skhyst.exceptions.DivergenceWarning`; with ``y_start`` one that was fitted by
        predictions one step ahead continues from them, see :meth:`predict_one_step`.
        """
        check_is_fitted(self)
        if y_start is not None and hasattr(self, "predictor_gain_"):
            refuse_std(self, return_std, "that predicts one step ahead")
            return self.predict_one_step(X, y_start)
        if np.any(self.poles_.real > 0.0):
            warnings.warn(
                "The model is unstable: its free run grows without bound.",
                DivergenceWarning,
                stacklevel=2,
            )
        return super().predict(X, y_start, return_std)

    def read_inputs(self, X):
        if not hasattr(self, "_response_inputs"):
            return super().read_inputs(X)
        names = list(getattr(X, "columns", ()))
        if set(self._response_inputs) <= set(names):
            X = X[list(self._response_inputs)]
        array = check_array(X, dtype=np.float64)
        if array.shape[1] < self._n_inputs:
            raise ValueError(
                f"X must have the {self._n_inputs} input(s) {list(self._response_inputs)}. Got "
                f"{array.shape[1]} column(s) instead."
            )
        return read_slices(self, X, reset=False, bridge=True), array[:, : self._n_inputs]
