r"""What drive and response say of each other, of how they were recorded.

**Noise floor.** The difference of order p multiplies white noise by :math:`\sqrt{\binom{2p}{p}}`
and a sine of period T by :math:`(2 \sin(\pi / T))^p`. Divided by the former, the scatter of
differences falls from order to order where the signal is smooth, and stays where it is noise.

**A noisy drive.** Above the band of a smooth drive its spectrum is that floor. Noise that came in
by the recording shows twice. *The response does not follow it.* Where a device has seen it, the
phase between both channels is the same in all stretches; the squared length of the mean of m random
unit vectors, times m, is exponential (Rayleigh). Phases leave sizes aside, so that an edge of the
drive counts as one stretch among others. *The response foretells the drive*, better than its own
noisy past does, since it follows the true one (Granger's test [1]_). A device that is too slow to
follow a rough drive foretells nothing.

**A drive that reacts to the response.** The noise of a response says nothing of a drive that does
not know it: what a fitted model leaves, without what its own past foretells, is regressed on later
innovations of the drive (Sims [2]_). It is white and independent of the drive if so, and the test
holds whatever the drive is. The response itself would not do: a bent function of the drive's past
foretells the drive.

**Exchanged channels.** A reading has noise and a command has none, and the response lags: the
area :math:`\sum y_{t-1} u_t - y_t u_{t-1}` about the means has the sign of their covariance if so,
and the other one if it leads. White noise on either channel adds nothing to it on average.

**Lost samples.** Both sides of a row lie on one cubic once those behind it are moved by what
was lost, and as they stand they do not. What the fits leave is compared with what they leave of the
stretches before and behind, by Fisher's law.

References
----------
.. [1] Granger, *Econometrica*, 1969.
.. [2] Sims, *American Economic Review*, 1972.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import comb
from scipy.stats import chi2, norm
from scipy.stats import f as fisher

from .._block_test import block_p_value

_ENOUGH = 10_000  # samples at once: windows of 2 sqrt(n) lags of them take 16 MB


def noise_floor(signal):
    """Return the standard deviation of white noise on a smooth signal, 0 where none is seen."""
    order, n = 10, len(signal)  # leaves 1e-6 of a sine of 30 samples
    if n < 8 * order:
        return 0.0
    before, last = _scatter(signal, order), _scatter(signal, order + 1)
    # of simulated noise, the ratio is 1 with a standard deviation of 0.57 / sqrt(n)
    grid = np.min(np.diff(np.unique(signal)), initial=np.inf)
    rounding = n * np.finfo(float).eps * np.abs(signal).max()
    least = max((1.0 - 2.0 / np.sqrt(n)) * before, grid, rounding)
    return float(before) if last > least else 0.0


def largest_noise(signal):
    """Return the standard deviation that white noise on a signal has at the most."""
    return float(min(_scatter(signal, p) for p in range(1, min(len(signal), 12))))


def _scatter(signal, order):
    """Return that of the differences, over what they make of white noise of unit variance."""
    size = np.median(np.abs(np.diff(signal, order))) / norm.ppf(0.75)
    return size / np.sqrt(comb(2 * order, order))


def noise_on_drive(u, y, alpha=0.001):
    """Return the standard deviation of noise that is on the drive's recording alone, 0 for none."""
    u, y = u[:_ENOUGH], y[:_ENOUGH]
    floor = noise_floor(u)
    if not (floor > 0.0 and np.ptp(y) > 0.0) or _is_followed(u, y, floor):
        return 0.0
    return floor if _foretold(u, y) < alpha else 0.0


