"""The page on safety names tests that exist."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = sorted(
    {
        found
        for page in (ROOT / "docs").glob("*.md")
        for found in re.findall(r"(test_\w+\.py)::(test_\w+)", page.read_text(encoding="utf-8"))
    }
)


def names_in(file: str) -> set[str]:
    (path,) = (*ROOT.glob(f"tests/{file}"), *ROOT.glob(f"ros2_ws/src/*/test/{file}"))
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return {node.name for node in tree if isinstance(node, ast.FunctionDef)}


def test_every_hazard_of_the_page_has_a_test() -> None:
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and "`test_" in line]
    assert len(rows) > 15
    table = PAGE.partition("| hazard |")[2].partition("\n\n")[0].splitlines()[2:]
    assert [row for row in table if "::test_" not in row] == []


@pytest.mark.parametrize(("file", "test"), NAMED)
def test_every_test_that_a_page_names_exists(file: str, test: str) -> None:
    assert test in names_in(file)
