"""Rows of the arrays that a compiled law works on."""

THETA_1, THETA_2, IDEAL_VELOCITY, COMMAND, STARTED = range(5)
"""Memory between ticks: the last two positions, ∫ u dt, the command sent, whether it is in use."""
MEMORY_ROWS = 5

SENSED, INERTIA, DAMPING, STIFFNESS = range(4)
"""Role in a trial: share of τ_h' sensed, then of the impedance that a joint is to show."""
ROLE_ROWS = 4
