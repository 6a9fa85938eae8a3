"""The inverse of an operator whose output depends on the input of the same sample, by root finding.

At each sample the input is found for which a step gives the wanted output. The search starts at the
last input and doubles its steps until the root is bracketed. Then it uses the Illinois variant of
false position, but never farther from the middle of the bracket than keeps its width within 8 times
that of bisection (the projection of the ITP method: Oliveira and Takahashi, *ACM Transactions on
Mathematical Software*, 2020). A root far smaller than the first bracket has few digits then: its
order of magnitude is found by geometric means, and the rest of its digits as before. So the number
of evaluations is bounded for any law. Evaluations use a copy of the state; the step is then taken
with the input that was found.
"""

import math
from dataclasses import dataclass
from functools import partial
from types import FunctionType

import numpy as np

from .._jit import bind
from ._compiled_step import CompiledLaw, CompiledStep
from ._protocol import Operator, as_signal

_DOUBLINGS = 12  # most doublings of the first step, up to the range between the limits
_STEPS = 100  # search steps for a bracket without limits
_SLACK = 3  # halvings by which a bracket may lag behind bisection
_DIGITS = 53  # binary digits to which the ends of a bracket are resolved
_ORDERS = 11  # the sign and geometric means, which halve at most 1024 binary orders of magnitude
_TRIALS = 1 + _STEPS + 2 * (_SLACK + _DIGITS) + _ORDERS
_LEAST = 2.0**-60  # least first step without limits


def step(u, c, s):
    """Placeholder of the inverted operator's step, which ``bind`` puts in its place."""
    raise NotImplementedError


def root_step(y, c, s):
    """Return the input that gives ``y``; a limit if that is beyond, or else the last input.

    ``c`` is (lower limit, upper limit, 1 or -1 if the output rises or falls with the input, least
    first step of a search, *constants of the step); ``s`` is the last input, its last change, a
    flag that is 1 if no input gave the last output, workspace for a state, and the state.
    """
    low, high, sign, least = c[0], c[1], c[2], c[3]
    n = (s.size - 3) // 2
    u, reach = s[0], s[1]
    least_size = 2.0**_DOUBLINGS * least  # the range between the limits, if there are any
    below, above, error_below, error_above = -math.inf, math.inf, 0.0, 0.0
    side, widest, digit = 0, 0.0, 0.0
    for i in range(_TRIALS):
        for j in range(n):
            s[3 + j] = s[3 + n + j]
        error = sign * (step(u, c[4:], s[3 : 3 + n]) - y)
        if error <= 0.0:
            below, error_below = u, error
            if side < 0:
                error_above = 0.5 * error_above
            side = -1
        if error >= 0.0:
            above, error_above = u, error
            if side > 0:
                error_below = 0.5 * error_below
            side = 1
        if above == math.inf or below == -math.inf:
            # between limits a bracket is found before ``_STEPS``
            if i == _STEPS or (u >= high if error < 0.0 else u <= low):
                break
            u = min(u + reach, high) if error < 0.0 else max(u - reach, low)
            reach = 2.0 * reach
        else:
            middle, half = 0.5 * (below + above), 0.5 * (above - below)
            if not (below < middle and middle < above):
                break
            size = max(abs(below), abs(above))
            if widest > 0.0 and half <= digit:
                if digit <= 0.5 ** (_DIGITS - _SLACK) * max(size, least_size):
                    break
                smallest = max(min(abs(below), abs(above)), least_size)
                if below < 0.0 and above > 0.0:
                    u = 0.0
                    continue
                if size > 2.0 * smallest:
                    u = math.copysign(math.sqrt(size) * math.sqrt(smallest), middle)
                    continue
                widest = 0.0
            if widest == 0.0:
                widest = 2.0 ** (_SLACK + 1) * half
                digit = 0.5**_DIGITS * size
                if half <= digit:
                    break
            # the next evaluation leaves a bracket of at most ``most``, and moves both its ends
            widest = 0.5 * widest
            near = min(widest - half, half - digit)
            u = above - error_above * (above - below) / (error_above - error_below)
            u = min(max(middle - near, u), middle + near)  # also if u is NaN
    s[2] = 0.0
    if (high == math.inf and above == math.inf) or (low == -math.inf and below == -math.inf):
        u = s[0]  # no input gives it
        s[2] = 1.0
    s[1] = max(abs(u - s[0]), 0.5 * s[1], least)  # never zero, even after a long rest
    s[0] = u
    step(u, c[4:], s[3 + n :])
    return u


@dataclass(frozen=True)
class InverseOperator(Operator):
    """Base of the inverses: operators from the output of another one to its input.

    Parameters
    ----------
    operator : Operator
        The operator that is inverted.

    Examples
    --------
    See :class:`RootInverseOperator`.
    """

    operator: Operator

    def inverse(self):
        """Return the operator that is inverted."""
        return self.operator

    def sensitivities(self, u, du, dt, initial_state="rest"):
        """Raise an error: an inverse is not identified."""
        raise NotImplementedError("An inverse is not identified.")


