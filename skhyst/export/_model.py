"""Puts the steps of a lowered model together as one function."""

from ._reader import read
from ._slice import sliced
from ._tree import Array, Call, Function, Return, constant, converted, leaves, variable
from ._values import signature


def model_step(lowered):
    """Return the step of a :class:`~skhyst.operators.Lowered` as a :class:`Slice`.

    Its arguments are the input, a number or an array, and the state.
    """
    n_inputs = lowered.n_inputs
    u = variable("u", "real") if n_inputs is None else Array("u", (n_inputs,))
    state = Array("s", (len(lowered.state),))
    body, kinds = [], {} if n_inputs else {"u": "real"}

    def binding(step, constants, places):
        own = Array("s", (len(places),), offset=constant(places[0] if len(places) else 0))
        given = tuple(_constant(c, k) for k, c in enumerate(constants))

        def called(u):
            function = read(step.py_func, *map(signature, (u, given, own)))
            name = f"y{len(body)}"
            kinds[name] = "real"
            args = zip(leaves((u, given, own)), function.params, strict=True)
            args = (x if isinstance(x, Array) else converted(x, p.kind) for x, p in args)
            body.append(Call(function, tuple(args), (name,)))
            return variable(name, "real")

        return called

    y = lowered.bound(range(len(lowered.state)), binding)(u)
    body.append(Return((y,)))
    params, writes = (u, state), frozenset({"s"})
    return sliced(Function("model", params, tuple(body), variable("", "real"), kinds, writes))


def _constant(value, k):
    if isinstance(value, float):
        return constant(value)
    return Array(f"c{k}", value.shape, tuple(value.ravel().tolist()))
