"""Base of the models of stages that have hysteresis in their equation of motion."""

import dataclasses
from abc import abstractmethod
from numbers import Integral, Real

import numpy as np

from .._sklearn import Interval
from ..base import ParametricModel
from ..linear import SecondOrderMode, SecondOrderModeOperator
from ..optimize import VariableProjection
from ._oscillator import OscillatorOperator

_COARSE, _FINE = 0.3, 0.1  # part of a radian of the fastest motion that a substep may last
_MOST_COARSE, _MOST_FINE = 16, 64
_WINDOWS = (4, 10, 25, 60)  # half lengths of the modulating function, samples
_SMOOTH = 4  # half length of that which smooths the response for the law
_FEWEST = 100  # equations
_MOST = 30_000  # samples that starting values are taken from
_LEVEL = 0.1  # hysteretic force, part of the drive's half range, where the data give none
_QUIET = 0.01  # the same of a stage that is almost its linear part
_N_STARTS = 12
_LEAST_DAMPING, _MOST_DAMPING = 0.01, 10.0
_COUPLINGS = (1.0, 3.0, 10.0)
_ROUGHLY = VariableProjection(tolerance=1e-5, max_evaluations=30)
_LAST_EVALUATIONS = 20


class OscillatorModel(ParametricModel):
    """Base of the stages: mass, substeps, intercept, and starting values in three steps.

    *Balance of forces.* For a given law the hysteretic force follows from the measured displacement
    up to factors, and with it the equation of motion is linear in everything else. It is weighted
    with a modulating function, whose derivatives take the place of those of the response (Shinbrot,
    *Transactions of the ASME*, 1957), and solved by least squares over a grid of laws.

    *Coupling.* The sum of squares of a free run has many minima, since the stage sticks and slips
    at moments of its own. A stage that a spring ties to the measured response does so less: it is
    the same stage driven by ``u + feedback y``, so its parameters follow exactly (Abarbanel et al.,
    *SIAM Journal on Applied Dynamical Systems*, 2009).

    *Free run*, from all of these.

    Parameters
    ----------
    fit_intercept : bool, default=True
        Whether the response has a constant.
    mass : float, default=1.0
        Mass of the stage, for ``physical_``; nothing else depends on it.
    n_substeps : int or None, default=None
        Integration steps in a sampling interval. None: as many as the stage that was found needs, a
        tenth of a radian of its fastest motion each, 64 at most.

    Attributes
    ----------
    physical_ : dict
        The quantities of the equation above for the given mass, see
        ``physical`` of ``operator_``.
    """

    _parameter_constraints = {
        **ParametricModel._parameter_constraints,
        "fit_intercept": ["boolean"],
        "mass": [Interval(Real, 0, None, closed="neither")],
        "n_substeps": [Interval(Integral, 1, None, closed="left"), None],
    }

    operator_class = OscillatorOperator

    @abstractmethod
    def _laws(self, length, speed):
        """Return lists of laws, one a kind, for the half range and the speed of the response."""

    @abstractmethod
    def _forces(self, law, y, dt, length):
        """Return the forces of a response (n_samples,), centred, as columns up to their factors."""

    @abstractmethod
    def _own(self, law, gain, stiffness, level, swing):
        """Return the operator's own parameters by name.

        The hysteretic force begins with the slope ``stiffness``, relative to the spring, and levels
        off at ``level``; ``swing`` is half the range of the drive.
        """

    def _stage(self, law, mode, scales, factors=None, level=_LEVEL):
        """Return the operator, or None where there is none.

        ``law`` begins with the way on which the force levels off, ``mode`` is the linear part,
        ``scales`` are half range and middle of the response and half range of the drive,
        ``factors`` belong to the columns of :meth:`_forces`; where they are unknown, the hysteretic
        force is the part ``level`` of the drive's half range.
        """
        way, gain, swing = law[0], mode.gain, scales[2]
        stiffness = level * swing * abs(gain) / way if factors is None else factors[0] * gain
        if not stiffness > 0.0:
            return None
        own = self._own(law, gain, float(stiffness), float(stiffness * way / abs(gain)), swing)
        linear = mode.natural_frequency, mode.damping_ratio
        return self.operator_class(*linear, gain=gain, intercept=mode.intercept, **own)

    def _retries(self, stage, stages):
        """Return those of the stages to follow to the end, because the one found is degenerate."""
        return []

    def starting_values(self, records, mode=None):
        """Return a dozen at most, with substeps that need not be made finer.

        One of them is almost linear: ``mode``, where the linear part is known already.
        """
        stages = self._stages(records, mode)
        return [self._divided(stage, records, _FINE, _MOST_COARSE) for stage in stages]

    def _stages(self, records, mode=None):
        """Return operators with coarse substeps, best first, among them an almost linear one."""
        swing = 0.5 * max(float(np.ptp(r.u)) for r in records) or 1.0
        low, high = min(float(r.y.min()) for r in records), max(float(r.y.max()) for r in records)
        length, middle = 0.5 * (high - low) or 1.0, 0.5 * (high + low)
        if not self.fit_intercept:
            middle = 0.0
        scales = length, middle, swing
        records, washout = _loudest(records, middle)
        kinds = []
        for window in _WINDOWS:
            usable = [r for r in records if len(r.u) > 2 * window]
            if sum(len(r.u) - 2 * window for r in usable) < _FEWEST:
                break
            kinds += self._balanced(usable, window, scales)
        if mode is None:
            linear = SecondOrderMode(
                fit_intercept=self.fit_intercept,
                initial_state=self._free_run_state(),
                method=self._roughly(),
            )
            mode = linear._identify(records).operator
        mode = dataclasses.replace(mode, gain=mode.gain or length / swing)
        laws = self._laws(length, mode.natural_frequency * length)
        if not kinds:
            kinds = [
                (kind, self._stage(law, mode, scales))
                for kind, group in enumerate(laws)
                for law in group
            ]
        group = laws[len(laws) // 2]
        kinds.append((len(laws), self._stage(group[len(group) // 2], mode, scales, level=_QUIET)))
        ranked = []
        for kind, stage in kinds:
            stage = self._divided(stage, records, _COARSE, _MOST_COARSE)
            ranked.append((self._error(stage, records, washout), kind, stage))
        ranked.sort(key=lambda entry: entry[0])
        # the first of each kind, then the second of each, ...
        turns = [sum(k == kind for _, k, _ in ranked[:i]) for i, (_, kind, _) in enumerate(ranked)]
        chosen = np.argsort(turns, kind="stable")[:_N_STARTS]
        return [ranked[i][2] for i in sorted(chosen)]

    def _balanced(self, records, window, scales):
        """Return (kind, stage) of the law of each kind that balances the forces best."""
        length, middle, _ = scales
        motion = np.concatenate(
            [
                np.stack([_weigh(r.y - middle, r.dt, window, order) for order in (2, 1, 0)], axis=1)
                for r in records
            ]
        )
        drive = np.concatenate([_weigh(r.u, r.dt, window) for r in records])
        speed = float(np.sqrt(np.mean(motion[:, 1] ** 2))) or length / records[0].dt
        smooth = [
            _weigh(np.pad(r.y - middle, _SMOOTH, mode="edge"), r.dt, _SMOOTH) for r in records
        ]
        linear = [motion, np.ones(len(drive))] if self.fit_intercept else [motion]
        n_linear = 3 + self.fit_intercept
        found = []
        for kind, laws in enumerate(self._laws(length, speed)):
            stages = []
            for law in laws:
                forces = [
                    np.apply_along_axis(_weigh, 0, self._forces(law, y, r.dt, length), r.dt, window)
                    for y, r in zip(smooth, records, strict=True)
                ]
                columns = np.column_stack([*linear, np.concatenate(forces)])
                if not np.isfinite(columns).all():
                    continue
                factors, error = _least_squares(columns, drive)
                mass, damping, stiffness = factors[:3].tolist()
                if not mass * stiffness > 0.0:
                    continue
                frequency = float(np.sqrt(stiffness / mass))
                ratio = 0.5 * damping * frequency / stiffness
                mode = SecondOrderModeOperator(
                    frequency,
                    float(np.clip(ratio, _LEAST_DAMPING, _MOST_DAMPING)),
                    1.0 / stiffness,
                    middle - float(factors[3]) / stiffness if self.fit_intercept else 0.0,
                )
                stage = self._stage(law, mode, scales, factors=factors[n_linear:])
                if stage is not None:
                    stages.append((error, stage))
            if stages:
                found.append((kind, min(stages, key=lambda entry: entry[0])[1]))
        return found

    def _error(self, stage, records, washout=0):
        """Return the sum of squares of the free run, gain and intercept solved.

        The first ``washout`` samples of each record do not count.
        """
        gram = np.zeros((3, 3))
        for r in records:
            y = stage.run(r.u, r.dt, stage.init(r.u[0], self._free_run_state()))[0]
            columns = np.stack([y, np.full(y.size, float(self.fit_intercept)), r.y])[:, washout:]
            gram += columns @ columns.T
        if not np.isfinite(gram).all():
            return np.inf
        best = np.linalg.lstsq(gram[:2, :2], gram[:2, 2], rcond=None)[0]
        return float(gram[2, 2] - best @ gram[:2, 2])

    def _coupled(self, stages, records, coupling):
        """Return the stage that fits best while it is tied to the response, [] without one."""
        feedback, origin = coupling / stages[0].gain, stages[0].intercept
        tied = [s.with_feedback(feedback, origin) for s in stages if feedback * s.gain > -0.5]
        driven = [
            dataclasses.replace(r, u=r.u + feedback * (r.y - origin), before=None) for r in records
        ]
        stage = self._refine(tied, driven, self._roughly())
        share = feedback * stage.operator.gain
        if not share < 1.0:
            return [], stage.n_evaluations
        # what is held, a preload for one, has not followed the intercept of the tied stage
        held = {name: getattr(stages[0], name) for name in self.held_parameters()}
        free = dataclasses.replace(stage.operator.with_feedback(-feedback, origin), **held)
        return [self._divided(free, records, _COARSE, _MOST_COARSE)], stage.n_evaluations

    def _divided(self, stage, records, part, most):
        """Return the stage with substeps that resolve its fastest motion."""
        n = self.n_substeps
        if n is None:
            longest = max(record.dt for record in records)
            n = np.clip(np.ceil(longest * stage.fastest_rate() / part), 1, most)
        return dataclasses.replace(stage, n_substeps=int(n))

    def _identify(self, data):
        """Identify with coarse substeps, then once more with those that the result asks for."""
        stages = self._stages(data)
        starts, evaluations = [], 0
        if stages[0].gain:
            for coupling in _COUPLINGS:
                found, n = self._coupled(stages, data, coupling)
                starts += found
                evaluations += n
        result = self._refine([*starts, *stages], data)
        evaluations += result.n_evaluations
        bounds = getattr(self.method, "bounds", None)
        for stage in self._retries(result.operator, stages):
            other = self._refine([stage], data, VariableProjection(bounds=bounds))
            evaluations += other.n_evaluations
            result = other if other.error < result.error else result
        stage = self._divided(result.operator, data, _FINE, _MOST_FINE)
        if stage.n_substeps > result.operator.n_substeps and np.isfinite(self._error(stage, data)):
            method = VariableProjection(bounds=bounds, max_evaluations=_LAST_EVALUATIONS)
            result = self._refine([stage], data, method)
            evaluations += result.n_evaluations
        return dataclasses.replace(result, n_evaluations=evaluations)

    def _roughly(self):
        """Return how starting values are identified: no longer than the result is."""
        most = getattr(self.method, "max_evaluations", None) or _ROUGHLY.max_evaluations
        return dataclasses.replace(_ROUGHLY, max_evaluations=min(most, _ROUGHLY.max_evaluations))

    def _adopt(self, result):
        super()._adopt(result)
        self.physical_ = result.operator.physical(self.mass)
        return self


def _loudest(records, middle):
    """Return a part of each long record, around its largest response, and samples to leave out.

    Before such a part the stage was not at rest.
    """
    n_samples = sum(len(r.u) for r in records)
    if n_samples <= _MOST:
        return records, 0
    parts = []
    for r in records:
        n = max(int(len(r.u) * _MOST / n_samples), 2)
        start = int(np.argmax(np.abs(r.y - middle))) - n // 2
        start = min(max(start, 0), len(r.u) - n)
        part = slice(start, start + n)
        parts.append(dataclasses.replace(r, u=r.u[part], y=r.y[part], segments=(), before=None))
    return parts, min(len(r.u) for r in parts) // 4


def _least_squares(columns, right):
    """Return the coefficients of the columns (n_samples, n) and the sum of squares left."""
    gram, moments = columns.T @ columns, columns.T @ right
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0.0] = 1.0
    factors = np.linalg.lstsq(gram / np.outer(scale, scale), moments / scale, rcond=None)[0]
    factors /= scale
    return factors, float(right @ right - moments @ factors)


def _weigh(values, dt, window, order=0):
    """Return a derivative of a signal, (n - 2 window,), averaged with the weights (1 - x^2)^3."""
    k = np.arange(-window, window + 1)
    x = k / (window + 1.0)
    bell = 1.0 - x * x
    if order == 0:
        weights = bell**3
        weights /= weights.sum()
    elif order == 1:
        weights = -x * bell**2
        weights /= -dt * (weights @ k)  # a ramp has its slope
    else:
        weights = bell * (5.0 * x * x - 1.0)
        weights -= weights.mean()
        weights /= 0.5 * dt * dt * (weights @ k**2)  # and a parabola its curvature
    return np.convolve(values, weights, mode="valid")
