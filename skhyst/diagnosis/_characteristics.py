"""What an engineer asks of a part beyond its parameters: name, unit and value for each operator."""

from dataclasses import dataclass

import numpy as np

from ..disturbance import DriftOperator, OffsetOperator, SinusoidOperator
from ..fluid import TankChainOperator
from ..hysteresis import (
    BacklashOperator,
    BoucWenOperator,
    BoucWenStageOperator,
    CoulombFrictionOperator,
    DahlOperator,
    FrictionStageOperator,
    MaxwellSlipOperator,
    PrandtlIshlinskiiOperator,
    RateDependentPrandtlIshlinskiiOperator,
    RestoringForceOperator,
    SlewLimitOperator,
)
from ..linear import (
    DelayOperator,
    FirstOrderLagOperator,
    KelvinVoigtOperator,
    SecondOrderModeOperator,
    TransferFunctionOperator,
)
from ..static import (
    DeadBandOperator,
    DeadZoneOperator,
    PolynomialCurveOperator,
    SaturationOperator,
    SoftSaturationOperator,
)

__all__ = ["OF_CLASSES", "Seen", "characteristics"]


@dataclass(frozen=True)
class Seen:
    """What has come into a part and out of it.

    Attributes
    ----------
    inputs, outputs : list of ndarray of shape (n_samples,)
        One a record.
    dts : list of float
        Sampling intervals, s.
    coefficients : ndarray of shape (n_records, n_coefficients) or None
        Of a disturbance.
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
    def half(self):
        """Half the range of the input."""
        return 0.5 * float(np.ptp(self.ends))

    @property
    def half_output(self):
        """Half the range of the output."""
        return 0.5 * float(np.ptp(np.concatenate(self.outputs)))

    @property
    def rates(self):
        """Sizes of the input's rate, of all samples."""
        return np.concatenate(
            [np.abs(np.diff(u)) / dt for u, dt in zip(self.inputs, self.dts, strict=True)]
        )

    @property
    def fast(self):
        """The rate of the input that a tenth of the samples exceed."""
        return float(np.quantile(self.rates, 0.9))


def characteristics(operator, seen):
    """Return name -> (value, unit) of what the operator's class is characterised by.

    Units are in terms of ``drive`` and ``response``, as those of parameters.
    """
    found = {}
    for name, unit, value in OF_CLASSES.get(type(operator), ()):
        values = np.ravel(value(operator, seen)) if value else ()
        for i, own in enumerate(values, start=1):
            found[f"{name} {i}" if len(values) > 1 else name] = (float(own), unit)
    return {name: own for name, own in found.items() if np.isfinite(own[0])}


def _bend(curve, seen):
    """Return the departure of a memoryless curve from a straight line, % of the range."""
    v = np.linspace(*seen.ends, 300)
    deviation = curve.run(v, 1.0)[0] - v
    return 100.0 * np.ptp(deviation - np.polyval(np.polyfit(v, deviation, 1), v)) / np.ptp(v)


def _largest_loop(operator, seen):
    """Return input, rising and falling branch of the loop between the ends of the input."""
    n, (low, high) = 400, seen.ends
    way = np.linspace(low, high, n)
    y = operator.run(np.concatenate([np.linspace(0.0, low, n), way, way[::-1], way]), 1.0)[0]
    return way, y[-n:], y[2 * n : 3 * n][::-1]


def _loop_width(operator, seen):
    _, up, down = _largest_loop(operator, seen)
    return 100.0 * np.abs(up - down).max() / np.ptp([up, down])


def _loop_slope(operator, seen):
    way, up, down = _largest_loop(operator, seen)
    return np.ptp([up, down]) / np.ptp(way)


def _harmonics(stage, seen):
    """Return half the range of a stage's displacement, and what its spring does over a period.

    Force, its first and its third harmonic, over the force of the linear spring there.
    """
    half = max(np.abs(y - stage.intercept).max() for y in seen.outputs)
    if not np.any(stage.stiffness_coefficients):
        return (np.nan,) * 4
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    q = np.cos(angle)
    size = half / (abs(stage.gain) * stage.scale)
    powers = enumerate(np.ravel(stage.stiffness_coefficients), start=1)
    force = q + sum(c * size ** (2 * i) * q ** (2 * i + 1) for i, c in powers)
    first, third = (2.0 * np.mean(force * np.cos(k * angle)) for k in (1, 3))
    return half, force[0], first, third


def _large_resonance(stage, seen):
    first = _harmonics(stage, seen)[2]
    return stage.natural_frequency * np.sqrt(max(first, 0.0)) / (2.0 * np.pi)


def _force_in_motion(level, stiffness):
    """Return what characterises a force with memory in an equation of motion."""

    def way(stage, seen):
        own = stiffness(stage)
        return abs(stage.gain) * level(stage) / own if own > 0.0 else np.nan

    def where_there(value):
        return lambda stage, seen: value(stage, seen) if stiffness(stage) > 0.0 else np.nan

    return (
        ("largest hysteretic force", "drive", where_there(lambda o, s: level(o))),
        (
            "force over the half range of the drive",
            "%",
            where_there(lambda o, s: 100.0 * level(o) / s.half),
        ),
        ("way before it yields", "response", way),
    )


def _force(level, stiffness):
    """Return what characterises a force with memory whose input is the displacement."""
    return (
        ("largest hysteretic force", "response", lambda o, s: level(o)),
        ("force over half the range", "%", lambda o, s: 100.0 * level(o) / s.half_output),
        ("stiffness after a turn", "response/drive", lambda o, s: stiffness(o)),
        ("way before it yields", "drive", lambda o, s: level(o) / stiffness(o)),
    )


