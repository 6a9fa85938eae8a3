"""Evidence for forces: in an equation of motion, or beside others in a model of a force."""

import numpy as np
from scipy.signal import savgol_filter

from ..hysteresis import (
    BoucWenOperator,
    BoucWenStageOperator,
    CoulombFrictionOperator,
    DahlOperator,
    FrictionStageOperator,
    MaxwellSlipOperator,
    PrandtlIshlinskiiOperator,
    RestoringForceOperator,
)
from ._evidence_base import Picture, binned, by_direction, compared, directions
from ._evidence_curves import describe_stage, hysteresis_in_series

__all__ = ["FORCES"]

_PART_OF_PERIOD = 8  # over which a measured motion is smoothed before it is differentiated
_SHORTEST, _DEGREE = 5, 3  # of the smoothing polynomials
_GRID = 201
_VELOCITIES = 40  # bins
_FALLS = 0.99  # friction of fast over slow sliding, above which it does not fall


class _Balance:
    """The balance of forces of a stage: what mass, damper and linear spring leave of the drive.

    ``displacement``, ``velocity`` and ``force`` are lists of one array a record: displacement and
    velocity in units of the response, forces in units of the drive.
    """

    def __init__(self, claim, measured):
        operator = claim.operator
        w, zeta, gain = operator.natural_frequency, operator.damping_ratio, operator.gain
        self.displacement, self.velocity, self.force = [], [], []
        own = claim.structure.run(claim.records, last=claim.at + 1)
        signals = zip(
            claim.records, claim.inputs(), own, claim.measured, claim.modelled, strict=True
        )
        for record, drive, stage, y, model in signals:
            # behind further stages the motion is not measured: the model's, and what it leaves
            motion = stage + (y - model) if measured else stage
            smooth, v, a = _derivatives(motion, record.dt, 2.0 * np.pi / w)
            x = smooth - operator.intercept
            left = drive - (a / w**2 + 2.0 * zeta * v / w + x) / gain
            self.displacement.append(x)
            self.velocity.append(v)
            self.force.append(left + getattr(operator, "preload", 0.0))


