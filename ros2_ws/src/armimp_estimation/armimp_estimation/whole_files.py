"""Files of which nobody ever sees a part, and files that must be plain ones to be read."""

import os
import secrets
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from armimp_common.errors import ArmimpError, DataError


def replace_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file under a new random name beside its place, and move it there.

    Nothing that stands there under that name is opened, and no link is followed.

    Parameters
    ----------
    path : Path
        The file; one that is there stays if writing fails.
    write : callable
        Writes the file at the path that it is given, which has the same suffix.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    part = path.with_name(f".{secrets.token_hex(8)}{path.suffix}")
    exclusively = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    os.close(os.open(part, exclusively, 0o666))
    try:
        write(part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_whole(
    path: Path,
    write: Callable[[Path], object],
    *,
    anew: bool = False,
    error: type[ArmimpError] = DataError,
) -> None:
    """Write a file as `replace_whole` does, with one line for whatever goes wrong.

    Parameters
    ----------
    path, write
        As of `replace_whole`.
    anew : bool
        Whether to put it in the place of a file that is there, which stays if that fails.
    error : type
        What is raised.

    Raises
    ------
    error
        If the file exists already or cannot be written.
    """
    try:
        if path.exists() and not anew:
            raise error(f"{path}: exists already")
        replace_whole(path, write)
    except OSError as cause:
        raise error(f"{path}: cannot be written: {cause.strerror}") from cause


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading; a link to one is followed.

    Pipes and devices are refused before anything is read: they may have no end, or never begin.

    Raises
    ------
    OSError
        If it is no regular file, or cannot be opened.
    """
    _require_regular(path, path.stat().st_mode)
    # Should it become a pipe in between, opening it must not wait for a writer.
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    try:
        _require_regular(path, os.fstat(file.fileno()).st_mode)
    except OSError:
        file.close()
        raise
    return file


def read_text(path: Path, most: int) -> str:
    """Read a regular file of UTF-8 text.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Bytes that it may have.

    Raises
    ------
    OSError
        If it is larger or no regular file, or cannot be read.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)  # what /proc says of sizes is nothing to go by
    if len(content) > most:
        raise OSError(0, f"has more than the {most} bytes that are read", str(path))
    return content.decode()


def require_text(path: Path) -> None:
    """Refuse a name that is not UTF-8, which no JSON and no message can carry.

    Raises
    ------
    OSError
        If it is not.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise OSError(0, "its name is not UTF-8", str(path)) from None


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(21, "Is a directory", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(0, "is not a regular file", str(path))
