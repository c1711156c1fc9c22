"""Room on the disk that is kept free for what has to be written when the disk is full."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from armimp_common.errors import BagError
from armimp_estimation.bags.writer import why_not_written

RESERVE_FILE: Final = ".reserve"
_LEAST_BYTES: Final = 1 << 20
_BYTES_PER_TICK: Final = 4


def reserve_bytes(ticks: int) -> int:
    """Room for the summary of a bag of so many control periods, and for the files of a result."""
    return _LEAST_BYTES + _BYTES_PER_TICK * ticks


class DiskReserve:
    """A file that takes up room until it is needed.

    Parameters
    ----------
    directory : Path
        Where it is made, with its parents; one that is left from a process that died is replaced.
    size : int
        Bytes.

    Raises
    ------
    BagError
        If there is not that much room.
    """

    def __init__(self, directory: Path, size: int) -> None:
        self._path = directory / RESERVE_FILE
        try:
            directory.mkdir(parents=True, exist_ok=True)
            # Random, since a file system may store zeros in no room at all.
            self._path.write_bytes(os.urandom(size))
        except OSError as error:
            self.release()
            raise BagError(f"{self._path}: cannot be written: {why_not_written(error)}") from None

    def release(self) -> None:
        """Give the room back; harmless if repeated."""
        release_reserve(self._path.parent)


def release_reserve(directory: Path) -> None:
    """Give back the room that a process has kept in a directory."""
    with suppress(OSError):
        (directory / RESERVE_FILE).unlink(missing_ok=True)
