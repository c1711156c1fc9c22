"""What a result was made with: versions of the software and revision of the sources."""

import functools
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

UNKNOWN: Final = "unknown"

_DISTRIBUTIONS: Final = {
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "rclpy": "ros-jazzy-rclpy",
    "rosbags": "rosbags",
    "mcap": "mcap",
    "armimp": "armimp",
}


def versions() -> dict[str, str]:
    """Return the version of Python and of every package that can influence a result.

    ``rclpy`` is the version of the PyPI wheel; in a full ROS installation, which has no such
    distribution, it is that of rclpy itself. What is not installed is ``"unknown"``.
    """
    found = {"python": platform.python_version()}
    for name, distribution in _DISTRIBUTIONS.items():
        found[name] = _version(distribution)
    if found["rclpy"] == UNKNOWN:
        found["rclpy"] = _version("rclpy")
    if found["armimp"] == UNKNOWN:
        found["armimp"] = _version("armimp_common")  # a workspace may hold some of the packages
    return found


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
