"""The scanning stage of Steinbusch (2020), simulated."""

import warnings
from functools import partial

import numpy as np
import pandas as pd
from sklearn.utils import Bunch

from .._jit import jit
from ..exceptions import RecordError
from ..records import record_slices, stack_records
from ._checks import interval, refuse, scalar
from ._device import Device, complete_effects, in_motion, path, simulate
from ._stepping import DeviceStepper
from ._test_signals import triangle
from .simulation import kelvin_voigt, oscillate, plays, refine, remembers

_RATE = 250e3  # Hz, of the data acquisition
_SPAN = 40.0  # V, half of the largest peak-to-peak drive
_SUBSTEPS = 8
_STEPS_A_PERIOD = 80  # of the first mode, where forces or velocities are computed
# sensor: range to either side and noise; displacement in um, velocity in um/s
_SENSORS = {"displacement": (5.0, 5e-4), "velocity": (2e5, 20.0)}
_BITS = 16


def load_scanning_stage_parameters() -> Bunch:
    r"""Return the published parameters of the high-speed scanning stage.

    .. math:: \hat u = a_0 V + \sum_{i=1}^5 a_i F_{r_i}[V], \quad
       G_{SD} = \frac{1}{k_0} + \sum_{i=1}^3 \frac{1}{k_i s + c_i}, \quad
       G_v = \frac{N(s)}{D(s)}, \quad \hat y = G_v G_{SD} \hat u

    Returns
    -------
    Bunch
        ``weights`` (6,), a_0 to a_5, and ``thresholds`` (6,) in V, by (3.6) for drives of 80 V
        peak to peak about zero, that of a_0 being zero; ``stiffnesses`` c_i and ``dampings`` k_i
        in s, (3,) each, with their ``compliances`` 1/c_i and ``time_constants`` k_i/c_i in s;
        ``numerator`` N and ``denominator`` D, highest power first, from V to um; the
        ``natural_frequencies`` in Hz and ``damping_ratios`` of its two resonances, (2,) each.

    See Also
    --------
    make_scanning_stage : A recording with these parameters.

    Notes
    -----
    The names of Steinbusch (2020), stiffness k_i and damping c_i, are exchanged. The static gain of
    (4.1) is 0.0243: in um/V, 80 V make a stroke of 3.42 um once creep has settled, which fits the
    piezo element (at most 8 um at 100 V) and the sensor (2.5 um/V). Since r_1 = 0, a_0 and a_1
    multiply the same signal, and only their sum can be identified.

    References
    ----------
    Steinbusch, *Hysteresis and Dynamics Compensation for Accurate Positioning in High Speed Piezo
    Scanning Stages*, 2020, Tables 4.2 and 4.3, (3.5) to (3.7), (4.1).

    Examples
    --------
    >>> from skhyst.datasets import load_scanning_stage_parameters
    >>> stage = load_scanning_stage_parameters()
    >>> stage.natural_frequencies.round(), stage.damping_ratios.round(4)
    (array([24392., 37255.]), array([0.0221, 0.0113]))
    """
    weights = np.array([1.1193, 0.0730, 0.1229, 0.0756, 0.10227, 0.0004])
    stiffnesses = np.array([12.0411, 6.4210, 25.6608])
    dampings = np.array([1.9502, 0.0016, 0.2244])
    numerator = np.array([2.43e29, 8.06e33, 9.10e39])
    denominator = np.array(
        [1.0, 5.19e5, 2.10e11, 5.31e16, 1.18e22, 1.61e27, 1.90e32, 1.48e37, 3.74e41]
    )
    poles = _poles(denominator)
    modes = poles[(poles.imag > 0.0) & (-poles.real < 0.1 * np.abs(poles))]
    modes = modes[np.argsort(np.abs(modes))]
    return Bunch(
        weights=weights,
        thresholds=_SPAN * np.array([0.0, 0.0, 0.2, 0.4, 0.6, 0.8]),
        stiffnesses=stiffnesses,
        dampings=dampings,
        compliances=1.0 / stiffnesses,
        time_constants=dampings / stiffnesses,
        numerator=numerator,
        denominator=denominator,
        natural_frequencies=np.abs(modes) / (2.0 * np.pi),
        damping_ratios=-modes.real / np.abs(modes),
    )


