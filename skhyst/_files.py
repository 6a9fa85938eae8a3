"""Files: what is read must be one, what is written takes its place whole or not at all, as text.

A file is written into a folder of its own beside its target, brought to the disk, and renamed,
which replaces a file in one step: a full disk or an interruption leaves the old one as it was.
"""

import os
import re
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

__all__ = ["check_input", "check_outputs", "printable", "replacing"]

# XML 1.0, 2.2 "Characters"; half of a surrogate pair is no text in UTF-8 either
_UNPRINTABLE = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def check_input(path):
    """Refuse what is no regular file, before it is opened: a named pipe would wait for ever."""
    if not path.exists():
        raise FileNotFoundError(f"There is no file {str(path)!r}.")
    if not path.is_file():
        raise OSError(f"{path} is a folder, a pipe or a device, a file was expected.")


def check_outputs(paths, inputs=(), *, force=False):
    """Find out, before anything is computed, whether all files can be written at no loss.

    Parameters
    ----------
    paths : sequence of Path
        Files to write; folders that are missing are made.
    inputs : sequence of Path
        What the same command reads: never written over.
    force : bool, default=False
        Whether other files that are there are written over.

    Raises
    ------
    OSError
        If one is an input, is named twice, is there already, is no regular file, or cannot be
        written.
    """
    for path in paths:  # first of all: in "new/../file" a name means nothing before
        with _telling(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            TemporaryDirectory(dir=path.parent).cleanup()
    for i, path in enumerate(paths):
        if any(_same(path, other.expanduser()) for other in inputs):
            raise FileExistsError(f"{path} is what is read: it is never written over.")
        if any(_same(path, other) for other in paths[:i]):
            raise FileExistsError(f"{path} is named for two outputs.")
        _check_target(path)
        if path.exists() and not force:
            raise FileExistsError(
                f"{path} is there already: add --force (in Python force=True) to write over it."
            )


def printable(text):
    """Return a text with a replacement character for what no XML and no UTF-8 file can hold."""
    return _UNPRINTABLE.sub("\ufffd", text)


@contextmanager
def replacing(*paths):
    """Yield where to write the files; they take their places when all are whole.

    Parameters
    ----------
    *paths : str or Path
        Files of one folder. Files that are there are replaced; their permissions are kept.

    Yields
    ------
    list of Path
        As the files are called, in a folder that is gone afterwards.

    Raises
    ------
    OSError
        If a path is a link or no regular file, or cannot be written.
    """
    paths = [Path(path) for path in paths]
    for path in paths:
        _check_target(path)
    with _telling(paths[0]), TemporaryDirectory(dir=paths[0].parent, prefix=".skhyst") as folder:
        written = [Path(folder, path.name) for path in paths]
        yield written
        for part, path in zip(written, paths, strict=True):
            with part.open("r+b") as file:
                os.fsync(file.fileno())
            with suppress(FileNotFoundError):
                part.chmod(path.stat().st_mode)
        for part, path in zip(written, paths, strict=True):
            os.replace(part, path)


def _same(path, other):
    there = path.exists() and other.exists()
    return path.samefile(other) if there else path.resolve() == other.resolve()


def _check_target(path):
    """Refuse to write through a link, over a folder, or into a pipe or a device."""
    if path.is_symlink():
        raise FileExistsError(f"{path} is a link to {path.readlink()}: name that file itself.")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder, a file was expected.")
    if path.exists() and not path.is_file():
        raise FileExistsError(f"{path} is a pipe or a device, a file was expected.")
    if path.exists() and not os.access(path, os.W_OK):  # a rename would not ask
        raise PermissionError(f"{path} is protected against writing.")


@contextmanager
def _telling(path):
    """Put what the system says, without its temporary names, into one sentence on the file."""
    try:
        yield
    except OSError as error:
        raise type(error)(f"{path} cannot be written: {error.strerror or error}.") from error
