"""Choice of a ROS domain id that no other experiment on this machine has."""

import fcntl
import os
import random
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final

from armimp_common.errors import ConfigurationError, GraphError

if TYPE_CHECKING:
    from typing_extensions import Self

LOWEST: Final = 1
HIGHEST: Final = 100
"""Domain ids beyond 101 collide with ephemeral ports on Linux; 0 is everybody's default."""


class DomainClaim:
    """A domain id held by this process until `release`, or until the process ends.

    The claim is an advisory file lock, so it needs no clean-up after a crash. It only keeps
    processes apart that claim their domains too.

    Parameters
    ----------
    domain_id
        The id to claim; None takes any that is free.

    Attributes
    ----------
    domain_id : int
        The claimed id.

    Raises
    ------
    ConfigurationError
        If the given id is out of range.
    GraphError
        If the given id is taken, or none is free.
    """

    def __init__(self, domain_id: int | None = None) -> None:
        self._file: int | None = None
        if domain_id is not None:
            if not 0 <= domain_id <= HIGHEST:
                raise ConfigurationError(f"domain id is not within 0..{HIGHEST}: {domain_id}")
            if not self._try(domain_id):
                raise GraphError(f"domain id {domain_id} is taken by another experiment")
            return
        candidates = list(range(LOWEST, HIGHEST + 1))
        # Not the seeded generator of an experiment: two equal experiments must differ here.
        random.SystemRandom().shuffle(candidates)
        if not any(self._try(candidate) for candidate in candidates):
            raise GraphError(f"no domain id is free within {LOWEST}..{HIGHEST}")

    def _try(self, domain_id: int) -> bool:
        try:
            file = _open(_directory() / f"{domain_id}.lock")
        except OSError:
            return False
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            return False
        self._file = file
        self.domain_id = domain_id
        return True

    def release(self) -> None:
        """Give the domain id back; calling it again does nothing."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def __enter__(self) -> "Self":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.release()


def _directory() -> Path:
    """Return the directory of the locks, which all users of the machine share."""
    directory = Path(tempfile.gettempdir()) / "armimp-domains"
    with suppress(FileExistsError):
        directory.mkdir()
        # Not by the mode of mkdir, which the umask narrows.
        directory.chmod(0o1777)
    return directory


def _open(path: Path) -> int:
    # Reading is enough for a lock. The file of another user must not be opened for creation:
    # Linux refuses that in a directory that is open to all.
    flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW
    try:
        return os.open(path, flags)
    except FileNotFoundError:
        return os.open(path, flags | os.O_CREAT, 0o644)
