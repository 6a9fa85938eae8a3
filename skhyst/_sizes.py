"""Check of the sizes that a file declares against its own size, before anything is allocated."""

import io
from math import prod

import numpy as np

from .exceptions import RecordError

# Largest number of bytes per compressed byte in deflate, the only compression of .npz and .mat
# files and the usual one of others: a match of 258 bytes takes at least two bits.
# Source: "zlib Technical Details", https://zlib.net/zlib_tech.html
_DENSEST = 1032
# Size up to which any file may unpack: a quarter of the 1 GB that reading takes at most, since
# readings are copied up to three times on their way. Beyond that, a byte of the file may unpack to
# 64 in memory, as for a reading of 8 bytes stored in one bit: denser content is nearly all
# repetition.
_SPARED, _SPARSEST = 10**9 // 4, 64
_HEAD = 2**14  # bytes in which numpy finds a header of the longest size that it trusts


def largest_size(held):
    """Return the number of bytes that ``held`` bytes of a file may be expanded to."""
    return min(_DENSEST * held, max(_SPARED, _SPARSEST * held))


def check_size(what, declared, held):
    """Refuse data that declare more bytes than ``held`` bytes of a file may be expanded to."""
    if declared > largest_size(held):
        raise RecordError(f"{what} declares {declared} bytes, of which the file holds {held}")


def check_archive(archive, size):
    """Refuse a zip archive in a file of ``size`` bytes whose entries unpack to too many bytes.

    The declared sizes can be relied on: no more than that is read of an entry.
    """
    entries = archive.infolist()
    if sum(entry.compress_size for entry in entries) > size:
        raise RecordError("its entries overlap")
    for entry in entries:
        check_size(entry.filename, entry.file_size, entry.compress_size)
    check_size("it", sum(entry.file_size for entry in entries), size)


def check_array(stream, size):
    """Refuse an array in NumPy's format whose header declares more bytes than follow it.

    Parameters
    ----------
    stream : binary file
        At the beginning of the array.
    size : int
        Bytes of the array including its header.
    """
    head = io.BytesIO(stream.read(_HEAD))
    version = np.lib.format.read_magic(head)
    # the third version differs from the second in how names are written, not in sizes
    first = version == (1, 0)
    read = np.lib.format.read_array_header_1_0 if first else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(head)
    if dtype.hasobject:
        raise RecordError("it holds pickled Python objects, and unpickling can run code")
    declared = prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or not dtype.itemsize or declared > size - head.tell():
        raise RecordError(
            f"its header declares {shape} elements of {dtype.itemsize} bytes, but "
            f"{size - head.tell()} bytes follow"
        )


class Finite(io.BufferedReader):
    """A file whose ``read`` allocates no more than the file has left, for any requested size."""

    def __init__(self, path):
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size=-1):
        """Return ``size`` bytes, or as many as are left."""
        return super().read(min(size, max(self._size - self.tell(), 0)))
