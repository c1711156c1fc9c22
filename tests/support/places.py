"""Where the parts of the project are."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    path.parent.name: path.parent
    for folder in ("ros2_ws/src", "examples")
    for path in (ROOT / folder).glob("*/package.xml")
}
"""Folders of the packages, those of the examples included."""
PACKAGES = sorted(SOURCES)
