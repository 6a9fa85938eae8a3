"""The inchworm motor of Han et al. (undated), simulated."""

import copy
from functools import partial

import numpy as np
import pandas as pd
from sklearn.utils import Bunch, check_random_state

from .._jit import jit
from ..records import record_slices, stack_records
from ._checks import count, interval, refuse, scalar
from ._device import Device, complete_effects, in_motion, path, simulate
from ._stepping import DeviceStepper
from ._test_signals import decaying_sine
from .simulation import bouc_wen, oscillate, plays, refine, remembers

_MASS, _DAMPING, _STIFFNESS = 3.04, 58.0, 2.312e6  # kg, N s/m, N/m, from (15)
_BENDING = 0.2657 / _STIFFNESS * 1e6  # c1, um/V
_EXTENDING = 0.05  # c2, um/V: chosen, the paper has none
_FULL_DRIVE = 5.0  # V, amplitude of (14)
_FULL_SCALE = _FULL_DRIVE, _BENDING * _FULL_DRIVE
_FREQUENCY = np.sqrt(_STIFFNESS / _MASS) / (2.0 * np.pi)  # Hz
_RATIO = _DAMPING / (2.0 * np.sqrt(_STIFFNESS * _MASS))
_COLUMNS = ["drive", "clamp", "drive_2", "clamp_2"]
_MOTION = partial(oscillate, frequency=_FREQUENCY, damping=_RATIO, base=1.0)
_ABOUT_ZERO = ("cubic_stiffness", "static_nonlinearity", "output_saturation")


def _bouc_wen_loop(u, step, share, limit, shape, stretch=0.0, memory=None):
    memory = {} if memory is None else memory
    state = memory.get("state", (0.0, 0.0, 0.0))
    out, memory["state"] = _bend_away(u, share, limit, shape, stretch / step, state)
    return out


@jit
def _bend_away(u, share, limit, shape, stretch, state):
    out = np.empty(u.size)
    h, before, begun = state
    for i in range(u.size):
        wide = limit * (1.0 + begun * stretch * abs(u[i] - before))
        h = bouc_wen(h, u[i] - before, wide, shape)
        before, begun = u[i], 1.0
        out[i] = share * h
    return out, (h, before, begun)


def _play_loop(u, step, thresholds, weights, stretch=0.0, memory=None):
    return u - plays(u, step, thresholds, weights, stretch, memory=memory)


def _no_loop(u, step, stretch=0.0):
    return np.zeros(u.size)


# the voltage lost in the hysteresis; numbers chosen so that the loop of (12) is as wide as
# the paper draws it, 18 % of the stroke
_LOOPS = {
    "bouc_wen": partial(_bouc_wen_loop, share=0.45, limit=1.5, shape=0.6),
    "prandtl_ishlinskii": partial(
        _play_loop,
        thresholds=np.array([0.0, 0.3, 0.7, 1.2, 1.8, 2.5]),
        weights=np.array([0.48, 0.12, 0.14, 0.13, 0.08, 0.05]),
    ),
    None: partial(_no_loop),
}


def walking_drive(
    n_steps=20, *, amplitude=5.0, frequency=10.0, direction=1, waveform="sine", dt=1e-4
) -> pd.DataFrame:
    r"""Return the four voltages that make the inchworm motor walk.

    The pairs of benders take turns: the longer one clamps the runner and carries it forward, the
    other swings back. With the phase :math:`\phi = 2 \pi f t`, the voltages of pair 1 are
    :math:`u_1 = -A \cos \phi` and :math:`u_2 = A \sin \phi`; those of pair 2 lag by half a period.

    Parameters
    ----------
    n_steps : int, default=20
        Steps, two per period.
    amplitude, frequency : float, default=5.0 and 10.0
        A, in V, and f, in Hz.
    direction : {1, -1}, default=1
        Sign of the travel.
    waveform : {"sine", "trapezoid"}, default="sine"
        Sinusoids, or a triangle that bends and a trapezoid that clamps.
    dt : float, default=1e-4
        Sampling interval in s.

    Returns
    -------
    DataFrame of shape (n_samples, 4)
        Columns ``drive``, ``clamp`` (u1 and u2 of pair 1), ``drive_2``, ``clamp_2`` (pair 2), in V.

    Raises
    ------
    ValueError
        If a parameter is out of its range.

    See Also
    --------
    make_inchworm_motor : The motor.

    References
    ----------
    See :func:`make_inchworm_motor`, Section 2.1 and Fig. 2.

    Examples
    --------
    >>> from skhyst.datasets import walking_drive
    >>> walking_drive(2, frequency=10.0).shape
    (1001, 4)
    """
    caller = "walking_drive"
    n_steps, dt = count(caller, "n_steps", n_steps), interval(caller, dt)
    amplitude = scalar(caller, "amplitude", amplitude, positive=True)
    frequency = scalar(caller, "frequency", frequency, positive=True)
    if frequency * dt > 0.05:
        wanted = f"at most 0.05 / dt = {0.05 / dt:g} Hz, 20 samples per period"
        refuse(caller, "frequency", wanted, frequency)
    if direction not in (-1, 1):
        refuse(caller, "direction", "1 or -1", direction)
    if waveform not in ("sine", "trapezoid"):
        refuse(caller, "waveform", "'sine' or 'trapezoid'", waveform)
    n_samples = round(0.5 * n_steps / (frequency * dt)) + 1
    phase = 2.0 * np.pi * frequency * dt * np.arange(n_samples)
    bend, clamp = -np.cos(phase), np.sin(phase)
    if waveform == "trapezoid":
        bend = 2.0 / np.pi * np.arcsin(bend)
        clamp = np.clip(3.0 * 2.0 / np.pi * np.arcsin(clamp), -1.0, 1.0)
    columns = np.column_stack([direction * bend, clamp, -direction * bend, -clamp])
    return stack_records([amplitude * columns], dt=dt).set_axis(_COLUMNS, axis=1)


