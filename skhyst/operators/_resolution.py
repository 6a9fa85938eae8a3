"""Resolution: how a part that is a sum of terms gets more or fewer terms, or other positions.

Plays, stops, Kelvin-Voigt units and the terms of a curve are terms of one kind, each with a weight
and, except for those of a curve, a position: a threshold, a time constant. Their number and
positions are the resolution of a description, not physics. A part declares it, see
:class:`Resolution`, and gives positions for further terms (``finer``); the code here is common to
all parts.
"""

from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from ._composition import Series, SumOperator, WrappedOperator
from ._protocol import Operator, ParameterSpec


@dataclass(frozen=True)
class Resolution:
    """Resolution of an operator that is a sum of terms: their number and positions.

    Parameters
    ----------
    name : str
        What the terms are called, in the plural.
    weights : str
        Field with one value per term, in which the output is linear; zero for no contribution.
    positions : str or None, default=None
        Field with the position of each term, ascending. None: terms are ordered, and a further one
        is appended.
    others : tuple of str, default=()
        Further linear fields with one value per term; empty if they are not used.
    fixed : float or None, default=None
        Position of a term that is fixed and never removed.

    See Also
    --------
    MovableOperator : An operator whose positions are parameters.

    Examples
    --------
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> plays = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 0.5])
    >>> plays.resolution.name, plays.resolution.of(plays)
    ('plays', 2)
    """

    name: str
    weights: str
    positions: str | None = None
    others: tuple = ()
    fixed: float | None = None

    def of(self, operator):
        """Return the number of terms of an operator.

        Parameters
        ----------
        operator : Operator
            With this resolution.

        Returns
        -------
        int
            Number of terms.
        """
        return np.size(getattr(operator, self.weights))

    def holds_positions(self, operator):
        """Whether terms have positions that a fit holds.

        Parameters
        ----------
        operator : Operator
            That has this resolution.

        Returns
        -------
        bool
            False where they are parameters, or terms have none.
        """
        return self.positions is not None and self.positions not in operator.parameter_specs()

    def stays(self, operator):
        """Mark the terms that are fixed.

        Parameters
        ----------
        operator : Operator
            With this resolution.

        Returns
        -------
        ndarray of bool of shape (n_terms,)
            True for a fixed term.
        """
        if self.fixed is None:
            return np.zeros(self.of(operator), dtype=bool)
        return np.asarray(getattr(operator, self.positions)) == self.fixed


def with_terms(operator, positions):
    """Return an operator with further terms of weight zero, and a mask of the new terms.

    Parameters
    ----------
    operator : Operator
        One with a ``resolution``.
    positions : array-like of shape (n_further,)
        Their positions, as its method ``finer`` returns them.

    Returns
    -------
    operator : Operator
        With the same output.
    further : ndarray of bool of shape (n_terms + n_further,)

    Examples
    --------
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> from skhyst.operators import with_terms
    >>> finer, further = with_terms(PrandtlIshlinskiiOperator([0.0, 2.0], [1.0, 0.5]), [1.0])
    >>> finer.thresholds, finer.weights
    (array([0., 1., 2.]), array([1. , 0. , 0.5]))
    >>> further
    array([False,  True, False])
    """
    kind, n = operator.resolution, len(positions)
    further = np.repeat([False, True], [kind.of(operator), n])
    order = np.arange(len(further))
    changes = {}
    if kind.positions is not None:
        places = np.append(getattr(operator, kind.positions), positions)
        order = np.argsort(places, kind="stable")
        changes[kind.positions] = places[order]
    for name in (kind.weights, *kind.others):
        values = getattr(operator, name)
        if np.size(values) or name == kind.weights:
            changes[name] = np.append(values, np.zeros(n))[order]
    return replace(operator, **changes), further[order]


def same_places(operator, other):
    """Whether the terms of two operators of one kind stand at the same fixed positions."""
    if not operator.resolution.holds_positions(operator):
        return True
    field = operator.resolution.positions
    return np.array_equal(getattr(operator, field), getattr(other, field))


def has_weight(operator):
    """Mark the terms of an operator with a nonzero weight, (n_terms,)."""
    kind = operator.resolution
    weights = [np.asarray(getattr(operator, name)) for name in (kind.weights, *kind.others)]
    return np.any([part != 0.0 for part in weights if part.size], axis=0)


