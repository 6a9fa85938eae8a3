r"""The noise-free part of the drive: explained by the reference of a closed loop, or smoothed.

A controller reads the response with the noise of the sensor, so a drive in a loop depends on the
noise, and so does everything that is computed from it. The reference that the controller follows
moves the drive and is independent of the noise: it is an instrument [1]_. A model's response to the
part of the drive that the reference explains is the instrument for the model's prediction, as in
the refined method of Young and Jakeman [2]_, and replaces it in the criterion and in the verdict's
black box.

That part is found by least squares with a light ridge from features of the reference: its powers,
its plays, and its differences and means over logarithmically spaced lags up to half a record, which
are coarse bins of any linear response. Each part of a record is explained by coefficients that were
fitted to the other parts: fitted to the same part, they would reproduce some of its noise.

A drive that was recorded with noise is a similar case: the noise of the recording is in every
prediction and, since it did not act on the device, in every residual. Any effect that smooths the
drive then predicts better, above all a lag or a backlash. Such noise is white
(``skhyst.records._channels``), and the smoothed drive replaces the reference: a cubic smoothing
spline, with the parameter of generalised cross-validation [3]_.

The fits themselves are not changed. They minimise the output error with the noise of the drive
included, so their parameters are biased, more so the larger the part of the drive that the
reference does not explain.

References
----------
.. [1] Söderström and Stoica, *Instrumental Variable Methods for System Identification*, 1983.
.. [2] Young and Jakeman, *International Journal of Control*, 1979.
.. [3] Craven and Wahba, *Numerische Mathematik*, 1979.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_smoothing_spline
from sklearn.linear_model import Ridge

from ..preprocessing import PlayOperators, find_column
from ._constants import BOX_FOLDS, ENOUGH, NEGLIGIBLE, STRETCHES
from ._criterion import paired_p_value
from ._structure import delayed, past_mean


class Reference:
    """A signal of some records that moves the drive and is independent of the noise.

    Parameters
    ----------
    drive, values : ndarray of shape (n_samples,)
    slices : sequence of RecordSlice

    Attributes
    ----------
    share : float
        Fraction of the variance of the drive that it predicts.
    p_value : float
        P-value of the hypothesis that it predicts nothing of the drive.
    """

    def __init__(self, drive, values, slices):
        self._values = [values[s.rows] for s in slices]
        self._features = _features(self._values)
        self._rows = [s.rows for s in slices]
        unexplained, centred = drive - self._explained(drive), drive - drive.mean()
        power = centred @ centred
        self.share = 1.0 - (unexplained @ unexplained) / power if power > 0.0 else 0.0
        self.p_value = paired_p_value(
            *([signal[rows] for rows in self._rows] for signal in (centred, unexplained))
        )

    def _explained(self, signal):
        """Return the part of a signal that the reference explains, by cross-fitting."""
        fold = np.arange(len(signal)) * STRETCHES // len(signal) % BOX_FOLDS
        explained = np.empty(len(signal))
        for number in range(BOX_FOLDS):
            train = np.flatnonzero(fold != number)
            train = train[:: max(len(train) // ENOUGH, 1)]
            # a light ridge: lagged features of a smooth reference are nearly collinear
            ridge = Ridge(alpha=1e-3 * len(train)).fit(self._features[train], signal[train])
            explained[fold == number] = ridge.predict(self._features[fold == number])
        return explained

    def explain(self, records):
        """Return the records with ``explained`` set: the part of the drive that is explained."""
        explained = self._explained(np.concatenate([record.u for record in records]))
        return [
            replace(record, explained=explained[rows])
            for record, rows in zip(records, self._rows, strict=True)
        ]

    def in_place(self, records):
        """Return the records with the reference as drive, the explained drive as a column."""
        driven = []
        for record, values in zip(records, self._values, strict=True):
            others = [] if record.auxiliary is None else [record.auxiliary]
            columns = np.column_stack([record.explained, *others])
            driven.append(replace(record, u=values, auxiliary=columns))
        return driven


def _features(references):
    """Return features of all samples, each of unit variance, (n_samples, n_features)."""
    joined = np.concatenate(references)
    middle, size = joined.mean(), np.ptp(joined)
    plays = PlayOperators().fit((joined[:, None] - middle) / size)
    lags = 2 ** np.arange(max(map(len, references)).bit_length() - 1)
    features = []
    for values in references:
        scaled = (values - middle) / size
        columns = [scaled, scaled**2, scaled**3, *plays.transform(scaled[:, None]).T]
        columns += [scaled - delayed(scaled, lag, scaled[0]) for lag in lags]
        columns += [past_mean(scaled - scaled[0], lag) for lag in lags]
        features.append(np.stack(columns, axis=1))
    features = np.concatenate(features)
    # one scale for all parts: a feature that hardly moves in most has no leverage in the others
    scale = features.std(axis=0)
    return features / np.where(scale > NEGLIGIBLE, scale, 1.0)


def reference_of(search, columns, slices):
    """Return the reference of a search, None where it needs none.

    ``columns`` are those of X. Noise on the drive is read from ``search.data_quality_``.

    Raises
    ------
    ValueError
        If the column is the drive, or constant, or does not predict the drive.
    """
    drive, number = columns[:, 0], column_of(search)
    if number is None:
        if "noisy_drive" not in set(search.data_quality_["fault"]):
            return None
        # one converter has recorded all records, whether or not its noise is detected in each
        return Reference(drive, np.concatenate([_smooth(drive[s.rows]) for s in slices]), slices)
    values = columns[:, number]
    if np.array_equal(drive, values):
        raise _refused(f"another column than the drive. Got column {number}")
    if not np.ptp(values) > 0.0:
        raise _refused(f"a column that moves. Got column {number}, which is constant,")
    reference = Reference(drive, values, slices)
    if not reference.p_value < search.alpha:
        raise _refused(
            "the column that the controller of the drive followed. Got column "
            f"{number}, which predicts {max(100.0 * reference.share, 0.0):.2g} % of the drive "
            f"(p = {reference.p_value:.2g})"
        )
    return reference


def _smooth(drive):
    """Return a drive without its white noise, by a smoothing spline."""
    return make_smoothing_spline(np.arange(len(drive)), drive)(np.arange(len(drive)))


def _refused(requirement):
    return ValueError(f"The 'reference' parameter of EffectSearchCV must be {requirement} instead.")


def column_of(search):
    """Return the number of the column that is the reference of a search; None without one."""
    return None if search.reference is None else find_column(search, search.reference, "reference")


def without_column(X, number):
    """Return X without a column, or unchanged if the number is None."""
    if number is None:
        return X
    if not hasattr(X, "iloc"):
        return np.delete(X, number, axis=1)
    return X.iloc[:, [i for i in range(X.shape[1]) if i != number]]
