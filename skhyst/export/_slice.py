"""Remove dead code: keep the statements of a function that its caller needs.

A statement is removed if no result that is used, and no array, depends on it. Laws return their
derivatives with the response, and a caller that does not use them should not compute them. The live
variables are followed backwards through the statements, through loops until their set no longer
grows, and into the functions that are called.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

from ._expressions import (
    Assign,
    Call,
    Expression,
    For,
    Function,
    If,
    Jump,
    Listed,
    Return,
    Store,
    While,
    mentioned,
)


@dataclass(frozen=True, eq=False)
class Slice:
    """A function without dead code; one per function and mask, compared by identity.

    Parameters
    ----------
    function : Function
    mask : tuple of bool
        The results that are used.
    body : tuple of statements
    taken : tuple of bool
        The arguments that are used.
    """

    function: Function
    mask: tuple
    body: tuple
    taken: tuple

    def args(self, args):
        """Return those of the arguments that are used."""
        return [arg for arg, taken in zip(args, self.taken, strict=True) if taken]


@lru_cache(maxsize=4096)
def sliced(function, mask=(True,)):
    """Return the :class:`Slice` of a function for the results that are used."""
    body, live = _block(function.body, frozenset(), (mask, None, None))
    names = (p.args[0] if isinstance(p, Expression) else p.name for p in function.params)
    return Slice(function, mask, body, tuple(name in live for name in names))


def called(call, live=()):
    """Return the slice of the function that is called, by an expression or a statement."""
    if isinstance(call, Expression):
        return sliced(call.args[0])
    return sliced(call.function, tuple(out is not None and out in live for out in call.outs))


def needs(*values):
    """Return the variables that values depend on."""
    return frozenset().union(*(mentioned(x, used_args) for x in values))


def used_args(call):
    """Return the arguments of a call that are used."""
    return called(call).args(call.args[1:])


def within(body):
    """Yield all statements, those inside others too."""
    for statement in body:
        yield statement
        for part in ("body", "orelse"):
            yield from within(getattr(statement, part, ()))


def _block(body, live, ends):
    """Return statements without dead code, and the variables that are live before them.

    ``live`` are the variables live after them; ``ends`` are the mask of the results that are used,
    and the variables that are live at ``break`` and at ``continue``.
    """
    kept = []
    for statement in reversed(body):
        statement, live = _statement(statement, live, ends)
        if statement is not None:
            kept.append(statement)
    return tuple(reversed(kept)), live


def _statement(statement, live, ends):
    mask, at_break, at_continue = ends
    match statement:
        case Assign(target, value):
            if target not in live:
                return None, live
            return statement, live - {target} | needs(value)
        case Store(array, place, value):
            return statement, live | needs(array, place, value)
        case Listed(array, values):
            if array.name not in live:
                return None, live
            return statement, live | needs(*values)
        case Call(function, args, outs):
            part = called(statement, live)
            if not any(part.mask) and not function.writes:
                return None, live
            kept = tuple(out if used else None for out, used in zip(outs, part.mask, strict=True))
            return replace(statement, outs=kept), live - {*kept} | needs(*part.args(args))
        case Return(values):
            values = tuple(x for x, used in zip(values, mask, strict=True) if used)
            return Return(values), needs(*values)
        case Jump(word):
            return statement, at_break if word == "break" else at_continue
        case If(test, body, orelse):
            body, first = _block(body, live, ends)
            orelse, second = _block(orelse, live, ends)
            if not body and not orelse:
                return None, live
            return If(test, body, orelse), first | second | needs(test)
    return _loop(statement, live, mask)


def _loop(loop, live, mask):
    head = live | (needs(loop.test) if isinstance(loop, While) else frozenset())
    while True:
        body, first = _block(loop.body, head, (mask, live, head))
        if first <= head:
            break
        head |= first
    if all(isinstance(statement, (If, Jump)) for statement in within(body)):
        return None, live
    loop = replace(loop, body=body, carried=first)
    if isinstance(loop, For):
        head = head - {loop.target} | needs(loop.start, loop.stop)
    return loop, head
