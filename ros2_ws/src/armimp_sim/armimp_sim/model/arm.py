"""The human arm: M, B and K about a posture, and reflexes, muscles and a cuff beside them."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from armimp_common.arrays import FloatArray
from armimp_common.schema import Schema, Vector, matrix


class HumanArm(Schema):
    """τ_h = M_h θ̈ + B_h θ̇ + K_h (θ − θ_0), eq. 1–3 of the paper.

    The matrices are general: nothing here assumes or makes them symmetric.
    """

    posture: Vector
    """Posture θ_0 of the arm, in which it has no elastic torque (rad)."""
    inertia: Vector
    """Inertia M_h of the arm, n×n row by row (kg·m²)."""
    damping: Vector
    """Damping B_h of the arm, n×n row by row (N·m·s/rad)."""
    stiffness: Vector
    """Stiffness K_h of the arm, n×n row by row (N·m/rad)."""

    @model_validator(mode="after")
    def _has_inertia(self) -> HumanArm:
        if not all(value > 0.0 for value in self.inertia[:: self.joints + 1]):
            raise ValueError(f"inertia of every joint must be positive, got {self.inertia}")
        return self

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.posture)

    @property
    def theta_0(self) -> FloatArray:
        """(n,) θ_0, rad."""
        return np.array(self.posture)

    @property
    def M(self) -> FloatArray:
        """(n, n) M_h, kg·m²."""
        return matrix("arm.inertia", self.inertia, self.joints)

    @property
    def B(self) -> FloatArray:
        """(n, n) B_h, N·m·s/rad."""
        return matrix("arm.damping", self.damping, self.joints)

    @property
    def K(self) -> FloatArray:
        """(n, n) K_h, N·m/rad."""
        return matrix("arm.stiffness", self.stiffness, self.joints)


class ReflexParameters(Schema):
    """Stretch reflex: velocity and stretch act after a delay, through a second-order muscle.

    The model, and 40 ms, are those of Kearney, Stein & Parameswaran (IEEE Trans. Biomed. Eng.
    44(6), 1997) for the ankle; the muscle's values are an assumption.
    """

    velocity_gain: Vector = (0.0,)
    """Gain of the stretch reflex from the velocity of the joint to torque (N·m·s/rad); one value or
    one for each joint."""
    stretch_gain: Vector = (0.0,)
    """Gain of the stretch reflex from the angle from the posture to torque (N·m/rad); one value or
    one for each joint."""
    delay: float = Field(default=0.04, ge=0.0, le=0.2)
    """Delay of the stretch reflex (s)."""
    muscle: float = Field(default=50.0, ge=1.0, le=1000.0)
    """Natural frequency of the muscle that the reflex drives (rad/s)."""
    damping_ratio: float = Field(default=1.0, ge=0.1, le=10.0)
    """Damping ratio of that muscle (–)."""


class MuscleParameters(Schema):
    """How stiffness departs from a constant K_h.

    Short-range stiffness yields after some milliradians (Rack & Westbury, J. Physiol. 240, 1974);
    stiffness falls with amplitude (Kearney & Hunter, J. Biomech. 15(10), 1982) and changes over
    minutes. The shapes are the simplest ones that do so, an assumption.
    """

    short_range_stiffness: Vector = (0.0,)
    """Additional stiffness of a muscle within its short range (N·m/rad); one value or one for each
    joint."""
    short_range: float = Field(default=0.005, gt=0.0)
    """Stretch, in either direction, at which the short-range spring yields and follows (rad)."""
    cubic: float = 0.0
    """Relative change of the diagonal of the stiffness with the square of the angle from the
    posture (1/rad²); the torque is K_ii · cubic · angle³, negative for an arm that softens."""
    stiffening: float = 0.0
    """Relative change of the stiffness K_h per second from the start of the simulation on (1/s)."""


class CuffParameters(Schema):
    """Spring and damper between each joint of the robot and that of the arm.

    Transducers are on the robot's side. Values are assumptions: 100 kN·m/rad for a cast, down to
    1 kN·m/rad for straps.
    """

    stiffness: float = Field(default=0.0, ge=0.0)
    """Stiffness of the cuff between robot and arm (N·m/rad); 0 for a rigid one."""
    damping: float = Field(default=0.0, ge=0.0)
    """Damping of the cuff between robot and arm (N·m·s/rad)."""
