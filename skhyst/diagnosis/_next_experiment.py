"""The next experiment: the most informative drive for a search, as a file."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.utils.validation import check_is_fitted

from .._files import check_outputs, replacing
from ..datasets import FEWEST, from_rest_to_rest, signals_within
from ..optimize import RecordData
from ..records import stack_records
from ._black_box import drive_of
from ._open_questions import question_of
from ._reference import column_of


@dataclass(frozen=True)
class Experiment:
    """A drive to record next.

    Parameters
    ----------
    drive : Series of shape (n_samples,)
        Units of the drive; the index is the time in s. Before the record the device rests at the
        first value.
    signal : str
        Description of the drive.
    reason : str
        The purpose, with numbers: one sentence, and another if something is assumed.
    expected_gain : float
        Information in nats, see :func:`next_experiment`.
    """

    drive: pd.Series = field(repr=False)
    signal: str
    reason: str
    expected_gain: float

    def save(self, path, rest=None, *, force=False) -> None:
        """Write time and drive as a CSV file, from rest to rest.

        The drive is preceded by a ramp from rest, at times below zero, and followed by one back,
        neither steeper than the drive itself.

        Parameters
        ----------
        path : str or Path
            File that is written.
        rest : float or None, default=None
            Drive at which the amplifier rests, its units; by default the one nearest to zero within
            the range of the drive.
        force : bool, default=False
            Whether an existing file is overwritten.

        Raises
        ------
        OSError
            If the file exists already, or cannot be written.
        """
        check_outputs([Path(path)], force=force)
        with replacing(path) as (part,):
            self.from_rest(rest).to_csv(part)

    def from_rest(self, rest=None) -> pd.Series:
        """Return the drive with the ramps from rest and back that :meth:`save` writes.

        Parameters
        ----------
        rest : float or None, default=None
            Drive at which the amplifier rests, its units; by default the one nearest to zero within
            the range of the drive.

        Returns
        -------
        Series of shape (n_samples + n_ramps,)
            The index is the time in s, zero where the drive itself begins.
        """
        dt = float(self.drive.index[1] - self.drive.index[0])
        drive, n_before = from_rest_to_rest(self.drive, dt, rest)
        time = pd.Index(dt * (np.arange(len(drive)) - n_before), name="time")
        return pd.Series(drive, time, name="drive")


def next_experiment(search, drive_limits, rate_limit=None, duration=None, dt=None) -> Experiment:
    """Propose the drive that is most informative about what a search has left open.

    If claims are ambiguous, it discriminates between them and their rivals, and so of the places of
    a term without a name. Otherwise, if the
    verdict is not ``"noise"``, it discriminates between the model and those with one of the effects
    that came nearest to a claim, and else it reduces confidence intervals of parameters. It is the
    best of the signals of :func:`skhyst.datasets.signals_within`, by the predictions of the models
    relative to the noise.

    Parameters
    ----------
    search : EffectSearchCV
        Fitted.
    drive_limits : (float, float)
        Lowest and highest drive, its units. Beyond the recorded range the models extrapolate.
    rate_limit : float or None, default=None
        Largest slope, units of the drive over s. None: any.
    duration, dt : float or None, default=None
        Duration and sampling interval in s. None: those of the longest record of the search, with
        64 samples at least.

    Returns
    -------
    Experiment
        Its ``expected_gain`` is the information in nats: about the differences of the models, or
        about the parameters.

    Raises
    ------
    NotFittedError
        If the search is not fitted.
    ValueError
        If limits, rate, duration and interval are inconsistent.

    Notes
    -----
    Further columns of X are assumed constant at their means, and a feedback loop, if there was one,
    open. Search the new record together with the old ones.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.datasets import sine
    >>> from skhyst.diagnosis import EffectSearchCV, next_experiment
    >>> from skhyst.linear import Gain
    >>> X = sine(1.0, 2.0, n_cycles=4, dt=5e-3)
    >>> u = X["drive"].to_numpy()
    >>> y = np.interp(np.arange(len(u)) - 2.0, np.arange(len(u)), u)  # two samples late
    >>> y += 0.02 * np.random.default_rng(0).normal(size=len(u))
    >>> search = EffectSearchCV(Gain(), effects=["delay", "lag"]).fit(X, y)
    >>> search.effects_, search.history_["ambiguous_with"].tolist()
    (['delay'], [('lag',)])
    >>> next_experiment(search, (-1.0, 1.0), rate_limit=100.0).signal
    'triangle of 9 Hz from -1 to 1'
    """
    check_is_fitted(search)
    longest = max(search.records_, key=lambda s: s.n_samples * s.dt)
    dt = longest.dt if dt is None else dt
    if duration is None:
        duration = max(longest.n_samples * longest.dt, FEWEST * dt)
    signals = signals_within(drive_limits, duration, dt, rate_limit=rate_limit)
    question = question_of(search)
    answers = {name: question.evaluate(_record(search, u, dt)) for name, u in signals.items()}
    name = max(answers, key=lambda own: question.score(answers[own]))
    drive = signals[name]
    time = pd.Index(dt * np.arange(len(drive)), name="time")
    reason = question.describe(answers[name], len(drive))
    if search._records[0].auxiliary is not None:
        reason += " Further columns are taken to stay at their means."
    gain, name = float(question.score(answers[name])[-1]), search.units_.in_time(name)
    return Experiment(
        pd.Series(drive, time, name="drive"), name, f"{name[0].upper()}{name[1:]}: {reason}", gain
    )


def _record(search, drive, dt):
    """Return a record of the drive, with the input that the stages of the search's models read."""
    names = getattr(search, "feature_names_in_", None)
    auxiliary = search._records[0].auxiliary
    columns = drive[:, None]
    if auxiliary is not None:
        means = np.concatenate([r.auxiliary for r in search._records]).mean(axis=0)
        auxiliary = np.tile(means, (len(drive), 1))
        columns = np.concatenate([columns, auxiliary], axis=1)
    if names is not None and search.reference is not None:
        names = np.delete(names, column_of(search))
    X = stack_records([pd.DataFrame(columns, columns=names)], dt=dt)
    u = drive_of(search._driver, X if names is not None else columns, columns)
    return RecordData(u, np.zeros(len(u)), dt, auxiliary=auxiliary)
