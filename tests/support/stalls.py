"""For how long the machine did not run what was ready to run, measured beside the program."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import TracebackType

_PROGRAM = """
import time
last = time.monotonic()
while True:
    time.sleep(0.002)
    now = time.monotonic()
    if now - last > 0.006:
        print(last + 0.002, now, flush=True)
    last = now
"""


class StallWitness:
    """A process that does nothing but sleep and look at the clock, while this is entered."""

    def __init__(self, file: Path) -> None:
        self._file = file

    @property
    def stalls(self) -> list[tuple[float, float]]:
        """Beginning and end of each stall of more than 4 ms so far (monotonic, s)."""
        lines = self._file.read_text().splitlines()
        return [(float(line.split()[0]), float(line.split()[1])) for line in lines]

    def __enter__(self) -> StallWitness:
        with self._file.open("w") as file:
            self._process = subprocess.Popen([sys.executable, "-c", _PROGRAM], stdout=file)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._process.kill()
        self._process.wait()
