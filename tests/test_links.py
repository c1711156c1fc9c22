"""Every relative link in every Markdown file leads to a file, and to a heading in it."""

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# Folders of tools, environments and results hold pages of others.
FOLDERS = (
    ".",
    "benchmarks",
    "docs",
    "docker",
    "examples",
    "research",
    "ros2_ws/src",
    "scripts",
    "tests",
)
PAGES = sorted(
    {
        path.relative_to(ROOT)
        for folder in FOLDERS
        for path in (ROOT / folder).glob("*.md" if folder == "." else "**/*.md")
        if not any(part.startswith(".") for part in path.relative_to(ROOT).parts)
    }
)


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


def test_there_are_pages_and_they_have_links() -> None:
    assert {Path("README.md"), Path("CONTRIBUTING.md"), Path("docs/theory.md")} <= set(PAGES)
    assert sum(len(list(links(page))) for page in PAGES) > 100


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_link_leads_somewhere(page: Path) -> None:
    assert [link for link in links(page) if not leads_somewhere(page, link)] == []


def test_every_page_of_docs_can_be_reached_from_the_readme() -> None:
    reached, waiting = set[Path](), [Path("README.md")]
    while waiting:
        page = waiting.pop()
        if page in reached or page.suffix != ".md":
            continue
        reached.add(page)
        names = [link.partition("#")[0] for link in links(page)]
        folder = (ROOT / page).parent
        waiting += [(folder / name).resolve().relative_to(ROOT) for name in names if name]
    assert {page for page in PAGES if page.parts[0] == "docs"} <= reached
    assert {Path("CHANGELOG.md"), Path("CONTRIBUTING.md"), Path("examples/README.md")} <= reached
