r"""What the input of an operator does between its samples.

It is a straight line ("foh"), or constant ("zoh"), for which the operators are written. Or it is
the signal without any content above half the sampling rate that goes through the samples
("bandlimited"), as of a drive that an instrument has recorded behind its anti-aliasing filter. Such
an input is read from the samples by

    u(t) = sum_k u[k] sinc(t / dt - k) w(t / dt - k)

with a Kaiser window w that reaches over 32 samples to either side: to 1e-4 for content up to 0.92
of half the sampling rate (Kaiser, *IEEE International Symposium on Circuits and Systems*, 1974).
Beyond its ends a record goes on as its reflection in the point at the end, which keeps value and
slope; what the truth departs from that reaches as far as the window. The operator is then run with
a straight line between finer samples. A straight line between samples weakens content at the
frequency f, in cycles per sample, by ``sinc(f)^2``; the factor between the intervals is the least
power of two for which what is missing of the drive's spectrum is 1e-3 of its standard deviation, 16
at most, where it is 3e-3 at half the sampling rate. A linear operator takes 16 whatever the drive,
so that it is linear in the signal.
"""

from dataclasses import replace
from functools import cached_property, wraps

import numpy as np
from scipy.signal import upfirdn
from scipy.signal.windows import kaiser

from ._protocol import Operator

BANDLIMITED = "bandlimited"
_REACH = 32  # samples to either side that a value between two samples is read from
_SHAPE = 7.86  # of the window, for 80 dB: 0.1102 (80 - 8.7)
_ENOUGH = 1e-3  # of the standard deviation of the drive, that straight lines may miss
_FACTORS = (1, 2, 4, 8, 16)


def finer_factor(u):
    """Return how many times as many samples a band-limited input needs for straight lines.

    Parameters
    ----------
    u : ndarray of shape (n_samples,) or (n_samples, n_inputs)
        Input.

    Returns
    -------
    int
    """
    u = np.reshape(u, (len(u), -1))
    u = (u - u.mean(axis=0)) / np.maximum(np.abs(u).max(axis=0, initial=0.0), np.finfo(float).tiny)
    power = np.square(np.abs(np.fft.rfft(u * np.hanning(len(u))[:, None], axis=0)))
    frequency = np.fft.rfftfreq(len(u))
    for factor in _FACTORS[:-1]:
        missing = np.square(1.0 - np.sinc(frequency / factor) ** 2)
        if np.all(missing @ power <= _ENOUGH**2 * power.sum(axis=0)):
            return factor
    return _FACTORS[-1]


def finer_samples(u, factor):
    """Return a band-limited signal at ``factor`` times as many samples, from first to last.

    Parameters
    ----------
    u : ndarray of shape (n_samples,) or (n_samples, m)
        Signal.
    factor : int

    Returns
    -------
    ndarray of shape (1 + factor (n_samples - 1),) or (1 + factor (n_samples - 1), m)
    """
    n, around = 1 + factor * (len(u) - 1), ((_REACH, _REACH), *((0, 0),) * (u.ndim - 1))
    if factor == 1 or not u.size:
        return np.empty((n, *u.shape[1:])) if factor > 1 else u
    padded = np.pad(u, around, mode="reflect", reflect_type="odd")
    places = np.arange(-_REACH * factor, _REACH * factor + 1)
    weights = np.sinc(places / factor) * kaiser(len(places), _SHAPE)
    for phase in range(factor):  # so that a constant stays one
        weights[phase::factor] /= weights[phase::factor].sum()
    begin = 2 * _REACH * factor
    return np.ascontiguousarray(upfirdn(weights, padded, up=factor, axis=0)[begin : begin + n])


class HeldInput(Operator):
    """Base of the operators with a field ``hold``: what their input does between samples.

    A subclass is written for straight lines and, where ``holds`` says so, for constants; where the
    input is band-limited, it runs at finer samples of it. Such an operator reads later input: it is
    neither stepped nor inverted. A record that is run in pieces differs near the cuts.
    """

    hold = "foh"
    holds = ("foh", "zoh", BANDLIMITED)

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        for name, finely in _FINELY.items():
            if name in vars(cls):
                setattr(cls, name, _either(vars(cls)[name], finely))

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

    def _factor(self, u):
        return _FACTORS[-1] if self.signal_linear else finer_factor(u)

    def _finer(self, factor):
        """Return the operator of an input that is straight between finer samples."""
        n = getattr(self, "n_substeps", None)
        substeps = {} if n is None else {"n_substeps": -(-n // factor)}
        key = BANDLIMITED, *substeps.values()
        if key not in self._memory:
            self._memory[key] = replace(self, hold="foh", **substeps)
        return self._memory[key]


def _either(own, finely):
    """Return a method that is another one where the input is band-limited."""

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
    whole = np.concatenate([past, u])
    factor = self._factor(whole)
    begin = max(factor * (len(past) - 1) + 1, 0)
    y, inner = self._finer(factor).run(finer_samples(whole, factor)[begin:], dt / factor, inner)
    first = factor - 1 if len(past) else 0
    return np.ascontiguousarray(y[first::factor]), (inner, whole[-_REACH:])


def _sensitivities(self, u, du, dt, initial_state="rest"):
    u, du = np.asarray(u, dtype=float), np.asarray(du, dtype=float)
    factor = self._factor(u)
    signals = (finer_samples(signal, factor) for signal in (u, du))
    y, dy = self._finer(factor).sensitivities(*signals, dt / factor, initial_state)
    return np.ascontiguousarray(y[::factor]), np.ascontiguousarray(dy[::factor])


def _by_start(self, u, dt, start):
    u = np.asarray(u, dtype=float)
    factor = self._factor(u)
    dy = self._finer(factor).by_start(finer_samples(u, factor), dt / factor, start)
    return np.ascontiguousarray(dy[::factor])


def _propagate(self, u, du, dt, initial_state="rest"):
    return Operator.propagate(self, u, du, dt, initial_state)


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
    "propagate": _propagate,
    "by_start": _by_start,
    "compiled_step": _compiled_step,
    "inverse": _inverse,
}
