"""Pictures of README and docs are made by one command, and none is older than what makes it."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


def _script() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "make_pictures", ROOT / "scripts/make_pictures.py"
    )
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


SCRIPT = _script()


@pytest.mark.parametrize("name", SCRIPT.RECIPES)
def test_pictures_are_as_new_as_what_makes_them(name: str) -> None:
    recipe = SCRIPT.RECIPES[name]
    assert all((SCRIPT.IMAGES / picture).exists() for picture in recipe.pictures)
    assert SCRIPT.stored()[name] == recipe.digest(), f"out of date: make pictures ARGS={name}"


def test_every_picture_of_the_pages_has_a_recipe() -> None:
    pages = [ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("research/*.md")]
    shown = {
        name
        for page in pages
        for name in re.findall(r"!\[[^\]]*\]\([^)]*images/([^)]+\.png)\)", page.read_text("utf-8"))
    }
    assert shown == {one for recipe in SCRIPT.RECIPES.values() for one in recipe.pictures}


def test_a_change_of_code_changes_the_digest_and_one_of_words_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SCRIPT, "ROOT", tmp_path)
    recipe = SCRIPT.Recipe(pictures=("one.png",), sources=("draw.py",), study=("one",))
    source = tmp_path / "draw.py"
    digests = []
    words = '"""New."""\nimport this\n\n# Wide.\ndef draw(width: int) -> None: plot(width, 3)\n'
    for text in ("def draw(width): plot(width, 3)\n", words, "def draw(width): plot(width, 4)\n"):
        source.write_text(text)
        digests.append(recipe.digest())
    assert digests[0] == digests[1] != digests[2]
