"""Compose the steps of a compiled model into one function."""

import math

from ._expressions import (
    Array,
    Call,
    Expression,
    Function,
    If,
    Return,
    Store,
    arithmetic,
    compared,
    constant,
    converted,
    leaves,
    variable,
)
from ._reader import read
from ._slice import sliced
from ._values import signature


def model_step(compiled_step, with_numbers=False, tuned=None, rules=None):
    """Return the step of a :class:`~skhyst.operators.CompiledStep` as a :class:`Slice`.

    See :func:`composed`.
    """
    return sliced(composed(compiled_step, with_numbers, tuned, rules))


def composed(compiled_step, with_numbers=False, tuned=None, rules=None):
    """Return the step of a :class:`~skhyst.operators.CompiledStep` as a :class:`Function`.

    Its arguments are the input, a number or an array, and the state. Constants are arguments of the
    functions of its parts, so that parts of one kind share a function; under ``with_numbers`` each
    part has its own, without the branches that its constants exclude. Else, in floating point, the
    result is infinite where the input of a part is not finite, as in
    :meth:`~skhyst.operators.Stepper.step`. Constants that change at run time are elements of a
    third argument, at the places that ``tuned`` gives, see :class:`Derived`. With ``rules`` the
    function puts the state to rest, see :class:`Rule`.
    """
    n_inputs = compiled_step.n_inputs
    u = variable("u", "real") if n_inputs is None else Array("u", (n_inputs,))
    state = Array("s", (len(compiled_step.state),))
    body, kinds = [], {} if n_inputs else {"u": "real"}
    places_of_tuned = {} if tuned is None else tuned.places
    parts = []

    def binding(step, constants, places):
        part = len(parts)
        parts.append(step)
        states = Array("s", (len(places),), offset=constant(places[0] if len(places) else 0))
        part_constants = tuple(
            _tuned(c, places_of_tuned[part, k]) if (part, k) in places_of_tuned else _constant(c, k)
            for k, c in enumerate(constants)
        )

        def rest_part(u):
            """Write statements that put the part to rest, or to where a step to rest begins."""
            rule = rules[part]
            slope = [None] * len(places) if rule.slope is None else rule.slope
            for k, (first, by_u) in enumerate(zip(rule.first, slope, strict=True)):
                body.append(
                    Store(states, states.at([constant(k)]).args[1], _affine(first, by_u, u))
                )

        def called(u):
            if rules is not None:
                rest_part(u)
            elif not with_numbers:
                body.extend(map(_unless_finite, filter(_is_computed, leaves(u))))
            kinds_of = (signature(x, with_numbers) for x in (u, part_constants, states))
            function = read(step.py_func, *kinds_of, with_numbers=with_numbers)
            name = f"y{len(body)}"
            kinds[name] = "real"
            args = zip(leaves((u, part_constants, states)), function.params, strict=True)
            args = (x if isinstance(x, Array) else converted(x, p.kind) for x, p in args)
            body.append(Call(function, tuple(args), (name,)))
            # a step at rest moves an affine state by rounding, which is undone
            if rules is not None and rules[part].slope is not None:
                rest_part(u)
            return variable(name, "real")

        return called

    # the indices of the state are bound in place of its numbers: each part gets its own indices
    y = compiled_step.bound(range(len(compiled_step.state)), binding)(u)
    body.append(Return((y,)))
    params, writes = (u, state), frozenset({"s"})
    if tuned is not None:
        params = (*params, Array("k", (len(tuned.first),)))
    name = "model" if rules is None else "rest"
    return Function(name, params, tuple(body), variable("", "real"), kinds, writes)


def _is_computed(x):
    """Whether a number is not the input itself, which is finite."""
    return isinstance(x, Expression) and x.op not in ("const", "load") and x.args != ("u",)


def _unless_finite(x):
    """Return the statement that ends the step with infinity where a number is not finite."""
    is_finite = compared("<", Expression("math.fabs", (x,), "real"), constant(math.inf))
    return If(is_finite, (), (Return((constant(math.inf),)),))


def _affine(first, slope, u):
    """Return ``first + slope u`` as an expression."""
    if not slope:
        return constant(float(first))
    product = arithmetic("*", constant(float(slope)), u)
    return arithmetic("+", constant(float(first)), product) if first else product


def _tuned(value, place):
    """Return a constant that changes at run time, as an element or a part of the array ``k``."""
    if isinstance(value, float):
        return Expression("load", (Array("k", ()), constant(place)), "real")
    return Array("k", value.shape, offset=constant(place))


def _constant(value, k):
    """Return a constant with its numbers, named after its place among those of the part."""
    if isinstance(value, float):
        return constant(value)
    return Array(f"c{k}", value.shape, tuple(value.ravel().tolist()))
