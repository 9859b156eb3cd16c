"""Sums of velocities over many steps in float32, which would otherwise lose small changes of large velocities.

The change of a velocity in one step, such as g dt, can be smaller than half the spacing of float32 at the velocity
(5e-7 m/s at 8 m/s). Each particle therefore keeps the remainder of the sum for the next step (Kahan, Commun. ACM 8
(1965) 40). Clumps sum their velocities in the precision of positions instead.
"""

from typing import Any

from granflow.engine.state import State
from granflow.kernel_language import ti


def build_changed(state: State, name: str) -> Any:
    """Device function (i, change): a velocity of particle i after a change in this step; does not write the velocity.

    name:  "velocity" or "angular_velocity"

    Reads:   the velocity, its remainder
    Writes:  the remainder
    """
    velocity, keeps_remainder = getattr(state.particles, name), state.plan.features.velocity_remainders
    remainder = getattr(state.particles, f"{name}_remainder")

    @ti.func
    def changed(i, change):
        before = velocity[i]
        after = before + change
        if ti.static(keeps_remainder):
            whole = change + remainder[i]
            after = before + whole
            remainder[i] = whole - (after - before)
        return after

    return changed
