"""Compose the steps of a compiled model into one function."""

from ._expressions import Array, Call, Function, Return, constant, converted, leaves, variable
from ._reader import read
from ._slice import sliced
from ._values import signature


def model_step(compiled_step, with_numbers=False):
    """Return the step of a :class:`~skhyst.operators.CompiledStep` as a :class:`Slice`.

    See :func:`composed`.
    """
    return sliced(composed(compiled_step, with_numbers))


def composed(compiled_step, with_numbers=False):
    """Return the step of a :class:`~skhyst.operators.CompiledStep` as a :class:`Function`.

    Its arguments are the input, a number or an array, and the state. Constants are arguments of
    the functions of its parts, so that parts of one kind share a function; under ``with_numbers``
    each part has its own, without the branches that its constants exclude.
    """
    n_inputs = compiled_step.n_inputs
    u = variable("u", "real") if n_inputs is None else Array("u", (n_inputs,))
    state = Array("s", (len(compiled_step.state),))
    body, kinds = [], {} if n_inputs else {"u": "real"}

    def binding(step, constants, places):
        own = Array("s", (len(places),), offset=constant(places[0] if len(places) else 0))
        given = tuple(_constant(c, k) for k, c in enumerate(constants))

        def called(u):
            kinds_of = (signature(x, with_numbers) for x in (u, given, own))
            function = read(step.py_func, *kinds_of, with_numbers=with_numbers)
            name = f"y{len(body)}"
            kinds[name] = "real"
            args = zip(leaves((u, given, own)), function.params, strict=True)
            args = (x if isinstance(x, Array) else converted(x, p.kind) for x, p in args)
            body.append(Call(function, tuple(args), (name,)))
            return variable(name, "real")

        return called

    y = compiled_step.bound(range(len(compiled_step.state)), binding)(u)
    body.append(Return((y,)))
    params, writes = (u, state), frozenset({"s"})
    return Function("model", params, tuple(body), variable("", "real"), kinds, writes)


def _constant(value, k):
    if isinstance(value, float):
        return constant(value)
    return Array(f"c{k}", value.shape, tuple(value.ravel().tolist()))
