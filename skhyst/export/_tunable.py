r"""Parameters that a program can change at run time, and the constants that depend on them.

Python computes the constants of a step from the parameters of its model, such as the matrices of a
mode from its frequency. A program needs this in plain arithmetic, so constants are identified as
functions of the parameters over their ranges: where a constant is a polynomial of at most second
degree, from its differences, and else, where it depends on one or two parameters, as a Chebyshev
series,

.. math:: c(x, y) = \sum_{a, b} c_{ab} \, T_a(x) \, T_b(y), \qquad T_n(\cos t) = \cos n t,

which for an analytic function converges geometrically with its degree (Trefethen,
*Approximation Theory and Approximation Practice*, 2013, theorem 8.2). Each is verified at
random parameters within the ranges.
"""

import copy
import re
from dataclasses import dataclass, field
from itertools import combinations
from numbers import Real

import numpy as np
from numpy.polynomial import chebyshev

from ..operators import ParameterSpec

_SAME = 1e-13  # error of a constant, relative to its largest value within the ranges
_N_CHECKED = 16  # random sets of parameters at which constants are verified
_DEGREES = (4, 8, 12, 16, 24, 32, 48)  # degrees of a series that are tried in this order
_PART = 0.5  # default range of a parameter to either side, as a fraction of its value


@dataclass(frozen=True)
class Entry:
    """A parameter of a model that can be changed at run time.

    Parameters
    ----------
    field, index : str, int or None
        Name of its field in the struct of parameters, and index in it; None: the field is a number.
    name : str
        Its name in Python.
    unit : str
    value, low, high : float
        Value of the fit, and the range.
    """

    field: str
    index: int | None
    name: str
    unit: str
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Derived:
    """Constants as functions of parameters.

    Parameters
    ----------
    entries : tuple of Entry
    places : dict of (int, int) to int
        Position of the first number of constant ``(part, number)`` among those that change.
    first : ndarray of shape (n_constants,)
        Their values for the parameters of the fit.
    quadratic : list of (int, list of (int, int, float))
        Position of a constant, and its terms: indices of two scaled parameters (-1 stands for the
        number one) and the factor of their product.
    series : list of (list of int, tuple of int, ndarray)
        Positions of constants, indices of the one or two parameters, coefficients (n_constants, n,
        m).
    """

    entries: tuple
    places: dict
    first: np.ndarray
    quadratic: list = field(repr=False)
    series: list = field(repr=False)

    def at(self, values):
        """Return the constants for other parameters (n_entries,)."""
        x = self.scaled(values)
        constants = self.first.copy()
        for k, terms in self.quadratic:
            constants[k] = sum(f * _factor(x, a) * _factor(x, b) for a, b, f in terms)
        for k, parameters, table in self.series:
            constants[k] = _evaluated(table, x[list(parameters)])
        return constants

    def scaled(self, values):
        """Return parameters as fractions of their ranges, from -1 to 1."""
        low, high = np.transpose([(e.low, e.high) for e in self.entries])
        return (np.asarray(values) - 0.5 * (low + high)) / (0.5 * (high - low))


def _factor(x, a):
    """Return a scaled parameter of a term, or the number one."""
    return 1.0 if a < 0 else x[a]


def _evaluated(table, x):
    """Return the sums (n_constants,) of Chebyshev series of one or two scaled parameters."""
    rows = [
        np.cos(np.arange(n) * np.arccos(np.clip(value, -1.0, 1.0)))
        for n, value in zip(table.shape[1:], x, strict=False)
    ]
    rows += [np.ones(1)] * (2 - len(rows))
    return np.einsum("kab,a,b->k", table, *rows)


