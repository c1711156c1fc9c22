"""Parameters of the simulator node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from operator import attrgetter
from typing import Literal

import numpy as np
from pydantic import Field

from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.protection import WATCHDOG_PERIODS
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema, require_length
from armimp_common.topics import PERIOD
from armimp_sim import presets
from armimp_sim.model.arm import CuffParameters, HumanArm, MuscleParameters, ReflexParameters
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import ActuatorParameters, PlanarChain
from armimp_sim.model.sensors import ReadingParameters, SensorParameters
from armimp_sim.voluntary import VoluntaryParameters

RK4_RADIUS = 2.6
"""|h·λ| up to which explicit RK4 is stable for any λ of a decaying motion; the worst are
oscillations with ζ = 0.54."""


class SimulatorParameters(Schema):
    """All parameters of the node ``arm_sim``: one arm in one exoskeleton.

    With a soft cuff the plant has 2n coordinates: first the n joints of the robot, then those of
    the arm. Its equations are those of a rigid arm on a chain whose outer n links are massless; arm
    and cuff are in its inertia, damping and stiffness. The torque of that arm on the first n
    coordinates is then the torque of the cuff, which the transducers measure.
    """

    joints: tuple[str, ...] = Field(min_length=1, max_length=7)
    """Names of the joints, from the shoulder outwards."""
    seed: int = Field(default=1, ge=0)
    """Seed of voluntary torque, tremor, and noise of the sensors."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """lockstep: one step for each command received; realtime: one step every millisecond."""
    realtime: SchedulingParameters = SchedulingParameters()
    watchdog_ticks: int = Field(default=WATCHDOG_PERIODS, ge=1, le=100)
    """Control periods without a command, or by which commands lag behind, after which the drives
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
        """Return parameters of the study's rig at given friction and resolution levels (0 to 3).

        With ``rig="realistic"`` it also has what a good real rig has beyond that, see
        :func:`armimp_sim.presets.realistic`.
        """
        realistic = rig == "realistic"
        return cls(
            joints=presets.JOINT_NAMES[joints],
            seed=seed,
            arm=presets.human_arm(joints),
            robot=presets.robot(joints),
            friction=presets.friction(friction, joints),
            sensors=presets.sensors(resolution, presets.TRANSDUCER_NOISE if realistic else 0.0),
            **(presets.realistic(joints) if realistic else {}),
        )

    @property
    def soft(self) -> bool:
        """Whether a cuff lets arm and robot move against each other."""
        return self.cuff.stiffness > 0.0

    @property
    def ideal(self) -> bool:
        """Whether drives and readings are ideal, but for rounding, and the arm is M, B, K alone."""
        rounded = SensorParameters(
            position=ReadingParameters(resolution=self.sensors.position.resolution),
            torque=ReadingParameters(resolution=self.sensors.torque.resolution),
        )
        person = (self.reflex, self.muscle) == (ReflexParameters(), MuscleParameters())
        return person and (self.actuators, self.sensors) == (ActuatorParameters(), rounded)

    def coordinates(self) -> tuple[FloatArray, ...]:
        """Return inertia without the robot's, damping, stiffness, and coefficients of the chain.

        Each is (n, n), or (2n, 2n) with a soft cuff, in the units of the arm.
        """
        arm, chain = self.arm, self.robot.coefficients()
        if not self.soft:
            return arm.M, arm.B, arm.K, chain
        nothing = np.zeros_like(chain)

        def cuffed(value: float, of_arm: FloatArray) -> FloatArray:
            cuff = value * np.eye(arm.joints)
            return np.block([[cuff, -cuff], [-cuff, cuff + of_arm]])

        return (
            cuffed(0.0, arm.M),
            cuffed(self.cuff.damping, arm.B),
            cuffed(self.cuff.stiffness, arm.K),
            np.block([[chain, nothing], [nothing, nothing]]),
        )

    def mass_matrix(self) -> FloatArray:
        """Return the inertia of all coordinates in the posture, kg·m²; M_r(θ_0) + M_h if rigid."""
        inertia: FloatArray = self.coordinates()[0].copy()
        n = self.arm.joints
        inertia[:n, :n] += self.robot.mass_matrix(self.arm.theta_0)
        return inertia

    def check(self, period: float = PERIOD) -> None:
        """Check that this is a rig that can be simulated.

        Parameters
        ----------
        period : time between samples, s

        Raises
        ------
        ConfigurationError
            If the numbers of joints disagree, M_r + M_h is not positive definite (symmetric part),
            or friction at rest or the cuff is too stiff for the step.
        """
        n = len(self.joints)
        for name in ("arm.posture", "robot.lengths"):
            require_length(name, attrgetter(name)(self), n, n)
        for group in ("sensors.position", "sensors.torque", "reflex", "muscle"):
            for name, values in attrgetter(group)(self):
                if isinstance(values, tuple):
                    require_length(f"{group}.{name}", values, n, 1, n)
        mass = self.mass_matrix()
        smallest = float(np.linalg.eigvalsh(0.5 * (mass + mass.T))[0])
        if not smallest > 0.0:
            raise ConfigurationError(
                f"plant: {'M_r and M_h' if self.soft else 'M_r + M_h'} must have a positive "
                f"definite symmetric part, its smallest eigenvalue is {smallest:.3g} kg·m²"
            )
        self._check_step(mass, period / self.substeps)

    def _check_step(self, mass: FloatArray, step: float) -> None:
        """Refuse a step that is unstable for the linear system with all joints stuck."""
        _, damping, stiffness, _ = (one.copy() for one in self.coordinates())
        law, robot = self.friction.of_joints(self.arm.joints), np.arange(self.arm.joints)
        stiffness[robot, robot] += law["sigma_0"]
        damping[robot, robot] += law["sigma_1"] + law["sigma_2"]
        inverse = np.linalg.inv(mass)
        system = np.block(
            [
                [np.zeros_like(mass), np.eye(len(mass))],
                [-inverse @ stiffness, -inverse @ damping],
            ]
        )
        largest = float(np.max(np.abs(np.linalg.eigvals(system)))) * step
        if not largest < RK4_RADIUS:
            raise ConfigurationError(
                f"plant: step {step:.3g} s is too long for the "
                f"{'cuff and the ' if self.soft else ''}stuck joints: "
                f"|h·λ| = {largest:.3g}, must be below {RK4_RADIUS}"
            )