def select_terms(operator, kept):
    """Return an operator with only those of its terms that ``kept`` (n_terms,) marks."""
    kind = operator.resolution
    names = [kind.weights, *kind.others, *([] if kind.positions is None else [kind.positions])]
    fields = {name: np.asarray(getattr(operator, name)) for name in names}
    return replace(operator, **{name: fields[name][kept] for name in names if fields[name].size})


def parts_with_resolution(operator, _prefix=""):
    """Return the parts within an operator that have a resolution.

    Parameters
    ----------
    operator : Operator
        A single part, or a series or a sum of several.

    Returns
    -------
    list of (str, Operator, callable)
        The prefix of the part's entries among those of the operator; the part; and a function that
        returns the operator with another part in its place.
    """
    if operator.resolution is not None:
        return [(_prefix, operator, lambda part: part)]
    if not isinstance(operator, Series | SumOperator):
        return []
    parts, members = [], operator.members()
    if isinstance(operator, Series):  # later stages have an input that this part determines
        members = members[:1]
    for at, (name, stage) in enumerate(members):
        for prefix, part, put in parts_with_resolution(stage, f"{_prefix}{name}__"):
            parts.append((prefix, part, _placed(operator, at, put)))
    return parts


def _placed(operator, at, put):
    def placed(part):
        stages = list(operator.stages)
        stages[at] = put(part)
        return replace(operator, stages=tuple(stages))

    return placed


@dataclass(frozen=True)
class MovableOperator(WrappedOperator):
    """A sum of terms whose positions are parameters, each between the midpoints to its neighbours.

    Only for identification: in an operator positions are fixed structure; ``position_tangents`` are
    the derivatives of its output by them.

    Parameters
    ----------
    operator : Operator
        One with a ``resolution``.
    moving : ndarray of bool of shape (n_terms,)
        The terms that may move.
    limits : ndarray of shape (n_moving, 2)
        Lowest and highest position of each.

    Examples
    --------
    >>> from skhyst.hysteresis import PrandtlIshlinskiiOperator
    >>> from skhyst.operators import MovableOperator
    >>> plays = PrandtlIshlinskiiOperator([0.0, 1.0], [1.0, 0.5])
    >>> movable = MovableOperator.around(plays, highest=3.0)
    >>> movable.entries()[-1][0], movable.limits.tolist()
    ('thresholds[1]', [[0.5, 3.0]])
    """

    operator: Operator
    moving: np.ndarray
    limits: np.ndarray

    # a single part: edits and names do not reach into the operator
    split, inner, keys = Operator.split, Operator.inner, Operator.keys
    resolution = property(attrgetter("operator.resolution"), doc="That of the operator.")

    @classmethod
    def around(cls, operator, highest):
        """Return an operator in which terms with nonzero weight may move.

        Parameters
        ----------
        operator : Operator
            With a resolution.
        highest : float
            Upper limit of the positions.

        Returns
        -------
        MovableOperator
            With the positions as parameters.
        """
        kind = operator.resolution
        places = np.asarray(getattr(operator, kind.positions), dtype=float)
        moving = ~kind.stays(operator) & (places <= highest) & has_weight(operator)
        between = 0.5 * (places[1:] + places[:-1])
        lowest = 0.5 * places[:1]  # a term that is not at zero stays away from zero
        limits = np.transpose([np.append(lowest, between), np.append(between, highest)])
        return cls(operator, moving, limits[moving], model=operator.model)

    @property
    def _field(self):
        return self.operator.resolution.positions

    @property
    def _places(self):
        return np.array(getattr(self.operator, self._field), dtype=float)

    def entries(self):
        rows = zip(np.flatnonzero(self.moving).tolist(), self.limits.tolist(), strict=True)
        moved = [
            (f"{self._field}[{i}]", ParameterSpec(lower=a, upper=b, unit="drive"))
            for i, (a, b) in rows
        ]
        return [*self.operator.entries(), *moved]

    def pack(self):
        return np.append(self.operator.pack(), self._places[self.moving])

    def unpack(self, vector):
        n, places = self.operator.n_parameters, self._places
        places[self.moving] = vector[n:]
        return self._with(replace(self.operator.unpack(vector[:n]), **{self._field: places}))

    def unfitted(self):
        return Operator.unfitted(self)

    def sensitivities(self, u, du, dt, initial_state="rest"):
        y, dy = self.operator.sensitivities(u, du, dt, initial_state)
        if not self.moving.any():
            return y, dy
        moving = select_terms(self.operator, self.moving)
        return y, np.column_stack([dy, moving.position_tangents(u, dt, initial_state)])
