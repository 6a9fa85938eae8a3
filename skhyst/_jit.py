"""One decorator for compiled loops.

Kernels compile on first use and release the GIL. The machine code is cached next to the source
where that folder, or ``NUMBA_CACHE_DIR``, can be written; elsewhere the kernel is compiled once per
process instead, since a plain ``cache=True`` raises at import in a read-only install without a
home folder. A cached kernel that cannot be read is compiled and written again: a damaged file, one
of another layout, one that names a missing module. So is a kernel that calls a function or uses a
constant from another file that has changed, as after an upgrade. Without Numba the same function
runs as plain Python: slow, but with equal results.
"""

import pickle
from contextlib import suppress
from functools import cache, partial
from hashlib import sha256
from types import CodeType, FunctionType

import numpy as np


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
    options["no_cfunc_wrapper"] = True  # one that C calls, which takes long to compile
    if not allocates:
        options["_nrt"] = False
    compiled = numba.njit(**options)(function)
    if compiled is not function:  # as it is where NUMBA_DISABLE_JIT is set
        with suppress(RuntimeError):  # no folder to cache in
            compiled._cache = _cache_class()(function)
    return compiled


@cache
def _cache_class():
    """Return a class of Numba's cache of a function that only uses complete files.

    Numba's own raises if a file is damaged, and detects changes only in the file of the function,
    not in functions compiled into it from elsewhere. If two processes start at once, each with its
    own signature, one may get the code of the other: so the code is stored with its key, and with a
    digest, since damaged machine code may crash the interpreter.
    """
    from numba.core.caching import FunctionCache, IndexDataCacheFile

    class WholeFile(IndexDataCacheFile):
        def save(self, key, data):
            code = self._dump(data)
            super().save(key, (key, sha256(code).digest(), code))

        def load(self, key):
            stored_key, digest, code = super().load(key)  # of None without one, which is an error
            if stored_key != key or digest != sha256(code).digest():
                raise ValueError("damaged, or of another signature")
            return pickle.loads(code)

        def _load_index(self):
            try:
                return dict(super()._load_index())
            except Exception:  # damaged files raise exceptions of any type
                return {}

    class WholeCache(FunctionCache):
        def __init__(self, function):
            super().__init__(function)
            base, stamp = self._impl.filename_base, self._impl.locator.get_source_stamp()
            self._cache_file = WholeFile(self._cache_path, base, stamp)

        def _index_key(self, signature, codegen):
            return *super()._index_key(signature, codegen), _digest(self._py_func)

        def load_overload(self, signature, context):
            with suppress(Exception):
                return super().load_overload(signature, context)

        def save_overload(self, signature, code):
            with suppress(OSError):  # such as a full disk
                super().save_overload(signature, code)

    return WholeCache


def _digest(function):
    """Return a digest of the code and the constants of a function and of all that it calls."""
    seen, pending, parts = set(), [function], []
    while pending:
        item = pending.pop()
        item = getattr(item, "py_func", item)
        if isinstance(item, FunctionType):
            if item in seen:
                continue
            seen.add(item)
            codes = [item.__code__]
            for code in codes:
                parts += [code.co_code, *(c for c in code.co_consts if not isinstance(c, CodeType))]
                codes += [c for c in code.co_consts if isinstance(c, CodeType)]
                pending += [item.__globals__.get(name) for name in code.co_names]
            pending += [cell.cell_contents for cell in item.__closure__ or ()]
        elif isinstance(item, np.ndarray):
            parts += [item.dtype, item.shape, item.tobytes()]
        elif isinstance(item, tuple):
            pending += item
        elif isinstance(item, (bool, int, float, complex, str, np.generic)):
            parts.append(item)
    return sha256(repr(parts).encode()).hexdigest()


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
