"""Files of which nobody ever sees a part."""

import os
from collections.abc import Callable
from pathlib import Path

from armimp_common.errors import DataError


def write_whole(path: Path, write: Callable[[Path], object], *, anew: bool = False) -> None:
    """Write a file beside its place and move it there.

    Parameters
    ----------
    path : Path
        The file.
    write : callable
        Writes the file at the path that it is given.
    anew : bool
        Whether to put it in the place of a file that is there, which stays if that fails.

    Raises
    ------
    DataError
        If the file exists already or cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.exists() and not anew:
            raise DataError(f"{path}: exists already")
        try:
            write(part)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise DataError(f"{path}: cannot be written: {error.strerror}") from error
