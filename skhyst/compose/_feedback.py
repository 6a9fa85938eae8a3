"""Linear dynamics with a memoryless curve in the feedback."""

from dataclasses import replace
from numbers import Integral
from typing import Self

import numpy as np

from .._sklearn import HasMethods, Interval, StrOptions
from .._validation import common_parameter
from ..base import ParametricModel, as_node, informed, refine, with_params
from ..exceptions import ConvergenceWarning
from ..operators import FEEDBACK_ARGUMENTS, FeedbackOperator, has_velocity, split_disturbances

_FINE = 0.1  # longest substep, in radians of the fastest motion
_RESTS = 9  # responses at rest, over the range of the data, that are tested for stability
_GROWS = 0.01  # relative growth of the range of q that requires another identification
_ROUNDS = 8  # most such identifications; the gain and the range of q become consistent
_NAMES = ("linear", "curve")


class Feedback(ParametricModel):
    r"""Linear dynamics with a memoryless curve in the feedback, identified jointly.

    .. math:: y = G\,[u - f(q)] + c, \qquad q = (y - c) / g, \qquad f(q) = s(q) - q

    with linear dynamics G of the static gain g and a curve s. So q, in units of the drive, is the
    response relative to the gain, and at rest ``s(q) = u``: of a mass on a spring, s is the
    characteristic of the spring, whatever its form, and the dynamics may have more poles than a
    mass. Where s is the identity the model is linear. Of the velocity, ``f(q') = s(q')`` is a
    damper's force in addition to that of a linear one, and of both ``f(q, q') = s(q, q') - q``,
    such as a damping that depends on the position. It is also known as a nonlinear
    linear-fractional model (NL-LFR [1]_).

    Parameters
    ----------
    linear : estimator
        Linear dynamics of one input without a delay, such as a
        :class:`~skhyst.linear.TransferFunction` or a :class:`~skhyst.linear.SecondOrderMode`. Its
        ``hold`` is that of the drive.
    curve : estimator
        Memoryless model, such as a :class:`~skhyst.static.SmoothCurve` or
        :class:`~skhyst.static.DeadZones`; of both arguments one of its input and the rate of that,
        an :class:`~skhyst.static.UnknownTerm`.
    n_substeps : int or None, default=None
        Integration steps per sampling interval. None: a tenth of a radian of the fastest motion
        below half the sampling rate each, so at most 32.
    argument : {"displacement", "velocity", "both"}, default="displacement"
        What the curve is a function of: q, or its velocity in units of the drive per s, or both.
    initial_state : {"rest", "zero", "estimate"} or None, default=None
        State before each record's first sample; None: that of the two models.
    dt : float or None, default=None
        Sampling interval in s of data without a time index; None: that of the two models.

    Attributes
    ----------
    operator_ : FeedbackOperator
        ``linear`` and ``curve``, their operators, and ``poles_at(response)``, the poles of small
        motions about a rest.

    Raises
    ------
    TypeError
        If one of the two is not such a model.

    Warns
    -----
    ConvergenceWarning
        If a rest within the range of the response is unstable, so that a free run does not stay
        there.

    See Also
    --------
    Cascade : A curve before or behind the dynamics.
    skhyst.hysteresis.RestoringForce : A mass with a polynomial spring and damper, and hysteresis.

    Notes
    -----
    Starting values are the linear dynamics alone, and those with the curve that fits best if the
    measured response is fed back instead of the simulated one; that problem is linear for most
    curves. The curve has no intercept or gain of its own: the dynamics already have them.

    References
    ----------
    .. [1] Schoukens and Tóth, *IFAC-PapersOnLine*, 2020.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import Feedback
    >>> from skhyst.hysteresis import RestoringForceOperator
    >>> from skhyst.linear import SecondOrderMode
    >>> from skhyst.static import SmoothCurve
    >>> drive = np.sin(np.cumsum(np.linspace(0.02, 0.3, 1500)))
    >>> y, _ = RestoringForceOperator(20.0, 0.3, [0.4], [], 0.0, 1.0).run(drive, 0.01)
    >>> model = Feedback(SecondOrderMode(), SmoothCurve(3), dt=0.01).fit(drive[:, None], y)
    >>> bool(np.std(y - model.predict(drive[:, None])) < 1e-3 * np.std(y))
    True
    """

    operator_class = FeedbackOperator
    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "initial_state": [*ParametricModel._parameter_constraints["initial_state"], None],
        "linear": [HasMethods(["fit", "predict"])],
        "curve": [HasMethods(["fit", "predict"])],
        "n_substeps": [Interval(Integral, 1, None, closed="left"), None],
        "argument": [StrOptions(set(FEEDBACK_ARGUMENTS))],
    }

    def __init__(
        self,
        linear,
        curve,
        *,
        n_substeps=None,
        argument="displacement",
        initial_state=None,
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.linear = linear
        self.curve = curve
        self.n_substeps = n_substeps
        self.argument = argument
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def _models(self):
        return [informed(model, self) for model in (self.linear, self.curve)]

    def record_data(self, slices, X, y):
        for name, model in zip(_NAMES, self._models(), strict=True):
            if not isinstance(model, ParametricModel) or model.reads_columns:
                raise TypeError(
                    f"The '{name}' parameter of Feedback must be a parametric model of skhyst, of "
                    f"one input. Got {model!r} instead."
                )
            model._validate_params()  # its `fit`, which would validate, is not called
        # of some classes it depends on their values: then the operator refuses
        if self.argument != "both" and self.curve.operator_class.memoryless is False:
            raise TypeError(
                "The 'curve' parameter of Feedback must be a memoryless model. Got "
                f"{self.curve!r} instead."
            )
        return super().record_data(slices, X, y)

    def held_parameters(self) -> frozenset[str]:
        models = zip(_NAMES, self._models(), strict=True)
        return frozenset(
            f"{n}__{entry}" for n, model in models for entry in model.held_parameters()
        )

    def with_hold(self, hold):
        linear = self.linear.with_hold(hold)
        return self if linear is self.linear else with_params(self, linear=linear)

    def subtree(self, driven, disturbances):
        models = zip(self._models(), driven.stages, strict=True)
        stages = tuple(model.subtree(stage, disturbances) for model, stage in models)
        return replace(driven, stages=stages, model=as_node(self, linear=None, curve=None))

    def unfitted(self, operator) -> Self:
        return with_params(self, linear=operator.linear.unfitted(), curve=operator.curve.unfitted())

    def starting_values(self, records, linear=None):
        """Return operators with the starting curves for the responses.

        Parameters
        ----------
        linear : Operator, default=None
            The linear dynamics, if known; by default they are identified alone.
        """
        linear = self._open_loop(records) if linear is None else linear
        return self._starts_around(linear, records)

    def _open_loop(self, records):
        """Return the operator of the linear dynamics without a feedback."""
        linear = with_params(
            self._models()[0], initial_state=common_parameter(self, "initial_state")
        )
        base = linear.identify(records).operator
        is_linear = base.has_matrices and hasattr(base, "hold")
        if not (is_linear and base.gain and not base.n_start):
            raise TypeError(
                "The 'linear' parameter of Feedback must be linear dynamics with a static gain and "
                f"without a delay. Got {self.linear!r} instead."
            )
        if self.argument != "displacement" and not has_velocity(base):
            raise TypeError(
                "The 'linear' parameter of Feedback must be linear dynamics of at least two poles "
                f"more than zeros for a curve of the velocity. Got {self.linear!r} instead."
            )
        return base

    def _starts_around(self, base, records):
        """Return starts with curves over the range of the responses, relative to the gain."""
        curve_records = [
            replace(r, u=(r.y - base.intercept) / base.gain, before=None) for r in records
        ]
        if self.argument == "velocity":
            curve_records = [replace(r, u=np.gradient(r.u, r.dt)) for r in curve_records]
        starts = []
        for start in self._models()[1].starting_values(curve_records):
            curve, _ = split_disturbances(start)
            fitted_curves = self._curves_of_measured_feedback(base, curve, records, curve_records)
            starts += [
                self.divided(base, candidate, records) for candidate in (curve, *fitted_curves)
            ]
        return starts

    def divided(self, linear, curve, records):
        """Return the operator with substeps that resolve its motion.

        Parameters
        ----------
        linear, curve : Operator
            The two stages.
        records : sequence of RecordData
            With the wanted responses, and the intervals.

        Returns
        -------
        FeedbackOperator
            Of both.
        """
        dt, n = max(record.dt for record in records), self.n_substeps
        options = {"n_substeps": n or 1, "argument": self.argument}
        operator = FeedbackOperator(_NAMES, (linear, curve), **options)
        if n is None:
            rests = _rests(records)
            fastest = max(np.abs(operator.poles_at(y)).max(initial=0.0) for y in rests)
            n = int(np.clip(np.ceil(min(dt * fastest, np.pi) / _FINE), 1, None))
        return replace(operator, n_substeps=n)

    def _curves_of_measured_feedback(self, linear, curve, records, curve_records):
        """Yield the curve that fits best with the measured response fed back, if it is linear.

        Then ``y = G u - sum_i a_i G[f_i(q)] + c``, and all coefficients, with that of G u, follow
        by least squares.
        """
        mask = np.array([s.linear and not s.is_shared for _, s in curve.entries()], dtype=bool)
        if not mask.any():
            return
        rows, right = [], []
        for record, curve_record in zip(records, curve_records, strict=True):
            _, functions = curve.sensitivities(
                curve_record.u, np.empty((len(curve_record.u), 0)), record.dt
            )
            forces = np.column_stack([record.u, functions[:, mask]])
            columns = [
                linear.run(f, record.dt, linear.init(f[0], self.free_run_state))[0]
                - linear.intercept
                for f in np.ascontiguousarray(forces.T)
            ]
            weights = np.sqrt(record.counts())
            rows.append(weights[:, None] * np.column_stack([*columns, np.ones(len(record.u))]))
            right.append(weights * record.y)
        rows, right = np.concatenate(rows), np.concatenate(right)
        if np.isfinite(rows).all():
            gain, *coefficients, _ = np.linalg.lstsq(rows, right, rcond=None)[0]
            if gain > 0.0:
                values = curve.pack()
                values[mask] = -np.array(coefficients) / gain
                yield curve.unpack(values)

    def identify(self, data):
        """Identify with the range and substeps of the starts, then with those of the result.

        The range of q grows as the gain of the dynamics falls; beyond the range of its start, a
        curve is only extrapolated.
        """
        base = self._open_loop(data)
        result = refine(self, self._starts_around(base, data), data)
        for _ in range(_ROUNDS):
            linear = result.operator.linear
            if not 0.0 < abs(linear.gain) <= (1.0 - _GROWS) * abs(base.gain):
                break
            base = linear
            again = refine(self, self._starts_around(base, data), data)
            evaluations = result.n_evaluations + again.n_evaluations
            if again.error >= result.error:
                result = replace(result, n_evaluations=evaluations)
                break
            result = replace(again, n_evaluations=evaluations)
        finer = self.divided(*result.operator.stages, data)
        if finer.n_substeps > result.operator.n_substeps:
            again = refine(self, [finer], data)
            evaluations = result.n_evaluations + again.n_evaluations
            result = replace(again, n_evaluations=evaluations)
        return result

    def fit_warnings(self, result, records):
        yield from super().fit_warnings(result, records)
        rests = _rests(records)
        rates = [np.max(result.operator.poles_at(y).real, initial=-np.inf) for y in rests]
        away = [f"{y:.3g}" for y, rate in zip(rests, rates, strict=True) if rate > 0.0]
        if away:
            yield (
                f"Feedback is not stable at rest at a response of {', '.join(away)}: a free run "
                "does not stay there: it has another equilibrium or a limit cycle, or diverges.",
                ConvergenceWarning,
            )


def _rests(records):
    """Return responses over the range of all records."""
    response = np.concatenate([record.y for record in records])
    return np.linspace(response.min(), response.max(), _RESTS).tolist()
