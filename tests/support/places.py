"""Where the parts of the project are, and what is in a folder."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    path.parent.name: path.parent
    for folder in ("ros2_ws/src", "examples")
    for path in (ROOT / folder).glob("*/package.xml")
}
"""Folders of the packages, those of the examples included."""
PACKAGES = sorted(SOURCES)


def contents(folder: Path) -> dict[str, bytes]:
    """Files of a folder by their path in it, without what Python has compiled."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
