"""The simulated rig as a device: commands in, samples out, and no torque after a fault."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from armimp_common.protection import TorqueLatch
from armimp_common.topics import PERIOD_NS
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.plant import IntegrationError, Plant
from armimp_sim.voluntary import ReadingNoise, VoluntaryTorque


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
        config = parameters.plant_config()
        super().__init__(config.joints)
        self._plant = Plant([config])
        self.position: NDArray[np.float64] = self._plant.position[0]
        self.torque: NDArray[np.float64] = self._plant.torque[0]
        self._voluntary = VoluntaryTorque(
            parameters.voluntary,
            joints=config.joints,
            period=config.period,
            seed=parameters.seed,
        )
        self._noise = ReadingNoise(config.sensors, joints=config.joints, seed=parameters.seed)
        self._command = np.zeros((1, config.joints))
        self.tick = 0
        self._compile(config.joints)

    @property
    def stamp_ns(self) -> int:
        """Time of the present sample since the start, ns."""
        return self.tick * PERIOD_NS

    def step(self, command: Sequence[float]) -> None:
        """Hold ``command`` (n,), N·m, for one period and sample again.

        A command that is not finite never reaches the plant: it latches the fault, and this and
        all further steps run with zero torque. After :meth:`fade` they run with a torque on its way
        to zero.

        Raises
        ------
        IntegrationError
            If the simulation itself broke down.
        """
        if not math.isfinite(sum(command)):
            self._refuse(command)
        self.obey(command)
        self.go_on_fading()
        self._command[0] = self.applied
        self._plant.tick(self._command, self._voluntary.take(1), self._noise.take(1))
        self.tick += 1

    def _refuse(self, command: Sequence[float]) -> None:
        """Latch the fault of a command that is not finite; a sum may be too large without one."""
        for joint, value in enumerate(command):
            if not math.isfinite(value):
                self.latch(f"command of joint {joint + 1} is not finite: {value}")

    def _compile(self, joints: int) -> None:
        """Compile the plant before time matters, and leave its state as it was."""
        state = self._plant.state()
        with suppress(IntegrationError):  # it will be reported when it happens in earnest
            self._plant.tick(np.zeros((1, joints)), np.zeros((1, joints)))
        self._plant.set_state(state)
