"""Operators as parts of a tree, which is the structure of a model.

The leaves of the tree are operators of single models. Its nodes join them: in series (``|``), in
parallel (``+``), scaled by a column of the input (``*``), driven by a column, or with parameters
that depend on a value per record. Each part has in ``model`` the unfitted estimator it belongs to
(for a node, with that node's own parameters only), so that ``estimator()`` composes the whole;
``tree(operator)`` of an estimator is the inverse. An edit of a model is a function from a tree to a
tree, see ``_driven_series``.
"""

import dataclasses
import re
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from sklearn.base import clone

from .._documentation import inherit_documentation

JOIN = {}  # symbol -> function of two operands, filled where the nodes are defined
_COMPOSE = f"{__package__.partition('.')[0]}.compose"  # imported on demand: it imports this


def snake_case(name) -> str:
    """Return ``PrandtlIshlinskii`` as ``prandtl_ishlinskii``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


class Stage(NamedTuple):
    """A part of a tree and its name; None for the name of its estimator."""

    name: str | None
    operator: Any

    @property
    def model(self):
        """The unfitted estimator."""
        return self.operator.unfitted()


class Factor(NamedTuple):
    """The factor ``1 + sensitivity (column - reference)`` that scales a response, by ``*``.

    Parameters
    ----------
    column : int
        Of the input; -1 for the last one.
    reference : float, default=0.0
        Units of the column.
    sensitivity : float, default=0.0
        One over the units of the column.

    See Also
    --------
    Scaled : The node that ``operator * Factor(...)`` makes.

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.linear import GainOperator
    >>> from skhyst.operators import Factor
    >>> warm = GainOperator(3.0) * Factor(1, reference=20.0, sensitivity=0.1)
    >>> warm.run(np.array([[1.0, 20.0], [1.0, 25.0]]), 0.1)[0]
    array([3. , 4.5])
    """

    column: int
    reference: float = 0.0
    sensitivity: float = 0.0


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Base of the operators: members that a tree needs of its parts, each with a default.

    Parameters
    ----------
    model : estimator, default=None
        The unfitted estimator that it belongs to; None if it is not known.

    Attributes
    ----------
    signal_linear : bool
        The output is an affine function of the input signal, whatever the input.
    owns_gain : bool
        The operator has a static gain and an intercept of its own, like a hysteresis; in a series
        every other stage then has unit gain and no intercept.
    stage_order : int
        Place of the stage in a series: 0 limits of the drive, 5 delays, 10 hysteresis, 20 curves
        behind the hysteresis, 30 linear dynamics, 40 sensor curves, 50 limits of the sensor, 60
        shifts between instruments, and additive disturbances.
    n_poles : (int, int)
        Number of real poles and of pairs of poles of a linear operator.
    has_matrices : bool
        It is linear, and ``discrete(dt)`` returns the matrices of its discrete form.
    memoryless : bool
        The output depends on the input of the same instant alone.
    of_rate : bool
        The output depends on the input and its rate alone. Then ``surface(v)`` returns it with its
        derivatives by both and by its own entries, for rows of the two, and ``compiled_surface()``
        has a step of such a row.
    causal : bool
        The output depends on no later input, so that a run may be cut anywhere.
    at_once : bool
        The output is a monotone function of the input of the same instant, whatever came before,
        so that a drive for an output can be found sample by sample.
    n_start : int
        Number of values that define the state at the first sample, for an operator without a state
        of rest, such as displacement and velocity of a free mass; else 0. ``init`` and
        ``sensitivities`` then take them, (n_start,), as ``initial_state``, and there are the
        methods of ``StartValues``.
    is_disturbance : bool
        The output is a disturbance ``basis(time) coefficients``, whatever the input, with
        ``coefficients`` per record; it has the methods of ``DisturbanceOperator``.
    reads_columns : bool
        The input has several columns, shape (n_samples, n_inputs).
    moves_at_rest : bool
        The output moves while the input rests, as of linear dynamics: an input that is held between
        samples gives an output that is not. A node moves where one of its parts does.
    schedule_range : (float, float) or None
        Least and largest schedule of the fit, where parameters depend on a schedule.
    resolution : Resolution or None
        Which fields tell how many terms it is the sum of, such as plays, and where they stand, if
        that may be chosen.
    scaled_within : tuple of str
        Parameters that it scales within itself by a factor that varies from sample to sample, all
        together, such as the thresholds of plays: by the methods of ``ScaledWithin``.
    children : tuple of Operator
        The parts that a node joins or wraps.

    Examples
    --------
    >>> from skhyst.linear import FirstOrderLag, FirstOrderLagOperator, Gain, GainOperator
    >>> gain, lag = Gain().tree(GainOperator(2.0)), FirstOrderLag().tree(FirstOrderLagOperator(0.1))
    >>> (gain | lag).estimator(dt=0.01)
    Cascade(dt=0.01, steps=[('gain', Gain()), ('first_order_lag', FirstOrderLag())])
    """

    model: Any = dataclasses.field(default=None, kw_only=True, compare=False, repr=False)

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        inherit_documentation(cls, attributes=False)

    signal_linear = False
    owns_gain = False
    stage_order = 30
    n_poles = (0, 0)
    has_matrices = False
    memoryless = False
    of_rate = False
    causal = True
    at_once = True
    is_disturbance = False
    reads_columns = False
    schedule_range = None
    resolution = None
    scaled_within = ()
    children = ()
    driving_column = 0  # of the input
    structure_of = None  # of a node: name of the estimator in skhyst.compose

    def linear_mode(self):
        """Return the second-order mode without hysteresis and nonlinearity, or None."""
        return None

    def in_order(self):
        """Return an equivalent operator with exchangeable parts in ascending order.

        For example the modes of a transfer function, by frequency; by default the operator itself.

        Returns
        -------
        Operator
        """
        return self

    def slowest_decay(self) -> float:
        """Return the longest time in which a state falls to 1/e, s; infinite for an integrator.

        Of the linear parts only; 0 if there are none.
        """
        return max((child.slowest_decay() for child in self.children), default=0.0)

    def at(self, schedule):
        """Return the operator of a record, whose parameters may depend on a value per record.

        Parameters
        ----------
        schedule : float
            Value of the record, such as its amplitude.

        Returns
        -------
        Operator
            A copy, or the operator itself if nothing depends on it.
        """
        return self

    def ahead(self, dt: float, u0: float, tol: float = 1e-9):
        """Return a step with preview: its input lies some samples after its output.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        u0 : float
            Input at which the device rests before.
        tol : float, default=1e-9
            Fraction of the effect of later input that may be neglected, if all later input has an
            effect.

        Returns
        -------
        compiled_step : CompiledStep
            The step.
        samples : int
            Samples by which its output lags behind its input; 0 if the operator is causal.

        Raises
        ------
        NotImplementedError
            If no finite number of samples is enough.
        """
        return self.compiled_step(dt, self.init(u0)), 0

    def __or__(self, other):
        """Return the series: the output of the first is the input of the second."""
        return JOIN["|"](self, other) if isinstance(other, Part) else NotImplemented

    def __add__(self, other):
        """Return the sum of the outputs."""
        return JOIN["+"](self, other) if isinstance(other, Part) else NotImplemented

    def __mul__(self, factor):
        """Return the output scaled by a :class:`Factor`."""
        return JOIN["*"](self, factor) if isinstance(factor, Factor) else NotImplemented

    # ------------------------------------------------------------------ as an estimator

    @property
    def acting_columns(self) -> set[int]:
        """Numbers of the columns that the operator reads other than as its drive."""
        column = getattr(self, "column", -1)  # -1 is the amplitude, which is that of the drive
        return {column} - {-1} | {i for child in self.children for i in child.acting_columns}

    @property
    def is_scheduled(self) -> bool:
        """Whether parameters depend on a value per record."""
        return any(child.is_scheduled for child in self.children)

    @property
    def n_start(self) -> int:
        """Number of start values of a record without rest: the sum over the parts."""
        return sum(child.n_start for child in self.children)

    @property
    def label(self) -> str:
        """Default name of a part: from its estimator, or from its own class."""
        kind = self.structure_of or type(self).__name__.removesuffix("Operator")
        return snake_case(kind if self.model is None else type(self.model).__name__)

    def estimator(self, **params):
        """Return the unfitted estimator that the operator belongs to.

        Parameters
        ----------
        **params : object
            Parameters in place of those of the estimator, such as ``dt``.

        Returns
        -------
        estimator
            Unfitted.

        Raises
        ------
        ValueError
            If a part has no estimator.
        """
        return clone(self.unfitted()).set_params(**params)

    def unfitted(self):
        """Return the estimator, with the tree's own parts, not clones."""
        if self.model is not None:
            return self.model.unfitted(self)
        if self.structure_of is None:
            raise ValueError(
                f"{type(self).__name__} does not say which estimator it belongs to: take it from "
                "the method 'tree' of one."
            )
        return self.estimator_class()(None).unfitted(self)

    @classmethod
    def estimator_class(cls):
        """Return the class of estimators whose structure is this node."""
        return getattr(import_module(_COMPOSE), cls.structure_of)

    def held_entries(self) -> frozenset[str]:
        """Return the names of the entries that the estimator holds constant."""
        return frozenset() if self.model is None else self.model.held_parameters()

    def free_mask(self) -> np.ndarray:
        """Mark the values of ``pack`` that are free: not held, and not fixed by the gauge."""
        held = self.held_entries()
        return np.array([not (s.held or name in held) for name, s in self.entries()], dtype=bool)

    def released(self):
        """Return a copy without estimators and without held entries."""
        return self if self.model is None else dataclasses.replace(self, model=None)

    # ------------------------------------------------------------------ its parts

    @property
    def moves_at_rest(self) -> bool:
        """Whether the output moves while the input rests, by default where that of a part does."""
        return any(child.moves_at_rest for child in self.children)

    def split(self):
        """Return the driven part, or None, and a tuple of the additive disturbances."""
        return (None, (self,)) if self.is_disturbance else (self, ())

    @property
    def disturbance_names(self) -> tuple[str, ...]:
        """Names of the additive disturbances."""
        return ()

    def inner(self, name=None):
        """Return the driven stage within this node.

        Parameters
        ----------
        name : str, default=None
            Name of this part.

        Returns
        -------
        Stage or None
            None if this part wraps no other.
        """
        return None

    def with_inner(self, stage, name=None):
        """Return the tree with another stage in place of the one of :meth:`inner`.

        Parameters
        ----------
        stage : Stage
            The other stage.
        name : str, default=None
            Name of the one that it replaces.

        Returns
        -------
        Operator
            A copy.
        """
        raise NotImplementedError

    def series(self, name=None):
        """Return the stages of a series; any other part is a single stage.

        Parameters
        ----------
        name : str, default=None
            Name of this part; None: its :attr:`label`.

        Returns
        -------
        list of Stage
            In the order of the series.
        """
        return [Stage(name or self.label, self)]

    def keys(self, name=None):
        """Return the keys of the values of the driven part.

        Parameters
        ----------
        name : str, default=None
            Name of this part; None: its :attr:`label`.

        Returns
        -------
        list of (str, str)
            Name of the stage and name of the entry, for each value.
        """
        return [(name or self.label, entry) for entry, _ in self.entries()]


