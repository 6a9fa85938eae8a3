r"""Whether a residual is noise: from a noise floor and a ceiling, in this order.

The **floor** cannot be the response of any model: it is the smallest of the scatter between
repetitions of the drive, of the innovations of the residual under its noise model, and of the
scaled differences of residual and response (:func:`skhyst.noise.difference_noise`). The last two
count everything smooth as structure; of coloured noise they contain only a part. The **ceiling** is
the held-out error, or the part of it that a black box does not predict.

1. **What is found is structure**, however close to the floor: what repetitions share, what a black
   box predicts, or what follows the drive better than the drive shifted in time (``_structure``),
   if it is significant and matters. The residual is ``unexplained``.
2. Otherwise, if floor and ceiling agree within `min_improvement`, it is ``noise``.
3. Between them it is ``noise`` if it *can* be, or if repetitions show it, since a misfit repeats.
   It can be noise on these conditions. Its spectrum falls with an exponent below 2: the power of an
   integrated signal, such as drift or creep, grows without bound with the record. Its correlation
   falls to 1/e within a fifth of the drive's period: a response changes as the drive does, that to
   a sine within 0.19 of its period. Or the record is at least 90 times as long as this correlation:
   then structure would have been found. The fraction s of the power, in m independent pieces, gives
   a mean T of :math:`\sqrt{m s / (1 - s)} / 2` in the test of ``_criterion``, and a dozen trials at
   the level of 1 % find half of the power with a probability of 95 % from
   :math:`m = (2 (3.1 + 1.6))^2` on. Its median magnitude is less than three times that of its
   innovations: a larger ratio resembles a smooth misfit with a little noise (for a first-order
   process, a correlation of 0.94 per sample), also where the misfit jumps now and then. Its
   innovations, enlarged as the held-out error is, are less than three times the floor, or the
   rounding of the converter if that is larger: under all laws with an exponent below 2 innovations
   are at most 2.2 times the scaled differences. A black box predicts less of it than matters, even
   by chance. And the held-out error is less than three times that of the fit, both in blocks and in
   whole records within the range of the others: a larger ratio is not that of stationary noise.
4. Otherwise it is ``undetermined``, and the advice says what to record.

The limits of the third step are checked by ``benchmarks/verdicts.py``: hardly any white,
first-order or flicker noise is missed, and hardly any structure that no test has found is called
noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..noise import NoiseModel, difference_noise, fit_noise
from ._structure import (
    by_black_boxes,
    by_shifted_drive,
    in_repetitions,
    repeatability,
    repetitions,
)
from ._turns import turns

LARGEST_EXPONENT = 2.0  # of the spectrum: that of integrated white noise
CORRELATED = 0.2  # of the drive's period
PIECES = 90  # correlation lengths of a record, in which structure as large as noise is found
PREDICTABLE = 3.0  # largest ratio of noise to its innovations


@dataclass(frozen=True)
class Judgement:
    """Judgement of the residual of a model.

    Attributes
    ----------
    verdict : {"noise", "unexplained", "undetermined"}
    floor, ceiling : float
        Bounds of the noise's root mean square, units of the response.
    noise : NoiseModel
        Of the residual without its structure.
    reason : str
        What decided the verdict.
    advice : str
        What to record if it is undetermined.
    p_value : float
        Of the hypothesis that the residual is noise.
    share : float
        Smallest fraction of the residual's power that a test has left.
    repeated : bool
        Whether the drive repeats itself.
    unpredicted : float
        Fraction of the residual's power that neither a black box predicts nor repetitions share.
    """

    verdict: str
    floor: float
    ceiling: float
    noise: NoiseModel
    reason: str
    p_value: float = 1.0
    share: float = 1.0
    repeated: bool = False
    unpredicted: float = 1.0
    advice: str = ""

    @classmethod
    def of_rounding(cls, error):
        """Return the judgement of an error that is no more than rounding."""
        return cls(
            "noise", error, error, NoiseModel("white", error), "the residual is zero to rounding"
        )

    @property
    def structured(self):
        """Whether the residual has structure."""
        return self.verdict == "unexplained"


def judge_residual(records, residuals, predictions, rng, criterion, *, error=None, in_loop=False):
    """Judge whether residuals are noise or structure.

    Parameters
    ----------
    records : sequence of RecordData
    residuals, predictions : sequence of ndarray of shape (n_samples,)
        Of each record, from the fit to all records; NaN where nothing is scored. Without a model,
        the response minus its mean, and that mean.
    rng : numpy.random.Generator
    criterion : Criterion
    error : float or None, default=None
        Held-out error of the model. None: the root mean square of the residuals.
    in_loop : bool, default=False
        Whether the reference of a loop replaces the drive of the records, and predictions are
        responses to the part of the drive that it explains. Repetitions then have different drives,
        but still independent noise.

    Returns
    -------
    Judgement
    """
    readings = [record.y for record in records]
    count = max(sum(np.isfinite(r).sum() for r in residuals), 1)
    power = sum(np.nansum(np.square(r)) for r in residuals) / count
    noise = fit_noise(residuals, readings)
    ceiling = float(np.sqrt(power)) if error is None else float(error)
    if not power > 0.0:
        return Judgement.of_rounding(ceiling)
    pairs = list(repetitions(records))
    scatter = None if in_loop else repeatability(records, pairs=pairs)
    responses = [] if in_loop else readings  # a loop attenuates the noise of the response
    floor = min(noise_floor(responses, residuals, noise, scatter), ceiling)
    trials = {
        "a black box predicts it": by_black_boxes(records, residuals, predictions, rng, criterion),
        "it follows the drive better than the drive shifted in time": by_shifted_drive(
            records, residuals, predictions
        ),
    }
    if pairs:
        trials["it repeats with the drive"] = in_repetitions(pairs, residuals, power)
    found = {name: own for name, own in trials.items() if own.is_structure(criterion)}
    p_value = min(own.p_value for own in trials.values())
    predicted, unpredicted = [own for own in found.values() if own.left is not None], 1.0
    if predicted:
        best = predicted[-1]  # repetitions show the noise, the black box only what it could predict
        unpredicted = float(best.share)
        noise, ceiling = fit_noise(best.left, readings), ceiling * unpredicted**0.5
    share = min(own.share for own in (found or trials).values())
    statistics = p_value, share, bool(pairs), unpredicted
    if found:
        reason = "; ".join(found)
        return Judgement("unexplained", min(floor, ceiling), ceiling, noise, reason, *statistics)
    matters = 1.0 - criterion.min_improvement
    if floor >= matters * ceiling:
        return Judgement(
            "noise", floor, ceiling, noise, "noise floor and ceiling agree", *statistics
        )
    scatters = scatter is None or scatter >= matters * ceiling
    if pairs and scatters and not trials["it repeats with the drive"].improves_enough(criterion):
        return Judgement(
            "noise", floor, ceiling, noise, "it does not repeat with the drive", *statistics
        )
    size = float(np.sqrt(power))
    against = list(_against_noise(records, residuals, noise, floor, ceiling / size))
    predicts = trials["a black box predicts it"]
    if predicts.improves_enough(criterion):
        against.append(
            f"a black box predicts part of it, not significantly (p = {predicts.p_value:.2g})"
        )
    advice = "more repetitions of the drive" if pairs else "the same drive twice or more often"
    advice = f"record {advice}: noise does not repeat"
    if ceiling >= PREDICTABLE * size:
        against = [f"the held-out error is {ceiling / size:.3g} times the residual of the fit"]
        advice = "record longer, and more of the conditions with the largest held-out error"
    if not against:
        return Judgement(
            "noise", floor, ceiling, noise, f"it is consistent with {noise}", *statistics
        )
    return Judgement("undetermined", floor, ceiling, noise, "; ".join(against), *statistics, advice)


def noise_floor(responses, residuals, noise=None, scatter=None):
    """Return the least that the noise can be, units of the response.

    Parameters
    ----------
    responses, residuals : sequence of ndarray of shape (n_samples,)
        NaN where nothing is scored. Before there is a model, both are the responses.
    noise : NoiseModel or None, default=None
        Of the residuals.
    scatter : float or None, default=None
        Standard deviation between repetitions, if there are any.
    """
    noise = fit_noise(residuals) if noise is None else noise
    sizes = [
        _innovation_size(noise, residuals),
        difference_noise(residuals),
        difference_noise(responses),
        np.nan if scatter is None else scatter,
    ]
    return float(np.nanmin(sizes))


def _innovation_size(noise, residuals):
    """Return the root mean square of the innovations."""
    innovations = np.concatenate(noise.innovations(residuals))
    return np.sqrt(np.nanmean(np.square(innovations)))


def _against_noise(records, residuals, noise, floor, excess):
    """Yield the reasons why residuals can hardly be noise.

    ``excess`` is the held-out error over the root mean square of the residuals.
    """
    if noise.law == "power_law" and noise.coefficient >= LARGEST_EXPONENT:
        yield f"its spectrum falls as f^-{noise.coefficient:.2f}"
    counts = [int(np.isfinite(r).sum()) for r in residuals]
    correlated, period = noise.correlation_length(max(counts)), _drive_period(records)
    if correlated > max(CORRELATED * period, sum(counts) / PIECES):
        yield f"it is correlated over {correlated:.3g} samples, the drive's period is {period:.3g}"
    size, innovation = map(_median_magnitude, (residuals, noise.innovations(residuals)))
    if size >= PREDICTABLE * innovation:
        yield f"it is {size / innovation:.3g} times its innovations"
    white, least = excess * innovation / norm.ppf(0.75), max(floor, noise.quantisation / 12.0**0.5)
    if white >= PREDICTABLE * least:
        yield f"without its colour it is {white:.3g}, the noise floor {least:.3g}"


def _median_magnitude(signals):
    return np.nanmedian(np.abs(np.concatenate(signals)))


def _drive_period(records):
    """Return the mean number of samples per two turns of the drive, or of the record."""
    count = sum(len(turns(record.u)) for record in records)
    if not count:
        return max(len(record.u) for record in records)
    return 2.0 * sum(len(record.u) for record in records) / count
