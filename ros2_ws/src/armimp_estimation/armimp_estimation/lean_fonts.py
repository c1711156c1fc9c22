"""Fonts in PDF files without what only the setting of text needs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_TABLES = ("GSUB", "GPOS", "GDEF", "kern")
"""Ligatures, positions and kerning; in a PDF, every glyph has its place already."""
_DEFAULT = "_drop_tables_default"


@contextmanager
def lean_fonts() -> Iterator[None]:
    """Have matplotlib embed fonts without these tables, which takes it a quarter of the time.

    It has no option for that, so this is one of the library behind it; where that has another
    name, files are a little larger and take longer.
    """
    from fontTools.subset import Options

    options: Any = Options
    before = getattr(options, _DEFAULT, None)
    if not isinstance(before, list):
        yield
        return
    setattr(options, _DEFAULT, [*before, *_TABLES])
    try:
        yield
    finally:
        setattr(options, _DEFAULT, before)
