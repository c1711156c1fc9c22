"""What all laws share: their parameters, and the rows of the arrays that they work on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from armimp_common.arrays import BoolArray, FloatArray
from armimp_common.schema import PositiveVector, Schema, Vector
from armimp_common.topics import RATE
from armimp_control import presets
from armimp_control.rig import MOST_DELAY, KnownParameters

THETA_1, THETA_2, IDEAL_VELOCITY, TICKS, OFFSET, SENSED_BEFORE = range(6)
"""Memory between ticks: the last two positions, ∫ u dt, ticks since the start, distance of the
target from θ_rd, and the first row of the role."""
ANGLE, VELOCITY, DISTURBANCE = 6, 7, 8
"""Memory of the observer: angle (rad), velocity (rad/s), acceleration that no torque explains
(rad/s²)."""
COMMAND = 9
"""The command sent, and in the rows after it those that the observer knows to be under way."""
MEMORY_ROWS = COMMAND + 1 + MOST_DELAY

SENSED, INERTIA, DAMPING, STIFFNESS, APPROACH, DITHER, DITHER_ANGLE, TARE, LATE = range(9)
"""Role in a trial: share of τ_h' sensed; impedance that a joint is to show; what is left after a
tick of the distance of its target from θ_rd; amplitude (rad) and angle per tick (rad) of the dither
in its target; what the torque transducer reads at rest (N·m), which the law takes from τ_h'; and
periods by which the observer takes commands to act late."""
ROLE_ROWS = 9

INERTIA_MODEL, INVERSE, ANGLE_GAIN, VELOCITY_GAIN, DISTURBANCE_GAIN = range(5)
"""Internal model in a trial, matrices (n, n): M̄ (kg·m²), and for the observer M̄⁻¹ and what an error
of the encoders (rad) adds to angles (rad), velocities (rad/s) and accelerations (rad/s²)."""
MODEL_ROWS = 5

NO_JOINT = -1
"""Stands for the perturbed joint while all joints are locked."""

IMBIC, PD, IMBIC_OBSERVER = 0, 1, 2
"""What tells the laws apart in compiled code."""

SECOND_TONE = 1.55
"""Frequency of the second sine of the dither, over that of the first.

Rounding mixes the two: slow motion of the joint is read beside each ``m f_1 - n f_2``. With 1.3 the
strongest, ``f_2 - f_1``, is at the end of the band, and the errors of a heavy locked joint hide the
response of a light one; ratios of small whole numbers make many of them meet.
"""


class TargetParameters(Schema):
    """Target impedance Y_rd, diagonal (eq. 8); assumptions."""

    posture: Vector
    """Target posture θ_rd of each joint (rad)."""
    inertia: PositiveVector
    """Target inertia of each joint, diagonal of M_rd (kg·m²)."""
    damping: Vector
    """Target damping B_rd of each joint while it is perturbed (N·m·s/rad)."""
    stiffness: Vector
    """Target stiffness K_rd of each joint while it is perturbed (N·m/rad)."""
    lock_frequency: float = Field(default=100.0, ge=0.0, le=1e4)
    """Natural frequency of the target of joints locked by the law imbic (rad/s); 0: the target that
    they have while they are perturbed."""
    lock_damping_ratio: float = Field(default=1.0, gt=0.0)
    """Damping ratio of the target of joints locked by the law imbic (–)."""
    lock_approach: float = Field(default=0.05, ge=0.0)
    """Time constant with which the target of a joint that gets locked goes from where the joint is
    to the target posture (s); 0: it is there at once."""
    lock_dither: float = Field(default=0.0, ge=0.0, lt=0.01)
    """Amplitude of each of two sines that locked joints make against the bias of their encoders
    (rad)."""
    lock_dither_frequency: float = Field(default=35.0, gt=0.0, lt=0.5 * RATE / SECOND_TONE)
    """Frequency of the first of two sines that locked joints make, above the band of the
    perturbation (Hz)."""


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Law(ABC):
    """A law with the parameters of the controller that it is made from."""

    target: TargetParameters
    law: LawParameters
    known: KnownParameters

    @property
    @abstractmethod
    def kind(self) -> int:
        """Which law it is in compiled code."""

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.target.posture)

    @property
    def target_posture(self) -> FloatArray:
        """(n,) θ_rd, rad."""
        return np.array(self.target.posture)

    def locked(self, perturbed: int | None) -> BoolArray:
        """Which joints (n,) are locked, see :meth:`role`."""
        every = np.arange(self.joints)
        return np.asarray(every != (every if perturbed is None else perturbed))

    @abstractmethod
    def role(self, perturbed: int | None) -> FloatArray:
        """Law parameters (ROLE_ROWS, n) while joint ``perturbed`` (0-based) yields, others lock.

        With None all joints yield, with NO_JOINT all lock.
        """

    def model(self, _perturbed: int | None) -> FloatArray:
        """Internal model (MODEL_ROWS, n, n) in the same trial; zeros of a law that has none."""
        return np.zeros((MODEL_ROWS, self.joints, self.joints))
