"""Numbers that kernels and host share: why a run aborts, the phases of a step, and values for "none"."""

ABORT_FORCE = 1
"""A contact force is above the range of the sums."""
ABORT_DISPLACEMENT = 2
"""A displacement in one step is above its limit."""
ABORT_NOT_FINITE = 3
"""A position is not finite."""
ABORT_OVERLAP = 4
"""An overlap is above its limit."""
ABORT_LEFT_DOMAIN = 5
"""A particle is outside a domain with `on_exit: error`; set by the host."""
ABORT_WALL = 6
"""The displacement of a force-controlled wall in one step is above its limit."""
ABORT_FAR = 7
"""A particle is so far from the origin that the precision does not resolve its position."""
ABORT_LIQUID = 8
"""Bridges have taken more liquid from a film than it had."""
ABORT_FLOW = 9
"""A sum that a contact model declares is above its range."""
ABORT_RATE = 10
"""A particle equation gives a property a value that is not finite."""
ABORT_BOX = 11
"""A deforming box has become narrower than the neighbor lists permit."""
ABORT_REASONS = {
    ABORT_FORCE: "force",
    ABORT_DISPLACEMENT: "displacement",
    ABORT_NOT_FINITE: "not_finite",
    ABORT_OVERLAP: "overlap",
    ABORT_LEFT_DOMAIN: "left_domain",
    ABORT_WALL: "wall",
    ABORT_FAR: "far",
    ABORT_LIQUID: "liquid",
    ABORT_FLOW: "flow",
    ABORT_RATE: "rate",
    ABORT_BOX: "box",
}
"""Reason of each code, as in Diagnosis.reason."""
FORCE_REASONS = frozenset({"force", "displacement", "not_finite", "overlap"})
"""Reasons that a force from Python can have caused."""
NO_PARTICLE = 2**31 - 1
"""Larger than any id: kernels lower it to the smallest id that exceeds a limit."""
PHASE_INTEGRATION = 0
PHASE_FORCES = 1
"""Phases of a step on a GPU that can halt the following launches: indices of `Control.halted_at`."""
NOT_HALTED = 2**31 - 1
"""Larger than the number of any launch on a GPU."""
REMOVED_BELOW = 0.0
"""Radius [m] at and below which a particle is deleted at the next neighbor-list rebuild."""
