"""Parameters of the controller node: the one place of their names, defaults and meaning."""

from __future__ import annotations

import dataclasses
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from armimp_common.errors import ConfigurationError
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema
from armimp_common.topics import NS_PER_S, PERIOD_NS
from armimp_control import presets
from armimp_control.laws.imbic import ImbicConfig
from armimp_control.laws.law import LawConfig
from armimp_control.laws.pd import PdConfig
from armimp_control.perturbation import PerturbationConfig
from armimp_control.rig_dynamics import RigDynamics
from armimp_control.safety import Action, SafetyConfig
from armimp_control.sequence import SequenceConfig
from armimp_control.stability import StabilityMargins, check_stability
from armimp_control.tare import TareConfig

Vector = tuple[float, ...]
PERIOD = PERIOD_NS / NS_PER_S
"""Control period L, s."""


class TargetParameters(Schema):
    """Target impedance Y_rd, diagonal (eq. 8); assumptions."""

    posture: Vector = Field(description="θ_rd (rad)")
    inertia: Vector = Field(description="diagonal of M_rd (kg·m²)")
    damping: Vector = Field(description="B_rd of a joint while perturbed (N·m·s/rad)")
    stiffness: Vector = Field(description="K_rd of a joint while perturbed (N·m/rad)")
    lock_frequency: float = Field(
        default=100.0, ge=1.0, le=1e4, description="ω of joints locked by imbic (rad/s)"
    )
    lock_damping_ratio: float = Field(default=1.0, gt=0.0, description="their ζ (–)")
    lock_approach: float = Field(
        default=0.05,
        gt=0.0,
        description="time constant of their targets on the way from where they are to θ_rd (s)",
    )
    lock_dither: float = Field(
        default=0.0,
        ge=0.0,
        lt=0.01,
        description="amplitude of each of two sines that they make, against encoder bias (rad)",
    )
    lock_dither_frequency: float = Field(
        default=35.0, gt=0.0, lt=380.0, description="frequency of the first, above the band (Hz)"
    )


class LawParameters(Schema):
    """Which law; time-delay estimation and ideal-velocity feedback of IMBIC; assumptions."""

    kind: Literal["imbic", "pd"] = Field(
        default="imbic", description="imbic; or pd: plain PD locking, the negative control"
    )
    model_inertia: Vector = Field(description="M̄ of imbic, n×n row by row (kg·m²)")
    gamma: float = Field(default=100.0, gt=0.0, description="Γ of imbic (rad/s)")
    pd_frequency: float = Field(
        default=25.0, gt=0.0, description="natural frequency of joints locked by pd (rad/s)"
    )
    pd_damping_ratio: float = Field(default=1.0, gt=0.0, description="their damping ratio (–)")


class KnownParameters(Schema):
    """What is known of rig and arm beforehand: for the stability check, and gains of pd."""

    robot_inertia: Vector = Field(description="M_r(θ_0), n×n row by row (kg·m²)")
    arm_inertia: Vector = Field(description="expected M_h, n×n row by row (kg·m²)")
    command_delay: int = Field(
        default=0,
        ge=0,
        le=20,
        description="periods by which commands act later than right after the sample they answer",
    )
    actuator_lag: float = Field(
        default=0.0, ge=0.0, le=0.1, description="time constant of the drives (s)"
    )
    torque_delay: float = Field(
        default=0.0, ge=0.0, le=0.1, description="delay of torque readings (s)"
    )
    torque_cutoff: float = Field(
        default=0.0, ge=0.0, description="their anti-alias low-pass (Hz); 0: none"
    )
    torque_order: int = Field(default=1, ge=1, le=4, description="its order (Butterworth)")

    def dynamics(self) -> RigDynamics:
        """Drives and transducers, for the stability check."""
        return RigDynamics(**self.model_dump(exclude={"robot_inertia", "arm_inertia"}))


class PerturbationParameters(Schema):
    """Perturbation τ_Δ."""

    peak: Vector = Field(description="largest torque on each joint (N·m)")
    cutoff: float = Field(default=15.0, gt=0.0, description="cut-off of the low-pass (Hz)")
    order: int = Field(default=8, ge=1, le=20, description="order of the Butterworth low-pass")