def entries_of(model, tunable):
    """Return the entries that are named, and a function that returns a model with other values.

    Parameters
    ----------
    model : object
        With an ``operator_`` or a ``model_`` that has one, an operator, or a controller with
        numbers as attributes.
    tunable : sequence of str, or dict of str to (float, float)
        Names of parameters, such as ``"gain"`` or ``"plays__weights"``, with their ranges.

    Returns
    -------
    entries : tuple of Entry
    tuned : callable
        ``values (n_entries,) -> model``.
    """
    operator = _operator(model)
    if operator is None:
        numbers = {k: v for k, v in vars(model).items() if isinstance(v, Real)}
        numbers = {k: float(v) for k, v in numbers.items() if not isinstance(v, bool)}
        names, values = list(numbers), np.array([*numbers.values()])
        specs = [ParameterSpec()] * len(names)
    else:
        names, values = [name for name, _ in operator.entries()], operator.pack()
        specs = [spec for _, spec in operator.entries()]
    ranges = tunable if isinstance(tunable, dict) else dict.fromkeys(tunable)
    entries, places = [], []
    for wanted, range_ in ranges.items():
        matches = [k for k, name in enumerate(names) if _matches(name, wanted)]
        # a name that several stages share is ambiguous, and a parameter cannot be named twice
        if len({_whole(names[k]) for k in matches}) != 1 or set(matches) & set(places):
            raise ValueError(
                f"The 'tunable' parameter of to_c must be names of parameters, each of one of "
                f"{sorted({_whole(name) for name in names})}. Got {wanted!r} instead."
            )
        largest = np.abs(values[matches]).max()
        for k in matches:
            value = float(values[k])
            entries.append(_entry(names[k], specs[k], value, range_, largest, wanted))
        places += matches

    def tuned(values):
        # a constant of zero may be omitted from a step, which then has another structure
        values = np.where(np.equal(values, 0.0), np.finfo(float).tiny, values)
        if operator is None:
            other = copy.copy(model)
            for entry, value in zip(entries, values, strict=True):
                setattr(other, entry.name, float(value))
            return other
        vector = operator.pack()
        vector[places] = values
        return _with_operator(model, operator.unpack(vector))

    return tuple(entries), tuned


def _whole(name):
    """Return the name of the array that an entry belongs to, such as "weights" of "weights[2]"."""
    return name.partition("[")[0]


def _matches(name, wanted):
    """Whether an entry is the ``wanted`` parameter, or an element of it, in any stage."""
    return name == wanted or _whole(name) == wanted or _whole(name).endswith(f"__{wanted}")


def _entry(name, spec, value, range_, largest, wanted):
    """Return an entry with its range, by default half of its value on either side.

    The default for a zero in an array is half of its ``largest`` element. The range is cut off at
    the bounds of the parameter.
    """
    bounds = spec.lower, spec.upper
    if range_ is None:
        size = _PART * (abs(value) or largest)
        range_ = value - size, value + size
    low, high = max(float(range_[0]), bounds[0]), min(float(range_[1]), bounds[1])
    is_inside = low > bounds[0] if spec.log else low >= bounds[0]
    if not (is_inside and low < high and low <= value <= high < np.inf):
        size = abs(value) or 1.0
        example = max(value - _PART * size, bounds[0]), min(value + _PART * size, bounds[1])
        raise ValueError(
            f"The 'tunable' parameter of to_c must give {name!r} a range around its value "
            f"{value:g} and within its bounds {bounds}, as {{{name!r}: ({example[0]:g}, "
            f"{example[1]:g})}}. Got {range_!r} instead."
        )
    index = None if name == wanted else re.search(r"\[(\d+)\]$", name)
    legal = re.sub(r"\W+", "_", _whole(name) if index else name).strip("_")
    return Entry(legal, index and int(index[1]), name, spec.unit, value, low, high)


def _operator(model):
    """Return the operator with the parameters of a model, None if it has none."""
    if hasattr(model, "entries"):
        return model
    for name in ("operator_", "model_"):
        if hasattr(model, name):
            return _operator(getattr(model, name))
    return None


def _with_operator(model, operator):
    """Return a copy of a model with another operator."""
    if hasattr(model, "entries"):
        return operator
    name = "operator_" if hasattr(model, "operator_") else "model_"
    other = copy.copy(model)
    setattr(other, name, _with_operator(getattr(model, name), operator))
    return other


