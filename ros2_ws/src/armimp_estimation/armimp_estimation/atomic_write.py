"""Writing files so that nobody sees them half written, and reading regular files only."""

import errno
import os
import stat
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from armimp_common.errors import DataError

_NEVER_SPARSE: Final = 64 << 20
"""Size up to which a file is read even if it is sparse, bytes."""
_SPARSEST: Final = 20
"""Largest ratio of the size of a larger file to the bytes that its blocks hold."""


def write_atomically(path: Path, write: Callable[[Path], object], *, anew: bool = False) -> None:
    """Write a file in a new directory beside it, to which only this user has access, then move it.

    If writing fails, an existing file at `path` stays as it is.

    Parameters
    ----------
    path : Path
    write : callable
        Writes the file at the path that it is given, which has the same name.
    anew : bool
        Whether to replace an existing file.

    Raises
    ------
    DataError
        If the file cannot be written, or exists already and `anew` is false.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".", dir=path.parent) as work:
            part = Path(work) / path.name
            write(part)
            if anew:
                part.replace(path)
            else:
                _name(part, path)
    except FileExistsError:
        raise DataError(f"{path}: exists already") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {reason_of(error)}") from error


def _name(part: Path, path: Path) -> None:
    """Give a file the name that it is to have, unless another has it."""
    try:
        path.hardlink_to(part)  # fails if the name is taken; renaming would replace the other file
    except OSError:
        if os.path.lexists(path):
            raise FileExistsError from None
        part.replace(path)  # this file system has no links


def reason_of(error: OSError) -> object:
    """Return in a few words why a file cannot be written."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    return "disk full" if full else error.strerror or error


def write_text(path: Path, content: str, *, anew: bool = True) -> None:
    """Write a text file as `write_atomically` does, by default in place of an existing one."""
    write_atomically(path, lambda part: part.write_text(content, encoding="utf-8"), anew=anew)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; a link to one is followed.

    Pipes and devices are refused before anything is read, as reading them may never begin or never
    end. So are sparse files that consist almost entirely of holes, which could take years to read.

    Raises
    ------
    OSError
        If it is not a regular file, or cannot be opened.
    """
    _require_regular(path, path.stat())
    # If it has become a pipe in between, opening it must not wait for a writer.
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _require_regular(path, os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except OSError:
        os.close(descriptor)
        raise


def read_text(path: Path, most: int) -> str:
    """Read a regular file of UTF-8 text, of at most `most` bytes.

    Raises
    ------
    OSError
        If it is larger, is not a regular file, or cannot be read.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)  # sizes that /proc reports cannot be trusted
    if len(content) > most:
        raise OSError(0, f"has more than the {most} bytes that are read", str(path))
    return content.decode()


def require_text(path: Path) -> None:
    """Refuse a path whose name is not UTF-8, as neither JSON nor messages can carry it.

    Raises
    ------
    OSError
        If it is not UTF-8.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise OSError(0, "its name is not UTF-8", str(path)) from None


def _require_regular(path: Path, status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(21, "Is a directory", str(path))
    if not stat.S_ISREG(status.st_mode):
        raise OSError(0, "is not a regular file", str(path))
    written = 512 * status.st_blocks
    if status.st_size > _NEVER_SPARSE and 0 < _SPARSEST * written < status.st_size:
        raise OSError(0, f"is a sparse file: {written} of {status.st_size} bytes", str(path))
