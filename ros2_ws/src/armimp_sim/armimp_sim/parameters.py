"""Parameters of the simulator node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema, matrix, vector
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_sim import presets
from armimp_sim.model.arm import CuffParameters, HumanArm, MuscleParameters, ReflexParameters
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import ActuatorParameters, PlanarChain
from armimp_sim.model.sensors import SensorParameters
from armimp_sim.plant import PlantConfig
from armimp_sim.voluntary import VoluntaryParameters

WATCHDOG_TICKS = 5
"""Periods after which the simulated rig takes the torque away by default."""

Vector = tuple[float, ...]


class ArmParameters(Schema):
    """The human arm; matrices row by row."""

    posture: Vector
    """Posture θ_0 of the arm, in which it has no elastic torque (rad)."""
    inertia: Vector
    """Inertia M_h of the arm, n×n row by row (kg·m²)."""
    damping: Vector
    """Damping B_h of the arm, n×n row by row (N·m·s/rad)."""
    stiffness: Vector
    """Stiffness K_h of the arm, n×n row by row (N·m/rad)."""


class RobotParameters(Schema):
    """The exoskeleton, a planar chain (assumption)."""

    lengths: Vector
    """Length of each link of the robot (m)."""
    moments: Vector
    """Moment of inertia of each link of the robot about its own joint (kg·m²)."""
    masses: Vector
    """Mass of each link of the robot (kg)."""
    centres: Vector
    """Distance from the joint to the centre of mass of each link of the robot (m)."""


class FrictionParameters(Schema):
    """LuGre friction of every joint (assumption)."""

    coulomb: Vector
    """Coulomb friction Fc of each joint (N·m)."""
    static: Vector
    """Static friction Fs of each joint (N·m)."""
    sigma_0: Vector
    """Bristle stiffness σ0 of the friction of each joint (N·m/rad)."""
    sigma_1: Vector
    """Bristle damping σ1 of the friction of each joint (N·m·s/rad)."""
    sigma_2: Vector
    """Viscous friction σ2 of each joint (N·m·s/rad)."""
    stribeck_velocity: Vector
    """Stribeck velocity vs of each joint (rad/s)."""


class SimulatorParameters(Schema):
    """All parameters of the node ``arm_sim``."""

    joints: tuple[str, ...]
    """Names of the joints, from the shoulder outwards."""
    seed: int = Field(default=1, ge=0)
    """Seed of voluntary torque, tremor, and noise of the sensors."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """lockstep: one step for each command received; realtime: one each millisecond."""
    realtime: SchedulingParameters = SchedulingParameters()
    watchdog_ticks: int = Field(default=WATCHDOG_TICKS, ge=1, le=100)
    """Control periods without a command, or by which commands are behind, after which the drives
    take the torque away in mode realtime."""
    substeps: int = Field(default=100, ge=1)
    """RK4 steps in one control period of 1 ms."""
    arm: ArmParameters
    robot: RobotParameters
    friction: FrictionParameters
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
        laws = presets.friction(friction, joints)
        sensors = presets.sensors(resolution)
        real = presets.realistic(joints) if rig == "realistic" else {}
        if real:
            noisy = sensors.torque.model_copy(update={"noise": presets.TRANSDUCER_NOISE})
            sensors = sensors.model_copy(update={"torque": noisy})
        return cls(
            joints=presets.JOINT_NAMES[joints],
            seed=seed,
            arm=ArmParameters(**_flat(presets.human_arm(joints))),
            robot=RobotParameters(**_flat(presets.robot(joints))),
            friction=FrictionParameters(
                **{
                    name: tuple(getattr(law, name) for law in laws)
                    for name in FrictionParameters.model_fields
                }
            ),
            sensors=sensors,
            **real,
        )

    def human_arm(self) -> HumanArm:
        """The arm with its matrices in shape."""
        n = len(self.joints)
        shapes = {
            name: vector if name == "posture" else matrix for name in ArmParameters.model_fields
        }
        return HumanArm(
            **{name: of(f"arm.{name}", getattr(self.arm, name), n) for name, of in shapes.items()}
        )

    def plant_config(self) -> PlantConfig:
        """Everything that the plant needs.

        Raises
        ------
        ConfigurationError
            If a shape or a value is wrong; the message names the parameter.
        """
        robot, values = (
            {
                name: vector(f"{group}.{name}", numbers, len(self.joints))
                for name, numbers in getattr(self, group)
            }
            for group in ("robot", "friction")
        )
        return PlantConfig(
            arm=self.human_arm(),
            robot=PlanarChain(**robot),
            friction=tuple(
                LuGre(**{name: float(value[i]) for name, value in values.items()})
                for i in range(len(self.joints))
            ),
            sensors=self.sensors,
            actuators=self.actuators,
            reflex=self.reflex,
            muscle=self.muscle,
            cuff=self.cuff,
            period=PERIOD_NS / NS_PER_S,
            substeps=self.substeps,
        )


def _flat(model: HumanArm | PlanarChain) -> dict[str, Vector]:
    """Arrays of a model by name, row by row."""
    return {name: tuple(values.ravel().tolist()) for name, values in vars(model).items()}
