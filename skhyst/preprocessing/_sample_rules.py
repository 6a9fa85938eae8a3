"""Features of one sample from those of the sample before, for models that are stepped.

The inputs and the features computed from them form one row. Each feature follows by a rule, one
line of a table, from values of this row and of the previous one.
"""

import numpy as np

from .._jit import jit

_PLAY, _LESS, _SLOPE, _DIRECTION, _TURN = map(float, range(5))


class SampleRules:
    """Collects the rules that compute a row of inputs and features from the previous row.

    Parameters
    ----------
    row : array-like of shape (n_columns,)
        The inputs while the device rests, before the first sample.

    Attributes
    ----------
    row : list of float
        Inputs and features while the device is at rest.
    table : list of tuple
        One rule per feature: kind, two positions in the row that it reads, and a value.

    Examples
    --------
    >>> from skhyst.preprocessing import SampleRules
    >>> rules = SampleRules([4.0])
    >>> rules.play(0, 1.0), rules.row
    (1, [4.0, 3.0])
    """

    def __init__(self, row):
        self.row = [float(value) for value in row]
        self.table = []

    def _add(self, initial, *rule):
        self.table.append(rule)
        self.row.append(float(initial))
        return len(self.row) - 1

    def play(self, a, threshold):
        """Add a play of the value at ``a``, first loaded from zero; return its position."""
        initial = max(self.row[a] - threshold, min(self.row[a] + threshold, 0.0))
        return self._add(initial, _PLAY, a, 0, threshold)

    def less(self, a, b):
        """Add the value at ``a`` minus that at ``b``; return its position."""
        return self._add(self.row[a] - self.row[b], _LESS, a, b, 0.0)

    def slope(self, a, dt):
        """Add the rate of the value at ``a``, change over ``dt``; return its position."""
        return self._add(0.0, _SLOPE, a, 0, dt)

    def direction(self, a, from_zero):
        """Add the sign of the last change of the value at ``a``; return its position.

        At rest it is 0 or, with ``from_zero``, the sign of the change from zero to the value.
        """
        return self._add(np.sign(self.row[a]) if from_zero else 0.0, _DIRECTION, a, 0, 0.0)

    def turn(self, a, b):
        """Add the value at ``a`` before the last reversal of ``b``; return its position."""
        return self._add(0.0, _TURN, a, b, 0.0)


@jit
def follow_rules(s, before, first, rules):
    """Compute the features of a row, in place.

    Parameters
    ----------
    s : ndarray
        Begins with the row, in which the inputs of the sample are set.
    before : int
        Position of the previous row in ``s``.
    first : int
        Position of the first feature in the row.
    rules : ndarray of shape (n_rules, 4)
        The table of :class:`SampleRules`.
    """
    for i in range(rules.shape[0]):
        kind, a, b, value = rules[i, 0], int(rules[i, 1]), int(rules[i, 2]), rules[i, 3]
        feature, change = s[before + first + i], s[a] - s[before + a]
        if kind == _PLAY:
            feature = max(s[a] - value, min(s[a] + value, feature))
        elif kind == _LESS:
            feature = s[a] - s[b]
        elif kind == _SLOPE:
            feature = change / value
        elif kind == _DIRECTION:
            if change != 0.0:
                feature = 1.0 if change > 0.0 else -1.0
        elif s[b] * s[before + b] < 0.0:
            feature = s[before + a]
        s[first + i] = feature
