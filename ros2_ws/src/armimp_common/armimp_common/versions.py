"""What a result was made with: versions of the software and revision of the sources."""

import functools
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

UNKNOWN: Final = "unknown"

_PACKAGES: Final = ("numpy", "scipy", "numba", "rclpy", "rosbags", "mcap", "armimp")
_OTHER_NAMES: Final = {"rclpy": "ros-jazzy-rclpy", "armimp": "armimp_common"}
"""In the wheels of ROS, and in a workspace that holds some of the packages of this project."""


def versions() -> dict[str, str]:
    """Return the version of Python and of every package that can influence a result.

    What is not installed is ``"unknown"``.
    """
    found = {name: _version(_OTHER_NAMES.get(name, name)) for name in _PACKAGES}
    missing = {name: _version(name) for name, known in found.items() if known == UNKNOWN}
    return {"python": platform.python_version(), **found, **missing}


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


@functools.cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
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
