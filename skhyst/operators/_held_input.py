r"""The course of an operator's input between its samples.

It is a straight line ("foh"), or constant ("zoh"), for which the operators are written. Or it is
the signal through the samples without any content above half the sampling rate ("bandlimited"), as
a recorder with an anti-aliasing filter gives it. Such an input is interpolated by

    u(t) = sum_k u[k] h(t / dt - k) w(t / dt - k),   h(x) = int_0^1/2 2 cos(2 pi f x) g(f) df

where h is sinc(x) for g = 1, with a Kaiser window w of 32 samples to either side: to 1e-4 for
content up to 0.92 of half the sampling rate (Kaiser, *IEEE International Symposium on Circuits and
Systems*, 1974). Beyond its ends a record is continued by its point reflection at the end, which
keeps value and slope; the error of that reaches as far as the window. The operator is then run with
straight lines between m times as many samples, which attenuates content at f cycles per sample by
``sinc(f / m)^2``. If no output depends on the input of the same instant, ``g(f) = 1 / sinc(f /
m)^2`` compensates for that, with m = 4: there remains an image at m - f cycles per sample, ``(f /
(m - f))^2`` times as large, to which dynamics hardly respond. The points are then not quite on the
signal. If an output depends on the input of the same instant, they have to be: g = 1 and m = 16,
with an error of 3e-3 at half the sampling rate. Neither choice depends on the drive, so that the
response to a record does not depend on the spectrum of earlier ones.
"""

from dataclasses import replace
from functools import cache, cached_property, lru_cache, singledispatch, wraps

import numpy as np
from scipy.signal import upfirdn
from scipy.signal.windows import kaiser

from ._protocol import Operator

BANDLIMITED = "bandlimited"
_REACH = 32  # samples to either side from which a value between samples is interpolated
_SHAPE = 7.86  # beta of the Kaiser window for 80 dB: 0.1102 (80 - 8.7)
_FACTOR = {True: 4, False: 16}  # finer samples per sample; True: of a strictly proper operator
_NODES = 256  # nodes of the integral over frequency, whose integrand has 32 periods at most
_KEPT = 1 << 15  # samples of a drive up to which its finer samples are cached: 4 MB
_SAME = 1e-9  # relative difference of two substeps that counts as rounding
_ENOUGH = 1e-3  # tolerated error of straight lines, relative to the drive's standard deviation


def is_straight(u):
    """Whether straight lines between the samples are as good as a band-limited signal.

    Parameters
    ----------
    u : ndarray of shape (n_samples,) or (n_samples, n_inputs)
        Signal.

    Returns
    -------
    bool
        Whether their spectral error is 1e-3 of its standard deviation or less.
    """
    u = np.reshape(u, (len(u), -1))
    u = (u - u.mean(axis=0)) / np.maximum(np.abs(u).max(axis=0, initial=0.0), np.finfo(float).tiny)
    power = np.square(np.abs(np.fft.rfft(u * np.hanning(len(u))[:, None], axis=0)))
    missing = np.square(1.0 - np.sinc(np.fft.rfftfreq(len(u))) ** 2)
    return bool(np.all(missing @ power <= _ENOUGH**2 * power.sum(axis=0)))


def finer_samples(u, proper):
    """Return points between which straight lines approximate a band-limited signal.

    Parameters
    ----------
    u : ndarray of shape (n_samples,) or (n_samples, n_columns)
        Signal.
    proper : bool
        Whether the driven operator is strictly proper: then there are m = 4 points per sample,
        which compensate for the attenuation by the lines, else 16 points on the signal itself.

    Returns
    -------
    ndarray of shape (1 + m (n_samples - 1),) or (1 + m (n_samples - 1), n_columns)
    """
    m = _FACTOR[proper]
    n, around = 1 + m * (len(u) - 1), ((_REACH, _REACH), *((0, 0),) * (u.ndim - 1))
    if not u.size:
        return np.empty((n, *u.shape[1:]))
    padded = np.pad(u, around, mode="reflect", reflect_type="odd")
    begin = 2 * _REACH * m
    return np.ascontiguousarray(upfirdn(_weights(proper), padded, up=m, axis=0)[begin : begin + n])


def _finer_drive(u, proper):
    """Return :func:`finer_samples` of a drive, cached for repeated evaluations of a fit."""
    if len(u) > _KEPT:
        return finer_samples(u, proper)
    return _kept(np.ascontiguousarray(u).tobytes(), u.shape, proper)


@lru_cache(maxsize=16)
def _kept(values, shape, proper):
    finer = finer_samples(np.frombuffer(values).reshape(shape), proper)
    finer.flags.writeable = False
    return finer


@cache
def _weights(proper):
    """Return the interpolation weights of a finer sample."""
    m = _FACTOR[proper]
    places = np.arange(-_REACH * m, _REACH * m + 1)
    nodes, parts = np.polynomial.legendre.leggauss(_NODES)
    f = 0.25 * (nodes + 1.0)  # from 0 to 1/2
    parts = 0.5 * parts / (np.sinc(f / m) ** 2 if proper else 1.0)
    weights = np.cos(2.0 * np.pi * np.outer(places / m, f)) @ parts * kaiser(len(places), _SHAPE)
    for phase in range(m):  # a constant signal stays constant
        weights[phase::m] /= weights[phase::m].sum()
    return weights


