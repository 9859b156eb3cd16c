"""Quantities that each chunk of particles sums: terms of the energy budget, and impulses of walls."""

LOSSES = ("plastic_dissipation", "friction_dissipation", "rolling_dissipation", "damping_dissipation", "wall_work")
"""Terms of the energy budget that each chunk sums [J], with the names of the totals."""

PLASTIC, FRICTION, ROLLING, DAMPING, WALL_WORK = range(len(LOSSES))

IMPULSE_SIZE = 7
"""Components that each chunk sums for a wall: time integrals of force (3), torque (3) and normal force (1)."""