class SequenceParameters(Schema):
    """Lengths of the phases of every trial."""

    duration: float = Field(default=50.0, gt=0.0, description="perturbation (s)")
    settle: float = Field(default=0.5, ge=0.05, description="before it (s)")
    rest: float = Field(default=0.5, ge=0.05, description="after it (s)")
    may_end_early: bool = Field(
        default=False, description="whether the estimator may end a trial before its planned end"
    )


class TareParameters(Schema):
    """Tare of the torque transducers before each trial, with all joints held."""

    duration: float = Field(
        default=0.0, ge=0.0, le=60.0, description="readings (s), at least 0.4; 0: no tare"
    )
    wait: float = Field(
        default=0.5, ge=0.0, le=60.0, description="before them, until the arm rests (s)"
    )
    limit: float = Field(default=5.0, gt=0.0, description="largest tare of a joint (N·m)")
    noise: float = Field(default=0.05, gt=0.0, description="largest standard error of a tare (N·m)")


class SafetyParameters(Schema):
    """Safety gate: limits, and what is done beyond them; watchdog."""

    position_limit: Vector = Field(
        default=(0.5,), description="largest distance from θ_rd (rad); one for all joints or each"
    )
    position_action: Action = Field(default=Action.STOP, description="beyond it")
    velocity_limit: Vector = Field(
        default=(4.0,), description="largest speed over 5 ticks (rad/s); one for all joints or each"
    )
    velocity_action: Action = Field(default=Action.STOP, description="beyond it")
    torque_limit: float = Field(default=80.0, gt=0.0, description="limit of each command (N·m)")
    torque_action: Action = Field(default=Action.CLIP, description="beyond it")
    rate_limit: float = Field(
        default=150e3, gt=0.0, description="limit of its change from tick to tick (N·m/s)"
    )
    rate_action: Action = Field(default=Action.CLIP, description="beyond it")
    power_limit: float = Field(
        default=200.0, gt=0.0, description="largest power τ·θ̇ of a joint in either direction (W)"
    )
    power_action: Action = Field(default=Action.CLIP, description="beyond it")
    watchdog_ticks: int = Field(
        default=5, ge=1, le=100, description="periods without a sample until torque is gone"
    )
    slowest_tick: float = Field(
        default=1.0,
        gt=0.0,
        le=10.0,
        description="wall time that counts as one period in lockstep, which has no pace (s); in "
        "realtime it is the period",
    )
    ramp_time: float = Field(
        default=0.01, ge=0.0, le=0.05, description="time in which a stop takes the torque away (s)"
    )

    @classmethod
    def preset(cls, joints: int) -> SafetyParameters:
        """Default limits of a rig with so many joints."""
        limits = {
            name: value
            for name, value in dataclasses.asdict(presets.safety(joints)).items()
            if name in cls.model_fields
        }
        return cls(**limits)

    def config(self) -> SafetyConfig:
        """The same as the gate and the watchdog take it."""
        return SafetyConfig(**self.model_dump(exclude={"slowest_tick"}))


