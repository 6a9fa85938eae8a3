"""Files: checks before reading, and atomic writing.

A file is written into a temporary folder next to its target, flushed to the disk, and renamed,
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
    """Refuse irregular files before opening them: a named pipe would block for ever."""
    if not path.exists():
        raise FileNotFoundError(f"There is no file {str(path)!r}.")
    if not path.is_file():
        raise OSError(f"{path} is a folder, a pipe or a device, a file was expected.")


def check_outputs(paths, inputs=(), *, force=False):
    """Check, before anything is computed, that all files can be written without loss of others.

    Parameters
    ----------
    paths : sequence of Path
        Files to write; folders that are missing are made.
    inputs : sequence of Path
        Files that the same command reads: never overwritten.
    force : bool, default=False
        Whether other files that exist are overwritten.

    Raises
    ------
    OSError
        If one is an input, is named twice, exists already, is not a regular file, or cannot be
        written.
    """
    for path in paths:  # first of all: "new/../file" needs the folder "new"
        with errors_naming(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            TemporaryDirectory(dir=path.parent).cleanup()
    for i, path in enumerate(paths):
        if any(_same(path, other.expanduser()) for other in inputs):
            raise FileExistsError(f"{path} is an input: it is never overwritten.")
        if any(_same(path, other) for other in paths[:i]):
            raise FileExistsError(f"{path} is named for two outputs.")
        _check_target(path)
        if path.exists() and not force:
            raise FileExistsError(
                f"{path} exists already: add --force (in Python force=True) to overwrite it."
            )


def printable(text):
    """Return a text with a replacement character for each one not allowed in XML or UTF-8."""
    return _UNPRINTABLE.sub("\ufffd", text)


@contextmanager
def replacing(*paths):
    """Yield temporary paths to write to; the files replace their targets when all are complete.

    Parameters
    ----------
    *paths : str or Path
        Files of one folder. Files that exist are replaced; their permissions are kept.

    Yields
    ------
    list of Path
        With the names of the files, in a folder that is removed afterwards.

    Raises
    ------
    OSError
        If a path is a link or not a regular file, or cannot be written.
    """
    paths = [Path(path) for path in paths]
    for path in paths:
        _check_target(path)
    with (
        errors_naming(paths[0]),
        TemporaryDirectory(dir=paths[0].parent, prefix=".skhyst") as folder,
    ):
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
def errors_naming(path):
    """Raise errors of the system as one sentence on the file, without its temporary name."""
    try:
        yield
    except OSError as error:
        raise type(error)(f"{path} cannot be written: {error.strerror or error}.") from error
