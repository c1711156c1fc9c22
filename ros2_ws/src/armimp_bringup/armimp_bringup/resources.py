"""Files that come with the packages, directories of results, and the limit of open files."""

from __future__ import annotations

import resource
from pathlib import Path

from armimp_common.errors import ConfigurationError, GraphError
from armimp_estimation.atomic_write import require_text

_OPEN_FILES = 64
"""So many may be open at once in a process; a run of two joints has at most 26."""


def config_file(name: str) -> Path:
    """Return a file of this package's ``config`` folder, from the sources or the installation.

    Raises
    ------
    ConfigurationError
        If it is not there.
    """
    beside = Path(__file__).resolve().parents[1] / "config" / name
    if beside.is_file():
        return beside
    # Where a wheel puts it: beside the folder of the packages in the same environment.
    wheel = Path(__file__).resolve().parents[4] / "share" / "armimp_bringup" / "config" / name
    if wheel.is_file():
        return wheel
    try:
        from ament_index_python.packages import get_package_share_directory

        installed = Path(get_package_share_directory("armimp_bringup")) / "config" / name
    except (ImportError, LookupError):
        installed = beside
    if not installed.is_file():
        raise ConfigurationError(f"{name} is neither in the sources nor installed: {beside}")
    return installed


def prepare_directory(directory: Path) -> None:
    """Make the output directory; one with anything in it is refused.

    Raises
    ------
    ConfigurationError
        If it exists and is not an empty directory, or can't be made.
    """
    try:
        require_text(directory)
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{directory}: cannot be made: {error.strerror}") from None
    require_unused(directory)


def require_unused(directory: Path) -> None:
    """Refuse an output directory with anything in it; there need not be one yet.

    Raises
    ------
    ConfigurationError
        If it exists and is not an empty directory.
    """
    try:
        require_text(directory)
        used = directory.exists() and any(directory.iterdir())
    except OSError as error:
        raise ConfigurationError(f"{directory}: cannot be made: {error.strerror}") from None
    if used:
        raise ConfigurationError(f"{directory}: is not empty, nothing is overwritten")


def require_open_files() -> None:
    """Raise the limit of open files as far as it must be.

    Raises
    ------
    GraphError
        If the system does not permit that.
    """
    limit, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= limit < _OPEN_FILES:
        if 0 <= most < _OPEN_FILES:
            raise GraphError(
                f"{most} open files are permitted (ulimit -n), and {_OPEN_FILES} are needed"
            )
        resource.setrlimit(resource.RLIMIT_NOFILE, (_OPEN_FILES, most))