def _derivatives(motion, dt, period):
    """Return a motion, its velocity and its acceleration, smoothed where that bends nothing."""
    window = int(period / dt / _PART_OF_PERIOD) // 2 * 2 + 1
    window = min(window, (len(motion) - 1) // 2 * 2 + 1)
    if window >= _SHORTEST:
        return [savgol_filter(motion, window, _DEGREE, k, dt) for k in range(3)]
    # too few samples a period for a polynomial: those of the sine series between the ends
    n = len(motion)
    ends = np.linspace(motion[0], motion[-1], n)
    odd = np.concatenate([motion - ends, (ends - motion)[-2:0:-1]])
    omega = 2.0 * np.pi * np.fft.rfftfreq(len(odd), dt)
    spectrum = np.fft.rfft(odd)
    v, a = (np.fft.irfft(factor * spectrum, len(odd))[:n] for factor in (1j * omega, -(omega**2)))
    return motion, v + (motion[-1] - motion[0]) / (dt * max(n - 1, 1)), a


def _amplitude(claim):
    """Return half the range of the drive at the stage."""
    return 0.5 * float(np.ptp(np.concatenate(claim.inputs())))


# ------------------------------------------------------------------ in the equation of motion


def _friction_stage(claim):
    operator, half = claim.operator, _amplitude(claim)
    size = abs(operator.gain)
    static = claim.number("static_level", "drive")
    numbers = {
        "friction of slow sliding": static,
        "friction over the half range of the drive": (static[0] / half, static[1] / half, ""),
        "way before sliding": (
            float(size * operator.static_level / operator.bristle_stiffness),
            np.nan,
            "response",
        ),
    }
    statement = (
        f"A force of {static[0]:.4g} in units of the drive, {100.0 * static[0] / half:.3g} % of "
        "its half range, opposes the motion and changes sign with it"
    )
    if operator.coulomb_ratio < _FALLS:
        numbers["friction of fast over slow sliding"] = claim.number("coulomb_ratio", "")
        numbers["Stribeck velocity"] = claim.number("stribeck_velocity", "response/s", size)
        statement += f"; fast sliding leaves {100.0 * operator.coulomb_ratio:.3g} % of it"
    measured, identified = _Balance(claim, True), _Balance(claim, False)
    # against the model's velocity: the noise of a measured one would blur the jump
    signals = identified.velocity, measured.force, identified.force
    curves = compared(*map(np.concatenate, signals), _VELOCITIES)
    v = np.linspace(curves[0][1].min(), curves[0][1].max(), _GRID)
    ratio = operator.coulomb_ratio
    fall = ratio + (1.0 - ratio) * np.exp(-((v / (size * operator.stribeck_velocity)) ** 2))
    law = np.sign(v * operator.gain) * operator.static_level * fall
    picture = Picture(
        "Friction in the balance of forces",
        "velocity (response/s)",
        "force that the linear stage leaves (drive)",
        (*curves, ("steady sliding", v, law, "dashed")),
    )
    return statement + ".", numbers, picture


def _cubic_stage(claim):
    operator = claim.operator
    measured = _Balance(claim, True)
    x = np.concatenate(measured.displacement)
    half = float(np.abs(x).max())
    angle = np.linspace(0.0, 2.0 * np.pi, 2 * _GRID, endpoint=False)
    force = _spring(operator, half * np.cos(angle) / abs(operator.gain))
    linear = half / abs(operator.gain)
    first, third = (2.0 * np.mean(force * np.cos(k * angle)) for k in (1, 3))
    small = operator.natural_frequency / (2.0 * np.pi)
    large = small * np.sqrt(max(first / linear, 0.0))
    share = force[0] / linear - 1.0
    numbers = {
        "nonlinear over linear spring force at full amplitude": (
            float(share),
            _relative(claim, "stiffness_coefficients") * abs(float(share)),
            "",
        ),
        "full amplitude": (half, np.nan, "response"),
        "third harmonic of the spring force": (float(abs(third / first)), np.nan, ""),
        "resonance at small amplitude": claim.number("natural_frequency", "Hz", 0.5 / np.pi),
        "resonance at full amplitude": (float(large), np.nan, "Hz"),
    }
    cubic = 3.0 * float(np.ravel(operator.stiffness_coefficients)[0])
    statement = (
        f"The spring {'hardens' if cubic > 0.0 else 'softens'}: at full amplitude its force "
        f"differs by {100.0 * share:+.3g} % from the linear one, which moves the resonance from "
        f"{small:.4g} to {large:.4g} Hz."
    )
    grid = np.linspace(x.min(), x.max(), _GRID)
    law = _spring(operator, grid / operator.gain) - grid / operator.gain
    picture = Picture(
        "Spring force less its linear part",
        "displacement (response)",
        "force that the linear stage leaves (drive)",
        (
            ("measured", *binned(x, np.concatenate(measured.force)), "points"),
            ("identified", grid, law, "line"),
        ),
    )
    return statement, numbers, picture


def _spring(operator, q):
    """Return the force of a polynomial spring."""
    coefficients = np.ravel(operator.stiffness_coefficients)
    parts = (c * (q / operator.scale) ** (2 * i) for i, c in enumerate(coefficients, 1))
    return q + q * sum(parts)


def _relative(claim, key):
    """Return the standard error of the first value of an array, relative."""
    key = key if key in claim.values else f"{key}[0]"
    value, std = claim.values.get(key, (np.nan, np.nan))
    return abs(std / value) if value else np.nan


def _hysteretic_stage(claim):
    operator, half = claim.operator, _amplitude(claim)
    if isinstance(operator, BoucWenStageOperator):
        level, error, _ = claim.number("level", "drive")
        factor = (1.0 + operator.shape) ** (-1.0 / operator.exponent) if operator.shape > -1 else 1
        level, error = level * factor, error * factor
    elif isinstance(operator, FrictionStageOperator):
        level, error, _ = claim.number("static_level", "drive")
    else:
        level, error, _ = claim.number("slip_level", "drive")
    key = "bristle_stiffness" if hasattr(operator, "bristle_stiffness") else "hysteresis_stiffness"
    stiffness = getattr(operator, key)
    way = float(abs(operator.gain) * level / stiffness) if stiffness else np.nan
    numbers = {
        "largest hysteretic force": (float(level), float(error), "drive"),
        "force over the half range of the drive": (
            float(level / half),
            float(error / half),
            "",
        ),
        "stiffness after a turn, over the spring's": claim.number(key, ""),
        "way before it yields": (way, np.nan, "response"),
    }
    statement = (
        f"A force with memory grows to {level:.4g} in units of the drive, "
        f"{100.0 * level / half:.3g} % of its half range, within {way:.4g} of motion after each "
        "turn, however slow."
    )
    measured, identified = _Balance(claim, True), _Balance(claim, False)
    picture = Picture(
        "Hysteretic force in the balance of forces",
        "displacement (response)",
        "force that the linear stage leaves (drive)",
        by_direction(
            measured.displacement,
            directions(measured.displacement),
            measured.force,
            identified.force,
        ),
    )
    return statement, numbers, picture


# ------------------------------------------------------------------ beside other forces


def _beside_forces(claim):
    """Return what the other forces leave, measured and identified."""
    return claim.lacking(claim.rest.respond(claim.records))


def _friction_force(claim):
    operator = claim.operator
    span = float(np.ptp(np.concatenate(claim.measured)))
    level = claim.number("coulomb_force", "response")
    numbers = {
        "Coulomb force": level,
        "Coulomb force over half the range": (
            2.0 * level[0] / span,
            2.0 * level[1] / span,
            "",
        ),
        "transition velocity": claim.number("transition_velocity", "drive/s"),
    }
    statement = (
        f"A force of {level[0]:.4g}, {200.0 * level[0] / span:.3g} % of half the range, follows "
        "the sign of the velocity"
    )
    if operator.stribeck_force:
        numbers["more of it in slow sliding"] = claim.number("stribeck_force", "response")
        numbers["Stribeck velocity"] = claim.number("stribeck_velocity", "drive/s")
        statement += f", and is {operator.stribeck_force:.4g} more in slow sliding"
    velocities = [
        np.diff(u, prepend=u[0]) / record.dt
        for u, record in zip(claim.inputs(), claim.records, strict=True)
    ]
    signals = map(np.concatenate, (velocities, *_beside_forces(claim)))
    picture = Picture(
        "Friction against velocity",
        "velocity (drive/s)",
        "force that the others leave (response)",
        compared(*signals, _VELOCITIES),
    )
    return statement + ".", numbers, picture


def _hysteretic_force(claim):
    operator = claim.operator
    span = float(np.ptp(np.concatenate(claim.measured)))
    if isinstance(operator, BoucWenOperator):
        level = abs(operator.alpha) * operator.limit
        stiffness = abs(operator.alpha)
    elif isinstance(operator, DahlOperator):
        level = abs(operator.coulomb_force)
        stiffness = level / operator.presliding_displacement
    else:
        level = float(np.sum(operator.weights * operator.thresholds))
        stiffness = float(np.sum(operator.weights))
    way = level / stiffness if stiffness else np.nan
    numbers = {
        "largest hysteretic force": (float(level), np.nan, "response"),
        "force over half the range": (float(2.0 * level / span), np.nan, ""),
        "stiffness after a turn": (float(stiffness), np.nan, "response/drive"),
        "way before it yields": (float(way), np.nan, "drive"),
    }
    statement = (
        f"A force with memory grows to {level:.4g}, {200.0 * level / span:.3g} % of half the "
        f"range, within {way:.4g} of motion after each turn."
    )
    displacement = claim.inputs()
    picture = Picture(
        "Hysteretic force",
        "displacement (drive)",
        "force that the others leave (response)",
        by_direction(displacement, directions(displacement), *_beside_forces(claim)),
    )
    return statement, numbers, picture


# ------------------------------------------------------------------ which of these


def _friction(claim):
    if isinstance(claim.operator, FrictionStageOperator):
        return _friction_stage(claim)
    if isinstance(claim.operator, CoulombFrictionOperator):
        return _friction_force(claim)
    return describe_stage(claim)


def _cubic_stiffness(claim):
    if isinstance(claim.operator, RestoringForceOperator):
        return _cubic_stage(claim)
    return describe_stage(claim)


def _hysteresis(claim):
    stage = RestoringForceOperator | BoucWenStageOperator | FrictionStageOperator
    if isinstance(claim.operator, stage):
        return _hysteretic_stage(claim)
    if isinstance(claim.operator, BoucWenOperator | DahlOperator | MaxwellSlipOperator):
        return _hysteretic_force(claim)
    if isinstance(claim.operator, PrandtlIshlinskiiOperator):
        return hysteresis_in_series(claim)
    return describe_stage(claim)


FORCES = {
    "friction": _friction,
    "cubic_stiffness": _cubic_stiffness,
    "hysteresis": _hysteresis,
}
