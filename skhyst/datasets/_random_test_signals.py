"""Test signals with random phases: multisines and band-limited noise."""

import numpy as np
import pandas as pd

from .._documentation import documented_like
from . import _checks as check


def multisine(
    n_samples=1024,
    *,
    band=None,
    grid="full",
    group_size=4,
    amplitude=None,
    rms=1.0,
    offset=0.0,
    n_periods=1,
    n_realizations=1,
    n_inputs=1,
    dt=1e-3,
    random_state=None,
) -> pd.DataFrame:
    r"""Random-phase multisines: the excitation of a frequency response and of its distortion.

    .. math:: u = u_0 + \sum_k A_k \cos(2 \pi k t / T + \varphi_k)

    over the excited lines :math:`k`, with independent uniform phases :math:`\varphi_k` and the
    period :math:`T`, ``n_samples * dt``. All realisations excite the same lines with the same
    amplitudes.

    With several inputs each realisation consists of ``n_inputs`` experiments: in experiment
    :math:`e` the phases of input :math:`i` are those of the realisation plus
    :math:`2 \pi e i / n` with :math:`n` the number of inputs. At each line the matrix of inputs by
    experiments is then a unitary one up to the amplitudes, whose inverse amplifies noise least.

    Parameters
    ----------
    n_samples : int, default=1024
        Samples of one period.
    band : (float, float) or None, default=None
        Lowest and highest excited frequency, Hz, both included; all lines below half the sampling
        rate by default. The constant is never excited.
    grid : {"full", "odd", "random_odd"}, default="full"
        Excited lines: all; odd ones, so that even distortion shows at the even lines;
        odd ones but one, drawn at random, of each ``group_size`` in succession, so that odd
        distortion shows there.
    group_size : int, default=4
        Odd lines of a group of the random odd grid, at least 2.
    amplitude : callable, array-like of shape (n_lines,) or None, default=None
        Relative amplitudes :math:`A_k`, as a function of the frequencies in Hz or one per line; all
        equal by default.
    rms, offset : float or sequence of float of shape (n_inputs,), default=1.0 and 0.0
        Root mean square of each input about its mean, and that mean, units of the drive: exact, and
        the same in each record.
    n_periods : int, default=1
        Periods in succession in each record; the first may be left to transients.
    n_realizations : int, default=1
        Independent draws of the phases.
    n_inputs : int, default=1
        Inputs.
    dt : float, default=1e-3
        Sampling interval in s.
    random_state : int, Generator or None, default=None
        Seed of the phases and of the random grid.

    Returns
    -------
    DataFrame of shape (n_realizations * n_inputs * n_periods * n_samples, n_inputs)
        Columns ``drive``, ``drive_1``, ...; a record an experiment, named ``realization0`` or, with
        several inputs, ``realization0_experiment0``, those of a realisation in succession.

    Raises
    ------
    ValueError
        If the band is empty or reaches half the sampling rate, or an amplitude is negative or all
        are zero.

    See Also
    --------
    band_limited_noise : Random amplitudes, too.
    skhyst.linear.frequency_response : Evaluate the response.

    References
    ----------
    Pintelon and Schoukens, *System Identification*, 2012. Dobrowiecki and Schoukens, *Automatica*,
    2007.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets import multisine
    >>> X = multisine(100, band=(20.0, 40.0), grid="odd", dt=1e-3, random_state=0)
    >>> spectrum = np.fft.rfft(X["drive"].to_numpy())
    >>> (np.flatnonzero(np.abs(spectrum) > 1e-9) / (100 * 1e-3)).tolist()
    [30.0]
    """
    function = "multisine"
    rms, offset, lines = _check(
        function, n_samples, band, rms, offset, n_realizations, n_inputs, dt
    )
    n_periods = check.count(function, "n_periods", n_periods)
    if grid not in ("full", "odd", "random_odd"):
        check.refuse(function, "grid", "'full', 'odd' or 'random_odd'", grid)
    rng = np.random.default_rng(random_state)
    if grid != "full":
        lines = lines[lines % 2 == 1]
    if grid == "random_odd":
        lines = _without_detection(lines, check.count(function, "group_size", group_size, 2), rng)
    if not lines.size:
        check.refuse(function, "band", f"wide enough for a line of the {grid!r} grid", band)
    sizes = _amplitudes(amplitude, lines / (n_samples * dt), lines.size)
    # a sine of amplitude A has the power A^2 / 2, whatever its phase
    sizes = sizes / np.sqrt(0.5 * np.sum(sizes**2))
    records, labels = [], []
    turns = np.outer(np.arange(n_inputs), np.arange(n_inputs)) / n_inputs
    for realization in range(n_realizations):
        phases = rng.uniform(0.0, 1.0, (n_inputs, lines.size))
        for experiment in range(n_inputs):
            angle = 2.0 * np.pi * (phases + turns[experiment][:, None])
            spectrum = np.zeros((n_inputs, n_samples // 2 + 1), dtype=complex)
            spectrum[:, lines] = 0.5 * n_samples * sizes * np.exp(1j * angle)
            period = np.fft.irfft(spectrum, n_samples, axis=1).T
            records.append(np.tile(offset + rms * period, (n_periods, 1)))
            suffix = f"_experiment{experiment}" if n_inputs > 1 else ""
            labels.append(f"realization{realization}{suffix}")
    return check.signal_frame(records, dt, labels)


def _without_detection(lines, group_size, rng):
    """Return the lines without a random one of each complete group."""
    n_groups = lines.size // group_size
    left_out = group_size * np.arange(n_groups) + rng.integers(0, group_size, n_groups)
    return np.delete(lines, left_out)


def _amplitudes(amplitude, frequency, n_lines):
    if amplitude is None:
        return np.ones(n_lines)
    relative = amplitude(frequency) if callable(amplitude) else amplitude
    sizes = check.number("multisine", "amplitude", relative, negative=False, size=n_lines)
    if not sizes.any():
        check.refuse("multisine", "amplitude", "above zero at one line at least", amplitude)
    return sizes / sizes.max()


@documented_like(multisine)
def band_limited_noise(
    n_samples=1024,
    *,
    band=None,
    rms=1.0,
    offset=0.0,
    n_realizations=1,
    n_inputs=1,
    dt=1e-3,
    random_state=None,
) -> pd.DataFrame:
    """Gaussian noise without power outside a band.

    Its spectrum has independent complex Gaussian values at the lines within the band, and zeros
    elsewhere: the record is one period of a periodic signal, so the band's edges are exact.

    Parameters
    ----------
    n_samples : int, default=1024
        Samples of a record.
    n_realizations, n_inputs : int, default=1
        Independent records and inputs.
    random_state : int, Generator or None, default=None
        Seed.

    Returns
    -------
    DataFrame of shape (n_realizations * n_samples, n_inputs)
        Columns ``drive``, ``drive_1``, ...; records ``realization0``, ``realization1``, ...

    Raises
    ------
    ValueError
        If the band holds no multiple of ``1 / (n_samples dt)`` or reaches half the sampling rate.

    See Also
    --------
    multisine : Periodic, with equal amplitudes and random phases.

    Examples
    --------
    >>> from skhyst.datasets import band_limited_noise
    >>> X = band_limited_noise(1000, band=(0.0, 50.0), rms=2.0, dt=1e-3, random_state=0)
    >>> round(float(X["drive"].std(ddof=0)), 12)
    2.0
    """
    function = "band_limited_noise"
    rms, offset, lines = _check(
        function, n_samples, band, rms, offset, n_realizations, n_inputs, dt
    )
    rng = np.random.default_rng(random_state)
    records = []
    for _ in range(n_realizations):
        spectrum = np.zeros((n_inputs, n_samples // 2 + 1), dtype=complex)
        real, imaginary = rng.normal(size=(2, n_inputs, lines.size))
        spectrum[:, lines] = real + 1j * imaginary
        noise = np.fft.irfft(spectrum, n_samples, axis=1)
        noise /= np.sqrt(np.mean(noise**2, axis=1, keepdims=True))
        records.append(offset + rms * noise.T)
    return check.signal_frame(records, dt, [f"realization{i}" for i in range(n_realizations)])


def _check(function, n_samples, band, rms, offset, n_realizations, n_inputs, dt):
    """Check common parameters; return root mean squares, offsets and the lines of the band."""
    check.count(function, "n_samples", n_samples, 3)
    check.count(function, "n_realizations", n_realizations)
    check.count(function, "n_inputs", n_inputs)
    rms = check.number(function, "rms", rms, negative=False, size=n_inputs)
    offset = check.number(function, "offset", offset, size=n_inputs)
    return rms, offset, _band_lines(function, band, n_samples, check.interval(function, dt))


def _band_lines(function, band, n_samples, dt):
    """Return the lines, multiples of ``1 / (n_samples dt)`` above 0, in a band in Hz."""
    if band is None:
        low, high = 0.0, np.inf
    else:
        values = check.number(function, "band", band, negative=False)
        if values.shape != (2,) or values[0] > values[1]:
            check.refuse(function, "band", "a pair (lowest, highest frequency) in Hz", band)
        low, high = values
        check.refuse_aliasing(function, "band", high, dt)
    lines = np.arange(1, (n_samples + 1) // 2)
    duration = n_samples * dt
    slack = check.ROUNDING * lines
    excited = lines[(lines >= low * duration - slack) & (lines <= high * duration + slack)]
    if not excited.size:
        check.refuse(function, "band", f"wide enough for a multiple of {1.0 / duration:g} Hz", band)
    return excited