def make_inchworm_motor(
    drive=None,
    *,
    dt=1e-4,
    hysteresis="bouc_wen",
    effects=None,
    noise=5e-4,
    resolution=1e-4,
    substeps=10,
    random_state=None,
) -> tuple[pd.DataFrame, pd.Series, Bunch]:
    r"""Simulate the inchworm piezo motor.

    Two pairs of benders :math:`i = 1, 2` carry a runner,

    .. math:: x_{p,i} = c_1 u_{1,i} - h_x, \quad z_{p,i} = c_2 u_{2,i} - h_z, \quad
       m \ddot x = k (X_p - x) + b (\dot X_p - \dot x)

    with :math:`m = 3.04` kg, :math:`k = 2.312 \cdot 10^6` N/m, :math:`b = 58` N s/m and
    :math:`c_1 = 0.2657\,\mathrm{N/V} / k`, so that 3.5 V bend by 0.4 um and the first mode is at
    138.8 Hz. The pair with the larger :math:`z_p` clamps the runner; :math:`X_p` follows it from
    where it stands when it takes over, and so the runner travels. With one voltage alone, pair 1
    stays clamped: the experiments of the identification.

    The hysteresis is :math:`h_x = c_1 h(u_1)`, with h a Bouc-Wen law, :math:`dh = 0.45\, du\, (1 -
    |h|/h_m (0.6\,\mathrm{sign}(h\,du) + 0.4))`, or six plays; loops of 3.5 V are as wide as 18 %
    of the stroke. The simulation shares no code with the package's models.

    Parameters
    ----------
    drive : DataFrame or array-like of shape (n_samples,) or (n_samples, 1 or 4), default=None
        Voltage u1 in V, or the four of :func:`walking_drive`; a frame may hold several records.
        None: :func:`decaying_sine`, (12), 35,001 samples.
    dt : float, default=1e-4
        Sampling interval in s of a drive without times.
    hysteresis : {"bouc_wen", "prandtl_ishlinskii", None}, default="bouc_wen"
        Law of h; None for a linear motor.
    effects : mapping, iterable of str, str or None, default=None
        Further physical effects: a name alone for its defaults, name -> strength, or name ->
        parameters, see :ref:`simulated_devices`. Full scale is 5 V and 0.575 um.
    noise : float, default=5e-4
        Standard deviation of the sensor's white noise, um.
    resolution : float, default=1e-4
        Step of the sensor, um; 0 for none.
    substeps : int, default=10
        Steps of the simulation in a sampling interval.
    random_state : int, RandomState instance or None, default=None
        Seed of the noise and of the random values in effects.

    Returns
    -------
    X : DataFrame of shape (n_samples, n_inputs)
        Column 0 is the drive, in V; ``temperature``, the last, where the auxiliary input acts.
    y : Series of shape (n_samples,)
        Measured displacement of the runner, um.
    truth : Bunch
        ``response``: displacement without sensor noise, Series, um. ``signals``: frame of the
        limited ``drive`` (V), ``hysteresis`` h_x, ``actuator`` X_p, ``runner`` x (um), and where
        it walks those of pair 2, both ``height`` and the pair in ``contact``. ``noise_std``:
        of noise and rounding, um. ``parameters``: those of the motor in SI units,
        ``frequency`` in Hz and ``damping_ratio``. ``effects``: those present, with all parameters.

    Raises
    ------
    ValueError
        If the drive or a parameter is not as above.
    RecordError
        If the rows of the drive are no evenly sampled records.

    See Also
    --------
    inchworm_motor_stepper : The motor sample by sample.
    walking_drive : The drive that makes it walk.

    References
    ----------
    S. Han, Y. Xu, J. Yu, X. Yang, "An identification method for dynamic systems with SCNs
    hysteresis compensator: application to the inchworm piezo motor", (1) to (4), (12), (15).

    Examples
    --------
    >>> from skhyst.datasets import make_inchworm_motor, walking_drive
    >>> X, y, truth = make_inchworm_motor(random_state=0)
    >>> len(X), round(truth.parameters["frequency"], 1)
    (35001, 138.8)
    >>> X, y, truth = make_inchworm_motor(walking_drive(20), effects={"creep": 0.1})
    >>> bool(y.iloc[-1] > 10.0)
    True
    """
    caller = "make_inchworm_motor"
    loop = _loop(hysteresis, caller)
    noise = scalar(caller, "noise", noise, negative=False)
    resolution = scalar(caller, "resolution", resolution, negative=False)
    substeps = count(caller, "substeps", substeps)
    X, records = _read_drive(drive, interval(caller, dt), caller)
    effects = _effects(effects, X.shape[1], caller)
    seed = check_random_state(random_state).randint(np.iinfo(np.int32).max)
    device = Device(*_FULL_SCALE, records, seed)
    respond = partial(_respond, loop=loop, substeps=substeps)
    X, signals = simulate(device, X, path(loop, _MOTION), effects, respond)
    response = pd.Series(signals.pop("response"), X.index, name="response")
    draws = [
        device.generator(number).standard_normal(record.n_samples)
        for number, record in enumerate(records)
    ]
    y = response + noise * np.concatenate(draws)
    truth = Bunch(
        response=response,
        signals=pd.DataFrame(signals, X.index),
        noise_std=float(np.hypot(noise, resolution / np.sqrt(12.0))),
        parameters={
            "mass": _MASS,
            "damping": _DAMPING,
            "stiffness": _STIFFNESS,
            "bending": 1e-6 * _BENDING,
            "extending": 1e-6 * _EXTENDING,
            "frequency": float(_FREQUENCY),
            "damping_ratio": float(_RATIO),
            "hysteresis": copy.deepcopy(loop.keywords),
        },
        effects=effects,
    )
    return X, np.round(y / resolution) * resolution if resolution else y, truth


