"""Entry point of the command ``armimp``; an interrupt during the imports is handled, too."""

import os
from typing import NoReturn


def program() -> NoReturn:
    """Import the command line, which takes most of a second, and run it."""
    try:
        from armimp_bringup import cli
    except KeyboardInterrupt:
        os.write(2, b"armimp: interrupted\n")
        os._exit(130)
    cli.program()


if __name__ == "__main__":
    program()
