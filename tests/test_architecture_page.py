"""The architecture page: its table of packages is what the sources do, and its names exist."""

import ast
import importlib.util
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from armimp_common.topics import (
    CONTROLLER_NODE,
    DATA_STREAMS,
    ESTIMATOR_NODE,
    RECEIVED,
    SIM_NODE,
    TRIAL,
)

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "ros2_ws" / "src"
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PICTURE = ROOT / "docs" / "images" / "architecture.svg"
ROWS = dict(re.findall(r"^\| `(armimp\w*)` \| [^|]+ \| ([^|]+) \|$", PAGE, flags=re.MULTILINE))
ALLOWED = {package: set(re.findall(r"`(\w+)`", cell)) for package, cell in ROWS.items()}


def packages_in(path: Path) -> set[str]:
    """Top-level packages that a file imports anywhere."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.split(".")[0])
    return found


def test_the_table_names_every_package() -> None:
    assert set(ALLOWED) == {path.parent.name for path in SOURCES.glob("*/package.xml")}


@pytest.mark.parametrize("package", ALLOWED)
def test_a_package_imports_what_the_table_lets_it_and_nothing_else(package: str) -> None:
    files = (SOURCES / package / package).rglob("*.py")
    used = set().union(*(packages_in(path) for path in files)) & set(ALLOWED)
    assert used - {package} == ALLOWED[package]


@pytest.mark.parametrize("package", ALLOWED)
def test_the_manifest_depends_on_the_same_packages(package: str) -> None:
    manifest = ElementTree.parse(SOURCES / package / "package.xml").getroot()
    named = {one.text for kind in ("depend", "exec_depend") for one in manifest.iter(kind)}
    assert named & set(ALLOWED) == ALLOWED[package]


def test_no_package_imports_another_one_that_imports_it() -> None:
    done: set[str] = set()
    while ready := {name for name, others in ALLOWED.items() if others <= done} - done:
        done |= ready
    assert done == set(ALLOWED)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(armimp_\w+(?:\.\w+)+)`", PAGE))))
def test_every_module_that_the_page_names_exists(name: str) -> None:
    assert importlib.util.find_spec(name) is not None


def test_every_decision_has_a_date() -> None:
    part = PAGE.partition("\n## 6. Decisions")[2].partition("\n## 7. ")[0]
    decisions = re.split(r"^\d+\. ", part, flags=re.MULTILINE)[1:]
    assert len(decisions) > 20
    assert [one for one in decisions if not re.search(r"20\d\d-\d\d-\d\d\)", one)] == []


def test_the_picture_shows_topics_and_nodes_that_exist() -> None:
    texts = [
        one.text or "" for one in ElementTree.parse(PICTURE).iter() if one.tag.endswith("text")
    ]
    # A topic may be broken over two lines, or be followed by words.
    shown = re.sub(r"/\n", "/", "\n".join(texts))
    found = re.findall(r"^(\w+/[a-z]+|joint_states, torque_sensors|\w+_\w+s)(?=:|$)", shown, re.M)
    topics = {topic for one in found for topic in one.split(", ")}
    assert topics == {*DATA_STREAMS, TRIAL, RECEIVED}
    for node in (SIM_NODE, CONTROLLER_NODE, ESTIMATOR_NODE):
        assert node in texts