def make_scanning_stage(
    drive="identification",
    *,
    effects=None,
    measured="displacement",
    noise=None,
    quantize=True,
    dt=1.0 / _RATE,
    random_state=None,
) -> tuple[pd.DataFrame, pd.Series, Bunch]:
    """Return a recording of the simulated scanning stage, and the truth about it.

    It shares no code with the models of skhyst: plays by their recursion, linear dynamics exactly
    for a drive that is a straight line from sample to sample. Records start at rest, after a first
    loading from zero.

    Parameters
    ----------
    drive : {"identification", "validation", "small_signal"}, DataFrame, or array-like of shape \
            (n_samples,), default="identification"
        Voltage at the piezo element about its bias, V. ``"identification"``: triangles of 80 V
        peak to peak at 1, 10, 100 and 1000 Hz (section 4.3). ``"validation"``: the six experiments
        of chapter 5. ``"small_signal"``: white noise of 2 V peak to peak (section 4.1). A frame
        has the voltage in column 0, and its index carries records and time.
    effects : mapping, iterable of str, or str, optional
        Effects that the published model does not have, each with its parameters, its strength
        as a number, or by name alone, see :ref:`simulated_devices`. Full scale is 40 V and the
        response to it. A weaker amplifier is ``"lag"``, the signal processing ``{"delay": {"time":
        2.5e-5}}``.
    measured : {"displacement", "velocity"}, default="displacement"
        Output of the vibrometer, in um or um/s.
    noise : float, optional
        Standard deviation of the sensor's noise; 0.5 nm or 20 um/s by default.
    quantize : bool, default=True
        Whether the sensor has 16 bits over 10 um, or over 0.4 m/s, and saturates there.
    dt : float, default=4e-6
        Interval in s of a drive without times.
    random_state : int or None, default=None
        Seed of the noise, of the white drive, and of what is random in the effects.

    Returns
    -------
    X : DataFrame of shape (n_samples, 1) or (n_samples, 2)
        Column ``drive`` in V; index with the levels ``record`` and ``time`` in s.
    y : Series of shape (n_samples,)
        Response.
    truth : Bunch
        ``response`` without noise, ``hysteresis`` (output of the plays, V) and ``creep`` (that of
        the spring-dampers, V), Series each; ``noise_std``; ``resolution`` (step of the sensor, 0
        without); ``parameters``, of :func:`load_scanning_stage_parameters`; ``effects``, a dict
        with all parameters of each.

    Raises
    ------
    ValueError
        If an effect, one of its parameters or another argument is not one of those listed.
    RecordError
        If the drive is empty or not finite, or its index does not form records.

    See Also
    --------
    scanning_stage_stepper : The stage sample by sample.
    load_scanning_stage_parameters : Its parameters.

    Notes
    -----
    A named record is sampled in proportion to its frequency, 1 Hz at 500 Hz up to
    1000 Hz at 250 kHz: every n-th sample of 250 kHz, with no filter in between.

    References
    ----------
    See :func:`load_scanning_stage_parameters`.

    Examples
    --------
    >>> from skhyst.datasets import make_scanning_stage
    >>> X, y, truth = make_scanning_stage(effects={"creep": 0.1}, random_state=0)
    >>> X.index.get_level_values("record").unique().tolist()
    ['1 Hz', '10 Hz', '100 Hz', '1000 Hz']
    >>> print(f"stroke {y['10 Hz'].max() - y['10 Hz'].min():.1f} um, {truth.noise_std} um of noise")
    stroke 3.4 um, 0.0005 um of noise
    """
    caller = "make_scanning_stage"
    if measured not in _SENSORS:
        refuse(caller, "measured", "'displacement' or 'velocity'", measured)
    limit, default_noise = _SENSORS[measured]
    noise = scalar(caller, "noise", default_noise if noise is None else noise, negative=False)
    rng = np.random.default_rng(random_state)
    X = _drive(drive, dt, rng)
    stage = load_scanning_stage_parameters()
    effects = complete_effects(effects, 1.0 / stage.natural_frequencies[0], caller)
    records = record_slices(X, one_interval=False)
    device = Device(_SPAN, _full_scale(stage), records, seed=int(rng.integers(2**31)))
    respond = partial(_respond, stage=stage, measured=measured)
    X, signals = simulate(device, X, _path(stage), effects, respond)
    y = signals["response"] + noise * rng.normal(size=len(X))
    resolution = 2.0 * limit / 2**_BITS if quantize else 0.0
    if quantize:
        if np.abs(y).max() > limit:
            warnings.warn(
                f"The response leaves the range of the sensor, {limit:g} to either side, and is "
                "clipped. With quantize=False it is not.",
                UserWarning,
                stacklevel=2,
            )
        y = np.clip(resolution * np.round(y / resolution), -limit, limit)
    truth = Bunch(
        **{name: pd.Series(values, X.index, name=name) for name, values in signals.items()},
        noise_std=noise,
        resolution=resolution,
        parameters=stage,
        effects=effects,
    )
    return X, pd.Series(y, X.index, name="response"), truth