def _is_followed(u, y, floor, alpha=0.01):
    """Whether the response follows the drive's noise in an octave, or that would not show."""
    length = int(np.sqrt(len(u)))
    omega = 2.0 * np.pi * np.arange((length + 1) // 2) / length
    window = np.hanning(length + 1)[:-1]
    a, b = (_spectra(signal, window)[:, : len(omega)] for signal in (u / floor, y / np.ptp(y)))
    # the median of an exponential variable is log(2) times its mean; at most half is signal
    noise = np.log(2.0) * (window @ window) * (2.0 * np.sin(0.5 * omega)) ** 4
    signal = np.flatnonzero(np.median(np.abs(a) ** 2, axis=0) > 2.0 * noise)
    first, stop = signal.max(initial=0) + 1, len(omega)
    slope = np.cov(u, y)[0, 1] / np.var(u) * floor / np.ptp(y)
    shown = 0.0
    while first < stop:
        own = slice(max(first, stop // 2), stop)
        stop = own.start
        products = a[:, own].conj() * b[:, own]
        sizes = np.abs(products)
        m = sizes.size / 1.5  # the noise bandwidth of the window, in bins
        mean = np.mean(np.divide(products, sizes, out=0j * products, where=sizes > 0.0))
        if m * abs(mean) ** 2 > -np.log(alpha):
            return True
        powers = [np.median(np.abs(part[:, own]) ** 2) for part in (a, b)]
        # for a coherence c, the mean phase is sqrt(pi c) / 2 long, and 1 at the most
        coherence = min(1.0, slope**2 * powers[0] / max(powers[1], np.finfo(float).tiny))
        shown = np.sqrt(0.25 * np.pi * m * coherence)
    return shown < np.sqrt(-np.log(alpha)) + norm.isf(alpha) * np.sqrt(0.5)


def _spectra(signal, window):
    """Return spectra of stretches, bent so that what is slow does not leak."""
    bent = np.diff(signal, 2)
    count = len(bent) // len(window)
    return np.fft.rfft(bent[: count * len(window)].reshape(count, -1) * window, axis=1)


def _foretold(u, y):
    """Return the p-value that the response's past says nothing of the drive beyond its own past."""
    lags = int(np.sqrt(len(u)))
    own, basis = _innovations(u, 2 * lags)
    past = sliding_window_view(y / np.ptp(y), lags + 1)[lags:, :-1]
    return _p_value(own, _beside(basis, past), 2 * lags + 1)


def reaction_p_value(u, noise):
    """Return the p-value that the drive does not react to the response's noise (Sims's test)."""
    u, noise = u[:_ENOUGH], noise[:_ENOUGH]
    lags = int(np.sqrt(len(u)))
    if len(u) < 8 * lags or not (np.ptp(u) > 0.0 and np.ptp(noise) > 0.0):
        return 1.0
    drive, noise = _innovations(u, 2 * lags)[0], _innovations(noise, lags)[0][lags:]
    # which one is foretold makes no difference; the noise is white, whatever the drive is
    return _p_value(noise[:-lags], sliding_window_view(drive[1:], lags), 1)


def _innovations(signal, lags):
    """Return what a signal's past leaves of it, the past's basis beside; an edge is cut down."""
    windows = sliding_window_view((signal - signal.mean()) / np.ptp(signal), lags + 1)
    past = np.linalg.qr(np.column_stack([windows[:, :-1], np.ones(len(windows))]))[0]
    left = _beside(past, windows[:, -1])
    most = 3.0 * np.median(np.abs(left)) / norm.ppf(0.75)
    return _beside(past, np.clip(left, -most, most)), past


def _beside(basis, values):
    return values - basis @ (basis.T @ values)


def _p_value(target, columns, used):
    """Return the p-value of Fisher's test that columns explain nothing of a target."""
    basis = np.linalg.qr(columns - columns.mean(axis=0))[0]
    gain, count = np.sum((basis.T @ target) ** 2), columns.shape[1]
    freedom = len(target) - count - used
    rest = max(target @ target - gain, np.finfo(float).tiny)
    return fisher.sf(gain / count / (rest / freedom), count, freedom)


def are_exchanged(u, y, alpha=0.01):
    """Whether the response is a command that runs ahead of a drive with noise of its own."""
    if noise_floor(y) > 0.0:
        return False
    u, y = ((signal - signal.mean()) / np.ptp(signal) for signal in (u, y))
    area = np.sign(u @ y) * (y[:-1] * u[1:] - y[1:] * u[:-1])
    return block_p_value(area.sum(), [area - area.mean()]) < alpha


def lost_samples(u, y, alpha=0.001):
    """Return before which rows how many samples are missing, as pairs of (rows, number)."""
    side, n = 8, len(u)
    if n < 4 * side or not (np.ptp(u) > 0.0 and np.ptp(y) > 0.0):
        return []
    drive, response = _Stretches(u, side), _Stretches(y, side)
    freedom = 2 * side - 4
    rows = np.arange(2 * side, n - 2 * side + 1)
    bound = fisher.isf(alpha / n, freedom, freedom)
    rows = rows[drive.left(rows, 0) > bound * drive.beside(rows)]
    rows = rows[(rows >= 4 * side) & (rows <= n - 4 * side)]
    if not rows.size:
        return []
    ratios = np.array([drive.ratio(rows, lost) for lost in range(2 * side + 1)])
    number, best = np.argmin(ratios, axis=0), np.min(ratios, axis=0)
    likely = fisher.isf(alpha, freedom, freedom)
    found = (number % (2 * side) > 0) & (best < likely)  # a kink is like the longest loss
    for lost in np.unique(number[found]):
        own = np.flatnonzero(found & (number == lost))
        gain = response.left(rows[own], 0) - response.left(rows[own], lost)
        found[own] = response.ratio(rows[own], lost) < likely
        found[own] &= drive.left(rows[own], lost) < bound * drive.beside(rows[own])
        found[own] &= gain > chi2.isf(alpha, 1) / freedom * response.beside(rows[own])
    rows, number, best = rows[found], number[found], best[found]
    near = np.abs(rows[:, None] - rows) < side
    first = best == np.min(np.where(near, best, np.inf), axis=1, initial=np.inf)
    return [(rows[first & (number == lost)], lost) for lost in np.unique(number[first])]


class _Stretches:
    """What cubics leave of a signal on both sides of rows."""

    def __init__(self, signal, side):
        self.signal = (signal - signal.mean()) / np.ptp(signal)
        self.side = side
        self.rounding = len(signal) * np.finfo(float).eps ** 2 * np.ptp(signal)

    def left(self, rows, lost, gap=0):
        """Return the sum of squares if so many are lost; a gap leaves out some that are not."""
        after = np.arange(2 * self.side) >= self.side
        around = np.arange(-self.side, self.side)
        basis = np.linalg.qr(np.vander((around + lost * after) / self.side, 4))[0]
        left = np.empty(len(rows))
        for start in range(0, len(rows), _ENOUGH):  # a long record has no room for all windows
            own = slice(start, start + _ENOUGH)
            windows = self.signal[rows[own, None] + around + gap * after]
            left[own] = np.sum((windows - windows @ basis @ basis.T) ** 2, axis=1)
        return left

    def beside(self, rows):
        """Return the larger one of what is left of the stretches before and behind."""
        stretches = [self.left(rows + way, 0) for way in (-self.side, self.side)]
        return np.maximum(*stretches) + self.rounding

    def ratio(self, rows, lost):
        """Return what is left to what is of stretches beside, if there as many are left out."""
        stretches = [self.left(rows + way, lost, lost) for way in (-self.side - lost, self.side)]
        return self.left(rows, lost) / (np.minimum(*stretches) + self.rounding)
