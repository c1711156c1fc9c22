"""Pages: their links lead somewhere, hazards name their tests, and pictures are up to date."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import make_pictures
import pytest

from research.truth import names_like
from support.places import ROOT
from support.processes import run_program

# Folders of tools, environments and results hold pages of others.
PAGES = sorted(map(Path, run_program("git", "ls-files", "*.md", cwd=ROOT).splitlines()))


def text_of(page: Path) -> str:
    """A page without its blocks of code, in which brackets mean something else."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.sub(r"^( *)(```|~~~).*?^\1\2 *$", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub makes them: a repeated one gets a number."""
    found: set[str] = set()
    seen: Counter[str] = Counter()
    for heading in re.findall(r"^#+ +(.*?) *$", text_of(page), flags=re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        name = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
        found.add(f"{name}-{seen[name]}" if seen[name] else name)
        seen[name] += 1
    return found


def links(page: Path) -> Iterator[str]:
    text = re.sub(r"`[^`\n]*`", "", text_of(page))
    for link in re.findall(r"\]\(<?([^)\s>]+)>?(?: \"[^\"]*\")?\)", text):
        if not re.match(r"[a-z][a-z0-9+.-]*:", link):
            yield link


def leads_somewhere(page: Path, link: str) -> bool:
    name, _, anchor = link.partition("#")
    target = ((ROOT / page).parent / name).resolve() if name else ROOT / page
    if not target.exists() or ROOT not in (target, *target.parents):
        return False
    return not anchor or anchor in anchors(target.relative_to(ROOT))


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_link_leads_somewhere(page: Path) -> None:
    assert [link for link in links(page) if not leads_somewhere(page, link)] == []


SAFETY = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = sorted(
    {
        found
        for page in (ROOT / "docs").glob("*.md")
        for found in re.findall(r"(test_\w+\.py)::(test_\w+)", page.read_text(encoding="utf-8"))
    }
)


def names_in(file: str) -> set[str]:
    folders = ("tests", "ros2_ws/src/*/test", "examples/*/test")
    (path,) = (path for folder in folders for path in ROOT.glob(f"{folder}/{file}"))
    tree = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return {node.name for node in tree if isinstance(node, ast.FunctionDef)}


def test_every_hazard_of_the_page_has_a_test() -> None:
    rows = [line for line in SAFETY.splitlines() if line.startswith("| ") and "`test_" in line]
    assert len(rows) > 15
    table = SAFETY.partition("| hazard |")[2].partition("\n\n")[0].splitlines()[2:]
    assert [row for row in table if "::test_" not in row] == []


@pytest.mark.parametrize(("file", "test"), NAMED)
def test_every_test_that_a_page_names_exists(file: str, test: str) -> None:
    assert test in names_in(file)


def test_every_choice_of_classes_that_a_page_names_has_some() -> None:
    pattern = r"truth [^`]*?--only ('[^'`]+'|[^\s\"`]+)"
    chosen = [choice for page in PAGES for choice in re.findall(pattern, (ROOT / page).read_text())]
    assert len(chosen) > 15
    assert all(names_like(choice.strip("'")) for choice in chosen)


@pytest.mark.parametrize("name", make_pictures.RECIPES)
def test_pictures_are_as_new_as_what_makes_them(name: str) -> None:
    recipe = make_pictures.RECIPES[name]
    assert all((make_pictures.IMAGES / picture).exists() for picture in recipe.pictures)
    assert make_pictures.stored()[name] == recipe.digest(), (
        f"out of date: make pictures ARGS={name}"
    )