def inchworm_motor_stepper(
    u0=0.0, *, dt=1e-4, hysteresis="bouc_wen", effects=None, substeps=10
) -> DeviceStepper:
    """Return the inchworm motor as a device that is driven sample by sample.

    Parameters
    ----------
    u0 : float or array-like of shape (1 or 4,), default=0.0
        Voltage u1, or the four of :func:`walking_drive`, at which the motor has rested, in V.
    dt : float, default=1e-4
        Sampling interval in s.
    hysteresis : {"bouc_wen", "prandtl_ishlinskii", None}, default="bouc_wen"
        As in :func:`make_inchworm_motor`.
    effects : mapping, iterable of str, str or None, default=None
        As in :func:`make_inchworm_motor`, except for effects of complete records: what adds to the
        response, and ``"amplitude_dependence"``.
    substeps : int, default=10
        As in :func:`make_inchworm_motor`.

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
    make_inchworm_motor : A complete recording of it.
    skhyst.control.simulate_loop : A feedback loop around it.

    Examples
    --------
    >>> from skhyst.datasets import inchworm_motor_stepper, walking_drive
    >>> walk = walking_drive(20).to_numpy()
    >>> motor = inchworm_motor_stepper(walk[0])
    >>> travel = motor.run(walk[1:])
    >>> print(f"{travel[-1] - travel[0]:.1f} um")
    19.8 um
    """
    caller = "inchworm_motor_stepper"
    loop, dt, substeps = (
        _loop(hysteresis, caller),
        interval(caller, dt),
        count(caller, "substeps", substeps),
    )
    if np.size(u0) not in (1, 4) or not np.isfinite(u0).all():
        refuse(caller, "u0", "finite, one voltage or four", u0)
    effects = _effects(effects, np.size(u0), caller)
    plant = in_motion(Device(*_FULL_SCALE, ()), path(loop, _MOTION), effects, caller)
    motor = _Motor(plant, dt, loop, substeps, np.size(u0))
    return DeviceStepper(motor.response, u0)


def _loop(hysteresis, caller):
    if hysteresis not in list(_LOOPS):
        refuse(caller, "hysteresis", "'bouc_wen', 'prandtl_ishlinskii' or None", hysteresis)
    return _LOOPS[hysteresis]


