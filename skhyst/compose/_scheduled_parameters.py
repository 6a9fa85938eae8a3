"""Any model with parameters that depend on the record's amplitude, or on a column."""

from dataclasses import fields, replace
from numbers import Integral
from typing import Self

import numpy as np
from sklearn.base import clone

from .._sklearn import Interval
from .._validation import drive_column
from ..base import as_node, informed, refine, with_params
from ..exceptions import RecordError
from ..operators import Scheduled, split_disturbances
from ..optimize import RecordData
from ..records import record_names
from ._cascade import ROUGH
from ._columns import AroundModel, amplitude, is_constant

_LEAST = 1e-3  # least starting value of a positive parameter, relative to its constant value


class ScheduledParameters(AroundModel):
    r"""A model whose parameters are polynomials of the record's amplitude or of a column.

    .. math:: p_i(s) = \sum_{k=0}^{d} c_{ik} s^k

    with s the half range of the drive in a record, or the value of a column of X that is constant
    within each record (Xie et al. 2023, (22) to (26)). All coefficients are identified jointly from
    all records. They are searched as Bernstein coefficients over the range of s, so that a
    parameter keeps its bounds (nonnegative weights, positive time constants) everywhere in that
    range.

    Parameters
    ----------
    estimator : estimator
        A parametric model of skhyst, or a cascade of them; ScheduledParameters is the outermost
        model.
    by : str or int, default="amplitude"
        ``"amplitude"``, or the name or number of a column of X.
    degree : int, default=1
        Degree of the polynomials.
    parameters : list of str or None, default=None
        Names of the parameters that depend on the schedule, as in ``params_`` of the model;
        ``"weights"`` stands for all of ``"weights[0]"``, ... None: all free parameters.

    Attributes
    ----------
    operator_ : Scheduled
    polynomials_ : dict of str to ndarray of shape (degree + 1,)
        Coefficients by powers of the schedule, lowest first.
    schedule_ : ndarray of shape (n_records,)
        Schedule value of each record of the fit.
    params_, params_std_ : dict
        Bernstein coefficients ``name[k]`` and their standard errors: with degree 1 the parameter's
        values at the least and at the largest schedule.

    Raises
    ------
    RecordError
        If the column is not constant in each record.

    See Also
    --------
    Modulated : Scales the response, or some parameters, by a column that varies within a record.

    References
    ----------
    Xie et al., *Smart Materials and Structures*, 2023, (22) to (26).

    Examples
    --------
    >>> import numpy as np
    >>> from skhyst.compose import ScheduledParameters
    >>> from skhyst.hysteresis import PrandtlIshlinskii
    >>> from skhyst.records import stack_records
    >>> phase = np.linspace(0, 20, 400)
    >>> records = [(a * np.sin(phase), (1 + 0.1 * a) * a * np.sin(phase)) for a in (1.0, 2.0, 4.0)]
    >>> X, y = stack_records(records)
    >>> model = ScheduledParameters(PrandtlIshlinskii(thresholds=[0.0])).fit(X, y)
    >>> model.polynomials_["weights[0]"].round(3)
    array([1. , 0.1])
    """

    _parameter_constraints = {
        **AroundModel._parameter_constraints,
        "by": [str, Interval(Integral, 0, None, closed="left")],
        "degree": [Interval(Integral, 0, None, closed="left")],
        "parameters": ["array-like", None],
    }

    def __init__(
        self,
        estimator,
        *,
        by="amplitude",
        degree=1,
        parameters=None,
        initial_state=None,
        dt=None,
        drive=None,
        method="variable_projection",
    ):
        self.estimator = estimator
        self.by = by
        self.degree = degree
        self.parameters = parameters
        self.initial_state = initial_state
        self.dt = dt
        self.drive = drive
        self.method = method

    def operator_input(self, X, slices):
        return X[:, drive_column(self)], self._schedules(X, slices)

    def _schedules(self, X, slices):
        """Return the schedule of each record."""
        if self.by == "amplitude":
            return [amplitude(X[s.rows, drive_column(self)]) for s in slices]
        column = self._column(X.shape[1])
        schedules = []
        for s, name in zip(slices, record_names(slices), strict=True):
            values = X[s.rows, column]
            if not is_constant(values, np.abs(X[:, column]).max()):
                raise RecordError(
                    f"The column {self.by!r} of ScheduledParameters must be constant in each "
                    f"record. In record {name!r} it goes from {values.min():g} to "
                    f"{values.max():g}: cut the record where it changes, or let a Modulated scale "
                    "parameters by it sample by sample."
                )
            schedules.append(float(values.mean()))
        return schedules

    def _column(self, n_columns):
        names = list(getattr(self, "feature_names_in_", range(n_columns)))
        if isinstance(self.by, str):
            if self.by in names:
                return names.index(self.by)
        elif self.by < n_columns:
            return self.by
        raise ValueError(
            "The 'by' parameter of ScheduledParameters must be 'amplitude' or a column of X: "
            f"{', '.join(map(str, names))}. Got {self.by!r} instead."
        )

    def record_data(self, slices, X, y):
        self._check_estimator()
        data = super().record_data(slices, X, y)
        self.schedule_ = np.array([record.schedule for record in data])
        return data

    def starting_values(self, records):
        if any(record.schedule is None for record in records):
            raise ValueError(
                "ScheduledParameters must be the outermost model, or a term of a Sum: put the "
                "Cascade into it, and search effects of the model inside."
            )
        model = self._starting_model(informed(clone(self.estimator), self))
        plain = [RecordData(r.u, r.y, r.dt, r.segments, weights=r.weights) for r in records]
        result = model.identify(plain)
        if result.disturbances:
            raise ValueError(
                "ScheduledParameters takes a driven model: a disturbance has coefficients for "
                "each record already."
            )
        values, candidates = [r.schedule for r in records], []
        # if parameters differ between records, a fit with constant ones may choose a wrong form
        starts = map(split_disturbances, model.starting_values(plain))
        others = {_form(fit): fit for fit, _ in starts}
        others.pop(_form(result.operator), None)
        for fit in (result, *(refine(model, [start], plain) for start in others.values())):
            degrees = self._degrees(fit)
            scheduled = Scheduled.constant(fit.operator, degrees, min(values), max(values))
            candidates += [scheduled, _from_each_record(scheduled, records, plain, model)]
        return candidates

    def _degrees(self, result):
        """Return the degree of each value of the model's operator."""
        free = set(result.params)
        if not free:
            raise ValueError(
                f"The model of ScheduledParameters has no free parameter: {self.estimator!r}."
            )
        if self.parameters is not None:
            chosen = {n for n in free if n in self.parameters or n.split("[")[0] in self.parameters}
            known = chosen | {n.split("[")[0] for n in chosen}
            unknown = [name for name in self.parameters if name not in known]
            if unknown:
                raise ValueError(
                    "The 'parameters' of ScheduledParameters must be free parameters of the model: "
                    f"{', '.join(sorted(free))}. Got {', '.join(map(repr, unknown))} instead."
                )
            free = chosen
        return [self.degree if name in free else 0 for name, _ in result.operator.entries()]

    def subtree(self, driven, disturbances):
        base = self.estimator.subtree(driven.base, disturbances)
        return replace(driven.over(base), model=as_node(self, estimator=None))

    def unfitted(self, operator) -> Self:
        base, parameters = operator.base, self.parameters
        free = zip(base.entries(), base.free_mask(), operator.degrees, strict=True)
        if parameters is None and any(is_free and not degree for _, is_free, degree in free):
            rows = zip(base.entries(), operator.degrees, strict=True)
            parameters = [name for (name, _), degree in rows if degree]
        params = {
            "parameters": parameters,
            "degree": max(operator.degrees, default=0) or self.degree,
        }
        return with_params(self, estimator=base.unfitted(), **params)

    def adopt(self, result):
        super().adopt(result)
        self.polynomials_ = self.operator_.polynomials()
        return self


