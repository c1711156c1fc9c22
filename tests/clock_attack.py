"""Program for test_clock_steps.py: ``armimp`` with a wall clock that is set during a trial.

``python -m clock_attack run …`` is the orchestrator. Its simulator is this program, too, in the
same process or in one of its own. At sample CLOCK_TICK the simulator steps the clock of the chosen
processes (see wall_clock.c) by CLOCK_STEP (s). If RIG_LOG names a file, the simulator sends its
last sample soon afterwards, before anybody can have noticed, and lives on. It writes lines to that
file, each with the time on the steady clock (s): ``sample`` for the last sample, and for each
command ``torque``, or ``zero`` if all its torques are zero.
"""

import os
import struct
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from armimp_bringup import cli, nodes
from armimp_common.topics import SIM_NODE
from armimp_sim import node

SOON = 5
"""Samples between step and silence."""


class AttackingRig(node.ArmSimNode):
    """A simulator that sets the clock, and may fall silent soon afterwards."""

    def __init__(self, **kwargs: Any) -> None:
        log = os.environ.get("RIG_LOG")
        self._log = None if log is None else Path(log).open("w", buffering=1)  # noqa: SIM115
        self._step_tick = int(os.environ["CLOCK_TICK"])
        super().__init__(**kwargs)

    def _note(self, what: str) -> None:
        if self._log is not None:
            self._log.write(f"{time.monotonic()!r} {what}\n")

    def _send(self) -> None:
        tick = self.limiter.tick if self.configured else 0
        if tick == self._step_tick:
            with Path(os.environ["WALL_CLOCK"]).open("r+b") as file:
                file.write(struct.pack("q", int(os.environ["CLOCK_STEP"])))
        super()._send()
        if self._log is not None and tick == self._step_tick + SOON:
            self._note("sample")
            assert self._simulator is not None
            self._simulator.stop()

    def on_command(self, command: tuple[float, ...]) -> None:
        self._note("torque" if any(command) else "zero")
        super().on_command(command)


if __name__ == "__main__":
    setattr(node, "ArmSimNode", AttackingRig)  # noqa: B010 (a class is not assigned to, says mypy)
    if "--ros-args" in sys.argv:
        sys.exit(node.main())
    cast("dict[str, Sequence[str]]", nodes.MODULES)[SIM_NODE] = ("clock_attack",)
    sys.exit(cli.program())
