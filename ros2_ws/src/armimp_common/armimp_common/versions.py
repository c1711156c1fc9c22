"""What a result was made with: versions of the software and revision of the sources."""

import functools
import platform
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

UNKNOWN: Final = "unknown"

_PACKAGES: Final = ("numpy", "scipy", "numba", "rclpy", "mcap", "armimp")
_OTHER_NAMES: Final = {"rclpy": "ros-jazzy-rclpy", "armimp": "armimp_common"}
"""Other distribution names: of the ROS wheel, and of a workspace with only some packages."""


@functools.cache
def software() -> Mapping[str, Any]:
    """Return the software that runs here, as it is stored with results.

    ``versions`` are those of Python and of all packages that can influence a result, ``"unknown"``
    for what is not installed; ``git_revision`` is that of the sources.
    """
    found = {name: _version(_OTHER_NAMES.get(name, name), name) for name in _PACKAGES}
    versions = {"python": platform.python_version(), **found}
    return {"versions": versions, "git_revision": git_revision()}


def git_revision() -> str:
    """Return the git revision of the sources.

    Returns
    -------
    str
        The commit hash, with ``+dirty`` after it if tracked files were changed since;
        ``"unknown"`` if there is no git, no repository or no commit.
    """
    commit = _git("rev-parse", "--verify", "HEAD")
    # A virtual environment inside another project's repository must not report that project.
    if commit is None or not _git("ls-files", __file__):
        return UNKNOWN
    changes = _git("status", "--porcelain", "--untracked-files=no")
    return f"{commit}+dirty" if changes else commit


def _version(*distributions: str) -> str:
    for distribution in distributions:
        with suppress(PackageNotFoundError):
            return version(distribution)
    return UNKNOWN


def _git(*arguments: str) -> str | None:
    directory = Path(__file__).resolve().parent
    try:
        done = subprocess.run(
            ["git", "-C", str(directory), *arguments],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
