"""Physical effects of the simulated devices, one scheme for all of them.

A device sends its signals through an :class:`EffectPath` on a grid finer than the sampling::

    drive -> before -> (hysteresis) -> after -> dynamics -> (motion) -> sensor -> + beside

Everything here is written independently of the operators that identify such effects. A signal is a
straight line between its samples. Every record starts at rest, after a first loading from zero.
"""

import dataclasses
from collections.abc import Mapping
from numbers import Real

import numpy as np
from scipy.signal import lfilter

from .._jit import jit
from ._motion import Forces, oscillate

__all__ = [
    "EFFECTS",
    "EffectPath",
    "dead_zones",
    "first_order",
    "plays",
    "refine",
    "shift",
]

# name -> (least and largest strength, default strength, further defaults). Times are multiples of
# the period of the device's first mode, frequencies of its frequency.
_LAWS = {
    "slew_limit": (0.0, np.inf, 1.0, {"frequency": 0.02}),
    "input_saturation": (0.0, 1.0, 0.3, {}),
    "dead_zone": (0.0, 1.0, 0.1, {}),
    "backlash": (0.0, 1.0, 0.05, {"place": "drive"}),
    "rate_dependence": (0.0, np.inf, 0.5, {"frequency": 0.05}),
    "amplitude_dependence": (-0.5, np.inf, 0.2, {}),
    "asymmetry": (-0.5, np.inf, 0.25, {"side": 1, "threshold": 0.2}),
    "lag": (0.0, np.inf, 1.0, {"time_constant": 0.5}),
    "delay": (0.0, np.inf, 1.0, {"time": 0.2}),
    "resonance": (0.0, 1.0, 0.2, {"frequency": 0.4, "damping": 0.03}),
    "creep": (0.0, np.inf, 0.15, {"time_constants": (5.0, 30.0, 200.0)}),
    "friction": (0.0, 1.0, 0.05, {"presliding": 0.01, "static": 1.5, "stribeck": 0.1}),
    "cubic_stiffness": (0.0, np.inf, 0.2, {}),
    "hysteretic_force": (0.0, np.inf, 0.2, {"width": 0.3}),
    "static_nonlinearity": (-0.3, np.inf, 0.15, {"order": 3}),
    "output_saturation": (0.0, 1.0, 0.3, {}),
    "drift": (-np.inf, np.inf, 0.1, {"time_constant": 200.0}),
    "offset": (0.0, np.inf, 0.1, {}),
    "periodic_disturbance": (0.0, np.inf, 0.02, {"frequency": 0.36}),
    "auxiliary_input": (-np.inf, np.inf, 0.1, {"time_constant": 10.0}),
}
_CHOICES = {"place": ("drive", "response"), "side": (-1, 1), "order": (2, 3)}
_UNITS = {"time": 1, "time_constant": 1, "time_constants": 1, "frequency": -1}  # powers of seconds

EFFECTS = tuple(_LAWS)


# ------------------------------------------------------------------------------------- elements


def refine(drive, substeps):
    """Put ``substeps`` equal intervals between each two samples of a piecewise linear drive."""
    n = len(drive)
    fine = np.interp(np.arange((n - 1) * substeps + 1) / substeps, np.arange(n), drive)
    fine[::substeps] = drive
    return fine


@jit
def plays(signal, thresholds, weights, growth):
    """Weighted sum of play operators, first loaded from zero.

    Parameters
    ----------
    signal, growth : ndarray of shape (n_samples,)
        Input, and the factor of all thresholds at each sample.
    thresholds, weights : ndarray of shape (n_plays,)

    Returns
    -------
    ndarray of shape (n_samples,)
    """
    out = np.zeros(signal.size)
    for j in range(thresholds.size):
        state = 0.0
        for i in range(signal.size):
            r = thresholds[j] * growth[i]
            state = max(signal[i] - r, min(signal[i] + r, state))
            out[i] += weights[j] * state
    return out


@jit
def _follow(signal, largest):
    """Follow the signal with steps of at most ``largest``."""
    out = np.empty(signal.size)
    level = signal[0]
    for i in range(signal.size):
        level += min(max(signal[i] - level, -largest), largest)
        out[i] = level
    return out


def first_order(signal, dt, tau):
    """Solve tau x' + x = u exactly; x starts settled."""
    p = dt / tau
    gone = -np.expm1(-p)
    ramp = 1.0 - gone / p if p > 1e-4 else 0.5 * p - p * p / 6.0
    x0 = signal[0]
    return x0 + lfilter([ramp, gone - ramp], [1.0, gone - 1.0], signal - x0)


