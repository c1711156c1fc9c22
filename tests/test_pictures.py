"""Pictures of README and docs are made by one command, and none is older than what makes it."""

from __future__ import annotations

import re
from pathlib import Path

import make_pictures
import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize("name", make_pictures.RECIPES)
def test_pictures_are_as_new_as_what_makes_them(name: str) -> None:
    recipe = make_pictures.RECIPES[name]
    assert all((make_pictures.IMAGES / picture).exists() for picture in recipe.pictures)
    assert make_pictures.stored()[name] == recipe.digest(), (
        f"out of date: make pictures ARGS={name}"
    )


def test_every_picture_of_the_pages_has_a_recipe() -> None:
    pages = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("research/*.md")]
    shown = {
        name
        for page in pages
        for name in re.findall(r"!\[[^\]]*\]\([^)]*images/([^)]+\.png)\)", page.read_text("utf-8"))
    }
    assert shown == {one for recipe in make_pictures.RECIPES.values() for one in recipe.pictures}


def test_a_change_of_code_changes_the_digest_and_one_of_words_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(make_pictures, "ROOT", tmp_path)
    recipe = make_pictures.Recipe(pictures=("one.png",), sources=("draw.py",), study=("one",))
    source = tmp_path / "draw.py"
    digests = []
    words = '"""New."""\nimport this\n\n# Wide.\ndef draw(width: int) -> None: plot(width, 3)\n'
    for text in ("def draw(width): plot(width, 3)\n", words, "def draw(width): plot(width, 4)\n"):
        source.write_text(text)
        digests.append(recipe.digest())
    assert digests[0] == digests[1] != digests[2]
