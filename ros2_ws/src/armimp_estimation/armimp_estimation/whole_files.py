"""Files of which nobody ever sees a part."""

import os
from collections.abc import Callable
from pathlib import Path

from armimp_common.errors import ArmimpError, DataError


def write_whole(
    path: Path,
    write: Callable[[Path], object],
    *,
    anew: bool = False,
    error: type[ArmimpError] = DataError,
) -> None:
    """Write a file beside its place and move it there.

    Parameters
    ----------
    path : Path
        The file.
    write : callable
        Writes the file at the path that it is given, which has the same suffix.
    anew : bool
        Whether to put it in the place of a file that is there, which stays if that fails.

    error : type
        What is raised.

    Raises
    ------
    error
        If the file exists already or cannot be written.
    """
    part = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        if path.exists() and not anew:
            raise error(f"{path}: exists already")
        try:
            write(part)
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as cause:
        raise error(f"{path}: cannot be written: {cause.strerror}") from cause
