"""Parameters of the controller node: the one place of their names, defaults and meaning."""

from __future__ import annotations

from operator import attrgetter
from typing import Literal

from pydantic import Field

from armimp_common.arrays import FloatArray
from armimp_common.errors import ConfigurationError
from armimp_common.realtime import SchedulingParameters
from armimp_common.schema import Schema, each, matrix, require_length, row_by_row
from armimp_common.topics import PERIOD
from armimp_control import presets
from armimp_control.laws import Law, LawParameters, TargetParameters
from armimp_control.laws.law import LAWS
from armimp_control.perturbation import (
    JointPrior,
    PerturbationKind,
    PerturbationParameters,
    perturbation,
)
from armimp_control.rig import KnownParameters
from armimp_control.safety_limiter import SafetyParameters
from armimp_control.sequence import SequenceParameters, TareParameters
from armimp_control.stability import check_stability


class ControllerParameters(Schema):
    """All parameters of the node ``imbic_controller``."""

    joints: tuple[str, ...] = Field(min_length=1)
    """Names of the joints, in the order of commands."""
    seed: int = Field(default=1, ge=0)
    """Seed of the perturbation."""
    mode: Literal["lockstep", "realtime"] = "lockstep"
    """lockstep: time waits for commands; realtime: it does not wait, as on every real rig."""
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
        """Return a preset of the law for a rig, with the perturbation of a level from 1 to 3.

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
        # With very coarse encoders, the dither would be a motion that can be felt.
        count = min(encoder_resolution, presets.COARSEST)
        perturbing = presets.perturbation(perturbation, n, perturbation_kind)
        return cls(
            joints=joints,
            seed=seed,
            target=TargetParameters(
                posture=row_by_row(posture),
                inertia=row_by_row(inertia),
                damping=row_by_row(damping),
                stiffness=row_by_row(stiffness),
                lock_frequency=preset.lock_frequency,
                lock_approach=preset.lock_approach,
                lock_dither=preset.dither * count,
            ),
            law=LawParameters(
                internal_model=preset.internal_model,
                model_inertia=row_by_row(preset.inertia * robot_inertia),
                gamma=preset.gamma,
                encoder_resolution=max(count, preset.finest),
                perturbed_walk=row_by_row(perturbed),
                locked_walk=row_by_row(locked),
            ),
            known=KnownParameters(
                robot_inertia=row_by_row(robot_inertia), arm_inertia=row_by_row(arm_inertia)
            ),
            perturbation=perturbing,
            sequence=SequenceParameters(duration=duration),
            safety=presets.safety(n, max(perturbing.peak), preset.internal_model),
        )

    def control_law(self) -> Law:
        """Return the law that was chosen."""
        return LAWS[self.law.kind](target=self.target, law=self.law, known=self.known)

    def prior(self, joint: int) -> JointPrior:
        """Return what is expected of a joint (0-based) while it is perturbed."""
        target, known, n = self.target, self.known, len(self.joints)
        inertia = float(matrix("known.arm_inertia", known.arm_inertia, n)[joint, joint])
        omega = float(each("known.arm_frequency", known.arm_frequency, n)[joint])
        zeta = float(each("known.arm_damping_ratio", known.arm_damping_ratio, n)[joint])
        return JointPrior(
            arm=(inertia, 2.0 * zeta * omega * inertia, omega * omega * inertia),
            target=(target.inertia[joint], target.damping[joint], target.stiffness[joint]),
        )

    def signal(self, joint: int, *, trial: int, ticks: int) -> FloatArray:
        """Return the perturbation (ticks,) of a joint (0-based) in a trial (from 1), N·m."""
        return perturbation(
            self.perturbation,
            joint=joint,
            trial=trial,
            ticks=ticks,
            seed=self.seed,
            prior=self.prior(joint),
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
        require_length("perturbation.peak", self.perturbation.peak, n, n)
        each("perturbation.angle_limit", self.perturbation.angle_limit, n)
        inertia = [self.prior(joint).arm[0] for joint in range(n)]
        if self.perturbation.kind == "optimal" and not all(one > 0.0 for one in inertia):
            raise ConfigurationError(
                "optimal perturbations need a positive inertia of the arm at every joint, "
                f"known.arm_inertia has {inertia}"
            )
        law = self.control_law()
        self.safety.rules(law.target_posture)
        return check_stability(law)
