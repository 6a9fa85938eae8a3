"""Mutants of files: bytes flipped, cut, doubled or put in place of others."""

import io
import zipfile

__all__ = ["mutant"]

_INTEGERS = (0, 1, 2**7, 2**8 - 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**60, 2**63 - 1, 2**64 - 1)


def mutant(data, others, rng):
    """Return a changed copy of a file; an archive is changed inside, every other time."""
    if data[:2] == b"PK" and rng.random() < 0.5:
        try:
            return _inside(data, rng)
        except Exception:
            pass
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(data) + 1)
        length = rng.choice((1, 1, 2, 4, 8, 64))
        _EDITS[rng.randrange(len(_EDITS))](data, at, length, others, rng)
    return bytes(data)


def _flip(data, at, length, others, rng):
    for i in range(at, min(at + length, len(data))):
        data[i] ^= 1 << rng.randrange(8)


def _number(data, at, length, others, rng):
    size = rng.choice((2, 4, 8))
    value = rng.choice(_INTEGERS) % 2 ** (8 * size)
    data[at : at + size] = value.to_bytes(size, rng.choice(("little", "big")))


def _cut(data, at, length, others, rng):
    del data[at : at + length if rng.random() < 0.9 else len(data)]


def _double(data, at, length, others, rng):
    data[at:at] = data[at : at + length] * rng.choice((1, 1, 100))


def _put(data, at, length, others, rng):
    data[at:at] = rng.randbytes(length)


def _splice(data, at, length, others, rng):
    other = rng.choice(others)
    start = rng.randrange(len(other) + 1)
    data[at : at + length] = other[start : start + length]


_EDITS = (_flip, _flip, _number, _number, _cut, _double, _put, _splice)


def _inside(data, rng):
    """Change one member of an archive, which stays an archive."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(out, "w") as new:
        names = old.namelist()
        chosen = rng.choice(names)
        for name in names:
            content = old.read(name)
            new.writestr(name, mutant(content, [content], rng) if name == chosen else content)
    return out.getvalue()
