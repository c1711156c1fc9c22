"""Parameters of the simulator node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.protection import WATCHDOG_PERIODS
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema
from armimp_common.topics import PERIOD
from armimp_sim import presets
from armimp_sim.model.arm import CuffParameters, HumanArm, MuscleParameters, ReflexParameters
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import ActuatorParameters, PlanarChain
from armimp_sim.model.sensors import SensorParameters
from armimp_sim.plant import PlantConfig
from armimp_sim.voluntary import VoluntaryParameters


class SimulatorParameters(Schema):
    """All parameters of the node ``arm_sim``."""

    joints: tuple[str, ...] = Field(min_length=1, max_length=7)
    """Names of the joints, from the shoulder outwards."""
    seed: int = Field(default=1, ge=0)
    """Seed of voluntary torque, tremor, and noise of the sensors."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """lockstep: one step for each command received; realtime: one each millisecond."""
    realtime: SchedulingParameters = SchedulingParameters()
    watchdog_ticks: int = Field(default=WATCHDOG_PERIODS, ge=1, le=100)
    """Control periods without a command, or by which commands are behind, after which the drives
    take the torque away in mode realtime."""
    substeps: int = Field(default=100, ge=1)
    """RK4 steps in one control period of 1 ms."""
    arm: HumanArm
    robot: PlanarChain
    friction: LuGre
    sensors: SensorParameters
    actuators: ActuatorParameters = ActuatorParameters()
    voluntary: VoluntaryParameters = VoluntaryParameters()
    reflex: ReflexParameters = ReflexParameters()
    muscle: MuscleParameters = MuscleParameters()
    cuff: CuffParameters = CuffParameters()

    @classmethod
    def preset(
        cls,
        *,
        joints: int = 2,
        friction: int = 3,
        resolution: int = 3,
        seed: int = 1,
        rig: presets.Rig = "paper",
    ) -> SimulatorParameters:
        """Parameters of the study's rig at given friction and resolution levels (0 to 3).

        With ``rig="realistic"`` it has what a good real one has beside
        (:func:`armimp_sim.presets.realistic`).
        """
        sensors = presets.sensors(resolution)
        real = presets.realistic(joints) if rig == "realistic" else {}
        if real:
            noisy = sensors.torque.model_copy(update={"noise": presets.TRANSDUCER_NOISE})
            sensors = sensors.model_copy(update={"torque": noisy})
        return cls(
            joints=presets.JOINT_NAMES[joints],
            seed=seed,
            arm=presets.human_arm(joints),
            robot=presets.robot(joints),
            friction=presets.friction(friction, joints),
            sensors=sensors,
            **real,
        )

    def plant_config(self) -> PlantConfig:
        """Everything that the plant needs.

        Raises
        ------
        ConfigurationError
            If a shape or a value is wrong; the message names the parameter.
        """
        if self.arm.joints != len(self.joints):
            raise ConfigurationError(
                f"'arm.posture' has {self.arm.joints} values, needs {len(self.joints)}"
            )
        return PlantConfig(
            arm=self.arm,
            robot=self.robot,
            friction=self.friction,
            sensors=self.sensors,
            actuators=self.actuators,
            reflex=self.reflex,
            muscle=self.muscle,
            cuff=self.cuff,
            period=PERIOD,
            substeps=self.substeps,
        )
