"""One decorator for compiled loops.

Kernels compile on first use and release the GIL. The machine code is cached next to the source
where that folder, or ``NUMBA_CACHE_DIR``, can be written; elsewhere the kernel is compiled once per
process instead, since a plain ``cache=True`` raises at import in a read-only install without a
home folder. Without Numba the same function runs as plain Python: slow, but with equal results.
"""

from functools import partial
from types import FunctionType


def jit(function=None, *, fastmath=False, inline=False, allocates=True):
    """Compile a kernel lazily, without the GIL, cached where that is possible.

    Parameters
    ----------
    function : callable
        A loop over arrays and scalars, written in the subset of Python that Numba compiles.
    fastmath : bool or set of str, default=False
        Reordering of floating-point operations that the compiler may do, as in ``numba.njit``.
    inline : bool, default=False
        The body replaces every call in compiled code, however long it is, so that results that a
        caller does not use are not computed.
    allocates : bool, default=True
        False: it creates no arrays, and references to those it is given are not counted, which
        can take longer than a sample.

    Returns
    -------
    callable
        The compiled function; its plain Python original is the attribute ``py_func``.
    """
    if function is None:
        return partial(jit, fastmath=fastmath, inline=inline, allocates=allocates)
    try:
        import numba
    except ImportError:
        function.py_func = function
        return function
    options = {"nogil": True, "error_model": "numpy", "fastmath": fastmath, "forceinline": inline}
    if not allocates:
        options["_nrt"] = False
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder to cache in
        return numba.njit(**options)(function)


def bind(loop, law, **options):
    """Compile a copy of a loop whose global name ``step`` is the compiled ``law``.

    The compiler sees one plain loop without calls through pointers, and the machine code is cached
    with the file of the law, as if the loop had been written there. Options are those of
    :func:`jit`.
    """
    place = law.__code__
    code = loop.__code__.replace(co_filename=place.co_filename, co_firstlineno=place.co_firstlineno)
    bound = FunctionType(code, {**loop.__globals__, "step": law})
    bound.__module__, bound.__wrapped__ = law.__module__, loop
    bound.__name__ = bound.__qualname__ = f"{law.__name__}_{loop.__name__}"
    return jit(bound, **options)