def _form(operator):
    """Return the fields of an operator that are strings or flags, such as the form of plays."""
    values = ((f.name, getattr(operator, f.name)) for f in fields(operator))
    return tuple((name, value) for name, value in values if type(value) in (bool, str))


def _from_each_record(scheduled, records, plain, model):
    """Return the operator whose polynomials best fit the parameters of single records."""
    fixed = model.held_parameters()
    start = [scheduled.base]
    alone = [refine(model, start, [record], ROUGH, with_errors=False) for record in plain]
    values = np.array([result.operator.pack() for result in alone])
    specs = [spec for _, spec in scheduled.entries()]
    coefficients, start = scheduled.pack(), 0
    for i, degree in enumerate(scheduled.degrees):
        rows = slice(start, start + degree + 1)
        design = np.array([scheduled.at(r.schedule)._basis[rows] for r in records])
        coefficients[rows] = np.linalg.lstsq(design, values[:, i], rcond=None)[0]
        start += degree + 1
    held = np.repeat([name in fixed for name, _ in scheduled.base.entries()], scheduled._counts)
    lower = [
        max(spec.lower, _LEAST * abs(value)) if spec.log else spec.lower
        for spec, value in zip(specs, scheduled.pack(), strict=True)
    ]
    coefficients = np.clip(coefficients, lower, [spec.upper for spec in specs])
    return scheduled.unpack(np.where(held, scheduled.pack(), coefficients))
