"""Make the pictures of README and docs, and keep a digest of what they were made with.

``make pictures`` remakes those whose sources have changed since; ``ARGS=coverage`` remakes one in
any case. ``tests/test_pages.py`` fails as long as one is out of date. Studies take up to an hour;
only the modules that draw their figures count as their sources, not all the code that they run.
"""

from __future__ import annotations

import ast
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
DIGESTS = IMAGES / "digests.json"
_ESTIMATION = "ros2_ws/src/armimp_estimation/armimp_estimation"
_WIDTH, _HEIGHT = 1280, 1020
"""Size of the picture of a report, pixels."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How pictures are made: by the default run, or by the study of the same name."""

    pictures: tuple[str, ...]
    """Files in ``docs/images``."""
    sources: tuple[str, ...]
    """Patterns of files that decide what they look like."""
    study: tuple[str, ...] = ()
    """Arguments of the study; none for the default run."""

    def digest(self) -> str:
        """Digest of the code of the sources, and of the study's arguments or the default run."""
        from armimp_bringup.config import ExperimentConfig

        made = hashlib.sha256(" ".join(self.study).encode())
        if not self.study:
            made.update(ExperimentConfig().model_dump_json().encode())
        for path in sorted({one for pattern in self.sources for one in ROOT.glob(pattern)}):
            made.update(path.relative_to(ROOT).as_posix().encode())
            made.update(_code(path) if path.suffix == ".py" else path.read_bytes())
        return made.hexdigest()

    def make(self) -> None:
        """Make the pictures."""
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "readme"
            if self.study:
                study = [sys.executable, "-m", "research", *self.study, "--out", str(out)]
                subprocess.run(study, cwd=ROOT, check=True)
            else:
                armimp = str(Path(sys.executable).with_name("armimp"))
                subprocess.run([armimp, "run", "--out", out.name], cwd=folder, check=True)
                _photograph(out / "report.html", out / "report.png")
            for picture in self.pictures:
                shutil.copy(out / picture, IMAGES / picture)


def _study(name: str, *options: str, more: Iterable[str] = ()) -> Recipe:
    return Recipe(
        pictures=(f"{name}.png", *more),
        sources=(f"research/{name}_figure*.py",),
        study=(name, *options),
    )


RECIPES = {
    "run": Recipe(
        pictures=("impedance.png", "report.png"),
        sources=(
            f"{_ESTIMATION}/figures.py",
            *(f"{_ESTIMATION}/report/**/*.{suffix}" for suffix in ("py", "html", "css", "js")),
        ),
    ),
    "coverage": _study("coverage", "--seeds", "0:100"),
    "limits": _study("limits"),
    "controller": _study("controller"),
    "decomposition": _study("decomposition", more=["decomposition_coupling.png"]),
    "growth": _study("growth"),
}


def _code(path: Path) -> bytes:
    """Return the syntax tree of a module without docstrings, imports and types."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            body[:] = [one for one in body if not _is_said(one)]
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, (ast.FunctionDef, ast.AnnAssign)):
            node.returns = node.annotation = None  # type: ignore[union-attr]
    return ast.dump(tree).encode()


def _is_said(statement: ast.stmt) -> bool:
    """Whether a statement is for readers and types alone."""
    if isinstance(statement, ast.Expr):
        return isinstance(statement.value, ast.Constant)
    return isinstance(statement, (ast.Import, ast.ImportFrom))


def _photograph(page: Path, picture: Path) -> None:
    """Take a picture of the top of a page with a headless browser."""
    sys.path.insert(0, str(ROOT / "tests"))
    from support.browser import EXECUTABLE, started

    if EXECUTABLE is None:
        sys.exit("the picture of the report needs chromium (apt-get install chromium)")
    with started() as browser:
        browser.open(page, width=_WIDTH)
        browser.page.screenshot(
            path=picture,
            full_page=True,
            clip={"x": 0.0, "y": 0.0, "width": float(_WIDTH), "height": float(_HEIGHT)},
        )


def stored() -> dict[str, str]:
    """Return the digests of what the pictures were made with, by name of the recipe."""
    found: dict[str, str] = json.loads(DIGESTS.read_text(encoding="utf-8"))
    return found


def main(names: Sequence[str]) -> None:
    """Make the named pictures, or those that are out of date."""
    unknown = set(names) - set(RECIPES)
    if unknown:
        sys.exit(f"no pictures called {', '.join(sorted(unknown))}, only {', '.join(RECIPES)}")
    old = stored() if DIGESTS.exists() else {}
    for name, recipe in RECIPES.items():
        if name in names or (not names and old.get(name) != recipe.digest()):
            print(f"making {', '.join(recipe.pictures)}", file=sys.stderr)
            recipe.make()
            old[name] = recipe.digest()
            text = json.dumps({key: old[key] for key in RECIPES if key in old}, indent=1)
            DIGESTS.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