def derived(entries, step_for):
    """Return the constants that change with parameters, as functions of them.

    Parameters
    ----------
    entries : tuple of Entry
    step_for : callable
        ``values (n_entries,) -> CompiledStep``.

    Returns
    -------
    Derived

    Raises
    ------
    ValueError
        If the structure of the program changes with a parameter, or a constant is not a function
        as above.
    """
    low, high = np.transpose([(entry.low, entry.high) for entry in entries])
    first = step_for([entry.value for entry in entries])
    layout = [[np.shape(c) for c in part] for part in _constants(first)]

    def constants(x):
        parts = _constants(step_for(0.5 * (low + high) + 0.5 * (high - low) * np.asarray(x)))
        if [[np.shape(c) for c in part] for part in parts] != layout:
            names = ", ".join(entry.name for entry in entries)
            raise ValueError(
                f"The 'tunable' parameter of to_c must be parameters that change only numbers of "
                f"the program. Got {names} instead."
            )
        return _flat(parts)

    n = len(entries)
    # verified away from the points that determine the polynomials, at which they agree anyway
    checked = np.random.default_rng(0).uniform(-1.0, 1.0, (_N_CHECKED, n))
    expected = np.array([constants(x) for x in checked])
    ends = expected.min(axis=0), expected.max(axis=0)
    moved = np.subtract(ends[1], ends[0], where=ends[0] != ends[1], out=np.zeros(len(ends[0])))
    varying = np.flatnonzero(moved > 0.1 * _SAME * np.maximum(*np.abs(ends)))
    if not len(varying):
        names = ", ".join(entry.name for entry in entries)
        raise ValueError(
            "The 'tunable' parameter of to_c must be parameters that change the step of the model, "
            f"not only the state that it starts from. Got {names} instead."
        )
    places, positions = _places(layout, set(varying.tolist()))
    size = np.abs(expected[:, positions]).max(axis=0, initial=0.0)
    constants_of = lambda x: constants(x)[positions]  # noqa: E731
    expected = expected[:, positions]
    functions = Derived(entries, places, _flat(_constants(first))[positions], [], [])
    open_ = set(range(len(positions)))

    def verify(terms_of):
        """Keep the polynomials that are right at the parameters for verification."""
        for at in sorted(open_):
            terms = terms_of(at)
            values = [sum(f * _factor(x, a) * _factor(x, b) for a, b, f in terms) for x in checked]
            if np.abs(values - expected[:, at]).max() <= _SAME * (size[at] or 1.0):
                functions.quadratic.append((at, terms))
                open_.discard(at)

    # linear functions first: most constants are linear, and each pair of parameters takes one more
    # evaluation of the model
    middle = constants_of(np.zeros(n))
    one_by_one = np.array([[constants_of(s * np.eye(n)[i]) for s in (-1.0, 1.0)] for i in range(n)])
    slope = 0.5 * (one_by_one[:, 1] - one_by_one[:, 0])
    bend = 0.5 * (one_by_one[:, 1] + one_by_one[:, 0]) - middle
    verify(
        lambda at: _terms(
            size[at], [(-1, -1, middle[at])], [(i, -1, slope[i, at]) for i in range(n)]
        )
    )
    if open_:
        mixed = {
            (i, j): constants_of(np.eye(n)[i] + np.eye(n)[j])
            - middle
            - slope[i]
            - bend[i]
            - slope[j]
            - bend[j]
            for i, j in combinations(range(n), 2)
        }
        verify(
            lambda at: _terms(
                size[at],
                [(-1, -1, middle[at])],
                [(i, -1, slope[i, at]) for i in range(n)],
                [(i, i, bend[i, at]) for i in range(n)],
                [(i, j, value[at]) for (i, j), value in mixed.items()],
            )
        )
    if open_:
        _fit_series(functions, sorted(open_), constants_of, checked, expected, size)
    return functions


def _fit_series(functions, indices, constants_of, checked, expected, size):
    """Add series for the constants that are not polynomials, by the parameters they depend on."""
    n = len(functions.entries)
    depends = np.zeros((n, len(size)), dtype=bool)
    for x in checked[:4]:
        base = constants_of(x)
        for i in range(n):
            other = x.copy()
            other[i] = -x[i]
            depends[i] |= constants_of(other) != base
    groups = {}
    for at in indices:
        groups.setdefault(tuple(np.flatnonzero(depends[:, at]).tolist()), []).append(at)
    for parameters, group in groups.items():
        if len(parameters) > 2:
            names = ", ".join(functions.entries[i].name for i in parameters)
            raise ValueError(
                "The 'tunable' parameter of to_c must be parameters of which at most two determine "
                f"a constant of the program that is no polynomial of them. Got {names} instead."
            )
        scale = size[group] + (size[group] == 0.0)
        for degree in _DEGREES:
            table = _series(constants_of, n, parameters, degree)[group]
            approximation = np.array([_evaluated(table, x[list(parameters)]) for x in checked])
            if (np.abs(approximation - expected[:, group]).max(axis=0) <= _SAME * scale).all():
                break
        else:
            names = ", ".join(functions.entries[i].name for i in parameters)
            raise ValueError(
                "The 'tunable' parameter of to_c must be parameters on which constants depend "
                f"smoothly within their ranges. Got {names} instead: choose narrower ranges."
            )
        # coefficients that are only rounding are left out
        small = (np.abs(table) / scale[:, None, None]).max(axis=0) < 1e-16
        rows, columns = (np.flatnonzero(~small.all(axis=axis)) for axis in (1, 0))
        table = table[:, : rows.max(initial=0) + 1, : columns.max(initial=0) + 1]
        functions.series.append((group, parameters, table))