class HeldInput(Operator):
    """Base of operators with a field ``hold``: the course of their input between samples.

    A subclass is written for straight lines and, if ``holds`` says so, for constants; with a
    band-limited input, it is run on finer samples. It then reads later input: it is neither stepped
    nor inverted, and a record that is run in pieces differs near the cuts.
    """

    hold = "foh"
    holds = ("foh", "zoh", BANDLIMITED)
    moves_at_rest = True
    strictly_proper = False  # whether no output depends on the input of the same instant

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        for name, finely in _FINELY.items():
            if name in vars(cls):
                setattr(cls, name, _either(vars(cls)[name], finely))

    def __post_init__(self):
        super().__post_init__()
        if "hold" in vars(self) and self.hold not in self.holds:  # a field of its own
            self._require("hold", False, f"be {' or '.join(map(repr, self.holds))}")

    @property
    def causal(self):
        return self.hold != BANDLIMITED

    @property
    def at_once(self):
        return self.causal

    @cached_property
    def _memory(self):
        return {}  # discretising costs as much as a short record

    def __getstate__(self):
        return {k: v for k, v in self.__dict__.items() if k != "_memory"}

    def _finer(self, factor):
        """Return the operator of an input that is straight between finer samples."""
        n = getattr(self, "n_substeps", None)
        substeps = {} if n is None else {"n_substeps": -(-n // factor)}
        key = BANDLIMITED, *substeps.values()
        if key not in self._memory:
            self._memory[key] = replace(self, hold="foh", **substeps)
        return self._memory[key]


def _either(own, finely):
    """Return a method that calls another one if the input is band-limited."""

    @wraps(own)
    def method(self, *args, **kwargs):
        return (finely if self.hold == BANDLIMITED else own)(self, *args, **kwargs)

    return method


def _init(self, u0, initial_state="rest"):
    return self._finer(1).init(u0, initial_state), np.empty((0, *np.shape(u0)))


def _run(self, u, dt, state=None):
    u = np.asarray(u, dtype=float)
    inner, past = _init(self, u[0]) if state is None else state
    if not len(u):
        return np.empty(0), (inner, past)
    whole, m = np.concatenate([past, u]), _FACTOR[self.strictly_proper]
    begin = max(m * (len(past) - 1) + 1, 0)
    finer = _finer_drive(whole, self.strictly_proper)[begin:]
    y, inner = self._finer(m).run(finer, dt / m, inner)
    first = m - 1 if len(past) else 0
    return np.ascontiguousarray(y[first::m]), (inner, whole[-_REACH:])


def _sensitivities(self, u, du, dt, initial_state="rest"):
    u, du = np.asarray(u, dtype=float), np.asarray(du, dtype=float)
    proper = self.strictly_proper
    signals, m = (_finer_drive(u, proper), finer_samples(du, proper)), _FACTOR[proper]
    y, dy = self._finer(m).sensitivities(*signals, dt / m, initial_state)
    return np.ascontiguousarray(y[::m]), np.ascontiguousarray(dy[::m])


def _by_start(self, u, dt, start):
    u, m = np.asarray(u, dtype=float), _FACTOR[self.strictly_proper]
    dy = self._finer(m).by_start(_finer_drive(u, self.strictly_proper), dt / m, start)
    return np.ascontiguousarray(dy[::m])


def _inverse(self):
    raise ValueError(
        f"{type(self).__name__} has no inverse: with hold='bandlimited' it looks ahead. Fit it "
        "with 'foh' or 'zoh' instead."
    )


def _compiled_step(self, dt, state):
    raise NotImplementedError(
        f"{type(self).__name__} cannot be stepped: with hold='bandlimited' it looks ahead, since "
        "the drive between two samples depends on later ones. Fit it with 'foh' or 'zoh' instead."
    )


_FINELY = {
    "init": _init,
    "run": _run,
    "sensitivities": _sensitivities,
    "by_start": _by_start,
    "compiled_step": _compiled_step,
    "inverse": _inverse,
}


@singledispatch
def resampled(operator, own, dt):
    """Return the equivalent operator at another sampling interval.

    Parameters
    ----------
    operator : Operator
        The operator.
    own, dt : float
        Sampling interval of the operator, NaN where it has none, and the new one, in s.

    Returns
    -------
    Operator or None
        None if no operator has exactly the same response to a drive with the same course between
        samples.
    """
    return operator if operator.memoryless else None


@resampled.register
def with_substeps_resampled(operator: HeldInput, own, dt):
    """Return an operator with substeps, if it has any, of the same length."""
    n = getattr(operator, "n_substeps", None)
    if n is None:
        return operator
    unit = 1 if operator.causal else _FACTOR[operator.strictly_proper]
    wanted = -(-n // unit) * dt / own
    whole = np.round(wanted)
    if not (whole > 0.0 and abs(wanted - whole) < _SAME * whole):
        return None
    return replace(operator, n_substeps=unit * int(whole))


@singledispatch
def holds_of_input(operator) -> set[tuple[int, str]]:
    """Return (column, hold) of all parts that the input drives, for each that has a hold."""
    own = getattr(operator, "hold", None)
    if own is not None:
        return {(operator.driving_column, own)}
    return set().union(*map(holds_of_input, operator.children))


@singledispatch
def holding_what_moves(operator, name=None) -> list[str]:
    """Return the names of parts with the hold "zoh" behind a part that moves at rest.

    Parameters
    ----------
    operator : Operator
        The operator.
    name : str, default=None
        Its name.

    Returns
    -------
    list of str
        As ``outer__inner``.
    """
    return [own for child in operator.children for own in holding_what_moves(child, name)]