class ControllerParameters(Schema):
    """All parameters of the node ``imbic_controller``."""

    joints: tuple[str, ...] = Field(description="names of the joints, in the order of commands")
    seed: int = Field(default=1, ge=0, description="seed of the perturbation")
    mode: Literal["lockstep", "realtime"] = Field(
        default="lockstep",
        description="lockstep: time waits for commands; realtime: it does not, as on every rig",
    )
    realtime: SchedulingParameters = SchedulingParameters()
    target: TargetParameters
    law: LawParameters
    known: KnownParameters
    perturbation: PerturbationParameters
    sequence: SequenceParameters = SequenceParameters()
    tare: TareParameters = TareParameters()
    safety: SafetyParameters = SafetyParameters()

    @classmethod
    def preset(
        cls,
        *,
        joints: tuple[str, ...],
        posture: NDArray[np.float64],
        robot_inertia: NDArray[np.float64],
        arm_inertia: NDArray[np.float64],
        perturbation: int = 3,
        duration: float = 50.0,
        seed: int = 1,
        encoder_resolution: float = 0.0,
    ) -> ControllerParameters:
        """Default law for a rig, with the perturbation of a level from 1 to 3.

        Parameters
        ----------
        joints : names of the n joints
        posture : (n,) θ_0, rad
        robot_inertia, arm_inertia : (n, n) M_r(θ_0) and expected M_h, kg·m²
        perturbation : level, 1 to 3
        duration : of every perturbation, s
        seed : of the perturbation
        encoder_resolution : rad per count, for the dither of locked joints
        """
        law = presets.imbic(robot_inertia, posture)
        return cls(
            joints=joints,
            seed=seed,
            target=TargetParameters(
                posture=_flat(law.target_posture),
                inertia=_flat(law.target_inertia),
                damping=_flat(law.target_damping),
                stiffness=_flat(law.target_stiffness),
                lock_dither=presets.lock_dither(encoder_resolution),
            ),
            law=LawParameters(model_inertia=_flat(law.model_inertia)),
            known=KnownParameters(
                robot_inertia=_flat(robot_inertia), arm_inertia=_flat(arm_inertia)
            ),
            perturbation=PerturbationParameters(
                peak=presets.perturbation(perturbation, len(joints)).peak
            ),
            sequence=SequenceParameters(duration=duration),
            safety=SafetyParameters.preset(len(joints)),
        )

    def law_config(self) -> LawConfig:
        """The law that was chosen."""
        return self.imbic_config() if self.law.kind == "imbic" else self.pd_config()

    def imbic_config(self) -> ImbicConfig:
        """The law of the study, whichever was chosen."""
        return ImbicConfig(
            target_posture=np.array(self.target.posture),
            target_inertia=np.array(self.target.inertia),
            target_damping=np.array(self.target.damping),
            target_stiffness=np.array(self.target.stiffness),
            lock_frequency=self.target.lock_frequency,
            lock_damping_ratio=self.target.lock_damping_ratio,
            lock_approach=self.target.lock_approach,
            lock_dither=self.target.lock_dither,
            lock_dither_frequency=self.target.lock_dither_frequency,
            model_inertia=self._matrix("law.model_inertia", self.law.model_inertia),
            gamma=self.law.gamma,
            period=PERIOD,
        )

    def pd_config(self) -> PdConfig:
        """The negative control, whichever was chosen; its gains follow from diag(M_r(θ_0))."""
        return PdConfig(
            target_posture=np.array(self.target.posture),
            target_damping=np.array(self.target.damping),
            target_stiffness=np.array(self.target.stiffness),
            inertia=np.diag(self._matrix("known.robot_inertia", self.known.robot_inertia)).copy(),
            frequency=self.law.pd_frequency,
            damping_ratio=self.law.pd_damping_ratio,
            period=PERIOD,
        )

    def perturbation_config(self) -> PerturbationConfig:
        """The perturbation."""
        if len(self.perturbation.peak) != len(self.joints):
            raise ConfigurationError(
                f"parameter 'perturbation.peak' has {len(self.perturbation.peak)} values for "
                f"{len(self.joints)} joints"
            )
        return PerturbationConfig(
            peak=self.perturbation.peak,
            cutoff=self.perturbation.cutoff,
            order=self.perturbation.order,
            period=PERIOD,
        )

    def sequence_config(self) -> SequenceConfig:
        """The phases."""
        return SequenceConfig(
            duration=self.sequence.duration,
            settle=self.sequence.settle,
            rest=self.sequence.rest,
            tare=TareConfig(**self.tare.model_dump()),
        )

    def safety_config(self) -> SafetyConfig:
        """The gate."""
        return self.safety.config()

    @property
    def patience_per_tick(self) -> float:
        """Longest wall time that may count as one period for the watchdog, s."""
        return PERIOD if self.mode == "realtime" else self.safety.slowest_tick

    def check(self) -> StabilityMargins:
        """Check that everything fits together and is stable when sampled.

        Raises
        ------
        ConfigurationError
            If not; the message carries the offending value.
        """
        law = self.law_config()
        if law.joints != len(self.joints):
            raise ConfigurationError(
                f"parameter 'target.posture' has {law.joints} values for {len(self.joints)} joints"
            )
        self.safety_config().rules(law.target_posture, PERIOD)
        self.sequence_config()
        return check_stability(
            law,
            robot_inertia=self._matrix("known.robot_inertia", self.known.robot_inertia),
            arm_inertia=self._matrix("known.arm_inertia", self.known.arm_inertia),
            dynamics=self.known.dynamics(),
        )

    def _matrix(self, name: str, values: Vector) -> NDArray[np.float64]:
        n = len(self.joints)
        if len(values) != n * n:
            raise ConfigurationError(
                f"parameter '{name}' has {len(values)} values, needs {n * n} for {n} joints"
            )
        return np.array(values).reshape(n, n)


def _flat(values: NDArray[np.float64]) -> Vector:
    return tuple(float(value) for value in values.ravel())
