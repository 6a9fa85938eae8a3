"""Generalised input gradient: rate and direction of the drive as features."""

from numbers import Integral, Real

import numpy as np

from .._sklearn import Interval, StrOptions
from ..operators import MOST_STEPS
from ._base import RecordTransformer


class GeneralizedInputGradient(RecordTransformer):
    r"""Rate of the drive, with the last rate kept at turning points.

    .. math:: f[u](t) = \begin{cases} f(t - 0) & \text{at an extremum} \\
        \Delta u / \Delta t & \text{else} \end{cases}

    Together with the drive, the rate distinguishes the two branches of a steady loop. It is not the
    complete memory: two minor loops can have the same drive and rate and different responses. For
    these, add the features of the last turning points, or use :class:`PlayOperators`.

    Parameters
    ----------
    method : {"backward", "forward"}, default="backward"
        ``"backward"``: ``(u[k] - u[k-1]) / dt``, causal; at a turning point this is the rate before
        it. The first sample of a record has rate 0. ``"forward"``: ``(u[k+1] - u[k]) / dt`` as in
        Ahmed and Yan (2021), with the rate before it at a turning point and at the last sample; it
        is not causal, by one sample.
    include_drive : bool, default=True
        Whether the drive itself is a feature, the first one.
    include_rate : bool, default=True
        Whether the rate is a feature, after the drive.
    direction : bool, default=False
        Whether to add the sign of the last change of the drive: 1 or -1, also while the drive
        rests, and 0 before the drive of a record has changed. It has no unit and distinguishes the
        branches at any rate.
    turning_points : bool or int, default=False
        True adds the last extreme of the drive and the distance from it; a number adds that many of
        the last extremes, the latest first and followed by the distance from it. Each record begins
        with a first loading from zero: until the drive turns, the last extreme is 0.
    dt : float or None, default=None
        Sampling interval in s of data without a time index.

    See Also
    --------
    PlayOperators : Features that hold the whole history of extrema.
    skhyst.neural.GrayBoxHysteresis : A model that uses this rate.

    Notes
    -----
    The rate is in the drive's unit per second. While the drive rests it is 0: at a flat top the
    gradient exists, and equation (4) does not apply.

    References
    ----------
    Ahmed and Yan, *IEEE Access*, 2021, equations (1) to (4).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.preprocessing import GeneralizedInputGradient
    >>> X = np.array([[0.0], [1.0], [3.0], [2.0]])
    >>> GeneralizedInputGradient(turning_points=True).fit_transform(X)
    array([[ 0.,  0.,  0.,  0.],
           [ 1.,  1.,  0.,  1.],
           [ 3.,  2.,  0.,  3.],
           [ 2., -1.,  3., -1.]])
    """

    one_interval = False  # the rate is per s

    _parameter_constraints = {
        **RecordTransformer._parameter_constraints,
        "method": [StrOptions({"backward", "forward"})],
        "include_drive": ["boolean"],
        "include_rate": ["boolean"],
        "direction": ["boolean"],
        "turning_points": ["boolean", Interval(Integral, 0, MOST_STEPS, closed="both")],
        "dt": [Interval(Real, 0, None, closed="neither"), None],
    }

    def __init__(
        self,
        method="backward",
        *,
        include_drive=True,
        include_rate=True,
        direction=False,
        turning_points=False,
        columns=0,
        dt=None,
    ):
        self.method = method
        self.include_drive = include_drive
        self.include_rate = include_rate
        self.direction = direction
        self.turning_points = turning_points
        self.columns = columns
        self.dt = dt

    def depends_on_interval(self, dt) -> bool:
        """Whether features at another interval differ from those at that of the fit.

        Parameters
        ----------
        dt : float
            Sampling interval in s.

        Returns
        -------
        bool
        """
        return self.include_rate and dt != self.dt_

    def _fit_records(self, X, records):
        if not (self.include_drive or self.include_rate or self.direction or self.turning_points):
            raise ValueError(
                "One of the parameters 'include_drive', 'include_rate', 'direction' and "
                "'turning_points' of GeneralizedInputGradient must be true. Got none instead."
            )

    def _transform_record(self, X, dt, out):
        features = []
        for column in self.columns_:
            drive = X[:, column]
            features += [drive] if self.include_drive else []
            features += [_rate(drive, self.method) / dt] if self.include_rate else []
            features += [_direction(drive)] if self.direction else []
            if self.turning_points:
                extremes = _last_extremes(drive, int(self.turning_points))
                features += [extremes[0], drive - extremes[0], *extremes[1:]]
        np.stack(features, axis=1, out=out)

    def sample_rules(self, rules, places, dt):
        if self.include_rate and self.method == "forward":
            raise NotImplementedError(
                "GeneralizedInputGradient cannot be stepped: with method='forward' it looks ahead."
            )
        features = []
        for drive in self._drives(places):
            features += [drive] if self.include_drive else []
            features += [rules.slope(drive, dt)] if self.include_rate else []
            features += [rules.direction(drive, from_zero=False)] if self.direction else []
            if self.turning_points:
                direction = rules.direction(drive, from_zero=True)
                extremes = [drive]
                for _ in range(int(self.turning_points)):
                    extremes.append(rules.turn(extremes[-1], direction))
                features += [extremes[1], rules.less(drive, extremes[1]), *extremes[2:]]
        return [(place, 0) for place in features]

    def _names(self, names):
        suffixes = [""] * self.include_drive + ["_gradient"] * self.include_rate
        suffixes += ["_direction"] * self.direction
        if self.turning_points:
            suffixes += ["_last_extreme", "_distance"]
            suffixes += [f"_extreme{count}" for count in range(2, int(self.turning_points) + 1)]
        return [names[column] + suffix for column in self.columns_ for suffix in suffixes]


def _rate(drive, method):
    """Return the change per sample."""
    backward = np.diff(drive, prepend=drive[0])
    if method == "backward":
        return backward
    forward = np.append(backward[1:], backward[-1])
    return np.where(backward * forward < 0.0, backward, forward)


def _held(sign):
    """Return the last nonzero sign up to each sample, 0 if there is none."""
    moves = np.arange(sign.size)
    return sign[np.maximum.accumulate(np.where(sign != 0.0, moves, 0))]


def _direction(drive):
    return _held(np.sign(np.diff(drive, prepend=drive[0])))


def _last_extremes(drive, count):
    """Return the values of the last turning points (count, n_samples), the latest first.

    The latest is the start of the present branch. During the first loading, all are 0.
    """
    before = np.append(0.0, drive[:-1])
    direction = _held(np.sign(drive - before))
    turned = np.append(False, direction[1:] * direction[:-1] < 0.0)
    values = np.append(np.zeros(count), before[turned])
    n_turns = np.cumsum(turned)
    return np.stack([values[n_turns + count - 1 - k] for k in range(count)])
