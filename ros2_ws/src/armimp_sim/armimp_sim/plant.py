"""The plant as the rest of the world sees it: torques in, quantised readings out, once per tick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armimp_common.compiled import compiled_entry
from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_sim import dynamics, sensor_model
from armimp_sim.model.arm import HumanArm
from armimp_sim.model.friction import LuGre
from armimp_sim.model.robot import PlanarChain
from armimp_sim.model.sensors import Sampling, SensorParameters, quantise
from armimp_sim.simd.lanes import Tag

RK4_LIMIT = 2.7
"""|h·λ| on the real axis up to which explicit RK4 is stable (2.785, with a margin)."""
RK4_RADIUS = 2.6
"""|h·λ| up to which it is stable for any λ of a decaying motion; worst are swings with ζ = 0.54."""


class IntegrationError(ArmimpError):
    """The explicit integration left its stability region or produced non-finite numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlantConfig:
    """One arm in one exoskeleton.

    Parameters
    ----------
    arm, robot : with the same number of joints n
    friction : one law per joint
    sensors : SensorParameters
    actuator_lag : time constant with which the torque of the drives follows commands, s; 0: at once
    period : s, between samples; commands are held over it
    substeps : RK4 steps per period

    Raises
    ------
    ConfigurationError
        If the numbers of joints disagree, M_r + M_h is not positive definite (symmetric part), or
        the friction at rest is too stiff for the step.
    """

    arm: HumanArm
    robot: PlanarChain
    friction: tuple[LuGre, ...]
    sensors: SensorParameters
    actuator_lag: float = 0.0
    period: float = 1e-3
    substeps: int = 100

    def __post_init__(self) -> None:
        n = self.arm.joints
        if self.robot.joints != n or len(self.friction) != n:
            raise ConfigurationError(
                f"plant: arm has {n} joints, robot {self.robot.joints}, "
                f"friction {len(self.friction)}"
            )
        self.sensors.check(n)
        if not 0.0 <= self.actuator_lag < np.inf:
            raise ConfigurationError(
                f"actuators: lag must not be negative, got {self.actuator_lag} s"
            )
        if not self.period > 0.0 or self.substeps < 1:
            raise ConfigurationError(
                f"plant: period {self.period} s with {self.substeps} substeps is not a step"
            )
        mass = self.mass_matrix()
        smallest = float(np.linalg.eigvalsh(0.5 * (mass + mass.T))[0])
        if not smallest > 0.0:
            raise ConfigurationError(
                "plant: M_r + M_h must have a positive definite symmetric part, "
                f"its smallest eigenvalue is {smallest:.3g} kg·m²"
            )
        self._check_step(mass)

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return self.arm.joints

    @property
    def step(self) -> float:
        """RK4 step h, s."""
        return self.period / self.substeps

    def mass_matrix(self) -> NDArray[np.float64]:
        """M_r(θ_0) + M_h (n, n), kg·m²."""
        return self.robot.mass_matrix(self.arm.posture) + self.arm.inertia

    def _check_step(self, mass: NDArray[np.float64]) -> None:
        """Refuse a step which is unstable for the linear system with all joints stuck."""
        n = self.joints
        sigma_0 = np.diag([law.sigma_0 for law in self.friction])
        damping = np.diag([law.sigma_1 + law.sigma_2 for law in self.friction])
        inverse = np.linalg.inv(mass)
        system = np.block(
            [
                [np.zeros((n, n)), np.eye(n)],
                [
                    -inverse @ (self.arm.stiffness + sigma_0),
                    -inverse @ (self.arm.damping + damping),
                ],
            ]
        )
        largest = float(np.max(np.abs(np.linalg.eigvals(system)))) * self.step
        if not largest < RK4_RADIUS:
            raise ConfigurationError(
                f"plant: step {self.step:.3g} s is too long for the stuck joints: "
                f"|h·λ| = {largest:.3g}, must be below {RK4_RADIUS}"
            )