def scanning_stage_stepper(u0=0.0, *, dt=1.0 / _RATE, effects=None) -> DeviceStepper:
    """Return the scanning stage as a device that is driven sample by sample.

    Parameters
    ----------
    u0 : float, default=0.0
        Voltage at which the stage has rested, V.
    dt : float, default=4e-6
        Sampling interval in s.
    effects : mapping, iterable of str, or str, optional
        As in :func:`make_scanning_stage`. Effects that need a complete record are refused: additive
        disturbances and ``"amplitude_dependence"``.

    Returns
    -------
    DeviceStepper
        ``step(u)``, ``run(u)``, ``copy()``; the response is the displacement without noise, um.

    Raises
    ------
    ValueError
        If a parameter is not as above.

    See Also
    --------
    make_scanning_stage : A complete recording of it.
    skhyst.control.simulate_loop : A feedback loop around it.

    Examples
    --------
    >>> from skhyst.datasets import scanning_stage_stepper
    >>> stage = scanning_stage_stepper(dt=1e-4)
    >>> stage.run([10.0] * 1000)[[0, 9, 99, 999]].round(3)
    array([0.184, 0.342, 0.351, 0.365])
    """
    caller = "scanning_stage_stepper"
    stage, dt = load_scanning_stage_parameters(), interval(caller, dt)
    if np.ndim(u0) or not np.isfinite(u0):
        refuse(caller, "u0", "a finite voltage", u0)
    effects = complete_effects(effects, 1.0 / stage.natural_frequencies[0], caller)
    plant = in_motion(Device(_SPAN, _full_scale(stage), ()), _path(stage), effects, caller)
    return DeviceStepper(_Stage(plant, dt, stage).response, u0)


# ---------------------------------------------------------------------------------------- drives


def _drive(drive, dt, rng):
    """Return the frame of the drive, index of record and time."""
    if isinstance(drive, str):
        if drive not in _EXPERIMENTS:
            names = ", ".join(map(repr, _EXPERIMENTS))
            refuse("make_scanning_stage", "drive", f"a frame, an array or one of {names}", drive)
        return stack_records(_EXPERIMENTS[drive](rng))
    X = stack_records([drive if hasattr(drive, "iloc") else np.asarray(drive, dtype=float)])
    if X.index.levels[1].dtype.kind == "i":  # without times
        X = stack_records([X], dt=dt)
    if not len(X) or not np.isfinite(X.iloc[:, 0].to_numpy(dtype=float)).all():
        raise RecordError("The drive of make_scanning_stage must have samples, all of them finite.")
    return X.iloc[:, :1].set_axis(["drive"], axis=1)


def _loop(frequency, rate, n_samples=2000):
    cycles = round(n_samples * frequency / rate)
    return triangle(_SPAN, frequency, n_cycles=cycles, dt=1.0 / rate)


def _identification(rng):
    rates = {1: 500.0, 10: 5e3, 100: 50e3, 1000: _RATE}
    return {f"{f} Hz": _loop(f, rate) for f, rate in rates.items()}


def _validation(rng):
    amplitudes = _SPAN * np.array([1.0, 0.25, 0.5, 0.75, 1.0, 0.6, 0.35, 0.9])
    up = [10.0, 30.0, 100.0, 300.0, 1000.0]
    mixed = [1000.0, 10.0, 500.0, 50.0, 200.0, 1000.0]
    return {
        "30 Hz": _loop(30, 15e3),
        "300 Hz": _loop(300, 150e3),
        "100 Hz, amplitudes": triangle(amplitudes, 100.0, dt=2e-5),
        "1000 Hz, amplitudes": triangle(amplitudes, 1000.0, dt=1.0 / _RATE),
        "rising frequency": triangle(_SPAN, up, dt=1.0 / _RATE),
        "mixed frequencies": triangle(_SPAN, mixed, dt=1.0 / _RATE),
    }


def _small_signal(rng):
    return {"white noise": stack_records([rng.uniform(-1.0, 1.0, 2**17)], dt=1.0 / _RATE)}


_EXPERIMENTS = {
    "identification": _identification,
    "validation": _validation,
    "small_signal": _small_signal,
}


# --------------------------------------------------------------------------------------- physics


def _poles(denominator):
    """Return the roots; the coefficients span forty decades, so s is in units of 1e5 rad/s."""
    powers = np.arange(len(denominator))
    return 1e5 * np.roots(denominator / 1e5**powers)


def _full_scale(stage):
    """Return the settled response to the largest drive, um."""
    settled = stage.weights @ (_SPAN - stage.thresholds) * (1.0 + stage.compliances.sum())
    return float(settled * stage.numerator[-1] / stage.denominator[-1])


