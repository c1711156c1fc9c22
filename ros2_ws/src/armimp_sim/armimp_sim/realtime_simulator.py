"""The simulated rig under the wall clock: time goes on, whether a command has come or not."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence

from armimp_common.realtime import Pacer, TimingMeter, wake_up_exactly
from armimp_common.status import TimingFigures
from armimp_sim.parameters import WATCHDOG_TICKS
from armimp_sim.simulator import SimulatedRig

UNHEARD_TICKS = 100
"""If the first command comes later than that, in periods, what was sent before was not heard."""
_PATIENCE = 2.0


class RealtimeSimulator:
    """Runs a rig in a thread of its own: sample k at its deadline, under the latest command.

    The command that answers sample k acts from sample k to sample k + 1, as in lockstep. The step
    between them is taken as soon as it comes, so that nothing is left to do at the deadline of
    k + 1 but to send. If it has not come by then, the last command is held and the tick counts as
    missed. A run without a missed tick takes the steps of a run in lockstep, and gives the same
    samples to the last bit.

    Parameters
    ----------
    rig : SimulatedRig
    send : callable
        Sends the present sample; called in the thread.
    pacer : Pacer
    watchdog_ticks : int
        Periods after which the rig takes the torque away: without any command, or by which commands
        that come are behind. A controller that works through old samples is none any more.

    Attributes
    ----------
    lock : held while the rig or the figures are used
    error : what ended the thread, if it was not :meth:`stop`
    """

    def __init__(
        self,
        rig: SimulatedRig,
        send: Callable[[], None],
        pacer: Pacer,
        *,
        watchdog_ticks: int = WATCHDOG_TICKS,
    ) -> None:
        self._rig, self._send, self._pacer = rig, send, pacer
        self._patience = watchdog_ticks
        self._command: tuple[float, ...] = (0.0,) * rig.position.size
        self._ledger = TimingMeter()
        self._unanswered: deque[int] = deque(maxlen=10_000)
        self._began = self._arrived = self._stepped = self._in_step = False
        self._silent = self._spare = 0
        self._unheard = UNHEARD_TICKS
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pacing", daemon=True)
        self.lock = threading.RLock()
        self.error: BaseException | None = None

    def start(self) -> None:
        """Send the first sample, and all others in their time."""
        self._thread.start()

    def stop(self) -> None:
        """Send no more; harmless if repeated."""
        self._stopped.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    def command(self, command: Sequence[float]) -> None:
        """Take a command (n,), N·m, for the next step."""
        now_ns = self._pacer.now()
        with self.lock:
            self._command = tuple(command)
            self._arrive(now_ns)

    def refuse(self, reason: str) -> None:
        """Take a message that is no command: no torque from now on."""
        now_ns = self._pacer.now()
        with self.lock:
            self._rig.latch(reason)
            self._command = (0.0,) * len(self._command)
            self._arrive(now_ns)

    def reset(self) -> None:
        """Obey commands again after a fault; samples that were left unanswered are forgotten.

        Raises
        ------
        GraphError
            If the rig refuses.
        """
        with self.lock:
            self._rig.reset()
            self._unanswered.clear()
            self._began = self._arrived = self._in_step = False
            self._silent, self._spare = 0, self._patience
            # Whoever commanded before the fault has to begin anew, too.
            self._unheard = self._patience

    def figures(self) -> TimingFigures:
        """Timing since the start."""
        with self.lock:
            return self._ledger.figures()

    def begin(self) -> None:
        """Send the first sample; its deadline is now. Part of the thread."""
        self._pacer.start()
        with self.lock:
            self._sample(0)

    def advance(self, tick: int) -> None:
        """Send the sample of a tick whose deadline has come. Part of the thread."""
        with self.lock:
            self._silent = 0 if self._arrived or not self._began else self._silent + 1
            self._arrived = False
            if not self._stepped:
                self._ledger.missed()
                self._look_after_itself()
                self._rig.step(self._command)
            self._sample(tick)

    def _look_after_itself(self) -> None:
        if self._silent >= self._patience:
            self._rig.fade(f"no command for {self._patience} ticks")
        elif self._in_step and len(self._unanswered) > self._patience:
            self._rig.fade(f"commands are more than {self._patience} ticks behind")

    def _sample(self, tick: int) -> None:
        sent_ns = self._pacer.now()
        self._send()
        self._ledger.sent(self._pacer.deadline_ns(tick), sent_ns)
        self._unanswered.append(sent_ns)
        self._stepped = False

    def _arrive(self, now_ns: int) -> None:
        if not self._began:
            self._forget_unheard()
        self._began = self._arrived = True
        if self._unanswered:
            self._ledger.answered(now_ns - self._unanswered.popleft())
        elif self._spare:
            self._spare -= 1
        elif any(self._command):
            self._rig.latch("more commands than samples")
        if not self._unanswered and not self._stepped:
            self._stepped = self._in_step = True
            self._rig.step(self._command)

    def _forget_unheard(self) -> None:
        """Expect no answers from a controller that was not there yet; they will never come.

        Who is only slow to start, or always late, answers what he has heard: that is counted.
        """
        if len(self._unanswered) > self._unheard:
            newest = self._unanswered.pop()
            self._unanswered.clear()
            self._unanswered.append(newest)
            # Which of the last samples is answered first is not known.
            self._spare = self._patience

    def _run(self) -> None:
        wake_up_exactly()
        try:
            self.begin()
            tick = 0
            while not self._stopped.is_set():
                tick += 1
                self._pacer.wait(tick)
                if not self._stopped.is_set():
                    self.advance(tick)
        except BaseException as error:  # noqa: BLE001 (the node raises it where it is seen)
            self.error = error
