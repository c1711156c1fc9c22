"""Controller and perturbation defaults: Table III of the paper, and stated assumptions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from armimp_common.arrays import FloatArray
from armimp_common.sizes import JOINT_SIZES
from armimp_common.topics import PERIOD
from armimp_control.perturbation import PerturbationKind, PerturbationParameters
from armimp_control.safety_limiter import SafetyParameters

LEVELS = (1, 2, 3)

InternalModel: TypeAlias = Literal["observer", "tde"]
LawName: TypeAlias = Literal["observer", "patient", "tde", "paper"]

FINEST = 1e-4
"""Resolution of encoders (rad) below which the observer gets no faster: delays would matter."""


@dataclass(frozen=True, kw_only=True)
class LawPreset:
    """Settings of one law of :data:`LAWS`."""

    internal_model: InternalModel = "observer"
    """``observer``, or ``tde``, time-delay estimation."""
    lock_frequency: float
    """ω of locked joints, rad/s; 0: they keep the target of perturbed ones."""
    lock_approach: float = 0.05
    """Time constant of their approach to the posture, s."""
    dither: float
    """Amplitude of their dither, in counts of the encoders."""
    gamma: float = 100.0
    """Gain Γ of the ideal-velocity feedback, rad/s."""
    inertia: float = 1.0
    """M̄ as a share of M_r(θ_0)."""
    finest: float = FINEST
    """Resolution of encoders (rad) below which the observer gets no faster."""


LAWS: Final[Mapping[LawName, LawPreset]] = {
    "observer": LawPreset(lock_frequency=120.0, dither=0.35),
    # With the lags of the realistic rig, it is stable for arms from a third to thrice as heavy.
    "patient": LawPreset(lock_frequency=80.0, dither=0.35, gamma=60.0, finest=2.0 * np.pi / 51200),
    "tde": LawPreset(internal_model="tde", lock_frequency=100.0, dither=0.7, inertia=0.6),
    # Locked joints as in the paper, end of II-B: they do not sense the arm, and that is all.
    "paper": LawPreset(
        internal_model="tde", lock_frequency=0.0, lock_approach=0.0, dither=0.0, inertia=0.6
    ),
}
"""Presets of the laws. Assumptions.

M̄ = M_r(θ_0) for the observer, whose torques are all fed forward through it, and 0.6·M_r(θ_0) for
time-delay estimation, where it is a gain. A third of a count of dither is enough; with time-delay
estimation joints follow their target less well, so they get twice that.
"""

COARSEST = 0.01
"""Coarsest resolution of encoders (rad) for which laws are made: eighty times the study's."""
_PEAK = 3.0  # N·m of a shoulder at level 1; the levels are multiples (Table III)


def perturbation(
    level: int, joints: int, kind: PerturbationKind = "noise"
) -> PerturbationParameters:
    """Return the perturbation at a level from 1 to 3, for 1 to 7 joints.

    Shoulder and elbow have that of Table III: 3 and 1.8, 6 and 3.6, 9 and 5.4 N·m. Assumption: the
    peak of any joint is proportional to its size, see :data:`armimp_common.sizes.JOINT_SIZES`.
    """
    # Rounded, so that the peaks of Table III are exact.
    return PerturbationParameters(
        kind=kind,
        peak=tuple(level * round(_PEAK * size, 6) for size in JOINT_SIZES[joints]),
    )


def safety(
    joints: int, peak: float, internal_model: InternalModel = "observer"
) -> SafetyParameters:
    """Return limits of commands. Assumptions, which exceed all that nominal experiments need.

    With an observer the torque limit is three times the largest peak of the perturbation, and
    commands may change by that much in a tick. The power limit is the 80 W that ISO 10218-1:2006 is
    said to set for robots beside people; the standard was not at hand. Time-delay estimation
    chatters, and needs limits that protect nobody.

    Largest values in the 48 conditions of the study (and with four to seven joints, trials of 4 s):

    ========  ============================================  =====================================
    limit     largest nominal value                         default
    ========  ============================================  =====================================
    position  0.19 rad (large joints), 0.38 rad (small)     0.5 rad, 0.8 rad
    velocity  1.5 rad/s (large joints), 5.6 rad/s (small)   4 rad/s, 10 rad/s
    torque    2.7 times the peak; tde: 77 N·m, beyond       3 times the peak; tde: 80 N·m, beyond
              three joints 92 N·m                           three joints 140 N·m
    rate      5 N·m per tick; tde: 115 N·m, 152 N·m         3 times the peak; tde: 150 N·m, 260 N·m
    power     20 W; tde: 67 W, 87 W                         80 W; tde: 200 W
    ========  ============================================  =====================================

    Parameters
    ----------
    joints : n
    peak : largest of the perturbation, N·m
    internal_model : observer or tde
    """
    sizes = JOINT_SIZES[joints]
    if internal_model == "observer":
        torque = round(3.0 * peak, 6)
        rate, power = torque / PERIOD, 80.0
    else:
        torque, rate, power = (80.0, 150e3, 200.0) if joints <= 3 else (140.0, 260e3, 200.0)
    return SafetyParameters(
        position_limit=tuple(0.5 if size >= 0.2 else 0.8 for size in sizes),
        velocity_limit=tuple(4.0 if size >= 0.5 else 10.0 for size in sizes),
        torque_limit=torque,
        rate_limit=rate,
        power_limit=power,
    )


def target(robot_inertia: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return diagonals (n,) of M_rd, B_rd and K_rd for a robot of M_r(θ_0) (n, n); assumptions.

    SI units. For two joints they are those of the study's rig. For other numbers of joints
    M_rd = 0.56·diag(M_r(θ_0)), and a perturbed joint has B_rd/M_rd = 10 1/s, like the study's rig,
    and K_rd/M_rd = 100 1/s², like its elbow.
    """
    if len(robot_inertia) == 2:
        return np.array([0.2, 0.1]), np.array([2.0, 1.0]), np.array([10.0, 10.0])
    inertia = 0.56 * np.diag(robot_inertia)
    return inertia, 10.0 * inertia, 100.0 * inertia


def unknown_torque(joints: int) -> tuple[FloatArray, FloatArray]:
    """Return the rms change of unknown torque in a period if perturbed and if locked, (n,), N·m.

    Assumptions, chosen by ``make research ARGS=controller``. Friction of a joint that reverses
    changes by some N·m within ten milliseconds; that of a locked joint, which moves by a count or
    so, hardly changes. Both are proportional to the size of the joint, see
    :data:`armimp_common.sizes.JOINT_SIZES`.
    """
    sizes = np.array(JOINT_SIZES[joints])
    return 0.4 * sizes, 0.02 * sizes