def shift(signal, dt, delay):
    """Shift in time; before its start the signal stood at its first value."""
    time = dt * np.arange(signal.size)
    return np.interp(time - delay, time, signal)


def dead_zones(signal, side, threshold, gain):
    """Add ``gain`` times what exceeds a threshold on one side."""
    return signal + gain * side * np.maximum(side * signal - threshold, 0.0)


# --------------------------------------------------------------------------------------- scheme


@dataclasses.dataclass(frozen=True)
class EffectPath:
    """The effects of one device.

    Use :meth:`resolve` to make one from what a user asks for. Strengths are shares of full scale
    and change nothing at zero; times are in s and frequencies in Hz.

    Attributes
    ----------
    settings : dict of str to dict
        The parameters of each effect that is present.
    drive, response : float
        Full scale of the drive and of the response.
    seed : int
        Of what is random, see :meth:`generator`.
    """

    settings: dict
    drive: float
    response: float
    seed: int = 0

    @classmethod
    def resolve(cls, effects, *, drive, response, period, caller, seed=0):
        """Check the effects and complete them by defaults.

        Parameters
        ----------
        effects : mapping of str to (mapping or float), iterable of str, str or None
            Effects and their parameters; a number is the strength, a name alone means defaults.
        drive, response : float
            Full scale.
        period : float
            Period of the first mode, s, that default times are multiples of.
        caller : str
            Function that errors name.
        seed : int, default=0

        Raises
        ------
        ValueError
            If an effect or a parameter has no such name, or a value is out of its range.
        """
        effects = () if effects is None else (effects,) if isinstance(effects, str) else effects
        if not isinstance(effects, Mapping):
            effects = {name: {} for name in effects}
        settings = {}
        for name, given in effects.items():
            if name not in _LAWS:
                raise ValueError(
                    f"The 'effects' parameter of {caller} must name effects among "
                    f"{', '.join(EFFECTS)}. Got {name!r} instead."
                )
            if isinstance(given, Real) and not isinstance(given, bool):
                given = {"strength": given}
            settings[name] = _complete(name, {} if given is True else given, period, caller)
        settings = {n: settings[n] for n in EFFECTS if n in settings and settings[n]["strength"]}
        return cls(settings, drive, response, seed)

    def generator(self, record, name=""):
        """Return the random generator of one effect in one record, independent of all others."""
        stream = 1 + EFFECTS.index(name) if name else 0
        return np.random.default_rng([self.seed, record, stream])

    def before(self, signal, dt):
        """Limit the drive: slew rate, saturation, dead zone, backlash."""
        if own := self.settings.get("slew_limit"):
            rate = 2.0 * np.pi * own["frequency"] * self.drive / own["strength"]
            signal = _follow(signal, rate * dt)
        if own := self.settings.get("input_saturation"):
            level = (1.0 - own["strength"]) * self.drive
            signal = np.clip(signal, -level, level)
        if own := self.settings.get("dead_zone"):
            level = own["strength"] * self.drive
            signal = signal - np.clip(signal, -level, level)
        return self._backlash(signal, "drive", self.drive)

    def growth(self, signal, dt):
        """Return the factor of the hysteresis thresholds at each sample: 1 when slow."""
        if own := self.settings.get("rate_dependence"):
            rate = np.abs(np.diff(signal, prepend=signal[0])) / dt
            return 1.0 + own["strength"] * rate / (2.0 * np.pi * own["frequency"] * self.drive)
        return np.ones(signal.size)

    def gain(self, signal):
        """Return the factor of the hysteresis output in a record with this drive."""
        if own := self.settings.get("amplitude_dependence"):
            return 1.0 + own["strength"] * np.abs(signal).max() / self.drive
        return 1.0

    def after(self, signal):
        """Bend what leaves the hysteresis on one side."""
        if own := self.settings.get("asymmetry"):
            threshold = own["threshold"] * self.response
            gain = own["strength"] / (1.0 - own["threshold"])
            signal = dead_zones(signal, own["side"], threshold, gain)
        return signal

    def dynamics(self, signal, dt):
        """Send a signal through the linear effects: lag, delay, creep, a further resonance."""
        if own := self.settings.get("lag"):
            signal = first_order(signal, dt, own["strength"] * own["time_constant"])
        if own := self.settings.get("delay"):
            signal = shift(signal, dt, own["strength"] * own["time"])
        if own := self.settings.get("creep"):
            share = own["strength"] / len(own["time_constants"])
            late = [first_order(signal, dt, tau) for tau in own["time_constants"]]
            signal = signal + share * sum(late)
        if own := self.settings.get("resonance"):
            ringing = oscillate(signal, dt, own["frequency"], own["damping"])
            signal = signal + own["strength"] * (ringing - signal)
        return signal

    def forces(self):
        """Return the forces in the equation of motion, for :func:`oscillate`, or None."""
        friction = self.settings.get("friction", {})
        cubic = self.settings.get("cubic_stiffness", {})
        hysteretic = self.settings.get("hysteretic_force", {})
        if not (friction or cubic or hysteretic):
            return None
        return Forces(
            scale=self.response,
            cubic=cubic.get("strength", 0.0),
            friction=friction.get("strength", 0.0),
            presliding=friction.get("presliding", 1.0),
            static=friction.get("static", 1.0),
            stribeck=friction.get("stribeck", 1.0),
            hysteretic=hysteretic.get("strength", 0.0),
            width=hysteretic.get("width", 1.0),
        )

    def sensor(self, signal):
        """Distort what the sensor sees: backlash, static nonlinearity, saturation."""
        signal = self._backlash(signal, "response", self.response)
        if own := self.settings.get("static_nonlinearity"):
            share = signal / self.response
            signal = signal * (1.0 + own["strength"] * share ** (own["order"] - 1))
        if own := self.settings.get("output_saturation"):
            level = (1.0 - own["strength"]) * self.response
            signal = np.clip(signal, -level, level)
        return signal

    def beside(self, n_samples, dt, record):
        """Return what adds to the response of a record, and the auxiliary input or None.

        The auxiliary input wanders slowly between about -1 and 1; it acts with a lag.
        """
        time = dt * np.arange(n_samples)
        added, auxiliary = np.zeros(n_samples), None
        if own := self.settings.get("drift"):
            added -= own["strength"] * self.response * np.expm1(-time / own["time_constant"])
        if own := self.settings.get("offset"):
            rng = self.generator(record, "offset")
            added += own["strength"] * self.response * rng.choice([-1, 1]) * rng.uniform(0.5, 1.0)
        if own := self.settings.get("periodic_disturbance"):
            phase = self.generator(record, "periodic_disturbance").uniform(0.0, 2.0 * np.pi)
            angle = 2.0 * np.pi * own["frequency"] * time + phase
            added += own["strength"] * self.response * np.sin(angle)
        if own := self.settings.get("auxiliary_input"):
            rng = self.generator(record, "auxiliary_input")
            cycles = rng.uniform(1.0, 4.0, 3) / (n_samples * dt)
            phases = rng.uniform(0.0, 2.0 * np.pi, 3)
            auxiliary = np.sin(2.0 * np.pi * np.outer(time, cycles) + phases).mean(axis=1)
            late = first_order(auxiliary, dt, own["time_constant"])
            added += own["strength"] * self.response * late
        return added, auxiliary

    def _backlash(self, signal, place, scale):
        own = self.settings.get("backlash")
        if not own or own["place"] != place:
            return signal
        width = np.array([own["strength"] * scale])
        return plays(signal, width, np.ones(1), np.ones(signal.size))


