"""Who leaves: asked of every particle at a search, and of nobody in between."""

from typing import Any

import taichi as ti

from granflow.device.state import State


def build_stays(state: State) -> Any:
    """Device function (i): whether particle i is still in the domain; not so a position that is no number.

    Reads:   position
    """
    position, real, border = state.particles.position, state.backend.position_real, state.plan.border
    free = range(3) if state.plan.scene.domain.leaving == "grow" else border.axes
    lows, highs = ([float(value) for value in corner] for corner in (state.plan.domain_low, state.plan.domain_high))

    @ti.func
    def stays(i):
        p, inside = position[i], True
        for axis in ti.static(range(3)):
            if ti.static(axis in free):
                inside = inside and p[axis] == p[axis]
            else:
                inside = inside and p[axis] >= real(lows[axis]) and p[axis] <= real(highs[axis])
        return inside

    return stays
