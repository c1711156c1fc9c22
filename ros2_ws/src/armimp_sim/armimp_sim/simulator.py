"""The simulated rig as a device: commands in, samples out, and no torque after a fault.

In lockstep a step follows each command; in real time, time goes on whether a command has come or
not.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.protection import CommandWatch, TorqueLatch, first_bad
from armimp_common.realtime import Pacer, TimingMeter, wake_up_exactly
from armimp_common.status import TimingFigures
from armimp_common.topics import PERIOD_NS
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import IntegrationError, Plant
from armimp_sim.voluntary import reading_noise, voluntary_torque

HEARD_TICKS = 100
"""Periods without any command after which all samples but the newest count as not received."""
_PATIENCE = 2.0
"""How long to wait for the thread to end (s)."""


class SimulatedRig(TorqueLatch):
    """Arm, exoskeleton, friction and sensors, advanced by one control period per command.

    Parameters
    ----------
    parameters : SimulatorParameters

    Attributes
    ----------
    position : (n,) encoder readings, rad; valid until the next step
    torque : (n,) torque transducer readings, N·m; likewise
    tick : number of the present sample, from 0

    Raises
    ------
    ConfigurationError
        If the parameters do not describe a rig.
    """

    def __init__(self, parameters: SimulatorParameters) -> None:
        joints = len(parameters.joints)
        super().__init__(joints, CommandWatch(parameters.watchdog_ticks, HEARD_TICKS))
        self._plant = Plant([parameters])
        self.position: FloatArray = self._plant.position[0]
        self.torque: FloatArray = self._plant.torque[0]
        seed = parameters.seed
        self._voluntary = voluntary_torque(parameters.voluntary, joints=joints, seed=seed)
        self._noise = reading_noise(parameters.sensors, joints=joints, seed=seed)
        self._command = np.zeros((1, joints))
        self.tick = 0
        # Have the plant compiled before time matters.
        with suppress(IntegrationError):  # reported when it happens in the simulation proper
            Plant([parameters]).tick(np.zeros((1, joints)), np.zeros((1, joints)))

    @property
    def stamp_ns(self) -> int:
        """Time of the present sample since the start, ns."""
        return self.tick * PERIOD_NS

    def step(self, command: Sequence[float]) -> None:
        """Hold ``command`` (n,), N·m, for one period and sample again.

        A command that is not finite never reaches the plant: it latches a fault, and this and all
        further steps run with zero torque. After :meth:`fade` they run with a torque on its way
        to zero.

        Raises
        ------
        IntegrationError
            If the simulation itself broke down.
        """
        if (bad := first_bad(command)) is not None:
            self.latch(f"command of joint {bad + 1} is not finite: {command[bad]}")
        self.obey(command)
        self.go_on_fading()
        self._command[0] = self.applied
        self._plant.tick(self._command, self._voluntary.take(1), self._noise.take(1))
        self.tick += 1


class RealtimeSimulator:
    """Runs a rig in a thread of its own, and sends each sample at its deadline.

    The command that answers sample k acts from sample k to sample k + 1, as in lockstep. The step
    between them is taken as soon as the command comes, so that at the deadline of k + 1 there is
    nothing left to do but to send. If it has not come by then, the last command is held and the
    tick counts as missed. A run without a missed tick takes the steps of a run in lockstep, and
    gives the same samples to the last bit.

    Parameters
    ----------
    rig : SimulatedRig
    send : callable
        Sends the present sample; called in the thread.
    pacer : Pacer

    Attributes
    ----------
    error : exception that ended the thread; None if none did
    """

    def __init__(self, rig: SimulatedRig, send: Callable[[], None], pacer: Pacer) -> None:
        self._rig, self._send, self._pacer = rig, send, pacer
        self._command: tuple[float, ...] = (0.0,) * rig.position.size
        self._meter = TimingMeter()
        self._stepped = False
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pacing", daemon=True)
        self.error: BaseException | None = None

    def start(self) -> None:
        """Send the first sample, and all others at their deadlines."""
        self._thread.start()

    def stop(self) -> None:
        """Stop sending; calling it again is harmless."""
        self._stopped.set()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    def command(self, command: Sequence[float]) -> None:
        """Take a command (n,), N·m, for the next step."""
        now_ns = self._pacer.now()
        with self._rig.lock:
            self._command, watch = tuple(command), self._rig.watch
            reason = watch.command(command)
            if watch.answered_ns is not None:
                self._meter.answered(now_ns - watch.answered_ns)
            if reason:
                self._rig.latch(reason)
            if not watch.owed and not self._stepped:
                self._stepped = True
                self._rig.step(command)

    def figures(self) -> TimingFigures:
        """Return the timing since the start."""
        with self._rig.lock:
            return self._meter.figures()

    def begin(self) -> None:
        """Send the first sample; its deadline is now. Part of the thread."""
        self._pacer.start()
        with self._rig.lock:
            self._sample(0)

    def advance(self, tick: int) -> None:
        """Send the sample of a tick whose deadline has come. Part of the thread."""
        with self._rig.lock:
            reason = self._rig.watch.period()
            if not self._stepped:
                self._meter.missed()
                if reason:
                    self._rig.fade(reason)
                self._rig.step(self._command)
            self._sample(tick)

    def _sample(self, tick: int) -> None:
        sent_ns = self._pacer.now()
        self._send()
        self._meter.sent(self._pacer.deadline_ns(tick), sent_ns)
        self._rig.watch.sample(sent_ns)
        self._stepped = False

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
