"""Rows of the arrays that a compiled law works on."""

THETA_1, THETA_2, IDEAL_VELOCITY, COMMAND, TICKS, OFFSET, SENSED_BEFORE = range(7)
"""Memory between ticks: the last two positions, ∫ u dt, the command sent, ticks since the start,
distance of the target from θ_rd, and the first row of the role."""
MEMORY_ROWS = 7

SENSED, INERTIA, DAMPING, STIFFNESS, APPROACH, DITHER, DITHER_ANGLE, TARE = range(8)
"""Role in a trial: share of τ_h' sensed; impedance that a joint is to show; what is left after a
tick of the distance of its target from θ_rd; amplitude (rad) and angle per tick (rad) of the dither
in its target; what the torque transducer reads at rest (N·m), which the law takes from τ_h'."""
ROLE_ROWS = 8

NO_JOINT = -1
"""Stands for the perturbed joint while all joints are locked."""
