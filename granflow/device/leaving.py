"""Who leaves: asked of every particle at a search, and of nobody in between."""

from typing import Any

import taichi as ti

from granflow.device.state import State


def build_stays(state: State) -> Any:
    """Device function (i): whether particle i is still in the domain; not so a position that is no number.

    Reads:   position
    """
    position = state.particles.position
    low_x, low_y, low_z = (float(value) for value in state.plan.domain_low)
    high_x, high_y, high_z = (float(value) for value in state.plan.domain_high)

    @ti.func
    def stays(i):
        p = position[i]
        in_x = p[0] >= low_x and p[0] <= high_x
        in_y = p[1] >= low_y and p[1] <= high_y
        return in_x and in_y and p[2] >= low_z and p[2] <= high_z

    return stays