def _effects(effects, n_columns, caller):
    effects = complete_effects(effects, 1.0 / _FREQUENCY, caller)
    if n_columns > 1 and (wrong := [name for name in _ABOUT_ZERO if name in effects]):
        raise ValueError(
            f"The 'effects' parameter of {caller} must not hold {', '.join(wrong)} for a motor "
            "that walks: they belong to a displacement about zero. Got a drive of 4 columns."
        )
    return effects


def _respond(plant, drives, dt, additive, loop, substeps):
    """Return the signals of one record at its samples."""
    signals = _Motor(plant, dt, loop, substeps, drives.shape[1]).signals(drives)
    return signals | {"response": signals["response"] + additive}


class _Motor:
    """The motor at an interval; each call continues where the last one ended."""

    def __init__(self, plant, dt, loop, substeps, n_columns):
        self.dt, self.substeps = dt, substeps
        self.plants = [plant.remembering() for _ in range(n_columns)]
        self.refined = [remembers(refine) for _ in range(n_columns)]
        self.clamps = [remembers(loop) for _ in range(n_columns // 2)]
        self.stood = None

    def response(self, drives):
        """Return the displacement (n_samples,) under drives (n_samples, n_columns)."""
        return self.signals(drives)["response"]

    def signals(self, drives):
        """Return the signals at the samples, by name."""
        step = self.dt / self.substeps
        drives = [
            plant.send(refined(column, self.substeps), step, "first")
            for plant, refined, column in zip(self.plants, self.refined, drives.T, strict=True)
        ]
        pairs = zip(self.plants[::2], drives[::2], strict=True)
        bends, losses = zip(*(_bend(plant, u, step) for plant, u in pairs), strict=True)
        signals = {"drive": drives[0], "hysteresis": losses[0], "actuator": bends[0]}
        if len(drives) > 1:
            clamps = zip(self.clamps, drives[1::2], strict=True)
            heights = [_EXTENDING * (u - loop(u, step)) for loop, u in clamps]
            first = heights[0] >= heights[1]
            signals |= {
                "drive_2": drives[2],
                "hysteresis_2": losses[1],
                "height": heights[0],
                "height_2": heights[1],
                "contact": np.where(first, 1, 2),
                "actuator": self._carried(first, *bends),
            }
        motion = self.plants[0]
        signals["runner"] = motion.send(signals["actuator"], step, "motion")
        samples = slice((len(drives[0]) - 1) % self.substeps, None, self.substeps)
        signals = {name: signal[samples] for name, signal in signals.items()}
        return signals | {"response": motion.send(signals["runner"], self.dt, "last")}

    def _carried(self, first, *bends):
        """Return the displacement of the runner, which moves with the pair in contact."""
        if self.stood is None:
            self.stood = bends[not first[0]][0], bends[0][0], bends[1][0]
        moved = [
            np.diff(bend, prepend=last) for bend, last in zip(bends, self.stood[1:], strict=True)
        ]
        position = self.stood[0] + np.cumsum(np.where(first, *moved))
        self.stood = position[-1], bends[0][-1], bends[1][-1]
        return position


def _bend(plant, u, step):
    """Return the deflection of a pair, and its hysteresis h_x, in um."""
    loss = _BENDING * plant.send(u, step, "core")
    plant = plant.adapt("gain", peak=np.abs(u).max())
    return plant.send(_BENDING * u - loss, step, "gain", "middle", "dynamics"), loss


def _read_drive(drive, dt, caller):
    """Return the drive as a frame with times, and its records."""
    if drive is None:
        drive = decaying_sine(3.5, 5.0, decay=1.0, duration=3.5, dt=dt)
    values = np.asarray(drive, dtype=float)
    values = values[:, None] if values.ndim == 1 else values
    if values.ndim != 2 or values.shape[1] not in (1, 4) or len(values) < 2:
        refuse(caller, "drive", "at least two rows of one column or four", values.shape)
    if not np.isfinite(values).all():
        refuse(caller, "drive", "finite", "NaN or infinity")
    index = drive.index if hasattr(drive, "iloc") else None
    X = pd.DataFrame(values, index, _COLUMNS[: values.shape[1]])
    records = record_slices(X, dt=dt, one_interval=False)
    if X.index.dtype.kind in "iu":  # rows are counted: stack_records makes times
        labels = None if len(records) == 1 else range(len(records))
        X = stack_records([X.to_numpy()[r.rows] for r in records], labels=labels, dt=dt)
        X = X.set_axis(_COLUMNS[: values.shape[1]], axis=1)
    return X, records
