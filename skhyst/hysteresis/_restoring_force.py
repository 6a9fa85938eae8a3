"""Mass with polynomial spring and damper and a bilinear hysteretic force."""

import math
from numbers import Integral

import numpy as np
from numpy.polynomial import Polynomial

from .._sklearn import Interval
from ..operators import PrandtlIshlinskiiOperator, RestoringForceOperator
from ._oscillator import LEVEL, OscillatorModel

__all__ = ["RestoringForce"]

# way before the hysteretic force slips, parts of the response's half range
_WAYS = (0.003, 0.01, 0.03, 0.08, 0.2, 0.5)


class RestoringForce(OscillatorModel):
    r"""Mass with polynomial spring and damper and a bilinear hysteretic force.

    .. math::

        m \ddot x + \sum_{i\,\mathrm{odd}} \alpha_i (x + x_0)^i
        + \sum_{i\,\mathrm{odd}} \lambda_i \dot x^i + z = b u + F_0

        \dot z = \alpha_s \dot x \text{ while } |z| < z_s \text{ or } z \dot x < 0,
        \text{ else } 0

    The drive ``u`` is a force or a voltage, the response a displacement. The equation is divided by
    ``b``, since a response to a drive does not tell the mass; forces are then in units of the
    drive. ``x + x_0 = y - c``: a static displacement ``x_0`` by the preload ``F_0`` shifts the
    polynomials against the rest position.

    Parameters
    ----------
    stiffness_degree : int, default=5
        Degree of the spring's polynomial; even ones count as the next lower.
    damping_degree : int, default=5
        Degree of the damper's polynomial; even ones count as the next lower.
    fit_hysteresis : bool, default=True
        Whether there is a hysteretic force. Without one the model with a cubic spring is a Duffing
        oscillator.
    fit_preload : bool, default=True
        Whether a preload is fitted (0 otherwise), which gives the spring even terms about the rest
        position; with a linear spring it cannot be told from the intercept and is held.
    fit_intercept : bool, default=True
        Whether the response has a constant.
    mass : float, default=1.0
        Mass of the stage, for ``physical_``; nothing else depends on it.
    n_substeps : int or None, default=None
        Integration steps in a sampling interval. None: as many as the stage that was found needs, a
        tenth of a radian of its fastest motion each, 64 at most.
    initial_state : {"rest", "zero", "estimate"}, default="rest"
        State before each record's first sample: at rest after a slow first loading from zero; all
        zero; or after a rest at a drive value that is fitted for each record.
    dt : float, default=1.0
        Sampling interval in s of data without a time index.
    method : str or Method, default="variable_projection"
        How the parameters are identified, see :mod:`skhyst.optimize`.

    Attributes
    ----------
    operator_ : RestoringForceOperator
        ``natural_frequency`` (rad/s), ``damping_ratio``, ``stiffness_coefficients`` and
        ``damping_coefficients`` (relative to the linear spring force at ``scale``, half the largest
        swing of the drive), ``hysteresis_stiffness`` (relative to the spring), ``slip_level`` and
        ``preload`` (units of the drive), ``gain``, ``intercept``.
    params_, params_std_ : dict
        Parameters and their standard errors.
    physical_ : dict
        The quantities of the equation above for the given mass, see
        :meth:`RestoringForceOperator.physical <skhyst.operators.RestoringForceOperator.physical>`.

    Notes
    -----
    Starting values come as those of :class:`FrictionStage`. Where the spring is almost linear, the
    preload and the spring's coefficients are hardly told apart, and their standard errors, which
    are those of a linearised model, are too small.

    Equation (7) as printed, ``z' = (alpha_s / 2) (1 + sgn(z_s - |z|)) x'``, never leaves its limit:
    the bracket is zero there for either direction. Meant is an elastic, ideally plastic element (a
    stop operator), which is elastic again as soon as the motion turns round. Equation (6) prints
    ``lambda_9 x'^9``; six coefficients are announced, of which that is ``lambda_5 x'^5``.

    References
    ----------
    O. Amor, A. Kaddouri, R. Abdessemed, "NARMAX approach for micro positioning stage piezoelectric
    actuator hysteresis identification", (6) to (8).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.hysteresis import RestoringForce
    >>> from skhyst.operators import RestoringForceOperator
    >>> time = np.arange(1500) * 0.01
    >>> drive = np.sin(0.7 * time) + 0.8 * np.sin(2.9 * time) + 0.3 * np.sin(11.0 * time)
    >>> plant = RestoringForceOperator(20.0, 0.5, [], [], 5.0, 0.3, gain=3.0)
    >>> y, _ = plant.run(drive, 0.01)
    >>> model = RestoringForce(1, damping_degree=1, dt=0.01).fit(drive.reshape(-1, 1), y)
    >>> print(f"{model.operator_.slip_level:.2f} {model.operator_.hysteresis_stiffness:.1f}")
    0.30 5.0
    """

    _parameter_constraints = {
        **OscillatorModel._parameter_constraints,
        "stiffness_degree": [Interval(Integral, 1, None, closed="left")],
        "damping_degree": [Interval(Integral, 1, None, closed="left")],
        "fit_hysteresis": ["boolean"],
        "fit_preload": ["boolean"],
    }

    def __init__(
        self,
        stiffness_degree=5,
        *,
        damping_degree=5,
        fit_hysteresis=True,
        fit_preload=True,
        fit_intercept=True,
        mass=1.0,
        n_substeps=None,
        initial_state="rest",
        dt=1.0,
        method="variable_projection",
    ):
        self.stiffness_degree = stiffness_degree
        self.damping_degree = damping_degree
        self.fit_hysteresis = fit_hysteresis
        self.fit_preload = fit_preload
        self.fit_intercept = fit_intercept
        self.mass = mass
        self.n_substeps = n_substeps
        self.initial_state = initial_state
        self.dt = dt
        self.method = method

    def _laws(self, length, speed):
        return [[part * length] for part in _WAYS] if self.fit_hysteresis else [[speed]]

    def _forces(self, law, y, dt, length):
        if self.fit_hysteresis:
            play, _ = PrandtlIshlinskiiOperator([law], [1.0]).run(y, dt)
            return (y - play)[:, None]
        v = np.gradient(y, dt)
        springs = [y * (y / length) ** (degree - 1) for degree in self._spring_degrees()]
        dampers = [v * (v / law) ** (degree - 1) for degree in _odd(self.damping_degree)]
        return np.array([*springs, *dampers]).reshape(-1, len(y)).T

    def _spring_degrees(self):
        """Return the degrees of the spring about the middle of the response, but 1."""
        if "preload" in self._fixed() or not self.fit_intercept:
            return _odd(self.stiffness_degree)
        return list(range(2, _odd(self.stiffness_degree)[-1] + 1))

    def _stage(self, law, mode, scales, factors=None, level=LEVEL):
        if not self.fit_hysteresis:
            return self._polynomial_stage(law, mode, scales, factors)
        gain = mode.gain or scales.length / scales.swing
        stiffness = level * scales.swing * abs(gain) / law if factors is None else factors[0] * gain
        if not stiffness > 0.0:
            return None
        return RestoringForceOperator(
            mode.natural_frequency,
            mode.damping_ratio,
            np.zeros(len(_odd(self.stiffness_degree))),
            np.zeros(len(_odd(self.damping_degree))),
            float(stiffness),
            float(stiffness * law / abs(gain)),
            gain=gain,
            intercept=mode.intercept,
            scale=scales.swing,
        )

    def _polynomial_stage(self, speed, mode, scales, factors):
        """Return the stage whose spring is odd about the place at which its curve has no bend."""
        gain = mode.gain or scales.length / scales.swing
        odd, center, preload, intercept = _odd(self.stiffness_degree), 0.0, 0.0, mode.intercept
        stiffness = 1.0 / gain
        spring, dampers = np.zeros(len(odd)), np.zeros(len(_odd(self.damping_degree)))
        if factors is not None:
            degrees = np.array(self._spring_degrees(), dtype=int)
            curve = np.zeros(2 if not odd else odd[-1] + 1)
            curve[1] = stiffness
            curve[degrees] = factors[: len(degrees)] / scales.length ** (degrees - 1.0)
            curve = Polynomial(curve)
            if len(degrees) > len(odd):
                bends = curve.deriv(2).roots()
                bends = bends[(np.abs(bends.imag) < 1e-9 * scales.length)].real
                bends = bends[(np.abs(bends) < scales.length) & (curve.deriv()(bends) * gain > 0.0)]
                center = float(bends[np.argmin(np.abs(bends))]) if len(bends) else 0.0
                # the constant of the balance, which the intercept of the linear part contains
                preload = (intercept - scales.middle) * stiffness - float(curve(center))
                intercept = scales.middle + center
            taylor = [curve.deriv(k)(center) / math.factorial(k) for k in (1, *odd)]
            stiffness, *spring = map(float, taylor)
            dampers = factors[len(degrees) :] / speed ** (np.array(_odd(self.damping_degree)) - 1.0)
        stiffer = stiffness * gain
        frequency = mode.natural_frequency * math.sqrt(stiffer)
        powers = np.array(odd, dtype=float), np.array(_odd(self.damping_degree), dtype=float)
        size = scales.swing ** (powers[0] - 1.0), scales.swing ** (powers[1] - 1.0)
        return RestoringForceOperator(
            frequency,
            mode.damping_ratio / math.sqrt(stiffer),
            np.array(spring) * size[0] / stiffness ** powers[0],
            dampers * size[1] / (stiffness / frequency) ** powers[1],
            0.0,
            0.0,
            preload,
            1.0 / stiffness,
            intercept,
            scale=scales.swing,
        )

    def _fixed(self):
        fixed = super()._fixed()
        if not self.fit_hysteresis:
            fixed |= {"hysteresis_stiffness", "slip_level"}
        # the preload of a linear spring is an intercept
        held = not self.fit_preload or (self.stiffness_degree < 3 and self.fit_intercept)
        return fixed | {"preload"} if held else fixed


def _odd(degree):
    """Return the odd degrees from 3 on."""
    return list(range(3, degree + 1, 2))
