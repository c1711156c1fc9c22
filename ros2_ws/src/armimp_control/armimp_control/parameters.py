"""Parameters of the controller node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from operator import attrgetter
from typing import Literal

import numpy as np
from pydantic import Field

from armimp_common.arrays import FloatArray
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import PositiveVector, Schema, Vector, each, require_length
from armimp_common.topics import PERIOD
from armimp_control import presets
from armimp_control.laws import TargetParameters
from armimp_control.laws.imbic import ImbicConfig, Observer
from armimp_control.laws.law import LawConfig
from armimp_control.laws.pd import PdConfig
from armimp_control.perturbation import JointPrior, PerturbationKind, PerturbationParameters
from armimp_control.safety_limiter import SafetyParameters
from armimp_control.sequence import SequenceParameters, TareParameters
from armimp_control.stability import RigDynamics, check_stability


class LawParameters(Schema):
    """Which law; internal model and ideal-velocity feedback of IMBIC; assumptions."""

    kind: Literal["imbic", "pd"] = "imbic"
    """Control law: imbic, or pd, plain PD locking as the negative control."""
    internal_model: presets.InternalModel = "observer"
    """Internal model of imbic: observer, or tde, time-delay estimation with raw differences of the
    encoders."""
    model_inertia: Vector
    """Inertia M̄ of the internal model of imbic, n×n row by row (kg·m²)."""
    encoder_resolution: float = Field(default=presets.FINEST, ge=1e-6, le=0.1)
    """Rounding of the encoders that the observer expects (rad); a smaller one makes it faster, and
    less patient with late commands."""
    perturbed_walk: PositiveVector = (0.4,)
    """Rms change within a control period of the unknown torque, mostly friction, that the observer
    expects of a joint while it is perturbed (N·m); one value for all joints or one for each."""
    locked_walk: PositiveVector = (0.02,)
    """The same of a joint while it is locked (N·m); one value for all joints or one for each."""
    gamma: float = Field(default=100.0, gt=0.0)
    """Gain Γ of the ideal-velocity feedback of imbic (rad/s)."""
    pd_frequency: float = Field(default=25.0, gt=0.0)
    """Natural frequency of joints locked by the law pd (rad/s)."""
    pd_damping_ratio: float = Field(default=1.0, gt=0.0)
    """Damping ratio of joints locked by the law pd (–)."""


class KnownParameters(RigDynamics):
    """What is known beforehand: for the stability check, gains of pd, and the perturbation."""

    robot_inertia: Vector
    """Inertia of the robot in the posture, M_r(θ_0), n×n row by row (kg·m²)."""
    arm_inertia: Vector
    """Expected inertia of the arm, M_h, n×n row by row (kg·m²)."""
    arm_frequency: PositiveVector = (8.0,)
    """Expected natural frequency of the arm, sqrt(K_kk/M_kk), for optimal perturbations and limits
    of the angle (rad/s); one value for all joints or one for each."""
    arm_damping_ratio: PositiveVector = (0.3,)
    """Expected damping ratio of the arm, B_kk/(2·sqrt(K_kk·M_kk)) (–); one value for all joints or
    one for each."""


class ControllerParameters(Schema):
    """All parameters of the node ``imbic_controller``."""

    joints: tuple[str, ...]
    """Names of the joints, in the order of commands."""
    seed: int = Field(default=1, ge=0)
    """Seed of the perturbation."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """lockstep: time waits for commands; realtime: it does not, as on every rig."""
    realtime: SchedulingParameters = SchedulingParameters()
    target: TargetParameters
    law: LawParameters
    known: KnownParameters
    perturbation: PerturbationParameters
    sequence: SequenceParameters = SequenceParameters()
    tare: TareParameters = TareParameters()
    safety: SafetyParameters = SafetyParameters()

    @classmethod
    def preset(  # noqa: PLR0913 (each is a fact of its own)
        cls,
        *,
        joints: tuple[str, ...],
        posture: FloatArray,
        robot_inertia: FloatArray,
        arm_inertia: FloatArray,
        perturbation: int = 3,
        perturbation_kind: PerturbationKind = "noise",
        duration: float = 50.0,
        seed: int = 1,
        encoder_resolution: float = 0.0,
        law: presets.LawName = "observer",
    ) -> ControllerParameters:
        """A preset of the law for a rig, with the perturbation of a level from 1 to 3.

        Parameters
        ----------
        joints : names of the n joints
        posture : (n,) θ_0, rad
        robot_inertia, arm_inertia : (n, n) M_r(θ_0) and expected M_h, kg·m²
        perturbation : level, 1 to 3
        perturbation_kind : noise, multisine or optimal
        duration : of every perturbation, s
        seed : of the perturbation
        encoder_resolution : rad per count, for the dither of locked joints and the observer
        law : name of one of :data:`armimp_control.presets.LAWS`
        """
        preset, n = presets.LAWS[law], len(joints)
        inertia, damping, stiffness = presets.target(robot_inertia)
        perturbed, locked = presets.unknown_torque(n)
        # With encoders as coarse as can be, dither would be a motion to be felt.
        count = min(encoder_resolution, presets.COARSEST)
        perturbing = presets.perturbation(perturbation, n, perturbation_kind)
        return cls(
            joints=joints,
            seed=seed,
            target=TargetParameters(
                posture=_flat(posture),
                inertia=_flat(inertia),
                damping=_flat(damping),
                stiffness=_flat(stiffness),
                lock_frequency=preset.lock_frequency,
                lock_approach=preset.lock_approach,
                lock_dither=preset.dither * count,
            ),
            law=LawParameters(
                internal_model=preset.internal_model,
                model_inertia=_flat(preset.inertia * robot_inertia),
                gamma=preset.gamma,
                encoder_resolution=max(count, preset.finest),
                perturbed_walk=_flat(perturbed),
                locked_walk=_flat(locked),
            ),
            known=KnownParameters(
                robot_inertia=_flat(robot_inertia), arm_inertia=_flat(arm_inertia)
            ),
            perturbation=perturbing,
            sequence=SequenceParameters(duration=duration),
            safety=presets.safety(n, max(perturbing.peak), preset.internal_model),
        )

    def law_config(self) -> LawConfig:
        """The law that was chosen."""
        return self.imbic_config() if self.law.kind == "imbic" else self.pd_config()

    def imbic_config(self) -> ImbicConfig:
        """The law of the study, whichever was chosen."""
        law, observer = self.law, None
        if law.internal_model == "observer":
            observer = Observer(
                resolution=law.encoder_resolution,
                delay=self.known.command_delay,
                perturbed=self._each("law.perturbed_walk"),
                locked=self._each("law.locked_walk"),
            )
        return ImbicConfig(
            target=self.target,
            model_inertia=self._matrix("law.model_inertia"),
            gamma=law.gamma,
            observer=observer,
        )

    def priors(self) -> tuple[JointPrior, ...]:
        """What is expected of each joint while it is perturbed."""
        target = self.target
        inertia = np.diag(self._matrix("known.arm_inertia"))
        omega, zeta = self._each("known.arm_frequency"), self._each("known.arm_damping_ratio")
        arm = np.stack([inertia, 2.0 * zeta * omega * inertia, omega**2 * inertia], axis=1)
        targets = zip(target.inertia, target.damping, target.stiffness, strict=True)
        return tuple(
            JointPrior(arm=tuple(one), target=of_target)
            for one, of_target in zip(arm.tolist(), targets, strict=True)
        )

    def pd_config(self) -> PdConfig:
        """The negative control, whichever was chosen; its gains follow from diag(M_r(θ_0))."""
        return PdConfig(
            target=self.target,
            inertia=np.diag(self._matrix("known.robot_inertia")).copy(),
            frequency=self.law.pd_frequency,
            damping_ratio=self.law.pd_damping_ratio,
        )

    @property
    def slowest_tick(self) -> float:
        """Longest wall time that may count as one period for the watchdog, s."""
        return PERIOD if self.mode == "realtime" else self.safety.slowest_tick

    def check(self) -> tuple[str, ...]:
        """Check that everything fits together and is stable when sampled; return warnings.

        Raises
        ------
        ConfigurationError
            If not; the message carries the offending value.
        """
        n = len(self.joints)
        for name in ("target.posture", "target.inertia", "target.damping", "target.stiffness"):
            require_length(name, attrgetter(name)(self), n, n)
        law = self.law_config()
        require_length("perturbation.peak", self.perturbation.peak, n, n)
        self._each("perturbation.angle_limit")
        self.priors()
        self.safety.rules(law.target_posture, PERIOD)
        return check_stability(
            law,
            robot_inertia=self._matrix("known.robot_inertia"),
            arm_inertia=self._matrix("known.arm_inertia"),
            dynamics=self.known,
        )

    def _each(self, name: str) -> FloatArray:
        return each(name, attrgetter(name)(self), len(self.joints))

    def _matrix(self, name: str) -> FloatArray:
        values, n = attrgetter(name)(self), len(self.joints)
        require_length(name, values, n, n * n)
        return np.array(values).reshape(n, n)


def _flat(values: FloatArray) -> Vector:
    return tuple(float(value) for value in values.ravel())