def _complete(name, given, period, caller):
    low, high, strength, further = _LAWS[name]
    known = {"strength": strength} | {
        key: _scaled(value, period ** _UNITS[key]) if key in _UNITS else value
        for key, value in further.items()
    }
    where = f"The 'effects' parameter of {caller} must"
    if not isinstance(given, Mapping):
        raise ValueError(
            f"{where} give the parameters of {name!r} as a mapping, or its strength as a number. "
            f"Got {given!r} instead."
        )
    for key, value in given.items():
        if key not in known:
            raise ValueError(
                f"{where} set parameters of {name!r} among {', '.join(known)}. Got {key!r} instead."
            )
        if key in _CHOICES:
            if value not in _CHOICES[key]:
                raise ValueError(
                    f"{where} set {key!r} of {name!r} to one of {_CHOICES[key]}. "
                    f"Got {value!r} instead."
                )
            continue
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            numbers = np.array(np.nan)
        several = key == "time_constants"
        fits = numbers.ndim == several and numbers.size and np.isfinite(numbers).all()
        if key == "strength":
            wanted, fits = f"a number from {low:g} to {high:g}", fits and low <= numbers <= high
        elif key == "threshold":
            wanted, fits = "a number from 0 to below 1", fits and 0 <= numbers < 1
        else:
            wanted = "a sequence of positive numbers" if several else "a positive number"
            fits = fits and np.all(numbers > 0)
        if not fits:
            raise ValueError(f"{where} set {key!r} of {name!r} to {wanted}. Got {value!r} instead.")
    return known | dict(given)


def _scaled(value, factor):
    return tuple(v * factor for v in value) if isinstance(value, tuple) else value * factor
