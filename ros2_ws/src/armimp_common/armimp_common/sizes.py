"""Sizes of the joints of the preset rigs, on which friction and perturbation depend."""

from typing import Final

JOINT_SIZES: Final[dict[int, tuple[float, ...]]] = {
    1: (0.6,),
    2: (1.0, 0.6),
    3: (1.0, 0.6, 0.14),
    4: (1.0, 0.62, 0.31, 0.091),
    5: (1.0, 0.69, 0.42, 0.21, 0.06),
    6: (1.0, 0.74, 0.5, 0.3, 0.15, 0.043),
    7: (1.0, 0.77, 0.57, 0.38, 0.23, 0.11, 0.032),
}
"""Size of each joint of the preset with n joints; that of the shoulder of the paper's arm is 1.

The rule: for bodies of the same shape, torques scale with the third power of length (cross-section
times lever arm of a muscle or motor), and moments of inertia with the fifth. So the size of a
joint, to which torques are proportional, is s_i = (M_ii/M_11)^(3/5) with the inertia
M = M_r(θ_0) + M_h of robot and arm. For the elbow of the paper (two joints) that gives 0.614; its
Table III has 0.6, which is used here.
"""
