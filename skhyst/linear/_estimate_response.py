r"""The nonparametric frequency response of a recording.

From averaged spectra: with the discrete Fourier transforms :math:`U_s` (n_inputs) and :math:`Y_s`
of the windowed segments :math:`s = 1 \dots n`,

.. math:: \hat S_{uu} = \sum_s U_s^* U_s^T, \quad \hat S_{uy} = \sum_s U_s^* Y_s, \quad
    \hat G = \hat S_{uu}^{-1} \hat S_{uy}

is the least-squares solution of :math:`Y_s = U_s^T G`. Segments that overlap are correlated: they
count as :math:`n' = n^2 / \sum_{s,t} \rho_{st}` independent ones, where :math:`\rho_{st}` is the
squared correlation of the two windows at their positions (Welch 1967). The residual's power,
divided by :math:`n' - n_{inputs}`, is the noise power of one segment. Periodic records are treated
in ``_periodic``.
"""

from numbers import Integral, Real

import numpy as np
from scipy.fft import rfft
from scipy.signal import detrend as remove_trend
from scipy.signal import get_window
from sklearn.utils import check_X_y

from .._sklearn import Interval, StrOptions, validate_params
from ..exceptions import RecordError
from ..records import record_slices, with_lost_rows
from ._frequency_response import FrequencyResponse
from ._periodic import find_period, period_mismatch, periodic_estimate

_MISMATCH = 0.05  # largest power of the change over a given period, relative to the drive's
_WEAKEST = 1e-10  # least power of the weakest combination of inputs, relative to the largest line
_SEGMENTS = 8  # segments in the recording by default, without overlap


