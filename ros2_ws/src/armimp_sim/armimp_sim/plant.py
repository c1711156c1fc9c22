"""The plant from outside: torques in, quantised readings out, once per tick."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.compiled import compiled_entry
from armimp_common.errors import ArmimpError, ConfigurationError
from armimp_common.topics import PERIOD
from armimp_sim import dynamics, real_rig
from armimp_sim.dynamics import Batch
from armimp_sim.model.sensors import Sampling, quantise
from armimp_sim.parameters import SimulatorParameters
from armimp_sim.real_rig import RealRig

RK4_LIMIT = 2.7
"""|h·λ| on the real axis up to which explicit RK4 is stable (2.785, with a margin)."""


class IntegrationError(ArmimpError):
    """The explicit integration left its stability region or produced non-finite numbers."""


class Plant:
    """A batch of plants, one per lane, that share the number of joints and the time step.

    Reading arrays are reused from tick to tick; copy what must last.

    Parameters
    ----------
    configs : one rig per lane
    period : time between samples, over which commands are held, s

    Attributes
    ----------
    position : (lanes, n) encoder readings θ, rad
    torque : (lanes, n) torque transducer readings, torque on the arm, N·m
    batch : the plants, for :func:`tick`
    real : what :mod:`armimp_sim.real_rig` adds; None where all rigs are ideal

    Raises
    ------
    ConfigurationError
        If a lane is no rig that can be simulated, or not the same kind of rig as the first one.
    """

    def __init__(self, configs: Sequence[SimulatorParameters], period: float = PERIOD) -> None:
        first = configs[0]
        for config in configs:
            config.check(period)
            if _shared(config) != _shared(first):
                raise ConfigurationError(
                    "plant: lanes must agree in joints, substeps, sampling, and in having a soft "
                    "cuff"
                )
        n, lanes = first.arm.joints, len(configs)
        width = 1 if lanes == 1 else dynamics.WIDTH
        blocks = -(-lanes // width)
        coordinates = n * (1 + first.soft)
        self.position, self.torque = np.zeros((lanes, n)), np.zeros((lanes, n))
        self.batch = Batch(
            w=np.zeros((blocks, dynamics.rows(coordinates), width)),
            joints=(0.0,) * coordinates,
            width=(0.0,) * width,
            substeps=first.substeps,
            step=period / first.substeps,
            interval_mean=first.sensors.sampling is Sampling.INTERVAL_MEAN,
            resolutions=np.array(
                [(c.sensors.position.resolution, c.sensors.torque.resolution) for c in configs]
            ),
            position=self.position,
            torque=self.torque,
        )
        self.real = real_rig.real_rig(configs, self.batch.step)
        self._noise = np.zeros((lanes, 2, n))
        for lane in range(blocks * width):
            # The last block is filled up with plants that nothing ever moves.
            row = _pack(configs[min(lane, lanes - 1)])
            self.batch.w[lane // width, :, lane % width] = row
        if self.real is None:
            dynamics.sample_now(self.batch)
            read(self.batch)
        else:
            real_rig.settle(self.batch, self.real)
            real_rig.read(self.batch, self.real, 1, self._noise)

    def tick(
        self, command: FloatArray, voluntary: FloatArray, noise: FloatArray | None = None
    ) -> None:
        """Hold the inputs for one period, then read the sensors.

        Parameters
        ----------
        command : (lanes, n) joint torques, N·m
        voluntary : (lanes, n) voluntary torque d, N·m
        noise : (lanes, 2, n) on readings of angles and torques, rad and N·m; ideal rigs ignore it

        Raises
        ------
        ValueError
            If an input has another shape; compiled code would read beyond its end.
        IntegrationError
            If the friction got too stiff for the step, or the state is not finite.
        """
        noise = self._noise if noise is None else noise
        if command.shape != self.position.shape or voluntary.shape != self.position.shape:
            raise ValueError(
                f"plant: command {command.shape} and voluntary torque {voluntary.shape} must "
                f"both be {self.position.shape}"
            )
        if noise.shape != self._noise.shape:
            raise ValueError(f"plant: noise {noise.shape} must be {self._noise.shape}")
        check_ratio(tick(self.batch, self.real, command, voluntary, noise), self.batch.step)


def _shared(config: SimulatorParameters) -> tuple[object, ...]:
    """Return what all lanes of a batch must have in common."""
    return config.arm.joints, config.substeps, config.sensors.sampling, config.soft


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


def _pack(config: SimulatorParameters) -> FloatArray:
    """Return all rows of one lane, at rest in the posture."""
    n = config.arm.joints
    inertia, damping, stiffness, chain = config.coordinates()
    vectors = np.zeros((dynamics.VECTORS, len(chain)))
    posture = np.resize(config.arm.theta_0, len(chain))
    vectors[dynamics.THETA] = vectors[dynamics.POSTURE] = posture
    # An arm in a cuff has no friction of its own.
    law = config.friction.of_joints(n)
    # Without friction g(v) may be anything but zero, as it is a divisor.
    vectors[dynamics.COULOMB] = 1.0
    vectors[dynamics.COULOMB, :n] = np.where(law["coulomb"] > 0.0, law["coulomb"], 1.0)
    vectors[dynamics.STRIBECK, :n] = law["static"] - law["coulomb"]
    vectors[dynamics.INVERSE_STRIBECK_VELOCITY, :n] = 1.0 / law["stribeck_velocity"]
    vectors[dynamics.SIGMA_0, :n] = law["sigma_0"]
    vectors[dynamics.SIGMA_1, :n] = law["sigma_1"]
    vectors[dynamics.SIGMA_2, :n] = law["sigma_2"]
    matrices = np.zeros((dynamics.MATRICES, *chain.shape))
    matrices[dynamics.INERTIA] = inertia
    matrices[dynamics.DAMPING] = damping
    matrices[dynamics.STIFFNESS] = stiffness
    matrices[dynamics.CHAIN] = chain
    return np.concatenate([vectors.ravel(), matrices.ravel()])


@compiled_entry
def read(batch: Batch) -> None:
    """Take quantised readings of the present sample."""
    w, n, m = batch.w, len(batch.joints), len(batch.width)
    resolutions, position, torque = batch.resolutions, batch.position, batch.torque
    for lane in range(position.shape[0]):
        for i in range(position.shape[1]):
            angle = w[lane // m, dynamics.THETA * n + i, lane % m]
            position[lane, i] = quantise(angle, resolutions[lane, 0])
            load = w[lane // m, dynamics.TORQUE * n + i, lane % m]
            torque[lane, i] = quantise(load, resolutions[lane, 1])


@compiled_entry
def tick(
    batch: Batch,
    real: RealRig | None,
    command: FloatArray,
    voluntary: FloatArray,
    noise: FloatArray,
) -> float:
    """Take all lanes through one period: hold the inputs, integrate, read.

    Parameters
    ----------
    batch : Batch, updated
    real : what :mod:`armimp_sim.real_rig` adds, updated; None where all rigs are ideal
    command, voluntary : (lanes, n) N·m
    noise : (lanes, 2, n) on readings of angles and torques, rad and N·m, where a rig is real

    Returns
    -------
    float
        Largest h·σ0|v|/g(v) at the end, for :func:`check_ratio`.
    """
    w, n, m = batch.w, len(batch.joints), len(batch.width)
    used = command.shape[1]
    for lane in range(command.shape[0]):
        for i in range(used):
            w[lane // m, dynamics.COMMAND * n + i, lane % m] = command[lane, i]
            # The coordinates of the arm come last.
            w[lane // m, dynamics.VOLUNTARY * n + n - used + i, lane % m] = voluntary[lane, i]
    # Only the branch that is needed gets compiled, as None has a type of its own.
    if real is None:
        dynamics.advance(batch)
        read(batch)
    else:
        real_rig.advance(batch, real)
        real_rig.read(batch, real, batch.substeps if batch.interval_mean else 1, noise)
    return dynamics.stiffness_ratio(batch)
