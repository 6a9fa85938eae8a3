"""Features of a signal at one sample, from those of the sample before: what streams.

The inputs and all that is made of them stand in one row. Each further number of the row follows by
a rule, a line of a table, from numbers of this row and of the one before.
"""

import numpy as np

from .._jit import jit

_PLAY, _LESS, _SLOPE, _DIRECTION, _TURN = map(float, range(5))


class SampleRules:
    """Collects the rules by which a row goes on.

    Parameters
    ----------
    row : array-like of shape (n_columns,)
        The inputs while the device rests, before the first sample.

    Attributes
    ----------
    row : list of float
        With what is made of the inputs.
    table : list of tuple
        Of each number that is made: kind, places that it reads, and a value.

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
        """Return the place of a play of the number at ``a``, after a first loading from zero."""
        initial = max(self.row[a] - threshold, min(self.row[a] + threshold, 0.0))
        return self._add(initial, _PLAY, a, 0, threshold)

    def less(self, a, b):
        """Return the place of the number at ``a`` less that at ``b``."""
        return self._add(self.row[a] - self.row[b], _LESS, a, b, 0.0)

    def slope(self, a, dt):
        """Return the place of the change of the number at ``a``, divided by ``dt``."""
        return self._add(0.0, _SLOPE, a, 0, dt)

    def direction(self, a, from_zero):
        """Return the place of the sign of the last move of the number at ``a``.

        At rest it is 0, or, where the first move is the one from zero, the sign of that.
        """
        return self._add(np.sign(self.row[a]) if from_zero else 0.0, _DIRECTION, a, 0, 0.0)

    def turn(self, a, b):
        """Return the place of what stood at ``a`` before the direction at ``b`` last turned."""
        return self._add(0.0, _TURN, a, b, 0.0)


@jit
def follow_rules(s, before, first, rules):
    """Write the numbers of a row that follow from others.

    Parameters
    ----------
    s : ndarray
        Has the row in front, with the inputs of a sample.
    before : int
        Place of the row before.
    first : int
        Place of the first number that follows.
    rules : ndarray of shape (n_rules, 4)
        The table of :class:`SampleRules`.
    """
    for i in range(rules.shape[0]):
        kind, a, b, value = rules[i, 0], int(rules[i, 1]), int(rules[i, 2]), rules[i, 3]
        own, change = s[before + first + i], s[a] - s[before + a]
        if kind == _PLAY:
            own = max(s[a] - value, min(s[a] + value, own))
        elif kind == _LESS:
            own = s[a] - s[b]
        elif kind == _SLOPE:
            own = change / value
        elif kind == _DIRECTION:
            if change != 0.0:
                own = 1.0 if change > 0.0 else -1.0
        elif s[b] * s[before + b] < 0.0:
            own = s[before + a]
        s[first + i] = own
