"""Lines on standard error."""

import sys


def say(line: str) -> None:
    """Print a line, which stays one whatever is in the names and values that it quotes."""
    shown = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode()
        for letter in line
    )
    print(shown, file=sys.stderr)
