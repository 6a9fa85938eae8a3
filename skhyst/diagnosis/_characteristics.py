"""What characterises a part beyond its parameters, as an engineer counts it."""

from dataclasses import dataclass

import numpy as np

from .. import disturbance, fluid, hysteresis, linear, static

__all__ = ["Seen", "characteristics"]


@dataclass(frozen=True)
class Seen:
    """What has come into a part and out of it: a list of one array a record, and intervals (s).

    ``coefficients`` are those of a disturbance, (n_records, n_coefficients).
    """

    inputs: list
    outputs: list
    dts: list
    coefficients: np.ndarray | None = None

    @property
    def ends(self):
        """Smallest and largest input."""
        return np.array([min(u.min() for u in self.inputs), max(u.max() for u in self.inputs)])

    @property
    def rates(self):
        """Sizes of the input's rate, of all samples."""
        pairs = zip(self.inputs, self.dts, strict=True)
        return np.concatenate([np.abs(np.diff(u)) / dt for u, dt in pairs])

    @property
    def fast(self):
        """The rate of the input that a tenth of the samples exceed."""
        return np.quantile(self.rates, 0.9)


def characteristics(operator, seen):
    """Return name -> (value, unit) of what the operator's class is characterised by.

    Units are in terms of ``drive`` and ``response``, as those of parameters. What a part lacks, a
    cubic spring or a force with memory, is left out.
    """
    found = {}
    for name, unit, value in _OF_CLASSES.get(type(operator), ()):
        values = np.ravel(value(operator, seen))
        for i, own in enumerate(values, start=1):
            if np.isfinite(own):
                found[f"{name} {i}" if len(values) > 1 else name] = float(own), unit
    return found


def _bend(curve, seen):
    v = np.linspace(*seen.ends, 300)
    deviation = curve.run(v, 1.0)[0] - v
    return 100.0 * np.ptp(deviation - np.polyval(np.polyfit(v, deviation, 1), v)) / np.ptp(v)


def _loop_width(plays, seen):
    low, high = seen.ends
    way = np.linspace(low, high, 400)
    turns = np.concatenate([np.linspace(0.0, low, 400), way, way[::-1], way])
    y = plays.run(turns, 1.0)[0]
    down, up = y[800:1200][::-1], y[1200:]
    return 100.0 * np.abs(up - down).max() / np.ptp([up, down])


def _spring(stage, seen):
    """Return half the range of a displacement, and what its spring does on the way, over linear.

    The latter are the force at the end, and the first and third harmonic of the force.
    """
    half = max(np.abs(y - stage.intercept).max() for y in seen.outputs)
    if not np.any(stage.stiffness_coefficients):
        return np.full(4, np.nan)
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    size, q = half / abs(stage.gain * stage.scale), np.cos(angle)
    powers = enumerate(np.ravel(stage.stiffness_coefficients), start=1)
    force = q + sum(c * size ** (2 * i) * q ** (2 * i + 1) for i, c in powers)
    return np.array([half, force[0], *(2.0 * np.mean(force * np.cos(k * angle)) for k in (1, 3))])


def _stage_force(level, stiffness):
    """Return what characterises a force with memory in an equation of motion, if there is one."""

    def there(o):
        return 1.0 if stiffness(o) > 0.0 else np.nan

    return (
        ("largest hysteretic force", "drive", lambda o, s: level(o) * there(o)),
        (
            "way before it yields",
            "response",
            lambda o, s: abs(o.gain) * level(o) / (stiffness(o) * there(o)),
        ),
    )


def _force(level, stiffness):
    """Return what characterises a force with memory whose input is the displacement."""
    return (
        ("largest hysteretic force", "response", lambda o, s: level(o)),
        ("stiffness after a turn", "response/drive", lambda o, s: stiffness(o)),
        ("way before it yields", "drive", lambda o, s: level(o) / stiffness(o)),
    )


def _bouc_wen_level(o):
    return o.level * ((1.0 + o.shape) ** (-1.0 / o.exponent) if o.shape > -1.0 else 1.0)


def _growth(o, seen):
    change = o.dilation or np.sum(o.rate_weights) / np.sum(o.weights)
    return 100.0 * change * seen.fast / (0.5 * np.ptp(seen.ends) if o.dilation else 1.0)


