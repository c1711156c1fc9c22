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
