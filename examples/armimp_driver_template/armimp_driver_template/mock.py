"""A mock device: the simulated rig behind raw counts, with the faults of a real bus."""

from __future__ import annotations

import math
import random
import threading
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from armimp_common.realtime import Pacer
from armimp_driver_template.conversion import BITS, Drives, Sensors, Wiring
from armimp_driver_template.device import Frame
from armimp_driver_template.parameters import DriverParameters
from armimp_sim.model.robot import ActuatorParameters
from armimp_sim.model.sensors import ReadingParameters, SensorParameters
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.simulator import SimulatedRig


class MockDevice:
    """The rig of the study, sampled each millisecond, or after each command.

    Commands act `latency` periods late, frames get lost, encoders wrap, transducers have an offset
    that drifts, a low-pass and a delay, and drives lag. Signs, gears and zeros of its sensors and
    drives, and the order of its joints, are those in the parameters of the driver.

    Parameters
    ----------
    parameters : DriverParameters
    pacer : Pacer, optional
        Keeps the time in real time.

    Attributes
    ----------
    names : of its joints, in the order of frames and commands
    paced : whether samples come by themselves
    """

    def __init__(self, parameters: DriverParameters, pacer: Pacer | None = None) -> None:
        self.paced = parameters.mode == "realtime"
        self._options = parameters.mock
        joints = parameters.names_at_device()
        self.names = parameters.mock.names or joints
        # The joints of the rig, from the shoulder outwards, have the order of the frames.
        self._wiring, n = Wiring(self.names, joints), len(joints)
        self._encoders = Sensors("encoder", parameters.encoder, n)
        self._transducers = Sensors("transducer", parameters.transducer, n)
        self._drives = Drives(parameters.drive, n)
        self._rig = SimulatedRig(self._rig_parameters(parameters))
        self._pacer = pacer or Pacer()
        self._random = random.Random(self._options.seed)
        self._commanded = threading.Semaphore(0)
        self._queue: deque[tuple[float, ...]] = deque()
        self._torque: tuple[float, ...] = ()
        self._tick = -1
        self.open()

    def open(self) -> None:
        """Connect; the first frame is due now."""
        self._torque = (0.0,) * len(self.names)
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
            # A command acts after those that are still under way.
            self._queue.append(self._torque)
            self._rig.step(self._queue.popleft())
        self._tick += 1
        if self._random.random() < self._options.dropout:
            if not self.paced:
                self._commanded.release()  # nobody answers a frame that was lost
            return None
        encoder = self._shown(self._encoders, self._rig.position)
        wrapped = tuple(count % (1 << BITS) for count in encoder)
        return Frame(self._tick, wrapped, self._shown(self._transducers, self._rig.torque))

    def send(self, torque: Sequence[float]) -> None:
        """Command torques of the drives (n,), N·m."""
        torques = self._drives.of_joints(self._wiring.to_joints(torque))
        self._torque = self._wiring.to_device(torques)
        self._commanded.release()

    def _shown(self, sensors: Sensors, values: NDArray[np.float64]) -> tuple[int, ...]:
        """Counts in the order of the frames."""
        return self._wiring.to_device(sensors.counts(self._wiring.to_joints(values.tolist())))

    def _rig_parameters(self, parameters: DriverParameters) -> SimulatorParameters:
        options = parameters.mock
        rig = SimulatorParameters.preset(joints=len(parameters.joints), friction=options.friction)
        # Counts round the readings; if they are equal for all joints, the rig can do it.
        sensors = SensorParameters(
            position=ReadingParameters(resolution=self._encoders.count),
            torque=ReadingParameters(
                resolution=self._transducers.count,
                offset=options.offset,
                drift=options.drift,
                delay=options.delay,
                cutoff=options.cutoff,
            ),
        )
        lag = options.lag
        actuators = ActuatorParameters(bandwidth=0.5 / math.pi / lag if lag else 0.0)
        return rig.model_copy(update={"sensors": sensors, "actuators": actuators})