def _path(stage):
    hysteresis = partial(plays, thresholds=stage.thresholds, weights=stage.weights)
    return path(hysteresis, partial(_vibrate, stage=stage))


def _respond(plant, drives, dt, additive, stage, measured):
    """Return the signals of one record at its samples."""
    moving = _Stage(plant, dt, stage, fine=measured == "velocity")
    signals = moving.signals(drives[:, 0])
    if measured == "velocity":
        signals["response"] = _slope(signals["response"], dt / moving.substeps)
        additive = np.gradient(additive, dt)
    signals = {name: signal[:: moving.substeps] for name, signal in signals.items()}
    return signals | {"response": signals["response"] + additive}


class _Stage:
    """The stage at an interval; each call continues where the last one ended."""

    def __init__(self, plant, dt, stage, fine=False):
        self.substeps = _SUBSTEPS
        if fine or "scale" in plant.places["motion"][0].keywords:  # it has forces
            finest = 1.0 / (_STEPS_A_PERIOD * stage.natural_frequencies[0])
            self.substeps = max(self.substeps, int(np.ceil(dt / finest)))
        self.step = dt / self.substeps
        self.plant, self.refined = plant.remembering(), remembers(refine)
        units = {"taus": stage.time_constants, "compliances": stage.compliances}
        self.creep = remembers(partial(kelvin_voigt, **units))

    def response(self, drives):
        """Return the displacement (n_samples,) under drives (n_samples, 1)."""
        fine = self.signals(drives[:, 0])["response"]
        return fine[(fine.size - 1) % self.substeps :: self.substeps]

    def signals(self, drive):
        """Return the signals at all steps, by name."""
        plant = self.plant.adapt("gain", peak=np.abs(drive).max())
        fine = self.refined(drive, self.substeps)
        hysteresis = plant.send(fine, self.step, "first", "core", "gain", "middle")
        creep = self.creep(hysteresis, self.step)
        response = plant.send(creep, self.step, "dynamics", "motion", "last")
        return {"hysteresis": hysteresis, "creep": creep, "response": response}


def _vibrate(signal, h, stage, memory=None, **forces):
    """Send a signal through (4.1), a sum of r / (s - p) over its poles p, from rest.

    Each term is advanced exactly for an input that is straight within a step. With forces in the
    equation of motion the first mode is a mass of its own, behind the other poles.
    """
    memory = {} if memory is None else memory
    frequency, damping = stage.natural_frequencies[0], stage.damping_ratios[0]
    if not memory:
        terms = _terms(h, stage, bool(forces))
        memory.update(start=signal[0], terms=terms, last=0.0, motion={})
        memory["state"] = np.zeros(terms.shape[1], dtype=complex)
    start, state = memory["start"], memory["state"]
    total = _summed(signal - start, memory["last"], memory["terms"], state)
    memory["last"] = signal[-1] - start
    total += start * stage.numerator[-1] / stage.denominator[-1]
    motion = {"memory": memory["motion"]}
    return oscillate(total, h, frequency, damping, **forces, **motion) if forces else total


def _terms(h, stage, forces):
    """Return what a step does to the term of each pole: decay, weights of the input."""
    poles, gain = _poles(stage.denominator), 1.0
    if forces:
        w = 2.0 * np.pi * stage.natural_frequencies[0]
        poles, gain = poles[np.abs(np.abs(poles) - w) > 1e-6 * w], 1.0 / w**2
    kept = poles[poles.imag >= 0.0]
    residues = [np.polyval(stage.numerator, p) / np.prod(p - poles[poles != p]) for p in kept]
    # a conjugate gives the same real part
    residues = gain * np.array(residues) * np.where(kept.imag == 0.0, 1.0, 2.0)
    q = kept * h
    change = np.expm1(q)
    ramp = change / q - 1.0
    return np.stack([1.0 + change, residues / kept * ramp, residues / kept * (change - ramp)])


@jit
def _summed(signal, last, terms, state):
    out = np.zeros(signal.size)
    for j in range(state.size):
        x, before = state[j], last
        for i in range(signal.size):
            x = terms[0, j] * x + terms[1, j] * signal[i] + terms[2, j] * before
            before = signal[i]
            out[i] += x.real
        state[j] = x
    return out


def _slope(signal, h):
    """Return the derivative by differences of the fourth order, of the second at the ends."""
    slope = np.gradient(signal, h, edge_order=2) if signal.size > 2 else np.zeros(signal.size)
    if signal.size > 4:
        wide = (signal[4:] - signal[:-4]) / (4.0 * h)
        slope[2:-2] = (4.0 * slope[2:-2] - wide) / 3.0
    return slope