def _series(constants_of, n, parameters, degree):
    """Return the coefficients (n_constants, n, m) of series of one or two parameters.

    They are interpolated at the Chebyshev nodes, where the polynomials are orthogonal.
    """
    nodes = chebyshev.chebpts1(degree + 1)
    to_series = chebyshev.chebvander(nodes, degree).T * 2.0 / (degree + 1)
    to_series[0] *= 0.5
    values = []
    for index in np.ndindex(*(degree + 1,) * len(parameters)):
        x = np.zeros(n)
        x[list(parameters)] = nodes[list(index)]
        values.append(constants_of(x))
    values = np.moveaxis(np.reshape(values, (*(degree + 1,) * len(parameters), -1)), -1, 0)
    values = values if len(parameters) == 2 else values[:, :, None]
    table = np.einsum("pa,kab->kpb", to_series, values)
    return np.einsum("qb,kpb->kpq", to_series, table) if len(parameters) == 2 else table


def _terms(size, *lists):
    """Return the terms whose factors are more than rounding, at least one term."""
    small = 1e-16 * size
    terms = [(a, b, float(f)) for group in lists for a, b, f in group if abs(f) > small]
    return terms or [(-1, -1, 0.0)]


def _constants(compiled_step):
    """Return the constants of each part of a compiled step, in order of binding."""
    parts = []

    def binding(step, constants, s):
        parts.append(constants)
        return lambda u: 0.0

    compiled_step.bound(compiled_step.state.copy(), binding)
    return parts


def _flat(parts):
    return np.concatenate([np.empty(0), *(np.ravel(c) for part in parts for c in part)])


def _places(layout, varying):
    """Return where each constant that changes begins, and the positions of all their numbers.

    A constant changes as a whole: an array in which one number changes is kept with the others.
    """
    places, positions, begin = {}, [], 0
    for part, shapes in enumerate(layout):
        for k, shape in enumerate(shapes):
            size = int(np.prod(shape))
            range_ = range(begin, begin + size)
            if varying.intersection(range_):
                places[part, k] = len(positions)
                positions += range_
            begin += size
    return places, positions


