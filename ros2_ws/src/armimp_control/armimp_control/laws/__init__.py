"""What all laws share: their parameters, and the rows of the arrays that they work on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from pydantic import Field

from armimp_common.arrays import BoolArray, FloatArray
from armimp_common.schema import PositiveVector, Schema, Vector
from armimp_common.topics import RATE
from armimp_control import presets
from armimp_control.rig import MOST_DELAY, KnownParameters

THETA_1, THETA_2, IDEAL_VELOCITY, TICKS, OFFSET, SENSED_BEFORE = range(6)
"""Rows of the memory between ticks: the last two positions, ∫ u dt, ticks since the start, distance
of the target from θ_rd, and SENSED of the role at the last tick."""
ANGLE, VELOCITY, DISTURBANCE = 6, 7, 8
"""Rows of the observer's memory: angle (rad), velocity (rad/s), and acceleration that no known
torque explains (rad/s²)."""
COMMAND = 9
"""Row of the last command sent; the rows after it hold earlier commands, which are yet to act."""
MEMORY_ROWS = COMMAND + 1 + MOST_DELAY

SENSED, INERTIA, DAMPING, STIFFNESS, APPROACH, DITHER, DITHER_ANGLE, TARE, LATE = range(9)
POSTURE, GAMMA = 9, 10
"""Rows of the role in a trial: share of τ_h' that is sensed; target inertia, damping and stiffness;
share of the distance of the target from θ_rd that a tick leaves; amplitude (rad) and angle per tick
(rad) of the dither in the target; what the torque transducer reads at rest (N·m), which the law
subtracts from τ_h'; periods by which the observer takes commands to act late; θ_rd (rad); and Γ
(rad/s), the same for all joints."""
ROLE_ROWS = 11

INERTIA_MODEL, INVERSE, ANGLE_GAIN, VELOCITY_GAIN, DISTURBANCE_GAIN = range(5)
"""Matrices (n, n) of the internal model in a trial: M̄ (kg·m²), and for the observer M̄⁻¹ and the
gains from innovations (rad) to angles (rad), velocities (rad/s) and accelerations (rad/s²)."""
MODEL_ROWS = 5

NO_JOINT = -1
"""Stands for the perturbed joint while all joints are locked."""

IMBIC, PD, IMBIC_OBSERVER = 0, 1, 2
"""Codes of the laws in compiled code."""


class LawArrays(NamedTuple):
    """The arrays on which a law works, in the form that compiled code takes."""

    sample: FloatArray
    """(3, n) of this tick: θ of the encoders (rad), τ_h of the transducers and τ_Δ (N·m)."""
    command: FloatArray
    """(n,) N·m, written: before the safety limiter, which changes it to what is sent."""
    role: FloatArray
    """(ROLE_ROWS, n) from :meth:`Law.role`."""
    memory: FloatArray
    """(MEMORY_ROWS, n), updated; zeros before the first tick; COMMAND holds what was sent."""
    model: FloatArray
    """(MODEL_ROWS, n, n) from :meth:`Law.model`."""


SECOND_TONE = 1.55
"""Frequency of the second sine of the dither, over that of the first.

Rounding mixes the two: slow motion of the joint also shows around each ``m f_1 - n f_2``. With 1.3
the strongest of these, ``f_2 - f_1``, lies within the band, and the errors of a heavy locked
joint hide the response of a light one; with ratios of small whole numbers many of them coincide.
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
    """Natural frequency of the target of joints locked by the law imbic (rad/s); 0: they keep the
    target of perturbed joints."""
    lock_damping_ratio: float = Field(default=1.0, gt=0.0)
    """Damping ratio of the target of joints locked by the law imbic (–)."""
    lock_approach: float = Field(default=0.05, ge=0.0)
    """Time constant with which the target of a joint that gets locked moves from where the joint is
    to the target posture (s); 0: it is there at once."""
    lock_dither: float = Field(default=0.0, ge=0.0, lt=0.01)
    """Amplitude of each of the two sines of the dither, with which locked joints move against the
    bias of their encoders (rad)."""
    lock_dither_frequency: float = Field(default=35.0, gt=0.0, lt=0.5 * RATE / SECOND_TONE)
    """Frequency of the first sine of the dither, above the band of the perturbation (Hz)."""


class LawParameters(Schema):
    """Choice of the law; internal model and ideal-velocity feedback of IMBIC; assumptions."""

    kind: Literal["imbic", "pd"] = "imbic"
    """Control law: imbic, or pd, plain PD locking as the negative control."""
    internal_model: presets.InternalModel = "observer"
    """Internal model of imbic: observer, or tde, time-delay estimation with raw differences of the
    encoders."""
    model_inertia: Vector
    """Inertia M̄ of the internal model of imbic, n×n row by row (kg·m²)."""
    encoder_resolution: float = Field(default=presets.FINEST, ge=1e-6, le=0.1)
    """Resolution of the encoders that the observer expects (rad); a finer one makes it faster, and
    less tolerant of late commands."""
    perturbed_walk: PositiveVector = (0.4,)
    """Rms change in a control period that the observer expects of the unknown torque, mostly
    friction, of a perturbed joint (N·m); one value for all joints or one for each."""
    locked_walk: PositiveVector = (0.02,)
    """Rms change in a control period that the observer expects of the unknown torque of a locked
    joint (N·m); one value for all joints or one for each."""
    gamma: float = Field(default=100.0, gt=0.0)
    """Gain Γ of the ideal-velocity feedback of imbic (rad/s)."""
    pd_frequency: float = Field(default=25.0, gt=0.0)
    """Natural frequency of joints locked by the law pd (rad/s)."""
    pd_damping_ratio: float = Field(default=1.0, gt=0.0)
    """Damping ratio of joints locked by the law pd (–)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Law(ABC):
    """Base of the laws, with the parameters of the controller from which a law is made."""

    target: TargetParameters
    law: LawParameters
    known: KnownParameters

    @property
    @abstractmethod
    def kind(self) -> int:
        """Code of the law in compiled code."""

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.target.posture)

    @property
    def target_posture(self) -> FloatArray:
        """(n,) θ_rd, rad."""
        return np.array(self.target.posture)

    def locked(self, perturbed: int | None) -> BoolArray:
        """Return which joints are locked (n,); ``perturbed`` as for :meth:`role`."""
        every = np.arange(self.joints)
        return np.asarray(every != (every if perturbed is None else perturbed))

    @abstractmethod
    def role(self, perturbed: int | None) -> FloatArray:
        """Return the roles (ROLE_ROWS, n): joint ``perturbed`` (0-based) yields, others are locked.

        With None all joints yield, with NO_JOINT all are locked.
        """

    def model(self, _perturbed: int | None) -> FloatArray:
        """Return the internal model (MODEL_ROWS, n, n) for this role; zeros if the law has none."""
        return np.zeros((MODEL_ROWS, self.joints, self.joints))
