"""Program for test_graph_kills.py: ``armimp`` without figures; a process of the graph is killed.

Arguments: file for events; file that exists as soon as the witness listens; phase; victim; delay
(s) after the beginning of the phase; time (s) for which the orchestrator does not see that its
child is dead, as on a rig where it has none; and then the arguments of ``armimp``. The phases are
``start``; the transitions ``configure``, ``activate`` and ``shutdown``; those of the trial
status with the number of the trial, like ``perturb 1``; and ``moving``, as soon as the witness has
seen some of the first perturbation, however long that takes. Events are lines: ``domain ID``, and
``killed T`` with the monotonic time of this machine, which all processes share.
"""

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from armimp_bringup import orchestrator, presentation
from armimp_bringup.cli import main
from armimp_bringup.graph import GraphContext
from armimp_bringup.nodes import SeparateNodes
from armimp_bringup.orchestrator import Supervisor
from armimp_common.lifecycle import LifecycleManager, TransitionName
from armimp_common.status import values_of
from armimp_common.topics import SUPERVISOR_NODE
from support.processes import wait_until

PATIENCE = 180.0
MOVING = "moving"


class Killer:
    """Kills one process of the graph, once."""

    def __init__(
        self, events: Path, seen: Path, phase: str, victim: str, delay: float, blind: float
    ) -> None:
        self._events, self._seen = events, seen
        self.phase, self._victim, self._delay = phase, victim, delay
        self._armed = True
        self._blind = blind
        self.blind_until = -math.inf
        self.nodes: SeparateNodes | None = None

    def note(self, line: str) -> None:
        with self._events.open("a") as events:
            events.write(line + "\n")

    def await_witness(self, what: str = "") -> None:
        """Return when the witness listens, or has done this."""
        file = self._seen.with_suffix(what)
        wait_until(file.exists, f"{file.name} of the witness", PATIENCE)

    def await_motion(self) -> None:
        """Tell when the witness has seen some of a perturbation."""
        self.await_witness(".moving")
        self.reach(MOVING)

    def before(self, transition: str) -> None:
        """A transition is to be asked for."""
        if transition == "activate" and (" " in self.phase or self.phase == MOVING):
            self.await_witness(".known")

    def reach(self, phase: str, *, node: str | None = None) -> None:
        """A phase has come; a phase of nodes counts only for the victim, if it is a node."""
        concerned = node is None or self._victim in (node, SUPERVISOR_NODE) or phase == "shutdown"
        if self._armed and concerned and phase == self.phase:
            self._armed = False
            threading.Timer(self._delay, self._kill).start()

    def _kill(self) -> None:
        assert self.nodes is not None
        nodes = {name: one.pid for name, one in self.nodes.processes.items()}
        process = nodes.get(self._victim, os.getpid())
        self.blind_until = time.monotonic() + self._blind
        self.note(f"killed {time.monotonic()!r}")
        os.kill(process, signal.SIGKILL)


def install(killer: Killer) -> None:
    """Have the orchestrator tell the killer where it is."""

    class Told(GraphContext):
        def __init__(self, domain_id: int | None = None) -> None:
            super().__init__(domain_id)
            killer.note(f"domain {self.claim.domain_id}")
            killer.await_witness()
            if killer.phase == MOVING:
                threading.Thread(target=killer.await_motion, daemon=True).start()

    class Kept(SeparateNodes):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            killer.nodes = self
            killer.reach("start")

        def dead(self) -> Mapping[str, str]:
            return {} if time.monotonic() < killer.blind_until else super().dead()

    class Manager(LifecycleManager):
        def change(self, name: str, transition: TransitionName) -> None:
            killer.before(transition)
            killer.reach(transition, node=name)
            super().change(name, transition)

    class Listener(Supervisor):
        def _on_trial(self, message: DiagnosticStatus) -> None:
            values = values_of(message)
            killer.reach(f"{values['phase']} {values['trial']}")
            super()._on_trial(message)

    for kind in (Told, Kept, Manager, Listener):
        setattr(orchestrator, kind.__bases__[0].__name__, kind)
    # Figures of what is left of the experiment would only keep the test waiting.
    setattr(presentation, "_draw", lambda *_: None)  # noqa: B010


if __name__ == "__main__":
    events, seen, phase, victim, delay, blind = sys.argv[1:7]
    install(Killer(Path(events), Path(seen), phase, victim, float(delay), float(blind)))
    sys.exit(main(sys.argv[7:]))
