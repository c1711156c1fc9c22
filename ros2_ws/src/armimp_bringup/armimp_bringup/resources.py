"""Files that come with the packages."""

from __future__ import annotations

from pathlib import Path

from armimp_common.errors import ConfigurationError


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
    try:
        from ament_index_python.packages import get_package_share_directory

        installed = Path(get_package_share_directory("armimp_bringup")) / "config" / name
    except (ImportError, LookupError):
        installed = beside
    if not installed.is_file():
        raise ConfigurationError(f"{name} is neither in the sources nor installed: {beside}")
    return installed