@dataclass(frozen=True)
class RootInverseOperator(InverseOperator):
    """The inverse of an operator whose output is monotone in the input of the same sample.

    Parameters
    ----------
    operator : Operator
        Causal, of one input.
    low, high : float
        Limits of its input. An output out of their range gives the limit.

    Notes
    -----
    The state is (last input, its last change, state of the operator). Per sample, the operator's
    step runs at most 71 times: 14 times until the input is bracketed, 56 times to halve the
    bracket, and once with the input that is found. Without limits, it runs up to 101 times for the
    bracket, and 67 times more for an input that is far smaller than the bracket. The input is exact
    to 2^-52 of its size or of its change, the larger of them, and at least to 2^-49 of its size or
    of the range between the limits; without limits, 2^-48 stands for this range.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import DahlOperator
    >>> from skhyst.operators import RootInverseOperator
    >>> friction = DahlOperator(0.1, 0.8, stiffness=0.3)
    >>> u = np.sin(np.arange(6))
    >>> y, _ = friction.run(u, 0.1)
    >>> bool(np.abs(RootInverseOperator(friction).run(y, 0.1)[0] - u).max() < 1e-12)
    True
    """

    low: float = -math.inf
    high: float = math.inf

    def init(self, y0, initial_state="rest"):
        """Return the state in which the operator rests with the output ``y0``.

        Parameters
        ----------
        y0 : float
            Output at the first sample.
        """
        start = min(max(0.0, self.low), self.high)
        if initial_state == "zero":
            return start, 1.0, self.operator.init(start, "zero")

        def rest(u, c, s):
            return self.operator.run(np.array([u]), 1.0, self.operator.init(u))[0][0]

        ends = [rest(min(max(end, self.low), self.high), (), None) for end in (-1.0, 1.0)]
        sign = 1.0 if ends[1] >= ends[0] else -1.0
        constants = self._constants(sign)
        u0 = _plain(rest)(float(y0), constants, np.array([start, 1.0, 0.0]))
        return u0, abs(u0 - start) or 1.0, self.operator.init(u0)

    def run(self, u, dt, state=None):
        """Return the inputs that give the outputs ``u`` (n_samples,), and the final state."""
        y = as_signal(u)
        state = state or self.init(y[0])
        compiled_step = self.compiled_step(dt, state)
        s = compiled_step.state.copy()
        drive = compiled_step.streaming(s)(y)
        _, inner = self.operator.run(drive, dt, state[2])
        return drive, (float(s[0]), float(s[1]), inner)

    def compiled_step(self, dt, state):
        """Return one step in plain arithmetic."""
        u, reach, inner = state
        forward = self.operator.compiled_step(dt, inner)
        ends = []
        for end in (u - reach, u + reach):
            ends.append(forward.stepping(forward.state.copy())(end))
        sign = 1.0 if ends[1] >= ends[0] else -1.0
        constants = self._constants(sign)
        start = [u, reach, 0.0, *forward.state, *forward.state]
        law = _plain(_Composed(forward))  # plain Python: several steps are not compiled together
        if isinstance(forward, CompiledLaw):
            law = bind(root_step, forward.step)
            constants += forward.constants
        possible = partial(_is_possible, forward)
        return CompiledLaw(law, constants, start, possible=possible, flags=(("unreachable", 2),))

    def _constants(self, sign):
        """Return the constants of :func:`root_step`; a first step can reach both limits."""
        width = self.high - self.low
        return self.low, self.high, sign, 0.5**_DOUBLINGS * width if width < math.inf else _LEAST


@dataclass(frozen=True)
class _Composed:
    """Several steps called as one, without constants."""

    compiled_step: CompiledStep

    def __call__(self, u, c, s):
        return self.compiled_step.stepping(s)(u)


def _is_possible(forward, s, c):
    """Return whether the step of the operator can continue from its part of the state."""
    return forward.is_possible(s[3 + len(forward.state) :])


def _plain(law):
    """Return :func:`root_step` for a step that is not compiled."""
    root = FunctionType(root_step.__code__, {**root_step.__globals__, "step": law})
    root.py_func = root
    return root


def inverse_of(operator, low=-math.inf, high=math.inf):
    """Return the inverse of an operator: its own, or one by root finding at each sample.

    Parameters
    ----------
    operator : Operator
        From a drive to a response.
    low, high : float, default=-inf, inf
        Limits of the drive, for root finding.

    Returns
    -------
    Operator
        From the response to the drive.

    Raises
    ------
    ValueError
        If the output does not follow the input at once and the operator has no other inverse.

    See Also
    --------
    skhyst.control.InverseCompensator : The inverse of a fitted model, with limits of the drive.

    Examples
    --------
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import inverse_of
    >>> inverse_of(GainOperator(2.0, 1.0))
    GainOperator(gain=0.5, intercept=-0.5)
    """
    if hasattr(operator, "inverse"):
        return operator.inverse()
    if not operator.at_once or operator.is_disturbance:
        raise ValueError(
            f"{type(operator).__name__} has no inverse: its output does not follow its input at "
            "once."
        )
    return RootInverseOperator(operator, low, high)