class Plant:
    """A batch of plants, one per lane, that share numbers of joints and time step.

    Reading arrays are reused from tick to tick; copy what must last.

    Parameters
    ----------
    configs : one configuration per lane

    Attributes
    ----------
    position : (lanes, n) encoder readings θ, rad
    torque : (lanes, n) torque transducer readings, torque on the arm, N·m
    sensor_lanes : of :mod:`armimp_sim.sensor_model`; None where readings and drives are direct
    """

    def __init__(self, configs: Sequence[PlantConfig]) -> None:
        first = configs[0]
        for config in configs:
            if (config.joints, config.period, config.substeps, config.sensors.sampling) != (
                first.joints,
                first.period,
                first.substeps,
                first.sensors.sampling,
            ):
                raise ConfigurationError(
                    "plant: lanes must agree in joints, period, substeps and sampling"
                )
        self.config = first
        n, lanes = first.joints, len(configs)
        width = dynamics.width_for(lanes)
        blocks = -(-lanes // width)
        self.batch = np.zeros((blocks, dynamics.rows(n) * width))
        self.joint_tag, self.width_tag = (0.0,) * n, (0.0,) * width
        self.resolutions = np.array(
            [(c.sensors.encoder_resolution, c.sensors.torque_resolution) for c in configs]
        )
        self.sensor_lanes = _sensor_lanes(configs)
        self._at_first = None if self.sensor_lanes is None else self.sensor_lanes.copy()
        self.position = np.zeros((lanes, n))
        self.torque = np.zeros((lanes, n))
        for lane in range(blocks * width):
            # The last block is filled up with plants that nothing ever moves.
            self._of_lane(lane)[:] = _pack(configs[min(lane, lanes - 1)])
        self._sample()

    def tick(self, command: NDArray[np.float64], voluntary: NDArray[np.float64]) -> None:
        """Hold the inputs for one period, then read the sensors.

        Parameters
        ----------
        command : (lanes, n) joint torques, N·m
        voluntary : (lanes, n) voluntary torque d, N·m

        Raises
        ------
        ValueError
            If an input has another shape; compiled code would read beyond its end.
        IntegrationError
            If the friction got too stiff for the step, or the state is not finite.
        """
        if command.shape != self.position.shape or voluntary.shape != self.position.shape:
            raise ValueError(
                f"plant: command {command.shape} and voluntary torque {voluntary.shape} must "
                f"both be {self.position.shape}"
            )
        ratio = tick(
            self.batch,
            self.joint_tag,
            self.width_tag,
            self.config.substeps,
            self.config.step,
            self.config.sensors.sampling is Sampling.INTERVAL_MEAN,
            self.sensor_lanes,
            self.resolutions,
            command,
            voluntary,
            self.position,
            self.torque,
        )
        check_ratio(ratio, self.config.step)

    def state(self) -> NDArray[np.float64]:
        """Exact (θ, v, z) of every lane: (lanes, 3, n). A copy."""
        n, lanes = self.config.joints, len(self.position)
        return np.array([self._of_lane(lane)[: 3 * n].reshape(3, n) for lane in range(lanes)])

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Put the plants into the given (θ, v, z), (lanes, 3, n), and read the sensors anew.

        Filters have seen the present torque for long, drives have no torque, drifts begin.
        """
        for lane, values in enumerate(state):
            self._of_lane(lane)[: values.size] = values.ravel()
        if self.sensor_lanes is not None:
            self.sensor_lanes[:] = self._at_first
        self._sample()

    def _of_lane(self, lane: int) -> NDArray[np.float64]:
        """All quantities of one lane, a view."""
        blocks, width = len(self.batch), len(self.width_tag)
        of_lane: NDArray[np.float64] = self.batch.reshape(blocks, -1, width)[
            lane // width, :, lane % width
        ]
        return of_lane

    def _sample(self) -> None:
        if self.sensor_lanes is None:
            dynamics.sample_now(self.batch, self.joint_tag, self.width_tag)
        else:
            sensor_model.settle(self.batch, self.joint_tag, self.width_tag, self.sensor_lanes)
        read(
            self.batch, self.joint_tag, self.width_tag, self.resolutions, self.position, self.torque
        )


def check_ratio(ratio: float, step: float) -> None:
    """Check that RK4 was stable for the bristles.

    Parameters
    ----------
    ratio : h·σ0|v|/g(v), from :func:`tick`
    step : h, s

    Raises
    ------
    IntegrationError
        If the ratio is not below :data:`RK4_LIMIT`, or not a number.
    """
    if ratio < RK4_LIMIT:
        return
    if np.isnan(ratio):
        raise IntegrationError(
            "plant: the state is not finite any more: a command was not, or the joints move too "
            f"fast for h = {step:.3g} s"
        )
    raise IntegrationError(
        f"plant: h·σ0|v|/g(v) = {ratio:.3g} with h = {step:.3g} s, must stay below {RK4_LIMIT}"
    )


def _sensor_lanes(configs: Sequence[PlantConfig]) -> NDArray[np.float64] | None:
    """Sensors and drives of all lanes, or None if all of them are direct."""
    if all(one.sensors.direct and not one.actuator_lag for one in configs):
        return None
    step, substeps = configs[0].step, configs[0].substeps
    periods = max(sensor_model.whole_periods(one.sensors, step, substeps) for one in configs)
    return np.array(
        [
            sensor_model.lane_numbers(
                one.sensors,
                one.actuator_lag,
                joints=one.joints,
                step=step,
                substeps=substeps,
                periods=periods,
            )
            for one in configs
        ]
    )


def _pack(config: PlantConfig) -> NDArray[np.float64]:
    """All rows of one lane, at rest in the posture."""
    n = config.joints
    vectors = np.zeros((dynamics.VECTORS, n))
    arm, friction = config.arm, config.friction
    vectors[dynamics.THETA] = vectors[dynamics.POSTURE] = arm.posture
    # Without friction g(v) may be anything but zero, which it divides.
    vectors[dynamics.COULOMB] = [law.coulomb if law.coulomb > 0.0 else 1.0 for law in friction]
    vectors[dynamics.STRIBECK] = [law.static - law.coulomb for law in friction]
    vectors[dynamics.INVERSE_STRIBECK_VELOCITY] = [1.0 / law.stribeck_velocity for law in friction]
    vectors[dynamics.SIGMA_0] = [law.sigma_0 for law in friction]
    vectors[dynamics.SIGMA_1] = [law.sigma_1 for law in friction]
    vectors[dynamics.SIGMA_2] = [law.sigma_2 for law in friction]
    matrices = np.zeros((dynamics.MATRICES, n, n))
    matrices[dynamics.INERTIA] = arm.inertia
    matrices[dynamics.DAMPING] = arm.damping
    matrices[dynamics.STIFFNESS] = arm.stiffness
    matrices[dynamics.CHAIN] = config.robot.coefficients()
    return np.concatenate([vectors.ravel(), matrices.ravel()])


@compiled_entry
def read(
    w: NDArray[np.float64],
    joints: Tag,
    width: Tag,
    resolutions: NDArray[np.float64],
    position: NDArray[np.float64],
    torque: NDArray[np.float64],
) -> None:
    """Quantised readings of the present sample.

    Parameters
    ----------
    w, joints, width : the batch, as in :mod:`armimp_sim.dynamics`
    resolutions : (lanes, 2) of encoders, rad, and torque transducers, N·m
    position, torque : (lanes, n), written, rad and N·m
    """
    n, m = len(joints), len(width)
    for lane in range(position.shape[0]):
        for i in range(n):
            angle = w[dynamics.place(lane, dynamics.THETA * n + i, m)]
            position[lane, i] = quantise(angle, resolutions[lane, 0])
            load = w[dynamics.place(lane, dynamics.TORQUE * n + i, m)]
            torque[lane, i] = quantise(load, resolutions[lane, 1])


@compiled_entry
def tick(  # noqa: PLR0913, PLR0917 (compiled code takes no objects)
    w: NDArray[np.float64],
    joints: Tag,
    width: Tag,
    substeps: int,
    step: float,
    interval_mean: bool,
    lanes: NDArray[np.float64] | None,
    resolutions: NDArray[np.float64],
    command: NDArray[np.float64],
    voluntary: NDArray[np.float64],
    position: NDArray[np.float64],
    torque: NDArray[np.float64],
) -> float:
    """One period of all lanes: hold the inputs, integrate, read.

    Parameters
    ----------
    w, joints, width : the batch, as in :mod:`armimp_sim.dynamics`
    substeps, step : number and length (s) of the RK4 steps
    interval_mean : whether torque is the mean over the period
    lanes : of :mod:`armimp_sim.sensor_model`, updated; None where all is direct
    resolutions : (lanes, 2) of encoders, rad, and torque transducers, N·m
    command, voluntary : (lanes, n) N·m
    position, torque : (lanes, n), written, rad and N·m

    Returns
    -------
    float
        Largest h·σ0|v|/g(v) at the end, for :func:`check_ratio`.
    """
    n, m = len(joints), len(width)
    for lane in range(command.shape[0]):
        for i in range(n):
            w[dynamics.place(lane, dynamics.COMMAND * n + i, m)] = command[lane, i]
            w[dynamics.place(lane, dynamics.VOLUNTARY * n + i, m)] = voluntary[lane, i]
    # Of the two only the one that is needed gets compiled, as None is a type.
    if lanes is None:
        dynamics.advance(w, joints, width, substeps, step, interval_mean)
    else:
        sensor_model.advance(w, joints, width, substeps, step, interval_mean, lanes)
    read(w, joints, width, resolutions, position, torque)
    return dynamics.stiffness_ratio(w, joints, width, step)
