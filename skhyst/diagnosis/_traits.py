"""What the search asks of an operator beyond the protocol.

The operator of a model may have each of these by its name, ``presliding_displacement`` as an
attribute and the others as methods; one that does not has the default. Of a tree it is that of its
leaves.
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


def characteristics(operator, seen):
    """Return what characterises a part beyond its parameters, as an engineer counts it.

    Parameters
    ----------
    operator : Operator
        A leaf, or what wraps one; several in a tree have none together.
    seen : object
        What has come in and out, in lists of one array a record: ``inputs`` and ``outputs``;
        ``dts``, intervals in s; ``ends``, the smallest and the largest input; ``rates``, absolute
        rates of the input, (n,); of a disturbance ``coefficients``, (n_records, n_coefficients).

    Returns
    -------
    dict of str to (float or array-like, str)
        Value or values, NaN for one that is not there, and the unit, see
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
