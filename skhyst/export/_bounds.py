"""How often the loops of a step run at most, where its text tells: for the header of a program."""

import math

from ._expressions import Array, Assign, Call, Expression, For, Function
from ._slice import called

_LONG = 16  # turns from which a loop is reported


def longest_loops(part):
    """Return the largest number of turns of long loops, by the names of their functions.

    Loops over places of a table, and those whose end depends on a number without a bound, are left
    out. A loop within a loop is reported for each run of the outer one.
    """
    found, assigned = {}, {}

    def most(x, within=()):
        """Return an upper bound of a number, infinite if none is known."""
        if x.op == "name" and x.args[0] not in within:
            values, within = assigned.get(x.args[0], ()), (*within, x.args[0])
            return max((most(value, within) for value in values), default=math.inf)
        if x.op in ("min", "max", "cast", "math.ceil", "math.floor"):
            return (min if x.op == "min" else max)(most(arg, within) for arg in x.args)
        return math.inf if x.value is None else x.value

    def visit(x):
        if isinstance(x, Assign):
            assigned.setdefault(x.target, []).append(x.value)
        if isinstance(x, For) and x.step == 1:
            turns = most(x.stop) - (x.start.value or 0)
            if _LONG < turns < math.inf:
                name = part.function.name
                found[name] = max(found.get(name, 0), math.ceil(turns))
        if isinstance(x, Call) or (isinstance(x, Expression) and x.op == "call"):
            outs = () if isinstance(x, Expression) else [out for out in x.outs if out is not None]
            for name, turns in longest_loops(called(x, outs)).items():
                found[name] = max(found.get(name, 0), turns)
        for child in x if isinstance(x, tuple) else vars(x).values():
            is_part = hasattr(child, "__dict__") and not isinstance(child, Function | Array)
            if is_part or isinstance(child, tuple):
                visit(child)

    visit(part.body)
    return found
