"""What all laws share: the rows of the arrays that they work on."""

MOST_DELAY = 20
"""Control periods by which commands may be known to act late, at most."""

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
