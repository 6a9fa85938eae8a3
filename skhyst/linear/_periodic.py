r"""Frequency responses of periodic records: the best linear approximation with its variances.

The discrete Fourier transform of a complete period is exact, without leakage. With the mean
:math:`\bar U_r, \bar Y_r` over the :math:`p_r` periods of realisation :math:`r = 1 \dots R` of the
drive, :math:`G` solves :math:`\bar Y_r = \bar U_r^T G` by least squares at every excited line. The
residual :math:`e_{rp} = Y_{rp} - U_{rp}^T \hat G` of single periods gives the variances:

- the scatter between the periods of a realisation is noise, of the response and of a measured
  drive; its level is estimated for each realisation, as recordings differ;
- the scatter of the means over periods between realisations is noise over :math:`p_r` plus the
  stochastic nonlinear distortion, which repeats from period to period.
"""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

_FOUND = (
    1e-4  # power of the change over a period, relative to the drive's, that confirms the period
)
_SAME = 1e-3  # power of the difference between two records, likewise, of one realisation
_CERTAIN = 100.0  # least power of the drive at an excited line, relative to noise in its mean
_TINY = np.finfo(float).tiny


def find_period(records):
    """Return the shortest period in samples of the inputs (n, n_inputs) of all records, or None."""
    longest = min(len(inputs) for inputs in records) // 2
    if longest < 2:
        return None
    # power of u(t + lag) - u(t) for all lags, from the autocorrelation
    lags = np.arange(longest + 1)
    change, power = np.zeros(longest + 1), np.zeros(longest + 1)
    for inputs in records:
        n = len(inputs)
        for u in (inputs - inputs.mean(axis=0)).T:
            size = next_fast_len(n + longest, real=True)
            product = irfft(np.abs(rfft(u, size)) ** 2, size)[: longest + 1]
            energy = np.concatenate([[0.0], np.cumsum(u**2)])
            energies = energy[n - lags] + energy[n] - energy[lags]
            scale = max(energy[n], _TINY)
            change += (energies - 2.0 * product) / scale
            power += energies / scale
    ratio = change / np.maximum(power, _TINY)
    away = np.flatnonzero(ratio > 0.1)  # a slow drive hardly changes from sample to sample
    if not away.size or ratio[away[0] :].min() > _FOUND:
        return None
    # several lags are near the minimum: multiples of the period, and neighbours of each
    near = np.flatnonzero(ratio <= max(4.0 * ratio[away[0] :].min(), 1e-10))
    near = near[near > away[0]]
    first = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)[0]
    return int(first[np.argmin(ratio[first])])


def period_mismatch(inputs, period):
    """Return the power of the change over a period, relative to that of unrelated signals."""
    if len(inputs) < 2 * period:
        return 0.0
    u = inputs - inputs.mean(axis=0)
    before, after = u[:-period], u[period:]
    power = (before**2).sum(axis=0) + (after**2).sum(axis=0)
    change = ((after - before) ** 2).sum(axis=0)
    return float(np.max(change / np.maximum(power, _TINY)))


def period_spectra(records, period, transient):
    """Return the transforms (n_periods, n_lines, ...) of the signals of each record.

    Zero and half the sampling rate, where they are real, are left out.
    """
    lines = slice(1, (period + 1) // 2)

    def spectrum(x):
        periods = x[transient * period : len(x) // period * period]
        return rfft(periods.reshape(-1, period, *x.shape[1:]), axis=1)[:, lines]

    return [tuple(map(spectrum, signals)) for signals in records]


def _shift(reference, u, period):
    """Return the lag in samples of ``u`` (k, m) behind ``reference``, None for another drive."""
    powers = np.sum(np.abs(reference) ** 2), np.sum(np.abs(u) ** 2)
    product = np.zeros(period // 2 + 1, dtype=complex)
    product[1 : 1 + len(u)] = np.sum(reference.conj() * u, axis=1)
    correlation = irfft(product, period) * period / 2.0
    at = int(np.argmax(correlation))
    return at if sum(powers) - 2.0 * correlation[at] < _SAME * sum(powers) else None


def _realizations(spectra, period):
    """Group records with the same drive, also if shifted in time: each group is a realisation."""
    groups = []
    for u, y in spectra:
        mean = u.mean(axis=0)
        for reference, parts in groups:
            shift = _shift(reference, mean, period)
            if shift is not None:
                turn = np.exp(2j * np.pi * shift / period * np.arange(1, 1 + y.shape[1]))
                parts.append((u * turn[:, None], y * turn))
                break
        else:
            groups.append((mean, [(u, y)]))
    return [tuple(map(np.concatenate, zip(*parts, strict=True))) for _, parts in groups]


def periodic_estimate(records, period, transient, min_excitation):
    """Return the excited lines, the estimate at them, and the number of realisations."""
    groups = _realizations(period_spectra(records, period, transient), period)
    count, m = len(groups), groups[0][0].shape[2]
    if count < m:
        return np.empty(0, dtype=int), {}, count
    periods = np.array([len(y) for _, y in groups])
    n_scatter = int(np.sum(periods - 1))

    mean_u = np.stack([u.mean(axis=0) for u, _ in groups], axis=1)  # (k, R, m)
    mean_y = np.stack([y.mean(axis=0) for _, y in groups], axis=1)  # (k, R)
    strength = np.linalg.svd(mean_u, compute_uv=False)
    excited = strength[:, -1] > min_excitation * strength[:, 0].max()
    if n_scatter:
        scatter = sum(np.sum(np.abs(u - u.mean(axis=0)) ** 2, axis=(0, 2)) for u, _ in groups)
        excited &= strength[:, -1] ** 2 > _CERTAIN * scatter / n_scatter * np.mean(1.0 / periods)
    lines = np.flatnonzero(excited)
    mean_u, mean_y = mean_u[lines], mean_y[lines]

    pseudo_inverse = np.linalg.pinv(mean_u, rcond=np.finfo(float).eps)  # (k, m, R)
    g = np.einsum("kir,kr->ki", pseudo_inverse, mean_y)
    estimate = {"response": g}
    weight = np.abs(pseudo_inverse) ** 2
    if n_scatter:
        errors = [y[:, lines] - np.einsum("pki,ki->pk", u[:, lines], g) for u, y in groups]
        squares = [np.sum(np.abs(e - e.mean(axis=0)) ** 2, axis=0) for e in errors]
        pooled = sum(squares) / n_scatter
        # noise in the mean over periods, (k, R), which differs between recordings
        single = [s / (p - 1) if p > 1 else pooled for s, p in zip(squares, periods, strict=True)]
        noise = np.stack(single, axis=1) / periods
        estimate["noise_std"] = estimate["std"] = np.sqrt(np.sum(weight * noise[:, None], axis=2))
        estimate["degrees_of_freedom"] = float(n_scatter)
    if count > m:
        residual = mean_y - np.einsum("kri,ki->kr", mean_u, g)
        total = np.sum(np.abs(residual) ** 2, axis=1) / (count - m)
        total_weight = np.sum(weight, axis=2)
        estimate["std"] = np.sqrt(total[:, None] * total_weight)
        estimate["degrees_of_freedom"] = float(count - m)
        if n_scatter:
            # 1 minus leverage: the fraction of its noise that a realisation leaves in the residual
            in_residual = 1.0 - np.einsum("kri,kir->kr", mean_u, pseudo_inverse).real
            expected = np.sum(in_residual * noise, axis=1) / (count - m)
            distortion = np.maximum(total - expected, 0.0)
            estimate["distortion_std"] = np.sqrt(distortion[:, None] * total_weight * count / m)
    return lines + 1, estimate, count