def _bouc_wen_level(stage):
    factor = (1.0 + stage.shape) ** (-1.0 / stage.exponent) if stage.shape > -1.0 else 1.0
    return stage.level * factor


def _growth(operator, seen):
    """Return by how much thresholds, or the gain, change at fast motion, %."""
    if operator.dilation:
        return 100.0 * operator.dilation * seen.fast / seen.half
    return 100.0 * np.sum(operator.rate_weights) * seen.fast / np.sum(operator.weights)


def _amplitudes(lines, seen):
    n = np.size(lines.frequencies)
    return np.hypot(seen.coefficients[:, :n], seen.coefficients[:, n:]).mean(axis=0)


def _parameter(name):
    """Return the place of a parameter among what characterises a class."""
    return name, "", None


_MODE = _parameter("natural frequency"), _parameter("damping ratio")
_CURVE = (("departure from a straight line", "%", _bend),)

OF_CLASSES = {
    SecondOrderModeOperator: _MODE,
    TransferFunctionOperator: _MODE,
    DelayOperator: (_parameter("delay"),),
    FirstOrderLagOperator: (
        _parameter("time constant"),
        ("corner frequency", "Hz", lambda o, s: 0.5 / (np.pi * o.time_constant)),
    ),
    KelvinVoigtOperator: (
        (
            "creep over the settled response",
            "%",
            lambda o, s: 100.0 * (1.0 - 1.0 / (1.0 + np.sum(o.compliances))),
        ),
        _parameter("time constant"),
    ),
    DeadZoneOperator: _CURVE,
    PolynomialCurveOperator: _CURVE,
    SaturationOperator: (
        _parameter("lower level"),
        _parameter("upper level"),
        (
            "part of the time beyond",
            "%",
            lambda o, s: np.mean(
                [100.0 * np.mean((u < o.lower) | (u > o.upper)) for u in s.inputs]
            ),
        ),
    ),
    SoftSaturationOperator: (
        _parameter("level"),
        _parameter("knee"),
        (
            "what it takes at the ends",
            "response",
            lambda o, s: np.abs(o.run(s.ends, 1.0)[0] - s.ends).max(),
        ),
    ),
    DeadBandOperator: (
        _parameter("width of the band"),
        ("width over the range", "%", lambda o, s: 100.0 * o.half_width / s.half),
    ),
    BacklashOperator: (
        _parameter("play"),
        ("play over the range", "%", lambda o, s: 100.0 * o.half_gap / s.half),
    ),
    SlewLimitOperator: (
        _parameter("rate"),
        ("fastest drive", "drive/s", lambda o, s: s.rates.max()),
        (
            "part of the time that the drive is faster",
            "%",
            lambda o, s: 100.0 * np.mean(s.rates > o.rate),
        ),
    ),
    PrandtlIshlinskiiOperator: (
        ("loop width over the range", "%", _loop_width),
        ("slope of the largest loop", "response/drive", _loop_slope),
    ),
    RateDependentPrandtlIshlinskiiOperator: (
        _parameter("dilation"),
        ("growth at fast motion", "%", _growth),
        ("fast motion", "drive/s", lambda o, s: s.fast),
    ),
    FrictionStageOperator: (
        _parameter("static level"),
        _parameter("coulomb ratio"),
        (
            "friction over the half range of the drive",
            "%",
            lambda o, s: 100.0 * o.static_level / s.half,
        ),
        ("stribeck velocity", "response/s", lambda o, s: abs(o.gain) * o.stribeck_velocity),
        (
            "way before sliding",
            "response",
            lambda o, s: abs(o.gain) * o.static_level / o.bristle_stiffness,
        ),
    ),
    RestoringForceOperator: (
        (
            "nonlinear over linear spring force at full amplitude",
            "%",
            lambda o, s: 100.0 * (_harmonics(o, s)[1] - 1.0),
        ),
        ("resonance at full amplitude", "Hz", _large_resonance),
        ("full amplitude", "response", lambda o, s: _harmonics(o, s)[0]),
        (
            "third harmonic of the spring force",
            "%",
            lambda o, s: 100.0 * abs(_harmonics(o, s)[3] / _harmonics(o, s)[2]),
        ),
        *_force_in_motion(lambda o: o.slip_level, lambda o: o.hysteresis_stiffness),
    ),
    BoucWenStageOperator: _force_in_motion(_bouc_wen_level, lambda o: o.hysteresis_stiffness),
    CoulombFrictionOperator: (
        _parameter("coulomb force"),
        (
            "coulomb force over half the range",
            "%",
            lambda o, s: 100.0 * o.coulomb_force / s.half_output,
        ),
    ),
    BoucWenOperator: _force(lambda o: abs(o.alpha) * o.limit, lambda o: abs(o.alpha)),
    DahlOperator: _force(
        lambda o: abs(o.coulomb_force), lambda o: abs(o.coulomb_force) / o.presliding_displacement
    ),
    MaxwellSlipOperator: _force(
        lambda o: np.sum(o.weights * o.thresholds), lambda o: np.sum(o.weights)
    ),
    TankChainOperator: (
        (
            "response at the ceiling",
            "response",
            lambda o, s: o.gain * o.ceilings[-1] + o.intercept if o.is_limited else np.nan,
        ),
    ),
    SinusoidOperator: (_parameter("frequency"), ("amplitude", "response", _amplitudes)),
    OffsetOperator: (("spread between records", "response", lambda o, s: np.ptp(s.coefficients)),),
    DriftOperator: (
        (
            "largest span in a record",
            "response",
            lambda o, s: max(
                np.ptp(o.basis(dt * np.arange(len(u))) @ own)
                for u, dt, own in zip(s.inputs, s.dts, s.coefficients, strict=True)
            ),
        ),
    ),
}