@validate_params(
    {
        "method": [StrOptions({"auto", "h1", "h2", "hv", "periodic"})],
        "inputs": [StrOptions({"all"}), str, Integral, "array-like"],
        "segment_length": [Interval(Integral, 4, None, closed="left"), None],
        "overlap": [Interval(Real, 0, 1, closed="left")],
        "window": [str, tuple, "array-like"],
        "detrend": [StrOptions({"constant", "linear"}), None],
        "period": [Interval(Integral, 3, None, closed="left"), None],
        "transient_periods": [Interval(Integral, 0, None, closed="left")],
        "min_excitation": [Interval(Real, 0, 1, closed="neither")],
        "dt": [Interval(Real, 0, None, closed="neither"), None],
    },
    prefer_skip_nested_validation=True,
)
def frequency_response(
    X,
    y,
    *,
    method="auto",
    inputs="all",
    segment_length=None,
    overlap=0.5,
    window="hann",
    detrend="constant",
    period=None,
    transient_periods=1,
    min_excitation=1e-3,
    dt=None,
) -> FrequencyResponse:
    r"""Estimate the nonparametric frequency response of a recording and its uncertainty.

    **Noise and sweeps: "h1", "h2", "hv".** The spectra are averaged over segments of all records
    (Welch's method). With the spectra :math:`S_{uu}, S_{uy}, S_{yy}`,

    .. math:: H_1 = S_{uu}^{-1} S_{uy}, \quad H_2 = S_{yy} / S_{yu}, \quad
        H_v = \sqrt{S_{yy} / S_{uu}}\; S_{uy} / |S_{uy}|

    ``h1`` is right when noise is in the response, ``h2`` when it is in the measured drive, ``hv``
    when both have the same signal-to-noise ratio (this one does not depend on units). With the
    coherence :math:`\gamma^2` and :math:`n` averages (overlapping segments count as the equivalent
    number of independent ones), the variance of ``h1`` and ``h2`` is
    :math:`|G|^2 (1 - \gamma^2) / (\gamma^2 n)` for one input, half of that times
    :math:`1 + \gamma^2` for ``hv``. Segments must be long relative to the ringing of the device:
    the response to the drive before a segment biases the estimate.

    **Repeated periods: "periodic".** At the excited lines, from Fourier transforms of whole
    periods, which have no leakage. Each distinct drive is a realisation (records with the same
    drive form one); all should have the same amplitude. The estimate is the best linear
    approximation: least squares over realisations, for one input their mean. Then

    - ``noise_std``, of the averaged estimate, comes from the scatter between periods;
    - ``std``, also of the averaged estimate, comes from the scatter between realisations when there
      are more of them than inputs, and so contains noise and stochastic nonlinear distortion. With
      fewer it is ``noise_std``, which contains no nonlinear distortion;
    - ``distortion_std`` is the level of distortion in one realisation (one group of ``n_inputs``
      experiments): the total variance minus that of noise. None for one realisation.

    Parameters
    ----------
    X : DataFrame or array-like of shape (n_samples, n_columns)
        The inputs; the index carries records and time.
    y : array-like of shape (n_samples,)
        Response.
    method : {"auto", "h1", "h2", "hv", "periodic"}, default="auto"
        ``"auto"`` is ``"periodic"`` where a period is given or the drives have one, else ``"h1"``.
        ``"h2"`` and ``"hv"`` are for one input.
    inputs : "all", str, int or list of these, default="all"
        The columns of X that are inputs, by name or position.
    segment_length : int, optional
        Samples per segment. By default an eighth of the recording, at most its shortest record.
    overlap : float, default=0.5
        Fraction of a segment that is shared with the next one.
    window : str, tuple or array-like of shape (segment_length,), default="hann"
        Window of the segments, as for :func:`scipy.signal.get_window`.
    detrend : {"constant", "linear"} or None, default="constant"
        What is removed from every segment before windowing: its mean or its linear trend.
    period : int, optional
        Period of the drives in samples. By default it is detected.
    transient_periods : int, default=1
        Periods at the start of each record that are not in steady state yet and are dropped.
        Samples after the last whole period are not used.
    min_excitation : float, default=1e-3
        ``"periodic"`` takes the lines where the drive has at least this fraction of its largest
        amplitude and exceeds its own noise. With several inputs the weakest combination counts.
    dt : float or None, default=None
        Sampling interval in s of data without a time index.

    Returns
    -------
    FrequencyResponse
        Without the lines at zero (an offset is no excitation) and at half the sampling rate.

    Raises
    ------
    RecordError
        If a record is sampled unevenly, is shorter than a segment, or has no complete period after
        the transient ones; or the drive does not repeat after the period.
    ValueError
        If a value is not finite, an input or the response is constant, the inputs are linearly
        dependent at all lines, or there are fewer segments or realisations than inputs.

    See Also
    --------
    TransferFunction : A model that is fitted to it, by ``fit_frequency_response``.
    ModalModel : Common modes of several inputs and responses.

    References
    ----------
    .. [1] Bendat and Piersol, *Random Data*, 2010, ch. 6, 7, 9.
    .. [2] Pintelon and Schoukens, *System Identification*, 2012, ch. 2 to 4 (the robust method).
    .. [3] Welch, *IEEE Transactions on Audio and Electroacoustics*, 1967.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import frequency_response
    >>> rng = np.random.default_rng(0)
    >>> drive = np.tile(rng.normal(size=100), 6)  # six periods
    >>> y = 2.0 * np.roll(drive, 1) + 0.01 * rng.normal(size=600)
    >>> found = frequency_response(drive[:, None], y, dt=0.01)
    >>> found.frequency[:3]
    array([1., 2., 3.])
    >>> bool(np.all(np.abs(np.abs(found.response) - 2.0) < found.confidence_radius(0.999)))
    True
    """
    names, records, slices, scales = _read(X, y, inputs, dt)
    interval = slices[0].dt
    if method in ("h2", "hv") and len(names) > 1:
        raise ValueError(
            f"The 'method' parameter of frequency_response must be 'h1' or 'periodic' for several "
            f"inputs. Got {method!r} for {len(names)} inputs instead; choose one by 'inputs'."
        )
    if period is None and method in ("auto", "periodic"):
        period = find_period([inputs for _, inputs, _ in records])
    if method == "periodic" or (method == "auto" and period is not None):
        method = "periodic"
        samples = period
        lines, estimate = _periodic(records, period, transient_periods, min_excitation)
    else:
        method = "h1" if method == "auto" else method
        lengths = [len(response) for _, _, response in records]
        samples = segment_length or max(4, min(min(lengths), sum(lengths) // _SEGMENTS))
        lines, estimate = _welch(records, samples, overlap, window, detrend, method)
    if not lines.size:
        raise ValueError(
            f"The inputs of frequency_response must excite at least one line and be linearly "
            f"independent there. Got no such line with {method!r} instead; choose columns by "
            f"'inputs'."
        )
    estimated = FrequencyResponse(
        frequency=lines / (samples * interval),
        **estimate,
        input_names=names,
        output_name=str(getattr(y, "name", None) or "response"),
        dt=interval,
        time_unit=slices[0].time_unit,
    )
    return estimated._scaled(scales)


def _read(X, y, inputs, dt):
    """Return the names of the inputs, (label, inputs, response) of each record, slices, scales.

    The signals of the records are divided by their largest magnitudes; a frequency response times
    ``scales`` (n_inputs,) is in the units of the recording.
    """
    values, response = check_X_y(X, y, dtype=np.float64, y_numeric=True, ensure_min_samples=4)
    count, response = values.shape[1], response.astype(float)
    if hasattr(X, "columns"):
        names = [str(name) for name in X.columns]
    else:
        names = ["drive"] if count == 1 else [f"input{i}" for i in range(count)]
    if not (isinstance(inputs, str) and inputs == "all"):
        wanted = [inputs] if isinstance(inputs, str | Integral) else inputs
        chosen = chosen_columns(wanted, names, count, "frequency_response")
        values, names = values[:, chosen], [names[at] for at in chosen]
    slices = record_slices(X, y, dt=dt, bridge=True)
    slices, values, response, _ = with_lost_rows(slices, values, response)
    for name, signal in zip(names, values.T, strict=True):
        if np.ptp(signal) == 0.0:
            raise ValueError(
                f"The inputs of frequency_response must vary. Got the constant {signal[0]:g} in "
                f"column {name!r} instead; leave it out by the 'inputs' parameter."
            )
    if np.ptp(response) == 0.0:
        raise ValueError(
            f"The 'y' parameter of frequency_response must vary. Got the constant "
            f"{response[0]:g} instead."
        )
    input_scales, response_scale = np.abs(values).max(axis=0), np.abs(response).max()
    values, response = values / input_scales, response / response_scale
    records = [(record.label, values[record.rows], response[record.rows]) for record in slices]
    return tuple(names), records, slices, response_scale / input_scales


def _welch(records, length, overlap, window, detrend, method):
    """Return the lines and the estimate from averaged segments; refuse records with too few."""
    for label, _, response in records:
        if len(response) < length:
            raise RecordError(
                f"Every record must be as long as the 'segment_length' parameter of "
                f"frequency_response, {length} samples. Got {len(response)} samples in record "
                f"{label!r} instead."
            )
    values = _window(window, length)
    step = max(1, length - round(length * overlap))
    counts = [(len(response) - length) // step + 1 for _, _, response in records]
    n_averages, n_inputs = _effective_averages(values, step, counts), records[0][1].shape[1]
    if n_averages < n_inputs + 0.5:
        raise ValueError(
            f"There must be more segments than inputs, {n_inputs}. Got "
            f"{n_averages:.3g} independent segments of {length} samples instead; choose a "
            f"smaller 'segment_length'."
        )
    return _welch_estimate(records, values, step, detrend, method, n_averages)


def _effective_averages(window, step, counts):
    """Return the equivalent number of independent segments; records have ``counts`` segments."""
    counts = np.asarray(counts, dtype=float)
    total = pairs = counts.sum()
    for k in range(1, int(np.ceil(window.size / step))):
        overlap = window[k * step :] @ window[: window.size - k * step] / (window @ window)
        pairs += 2.0 * np.maximum(counts - k, 0.0).sum() * overlap**2
    return float(total**2 / pairs)


def _welch_estimate(records, window, step, detrend, method, n_averages):
    """Return the excited lines and the estimate there."""
    length, m = window.size, records[0][1].shape[1]
    # zero and half the sampling rate are left out: their transforms are real, not complex
    inner = slice(1, (length + 1) // 2)
    spectra = 0.0
    for _, inputs, response in records:
        signals = np.vstack([inputs.T, response])
        for start in range(0, len(response) - length + 1, step):
            segment = signals[:, start : start + length]
            if detrend is not None:
                segment = remove_trend(segment, type=detrend)
            z = rfft(segment * window)[:, inner].T
            spectra = spectra + z.conj()[:, :, None] * z[:, None, :]
    power = np.linalg.eigvalsh(spectra[:, :m, :m])
    lines = np.flatnonzero(power[:, 0] > _WEAKEST * power[:, -1].max())
    spectra = spectra[lines]
    uu, uy, yy = spectra[:, :m, :m], spectra[:, :m, m], spectra[:, m, m].real

    g = np.linalg.solve(uu, uy[..., None])[..., 0]
    coherence = np.clip(np.einsum("ki,ki->k", uy.conj(), g).real / yy, 0.0, 1.0)
    dof = n_averages - m
    noise = yy * (1.0 - coherence) / dof
    variance = noise[:, None] * np.einsum("kii->ki", np.linalg.inv(uu)).real
    if method == "h2":
        g = g / coherence[:, None]
        variance = variance / coherence[:, None] ** 2
    elif method == "hv":
        g = g / np.sqrt(coherence)[:, None]
        variance = variance * (0.5 * (1.0 + 1.0 / coherence))[:, None]
    estimate = {"response": g, "std": np.sqrt(variance), "coherence": coherence}
    return lines + 1, {**estimate, "degrees_of_freedom": dof}


def _window(window, length):
    if isinstance(window, str | tuple):
        return get_window(window, length)
    values = np.asarray(window, dtype=float)
    if values.shape != (length,) or not np.isfinite(values).all() or not values.any():
        raise ValueError(
            f"The 'window' parameter of frequency_response must be a name or {length} values, one "
            f"for each sample of a segment. Got an array of shape {values.shape} instead."
        )
    return values


def _periodic(records, period, transient, min_excitation):
    """Return the lines and the estimate from periods; refuse records that do not have them."""
    if period is None:
        raise RecordError(
            "The drives must repeat after a common period in every record. Got drives without a "
            "period instead; give the 'period' parameter of frequency_response, or choose another "
            "'method'."
        )
    for label, inputs, response in records:
        mismatch = period_mismatch(inputs, period)
        if mismatch > _MISMATCH:
            raise RecordError(
                f"The drives must repeat after the 'period' parameter of frequency_response, "
                f"{period} samples. Got a change of {100 * mismatch:.3g} % of the power in record "
                f"{label!r} instead."
            )
        if len(response) < (transient + 1) * period:
            raise RecordError(
                f"Every record must have at least 'transient_periods' + 1 = {transient + 1} "
                f"periods of {period} samples. Got {len(response)} samples in record {label!r} "
                f"instead; if it starts in steady state, set transient_periods=0."
            )
    pairs = [record[1:] for record in records]
    lines, estimate, count = periodic_estimate(pairs, period, transient, min_excitation)
    n_inputs = pairs[0][0].shape[1]
    if count < n_inputs:
        raise ValueError(
            f"There must be at least as many records with different drives as inputs, {n_inputs}. "
            f"Got {count} instead; choose inputs by 'inputs', or method='h1'."
        )
    return lines, estimate


def chosen_columns(inputs, names, count, caller):
    """Return the positions of the columns of X that are chosen by position or name."""
    names, positions = list(names), []
    for wanted in inputs:
        if isinstance(wanted, str):
            positions.append(names.index(wanted) if wanted in names else None)
        else:
            inside = isinstance(wanted, Integral) and -count <= wanted < count
            positions.append(int(wanted) % count if inside else None)
    if not positions or None in positions or len(set(positions)) < len(positions):
        named = f" or name ({names})" if names else ""
        raise ValueError(
            f"The 'inputs' parameter of {caller} must be 'all', or at least one column of X and "
            f"none twice, by position (below {count}){named}. Got {inputs!r} instead."
        )
    return positions
