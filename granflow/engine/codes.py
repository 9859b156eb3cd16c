"""Codes and limits that kernels and host share."""

ABORT_FORCE, ABORT_DISPLACEMENT, ABORT_NOT_FINITE, ABORT_OVERLAP, ABORT_LEFT_DOMAIN, ABORT_WALL, ABORT_FAR = (
    range(1, 8)
)
ABORT_LIQUID = 8
"""Codes: a contact force above the range of the sums, a displacement per step above the limit, a position
that is not finite, an overlap above the limit, a particle outside a domain with `on_exit: error` (set by the
host), a force-controlled wall above its displacement limit, a particle so far from the origin that the
precision does not resolve its position (set by the host), and a film from which bridges have taken more
liquid than it had."""
ABORT_REASONS = {
    ABORT_FORCE: "force",
    ABORT_DISPLACEMENT: "displacement",
    ABORT_NOT_FINITE: "not_finite",
    ABORT_OVERLAP: "overlap",
    ABORT_LEFT_DOMAIN: "left_domain",
    ABORT_WALL: "wall",
    ABORT_FAR: "far",
    ABORT_LIQUID: "liquid",
}
"""Reason of each code, as in Diagnosis.reason."""
FORCE_REASONS = frozenset({"force", "displacement", "not_finite", "overlap"})
"""Reasons that a force from Python can have caused."""
NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that exceeds a limit."""
INTEGRATION, FORCES = range(2)
"""Phases of a step on a GPU that can halt the following launches."""
NOT_HALTED = 2**31 - 1
"""Larger than the number of any launch on a GPU."""
REMOVED_BELOW = 0.0
"""Radius [m] at and below which a particle is deleted at the next neighbor-list rebuild."""
