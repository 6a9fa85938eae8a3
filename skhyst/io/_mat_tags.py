"""Validate the structure of a MATLAB file of version 5 before it is parsed.

Such a file is a header of 128 bytes and a sequence of variables. A variable, compressed or not, is
a sequence of elements: a tag with a type code and a length, the data, and padding to 8 bytes; up to
4 bytes of data fit into the tag itself. Cells and structs contain variables in turn. scipy (1.15
and 1.17) looks type codes up without a check, so that a wrong one crashes the interpreter.

Source: MathWorks, "MAT-File Format", version 5 and later; classes 16 and 17 as scipy reads them.
"""

import struct
import zlib
from dataclasses import dataclass
from math import prod

from .._sizes import largest_size
from ..exceptions import RecordError

_HEADER = 128  # bytes
_DEEPEST = 64  # nesting of variables
_BLANK = 2**20  # elements that may have no data in the file: blanks, structs without fields
_INT32, _UINT32, _MATRIX, _COMPRESSED = 5, 6, 14, 15
_INTEGERS = {_INT32, _UINT32}
_NAMES = {1, 16}  # int8, UTF-8
_NUMBERS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18}  # codes of numbers and of characters
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE, _FUNCTION, _OPAQUE = 1, 2, 3, 4, 5, 16, 17
_NUMERIC = range(6, 16)


def check_tags(data):
    """Raise a RecordError unless every element of a file of version 5 is of the type expected."""
    order = "<" if data[126:128] == b"IM" else ">"
    file, remaining = _Elements(memoryview(data), order, _HEADER), largest_size(len(data))
    while file.position < len(data):
        start = file.position
        code, content = file.element()
        if code == _COMPRESSED:
            content = _inflated(content, start, remaining)
            remaining -= len(content)
            code, content = _Elements(content, order).element()
        if code != _MATRIX or not content:
            raise RecordError(f"at byte {start} is not a variable (type code {code})")
        try:
            _Elements(content, order).variable()
        except RecordError as error:
            raise RecordError(f"in the variable at byte {start} {error}") from None


def _inflated(content, start, longest):
    """Return a decompressed variable; all variables together have at most the allowed size."""
    inflater = zlib.decompressobj()
    try:
        inflated = inflater.decompress(content, max(longest, 1))  # 0 would be no limit
    except zlib.error as error:
        raise RecordError(f"the variable at byte {start} cannot be decompressed") from error
    if not inflater.eof:
        raise RecordError(f"the compressed variable at byte {start} is cut or too long")
    return memoryview(inflated)


@dataclass
class _Elements:
    """Elements of a variable, or of the file, one after another; ``order`` is "<" or ">"."""

    data: memoryview
    order: str
    position: int = 0

    def element(self):
        """Return the type code and the content of a variable."""
        code, length = self.unpack("II", self.take(8))
        return code, self.take(length)

    def take(self, length):
        """Return the next bytes."""
        start, self.position = self.position, self.position + length
        if self.position > len(self.data):
            raise RecordError(f"an element reaches past the end (byte {self.position})")
        return self.data[start : self.position]

    def unpack(self, layout, data):
        """Return the integers in ``data``."""
        return struct.unpack(self.order + layout, data)

    def part(self, codes):
        """Return the data of an element other than a variable; its type must be in ``codes``."""
        start = self.position
        tag = self.take(8)
        code, length = self.unpack("II", tag)
        if code >> 16:  # the data lie in the tag
            code, length = code & 0xFFFF, code >> 16
            if length > 4:
                raise RecordError(f"an element in its tag has {length} bytes (byte {start})")
            data = tag[4 : 4 + length]
        else:
            data = self.take(length)
            self.position += -length % 8
        if code not in codes:
            raise RecordError(f"an element has the unknown type code {code} (byte {start})")
        return data

    def integers(self):
        """Return an element of non-negative integers."""
        data = self.part(_INTEGERS)
        values = self.unpack(f"{len(data) // 4}i", data[: len(data) // 4 * 4])
        if not values or min(values) < 0:
            raise RecordError(f"a size is missing or negative (byte {self.position})")
        return values

    def variable(self, depth=0):
        """Check the parts of a variable, after its tag."""
        if depth > _DEEPEST:
            raise RecordError(f"more than {_DEEPEST} variables lie inside one another")
        start = self.position
        code, length, flags, _ = self.unpack("IIII", self.take(16))
        if (code, length) != (_UINT32, 8):
            raise RecordError(f"there are no array flags (byte {start})")
        kind, is_complex = flags & 0xFF, flags >> 11 & 1
        if kind == _OPAQUE:
            for _ in range(3):  # name, type system, class
                self.part(_NAMES)
            self.variables(1, depth)
            return
        size = prod(self.integers())
        self.part(_NAMES)
        if kind in _NUMERIC or kind == _SPARSE:
            for _ in range(is_complex + (3 if kind == _SPARSE else 1)):  # rows, columns, values
                self.part(_NUMBERS)
        elif kind == _CHAR:
            if not self.part(_NUMBERS) and size > _BLANK:
                raise RecordError(f"{size} characters have no data")
        elif kind == _CELL:
            self.variables(size, depth)
        elif kind in (_STRUCT, _OBJECT):
            if kind == _OBJECT:
                self.part(_NAMES)
            self.variables(size * self.fields(size), depth)
        elif kind == _FUNCTION:
            self.variables(1, depth)
        else:
            raise RecordError(f"an array has the unknown class {kind} (byte {start})")

    def fields(self, size):
        """Return the number of fields of a struct array with ``size`` elements."""
        (length, *_) = self.integers()
        names = self.part(_NAMES)
        if not length:
            raise RecordError("the names of fields have no length")
        if len(names) < length and size > _BLANK:
            raise RecordError(f"{size} structs have no fields")
        return len(names) // length

    def variables(self, count, depth):
        """Check the variables of a cell or a struct."""
        for _ in range(count):
            start = self.position
            code, length = self.unpack("II", self.take(8))
            if code != _MATRIX or length > len(self.data) - self.position:
                raise RecordError(f"a cell or field is not a variable (byte {start})")
            if length:
                self.variable(depth + 1)
