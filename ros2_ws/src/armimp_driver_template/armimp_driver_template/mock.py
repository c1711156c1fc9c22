"""A device that is none: the simulated rig behind raw counts, with the faults of a real bus."""

from __future__ import annotations

import random
import threading
from collections import deque
from collections.abc import Sequence

from armimp_common.contract import NS_PER_S, PERIOD_NS
from armimp_common.pacing import Pacer
from armimp_driver_template.conversion import BITS
from armimp_driver_template.device import Frame
from armimp_driver_template.parameters import DriverParameters
from armimp_sim.parameters import SensorParameters, SimulatorParameters
from armimp_sim.rig import SimulatedRig


class MockDevice:
    """The rig of the study, sampled each millisecond, or after each command.

    Commands act late by `latency` periods, frames get lost, encoders wrap, and transducers have an
    offset that drifts.

    Parameters
    ----------
    parameters : DriverParameters
    pacer : Pacer, optional
        Keeps the time in real time.

    Attributes
    ----------
    paced : whether samples come by themselves
    """

    def __init__(self, parameters: DriverParameters, pacer: Pacer | None = None) -> None:
        self.paced = parameters.mode == "realtime"
        self._parameters, self._options = parameters, parameters.mock
        self._rig = SimulatedRig(_rig_parameters(parameters))
        self._pacer = pacer or Pacer(PERIOD_NS)
        self._random = random.Random(self._options.seed)
        self._commanded = threading.Semaphore(0)
        self._queue: deque[tuple[float, ...]] = deque()
        self._torque: tuple[float, ...] = ()
        self._tick = -1
        self.open()

    def open(self) -> None:
        """Connect; the first frame is due now."""
        self._torque = (0.0,) * len(self._parameters.joints)
        self._queue.clear()
        self._queue.extend([self._torque] * self._options.latency)
        self._commanded = threading.Semaphore(0)
        self._tick = -1

    def close(self) -> None:
        """Free the drives."""
        self._rig.rest()

    def receive(self, timeout: float) -> Frame | None:
        """Wait for the next frame, None if it is lost or nothing was commanded."""
        if self._tick < 0:
            self._pacer.start()
        else:
            if self.paced:
                self._pacer.wait(self._tick + 1)
            elif not self._commanded.acquire(timeout=timeout):
                return None
            # A command acts after those that are still on their way.
            self._queue.append(self._torque)
            self._rig.step(self._queue.popleft())
        self._tick += 1
        if self._random.random() < self._options.dropout:
            if not self.paced:
                self._commanded.release()  # nobody will answer what nobody has heard
            return None
        return Frame(self._tick, self._encoder(), self._transducer())

    def send(self, torque: Sequence[float]) -> None:
        """Command torques (n,), N·m."""
        self._torque = tuple(torque)
        self._commanded.release()

    def _encoder(self) -> tuple[int, ...]:
        sensor = self._parameters.encoder
        return tuple(
            (round(angle / sensor.resolution) + zero) % (1 << BITS)
            for angle, zero in zip(self._rig.position.tolist(), sensor.zero, strict=True)
        )

    def _transducer(self) -> tuple[int, ...]:
        sensor = self._parameters.transducer
        drift = self._options.drift * self._tick * PERIOD_NS / NS_PER_S
        return tuple(
            round((torque + drift) / sensor.resolution) + zero
            for torque, zero in zip(self._rig.torque.tolist(), sensor.zero, strict=True)
        )


def _rig_parameters(parameters: DriverParameters) -> SimulatorParameters:
    rig = SimulatorParameters.preset(
        joints=len(parameters.joints), friction=parameters.mock.friction
    )
    sensors = SensorParameters(
        encoder_resolution=abs(parameters.encoder.resolution),
        torque_resolution=abs(parameters.transducer.resolution),
    )
    return rig.model_copy(update={"sensors": sensors})