def configuration(name, entries, functions, dialect, test_values):
    """Return the template values of the program's parameters.

    Parameters
    ----------
    name : str
        Prefix of all names.
    entries : tuple of Entry
    functions : Derived
    dialect : Dialect
    test_values : ndarray of shape (n_entries,)
        Parameters of the test.

    Returns
    -------
    dict of str to str
    """
    literal, n = dialect.literal, len(entries)
    fields = {}
    for entry in entries:
        fields.setdefault(entry.field, []).append(entry)
    # the fields of the struct in their order are the parameters p[0], p[1], ...
    places, declared = [], []
    for field_name, group in fields.items():
        ends = "; ".join(f"{e.low:.6g} to {e.high:.6g}" for e in group[:3])
        ellipsis = ", ..." if len(group) > 3 else ""
        unit = f"{group[0].unit}: " if group[0].unit else ""
        size = f"[{len(group)}]" if group[0].index is not None else ""
        declared.append(f"    {dialect.type} {field_name}{size}; /* {unit}{ends}{ellipsis} */\n")
        for k in range(len(group)):
            place = f"{field_name}[{k}]" if size else field_name
            places.append(place)

    def listed(values):
        """Return an initializer of the struct."""
        texts, remaining = [], list(values)
        for group in fields.values():
            part = ", ".join(literal(remaining.pop(0)) for _ in group)
            texts.append(part if group[0].index is None else f"{{{part}}}")
        return ", ".join(texts)

    # p holds the scaled parameters, then the number one, for terms with fewer than two parameters
    derive = [_polynomials(functions, dialect, n)] if functions.quadratic else []
    derive += [_series_text(name, dialect, *series) for series in functions.series]
    helper = _CHEBYSHEV.format(t=dialect.type, name=name, one=literal(1.0), two=literal(2.0))
    trials = []
    for place, entry in zip(places, entries, strict=True):
        low, high = map(dialect.number, (entry.low, entry.high))
        beyond = np.nextafter(low, -np.inf, dtype=low.dtype), np.nextafter(high, np.inf)
        tried = [(low, 0), (high, 0), (beyond[0], 1), (beyond[1], 1), (np.nan, 1)]
        trials += [
            f"        failed |= TRIED({place}, {literal(x)}, {wrong});\n" for x, wrong in tried
        ]
    return {
        "fields": "".join(declared),
        "n_constants": max(len(functions.first), 1),
        "constants": ", ".join(map(literal, functions.first)) or literal(0.0),
        "values": listed([e.value for e in entries]),
        "others": listed(test_values),
        "helpers": helper if functions.series else "",
        "n": n,
        "n_and_one": n + 1,
        "low": ", ".join(literal(e.low) for e in entries),
        "high": ", ".join(literal(e.high) for e in entries),
        "read": "".join(f"    p[{k}] = params->{place};\n" for k, place in enumerate(places)),
        "half": literal(0.5),
        "unity": literal(1.0),
        "derive": "".join(derive),
        "trials": "".join(trials),
    }


_CHEBYSHEV = """\
/* Chebyshev polynomials of degrees below n */
static void {name}_chebyshev({t} x, int32_t n, {t} *y)
{{
    int32_t i;
    for (i = 0; i < n; i++) {{
        y[i] = i == 0 ? {one} : i == 1 ? x : {two} * x * y[i - 1] - y[i - 2];
    }}
}}

"""


def _table(kind, name, values):
    """Return the declaration in C of a constant array."""
    return (
        f"        static const {kind} {name}[{len(values)}] = {{{', '.join(map(str, values))}}};\n"
    )


def _polynomials(functions, dialect, n):
    """Return the statements that compute constants which are polynomials."""
    rows = [
        (at, a if a >= 0 else n, b if b >= 0 else n, f)
        for at, t in functions.quadratic
        for a, b, f in t
    ]
    at, a, b, f = zip(*rows, strict=True)
    return (
        "    {\n"
        + _table("uint16_t", "at", at)
        + _table("uint16_t", "a", a)
        + _table("uint16_t", "b", b)
        + _table(dialect.type, "factor", [dialect.literal(x) for x in f])
        + f"        for (i = 0; i < {len(rows)}; i++) {{\n"
        "            if (i == 0 || at[i] != at[i - 1]) {\n"
        f"                state->k[at[i]] = {dialect.literal(0.0)};\n            }}\n"
        "            state->k[at[i]] += factor[i] * p[a[i]] * p[b[i]];\n        }\n    }\n"
    )


def _series_text(name, dialect, constants, parameters, table):
    """Return the statements that compute constants which are series."""
    _, n, m = table.shape
    first, second = parameters[0], parameters[-1]
    return (
        "    {\n"
        + _table("uint16_t", "at", constants)
        + _table(dialect.type, "series", [dialect.literal(x) for x in table.ravel()])
        + f"        {dialect.type} x[{n}];\n        {dialect.type} y[{m}];\n"
        "        int32_t j;\n        int32_t l;\n"
        f"        {name}_chebyshev(p[{first}], {n}, x);\n"
        f"        {name}_chebyshev(p[{second}], {m}, y);\n"
        f"        for (i = 0; i < {len(constants)}; i++) {{\n"
        f"            {dialect.type} sum = {dialect.literal(0.0)};\n"
        f"            for (j = 0; j < {n}; j++) {{\n                for (l = 0; l < {m}; l++) {{\n"
        f"                    sum += series[(i * {n} + j) * {m} + l] * x[j] * y[l];\n"
        "                }\n            }\n            state->k[at[i]] = sum;\n        }\n    }\n"
    )