class StartValues(Part):
    """Base of parts with an ``n_start``: records that begin without a rest, by some values."""

    def starts(self, u, y, dt):
        """Return candidates of the start values of a record, for a search to choose from.

        Parameters
        ----------
        u, y : ndarray of shape (n_samples,)
            Input and response.
        dt : float
            Sampling interval in s.

        Returns
        -------
        list of ndarray of shape (n_start,)
            Of an operator with ``n_start`` above 0.
        """
        raise NotImplementedError

    def by_start(self, u, dt: float, start) -> np.ndarray:
        """Return the derivatives of the output by the start values of a record.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Input.
        dt : float
            Sampling interval in s.
        start : array-like of shape (n_start,)
            Start values, of an operator without a state of rest.

        Returns
        -------
        ndarray of shape (n_samples, n_start)
        """
        raise NotImplementedError


class ScaledWithin(Part):
    """Base of parts with parameters that are ``scaled_within``, by a factor at each sample."""

    def scaled_init(self, u0, factor, initial_state="rest"):
        """Return the state of :meth:`scaled_run` before the first sample.

        Parameters
        ----------
        u0, factor : float
            Input and factor at the first sample.
        initial_state : {"rest", "zero"} or array-like of shape (n_start,), default="rest"
            As in ``init``.

        Returns
        -------
        object
        """
        raise NotImplementedError

    def scaled_run(self, u, factor, dt, state):
        """Return the output with the ``scaled_within`` parameters times a factor, and the state.

        Parameters
        ----------
        u, factor : ndarray of shape (n_samples,)
            Input, and the factor, not negative.
        dt : float
            Sampling interval in s.
        state : object
            As :meth:`scaled_init` and this method return it.

        Returns
        -------
        y : ndarray of shape (n_samples,)
        state : object
        """
        raise NotImplementedError

    def scaled_step(self, dt, state):
        """Return one step of :meth:`scaled_run`.

        Parameters
        ----------
        dt : float
            Sampling interval in s.
        state : object
            Before the first sample.

        Returns
        -------
        CompiledStep
            Of two inputs: that of the operator, and the factor.
        """
        raise NotImplementedError

    def scaled_sensitivities(self, u, du, factor, dfactor, dt, initial_state="rest"):
        """Return the output of :meth:`scaled_run` and its tangents.

        Parameters
        ----------
        u : ndarray of shape (n_samples,)
            Input.
        du : ndarray of shape (n_samples, m)
            Its tangents.
        factor : ndarray of shape (n_samples,)
            The factor.
        dfactor : ndarray of shape (n_samples, m + p)
            Its tangents, and its derivatives by p parameters of its own.
        dt : float
            Sampling interval in s.
        initial_state : {"rest", "zero"} or array-like of shape (n_start,), default="rest"
            As in ``init``.

        Returns
        -------
        y : ndarray of shape (n_samples,)
        dy : ndarray of shape (n_samples, m + n_parameters + p)
            As ``sensitivities`` returns them, then those by the parameters of the factor.
        """
        raise NotImplementedError

    def scaled_by_start(self, u, factor, dt, start):
        """Return the derivatives of the output by the start values of a record.

        Parameters
        ----------
        u, factor : ndarray of shape (n_samples,)
            Input, and the factor.
        dt : float
            Sampling interval in s.
        start : array-like of shape (n_start,)
            The values.

        Returns
        -------
        ndarray of shape (n_samples, n_start)
        """
        raise NotImplementedError
