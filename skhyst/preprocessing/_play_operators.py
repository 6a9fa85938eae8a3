"""Play and stop operators as features."""

from numbers import Integral

import numpy as np

from .._sklearn import Interval, StrOptions
from ..operators import as_signal, play_basis, play_thresholds, stop_basis
from ._base import RecordTransformer


class _OperatorBasis(RecordTransformer):
    """Base of both, which give ``_kernel``, ``_label`` and ``_first``, the first default threshold.

    Parameters
    ----------
    n_operators : int, default=20
        Number of thresholds per column; ignored where ``thresholds`` is given.
    spacing : {"grid", "quantile"}, default="grid"
        Spacing of the default thresholds; see :func:`skhyst.operators.play_thresholds`.

    Attributes
    ----------
    thresholds_ : ndarray of shape (n_columns, n_operators)
        Thresholds of each column in its unit.
    """

    _parameter_constraints = {
        **RecordTransformer._parameter_constraints,
        "n_operators": [Interval(Integral, 1, None, closed="left")],
        "thresholds": ["array-like", None],
        "spacing": [StrOptions({"grid", "quantile"})],
        "include_drive": ["boolean"],
    }

    one_interval = False  # plays are rate-independent

    def _fit_records(self, X, records):
        if self.thresholds is None:
            number = self.n_operators + self._first
            rows = []
            for column in self.columns_:
                drives = [X[record.rows, column] for record in records]
                rows.append(play_thresholds(drives, number, self.spacing)[self._first :])
        else:
            thresholds = np.array(self.thresholds, dtype=float)
            if thresholds.ndim != 1 or thresholds.size == 0 or not np.all(thresholds >= 0.0):
                raise ValueError(
                    f"The 'thresholds' parameter of {type(self).__name__} must be a list of values "
                    f"that are not negative. Got {self.thresholds!r} instead."
                )
            rows = [thresholds] * len(self.columns_)
        self.thresholds_ = np.array(rows)

    def _transform_record(self, X, dt, out):
        n_operators, stop = self.thresholds_.shape[1], 0
        for column, thresholds in zip(self.columns_, self.thresholds_, strict=True):
            drive = as_signal(X[:, column])
            if self.include_drive:
                out[:, stop] = drive
                stop += 1
            start, stop = stop, stop + n_operators
            basis = out[:, start:stop]  # contiguous where there are no other features
            self._kernel(drive, as_signal(thresholds), np.zeros(n_operators), basis)

    def sample_rules(self, rules, places, dt):
        features = []
        for drive, thresholds in zip(self._drives(places), self.thresholds_, strict=True):
            features += [drive] if self.include_drive else []
            plays = [rules.play(drive, threshold) for threshold in thresholds]
            features += plays if self._label == "play" else [rules.less(drive, p) for p in plays]
        return [(place, 0) for place in features]

    def _names(self, names):
        result = []
        for column in self.columns_:
            name = names[column]
            result += [name] if self.include_drive else []
            result += [f"{name}_{self._label}{k}" for k in range(self.thresholds_.shape[1])]
        return result


class PlayOperators(_OperatorBasis):
    r"""Play operators of the drive: the features of a Prandtl-Ishlinskii model.

    .. math:: F_r[u](t) = \max(u(t) - r, \min(u(t) + r, F_r[u](t^-)))

    (Steinbusch, *Hysteresis and Dynamics Compensation for Accurate Positioning in High Speed Piezo
    Scanning Stages*, 2020, equations (3.2) to (3.6)). Each record starts with a first loading from
    zero to its first value, where a play is at ``max(u - r, min(u + r, 0))``. A linear model of
    these features is a Prandtl-Ishlinskii model, any other regressor a static map of hysteresis
    memory.

    Parameters
    ----------
    thresholds : array-like of shape (n_operators,), default=None
        Thresholds in the unit of the drive; by default from the range of the data, the first 0, for
        which the feature is the drive itself.
    include_drive : bool, default=False
        Whether the drive itself is a feature, before its plays.

    See Also
    --------
    StopOperators : The complementary features, the drive minus its plays.
    skhyst.hysteresis.PrandtlIshlinskii : A linear model of these features.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.preprocessing import PlayOperators
    >>> X = np.array([[0.0], [2.0], [-2.0]])
    >>> PlayOperators(thresholds=[0.0, 1.0]).fit_transform(X)
    array([[ 0.,  0.],
           [ 2.,  1.],
           [-2., -1.]])
    """

    _kernel = staticmethod(play_basis)
    _label = "play"
    _first = 0

    def __init__(
        self, n_operators=20, *, thresholds=None, spacing="grid", include_drive=False, columns=0
    ):
        self.n_operators = n_operators
        self.thresholds = thresholds
        self.spacing = spacing
        self.include_drive = include_drive
        self.columns = columns


class StopOperators(_OperatorBasis):
    r"""Stop operators of the drive: ``E_r[u] = u - F_r[u]``, an elastic element that yields at r.

    ``F_r`` is a play, see :class:`PlayOperators`.

    Parameters
    ----------
    thresholds : array-like of shape (n_operators,), default=None
        Thresholds in the unit of the drive; by default from the range of the data, the first above
        0, for which the feature would be zero.
    include_drive : bool, default=True
        Whether the drive itself is a feature, before its stops.

    See Also
    --------
    PlayOperators : The complementary features, the drive minus its stops.
    skhyst.hysteresis.MaxwellSlip : A linear model of these features.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.preprocessing import StopOperators
    >>> X = np.array([[0.0], [2.0], [1.5]])
    >>> StopOperators(thresholds=[1.0], include_drive=False).fit_transform(X)
    array([[0. ],
           [1. ],
           [0.5]])
    """

    _kernel = staticmethod(stop_basis)
    _label = "stop"
    _first = 1

    def __init__(
        self, n_operators=20, *, thresholds=None, spacing="grid", include_drive=True, columns=0
    ):
        self.n_operators = n_operators
        self.thresholds = thresholds
        self.spacing = spacing
        self.include_drive = include_drive
        self.columns = columns
