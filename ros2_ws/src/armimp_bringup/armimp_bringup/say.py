"""Lines on standard error."""

import sys
from typing import Final

_LONGEST: Final = 1200
"""Letters of a line: files of unknown origin may hold names of any length."""


def say(line: str) -> None:
    """Print a line, which stays one whatever is in the names and values that it quotes."""
    shown = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in line
    )
    if len(shown) > _LONGEST:
        shown = f"{shown[: _LONGEST // 2]} ... {shown[-_LONGEST // 2 :]}"
    print(shown, file=sys.stderr)