def _spans(drift, seen):
    curves = zip(seen.inputs, seen.dts, seen.coefficients, strict=True)
    return [np.ptp(drift.basis(dt * np.arange(len(u))) @ own) for u, dt, own in curves]


def _hz(stage, seen):
    return stage.natural_frequency / (2.0 * np.pi)


_CURVE = (("departure from a straight line", "%", _bend),)
# class -> (name, unit, value or values of an operator and what it has seen)
_OF_CLASSES = {
    linear.FirstOrderLagOperator: (
        ("corner frequency", "Hz", lambda o, s: 0.5 / (np.pi * o.time_constant)),
    ),
    linear.KelvinVoigtOperator: (
        (
            "creep over the settled response",
            "%",
            lambda o, s: 100.0 * (1.0 - 1.0 / (1.0 + np.sum(o.compliances))),
        ),
    ),
    static.DeadZoneOperator: _CURVE,
    static.PolynomialCurveOperator: _CURVE,
    static.SoftSaturationOperator: (
        (
            "what it takes at the ends",
            "response",
            lambda o, s: np.abs(o.run(s.ends, 1.0)[0] - s.ends).max(),
        ),
    ),
    hysteresis.SlewLimitOperator: (("fastest drive", "drive/s", lambda o, s: s.rates.max()),),
    hysteresis.PrandtlIshlinskiiOperator: (("loop width over the range", "%", _loop_width),),
    hysteresis.RateDependentPrandtlIshlinskiiOperator: (
        ("growth at fast motion", "%", _growth),
        ("fast motion", "drive/s", lambda o, s: s.fast),
    ),
    hysteresis.FrictionStageOperator: (
        ("stribeck velocity", "response/s", lambda o, s: abs(o.gain) * o.stribeck_velocity),
        (
            "way before sliding",
            "response",
            lambda o, s: abs(o.gain) * o.static_level / o.bristle_stiffness,
        ),
    ),
    hysteresis.RestoringForceOperator: (
        (
            "nonlinear over linear spring force at full amplitude",
            "%",
            lambda o, s: 100.0 * (_spring(o, s)[1] - 1.0),
        ),
        ("full amplitude", "response", lambda o, s: _spring(o, s)[0]),
        ("resonance at small amplitude", "Hz", _hz),
        (
            "resonance at full amplitude",
            "Hz",
            lambda o, s: _hz(o, s) * np.sqrt(max(_spring(o, s)[2], 0.0)),
        ),
        (
            "third harmonic of the force",
            "%",
            lambda o, s: 100.0 * abs(np.divide(*_spring(o, s)[[3, 2]])),
        ),
        *_stage_force(lambda o: o.slip_level, lambda o: o.hysteresis_stiffness),
    ),
    hysteresis.BoucWenStageOperator: _stage_force(
        _bouc_wen_level, lambda o: o.hysteresis_stiffness
    ),
    hysteresis.BoucWenOperator: _force(lambda o: abs(o.alpha) * o.limit, lambda o: abs(o.alpha)),
    hysteresis.DahlOperator: _force(
        lambda o: abs(o.coulomb_force), lambda o: abs(o.coulomb_force) / o.presliding_displacement
    ),
    hysteresis.MaxwellSlipOperator: _force(
        lambda o: o.weights @ o.thresholds, lambda o: np.sum(o.weights)
    ),
    fluid.TankChainOperator: (
        ("power of the level", "", lambda o, s: o.exponents),
        (
            "response at the ceiling",
            "response",
            lambda o, s: o.gain * o.ceilings[-1] + o.intercept if o.is_limited else np.nan,
        ),
    ),
    disturbance.OffsetOperator: (
        ("spread between records", "response", lambda o, s: np.ptp(s.coefficients)),
    ),
    disturbance.DriftOperator: (
        ("largest span in a record", "response", lambda o, s: max(_spans(o, s))),
    ),
    disturbance.SinusoidOperator: (
        ("frequency", "Hz", lambda o, s: o.frequencies),
        (
            "amplitude",
            "response",
            lambda o, s: np.hypot(*np.split(s.coefficients, 2, axis=1)).mean(axis=0),
        ),
    ),
}
