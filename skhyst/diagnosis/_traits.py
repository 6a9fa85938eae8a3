"""Optional members of an operator, beyond the protocol, that only the search reads.

The operator of a model may have each of these by its name, ``presliding_displacement`` as an
attribute and the others as methods; without it the default applies. For a tree, its leaves are
asked.
"""


def n_ringing(operator):
    """Return the number of pairs of poles that overshoot, by default 0."""
    return sum(part.n_ringing() for part in _with("n_ringing", operator))


def lag_rates(operator):
    """Return the rates (rad/s) of the first-order lags among the poles, by default none."""
    return [rate for part in _with("lag_rates", operator) for rate in part.lag_rates()]


def presliding_displacement(operator):
    """Return the displacement over which friction builds up (units of the drive), or None."""
    parts = _with("presliding_displacement", operator)
    found = (part.presliding_displacement for part in parts)
    return next((displacement for displacement in found if displacement is not None), None)


def elastic_and_memory(operator):
    """Return the gain of what passes a hysteresis at once and the operator without, or None."""
    if not hasattr(operator, "elastic_and_memory"):
        return None
    return operator.elastic_and_memory()


def characteristics(operator, seen):
    """Return characteristics of a part in addition to its parameters, such as engineers use.

    Parameters
    ----------
    operator : Operator
        A leaf, or one wrapped in nodes with a single child; a tree with several leaves has none.
    seen : object
        Inputs and outputs, as lists of one array per record: ``inputs`` and ``outputs``; ``dts``,
        intervals in s; ``ends``, the smallest and the largest input; ``rates``, absolute rates of
        the input, (n,); of a disturbance ``coefficients``, (n_records, n_coefficients).

    Returns
    -------
    dict of str to (float or array-like, str)
        Value or values, NaN for an undefined one, and the unit, see
        :class:`~skhyst.operators.ParameterSpec`; by default empty.
    """
    while len(operator.children) == 1:
        [operator] = operator.children
    own = _with("characteristics", operator) if not operator.children else ()
    return {} if not own else own[0].characteristics(seen)


def _with(name, operator):
    """Return the leaves of a tree that have an attribute."""
    if operator.children:
        return [part for child in operator.children for part in _with(name, child)]
    return [operator] if hasattr(operator, name) else []
