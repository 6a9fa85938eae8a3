r"""Faults of a recording that show in the relation of drive and response.

**A noisy drive.** Above the band of a smooth drive, the spectrum of its recording is flat at the
noise floor shown by its differences (:func:`skhyst.noise.white_noise_floor`). Measurement noise on
the drive is recognised by two properties. *The response does not follow it.* If the noise had
driven the device, the phase between both channels would be the same in all parts of the record;
otherwise the squared length of the mean of m random unit vectors, times m, is exponential
(Rayleigh). Phases do not depend on amplitudes, so an edge of the drive has no more weight than
other parts. *The response predicts the drive* better than the drive's own noisy past does, since
the response follows the true drive (Granger's test [1]_). If a device is too slow to follow a rough
drive, its response predicts nothing.

**Closed loop.** Without feedback, the noise of the response is independent of later values of the
drive: the innovations of a model's residual are regressed on later innovations of the drive
(Sims [2]_). Without feedback they are white and independent of the drive, so the test holds for
any drive. The response itself instead of the residual would not do: a nonlinear function of the
drive's past predicts the drive.

**Exchanged channels.** A reading has noise and a command has none, and the response lags. The area
:math:`\sum y_{t-1} u_t - y_t u_{t-1}` about the means has the sign of their covariance if y lags,
and the opposite sign if it leads. White noise on either channel has no effect on its mean.

**Lost samples.** The samples on both sides of a row lie on one cubic if those after it are shifted
by the number of lost samples, and do not without this shift. The residuals of the cubics are
compared with those of the stretches before and after, by an F test.

References
----------
.. [1] Granger, *Econometrica*, 1969.
.. [2] Sims, *American Economic Review*, 1972.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import chi2, norm
from scipy.stats import f as fisher

from ..noise import block_p_value, white_noise_floor

SIDE = 8  # samples of a cubic on either side of a row
_ENOUGH = 10_000  # samples used at once: windows of 2 sqrt(n) lags of them take 16 MB


def noise_on_drive(u, y, alpha=0.001):
    """Return the standard deviation of measurement noise on the drive, 0 if none is detected."""
    u, y = u[:_ENOUGH], y[:_ENOUGH]
    floor = white_noise_floor(u)
    if not (floor > 0.0 and np.ptp(y) > 0.0) or _is_followed(u, y, floor):
        return 0.0
    return floor if _predicted(u, y) < alpha else 0.0


def _is_followed(u, y, floor, alpha=0.01):
    """Whether the response follows the noise of the drive, or the record is too short to tell.

    The phase between both is tested octave by octave above the band of the signal.
    """
    length = int(np.sqrt(len(u)))
    omega = 2.0 * np.pi * np.arange((length + 1) // 2) / length
    window = np.hanning(length + 1)[:-1]
    a, b = (_spectra(signal, window)[:, : len(omega)] for signal in (u / floor, y / np.ptp(y)))
    # noise floor of the spectrum: the median of an exponential variable is log(2) times its mean;
    # above the last bin of twice the floor, the drive is noise
    noise = np.log(2.0) * (window @ window) * (2.0 * np.sin(0.5 * omega)) ** 4
    signal = np.flatnonzero(np.median(np.abs(a) ** 2, axis=0) > 2.0 * noise)
    first, stop = signal.max(initial=0) + 1, len(omega)
    slope = np.cov(u, y)[0, 1] / np.var(u) * floor / np.ptp(y)
    expected_length = 0.0
    while first < stop:
        band = slice(max(first, stop // 2), stop)
        stop = band.start
        products = a[:, band].conj() * b[:, band]
        sizes = np.abs(products)
        m = sizes.size / 1.5  # the noise bandwidth of the window, in bins
        mean = np.mean(np.divide(products, sizes, out=0j * products, where=sizes > 0.0))
        if m * abs(mean) ** 2 > -np.log(alpha):
            return True
        powers = [np.median(np.abs(part[:, band]) ** 2) for part in (a, b)]
        # for a coherence c, the mean unit vector has the length sqrt(pi c) / 2, at most 1
        coherence = min(1.0, slope**2 * powers[0] / max(powers[1], np.finfo(float).tiny))
        expected_length = np.sqrt(0.25 * np.pi * m * coherence)
    return expected_length < np.sqrt(-np.log(alpha)) + norm.isf(alpha) * np.sqrt(0.5)


def _spectra(signal, window):
    """Return spectra of the second differences of stretches.

    Differencing attenuates slow parts, which would otherwise leak into high frequencies.
    """
    differences = np.diff(signal, 2)
    count = len(differences) // len(window)
    return np.fft.rfft(differences[: count * len(window)].reshape(count, -1) * window, axis=1)


def _predicted(u, y):
    """Return the p-value of Granger's test that the response's past does not predict the drive."""
    lags = int(np.sqrt(len(u)))
    innovations, basis = _innovations(u, 2 * lags)
    past = sliding_window_view(y / np.ptp(y), lags + 1)[lags:, :-1]
    return _p_value(innovations, _orthogonal(basis, past), 2 * lags + 1)


def reaction_p_value(u, noise):
    """Return the p-value that the drive does not react to the response's noise (Sims's test)."""
    u, noise = u[:_ENOUGH], noise[:_ENOUGH]
    lags = int(np.sqrt(len(u)))
    if len(u) < 8 * lags or not (np.ptp(u) > 0.0 and np.ptp(noise) > 0.0):
        return 1.0
    drive, noise = _innovations(u, 2 * lags)[0], _innovations(noise, lags)[0][lags:]
    # the test is symmetric in both; the noise is the target since it is white for any drive
    return _p_value(noise[:-lags], sliding_window_view(drive[1:], lags), 1)


def _innovations(signal, lags):
    """Return a signal's innovations, clipped at three sigma, and an orthonormal basis of its past.

    The innovations are the residual of a regression on so many lags; clipping keeps an edge of the
    signal from dominating.
    """
    windows = sliding_window_view((signal - signal.mean()) / np.ptp(signal), lags + 1)
    past = np.linalg.qr(np.column_stack([windows[:, :-1], np.ones(len(windows))]))[0]
    residual = _orthogonal(past, windows[:, -1])
    limit = 3.0 * np.median(np.abs(residual)) / norm.ppf(0.75)
    return _orthogonal(past, np.clip(residual, -limit, limit)), past


def _orthogonal(basis, values):
    """Return the part of values orthogonal to an orthonormal basis."""
    return values - basis @ (basis.T @ values)


def _p_value(target, columns, used):
    """Return the p-value of the F test that columns do not explain a target."""
    basis = np.linalg.qr(columns - columns.mean(axis=0))[0]
    gain, count = np.sum((basis.T @ target) ** 2), columns.shape[1]
    freedom = len(target) - count - used
    rest = max(target @ target - gain, np.finfo(float).tiny)
    return fisher.sf(gain / count / (rest / freedom), count, freedom)


def are_exchanged(u, y, alpha=0.01):
    """Whether the response is a command without noise that leads a noisy drive."""
    if white_noise_floor(y) > 0.0:
        return False
    u, y = ((signal - signal.mean()) / np.ptp(signal) for signal in (u, y))
    area = np.sign(u @ y) * (y[:-1] * u[1:] - y[1:] * u[:-1])
    return block_p_value(area.sum(), [area - area.mean()]) < alpha


def lost_samples(u, y, alpha=0.001):
    """Return pairs (row, number of samples missing before it)."""
    side, n = SIDE, len(u)
    if n < 8 * side or not (np.ptp(u) > 0.0 and np.ptp(y) > 0.0):
        return []
    drive, response = _Stretches(u, side), _Stretches(y, side)
    freedom = 2 * side - 4
    rows = np.arange(4 * side, n - 4 * side + 1)
    bound = fisher.isf(alpha / n, freedom, freedom)
    rows = rows[drive.residual(rows, 0) > bound * drive.residual_around(rows)]
    if not rows.size:
        return []
    ratios = np.array([drive.ratio(rows, lost) for lost in range(2 * side + 1)])
    n_lost, best = np.argmin(ratios, axis=0), np.min(ratios, axis=0)
    limit = fisher.isf(alpha, freedom, freedom)
    # none and the longest loss are left out: a kink of the drive looks like the latter
    is_loss = (n_lost % (2 * side) > 0) & (best < limit)
    for lost in np.unique(n_lost[is_loss]):
        members = np.flatnonzero(is_loss & (n_lost == lost))
        # the response must agree: it too lies on a cubic with the loss, and better than without
        gain = response.residual(rows[members], 0) - response.residual(rows[members], lost)
        is_loss[members] = response.ratio(rows[members], lost) < limit
        is_loss[members] &= drive.residual(rows[members], lost) < bound * drive.residual_around(
            rows[members]
        )
        is_loss[members] &= gain > chi2.isf(alpha, 1) / freedom * response.residual_around(
            rows[members]
        )
    rows, n_lost, best = rows[is_loss], n_lost[is_loss], best[is_loss]
    near = np.abs(rows[:, None] - rows) < side
    first = best == np.min(np.where(near, best, np.inf), axis=1, initial=np.inf)
    return [(rows[first & (n_lost == lost)], lost) for lost in np.unique(n_lost[first])]


class _Stretches:
    """Residuals of cubics that are fitted to a signal on both sides of rows."""

    def __init__(self, signal, side):
        self.signal = (signal - signal.mean()) / np.ptp(signal)
        self.side = side
        self.rounding = len(signal) * np.finfo(float).eps ** 2

    def residual(self, rows, lost, gap=0):
        """Return the residual sum of squares (n_rows,) assuming so many lost samples.

        ``gap`` samples of the signal are left out at the row.
        """
        after = np.arange(2 * self.side) >= self.side
        around = np.arange(-self.side, self.side)
        basis = np.linalg.qr(np.vander(around + lost * after, 4))[0]
        squares = np.empty(len(rows))
        for start in range(0, len(rows), _ENOUGH):  # all windows of a long record exceed memory
            part = slice(start, start + _ENOUGH)
            windows = self.signal[rows[part, None] + around + gap * after]
            squares[part] = np.sum((windows - windows @ basis @ basis.T) ** 2, axis=1)
        return squares

    def residual_around(self, rows):
        """Return the larger residual of the stretches before and after each row, (n_rows,)."""
        stretches = [self.residual(rows + shift, 0) for shift in (-self.side, self.side)]
        return np.maximum(*stretches) + self.rounding

    def ratio(self, rows, lost):
        """Return the ratio of the residual with lost samples to that of neighbouring stretches.

        As many samples are left out of these, so that their cubics span the same time.
        """
        shifts = (-self.side - lost, self.side)
        stretches = [self.residual(rows + shift, lost, lost) for shift in shifts]
        return self.residual(rows, lost) / (np.minimum(*stretches) + self.rounding)
