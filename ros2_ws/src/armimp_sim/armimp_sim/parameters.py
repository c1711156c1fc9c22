"""Parameters of the simulator node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_sim import presets
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import Sampling, Sensors
from armimp_sim.plant import PlantConfig
from armimp_sim.sensor_dynamics import ORDERS
from armimp_sim.sensor_model import LONGEST_DELAY, SensorModel
from armimp_sim.voluntary import VoluntaryConfig

WATCHDOG_TICKS = 5
"""Periods after which the simulated rig takes the torque away by default."""

Vector = tuple[float, ...]


class ArmParameters(Schema):
    """The human arm; matrices row by row."""

    posture: Vector = Field(description="θ_0 (rad)")
    inertia: Vector = Field(description="M_h, n×n row by row (kg·m²)")
    damping: Vector = Field(description="B_h, n×n row by row (N·m·s/rad)")
    stiffness: Vector = Field(description="K_h, n×n row by row (N·m/rad)")


class RobotParameters(Schema):
    """The exoskeleton, a planar chain (assumption)."""

    lengths: Vector = Field(description="length of each link (m)")
    moments: Vector = Field(description="moment of inertia about its own joint (kg·m²)")
    masses: Vector = Field(description="mass of each link (kg)")
    centres: Vector = Field(description="joint to centre of mass (m)")


class FrictionParameters(Schema):
    """LuGre friction of every joint (assumption)."""

    coulomb: Vector = Field(description="Fc (N·m)")
    static: Vector = Field(description="Fs (N·m)")
    sigma_0: Vector = Field(description="bristle stiffness (N·m/rad)")
    sigma_1: Vector = Field(description="bristle damping (N·m·s/rad)")
    sigma_2: Vector = Field(description="viscous friction (N·m·s/rad)")
    stribeck_velocity: Vector = Field(description="vs (rad/s)")


class SensorParameters(Schema):
    """Sensors; a resolution of 0 leaves a reading unquantised."""

    encoder_resolution: float = Field(ge=0.0, description="one count of the encoders (rad)")
    torque_resolution: float = Field(ge=0.0, description="one count of the transducers (N·m)")
    sampling: Sampling = Field(
        default=Sampling.BEFORE_UPDATE,
        description="instant of the torque reading: before_update or interval_mean",
    )
    torque_offset: Vector = Field(
        default=(0.0,), description="added to torque readings (N·m); one for all joints or each"
    )
    torque_drift: Vector = Field(
        default=(0.0,), description="how fast that grows (N·m/s); one for all joints or each"
    )
    torque_gain: Vector = Field(
        default=(1.0,), description="factor on torque readings (–); one for all joints or each"
    )
    torque_delay: float = Field(
        default=0.0,
        ge=0.0,
        le=LONGEST_DELAY,
        description="delay of torque readings (s), in steps of the integration",
    )
    torque_cutoff: float = Field(
        default=0.0, ge=0.0, description="anti-alias low-pass of the torque (Hz); 0: none"
    )
    torque_order: int = Field(
        default=1, ge=1, le=ORDERS, description="order of that Butterworth low-pass"
    )


class ActuatorParameters(Schema):
    """Drives."""

    lag: float = Field(
        default=0.0,
        ge=0.0,
        le=0.1,
        description="time constant with which torque follows commands (s); 0: at once",
    )


class VoluntaryParameters(Schema):
    """Voluntary torque of the person."""

    rms: float = Field(default=0.0, ge=0.0, description="rms of every joint (N·m)")
    cutoff: float = Field(default=2.0, gt=0.0, description="cut-off frequency (Hz)")


class RealtimeParameters(SchedulingParameters):
    """What counts in mode realtime only."""

    spin: float = Field(
        default=0.0,
        ge=0.0,
        le=0.001,
        description="last part of each wait in which the clock is asked over and over (s)",
    )


class SimulatorParameters(Schema):
    """All parameters of the node ``arm_sim``."""

    joints: tuple[str, ...] = Field(description="names of the joints, from the shoulder outwards")
    seed: int = Field(default=1, ge=0, description="seed of the voluntary torque")
    mode: Literal["lockstep", "realtime"] = Field(
        default="lockstep",
        description="lockstep: one step for each command received; realtime: one each millisecond",
    )
    realtime: RealtimeParameters = RealtimeParameters()
    watchdog_ticks: int = Field(
        default=WATCHDOG_TICKS,
        ge=1,
        le=100,
        description="in realtime, periods without a command, or by which commands are behind, "
        "until the drives take the torque away",
    )
    substeps: int = Field(default=100, ge=1, description="RK4 steps in one control period of 1 ms")
    arm: ArmParameters
    robot: RobotParameters
    friction: FrictionParameters
    sensors: SensorParameters
    actuators: ActuatorParameters = ActuatorParameters()
    voluntary: VoluntaryParameters = VoluntaryParameters()

    @classmethod
    def preset(
        cls, *, joints: int = 2, friction: int = 3, resolution: int = 3, seed: int = 1
    ) -> SimulatorParameters:
        """Parameters of the study's rig at given friction and resolution levels (0 to 3)."""
        arm, robot = presets.human_arm(joints), presets.robot(joints)
        laws = presets.friction(friction, joints)
        sensors = presets.sensors(resolution)
        return cls(
            joints=presets.JOINT_NAMES[joints],
            seed=seed,
            arm=ArmParameters(
                posture=_flat(arm.posture),
                inertia=_flat(arm.inertia),
                damping=_flat(arm.damping),
                stiffness=_flat(arm.stiffness),
            ),
            robot=RobotParameters(
                lengths=_flat(robot.lengths),
                moments=_flat(robot.moments),
                masses=_flat(robot.masses),
                centres=_flat(robot.centres),
            ),
            friction=FrictionParameters(
                **{
                    name: tuple(getattr(law, name) for law in laws)
                    for name in FrictionParameters.model_fields
                }
            ),
            sensors=SensorParameters(
                encoder_resolution=sensors.encoder_resolution,
                torque_resolution=sensors.torque_resolution,
            ),
        )

    def human_arm(self) -> HumanArm:
        """The arm with its matrices in shape."""
        return HumanArm(
            posture=self._vector("arm.posture", self.arm.posture),
            inertia=self._matrix("arm.inertia", self.arm.inertia),
            damping=self._matrix("arm.damping", self.arm.damping),
            stiffness=self._matrix("arm.stiffness", self.arm.stiffness),
        )

    def planar_chain(self) -> PlanarChain:
        """The exoskeleton."""
        return PlanarChain(
            **{
                name: self._vector(f"robot.{name}", getattr(self.robot, name))
                for name in RobotParameters.model_fields
            }
        )

    def plant_config(self) -> PlantConfig:
        """Everything that the plant needs.

        Raises
        ------
        ConfigurationError
            If a shape or a value is wrong; the message names the parameter.
        """
        values = {
            name: self._vector(f"friction.{name}", getattr(self.friction, name))
            for name in FrictionParameters.model_fields
        }
        return PlantConfig(
            arm=self.human_arm(),
            robot=self.planar_chain(),
            friction=tuple(
                LuGre(**{name: float(value[i]) for name, value in values.items()})
                for i in range(len(self.joints))
            ),
            sensors=Sensors(
                encoder_resolution=self.sensors.encoder_resolution,
                torque_resolution=self.sensors.torque_resolution,
                sampling=self.sensors.sampling,
            ),
            imperfections=self.imperfections(),
            period=PERIOD_NS / NS_PER_S,
            substeps=self.substeps,
        )

    def imperfections(self) -> SensorModel:
        """What transducers and drives lack.

        Raises
        ------
        ConfigurationError
            If a value makes no sense.
        """
        sensors = self.sensors
        return SensorModel(
            offset=sensors.torque_offset,
            drift=sensors.torque_drift,
            gain=sensors.torque_gain,
            delay=sensors.torque_delay,
            cutoff=sensors.torque_cutoff,
            order=sensors.torque_order,
            actuator_lag=self.actuators.lag,
        )

    def voluntary_config(self) -> VoluntaryConfig:
        """The voluntary torque."""
        return VoluntaryConfig(rms=self.voluntary.rms, cutoff=self.voluntary.cutoff)

    def _vector(self, name: str, values: Vector) -> NDArray[np.float64]:
        if len(values) != len(self.joints):
            raise ConfigurationError(
                f"parameter '{name}' has {len(values)} values for {len(self.joints)} joints"
            )
        return np.array(values)

    def _matrix(self, name: str, values: Vector) -> NDArray[np.float64]:
        n = len(self.joints)
        if len(values) != n * n:
            raise ConfigurationError(
                f"parameter '{name}' has {len(values)} values, needs {n * n} for {n} joints"
            )
        return np.array(values).reshape(n, n)


def _flat(values: NDArray[np.float64]) -> Vector:
    return tuple(float(value) for value in values.ravel())
